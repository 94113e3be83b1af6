"""Error of averaged forces on moving parts, by shaking ratio and number of parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from maps.grid import Grid, StabilityMap, grid
from plate_core import PlateCycle, Rig, load_rig
from plate_sim import simulate
from plate_solver import SinusoidSolver, average_force
from stages.scenes import random_positions

PARTS = (1, 2, 3, 4, 6, 8)
GAMMAS = np.geomspace(5, 1280, 13)
FORCE = 0.1
"""Maximum component of a request [mu m g]."""

REQUESTS = 8
"""Number of random requests for each number of parts."""

SEED = 83
SHORT_S = 0.001
"""Length of a cycle [s]. Averaged forces also neglect the plate's displacement. In such a short
cycle this displacement causes no error. The accuracy of averaged forces depends on the shaking
ratio, but not on the length of a cycle."""

FREE_M, FREE_MPS = 1.0, 100.0
"""Limits of stroke [m] and speed [m/s], so large that they limit no motion."""

SAMPLES = 4096

TOLERANCE = 1e-4
"""Tolerance of the simulated displacement, relative to mu g T^2 with the length T of a cycle."""

LEVEL = 0.3
"""Level of the map's border: error of the force, relative to the request."""


def make_motions(rig: Rig, parts: int, count: int) -> list[tuple[PlateCycle, np.ndarray, float]]:
    """For each random request, return a motion, the parts' positions (M, 2) [m], and its size [mu m
    g].

    Each motion meets its request on average. The motion is then scaled to a shaking ratio of 1. The
    size of a request is the root mean square of its components.
    """
    limits = replace(rig.limits, stroke_m=FREE_M, speed=FREE_MPS)
    free = replace(rig, limits=limits)
    solver = SinusoidSolver(free, period=SHORT_S, restarts=20)
    rng, found = np.random.default_rng([SEED, parts]), []
    for _ in range(count):
        position, force = random_positions(rig, parts, rng), rng.uniform(-FORCE, FORCE, (parts, 2))
        solver.reset()
        cycle = solver.solve(position, force).cycle.scaled(1 / rig.gamma)
        found.append((cycle, position, float(np.sqrt(np.mean(force**2)))))
    return found


def simulate_force_error(rig: Rig, cycle: PlateCycle, position: np.ndarray) -> float:
    """Return the root mean square difference between the simulated and the averaged force [mu m g].
    The parts are at rest at first."""
    still, friction = np.zeros_like(position), rig.friction
    unit = friction.accel * cycle.period**2
    run = simulate(
        cycle, position, still, friction.mu, friction.gravity, tolerance=TOLERANCE * unit
    )
    got = run.velocity[-1] / (friction.accel * cycle.period)
    return float(np.sqrt(np.mean((got - average_force(cycle, position)) ** 2)))


def predict_force_error(rig: Rig, cycle: PlateCycle, position: np.ndarray) -> float:
    """Return the theoretical value of `simulate_force_error`, for a large shaking ratio Gamma.

    A held part does not move; only friction moves a free part. Let w(t) be the slip velocity of
    a held part, and n(t) the direction of w(t). Until t, a free part gains the velocity

        v(t) = mu g (integral of n from 0 to t)

    This velocity changes the direction of the free part's slip by -(v - (n.v) n)/|w|. The mean of
    this change over the cycle is the error of the averaged force. For the harmonic h of a cycle
    with the length T, |w| is about Gamma mu g T/(2 pi h), so the error is about 2 pi h/Gamma.
    """
    t = (np.arange(SAMPLES) + 0.5) * cycle.period / SAMPLES
    twist, missed = cycle.twist(t), []
    for x, y in position:
        slip = np.column_stack([twist[:, 0] - y * twist[:, 2], twist[:, 1] + x * twist[:, 2]])
        size = np.hypot(*slip.T)[:, None]
        n = slip / size
        gained = rig.friction.accel * np.cumsum(n, axis=0) * cycle.period / SAMPLES
        across = gained - np.sum(n * gained, axis=1, keepdims=True) * n
        missed.append(np.mean(across / size, axis=0))
    return float(np.sqrt(np.mean(np.square(missed))))


def min_gamma(rig: Rig, cases: list[tuple[PlateCycle, np.ndarray, float]]) -> float:
    """Return the shaking ratio above which the error of the averaged forces is below `LEVEL`. This
    ratio is the median over the cases, by the theory of `predict_force_error`."""
    return (
        float(np.median([predict_force_error(rig, c, p) / requested for c, p, requested in cases]))
        / LEVEL
    )


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig = load_rig()
    parts, gammas = (PARTS[1:4:2], GAMMAS[::3]) if quick else (PARTS, GAMMAS)
    cases = [make_motions(rig, m, 3 if quick else REQUESTS) for m in parts]
    z = [
        [
            float(
                np.median(
                    [
                        simulate_force_error(rig, c.scaled(gamma), p) / requested
                        for c, p, requested in of_gamma_cases
                    ]
                )
            )
            for of_gamma_cases in cases
        ]
        for gamma in gammas
    ]
    return [
        grid(parts, gammas, z, parts, [min_gamma(rig, of_gamma_cases) for of_gamma_cases in cases])
    ]


MAP = StabilityMap(
    key="gamma",
    title="Error of average forces: shaking ratio and number of parts",
    x_label="parts",
    y_label="shaking ratio Γ = a_max/(mu g) [-]",
    z_label="force error divided by requested force [-]",
    line_label="the error due to the velocity that parts gain within a cycle, to first order in "
    f"1/Γ, is {LEVEL:g}",
    level=LEVEL,
    measure=measure,
    bounds=(0.0, 1.5),
    log="y",
    steps=True,
    finding="The average force neglects the velocity of the parts. Therefore it is wrong unless "
    "the shaking ratio is much higher than a rig can reach.",
    note=f"Parts start at rest. Values are medians of {REQUESTS} "
    f"random requests up to {FORCE:g} mu mg on each axis. The default rig has Γ = 40.8.",
)
