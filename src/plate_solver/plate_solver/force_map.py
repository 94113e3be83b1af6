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
"""Samples a cycle in `average_force`: twist is smooth, so only dips converge slowly."""

TINY = 1e-12
"""Slip speed [m/s] below which the direction of friction is taken as none."""


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
    t = (np.arange(SAMPLES) + 0.5) / SAMPLES * cycle.period
    return mean_force(position, velocity, cycle.twist(t))


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
