"""Cameras that run free: error against rate, exposure, latency and scatter.

Two parts at 40 mm/s, uneven friction; the planner knows neither the latency nor the scatter of the
stamps. A camera is good for the task where all runs end well and the median of their errors is at
most `ALLOWED_MM`: one value of it is changed at a time, until the border is passed.
"""

from __future__ import annotations

from harness import Cache, Result, Table
from plate_bringup.loop import Setup
from plate_core import load_rig
from tasks.runs import UNEVEN, runs_of, summed

USUAL = {"image_rate": 30.0, "exposure_s": 0.01, "latency": 0.04, "stamp_jitter": 0.005}
"""The camera where nothing else is said."""

VALUES = {
    "image_rate": (5.0, 7.5, 10.0, 12.0, 15.0, 20.0, 30.0, 60.0, 120.0),
    "exposure_s": (0.001, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    "latency": (0.0, 0.02, 0.04, 0.08, 0.12, 0.16, 0.24),
    "stamp_jitter": (0.0, 0.002, 0.005, 0.01, 0.015, 0.02),
}
"""What is changed, and to what."""

TRIGGERED = {"exposure_s": 0.001}
"""What free cameras are compared with: an image at the start of each cycle, with a true stamp."""

ALLOWED_MM = 0.2
"""Root mean square error up to which a camera is good for the task [mm]."""

FIRST_SEED, SEEDS = 82000, 5
"""Nothing was tuned on these seeds."""


def measure(quick: bool) -> Result:
    """Follow two rectangles with one camera after the other."""
    values, rig = {"image_rate": (30.0,)} if quick else VALUES, load_rig()
    cameras = {("triggered", 0.0): TRIGGERED} | {
        (changed, value): USUAL | {changed: value}
        for changed, many in values.items()
        for value in many
    }
    cases = {}
    for case, camera in cameras.items():
        settings = UNEVEN | {key: f"{value:g}" for key, value in camera.items()}
        seeds = range(FIRST_SEED, FIRST_SEED + SEEDS)
        cases[case] = [(Setup("follow_2", seed), settings, rig) for seed in seeds]
    rows = []
    for (changed, value), runs in runs_of(Cache.of(__name__), cases).items():
        found = summed(runs)
        kept = found["good"] == found["runs"] and found["rms_mm"] <= ALLOWED_MM
        rows.append({"changed": changed, "value": value, **found, "kept": kept})
    usual = ", ".join(f"{key} {value:g}" for key, value in USUAL.items())
    return Result([Table.of("cameras", rows, usual=usual)])
