"""Evaluation of agents: `python -m plate_gym.bench --agent B --task Sort10-v1 --json B.json`. Check
of a result from another person: `python -m plate_gym.bench --check B.json`. On all processors with
the instruction sets AVX2 and FMA, the results are identical."""

from __future__ import annotations

import argparse
import json
import operator
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed, wait
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from plate_bringup.cluster import Cluster
from plate_bringup.loop import ALIKE
from plate_core import PlateError, piped
from plate_core.files import OwnFile

from . import isolation
from .agents import AGENTS
from .env import drawn
from .episode import agent_class, episode, isolated, named
from .isolation import LIMITS, Limits
from .provenance import commit, files, module_of, sources, terms, versions
from .result import ROW, TIMES, line, printable, ranges, read, shortened, summary, validate
from .tasks import TASKS, WORLDS, chosen

__all__ = ["Limits", "check", "evaluate", "main", "seed_range"]

SHOWN = 5
"""Maximum number of differences that the error message lists if an earlier result cannot be
continued."""

MAX_OTHER = 100
"""Maximum number of different versions and files that a check reports."""

CHECKED = 10
"""Maximum number of seeds of each task that a check repeats."""

MAX_SEEDS = 100_000

KEEP_S = 1.0
"""Minimum time between two calls of `keep` during a task [s]."""


