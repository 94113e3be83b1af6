"""Tasks with images as of real cameras: tilt, parts with height, gloss, shadow, changing light.

About 200 runs take an hour on one core. An interrupted measurement continues where it stopped.
"""

from __future__ import annotations

from typing import Any

from harness import Cache, Result, Table
from plate_bringup.loop import Setup
from plate_core import load_rig
from plate_core.tasks import load_scenario
from tasks.runs import cached_runs, summarise

FIRST_SEED, SEEDS = 54_000, 10
"""First seed and number of seeds. No parameter was chosen by runs with these or larger seeds."""

SCENARIOS = ("sort_10", "follow_2", "sort_shapes")

PLAIN = "plain"

SCENES: dict[str, dict[str, str]] = {
    PLAIN: {},
    "tilt 25 sideways": {"camera_tilt_deg": "25", "camera_focal_px": "500"},
    "10 mm high, 0.43 m": {
        "camera_distance_m": "0.43", "camera_focal_px": "430", "rig_height_m": "0.01",
    },
    "gloss 0.25 r": {"gloss": "0.25"},
    "shadow 5 mm": {"shadows": "0.5", "shadow_length_m": "0.005", "penumbra_m": "0.0025"},
    "light 20 % down after 3 s": {"light_step": "-0.2", "light_step_s": "3"},
    "flicker 6 %": {"flicker": "0.06"},
}  # fmt: skip
"""Settings of `bench/closed_loop.py` for each scene, by name of the scene."""


def measure(quick: bool) -> Result:
    """Run all tasks in all scenes."""
    count = 1 if quick else SEEDS
    cases = {
        (name, scene): [
            (Setup(name, seed), settings, load_rig(load_scenario(name).rig))
            for seed in range(FIRST_SEED, FIRST_SEED + count)
        ]
        for name in SCENARIOS[: 1 if quick else None]
        for scene, settings in SCENES.items()
    }
    rows: list[dict[str, Any]] = []
    plain: dict[str, Any] = {}
    for (name, scene), runs in cached_runs(Cache.of(__name__), cases).items():
        row = {"scenario": name, "scene": scene} | summarise(runs)
        plain = row if scene == PLAIN else plain
        both_finished = row["time_s"] is not None and plain["time_s"] is not None
        row["longer_percent"] = (
            100 * (row["time_s"] / plain["time_s"] - 1) if both_finished else None
        )
        rows.append(row)
    return Result([Table.of("task_views", rows, seed=FIRST_SEED)])
