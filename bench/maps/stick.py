"""How long a part rests on the plate, by the size of the request and the shaking ratio."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from maps.grid import Grid, StabilityMap, grid
from plate_core import Rig, load_rig
from plate_sim import simulate
from stages.scenes import wave_cycle

PERIOD_S = 0.05
CYCLES = 100
"""Until the part is in its rhythm; the last one is judged."""

SAMPLES = 2000
"""Looks at a cycle."""

RESTING = 1e-6
"""Slip that counts as none, over the plate's greatest speed: friction never lets it creep."""

LEVEL = 0.005
"""Share of a cycle above which a part is said to rest at times."""

FORCES = np.linspace(0.0, 0.2, 11)
"""Requests [mu m g]: two harmonics along a line give up to 1/3."""

GAMMAS = np.geomspace(0.9, 8, 19)


def overtone(force: float) -> float:
    """Return b for which u ~ sin(wt) + b cos(2wt) gives a resting part an average force [mu m g].

    The force is the share of time in which u is above zero, less the rest. With s = sin(wt), u
    passes zero where s + b (1 - 2 s^2) = 0; hence s = -sin(pi f/2) and b = s/(2 s^2 - 1).
    """
    s = -np.sin(np.pi * force / 2)
    return float(s / (2 * s * s - 1))


def peak(b: float) -> float:
    """Return the greatest acceleration of u = sin(t) + b cos(2t)."""
    t = np.linspace(0, 2 * np.pi, 20_001)
    return float(np.max(np.abs(np.cos(t) - 2 * b * np.sin(2 * t))))


def least_gamma(force: float) -> float:
    """Return the shaking ratio above which a part never rests.

    A part that never rests gains mu g T/2 of speed in half a cycle, then loses it in the other: the
    plate is faster than the part in the first, slower in the second. At their joint the speeds are
    alike, so u(t + T/2) - u(t) = mu g T/2. Of u only the first harmonic counts there, with its
    acceleration a_1: sin(wt) = -(pi/2) mu g/a_1. The part does not come to rest if the plate's own
    acceleration exceeds mu g at both joints; the second one is the harder,

        sqrt((a_1/mu g)^2 - (pi/2)^2) (1 - 2 pi b mu g/a_1) >= 1

    For b = 0 that is Den Hartog's Gamma = sqrt(1 + pi^2/4) = 1.862 for dry friction (Trans. ASME
    53, 1931). Gamma is the greatest acceleration of all of u, over mu g.
    """
    b = overtone(force)

    def spare(first: float) -> float:
        rest = 1 - 2 * np.pi * b / first
        return float(np.sqrt(max(first**2 - (np.pi / 2) ** 2, 0.0)) * max(rest, 0.0) - 1)

    return float(brentq(spare, 1.5, 100.0)) * peak(b)


def resting_share(rig: Rig, force: float, gamma: float) -> float:
    """Return the share of a cycle that a part rests on the plate, by the simulator."""
    b, omega = overtone(force), 2 * np.pi / PERIOD_S
    speed = gamma * rig.friction.accel / (peak(b) * omega)
    cycle = wave_cycle(1 / PERIOD_S, np.array([speed, 0.0, 0.0]), b)
    none, friction = np.zeros((1, 2)), rig.friction
    run = simulate(cycle, none, none, friction.mu, friction.gravity, CYCLES)
    last = simulate(
        cycle, none, run.velocity[-1], friction.mu, friction.gravity, samples=SAMPLES,
        tolerance=1e-7,
    )  # fmt: skip
    slip = cycle.twist(last.time[:-1])[:, 0] - last.velocity[:-1, 0, 0]
    return float(np.mean(np.abs(slip) <= RESTING * speed))


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig = load_rig()
    forces, gammas = (FORCES[::5], GAMMAS[::3]) if quick else (FORCES, GAMMAS)
    z = [[resting_share(rig, f, gamma) for f in forces] for gamma in gammas]
    line = np.linspace(FORCES[0], FORCES[-1], 31)
    return [grid(forces, gammas, z, line, [least_gamma(f) for f in line])]


MAP = StabilityMap(
    key="stick",
    title="Parts at rest: request and shaking ratio, one part on a line",
    x_label="request: average force on a part at rest [mu mg]",
    y_label="shaking ratio Γ = a_max/(mu g) [-]",
    z_label="share of a cycle at rest [-]",
    line_label="theory: above it a part never rests",
    level=LEVEL,
    measure=measure,
    bounds=(0.0, 1.0),
    log="y",
    finding="The average force is exact if the part never rests. Larger requests need a higher "
    "shaking ratio.",
    note=f"Periodic state, after {CYCLES} cycles; border: {100 * LEVEL:g} % of the cycle.",
)
