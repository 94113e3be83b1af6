"""Evaluation of agents: `python -m plate_gym.bench --agent B --task Sort10-v1 --json B.json`. Check
of a result from another person: `python -m plate_gym.bench --check B.json`. On all processors with
AVX2 and FMA, the results are identical."""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import operator
import os
import re
import reprlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from plate_bringup.cluster import Cluster
from plate_bringup.identity import files_of, libraries_of, machine
from plate_bringup.loop import ALIKE
from plate_core import PlateError, did_you_mean, piped
from plate_core.files import OwnFile, read_file
from plate_core.intervals import of_median, of_share

from . import isolation
from .agent import KNOWN, Agent, Brief
from .agents import AGENTS
from .env import PlateEnv, drawn
from .isolation import LIMITS, Limits
from .plates import clocks
from .tasks import TASKS, WORLDS, chosen, digest

__all__ = [
    "ROW", "Limits", "agent_class", "check", "episode", "evaluate", "ranges", "read", "seed_range",
    "summary", "validate",
]  # fmt: skip

LIBRARIES = ("vibrating-plate", "plate_gym", "gymnasium")
"""Libraries whose versions a result contains if they are installed. It also contains the versions
that `machine` returns."""

PACKAGES = (
    "bringup", "core", "driver", "feeder", "gym", "native", "planner", "sim", "solver", "vision",
)  # fmt: skip
"""Packages of whose sources a result contains a digest. Their names begin with `plate_`."""

TIMES = ("start_ms", "decision_ms", "decision_ms_p99", "wall_ms", "wall_ms_p99")
"""Keys of computing times, which differ between runs."""

NUMBERS = ("time_s", "return", "error_mm", "turn_error_deg", "limit_share", *TIMES)
"""Keys of the numbers in a row."""

ROW: dict[str, type] = dict.fromkeys(NUMBERS, float) | {
    "seed": int, "steps": int, "there": int, "dropped": int, "success": bool, "places": str
}  # fmt: skip
"""Keys and types of a row. If the agent exceeded a limit in the episode, the row contains zeros,
and the key `failure` names the limit."""

RESULT: dict[str, type] = {
    "agent": str, "world": str, "commit": str, "sources": str, "versions": dict, "tasks": dict
}  # fmt: skip
"""Keys and types of a result."""

LATER: dict[str, type] = {"limits": dict, "files": dict}
"""Additional keys of a result and their types. Results of earlier versions of this module do not
contain these keys."""

SHOWN = 5
"""Maximum number of differences in an error message."""

MAX_NAMES = 10_000
"""Maximum number of versions in a result, and maximum number of an agent's files in a result."""

CHECKED = 10
"""Maximum number of seeds of each task that a check repeats."""

MAX_SEEDS = 100_000

AGENT = 2
"""Number that makes the seed of an agent different from the seed of its world."""

HUGE = 1e9
"""Limit of the absolute values of the numbers in a result."""

KEEP_S = 1.0
"""Minimum time between two calls of `keep` during a task [s]."""

RESULT_BYTES = 64_000_000
"""Maximum size of the file of a result [bytes]. It is sufficient for 100,000 episodes of 500 bytes
each."""

TEXT = 300
"""Maximum length of texts in results, and of error messages from agents [characters]."""


