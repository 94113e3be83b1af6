"""The averaged force map: equations (3) to (5) of the paper, with the parts' velocities inside.

    f(P) = 1/T integral of (v_s(P, t) - v_p) / |v_s(P, t) - v_p| dt,   v_s = (u1 - y u3, u2 + x u3)

in units of mu m g. The paper sets v_p = 0; friction also damps the part, so we keep it. The curl of
the field is the average of u3 / |v_s - v_p|, which is equation (11) where the plate turns about a
fixed centre.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
from numba import njit

from plate_core import PlateCycle, PlateError
from plate_core.kernels import SAME_ROUNDING, kernel

TINY_SQUARE = 1e-24
"""Squared slip [m2/s2] below which the direction of friction is taken as none."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Gauss-Legendre rule of a panel, on [-1, 1]."""

FAR = 1.2
"""A panel is fine if the integrand's singularities, where the slip would be zero for a complex
time, are this many times its half length away: the rule then errs by (1.2 + 1.56)^-16 = 9e-8 of
the little that it holds."""

DEEPEST = 32
"""Halvings of a piece at most: what is left of a jump is 1e-9 of the piece."""


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


def mean_direction(degree: int) -> Callable[[np.ndarray, float, np.ndarray], tuple[float, float]]:
    """Make the adaptive quadrature of slips that are polynomials in time, of one degree.

    Gauss-Legendre panels converge at once unless the slip is almost zero within: such panels are
    halved. The quadrature returns the mean direction of a slip, and takes

    slip : (degree + 1, 2)
        Powers of s, which runs from `first` to `first` + 1.
    first : float
    gradient : (3, degree + 1) or (0, 0)
        To it are added the derivatives by the powers, unless it is empty: d f_x / d slip_x,
        d f_x / d slip_y = d f_y / d slip_x, d f_y / d slip_y.
    """

    @njit(fastmath=True, error_model="numpy")
    def slopes(slip: np.ndarray, middle: float, half: float, gradient: np.ndarray) -> None:
        for n in range(len(NODES)):
            s = middle + half * NODES[n]
            wx = wy = 0.0
            for m in range(degree, -1, -1):
                wx, wy = wx * s + slip[m, 0], wy * s + slip[m, 1]
            square = wx * wx + wy * wy
            if square > TINY_SQUARE:
                inverse = 1 / sqrt(square)
                ux, uy, power = wx * inverse, wy * inverse, half * WEIGHTS[n] * inverse
                for m in range(degree + 1):
                    gradient[0, m] += power * uy * uy
                    gradient[1, m] -= power * ux * uy
                    gradient[2, m] += power * ux * ux
                    power *= s

    @njit(fastmath=True, error_model="numpy")
    def integrate(slip: np.ndarray, first: float, gradient: np.ndarray) -> tuple[float, float]:
        fx = fy = 0.0
        level, number, half = 0, 0, 0.5  # halvings, panels to the left, half the length
        while True:
            middle = first + (2 * number + 1) * half
            px = py = 0.0
            fine = True
            for n in range(len(NODES)):
                s = middle + half * NODES[n]
                wx = wy = ax = ay = 0.0
                for m in range(degree, -1, -1):
                    ax, ay = ax * s + wx, ay * s + wy
                    wx, wy = wx * s + slip[m, 0], wy * s + slip[m, 1]
                square = wx * wx + wy * wy
                if square > TINY_SQUARE:
                    weight = half * WEIGHTS[n] / sqrt(square)
                    px += weight * wx
                    py += weight * wy
                    near = FAR * half
                    fine = fine and square >= near * near * (ax * ax + ay * ay)
            if not fine and level < DEEPEST:
                level, number, half = level + 1, 2 * number, half / 2
                continue
            fx += px
            fy += py
            if len(gradient):
                slopes(slip, middle, half, gradient)
            number += 1
            while level > 0 and number % 2 == 0:
                level, number, half = level - 1, number // 2, half * 2
            if level == 0:
                return fx, fy

    return integrate


