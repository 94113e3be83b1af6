"""A disc that slides and rotates: error and speed, compared with scipy.

The reference is scipy's DOP853 with a tight tolerance and friction integrated over the disc by the
midpoints of many cells. The baselines solve the same equations with fewer cells and looser
tolerances.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from harness import Result, Table, race
from plate_sim import simulate_bodies
from plate_sim.friction import disc
from stages.scenes import FREQUENCY, GRAVITY, MU, MU_G, SPIN, exact_cycle

RADIUS = 0.02
"""Radius of the disc [m]."""

GAMMA = 20
"""Peak acceleration of the plate divided by mu g."""

CYCLES = 6
"""Number of simulated cycles, 0.2 s."""

PLACE, SPEED, OMEGA = (0.05, 0.03), (0.08, -0.05), 6.0
"""Initial position [m], velocity [m/s] and spin [rad/s] of the disc."""

TRUE_CELLS, BASELINE_CELLS = (24, 48), (8, 16)
"""Numbers of rings of equal area and of cells per ring, for the reference and the baseline."""

STEPS_MS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02)
TOLERANCES = (1e-3, 1e-4, 1e-5)

PROJECT, BASELINE = "bodies", "scipy RK45"


def measure(quick: bool) -> Result:
    """Simulate the disc with several settings of the project's simulator and of scipy."""
    truth = integrate_with_scipy(TRUE_CELLS, "DOP853", 1e-5 if quick else 1e-8)
    cases = [(PROJECT, f"{ms:g} ms", partial(simulate_in_steps, ms)) for ms in STEPS_MS]
    for tolerance in TOLERANCES[:1] if quick else TOLERANCES:
        run = partial(integrate_with_scipy, BASELINE_CELLS, "RK45", tolerance)
        cases.append((BASELINE, f"rtol {tolerance:g}", run))
    rows = [
        {
            "method": method, "setting": setting, "error_mm": 1e3 * pose_distance(run(), truth),
            "speed": CYCLES / FREQUENCY / race({"": run}, 0.1).median(""),
        }
        for method, setting, run in cases
    ]  # fmt: skip
    return Result([Table.of("bodies", rows, span=CYCLES / FREQUENCY)])


def pose_distance(a: np.ndarray, other: np.ndarray) -> float:
    """Return the difference of two poses (3,) [m, m, rad] of the disc as a distance [m]. This is
    the distance of the centres or the distance of a point on the contour, whichever is larger."""
    x, y, angle = a - other
    return max(float(np.hypot(x, y)), RADIUS * abs(angle))


def simulate_in_steps(step_ms: float) -> np.ndarray:
    """Simulate the disc with plate_sim in steps [ms]. Return its final pose (3,) [m, m, rad]."""
    run = simulate_bodies(
        exact_cycle(GAMMA, SPIN), disc(RADIUS), np.array([PLACE]), 0, np.array([SPEED]), OMEGA, MU,
        GRAVITY, CYCLES, 1, 1e-3 * step_ms,
    )  # fmt: skip
    return np.append(run.position[-1, 0], run.angle[-1, 0])


def integrate_with_scipy(cells: tuple[int, int], method: str, tolerance: float) -> np.ndarray:
    """Integrate the equations of motion with scipy, with friction by midpoints of cells of equal
    area. Return the final pose (3,) [m, m, rad]."""
    cycle = exact_cycle(GAMMA, SPIN)
    rings, per_ring = cells
    ring = RADIUS * np.sqrt((np.arange(rings) + 0.5) / rings)
    angle = 2 * np.pi * (np.arange(per_ring) + 0.5) / per_ring
    x, y = np.outer(ring, np.cos(angle)).ravel(), np.outer(ring, np.sin(angle)).ravel()

    def state_derivative(t: float, state: np.ndarray) -> list[float]:
        now = np.array([t % cycle.period])
        pose, twist = cycle.pose(now)[0], cycle.twist(now)[0]
        px, py, _, vx, vy, spin = state
        ux = twist[0] - twist[2] * (py + y - pose[1]) - (vx - spin * y)
        uy = twist[1] + twist[2] * (px + x - pose[0]) - (vy + spin * x)
        size = np.maximum(np.hypot(ux, uy), 1e-9)  # the minimum of 1e-9 m/s avoids a division by 0
        fx, fy = ux / size, uy / size
        angular = MU_G * float(np.mean(x * fy - y * fx)) / (RADIUS**2 / 2)
        return [vx, vy, spin, MU_G * float(fx.mean()), MU_G * float(fy.mean()), angular]

    start = [*PLACE, 0.0, *SPEED, OMEGA]
    end = CYCLES / FREQUENCY
    found = solve_ivp(
        state_derivative, (0, end), start, method, [end], rtol=tolerance, atol=1e-3 * tolerance,
        max_step=0.1 / FREQUENCY,
    )  # fmt: skip
    return np.asarray(found.y[:3, -1])
