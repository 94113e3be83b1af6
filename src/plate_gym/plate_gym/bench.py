"""Judge agents: `python -m plate_gym.bench --agent B --task Sort10-v1 --json B.json`; check
what others hand in: `python -m plate_gym.bench --check B.json`."""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from plate_core import PlateError, did_you_mean
from plate_core.intervals import of_median, of_share

from .agents import AGENTS, Agent
from .env import PlateEnv
from .tasks import TASKS, WORLDS, chosen

LIBRARIES = ("vibrating-plate", "plate_gym", "gymnasium", "numpy", "scipy")
"""Whose versions a result names, those of them that are installed."""

TIMES = ("decision_ms", "decision_ms_p99")
"""What differs from run to run."""

CHECKED = 10
"""Seeds of each task that the checker runs again."""

MOST_SEEDS = 100_000


def agent_class(name: str) -> type[Agent]:
    """Return an agent: one of `AGENTS`, or `MODULE:CLASS`, found as Python finds modules.

    Raises
    ------
    PlateError
        If there is none of that name.
    """
    if name in AGENTS:
        return AGENTS[name]
    module, colon, label = name.partition(":")
    if not colon:
        raise PlateError(
            f"agent is {name!r}{did_you_mean(name, AGENTS)}, allowed: {', '.join(AGENTS)}, or "
            "MODULE:CLASS"
        )
    try:
        found: type[Agent] = getattr(importlib.import_module(module), label)
    except (ImportError, AttributeError) as problem:
        raise PlateError(f"agent {name} cannot be loaded: {problem}") from problem
    return found


def episode(agent: str, world: str, task: str, seed: int) -> dict[str, Any]:
    """Run one episode, in the world of a seed.

    Returns
    -------
    dict
        `seed`, `success`, `time_s` (of the plate), `steps`, `return`, `there`, `dropped`,
        `error_mm` and `turn_error_deg` (of the worst part at the end), `limit_share` (greatest),
        `places` (digest of where the parts were all along), `decision_ms`, `decision_ms_p99`
        (computing time of a decision: median and 99 %).
    """
    kind = agent_class(agent)
    env = PlateEnv(task, world, kind.action, kind.observation)
    seen, info = env.reset(seed=seed)
    mind = kind(env, seed)
    spent, total, used = [], 0.0, 0.0
    places = hashlib.blake2b(digest_size=8)
    ended = over = False
    while not (ended or over):
        began = time.process_time()
        action = mind.act(seen, info)
        spent.append(1e3 * (time.process_time() - began))
        seen, reward, ended, over, info = env.step(action)
        total, used = total + reward, max(used, float(info["limit_share"]))
        places.update(env.plates.plates[0].simulation.state.position.tobytes())
    return {
        "seed": seed,
        "success": bool(info["success"]),
        "time_s": round(float(info["time_s"]), 6),
        "steps": len(spent),
        "return": total,
        "there": int(info["there"]),
        "dropped": int(info["dropped"]),
        "error_mm": 1e3 * float(np.max(info["error_m"])),
        "turn_error_deg": float(np.degrees(np.max(info["turn_error"]))),
        "limit_share": used,
        "places": places.hexdigest(),
        "decision_ms": float(np.median(spent)),
        "decision_ms_p99": float(np.percentile(spent, 99)),
    }


