"""Free-running cameras: error against rate, exposure, latency and jitter.

Two parts follow paths at 40 mm/s with uneven friction. The planner does not know the latency and
the jitter of the image stamps. A camera is sufficient if all runs succeed and the median of their
errors is at most `ALLOWED_MM`. Each series changes only one value of the default camera.
"""

from __future__ import annotations

from harness import Cache, Result, Table
from plate_bringup.loop import Setup
from plate_core import load_rig
from tasks.runs import UNEVEN, cached_runs, summarise

USUAL = {"image_rate": 30.0, "exposure_s": 0.01, "latency": 0.04, "stamp_jitter": 0.005}
"""Default values of the camera."""

VALUES = {
    "image_rate": (5.0, 7.5, 10.0, 12.0, 15.0, 20.0, 30.0, 60.0, 120.0),
    "exposure_s": (0.001, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    "latency": (0.0, 0.02, 0.04, 0.08, 0.12, 0.16, 0.24),
    "stamp_jitter": (0.0, 0.002, 0.005, 0.01, 0.015, 0.02),
}
"""Values of each varied parameter."""

TRIGGERED = {"exposure_s": 0.001}
"""Camera for comparison: it takes an image at the start of each cycle, with an exact stamp."""

ALLOWED_MM = 0.2
"""Maximum tracking error (root mean square) with a sufficient camera [mm]."""

FIRST_SEED, SEEDS = 82000, 5
"""First seed and number of seeds. No parameter was tuned with these seeds."""


def measure(quick: bool) -> Result:
    """Measure the tracking error of two parts that follow rectangles, for each setting of the
    camera."""
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
    for (changed, value), runs in cached_runs(Cache.of(__name__), cases).items():
        found = summarise(runs)
        kept = found["good"] == found["runs"] and found["rms_mm"] <= ALLOWED_MM
        rows.append({"changed": changed, "value": value, **found, "kept": kept})
    defaults = ", ".join(f"{key} {value:g}" for key, value in USUAL.items())
    return Result([Table.of("cameras", rows, usual=defaults)])
