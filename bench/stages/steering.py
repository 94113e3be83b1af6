"""Plate motions for requested displacements on the exact stick-slip cycle map.

Each scene is a short closed loop without camera and planner. The controller gets the true
positions, its cycle runs next, and `plate_sim` moves the parts. A random constant drift of each
part is requested.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import Result, Table, timed
from plate_core import Parts, PlateCycle, Rig, Wanted, load_rig
from plate_sim import simulate
from plate_solver import Controller
from stages.scenes import scatter

PARTS = (1, 2, 4, 6, 8, 10, 16, 24)
DRIFT = 0.005
"""Maximum requested drift of a part along each axis [m/s]."""

SCENES = 50

CYCLES = 6
"""Number of cycles of a scene. The first one is solved without a warm start."""

GOOD = 0.15
"""Maximum relative error of a request that counts as met, as in the controller."""


def measure(quick: bool) -> Result:
    """Run scenes for several numbers of parts by both methods."""
    rig = load_rig()
    rows = []
    for method in ("sinusoids", "rotations"):
        controller = Controller(rig, method)
        for parts in (2, 10) if quick else PARTS:
            rows.append(scenes_row(rig, controller, parts, 2 if quick else SCENES))
    return Result([Table.of("steering", rows, drift=1e3 * DRIFT, good=100 * GOOD)])


def scenes_row(rig: Rig, controller: Controller, parts: int, count: int) -> dict[str, Any]:
    """Run scenes with one number of parts, and return their row."""
    rng = np.random.default_rng(parts)
    scenes, period = [], 0.0
    for _ in range(count + 1):
        found, period = scene(rig, controller, scatter(rig, parts, rng), rng)
        scenes.append(found)
    ms, miss, own, ask = np.swapaxes(scenes[1:], 0, 1)  # the first scene was a warm-up

    def percent(what: np.ndarray, of: np.ndarray) -> float:
        return 100 * float(np.sqrt(np.sum(what**2) / np.sum(of**2)))

    return {
        "method": controller.method,
        "parts": parts,
        "period_s": period,
        "cold_ms": np.median(ms[:, 0]),
        "cold_p99_ms": np.percentile(ms[:, 0], 99),
        "cold_percent": percent(miss[:, 0], ask[:, 0]),
        "warm_ms": np.median(ms[:, 1:]),
        "warm_p99_ms": np.percentile(ms[:, 1:], 99),
        "missed_percent": percent(miss[:, 1:], ask[:, 1:]),
        "predicted_percent": percent(own, ask),
        "met_percent": 100 * float(np.mean(miss <= GOOD * ask)),
    }


def scene(
    rig: Rig, controller: Controller, position: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Move parts from rest.

    Returns
    -------
    found : (4, CYCLES)
        Time of each solution [ms], and root mean squares over parts and axes [m]: true error of the
        displacement, its error by the solver's prediction, and the requested displacement.
    period : float
        Period of the last solution [s].
    """
    controller.reset()
    drift = rng.uniform(-DRIFT, DRIFT, position.shape)
    velocity = np.zeros_like(position)
    running = PlateCycle.rest(0.1)
    milliseconds, missed, predicted, requested = [], [], [], []
    ids = tuple(f"black_{i}" for i in range(len(position)))
    for number in range(CYCLES + 1):
        request = Wanted.make(Parts.make(ids, position, drift))
        answer, seconds = timed(controller.answer, request, running)
        milliseconds.append(1e3 * seconds)
        run = simulate(running, position, velocity, rig.friction.mu, rig.friction.gravity)
        if number:
            way = drift * running.period
            error = way - (run.position[-1] - position)
            missed.append(float(np.sqrt(np.mean(error**2))))
            requested.append(float(np.sqrt(np.mean(way**2))))
        if number < CYCLES:
            predicted.append(answer.error_m)
        position, velocity, running = run.position[-1], run.velocity[-1], answer.cycle
    return np.array([milliseconds[:CYCLES], missed, predicted, requested]), running.period