def agent_class(name: str) -> type[Agent]:
    """Return the agent class for a name: a key of `AGENTS`, or `MODULE:CLASS`. The module is
    imported like any Python module.

    Raises
    ------
    PlateError
        If there is no agent with that name.
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
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        absent = isinstance(problem, ModuleNotFoundError) and problem.name == module
        where = f"; no {module}.py in this folder ({Path.cwd()}) or on the path" if absent else ""
        raise PlateError(f"agent {name} cannot be loaded: {one_line(problem)}{where}") from problem
    kinds = (getattr(found, key, None) for key in ("action", "observation"))
    if (
        not isinstance(found, type)
        or not all(isinstance(kind, str) for kind in kinds)
        or not callable(getattr(found, "act", None))
    ):
        raise PlateError(
            f"agent {name} is {found!r}, allowed: a class with action, observation and act"
        )
    return found


def one_line(problem: BaseException) -> str:
    """Return an exception as one line of text."""
    try:
        text = str(problem)
    except BaseException as other:
        text = f"(its text cannot be read: {type(other).__name__})"
    return shortened(f"{type(problem).__name__}: {text}" if text else type(problem).__name__)


def shortened(text: str) -> str:
    """Return a text of an agent or a result as one line of at most `TEXT` printable characters.
    Control characters are removed, because they could overwrite other lines of a terminal."""
    line = " ".join(text[: 2 * TEXT].split())
    line = line if len(line) <= TEXT else f"{line[:TEXT]}..."
    return "".join(letter if letter.isprintable() else "?" for letter in line)


def named(agent: str, task: str, seed: int, step: int) -> str:
    """Return a text for messages that tells where an error of an agent occurred."""
    return f"agent {agent}, {task}, seed {seed}, step {step}"


def episode(
    agent: str, world: str, task: str, seed: int, begin: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Run one episode in the world of a seed, in this process. The function `begin` is called
    before each decision.

    Returns
    -------
    dict
        Row with the keys `seed`, `success`, `time_s` (of the plate), `steps`, `return`, `there`,
        `dropped`, `error_mm` and `turn_error_deg` (of the part with the largest error at the end),
        `limit_share` (maximum), and `places` (digest of all positions). The computing times are
        `start_ms` (processor time to create the agent), `decision_ms` and `decision_ms_p99`
        (processor time of a decision, median and 99th percentile), and `wall_ms` and `wall_ms_p99`
        (elapsed time of a decision). If the action needs this project's solver, the times of a
        decision include the solver.

    Raises
    ------
    PlateError
        If the agent fails. The message contains agent, task, seed and step.
    """
    kind = agent_class(agent)
    spent, total, used = [], 0.0, 0.0
    places = hashlib.blake2b(digest_size=8)
    ended = over = False
    try:
        env = PlateEnv(task, world, kind.action, kind.observation)
        seen, info = env.reset(seed=seed)
        plate, brief = env.plates.plates[0], Brief.of(env)
        began = clocks()
        mind = kind(brief, seed_of_agent(seed))
        start = clocks() - began
        while not (ended or over):
            known = {name: info[name] for name in KNOWN if name in info}
            begin()
            before, began = plate.solving_s.copy(), clocks()
            action = mind.act(seen, known)
            passed = clocks() - began
            seen, reward, ended, over, info = env.step(action)
            spent.append(passed + plate.solving_s - before)
            total, used = total + reward, max(used, float(info["limit_share"]))
            places.update(plate.simulation.state.position.tobytes())
    except KeyboardInterrupt as problem:
        # Either Ctrl-C or the agent has raised KeyboardInterrupt. A process of `isolation` ignores
        # Ctrl-C, so there it was the agent.
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            raise
        raise PlateError(f"{named(agent, task, seed, len(spent))}: KeyboardInterrupt") from problem
    except BaseException as problem:
        where = named(agent, task, seed, len(spent))
        raise PlateError(f"{where}: {one_line(problem)}") from problem
    own, wall = 1e3 * np.array(spent).T
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
        "start_ms": 1e3 * float(start[0]),
        "decision_ms": float(np.median(own)),
        "decision_ms_p99": float(np.percentile(own, 99)),
        "wall_ms": float(np.median(wall)),
        "wall_ms_p99": float(np.percentile(wall, 99)),
    }


def seed_of_agent(seed: int) -> int:
    """Return the seed of an agent's random numbers. It differs from the seed of the world.
    Otherwise an agent could compute where the parts are."""
    return drawn(np.random.default_rng((seed, AGENT)))


