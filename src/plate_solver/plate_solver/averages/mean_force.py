"""Averaged force map: equations (3) to (5) of the paper, for parts with a velocity.

    f(P) = 1/T integral of (v_s(P, t) - v_p) / |v_s(P, t) - v_p| dt,   v_s = (u1 - y u3, u2 + x u3)

in units of mu m g. P = (x, y) is the position of the part, v_p its velocity, u the plate's twist,
v_s the velocity of the surface, and T the period. The paper sets v_p = 0. In this module, v_p may
differ from 0, because the velocity of a part changes the friction on it. The curl of the friction
field is the average of u3 / |v_s - v_p|. If the plate rotates about a fixed centre, this is
equation (11).
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle, PlateError

from .. import _kernels


def average_force(
    cycle: PlateCycle, position: np.ndarray, velocity: np.ndarray | None = None
) -> np.ndarray:
    """Return the average friction over a cycle on parts with constant position and velocity.

    Parameters
    ----------
    cycle : PlateCycle
        The plate's motion.
    position : (M, 2)
        Positions of the parts [m, plate_home]. The displacement of the plate is neglected, as in
        equation (3).
    velocity : (M, 2), optional
        Velocities of the parts [m/s]. Default: 0.

    Returns
    -------
    (M, 2)
        Average force on each part [mu m g].

    Raises
    ------
    PlateError
        If a shape is wrong or a value is not finite.
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
    return _kernels.spline_force(cycle.times, cycle.coefficients, position, velocity)


def step_forces(
    position: np.ndarray, velocity: np.ndarray, twist: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return the average force along x and y [mu m g] and the average curl [mu m g / m] at each
    part, (M, 3).

    Parameters
    ----------
    position, velocity : (M, 2)
        Positions [m] and velocities [m/s] of the parts, in plate_home.
    twist : (n, 3)
        Twist of the plate at the middles of the steps [m/s, m/s, rad/s].
    dt : (n,)
        Lengths of the steps, in any unit.
    """
    return _kernels.step_forces(position, velocity, twist, dt)


def step_force_gradient(
    position: np.ndarray, velocity: np.ndarray, twist: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return the derivatives (3, n, 3 M) of `step_forces` with respect to the twists.

    The first axis is the component of the twist: x, y, theta. The last axis contains force x, force
    y and curl of part 1, then of part 2, and so on.
    """
    return _kernels.step_force_gradient(position, velocity, twist, dt)