mean_direction_of_quartic = mean_direction(4)
"""For quintic splines: twists are their derivatives."""


@kernel(fastmath=True, error_model="numpy")
def spline_force(
    times: np.ndarray,
    coefficients: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
) -> None:
    """Write the average force (M, 2) [mu m g] of a spline motion, as `PlateCycle` holds it."""
    slip, none = np.empty((5, 2)), np.empty((0, 0))
    for i in range(len(position)):
        x, y = position[i, 0], position[i, 1]
        fx = fy = 0.0
        for k in range(len(coefficients)):
            step = times[k + 1] - times[k]
            grow = 1.0
            for m in range(5):  # powers of the fraction of the interval
                u3 = (m + 1) * coefficients[k, m + 1, 2]
                slip[m, 0] = grow * ((m + 1) * coefficients[k, m + 1, 0] - y * u3)
                slip[m, 1] = grow * ((m + 1) * coefficients[k, m + 1, 1] + x * u3)
                grow *= step
            slip[0, 0] -= velocity[i, 0]
            slip[0, 1] -= velocity[i, 1]
            px, py = mean_direction_of_quartic(slip, 0.0, none)
            fx += px * step
            fy += py * step
        force[i, 0] = fx / times[-1]
        force[i, 1] = fy / times[-1]


@kernel(fastmath=SAME_ROUNDING)
def step_forces(
    position: np.ndarray, velocity: np.ndarray, twist: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return force x, y [mu m g] and curl [mu m g / m] at each part, (M, 3), over steps.

    Parameters
    ----------
    position, velocity : (M, 2)
        Parts [m], [m/s], plate_home.
    twist : (n, 3)
        Plate at the middles of the steps.
    dt : (n,)
        Lengths of the steps, in any unit.
    """
    total = dt.sum()
    mean = np.zeros((len(position), 3))
    for i in range(len(position)):
        fx = fy = curl = 0.0
        for k in range(len(twist)):
            dx = twist[k, 0] - twist[k, 2] * position[i, 1] - velocity[i, 0]
            dy = twist[k, 1] + twist[k, 2] * position[i, 0] - velocity[i, 1]
            square = dx * dx + dy * dy
            weight = dt[k] / sqrt(square) if square > TINY_SQUARE else 0.0
            fx += weight * dx
            fy += weight * dy
            curl += weight * twist[k, 2]
        mean[i, 0], mean[i, 1], mean[i, 2] = fx / total, fy / total, curl / total
    return mean


@kernel(fastmath=SAME_ROUNDING)
def step_force_gradient(
    position: np.ndarray, velocity: np.ndarray, twist: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return the derivatives (3, n, 3 M) of `step_forces` by the twists.

    First the component of the twist; last part 1's force x, y and curl, part 2 ...
    """
    count, n = len(position), len(twist)
    total = dt.sum()
    gradient = np.zeros((3, n, 3 * count))
    for k in range(n):
        w, share = twist[k, 2], dt[k] / total
        for i in range(count):
            x, y = position[i, 0], position[i, 1]
            dx = twist[k, 0] - w * y - velocity[i, 0]
            dy = twist[k, 1] + w * x - velocity[i, 1]
            square = dx * dx + dy * dy
            if square <= TINY_SQUARE:
                continue
            inverse = 1 / sqrt(square)
            ux, uy, own = dx * inverse, dy * inverse, share * inverse
            curl = w * inverse
            by_u = (own * (1 - ux * ux), -own * ux * uy, -own * ux * curl)
            by_v = (-own * ux * uy, own * (1 - uy * uy), -own * uy * curl)
            for row in range(3):
                gradient[0, k, 3 * i + row] = by_u[row]
                gradient[1, k, 3 * i + row] = by_v[row]
                gradient[2, k, 3 * i + row] = x * by_v[row] - y * by_u[row]
            gradient[2, k, 3 * i + 2] += own
    return gradient
