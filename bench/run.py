"""Measure every stage beside its best peer: out/bench/NAME.json and a short table.

python bench/run.py [NAME ...] [--quick]
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from digest import code_of
from harness import ROOT, text_table, write

MEASUREMENTS = {
    "sim": "Parts on a shaken plate: error and speed of the simulator",
    "bodies": "A disc that slides and turns: error and speed, beside scipy",
    "force_map": "Average friction over a cycle: time and error",
    "solver": "Plate motions for wanted average forces, from a cold start",
    "rotations": "Method A: guaranteed forces, least time, closure, order, displacements",
    "inversion": "Method B: starts, what is solved, what is proven out of reach",
    "steering": "Plate motions for wanted displacements on the true stick-slip cycle",
    "options": "Both methods with their options, and scipy, on the stick-slip cycle",
    "requests": "Requests: the force that parts really get, hostile ones, manipulability",
    "vision": "Finding discs in an image: time, misses, error of the centres",
    "camera": "The simulated camera: time for one image, error of the centres",
    "stages": "What each stage of the loop costs for one image",
    "identity": "Ids over whole sorts: swaps, parts named anew; noise of the drift",
    "tasks": "Every scenario over many seeds, and in worlds that are not as believed",
    "tracking": "1 to 6 parts on circles: tracking error against speed, fastest that is kept",
    "control": "The closed loop with more and less time for the solver",
    "learning": "Learning the plate: error of realised harmonics, new cycles in a row",
    "stability": "Stability maps: where methods fail, and where theory says so",
    "serial": "The serial path: tasks, accidents, noise, uploads, lateness",
    "lines": "Serial lines from slow to fast, bad and far: tables played, time to a stop",
    "stop_latency": "From the emergency_stop call to the wire, under floods of messages",
    "board": "The firmware on an emulated STM32F405: instructions a tick, steps between setpoints",
    "latency": "Image to motors in the real graph, beside one that only forwards",
    "closed_loop": "Whole tasks in the closed loop",
}
"""Names, each measured by `measure_NAME.py`, and what they are about."""

LONG = {"tasks"}
"""Hours: measured only by name."""

EXPECTED_S = {
    "sim": 160.0, "bodies": 25.0, "force_map": 20.0, "solver": 60.0, "rotations": 40.0,
    "inversion": 30.0,
    "steering": 20.0, "options": 90.0, "vision": 60.0, "stages": 60.0, "control": 180.0,
    "tracking": 360.0, "learning": 10.0,
}  # fmt: skip
"""How long those of the charts take where they have never been run: two cores of today [s]."""


def main() -> int:
    """Run the command line; returns its exit code."""
    args = arguments()
    unknown = [name for name in args.names if name not in MEASUREMENTS]
    if unknown:
        allowed = ", ".join(MEASUREMENTS)
        print(f"error: measurement is {unknown[0]!r}, allowed: {allowed}", file=sys.stderr)
        return 2
    names = args.names or [name for name in MEASUREMENTS if args.quick or name not in LONG]
    run_all(names, args.quick, args.out)
    for name in names:
        data = json.loads((args.out / f"{name}.json").read_text(encoding="utf-8"))
        print(f"\n== {name}: {data['about']}")
        for table in data["tables"]:
            print("\n".join(text_table(table)))
        for line in data["summary"]:
            print(f"  -> {line}")
    return 0


def run_all(names: Iterable[str], quick: bool, out: Path) -> None:
    """Run measurements one after the other; tells of each how far the work is, and writes it."""
    names = list(names)
    expected = {name: seconds for name in names if (seconds := last_seconds(out, name, quick))}
    began = time.perf_counter()
    for number, name in enumerate(names, 1):
        left = sum(expected.get(n, 0.0) for n in names[number - 1 :])
        print(
            f"[{number}/{len(names)}, {clock(time.perf_counter() - began)}"
            + (f", about {clock(left)} left" if left else "")
            + f"] {name:12s} {MEASUREMENTS[name]} ... ",
            end="", flush=True,
        )  # fmt: skip
        start = time.perf_counter()
        code = code_of(name)
        result = importlib.import_module(f"measure_{name}").measure(quick)
        seconds = time.perf_counter() - start
        write(out / f"{name}.json", name, MEASUREMENTS[name], quick, seconds, code, result)
        print(f"{seconds:.1f} s", flush=True)


def last_seconds(out: Path, name: str, quick: bool) -> float | None:
    """Return how long a measurement took the last time [s], if it was as thorough."""
    path = out / f"{name}.json"
    if path.exists():
        there = json.loads(path.read_text(encoding="utf-8"))
        if there["quick"] == quick:
            return float(there["seconds"])
    return None if quick else EXPECTED_S.get(name)


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{seconds // 60:.0f}:{seconds % 60:02.0f}"


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MEASUREMENTS))
    parser.add_argument("--quick", action="store_true", help="fewer cases: half a minute in all")
    parser.add_argument("--out", type=Path, default=ROOT / "out/bench", help="(out/bench)")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
