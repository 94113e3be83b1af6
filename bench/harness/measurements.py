"""Every measurement by its name, and how they are run one after the other."""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from harness.cache import code_of
from harness.result import ROOT, write

ABOUT = {
    "stages": {
        "sim": "Parts on a shaken plate: error and speed of the simulator",
        "model": "The model of parts: cost and error by scene, beside the judge and pymunk",
        "trust": "Creep beside the peers, what is left out, other laws of friction",
        "bodies": "A disc that slides and turns: error and speed, beside scipy",
        "force_map": "Average friction over a cycle: time and error",
        "solver": "Plate motions for wanted average forces, from a cold start",
        "rotations": "Method A: guaranteed forces, least time, closure",
        "inversion": "Method B: what is solved, what is proven out of reach",
        "steering": "Plate motions for wanted displacements on the true stick-slip cycle",
        "options": "Both methods with their options, and scipy, on the stick-slip cycle",
        "vision": "Finding discs in an image: time, misses, error of the centres",
        "classes": "Types of parts: names, centres and angles",
        "shapes": "Parts of any outline in hostile scenes: recall, precision, centres, time",
        "stages": "What each stage of the loop costs for one image",
        "learning": "Learning the plate: error of realised harmonics",
        "stop_latency": "From the emergency_stop call to the wire, under floods of messages",
        "board": "The firmware on an emulated STM32F405: instructions a tick, longest steps",
        "latency": "Image to motors in the real graph, beside one that only forwards",
        "graph": "Faults, malformed messages, goals at random and minutes in the real graph",
        "page": "The live page beside the graph: latency, processor time, targets that are dragged",
    },
    "maps": {
        "stability": "Stability maps: where methods fail, and where theory says so",
    },
    "tasks": {
        "tasks": "Every scenario over many seeds, and in worlds that are not as believed",
        "tracking": "1 to 6 parts on circles: tracking error against speed, fastest that is kept",
        "bound": "How fast 1 to 10 parts can be moved: bounds, global search, closed loop",
        "rigs": "Small and weak rigs: success, time, error, and what `feasible` said",
        "sizing": "Number of parts: time, parts dropped",
        "sameness": "One seed, one answer: what changes a run, to the last bit",
        "free_running": "Cameras that run free: error against rate, exposure, latency and scatter",
        "drives": "Drives on a bus: error against latency, jitter and the drives' own loop",
        "control": "The closed loop with more and less time for the solver",
        "serial": "The serial path: a short task, and faults of the line",
        "lines": "Serial lines from slow to fast, bad and far: tables played, time to a stop",
        "closed_loop": "Whole tasks in the closed loop, many seeds: the table of README",
        "feeding": "A feeder in production beside peers that shake and look: speed, accuracy",
        "feeding_hour": "An hour of production: parts lost, stops, memory",
    },
}
"""Chapter of this folder -> its modules with `measure(quick)`, and what they are about."""

MEASUREMENTS = {
    name: (f"{chapter}.{name}", about)
    for chapter, modules in ABOUT.items()
    for name, about in modules.items()
}
"""Name -> module and what it is about."""

LONG = {"feeding_hour", "sameness", "tasks"}
"""Hours: measured only by name."""

PUBLISHED = ROOT / "docs/results/measured.json"
"""Of the charts that are in docs/results: how long each measurement took, among others."""

MOST_CORES = 0.3
"""That other programs may take while timings are measured."""


def run_all(names: Iterable[str], quick: bool, out: Path, quiet: bool = False) -> list[str]:
    """Run measurements one after the other; tells of each how far the work is, and writes it. If
    `quiet` each waits until other programs rest.

    One that fails does not hold up the others; returns the names of those that have failed.
    """
    names = list(names)
    failed: list[str] = []
    expected = [last_seconds(out, name, quick) for name in names]
    began = time.perf_counter()
    for number, name in enumerate(names, 1):
        module, about = MEASUREMENTS[name]
        left = sum(expected[number - 1 :])
        print(
            f"[{number}/{len(names)}, {clock(time.perf_counter() - began)}"
            + (f", about {clock(left)} left" if left else "")
            + f"] {name:12s} {about} ... ",
            end="", flush=True,
        )  # fmt: skip
        if quiet:
            await_quiet()
        start = time.perf_counter()
        code = code_of(module)
        try:
            result = importlib.import_module(module).measure(quick)
        except Exception:  # whatever it is, the others are still measured
            print("failed", flush=True)
            traceback.print_exc()
            failed.append(name)
            continue
        seconds = time.perf_counter() - start
        write(out / f"{name}.json", name, about, quick, seconds, code, result)
        print(f"{seconds:.1f} s", flush=True)
    return failed


def told(failed: list[str]) -> int:
    """Name at the end the measurements that have failed; returns the exit code of the program."""
    if failed:
        print(f"error: measurements that failed: {', '.join(failed)}", file=sys.stderr)
    return bool(failed)


def await_quiet() -> None:
    """Wait until other programs take less than `MOST_CORES`; says that it does."""
    told = False
    while (cores := busy_cores()) > MOST_CORES:
        if not told:
            print(
                f"waits for other programs, which take {cores:.1f} cores ... ", end="", flush=True
            )
        told = True


def busy_cores() -> float:
    """Return how many cores other programs take, for a second in which we rest."""
    before, start = idle_s(), time.monotonic()
    time.sleep(1.0)
    return (os.cpu_count() or 1) - (idle_s() - before) / (time.monotonic() - start)


def idle_s() -> float:
    """Return for how long the cores have had nothing to do, all together [s]."""
    cpu = Path("/proc/stat").read_text(encoding="ascii").split(maxsplit=6)
    return (int(cpu[4]) + int(cpu[5])) / os.sysconf("SC_CLK_TCK")


def last_seconds(out: Path, name: str, quick: bool) -> float:
    """Return how long a measurement took the last time [s], if it was as thorough: here, or for
    docs/results; else 0."""
    published = json.loads(PUBLISHED.read_text(encoding="utf-8"))["measurements"]
    there = (read(out, [name]) or published).get(name, {"quick": None})
    return float(there["seconds"]) if there["quick"] == quick else 0.0


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{seconds // 60:.0f}:{seconds % 60:02.0f}"


def is_done(folder: Path, name: str, quick: bool) -> bool:
    """Whether a measurement is there, at least as thorough as wanted, of the code as it is."""
    there = read(folder, [name]).get(name)
    code = code_of(MEASUREMENTS[name][0])
    return there is not None and there["quick"] <= quick and there.get("code") == code


def read(folder: Path, names: Iterable[str] = tuple(MEASUREMENTS)) -> dict[str, dict[str, Any]]:
    """Read measurements that are there, by name."""
    files = {name: folder / f"{name}.json" for name in names}
    return {
        name: json.loads(path.read_text(encoding="utf-8"))
        for name, path in files.items()
        if path.exists()
    }
