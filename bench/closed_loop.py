"""Run the closed loop without ROS for many seeds, and write one JSON row per run.

python bench/closed_loop.py --scenario sort_10 --seeds 0:20 --json out/bench/sort_10.json

A second call with the same file runs only the seeds that are missing in the file.
"""

from __future__ import annotations

import argparse
import hashlib
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from harness import Rows, cluster_option, executor, of_median, parallel, rate_text
from plate_bringup.cluster import Cluster
from plate_bringup.identity import code_of_packages, machine
from plate_bringup.loop import Setup, load_planner, summary, with_settings
from plate_core import PlateError, Rig, load_rig, piped
from plate_core.tasks import Scenario, load_scenario
from plate_planner import Planner
from tasks.runs import summarise

MAX_RUNS = 100_000
"""Maximum number of runs per call. A larger number of runs would take weeks."""


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    args = _parse_arguments()
    rows, code = Rows(None, {}), 2
    try:
        scenario = load_scenario(args.scenario)
        rig = load_rig(args.rig or scenario.rig)
        planner = Planner(rig, scenario)
        if planner.rules.endless:
            raise PlateError(
                f"scenario is {args.scenario}, whose task never ends, allowed: a task that ends "
                "(for a feeder use ros2 run plate_bringup qualify)"
            )
        settings = dict(_parse_setting(text) for text in args.set)
        if args.planner:
            load_planner(args.planner, rig)
        source = Path(args.planner).read_bytes() if args.planner else b""
        setup = with_settings(Setup(scenario, own_planner=args.planner), settings)
        marks = _result_metadata(scenario, rig, source, settings) if args.json else {}
        rows = Rows(args.json, marks)
        already_run = sum(seed in rows.by_seed for seed in args.seeds)
        missing = [seed for seed in args.seeds if seed not in rows.by_seed]
        work = [(replace(setup, seed=seed), rig, source) for seed in missing]
        with rows, _make_pool(args) if work else nullcontext() as workers:
            code = 1
            runs = f"{len(args.seeds)} run{'s' if len(args.seeds) > 1 else ''}"
            print(f"{args.scenario}, Gamma = {rig.gamma:.1f}, {runs}", flush=True)
            if already_run:
                print(f"{args.json} already contains {already_run} of these runs", flush=True)
            for warning in planner.warnings():
                print(f"warning: {warning}", flush=True)
            try:
                for row in _run_all(workers, work):
                    rows.add({**row, "scenario": args.scenario})
                    print(_row_text(row), flush=True)
            finally:
                rows.write()  # before the wait for the end of the workers
    except BrokenPipeError:
        raise
    except (PlateError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return code
    except KeyboardInterrupt:
        done = sum(seed in rows.by_seed for seed in args.seeds)
        kept = f" {args.json} contains them; the same command does the rest." if args.json else ""
        count = f" after {done} of {len(args.seeds)} runs.{kept}" if done else ""
        print(f"stopped{count}", file=sys.stderr)
        return 130
    print(_summary_text([rows.by_seed[seed] for seed in args.seeds]))
    return 0


def _make_pool(args: argparse.Namespace) -> AbstractContextManager[Executor | None]:
    """Return the executor of the runs: a cluster or a pool of processes. None if all runs use this
    process."""
    if args.cluster:
        return Cluster(args.cluster)
    return executor(args.workers) if args.workers > 1 else nullcontext()


def _run_all(workers: Executor | None, work: list[tuple[Setup, Rig, bytes]]) -> Iterator[dict]:
    """Yield the row of each run when it is done."""
    if workers is None:
        yield from (_run_loop(*item) for item in work)
    else:
        yield from (row for _, row in parallel(workers, _run_loop, work, _show_progress))


def _run_loop(setup: Setup, rig: Rig, code: bytes) -> dict[str, object]:
    """Run the loop and return its row. `code` is the content of the planner's file, because a
    worker on another computer cannot read this file. It is empty if the run uses the project's
    planner."""
    if not code:
        return summary(setup, rig)
    with TemporaryDirectory() as folder:
        path = Path(folder, Path(setup.own_planner).name)
        path.write_bytes(code)
        return summary(replace(setup, own_planner=str(path)), rig)


def _result_metadata(
    scenario: Scenario, rig: Rig, code: bytes, settings: dict[str, str]
) -> dict[str, str | dict[str, str]]:
    """Return all facts on which the result of a run depends, except its seed. These facts are the
    `marks` of `Rows`. They consist of digests of the code, scenario, rig and planner's file, of the
    settings, and of facts about the computer."""
    with np.printoptions(threshold=sys.maxsize, precision=17):
        parts = {"scenario": repr(replace(scenario, file="")), "rig": repr(rig)}
    marks = {name: hashlib.sha256(text.encode()).hexdigest()[:16] for name, text in parts.items()}
    if code:
        marks["planner"] = hashlib.sha256(code).hexdigest()[:16]
    return {"code": code_of_packages(), "settings": marks | settings, "machine": machine()}


def _show_progress(text: str) -> None:
    """Show the progress on a terminal. The next text overwrites the same line."""
    if sys.stderr.isatty():
        print(f"\r{text}\x1b[K", end="\r", file=sys.stderr, flush=True)


def _row_text(row: dict) -> str:
    # the error is 0 if parts can end at any position
    rms = f"  RMS {1e3 * row['rms_error_m']:.3f} mm" if row["rms_error_m"] else ""
    if row["turn_error_deg"] is not None:
        rms += f"  centre max {1e3 * row['max_error_m']:.3f} mm" if row["max_error_m"] else ""
        rms += f"  angle {row['turn_error_deg']:.2f} deg"
    remarks = "" if row["pace"] is None or row["pace"] > 0.995 else f"  pace {row['pace']:.2f}"
    remarks += "".join(
        f"  {row[k]} {k[:4]} cycles" for k in ("held_cycles", "late_cycles") if row[k]
    )
    return (
        f"seed {row['seed']:4d}  {'ok  ' if row['success'] else 'FAIL'}  {row['time_s']:6.1f} s"
        f"  dropped {row['dropped']}{rms}  missed {100 * row['missed_share']:.0f} %"
        f"  solve {row['solve_ms_median']:.1f} ms, p99 {row['solve_ms_p99']:.1f}{remarks}"
        + ("" if row["success"] else f"  {row['message']}")
    )


def _summary_text(rows: list[dict]) -> str:
    all_runs = summarise(rows)
    text = (
        f"{rate_text(all_runs['good'], len(rows))} ended well, {all_runs['dropped']} parts dropped"
    )
    if all_runs["good"]:
        low, high = of_median([row["time_s"] for row in rows if row["success"]])
        text += f"; time median {all_runs['time_s']:.1f} s ({low:.1f} to {high:.1f})"
        text += f", maximum {all_runs['longest_s']:.1f} s"
    if all_runs["rms_mm"]:
        text += (
            f"; RMS median {all_runs['rms_mm']:.3f} mm, maximum {all_runs['worst_rms_mm']:.3f} mm"
        )
    angles = [row["turn_error_deg"] for row in rows if row["turn_error_deg"] is not None]
    if angles:
        text += f"; angle error median {np.median(angles):.2f} deg, maximum {max(angles):.2f} deg"
        text += f"; centre error maximum {all_runs['max_mm']:.3f} mm" if all_runs["max_mm"] else ""
    return text


def _parse_setting(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals:
        raise PlateError(f"setting is {text!r}, allowed: key=value")
    return key, value


def _parse_seeds(text: str) -> range:
    first, colon, end = text.partition(":")
    try:
        seeds = range(int(first), int(end) if colon else int(first) + 1)
    except ValueError:
        seeds = range(0)
    if not seeds or seeds[0] < 0 or seeds[-1] - seeds[0] >= MAX_RUNS:
        raise argparse.ArgumentTypeError(
            f"seeds are {text!r}, allowed: one seed A, or a range A:B without B, with 0 <= A < B "
            f"and at most {MAX_RUNS} seeds"
        )
    return seeds


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--scenario",
        default="sort_10",
        help="name in config/scenarios, or .yaml file (default: sort_10)",
    )
    parser.add_argument(
        "--seeds",
        type=_parse_seeds,
        default=range(3),
        help="seeds A to B - 1 as A:B (default: 0:3)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a setting, such as method=rotations or latency=0.02; can be repeated",
    )
    parser.add_argument("--json", type=Path, help="JSON file for the results, one row per run")
    parser.add_argument(
        "--rig",
        default="",
        help="name in config/rigs, or .yaml file (default: the scenario's rig)",
    )
    parser.add_argument(
        "--planner",
        default="",
        help="Python file with a class OwnPlanner, which replaces the planner",
    )
    parser.add_argument(
        "--workers", type=int, default=1, help="number of parallel runs (default: 1)"
    )
    cluster_option(parser)
    args = parser.parse_args()
    if args.cluster and args.workers != 1:
        parser.error("--workers is given with --cluster, allowed: one of them")
    if args.workers < 1:
        parser.error(f"--workers is {args.workers}, allowed: 1 or more")
    return args


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the same as Ctrl-C
    sys.exit(main())
