"""Friction measured by pushes of the plate, compared with the simulated friction.

The plate pushes eight parts as the command `plate friction` does. Friction differs between the
parts and over the plate. The detector gets rendered images with noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from harness import Result, Table
from plate_core import PlateCycle, PlateError, Rig, load_rig
from plate_core.tasks import PartGroup, Scenario, load_scenario
from plate_driver.friction import FrictionMeasurement, FrictionResult, Rest
from plate_driver.setpoints import prepare
from plate_sim.world import Disturbances, Simulation
from plate_vision import Tracker, make_vision, observe

IMAGES, IMAGE_S = 4, 0.1
"""Number of images at rest after each push, and the time between two of them [s]."""

PLACES = [(x, y) for x in (-0.18, -0.06, 0.06, 0.18) for y in (-0.05, 0.05)]
"""Positions of the parts [m, plate_home]."""

WORLDS = (
    (0.15, 0.0, 0.0, 1.0), (0.15, 0.2, 0.0, 1.2), (0.25, 0.0, 0.0, 1.2), (0.25, 0.1, 0.0, 1.0),
    (0.25, 0.1, 0.1, 1.2), (0.25, 0.2, 0.2, 1.0), (0.4, 0.0, 0.0, 1.0), (0.4, 0.2, 0.0, 1.2),
    (0.6, 0.0, 0.0, 1.2), (0.6, 0.2, 0.0, 1.0),
)  # fmt: skip
"""Nominal mu, `friction_spread`, `friction_patches` and `static_ratio` of each simulated world."""

SEEDS = 2


def measure(quick: bool) -> Result:
    """Measure friction in all worlds."""
    rig = load_rig()
    worlds, seeds = (WORLDS[:2], 1) if quick else (WORLDS, SEEDS)
    rows = [row(rig, world, range(seeds)) for world in worlds]
    facts = {"parts": len(PLACES), "seeds": seeds, "rest_images": IMAGES}
    return Result([Table.of("friction", rows, **facts)], summary(rows))


def summary(rows: list[dict[str, Any]]) -> list[str]:
    """Return the largest errors over all worlds."""
    mean, ratio = (max(row[key] for row in rows) for key in ("mean_error", "ratio_error"))
    flat = [row["part_error"] for row in rows if not row["patchy"]]
    lines = [
        f"mean of {len(PLACES)} parts: within {100 * mean:.1f} %, for mu from {rows[0]['exact']:g} "
        f"to {max(row['exact'] for row in rows):g}",
        f"mu of each part: within {100 * max(flat):.1f} %",
        f"static divided by dynamic friction: within {ratio:.2f}",
    ]
    patchy = [row for row in rows if row["patchy"]]
    if patchy:
        lines[1] += (
            f", but {100 * max(row['part_error'] for row in patchy):.1f} % if mu varies over the "
            f"plate by {100 * max(row['patchy'] for row in patchy):.0f} % (standard deviation)"
        )
    return lines


def parts_at(places: Sequence[tuple[float, float]]) -> Scenario:
    """Return a scenario with round parts at these positions [m, plate_home]."""
    groups = (PartGroup("black", len(places), tuple(places)),)
    return replace(load_scenario("sort_4"), parts=groups)


def row(rig: Rig, world: tuple[float, ...], seeds: Sequence[int]) -> dict[str, Any]:
    """Return the means of true and measured values, and the maximum errors, over several seeds."""
    mu, spread, patches, static = world
    values = []
    for seed in seeds:
        unlike = Disturbances(friction_spread=spread, friction_patches=patches, static_ratio=static)
        found, true = measured(rig, parts_at(PLACES), seed, mu, unlike)
        exact = np.array([true[part.id] for part in found.parts])
        errors = np.array([part.mu for part in found.parts]) / exact - 1
        values.append(
            (np.mean(exact), found.mu, found.error, np.std(exact, ddof=1) / np.mean(exact),
             found.between_parts, found.over_plate, found.static_ratio, found.static_error,
             np.max(np.abs(errors)))
        )  # fmt: skip
    mean, maxima = np.mean(values, axis=0), np.max(values, axis=0)
    return {
        "exact": round(float(mean[0]), 4), "measured": f"{mean[1]:.4f} +- {mean[2]:.4f}",
        "worst": f"{100 * maxima[8]:.1f} %", "spread": f"{100 * mean[3]:.1f} %",
        "between": f"{100 * mean[4]:.1f} %", "patches": f"{100 * patches / np.sqrt(3):.1f} %",
        "over": f"{100 * mean[5]:.1f} %", "static": static,
        "ratio": f"{mean[6]:.2f} +- {mean[7]:.2f}",
        "mean_error": abs(mean[1] / mean[0] - 1), "part_error": maxima[8],
        "ratio_error": abs(mean[6] - static), "patchy": patches / np.sqrt(3),
    }  # fmt: skip


def measured(
    rig: Rig, scenario: Scenario, seed: int, mu: float, world: Disturbances
) -> tuple[FrictionResult, dict[str, float]]:
    """Return the measured friction, and the true mu of each part, averaged along its path.

    Raises
    ------
    PlateError
        If the measurement fails.
    """
    simulation = Simulation(rig, scenario, seed, world, mu_scale=mu / rig.friction.mu)
    vision, tracker, now = make_vision(rig), Tracker(), 0.0

    def track_image(tracker: Tracker, now: float) -> Tracker:
        image = simulation.capture()
        assert image is not None
        return observe(vision, tracker, image, now, None)

    def take_image(tracker: Tracker, now: float) -> tuple[Tracker, float, Rest]:
        images = []
        for _ in range(IMAGES):
            tracker = track_image(tracker, now)
            images.append(tracker.parts)
            simulation.run(PlateCycle.rest(IMAGE_S))
            now += IMAGE_S
        rest = Rest.of(images)
        if rest is None:
            raise PlateError("parts do not rest")
        return tracker, now, rest

    tracker, now, rest = take_image(tracker, now)
    measurement, true = FrictionMeasurement.start(rig, rest), []
    start = simulation.state.position
    # the detector and the simulation name the parts differently, so match them by position
    row_of = {
        name: int(np.argmin(np.hypot(*(start - position).T)))
        for name, position in rest.position.items()
    }
    while measurement.push is not None:
        table, _ = prepare(rig, measurement.push.cycle, round(1e9 * now))
        for motion in table.cycle.parts:
            tracker = track_image(tracker, now)
            simulation.run(motion)
            now += motion.period
        true.append(simulation.mu)
        tracker, now, rest = take_image(tracker, now)
        measurement = measurement.after(rest)
    mean = np.mean(true, axis=0)
    return measurement.result, {name: float(mean[number]) for name, number in row_of.items()}