def evaluate(
    agent: str,
    tasks: Iterable[str] = tuple(TASKS),
    seeds: Iterable[int] = range(100),
    world: str = "nominal",
    workers: int = 0,
    report: Callable[[str], None] = lambda text: None,
    keep: Callable[[dict[str, Any]], None] = lambda result: None,
    limits: Limits = LIMITS,
    pool: Executor | None = None,
    done: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Run episodes of an agent on one or more tasks. For each task and each seed, the agent runs
    one episode in the world that the seed defines.

    Parameters
    ----------
    agent : str
        Name for `agent_class`.
    tasks, seeds, world
        Names of tasks (or one name), seeds (0 or more, each once), and a key of `WORLDS`.
    workers : int
        Number of episodes that run at the same time, each in a separate process. If `workers` is 0,
        the episodes run in this process, without limits of time and memory.
    report : callable
        Function that is called with a line of text after each task, and after each episode in which
        a limit was exceeded.
    keep : callable
        Function that is called with the result so far. The function is called after each task, at
        most every `KEEP_S` during a task, and before an error is raised.
    limits : Limits
        Limits of the agent. If a limit is exceeded in an episode, the episode counts as failed.
    pool : Executor, optional
        Executor that runs the episodes, such as a `plate_bringup.cluster.Cluster`. If `pool` is
        given, `workers` has no effect.
    done : dict, optional
        Result of an earlier call. The new result contains the rows of this result, and the episodes
        of these rows are not repeated.

    Returns
    -------
    dict
        Result for JSON. The result contains `agent`, `world`, `commit`, the digest of the
        `sources`, `versions`, `limits`, and the digests of the agent's `files`. For each task, it
        contains the `rows` of `episode` and their summary. The summary contains `success`, and the
        medians of `time_s` (of the successful episodes) and `decision_ms`. Each of these three
        values has a 95 % confidence interval. The interval of `success` is a Wilson interval, and
        the intervals of the medians are computed by bootstrap.

    Raises
    ------
    PlateError
        If a name is unknown, a seed is not allowed, the agent fails, or `done` cannot be continued.
        `done` must be a result of the same code, files, agent, world, limits and type of computer.
    """
    result = begun(agent, world, limits, done)
    for task, seeds_left in missing(result, tasks, seeds).items():
        rows = {row["seed"]: row for row in rows_of(result, task)}
        kept = time.monotonic()
        try:
            for row in episodes(agent, world, task, seeds_left, workers, report, limits, pool):
                rows[row["seed"]] = row
                if time.monotonic() - kept > KEEP_S:
                    result["tasks"][task] = summary([rows[seed] for seed in sorted(rows)])
                    keep(result)
                    kept = time.monotonic()
        finally:  # also save the existing rows if the agent fails, or after Ctrl-C
            if rows:
                result["tasks"][task] = summary([rows[seed] for seed in sorted(rows)])
                keep(result)
        report(line(task, result["tasks"][task]))
    return result


def begun(agent: str, world: str, limits: Limits, done: dict[str, Any] | None) -> dict[str, Any]:
    """Return the result of `evaluate` as it is before the first episode.

    Raises
    ------
    PlateError
        If a name is unknown, or if `done` cannot be continued.
    """
    if ":" not in agent:  # agents of users are imported only in the worker processes
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
            shortened(f"{name} was {was.get(name)} and is now {now.get(name)}")
            for name in now | was
            if now.get(name) != was.get(name)
        ]:
            more = f"; {len(found) - SHOWN} more differences" if len(found) > SHOWN else ""
            raise PlateError(
                f"the earlier result cannot be continued: {'; '.join(found[:SHOWN])}{more}; "
                "allowed: equal values, or another file"
            )
        result["tasks"] |= done["tasks"]
    return result


def missing(
    result: dict[str, Any], tasks: Iterable[str], seeds: Iterable[int]
) -> dict[str, list[int]]:
    """Return the seeds of each task that have no row in a result. The arguments are those of
    `evaluate`.

    Raises
    ------
    PlateError
        If a task is unknown, or a seed is not allowed.
    """
    tasks = [tasks] if isinstance(tasks, str) else list(dict.fromkeys(tasks))
    for task in tasks:
        chosen("task", task, TASKS)
    seeds = [operator.index(seed) for seed in seeds]
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise PlateError(f"seeds are {seeds}, allowed: one or more different numbers, 0 or larger")
    done = {task: {row["seed"] for row in rows_of(result, task)} for task in tasks}
    return {task: [seed for seed in seeds if seed not in done[task]] for task in tasks}


def rows_of(result: dict[str, Any], task: str) -> list[dict[str, Any]]:
    """Return the rows of a task in a result. If the result does not contain the task, there are no
    rows."""
    rows: list[dict[str, Any]] = result["tasks"].get(task, {"rows": []})["rows"]
    return rows


def episodes(
    agent: str,
    world: str,
    task: str,
    seeds: list[int],
    workers: int,
    report: Callable[[str], None] = lambda text: None,
    limits: Limits = LIMITS,
    pool: Executor | None = None,
) -> Iterator[dict[str, Any]]:
    """Run episodes, and yield each row as soon as its episode has ended. The executor `pool` runs
    the episodes, if it is given. Otherwise, `workers` episodes run at the same time. Failed
    episodes are reported."""
    if pool is None and not workers:
        yield from map(partial(episode, agent, world, task), seeds)
        return
    # Threads are sufficient here, because each thread only waits for the process of an episode.
    shared = nullcontext(pool) if pool is not None else ThreadPoolExecutor(workers)
    with shared as threads:
        found = {threads.submit(isolated, agent, world, task, seed, limits): seed for seed in seeds}
        try:
            show(f"{task}: 0 of {len(seeds)}")
            for number, future in enumerate(as_completed(found), 1):
                try:
                    done = future.result()
                except PlateError as problem:
                    if str(problem).startswith(f"agent {agent}"):
                        raise
                    # a cluster does not know the episode whose agent has ended its workers
                    where = f"agent {agent}, {task}, seed {found[future]}"
                    raise PlateError(f"{where}: {problem}") from problem
                show(f"{task}: {number} of {len(seeds)}")
                if failure := done.get("failure"):
                    show("")
                    report(f"failed: {named(agent, task, done['seed'], done['steps'])}: {failure}")
                yield done
        except BaseException:
            for future in found:
                future.cancel()
            while wait(found, 0.1).not_done:
                isolation.stop()
            raise
        finally:
            show("")


def show(text: str) -> None:
    """Replace the last line of the terminal by the text `text`."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def check(
    result: Any,
    report: Callable[[str], None] = lambda text: None,
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
        Result of `evaluate`, as read from a JSON file.
    report : callable
        Function that is called with lines of text: the versions that differ on this machine, and
        the progress for each task.
    workers : int
        The same as in `evaluate`.
    fresh : int
        Number of additional random seeds of each task.
    world : str, optional
        World of the additional seeds. Default: the world of the result.
    trusted : str
        Name of an agent `MODULE:CLASS` whose code may be imported and run. If the result is from an
        agent `MODULE:CLASS` with another name, an error is raised.
    limits : Limits
        The same as in `evaluate`.

    Returns
    -------
    list of str
        Differences between the result and the repetition, except in computing times. If the
        additional seeds run in the world of the result, their success is also compared. The success
        counts as different if the two confidence intervals do not overlap. If the libraries of both
        machines round differently, the digest `places` differs too.

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
    report(f"agent {result['agent']}, commit {result['commit'] or 'unknown'}")
    differences = differences_here(result, limits)
    for text in differences[:MAX_OTHER]:
        report(text)
    if len(differences) > MAX_OTHER:
        report(f"{len(differences) - MAX_OTHER} more differences of versions and files")

    def run(task: str, world: str, seeds: list[int]) -> list[dict[str, Any]]:
        rows = episodes(agent, world, task, seeds, workers, report, limits)
        return sorted(rows, key=operator.itemgetter("seed"))

    # The seeds that are repeated must be unpredictable, so the generator has no fixed seed.
    wrong, rng = [], np.random.default_rng()
    for task, claimed in result["tasks"].items():
        rows = {row["seed"]: row for row in claimed["rows"]}
        report(f"{task}: the result has seeds {shortened(ranges(sorted(rows)))}")
        recomputed = summary(claimed["rows"])
        if {k: list(v) if isinstance(v, tuple) else v for k, v in recomputed.items()} != claimed:
            wrong.append(f"{task}: the summary does not match its rows")
        picks = sorted(rng.permutation(np.array(list(rows), object))[:CHECKED].tolist())
        played = run(task, result["world"], picks)
        for seed, true in zip(picks, played, strict=True):
            wrong += [
                f"{task}, seed {seed}: {key} is {rows[seed].get(key)!r} in the result, {value!r} "
                "here"
                for key, value in differing(rows[seed], true)
            ]
        took, took_here = recomputed["decision_ms"], summary(played)["decision_ms"]
        report(
            f"{task}: {len(picks)} seeds repeated, {len(wrong)} differences so far; {took:.3g} ms "
            f"per decision in the result, {took_here:.3g} ms here"
        )
        if fresh:
            seeds = [drawn(rng) for _ in range(fresh)]
            found = summary(run(task, world, seeds))
            report(f"{line(task, found)}, {world}, fresh seeds {ranges(sorted(seeds))}")
            low, high = found["success_interval"]
            low_again, high_again = recomputed["success_interval"]
            if world == result["world"] and (high < low_again or low > high_again):
                wrong.append(
                    f"{task}: success is {claimed['success']} in the result, {found['success']} "
                    "with fresh seeds"
                )
    return wrong


def differences_here(result: dict[str, Any], limits: Limits) -> list[str]:
    """Return a text for each difference between the versions, files and limits in a result and
    those on this computer."""
    agent = result["agent"]
    present = {"sources": sources(), "versions": versions(agent)}
    if "limits" in result:
        present |= {"limits": asdict(limits), "files": files(agent)}
    made, made_here = terms(result), terms(result | present)
    return [
        shortened(f"{name} is {made.get(name)} in the result, and {made_here.get(name)} here")
        for name in (made_here | made if "limits" in result else made)
        if made.get(name) != made_here.get(name)
    ]


def differing(claimed: dict[str, Any], true: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Compare two rows of the same episode, except their computing times. For each difference,
    yield the key and its value in the row `true`. If both rows have the key `failure` with the same
    value, they count as equal. The reason is that the step at which a limit is exceeded depends on
    the computer."""
    keys = ["failure"] if "failure" in true or "failure" in claimed else [*ROW]
    for key in keys:
        same = key in claimed and key in true if key == "failure" else claimed[key] == true[key]
        if key not in TIMES and not same:
            yield key, true.get(key)


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    args = arguments()
    try:
        limits = Limits(args.decision_limit, args.memory_limit)
        if args.check:
            wrong = check(
                read(args.check), partial(print, flush=True), args.workers, args.fresh or 0,
                args.world, args.trust or "", limits,
            )  # fmt: skip
            print("\n".join(wrong) or "the repeated seeds give the same result")
            return bool(wrong)
        evaluate_into_file(args, limits)
    except BrokenPipeError:
        raise
    except (PlateError, OSError) as error:
        # names of files can also come from another person
        print(f"error: {printable(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        kept = f"; {args.json} has the episodes so far" if args.json and args.json.is_file() else ""
        print(f"stopped{kept}", file=sys.stderr)
        return 130
    return 0


def arguments() -> argparse.Namespace:
    """Parse and check the command line. If it is wrong, end the program with a message."""
    parser = argparse.ArgumentParser(prog="python -m plate_gym.bench", description=__doc__)
    parser.add_argument(
        "--agent", help=f"agent: {', '.join(AGENTS)}, or MODULE:CLASS of a file (default: B)"
    )
    parser.add_argument(
        "--task",
        action="append",
        help=f"task: {', '.join(TASKS)} (default: all tasks); can be repeated",
    )
    parser.add_argument(
        "--seeds",
        type=seed_range,
        help="seeds FIRST to END - 1 as FIRST:END, or one seed (default: 0:100)",
    )
    parser.add_argument(
        "--world",
        help=f"simulated world: {', '.join(WORLDS)} (default: nominal; with --fresh the world of "
        "the result)",
    )
    parser.add_argument("--json", type=Path, help="JSON file for the result")
    parser.add_argument(
        "--workers",
        type=int,
        help="number of parallel processes (default: one per core); not with --cluster",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="address of a Dask scheduler, whose workers run the episodes",
    )
    parser.add_argument(
        "--check", type=Path, help="check the result in this file: repeat some of its seeds"
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
    options = ("agent", "task", "seeds", "json", "cluster", *(() if args.fresh else ("world",)))
    given = [f"--{name}" for name in options if getattr(args, name) is not None]
    if args.check and given:
        parser.error(
            f"{', '.join(given)} is given with --check, allowed: --workers, --trust, limits, "
            "--fresh "
            "and, with --fresh, --world"
        )
    if args.trust and not args.check:
        parser.error("--trust requires --check")
    if args.fresh is not None and not (args.check and 0 < args.fresh <= MAX_SEEDS):
        parser.error(f"--fresh is {args.fresh}, allowed: 1 to {MAX_SEEDS}, together with --check")
    if args.cluster and args.workers is not None:
        parser.error("--workers is given with --cluster, allowed: one of them")
    if args.workers is None:
        args.workers = os.cpu_count() or 1
    # at least one worker, because in this process an agent could end the program or falsify results
    if args.workers < 1:
        parser.error(f"--workers is {args.workers}, allowed: 1 or more")
    return args


def evaluate_into_file(args: argparse.Namespace, limits: Limits) -> None:
    """Evaluate the agent. Write the result to the file `--json` after each episode."""
    agent, world = args.agent or "B", args.world or "nominal"
    # The result file is opened before the runs. If the file cannot be written, the error appears
    # now and not after hours.
    with OwnFile(args.json) if args.json else nullcontext() as file:
        done = None
        if args.json and args.json.is_file() and args.json.stat().st_size:
            done = read(args.json)

        def keep(result: dict[str, Any]) -> None:
            if file is not None:
                file.write(json.dumps(result, indent=1) + "\n")

        # check the arguments before the program waits for the cluster
        tasks, seeds = args.task or list(TASKS), args.seeds or range(100)
        needed = missing(begun(agent, world, limits, done), tasks, seeds)
        pool: Any = nullcontext()
        if args.cluster and any(needed.values()):
            other = module_of(agent) if ":" in agent else ""
            if other and find_spec(other) is None:
                raise PlateError(
                    f"agent is {agent}: no module {other} in this folder ({Path.cwd()}) or on the "
                    "path"
                )
            pool = Cluster(args.cluster, modules=("plate_gym",), agent=other)
        with pool as shared:
            evaluate(
                agent, tasks, seeds, world, args.workers, partial(print, flush=True), keep, limits,
                shared, done,
            )  # fmt: skip


def interrupt_once(number: int, frame: Any) -> None:
    """Raise a KeyboardInterrupt, and ignore further signals SIGINT and SIGTERM. A second signal
    would interrupt the end of the workers. Then the program would wait for the limits of the
    agent."""
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, signal.SIG_IGN)
    raise KeyboardInterrupt


def seed_range(text: str) -> range:
    """Convert a text `FIRST:END`, or one number, to a range of seeds."""
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
    # The program restarts itself with the environment variables of `ALIKE`. Libraries read these
    # variables only at the start of a process.
    if not ALIKE.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | ALIKE)
    # SIGTERM has the same effect as Ctrl-C, so that the workers end.
    signal.signal(signal.SIGTERM, interrupt_once)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt_once)
    sys.exit(main())