def evaluate(
    agent: str,
    tasks: Iterable[str] = tuple(TASKS),
    seeds: Iterable[int] = range(100),
    world: str = "nominal",
    workers: int = 0,
    tell: Callable[[str], None] = lambda text: None,
    keep: Callable[[dict[str, Any]], None] = lambda result: None,
    limits: Limits = LIMITS,
    pool: Executor | None = None,
    done: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Run an agent on tasks. Each task is run in the worlds of several seeds.

    Parameters
    ----------
    agent : str
        Name for `agent_class`.
    tasks, seeds, world
        Names of tasks (or one name); seeds from 0, without repetition; a key of `WORLDS`.
    workers : int
        Number of episodes that run at once, each in a process of its own. 0: the episodes run in
        this process, without limits.
    tell : callable
        Function that is called with a line of text after each task, and after each episode in which
        a limit was exceeded.
    keep : callable
        Function that is called with the result so far: after each task, at most every `KEEP_S`
        during a task, and before an error is raised.
    limits : Limits
        Limits of the agent. If a limit is exceeded in an episode, the episode counts as failed.
    pool : Executor, optional
        Executor that runs the episodes in place of `workers`, such as a
        `plate_bringup.cluster.Cluster`.
    done : dict, optional
        Result of an earlier call. The new result contains its rows, and its episodes are not
        repeated.

    Returns
    -------
    dict
        Result for JSON. It contains `agent`, `world`, `commit`, the digest of the `sources`,
        `versions`, `limits`, and the digests of the agent's `files`. For each task, it contains the
        `rows` of `episode` and their summary. The summary contains `success`, and the medians of
        `time_s` (of the successful episodes) and `decision_ms`. Each of these has a 95 % confidence
        interval: of Wilson for `success`, by bootstrap for the medians.

    Raises
    ------
    PlateError
        If a name is unknown, if a seed is not allowed, if the agent fails, or if `done` is a result
        of other code or files, or of another agent, world, limit or computer.
    """
    result = begun(agent, world, limits, done)
    tasks = [tasks] if isinstance(tasks, str) else list(dict.fromkeys(tasks))
    for task in tasks:
        chosen("task", task, TASKS)
    seeds = [operator.index(seed) for seed in seeds]
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise PlateError(f"seeds are {seeds}, allowed: one or more, 0 or larger, each once")
    for task in tasks:
        rows = {row["seed"]: row for row in result["tasks"].get(task, {"rows": []})["rows"]}
        missing = [seed for seed in seeds if seed not in rows]
        kept = time.monotonic()
        try:
            for row in episodes(agent, world, task, missing, workers, tell, limits, pool):
                rows[row["seed"]] = row
                if time.monotonic() - kept > KEEP_S:
                    result["tasks"][task] = summary([rows[seed] for seed in sorted(rows)])
                    keep(result)
                    kept = time.monotonic()
        finally:  # the rows so far are also kept if the agent fails, or on Ctrl-C
            if rows:
                result["tasks"][task] = summary([rows[seed] for seed in sorted(rows)])
                keep(result)
        tell(line(task, result["tasks"][task]))
    return result


def begun(agent: str, world: str, limits: Limits, done: dict[str, Any] | None) -> dict[str, Any]:
    """Return the result of `evaluate` before its first episode.

    Raises
    ------
    PlateError
        If a name is unknown, or if `done` cannot be continued.
    """
    if ":" not in agent:  # other agents are imported only in the workers
        agent_class(agent)
    chosen("world", world, WORLDS)
    result: dict[str, Any] = {
        "agent": agent, "world": world, "commit": commit(), "sources": sources(),
        "versions": versions(agent), "limits": asdict(limits), "files": files(agent), "tasks": {},
    }  # fmt: skip
    if done is not None:
        validate(done)
        was, now = terms(done), terms(result)
        if found := [
            shortened(f"{name} is {was.get(name)} in it, {now.get(name)} now")
            for name in now | was
            if now.get(name) != was.get(name)
        ]:
            more = f"; {len(found) - SHOWN} more differences" if len(found) > SHOWN else ""
            raise PlateError(
                f"the earlier result cannot be continued: {'; '.join(found[:SHOWN])}{more}; "
                "allowed: the same, or another file"
            )
        result["tasks"] |= done["tasks"]
    return result


def episodes(
    agent: str,
    world: str,
    task: str,
    seeds: list[int],
    workers: int,
    tell: Callable[[str], None] = lambda text: None,
    limits: Limits = LIMITS,
    pool: Executor | None = None,
) -> Iterator[dict[str, Any]]:
    """Run episodes and yield their rows in the order of the seeds. `workers` episodes run at the
    same time, unless a pool runs them. Failed episodes are reported."""
    if pool is None and not workers:
        yield from map(partial(episode, agent, world, task), seeds)
        return
    # Threads are sufficient, because they only wait for the processes of the episodes.
    shared = nullcontext(pool) if pool is not None else ThreadPoolExecutor(workers)
    # Workers of a cluster import the function under this name.
    run = isolated if pool is None else importlib.import_module("plate_gym.bench").isolated
    with shared as threads:
        found = [threads.submit(run, agent, world, task, seed, limits) for seed in seeds]
        try:
            for number, row in enumerate(found):
                show(f"{task}: {number} of {len(seeds)}")
                done = row.result()
                if failure := done.get("failure"):
                    show("")
                    tell(f"failed: {named(agent, task, done['seed'], done['steps'])}: {failure}")
                yield done
        except BaseException:
            for own in found:
                own.cancel()
            while wait(found, 0.1).not_done:
                isolation.stop()
            raise
        finally:
            show("")


def isolated(agent: str, world: str, task: str, seed: int, limits: Limits) -> dict[str, Any]:
    """Run one episode in a separate process.

    Returns
    -------
    dict
        Row as in `episode`. If the agent exceeds a limit, the row contains zeros, and `failure`
        names the limit.

    Raises
    ------
    PlateError
        If the agent fails for another reason. The message contains agent, task and seed.
    """
    request = {"agent": agent, "world": world, "task": task, "seed": seed}
    reply = isolation.play(request, limits)
    where = f"agent {agent}, {task}, seed {seed}"
    if "row" in reply:
        check_fields(where, reply["row"], ROW)
        return dict(reply["row"])
    if "failure" in reply:
        failed = {"seed": seed, "steps": reply["steps"], "failure": shortened(reply["failure"])}
        return {key: kind() for key, kind in ROW.items()} | failed
    error = shortened(reply["error"])
    raise PlateError(error if error.startswith("agent ") else f"{where}: {error}")


def show(text: str) -> None:
    """Replace the last line in the terminal by `text`."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise the episodes of a task."""
    good = [row["time_s"] for row in rows if row["success"]]
    ended = [row for row in rows if "failure" not in row] or rows
    spent = [row["decision_ms"] for row in ended]
    found = {
        "episodes": len(rows),
        "success": len(good) / len(rows),
        "success_interval": of_share(len(good), len(rows)),
        "return": float(np.mean([row["return"] for row in rows])),
        "dropped": sum(row["dropped"] for row in rows),
        "decision_ms": float(np.median(spent)),
        "decision_ms_interval": of_median(spent),
        "wall_ms": float(np.median([row["wall_ms"] for row in ended])),
    }
    if good:
        found |= {"time_s": float(np.median(good)), "time_s_interval": of_median(good)}
    return found | {"rows": rows}


def line(task: str, found: dict[str, Any]) -> str:
    """Return the summary of a task as one line of text."""
    low, high = (100 * share for share in found["success_interval"])
    took = f"{found['time_s']:6.1f} s" if "time_s" in found else "     - s"
    return (
        f"{task:12s} {100 * found['success']:4.0f} % ({low:.0f} to {high:.0f})  {took}  return "
        f"{found['return']:6.2f}  dropped {found['dropped']}  {found['decision_ms']:.1f} ms each"
    )


def check(
    result: Any,
    tell: Callable[[str], None] = lambda text: None,
    workers: int = 0,
    fresh: int = 0,
    world: str | None = None,
    trusted: str = "",
    limits: Limits = LIMITS,
) -> list[str]:
    """Repeat up to `CHECKED` seeds of each task of a result, and recompute its summary.

    Parameters
    ----------
    result
        Content of a file from `evaluate`.
    tell : callable
        Function that is called with lines of text: the versions that differ on this machine, and
        the progress for each task.
    workers : int
        The same as in `evaluate`.
    fresh : int
        Number of additional random seeds of each task.
    world : str, optional
        World of the additional seeds. Default: the world of the result.
    trusted : str
        Name of an agent `MODULE:CLASS` whose code may be imported and run. If the result is from
        another agent of this form, an error is raised.
    limits : Limits
        The same as in `evaluate`.

    Returns
    -------
    list of str
        Differences, except in computing times. For additional seeds in the world of the result, the
        success counts as different if both confidence intervals do not overlap. A digest of places
        also differs if the libraries of both machines round differently.

    Raises
    ------
    PlateError
        If `result` is not a result of `evaluate`, or if its agent is missing, fails or is not
        trusted.
    """
    validate(result)
    agent = result["agent"]
    if agent not in AGENTS and agent != trusted:
        other = f" (trusted: {trusted})" if trusted else ""
        raise PlateError(
            f"agent {agent} is not trusted{other}; read its code, because the check runs it, and "
            f"trust it with --trust {agent}"
        )
    world = result["world"] if world is None else world
    chosen("world", world, WORLDS)
    tell(f"agent {result['agent']}, commit {result['commit'] or 'unknown'}")
    own = {"sources": sources(), "versions": versions(agent)}
    if "limits" in result:
        own |= {"limits": asdict(limits), "files": files(agent)}
    made, here = terms(result), terms(result | own)
    for name in here | made if "limits" in result else made:
        if made.get(name) != here.get(name):
            tell(shortened(f"{name} is {made.get(name)} in the result, and {here.get(name)} here"))
    # Nobody must be able to predict the seeds that are repeated.
    wrong, chance = [], np.random.default_rng()
    for task, claimed in result["tasks"].items():
        rows = {row["seed"]: row for row in claimed["rows"]}
        tell(f"{task}: the result has seeds {ranges(sorted(rows))}")
        again = summary(claimed["rows"])
        if {k: list(v) if isinstance(v, tuple) else v for k, v in again.items()} != claimed:
            wrong.append(f"{task}: the summary does not match its rows")
        run = partial(episodes, agent, task=task, workers=workers, tell=tell, limits=limits)
        picks = sorted(chance.permutation(np.array(list(rows), object))[:CHECKED].tolist())
        played = list(run(world=result["world"], seeds=picks))
        for seed, true in zip(picks, played, strict=True):
            wrong += [
                f"{task}, seed {seed}: {key} is {rows[seed].get(key)!r}, repeated: {value!r}"
                for key, value in differing(rows[seed], true)
            ]
        took, took_here = again["decision_ms"], summary(played)["decision_ms"]
        tell(
            f"{task}: {len(picks)} seeds repeated, {len(wrong)} differences so far; {took:.3g} ms "
            f"per decision in the result, {took_here:.3g} ms here"
        )
        if fresh:
            seeds = [drawn(chance) for _ in range(fresh)]
            found = summary(list(run(world=world, seeds=seeds)))
            tell(f"{line(task, found)}, {world}, fresh seeds {ranges(sorted(seeds))}")
            (low, high), (least, most) = found["success_interval"], again["success_interval"]
            if world == result["world"] and (high < least or low > most):
                wrong.append(
                    f"{task}: success is {claimed['success']}, {found['success']} with fresh seeds"
                )
    return wrong


def differing(claimed: dict[str, Any], true: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the key and the value in the row `true` of each difference between two rows, except in
    computing times. If both rows have the key `failure`, they count as equal, because the step at
    which a limit is exceeded depends on the computer."""
    keys = ["failure"] if "failure" in true or "failure" in claimed else [*ROW]
    for key in keys:
        same = key in claimed and key in true if key == "failure" else claimed[key] == true[key]
        if key not in TIMES and not same:
            yield key, true.get(key)


def read(path: Path) -> Any:
    """Return the content of a JSON file of at most `RESULT_BYTES`.

    Raises
    ------
    PlateError
        If the file cannot be read or is not valid JSON. The message contains the name of the file.
    """
    content = read_file(path, RESULT_BYTES)
    try:
        return json.loads(content.decode())
    # Json raises these errors also for huge numbers and deep nesting.
    except (ValueError, RecursionError) as problem:
        raise PlateError(f"{path} is not JSON: {problem}") from problem


def validate(result: Any) -> None:
    """Check that data has the form of a result of `evaluate`. The keys, the types and the ranges of
    numbers are checked.

    Raises
    ------
    PlateError
        If the data does not have this form. The message contains the place, the value and the
        allowed values.
    """
    earlier = isinstance(result, dict) and not set(LATER) & set(result)
    check_fields("result", result, RESULT if earlier else RESULT | LATER)
    for key in ("versions", "files"):
        texts = result.get(key, {})
        check_fields(f"result: {key}", texts, dict.fromkeys(texts, str))
        if len(texts) > MAX_NAMES:
            raise PlateError(f"result: {key} has {len(texts)} names, allowed: at most {MAX_NAMES}")
    if not earlier:
        check_fields("result: limits", result["limits"], dict.fromkeys(asdict(LIMITS), float))
    for key, form in (("agent", r"[\w.]+(:\w+)?"), ("commit", r"[\w.-]*")):
        if not re.fullmatch(form, result[key]):
            raise PlateError(f"result: {key} is {result[key]!r}, allowed: the form {form}")
    chosen("result: world", result["world"], WORLDS)
    if not result["tasks"]:
        raise PlateError("result: tasks is {}, allowed: one task or more")
    for task, found in result["tasks"].items():
        chosen("result: task", shortened(task), TASKS)
        rows = found.get("rows") if isinstance(found, dict) else None
        if not isinstance(rows, list) or not rows:
            raise PlateError(f"result: {task}: rows is {brief(rows)}, allowed: a list with entries")
        for k, row in enumerate(rows):
            where = f"result: {task}: rows[{k}]"
            failed = isinstance(row, dict) and "failure" in row
            check_fields(where, row, ROW | {"failure": str} if failed else ROW)
            if failed and row["success"]:
                raise PlateError(
                    f"{where}: success is True, allowed in a row with a failure: False"
                )
            for key in ("seed", *TIMES):
                if row[key] < 0:
                    raise PlateError(f"{where}: {key} is {row[key]}, allowed: 0 or more")
        if len({row["seed"] for row in rows}) < len(rows):
            raise PlateError(f"result: {task}: a seed occurs twice, allowed: each once")


def check_fields(where: str, found: Any, kinds: dict[str, type]) -> None:
    """Raise an error unless `found` is a dict with exactly the keys and types of `kinds`, with
    finite numbers and printable texts."""
    if not isinstance(found, dict) or set(found) != set(kinds):
        has = shortened(", ".join(map(str, found))) if isinstance(found, dict) else brief(found)
        raise PlateError(f"{where} has {has}, allowed: {', '.join(kinds)}")
    for key, kind in kinds.items():
        value = found[key]
        # The comparison is False for NaN, so NaN is refused.
        number = type(value) in (int, float) and abs(value) < HUGE
        fits = number if kind is float else type(value) is kind
        allowed = f"a number below {HUGE:g}" if kind is float else kind.__name__
        if fits and kind is str and not (len(value) <= TEXT and value.isprintable()):
            fits, allowed = False, f"up to {TEXT} printable characters"
        if not fits:
            raise PlateError(f"{where}: {key} is {brief(value)}, allowed: {allowed}")


def brief(value: Any) -> str:
    """Return a value of a result as a short text for a message."""
    return shortened(reprlib.repr(value))


def ranges(seeds: list[int]) -> str:
    """Return ascending seeds as a text with ranges `FIRST:END`."""
    ends = [k for k in range(1, len(seeds)) if seeds[k] > seeds[k - 1] + 1]
    # The type object allows integers of any size.
    runs = np.split(np.array(seeds, object), ends)
    return ", ".join(f"{run[0]}:{run[-1] + 1}" if len(run) > 1 else f"{run[0]}" for run in runs)


def terms(result: dict[str, Any]) -> dict[str, Any]:
    """Return the parts of a result that determine its rows, by name."""
    names = {f"file {name}": mark for name, mark in result.get("files", {}).items()}
    found = {key: result[key] for key in ("agent", "world", "sources")}
    return result["versions"] | result.get("limits", {}) | names | found


def versions(agent: str = "") -> dict[str, str]:
    """Return the facts of `machine`, and the versions of Python, of the installed `LIBRARIES`, and
    of the libraries that the agent imports."""
    found = {"python": sys.version.split()[0]}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    found |= {name: text for name, text in machine().items() if name != "Python"}
    return found | (libraries_of(module_of(agent)) if ":" in agent else {})


def files(agent: str) -> dict[str, str]:
    """Return digests of the files of an agent `MODULE:CLASS`. For agents of this package, there are
    none."""
    return files_of(module_of(agent)) if ":" in agent else {}


def module_of(agent: str) -> str:
    """Return the first part of the module name of an agent `MODULE:CLASS`. The modules in a package
    are not searched for, because this search would run the package's code."""
    return agent.partition(":")[0].partition(".")[0]


def commit() -> str:
    """Return the commit of this project, or an empty text if git does not track this file."""
    here = Path(__file__).resolve()
    git = partial(
        subprocess.run, cwd=here.parent, capture_output=True, text=True, check=True, timeout=60
    )
    try:
        top = Path(git(["git", "rev-parse", "--show-toplevel"]).stdout.strip())
        kept = top / "src/plate_gym/plate_gym" / here.name  # the build copies this file to install/
        git(["git", "ls-files", "--error-unmatch", str(kept)])
        same = kept.read_bytes() == here.read_bytes()
        return str(git(["git", "describe", "--always", "--dirty"]).stdout.strip()) if same else ""
    except (OSError, subprocess.SubprocessError):
        return ""


def sources() -> str:
    """Return a digest of the sources of `PACKAGES` and of the files of the tasks."""
    mark = hashlib.sha256()
    for name in PACKAGES:
        spec = find_spec(f"plate_{name}")
        assert spec is not None
        assert spec.origin is not None
        package = Path(spec.origin).parent
        for path in sorted(package.rglob("*")):
            if path.suffix in (".py", ".hpp", ".cpp"):
                mark.update(f"{name}/{path.relative_to(package).as_posix()}\n".encode())
                mark.update(path.read_bytes())
    mark.update("".join(digest(scenario) for scenario, _ in TASKS.values()).encode())
    return mark.hexdigest()[:16]


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m plate_gym.bench", description=__doc__)
    parser.add_argument("--agent", help=f"{', '.join(AGENTS)}, or MODULE:CLASS (default: B)")
    parser.add_argument(
        "--task", action="append", help=f"{', '.join(TASKS)} (default: all); can be repeated"
    )
    parser.add_argument("--seeds", type=seed_range, help="range or one seed (default: 0:100)")
    parser.add_argument(
        "--world", help=f"{', '.join(WORLDS)} (default: nominal, with --fresh that of the result)"
    )
    parser.add_argument("--json", type=Path, help="file for the result")
    parser.add_argument(
        "--workers", type=int, help="processes (default: one per core); not with --cluster"
    )
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="Dask scheduler whose workers run the episodes"
    )
    parser.add_argument(
        "--check", type=Path, help="file of a result; some of its seeds are repeated"
    )
    parser.add_argument(
        "--fresh",
        type=int,
        metavar="N",
        help="with --check: run N further, random seeds of each task",
    )
    parser.add_argument(
        "--trust", metavar="MODULE:CLASS",
        help="with --check: agent whose code may run; read its code first",
    )  # fmt: skip
    parser.add_argument(
        "--decision-limit", type=float, metavar="S", default=LIMITS.decision_s,
        help="maximum time of a decision, and of the agent's start (default: %(default)g s)",
    )  # fmt: skip
    parser.add_argument(
        "--memory-limit", type=float, metavar="GB", default=LIMITS.memory_gb,
        help="maximum memory of an episode's processes (default: %(default)g GB)",
    )  # fmt: skip
    args = parser.parse_args()
    own = ("agent", "task", "seeds", "json", "cluster", *(() if args.fresh else ("world",)))
    given = [f"--{name}" for name in own if getattr(args, name) is not None]
    if args.check and given:
        parser.error(
            f"{', '.join(given)} is given with --check, allowed: --workers, --trust, limits, "
            "--fresh "
            "and, with --fresh, --world"
        )
    if args.trust and not args.check:
        parser.error("--trust requires --check")
    if args.fresh is not None and not (args.check and 0 < args.fresh <= MAX_SEEDS):
        parser.error(f"--fresh requires --check, allowed: 1 to {MAX_SEEDS}")
    if args.cluster and args.workers is not None:
        parser.error("--workers is given with --cluster, allowed: without --cluster")
    if args.workers is None:
        args.workers = os.cpu_count() or 1
    if args.workers < 1:  # in this process, an agent could end the program or falsify results
        parser.error(f"--workers is {args.workers}, allowed: 1 or more")
    tell = partial(print, flush=True)
    try:
        limits = Limits(args.decision_limit, args.memory_limit)
        if args.check:
            wrong = check(
                read(args.check), tell, args.workers, args.fresh or 0, args.world,
                args.trust or "", limits,
            )  # fmt: skip
            print("\n".join(wrong) or "the repeated seeds give the same result")
            return bool(wrong)

        # The file is opened now, so that a file that cannot be written is an error now and not
        # after hours.
        file = OwnFile(args.json) if args.json else None
        done = None
        if args.json and args.json.is_file() and args.json.stat().st_size:
            done = read(args.json)

        def keep(result: dict[str, Any]) -> None:
            if file is not None:
                file.write(json.dumps(result, indent=1) + "\n")

        agent, world = args.agent or "B", args.world or "nominal"
        begun(agent, world, limits, done)  # before the cluster, for which it may wait
        pool: Any = nullcontext()
        if args.cluster:
            other = module_of(agent) if ":" in agent else ""
            pool = Cluster(args.cluster, modules=("plate_gym",), agent=other, end=isolation.stop)
        with file or nullcontext(), pool as shared:
            evaluate(
                agent, args.task or list(TASKS), args.seeds or range(100), world, args.workers,
                tell, keep, limits, shared, done,
            )  # fmt: skip
    except BrokenPipeError:
        raise
    except (PlateError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        kept = f"; {args.json} has the episodes so far" if args.json else ""
        print(f"stopped{kept}", file=sys.stderr)
        return 130
    return 0


def seed_range(text: str) -> range:
    """Return the seeds of a text `FIRST:END`, or of one number."""
    first, colon, end = text.partition(":")
    try:
        seeds = range(int(first), int(end) if colon else int(first) + 1)
    except ValueError:
        seeds = range(0)
    if not seeds or seeds[0] < 0 or seeds[-1] - seeds[0] >= MAX_SEEDS:
        raise argparse.ArgumentTypeError(
            f"is {text!r}, allowed: FIRST:END, at most {MAX_SEEDS} of them, or one number"
        )
    return seeds


if __name__ == "__main__":
    # The program restarts itself, because libraries read these environment variables only at the
    # start of a process.
    if not ALIKE.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | ALIKE)
    # SIGTERM has the same effect as Ctrl-C, so that the workers end.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())
