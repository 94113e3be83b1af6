"""All measurements by their names, and functions that run them one after the other."""

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

CHAPTERS = {
    "stages": (
        "sim", "model", "trust", "bodies", "force_map", "solver",
        "options", "vision", "cameras", "stages", "learning",
        "friction", "stop_latency", "board", "latency", "graph",
    ),
    "maps": ("stability",),
    "tasks": (
        "tasks", "tracking", "rigs", "sameness", "free_running", "drives",
        "views", "serial", "lines", "closed_loop", "feeding", "feeding_hour",
    ),
}  # fmt: skip
"""Names of the measurements by folder of `bench`. Each name is a module with a function
`measure(quick)`. The first line of its docstring is printed when the measurement starts."""

MEASUREMENTS = {name: f"{chapter}.{name}" for chapter, names in CHAPTERS.items() for name in names}
"""Module of each measurement, by its name."""

LONG = {"feeding_hour", "sameness", "tasks", "views"}
"""Measurements that take hours. `bench/run.py` runs these measurements only if their names are
given."""

PUBLISHED = ROOT / "docs/results/measured.json"
"""File with facts about the measurements in docs/results, such as their duration."""

MAX_CORES = 0.3
"""Maximum number of CPU cores that other programs are allowed to use during timings."""


def run_all(names: Iterable[str], quick: bool, out: Path, when_idle: bool = False) -> list[str]:
    """Run measurements one after the other, print the progress, and write the result of each. If
    `when_idle` is True, each measurement waits until other programs are idle.

    If a measurement fails, the others still run. Return the names of the failed measurements.
    """
    names = list(names)
    failed: list[str] = []
    expected = [last_seconds(out, name, quick) for name in names]
    began = time.perf_counter()
    for number, name in enumerate(names, 1):
        left = sum(expected[number - 1 :])
        print(
            f"[{number}/{len(names)}, {minutes_text(time.perf_counter() - began)}"
            + (f", about {minutes_text(left)} left" if left else "")
            + f"] {name:12s} ",
            end="", flush=True,
        )  # fmt: skip
        code = code_of(MEASUREMENTS[name])
        try:
            module = importlib.import_module(MEASUREMENTS[name])
            about = (module.__doc__ or "").partition("\n")[0].removesuffix(".")
            print(f"{about} ... ", end="", flush=True)
            if when_idle:
                await_idle()
            start = time.perf_counter()
            result = module.measure(quick)
            seconds = time.perf_counter() - start
            write(out / f"{name}.json", name, about, quick, seconds, code, result)
        except Exception:  # after any error of a measurement, continue with the next measurement
            print("failed", flush=True)
            traceback.print_exc()
            failed.append(name)
            continue
        print(f"{seconds:.1f} s", flush=True)
    return failed


def report_failures(failed: list[str]) -> int:
    """Print the names of failed measurements. Return the exit code of the program: 1 if a
    measurement failed, otherwise 0."""
    if failed:
        print(f"error: failed measurements: {', '.join(failed)}", file=sys.stderr)
    return bool(failed)


def await_idle() -> None:
    """Wait until other programs use at most `MAX_CORES` CPU cores. Print a message if they use more
    at first."""
    has_printed = False
    while (cores := busy_cores()) > MAX_CORES:
        if not has_printed:
            print(
                f"waiting until other programs use fewer cores (now {cores:.1f}) ... ",
                end="",
                flush=True,
            )
        has_printed = True


def busy_cores() -> float:
    """Sleep for 1 s, and return the number of CPU cores that other programs used meanwhile."""
    before, start = idle_s(), time.monotonic()
    time.sleep(1.0)
    return (os.cpu_count() or 1) - (idle_s() - before) / (time.monotonic() - start)


def idle_s() -> float:
    """Return the sum of the idle times of all CPU cores since the computer started [s]."""
    cpu = Path("/proc/stat").read_text(encoding="ascii").split(maxsplit=6)
    return (int(cpu[4]) + int(cpu[5])) / os.sysconf("SC_CLK_TCK")


def last_seconds(out: Path, name: str, quick: bool) -> float:
    """Return the duration of the last measurement with the same value of `quick` [s], on this
    computer or for docs/results. 0 without such a measurement."""
    published = json.loads(PUBLISHED.read_text(encoding="utf-8"))["measurements"]
    result = (read(out, [name]) or published).get(name, {"quick": None})
    return float(result["seconds"]) if result["quick"] == quick else 0.0


def minutes_text(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{seconds // 60:.0f}:{seconds % 60:02.0f}"


def is_done(folder: Path, name: str, quick: bool) -> bool:
    """Whether a result of the current code exists. A quick result counts only if `quick` is
    True."""
    result = read(folder, [name]).get(name)
    code = code_of(MEASUREMENTS[name])
    return result is not None and result["quick"] <= quick and result.get("code") == code


def read(folder: Path, names: Iterable[str] = tuple(MEASUREMENTS)) -> dict[str, dict[str, Any]]:
    """Return the existing results of measurements, by name."""
    files = {name: folder / f"{name}.json" for name in names}
    return {
        name: json.loads(path.read_text(encoding="utf-8"))
        for name, path in files.items()
        if path.exists()
    }
