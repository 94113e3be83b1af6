"""Cameras that run free: the tracking error against rate, exposure and latency of the images.

Two parts at 40 mm/s, stamps that scatter, uneven friction; the planner knows neither the latency
nor the scatter. A run has failed where it ends badly or errs more than `ALLOWED_MM`: one value of
the camera is changed at a time, until the border is passed.
"""

from __future__ import annotations

from harness import Cache, Result, Table, processes
from harness.loop import Setup
from plate_core import load_rig
from tasks.runs import UNEVEN, runs_of, summed

USUAL = {"image_rate": 30.0, "exposure_s": 0.01, "latency": 0.04, "stamp_jitter": 0.005}
"""The camera where nothing else is said; 0 images a second: triggered."""

VALUES = {
    "image_rate": (0.0, 5.0, 7.5, 10.0, 15.0, 30.0, 60.0, 120.0),
    "exposure_s": (0.001, 0.005, 0.01, 0.02, 0.033),
    "latency": (0.0, 0.02, 0.04, 0.08, 0.12, 0.16),
    "stamp_jitter": (0.0, 0.002, 0.005, 0.01, 0.02),
}
"""What is changed, and to what."""

TRIGGERED = {"image_rate": 0.0, "exposure_s": 0.001, "latency": 0.0, "stamp_jitter": 0.0}
"""What free cameras are compared with."""

ALLOWED_MM = 0.2
"""Root mean square error up to which a camera is good for the task [mm]."""

SEEDS = 2

COLUMNS = {
    "changed": "changed", "value": "to", "succeeded": "succeeded",
    "rms_mm": "RMS error, median [mm]",
    "worst_rms_mm": "of the worst run [mm]", "pace": "pace", "kept": "kept",
}  # fmt: skip


def measure(quick: bool) -> Result:
    """Follow two rectangles with one camera after the other."""
    cache = Cache.of(__name__)
    values = {"image_rate": (0.0, 30.0)} if quick else VALUES
    kinds = [(changed, value) for changed, many in values.items() for value in many]
    cases = {
        f"{changed} {value:g} {seed}": (Setup("follow_2", seed), settings(changed, value))
        for changed, value in kinds
        for seed in range(SEEDS)
    }
    with processes() as pool:
        done = iter(runs_of(pool, cache, load_rig(), cases))
    rows = []
    for changed, value in kinds:
        row = {"changed": changed, "value": value, **summed([next(done) for _ in range(SEEDS)])}
        rows.append({key: row.get(key) for key in COLUMNS} | {"kept": kept(row)})
    note = ", ".join(f"{key} {value:g}" for key, value in USUAL.items())
    return Result(
        [Table("cameras", "Cameras that run free", COLUMNS, rows, f"Where not changed: {note}.")],
        [
            f"{changed}: kept at "
            + ", ".join(
                f"{row['value']:g}" for row in rows if row["changed"] == changed and row["kept"]
            )
            for changed in values
        ],
    )


def settings(changed: str, value: float) -> dict[str, str]:
    """Return the settings of `bench/closed_loop.py` for one camera."""
    camera = USUAL | {changed: value}
    return UNEVEN | {
        key: str(each) for key, each in (camera if camera["image_rate"] else TRIGGERED).items()
    }


def kept(row: dict[str, object]) -> bool:
    """Whether all runs of a camera ended well and kept the error."""
    return row["good"] == row["runs"] and float(str(row["rms_mm"])) <= ALLOWED_MM
