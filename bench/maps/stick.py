"""Fraction of a cycle in which a part sticks to the plate, by requested force and shaking ratio."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from maps.grid import Grid, StabilityMap, grid
from plate_core import Rig, load_rig
from plate_sim import simulate
from stages.scenes import wave_cycle

PERIOD_S = 0.05
CYCLES = 100
"""Number of cycles until the part's motion is periodic. The last cycle is evaluated."""

SAMPLES = 2000
"""Number of samples per cycle."""

RESTING = 1e-6
"""Slip that counts as rest, relative to the plate's maximum speed. Friction permits no creep."""

LEVEL = 0.005
"""Level of the map's border: fraction of a cycle in which the part sticks. A part with a smaller
fraction counts as always sliding."""

FORCES = np.linspace(0.0, 0.2, 11)
"""Requests [mu m g]. A motion of two harmonics along a line produces a force of at most 1/3 mu m
g."""

GAMMAS = np.geomspace(0.9, 8, 19)


def overtone(force: float) -> float:
    """Return b for which a plate with the velocity u ~ sin(wt) + b cos(2wt) exerts the mean force f
    on a resting part [mu m g].

    The force is the fraction of time with u > 0 minus the fraction with u < 0. With s = sin(wt),
    u = 0 where s + b (1 - 2 s^2) = 0. Hence s = -sin(pi f/2) and b = s/(2 s^2 - 1).
    """
    s = -np.sin(np.pi * force / 2)
    return float(s / (2 * s * s - 1))


def peak(b: float) -> float:
    """Return the maximum acceleration of u = sin(t) + b cos(2t)."""
    t = np.linspace(0, 2 * np.pi, 20_001)
    return float(np.max(np.abs(np.cos(t) - 2 * b * np.sin(2 * t))))


def min_gamma(force: float) -> float:
    """Return the shaking ratio above which a part never sticks.

    A part that never sticks gains the speed mu g T/2 in one half of the cycle and loses it in the
    other half. The plate is faster than the part in the first half and slower in the second. At
    each change from one half to the other both speeds are equal, so u(t + T/2) - u(t) = mu g T/2.
    Only the first harmonic of u, with the peak acceleration a_1, contributes to this difference.
    Hence sin(wt) = -(pi/2) mu g/a_1 at a change. The part does not stick if the plate's
    acceleration exceeds mu g at both changes. The condition at the second change is stricter:

        sqrt((a_1/mu g)^2 - (pi/2)^2) (1 - 2 pi b mu g/a_1) >= 1

    For b = 0 this is Den Hartog's Gamma = sqrt(1 + pi^2/4) = 1.862 for dry friction (Trans. ASME
    53, 1931). Gamma is the maximum acceleration of u divided by mu g.
    """
    b = overtone(force)

    def spare(first: float) -> float:
        rest = 1 - 2 * np.pi * b / first
        return float(np.sqrt(max(first**2 - (np.pi / 2) ** 2, 0.0)) * max(rest, 0.0) - 1)

    return float(brentq(spare, 1.5, 100.0)) * peak(b)


def resting_fraction(rig: Rig, force: float, gamma: float) -> float:
    """Simulate a part, and return the fraction of a cycle in which it sticks to the plate."""
    b, omega = overtone(force), 2 * np.pi / PERIOD_S
    speed = gamma * rig.friction.accel / (peak(b) * omega)
    cycle = wave_cycle(1 / PERIOD_S, np.array([speed, 0.0, 0.0]), b)
    at_rest, friction = np.zeros((1, 2)), rig.friction
    run = simulate(cycle, at_rest, at_rest, friction.mu, friction.gravity, CYCLES)
    last = simulate(
        cycle, at_rest, run.velocity[-1], friction.mu, friction.gravity, samples=SAMPLES,
        tolerance=1e-7,
    )  # fmt: skip
    slip = cycle.twist(last.time[:-1])[:, 0] - last.velocity[:-1, 0, 0]
    return float(np.mean(np.abs(slip) <= RESTING * speed))


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig = load_rig()
    forces, gammas = (FORCES[::5], GAMMAS[::3]) if quick else (FORCES, GAMMAS)
    z = [[resting_fraction(rig, f, gamma) for f in forces] for gamma in gammas]
    line = np.linspace(FORCES[0], FORCES[-1], 31)
    return [grid(forces, gammas, z, line, [min_gamma(f) for f in line])]


MAP = StabilityMap(
    key="stick",
    title="Sticking parts: request and shaking ratio, one part on a line",
    x_label="request: average force on a part at rest [mu mg]",
    y_label="shaking ratio Γ = a_max/(mu g) [-]",
    z_label="fraction of a cycle at rest [-]",
    line_label="the shaking ratio above which a part never sticks to the plate",
    level=LEVEL,
    measure=measure,
    bounds=(0.0, 1.0),
    log="y",
    finding="The average force is exact if the part never sticks to the plate. Larger requests "
    "need a higher shaking ratio.",
    note=f"The fraction is measured in the periodic state, after {CYCLES} cycles.",
)
