"""The averaged force map: equations (3) to (5) of the paper, with the parts' velocities inside.

    f(P) = 1/T integral of (v_s(P, t) - v_p) / |v_s(P, t) - v_p| dt,   v_s = (u1 - y u3, u2 + x u3)

in units of mu m g. The paper sets v_p = 0; friction also damps the part, so we keep it. The curl of
the field is the average of u3 / |v_s - v_p|, which is equation (11) where the plate turns about a
fixed centre.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from plate_core import PlateCycle, PlateError

SAMPLES = 1024
"""Samples a cycle on which a motion is corrected where all of it is sampled: enough for most dips;
`average_force` judges."""

TINY = 1e-12
"""Slip speed [m/s] below which the direction of friction is taken as none."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Gauss-Legendre rule of a panel, on [-1, 1]."""

FAR = 1.2
"""A panel is fine if the integrand's singularities, where the slip would be zero for a complex
time, are this many times its half length away: the rule then errs by (1.2 + 1.56)^-16 = 9e-8 of
the little that it holds."""

DEEPEST = 32
"""Halvings of a knot interval at most: what is left of a jump is 1e-9 of the interval."""


def average_force(
    cycle: PlateCycle, position: np.ndarray, velocity: np.ndarray | None = None
) -> np.ndarray:
    """Average friction over a cycle at parts held at a place or moving steadily.

    Parameters
    ----------
    cycle : PlateCycle
        The plate's motion.
    position : (M, 2)
        Parts [m], plate_home. The plate's own displacement is neglected, as in equation (3).
    velocity : (M, 2), optional
        Parts' velocities [m/s], zero if left out.

    Returns
    -------
    (M, 2)
        Average force [mu m g].

    Raises
    ------
    PlateError
        If shapes are wrong or values are not finite.
    """
    position = np.ascontiguousarray(position, dtype=float)
    velocity = (
        np.zeros_like(position) if velocity is None else np.ascontiguousarray(velocity, dtype=float)
    )
    if position.ndim != 2 or position.shape[1] != 2 or velocity.shape != position.shape:
        raise PlateError(
            f"position and velocity have shapes {position.shape} and {velocity.shape}, "
            "allowed: both (M, 2)"
        )
    for name, array in (("position", position), ("velocity", velocity)):
        if not np.all(np.isfinite(array)):
            raise PlateError(f"{name} has values that are not finite")
    force = np.empty_like(position)
    spline_force(cycle.times, cycle.coefficients, position, velocity, force)
    return force


@njit(cache=True, fastmath=True, error_model="numpy")
def spline_force(
    times: np.ndarray,
    coefficients: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
) -> None:
    """Write the average force (M, 2) [mu m g] of a spline motion, as `PlateCycle` holds it.

    Between knots the slip is a polynomial of degree 4, so Gauss-Legendre panels converge at once
    unless the slip is almost zero within: such panels are halved.
    """
    c = np.empty((5, 2))
    depth = np.empty(DEEPEST + 2, np.int64)
    for i in range(len(position)):
        x, y = position[i, 0], position[i, 1]
        fx = fy = 0.0
        for k in range(len(coefficients)):
            step = times[k + 1] - times[k]
            grow = 1.0
            for m in range(5):  # powers of the share of the interval
                u3 = (m + 1) * coefficients[k, m + 1, 2]
                c[m, 0] = grow * ((m + 1) * coefficients[k, m + 1, 0] - y * u3)
                c[m, 1] = grow * ((m + 1) * coefficients[k, m + 1, 1] + x * u3)
                grow *= step
            c[0, 0] -= velocity[i, 0]
            c[0, 1] -= velocity[i, 1]
            # Panels yet to do lie side by side to the right of `left`; the stack has their depths.
            left, waiting = 0.0, 1
            depth[0] = 0
            while waiting:
                level = depth[waiting - 1]
                half = 0.5**level / 2
                px, py, fine = _panel(c, left + half, half)
                if fine or level == DEEPEST:
                    fx += px * step
                    fy += py * step
                    left += 2 * half
                    waiting -= 1
                else:
                    depth[waiting - 1] = depth[waiting] = level + 1
                    waiting += 1
        force[i, 0] = fx / times[-1]
        force[i, 1] = fy / times[-1]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _panel(c: np.ndarray, middle: float, half: float) -> tuple[float, float, bool]:
    """Integrate the direction of a slip polynomial (5, 2) over a panel; whether that is fine."""
    fx = fy = 0.0
    fine = True
    for n in range(len(NODES)):
        s = middle + half * NODES[n]
        wx = wy = ax = ay = 0.0
        for m in range(4, -1, -1):
            ax, ay = ax * s + wx, ay * s + wy
            wx, wy = wx * s + c[m, 0], wy * s + c[m, 1]
        square = wx * wx + wy * wy
        if square > TINY * TINY:
            share = half * WEIGHTS[n] / sqrt(square)
            fx += share * wx
            fy += share * wy
            near = FAR * half
            fine = fine and square >= near * near * (ax * ax + ay * ay)
    return fx, fy, fine


