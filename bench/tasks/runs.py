"""What measurements of tasks share: many runs of the closed loop, kept, and summed up in a row."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from typing import Any

import numpy as np

from harness import Cache, resumed
from plate_bringup.loop import Setup, summary, with_settings
from plate_core import Rig

UNEVEN = {"friction_spread": "0.1", "friction_patches": "0.1"}
"""Friction differs by 10 % between parts and over the plate: settings of `bench/closed_loop.py`."""


def runs_of(
    pool: Executor, cache: Cache, rig: Rig, cases: Mapping[str, tuple[Setup, Mapping[str, str]]]
) -> list[dict[str, Any]]:
    """Return a row of `bench/closed_loop.py` for each case, from the cache or by running it.

    Parameters
    ----------
    cases : mapping of str to (setup, settings)
        By their keys in the cache.
    """
    work = {key: (with_settings(setup, settings), rig) for key, (setup, settings) in cases.items()}
    return resumed(pool, summary, work, cache)


def summed(runs: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one row for the runs of a case; None where there is nothing to sum up.

    Times of the task are simulated, of the runs that ended well; `most` and `worst` are of the
    worst run, everything else is a median over the runs.
    """
    runs = list(runs)
    good = [run for run in runs if run["success"]]

    def values(key: str, unit: float = 1.0, of: Iterable[Mapping[str, Any]] = runs) -> list[float]:
        return [unit * run[key] for run in of if run[key] is not None]

    times, rms = values("time_s", of=good), values("rms_error_m", 1e3)
    return {
        "runs": len(runs),
        "good": len(good),
        "succeeded": f"{len(good)} of {len(runs)}",
        "dropped": sum(run["dropped"] for run in runs),
        "time_s": median(times),
        "longest_s": max(times, default=None),
        "rms_mm": median(rms),
        "worst_rms_mm": max(rms, default=None),
        "max_mm": max(values("max_error_m", 1e3), default=None),
        "turn_deg": max(values("turn_error_deg"), default=None),
        "pace": median([run["pace"] for run in runs if run.get("pace") is not None]),
        "missed_percent": median(values("missed_share", 100)),
        "solve_ms": median(values("solve_ms_median")),
        "solve_p99_ms": median(values("solve_ms_p99")),
        "step_ms": median(values("step_ms_median")),
        "step_p99_ms": median(values("step_ms_p99")),
        "limit_percent": max(values("limit_share_max", 100)),
    }


def median(values: list[float]) -> float | None:
    """Return the median, None of nothing."""
    return float(np.median(values)) if values else None


def sentence(row: Mapping[str, Any]) -> str:
    """Sum up a row in a sentence."""
    told = [str(row[key]) for key in ("scenario", "method", "world") if key in row]
    succeeded = row.get("succeeded") or f"{row['good']} of {row['runs']}"
    text = f"{', '.join(told)}: {succeeded} ended well"
    if row["time_s"] is not None:
        text += f", {row['time_s']:.1f} s"
    if row.get("dropped"):
        text += f", {row['dropped']} parts dropped"
    if row["rms_mm"] is not None:
        text += f", RMS {row['rms_mm']:.2f} mm"
    return text + (f", {row['solve_ms']:.1f} ms a solve" if "solve_ms" in row else "")
