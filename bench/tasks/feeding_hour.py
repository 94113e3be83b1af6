"""An hour of production: parts lost, stops, memory.

The hour is one run. The disturbances of this run are failed picks, parts on the wrong face, and
late and missing images. The run is good if no part is lost, production does not stop, and memory
does not grow.
"""

from __future__ import annotations

import os
from typing import Any

from graph.proc import memory_mb

from harness import Result, Table
from plate_bringup.loop import Setup
from plate_bringup.production import FeederCell, Production, filled, produce
from plate_core.tasks import load_scenario
from plate_sim import Disturbances

RECIPE = "feed"
"""Recipe. One part in ten is grey, which represents a part with the wrong face up. Such a part must
leave through the chute."""

FILL = 15
"""Number of parts on the plate."""

CYCLE_S = 2.0
"""Robot's cycle [s]."""

SEED = 61_000
"""Random seed."""

WORLD = Disturbances(
    pick_failure=0.05,
    latency=0.04,
    missed_images=0.05,
    friction_spread=0.1,
    friction_patches=0.1,
)
"""Disturbances: failed picks, late images, missing images, and friction that varies between parts
and over the plate."""

EVERY_S, HOUR_S, QUICK_S = 300.0, 3600.0, 20.0
"""Time between two rows of the result, duration of the production, and duration of a quick
production [s]."""


def measure(quick: bool) -> Result:
    """Produce for an hour."""
    time_s, every_s = (QUICK_S, QUICK_S / 2) if quick else (HOUR_S, EVERY_S)
    rows: list[dict[str, Any]] = []

    def record_cell(cell: FeederCell) -> None:
        if cell.simulation is not None and cell.tally.time_s >= every_s * (len(rows) + 1):
            task = cell.feeder.task
            rows.append(row(Production.of(cell.tally, cell.robot, cell.simulation, task), cell))
            print(f"{cell.tally.time_s / 60:.0f} min ... ", end="", flush=True)

    setup = Setup(filled(load_scenario(RECIPE), FILL), SEED, disturbances=WORLD)
    found = produce(setup, CYCLE_S, time_s, note=record_cell)
    text = (
        f"{found.picks} parts in {time_s / 60:g} minutes, {found.failed} picks failed, "
        f"{found.discharged} to the chute, {found.lost} lost; the robot waited "
        f"{100 * found.waiting:.1f} % and was refused a part {len(found.refused)} times; memory "
        f"{rows[0]['rss_mb']:.0f} MB after {rows[0]['minute']:.1f} minutes, "
        f"{rows[-1]['rss_mb']:.0f} MB at the end"
    )
    facts = {"recipe": RECIPE, "fill": FILL, "cycle": CYCLE_S, "seed": SEED}
    table = Table.of("feeding_hour", rows, **facts)
    return Result([table], [text, *dict.fromkeys(found.refused)])


def row(now: Production, cell: FeederCell) -> dict[str, Any]:
    """Return the row of the result for the current time."""
    return {
        "minute": cell.tally.time_s / 60, "picks": now.picks, "failed": now.failed,
        "waiting": 100 * now.waiting, "discharged": now.discharged, "lost": now.lost,
        "error_95_mm": now.error_mm[1], "error_most_mm": now.error_mm[2],
        "refused": len(now.refused), "rss_mb": memory_mb(os.getpid()),
    }  # fmt: skip