def evaluate(
    agent: str,
    tasks: Iterable[str] = tuple(TASKS),
    seeds: Sequence[int] = range(100),
    world: str = "nominal",
    workers: int = 1,
    tell: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Run an agent on tasks, each in the worlds of many seeds.

    Parameters
    ----------
    agent : str
        As `agent_class` takes it.
    tasks, seeds, world
        Names of tasks, seeds from 0 on, and a key of `WORLDS`.
    workers : int
        Processes that work at the same time.
    tell : callable
        Takes a line of text for each task that is done.

    Returns
    -------
    dict
        For JSON: what was run (`agent`, `world`, `commit`, `versions`), and by task `rows`, those
        of `episode`, with their summary: `success` and `time_s` and `decision_ms` (medians; times
        of the episodes that ended well), each with an interval of 95 % (Wilson's, bootstrap).

    Raises
    ------
    PlateError
        If a name is unknown or a seed is not allowed.
    """
    agent_class(agent)
    chosen("world", world, WORLDS)
    tasks = list(tasks)
    for task in tasks:
        chosen("task", task, TASKS)
    if not seeds or min(seeds) < 0:
        raise PlateError(f"seeds are {list(seeds)}, allowed: one or more, from 0 on")
    result: dict[str, Any] = {
        "agent": agent, "world": world, "commit": commit(), "versions": versions(), "tasks": {},
    }  # fmt: skip
    for task in tasks:
        run = partial(episode, agent, world, task)
        if workers == 1:
            rows = list(map(run, seeds))
        else:
            with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
                rows = list(pool.map(run, seeds))
        result["tasks"][task] = summary(rows)
        tell(line(task, result["tasks"][task]))
    return result


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum up the episodes of a task."""
    good = [row["time_s"] for row in rows if row["success"]]
    spent = [row["decision_ms"] for row in rows]
    found = {
        "episodes": len(rows),
        "success": len(good) / len(rows),
        "success_interval": of_share(len(good), len(rows)),
        "return": float(np.mean([row["return"] for row in rows])),
        "dropped": sum(row["dropped"] for row in rows),
        "decision_ms": float(np.median(spent)),
        "decision_ms_interval": of_median(spent),
    }
    if good:
        found |= {"time_s": float(np.median(good)), "time_s_interval": of_median(good)}
    return found | {"rows": rows}


def line(task: str, found: dict[str, Any]) -> str:
    """Say in a line how a task went."""
    low, high = (100 * share for share in found["success_interval"])
    took = f"{found['time_s']:6.1f} s" if "time_s" in found else "     - s"
    return (
        f"{task:12s} {100 * found['success']:4.0f} % ({low:.0f} to {high:.0f})  {took}  return "
        f"{found['return']:6.2f}  dropped {found['dropped']}  {found['decision_ms']:.1f} ms each"
    )


def check(result: dict[str, Any], tell: Callable[[str], None] = lambda text: None) -> list[str]:
    """Run up to `CHECKED` seeds of each task of a result again, and sum up its rows again.

    Returns
    -------
    list of str
        What differs, but for computing times; empty if nothing does. A digest of places also
        differs between machines whose libraries compute other last bits.

    Raises
    ------
    PlateError
        If it is no result of `evaluate`, or its agent is not here.
    """
    if lacking := [key for key in ("agent", "world", "tasks") if key not in result]:
        raise PlateError(f"result has no {', '.join(lacking)}, allowed: what evaluate returns")
    wrong = []
    for task, claimed in result["tasks"].items():
        rows = claimed["rows"]
        seeds = [row["seed"] for row in rows]
        if len(set(seeds)) < len(seeds):
            wrong.append(f"{task}: a seed is given twice, allowed: each once")
        again = summary(rows)
        if {k: list(v) if isinstance(v, tuple) else v for k, v in again.items()} != claimed:
            wrong.append(f"{task}: the summary is not that of its rows")
        picks = np.random.default_rng().permutation(len(rows))[:CHECKED]  # nobody knows which
        for row in (rows[k] for k in sorted(picks)):
            true = episode(result["agent"], result["world"], task, row["seed"])
            wrong += [
                f"{task}, seed {row['seed']}: {key} is {row.get(key)!r}, again: {value!r}"
                for key, value in true.items()
                if key not in TIMES and row.get(key) != value
            ]
        tell(f"{task}: {len(picks)} seeds again, {len(wrong)} differences so far")
    return wrong


def versions() -> dict[str, str]:
    """Return the versions of what is installed of `LIBRARIES`, and of Python."""
    found = {"python": sys.version.split()[0]}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def commit() -> str:
    """Return the name of the commit that this file is of; empty without git."""
    command = ["git", "-C", str(Path(__file__).resolve().parent), "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m plate_gym.bench", description=__doc__)
    parser.add_argument("--agent", default="B", help=f"{', '.join(AGENTS)}, or MODULE:CLASS")
    parser.add_argument(
        "--task", action="append", help=f"{', '.join(TASKS)} (all); may be given again"
    )
    parser.add_argument("--seeds", type=seed_range, default=range(100), help="0:100, or one")
    parser.add_argument("--world", default="nominal", help=", ".join(WORLDS))
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--json", type=Path, help="file for the result")
    parser.add_argument("--check", type=Path, help="file with a result to be run again in part")
    args = parser.parse_args()
    try:
        if args.check:
            wrong = check(json.loads(args.check.read_text("utf-8")), print)
            print("\n".join(wrong) or "the same again")
            return bool(wrong)
        tasks = args.task or list(TASKS)
        result = evaluate(args.agent, tasks, args.seeds, args.world, max(args.workers, 1), print)
        if args.json:
            args.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    except json.JSONDecodeError as error:
        print(f"error: {args.check} is no JSON: {error}", file=sys.stderr)
        return 2
    except (PlateError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def seed_range(text: str) -> range:
    """Return seeds `FIRST:END`, or one."""
    first, colon, end = text.partition(":")
    try:
        seeds = range(int(first), int(end) if colon else int(first) + 1)
    except ValueError:
        seeds = range(0)
    if not 0 < len(seeds) <= MOST_SEEDS or seeds[0] < 0:
        raise argparse.ArgumentTypeError(
            f"is {text!r}, allowed: FIRST:END, at most {MOST_SEEDS} of them, or one number"
        )
    return seeds


if __name__ == "__main__":
    sys.exit(main())