@njit(cache=True, fastmath=True)
def mean_force(position: np.ndarray, velocity: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Average force (M, 2) [mu m g] over twist samples (n, 3) at the middles of equal steps."""
    force = np.zeros((len(position), 2))
    for i in range(len(position)):
        fx = fy = 0.0
        for k in range(len(twist)):
            dx = twist[k, 0] - twist[k, 2] * position[i, 1] - velocity[i, 0]
            dy = twist[k, 1] + twist[k, 2] * position[i, 0] - velocity[i, 1]
            d = sqrt(dx * dx + dy * dy)
            if d > TINY:
                fx += dx / d
                fy += dy / d
        force[i, 0] = fx / len(twist)
        force[i, 1] = fy / len(twist)
    return force


@njit(cache=True, fastmath=True)
def mean_force_gradient(
    position: np.ndarray, velocity: np.ndarray, twist: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Average force, curl, and their derivatives by the twist samples.

    Returns
    -------
    force : (M, 2)
        [mu m g].
    curl : (M,)
        Curl of the averaged field [mu m g / m].
    gradient : (3 M, n, 3)
        Rows: part 1 force x, force y, curl, part 2 ...; columns: sample, twist component.
    """
    count, n = len(position), len(twist)
    force = np.zeros((count, 2))
    curl = np.zeros(count)
    gradient = np.zeros((3 * count, n, 3))
    for i in range(count):
        x, y = position[i, 0], position[i, 1]
        for k in range(n):
            w = twist[k, 2]
            dx = twist[k, 0] - w * y - velocity[i, 0]
            dy = twist[k, 1] + w * x - velocity[i, 1]
            d = sqrt(dx * dx + dy * dy)
            if d <= TINY:
                continue
            ux, uy = dx / d, dy / d
            force[i, 0] += ux / n
            force[i, 1] += uy / n
            curl[i] += w / d / n
            xx = (1 - ux * ux) / d / n
            xy = -ux * uy / d / n
            yy = (1 - uy * uy) / d / n
            cx, cy = -w * ux / (d * d) / n, -w * uy / (d * d) / n
            gradient[3 * i, k, 0] = xx
            gradient[3 * i, k, 1] = xy
            gradient[3 * i, k, 2] = -y * xx + x * xy
            gradient[3 * i + 1, k, 0] = xy
            gradient[3 * i + 1, k, 1] = yy
            gradient[3 * i + 1, k, 2] = -y * xy + x * yy
            gradient[3 * i + 2, k, 0] = cx
            gradient[3 * i + 2, k, 1] = cy
            gradient[3 * i + 2, k, 2] = -y * cx + x * cy + 1 / d / n
    return force, curl, gradient
