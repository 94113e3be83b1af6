"""Event-driven simulation of point parts on a plate whose exact motion is known. The accuracy can
be chosen. The event-driven simulation is the reference for all other integrators.

The motion of a sliding part is integrated by Runge-Kutta 5(4) with error control. A sticking part
stays exactly at its place on the plate until the acceleration of the surface at this place exceeds
the limit of static friction. If the slip of a part becomes 0, the time of this event is computed.
After the event, the part sticks if friction can hold it. Otherwise, the part begins to slide in the
direction opposite to the surface's acceleration, relative to the plate. Near a minimum of the slip,
the steps become as small as the tolerance requires. If the plate is tilted, the frame of reference
falls with the component of gravity along the plate (`plate.pieces`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle, PlateError

from .. import _kernels
from ..plate.ground import LEVEL, Ground
from ..plate.motion import PlateMotion
from ..plate.pieces import tabulate
from .checks import MAX_ABS, check_motion, friction_accel, pairs, whole

TOLERANCE = 1e-7
"""Default tolerance of the displacement in one cycle [m]: a ten-thousandth of a pixel."""

SAMPLES = 64
"""Default number of output samples per cycle. For a usual motion of the plate, this number gives
eight samples per period of the highest harmonic."""


@dataclass(frozen=True)
class Trajectory:
    """Motion of M parts in plate_home.

    Attributes
    ----------
    time : (k,)
        Times from the start [s].
    position : (k, M, 2)
        Positions of the parts [m].
    velocity : (k, M, 2)
        Velocities of the parts [m/s].
    unchecked : tuple of int
        Indices of parts whose motion required more than the maximum number of steps. The rest of
        the motion of such parts was computed with coarse steps, so that its error is unknown. The
        tuple is empty except for extreme motions.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    unchecked: tuple[int, ...] = ()


def simulate(
    cycle: PlateCycle | PlateMotion,
    position: np.ndarray,
    velocity: np.ndarray,
    friction: float | np.ndarray,
    gravity: float = 9.81,
    cycles: int = 1,
    samples: int | None = None,
    tolerance: float = TOLERANCE,
    *,
    ground: Ground = LEVEL,
) -> Trajectory:
    """Integrate the stick-slip motion of point parts on an unbounded plate, without contacts.

    The error of the displacement per cycle is about `tolerance`.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate. Only a PlateCycle that ends in its initial state can be repeated. Other
        motions are executed once.
    position, velocity : (M, 2)
        Positions [m] and velocities [m/s] of the parts at the start of the first cycle, in
        plate_home.
    friction : float or (M,)
        Friction coefficient mu: one value for all parts, or one value for each part.
    gravity : float
        Gravity [m/s2].
    cycles : int
        Number of cycles.
    samples : int, optional
        Number of output samples per cycle. Default: `SAMPLES`.
    tolerance : float
        Requested error of the displacement in one cycle [m].
    ground : Ground
        Static friction and tilt of the plate. The friction must not depend on the slip.

    Returns
    -------
    Trajectory
        Motion at the start and at all samples. The number of samples is k = cycles * samples + 1.

    Raises
    ------
    PlateError
        If shapes disagree, if a value is not finite, if a count or coefficient is out of range, or
        if a motion that does not close is repeated.
    """
    cycles = whole("cycles", cycles)
    check_motion(cycle, cycles)
    position = pairs("position", position)
    velocity = pairs("velocity", velocity, len(position))
    limit = friction_accel(friction, gravity, len(position))
    samples = whole("samples", SAMPLES if samples is None else samples)
    if not 0 < tolerance <= MAX_ABS:
        raise PlateError(f"tolerance is {tolerance!r} m, allowed: a positive number")
    for name in ("friction_slope", "heave"):
        if getattr(ground, name) != 0:
            raise PlateError(f"{name} is {getattr(ground, name):g}, allowed: 0 for point parts")
    effect = ground.effect(gravity)
    table, scales = tabulate(cycle, effect[:2])
    if not scales.max() <= MAX_ABS:
        raise PlateError(f"cycle accelerates by {scales.max():g}, allowed: up to {MAX_ABS:g}")
    path, speed = np.empty((2, cycles * samples + 1, len(position), 2))
    path[0], speed[0] = position, velocity
    checked = np.ones(len(position), bool)
    run_points(
        table, scales, limit, effect.static_ratio, float(tolerance), cycles, path, speed, checked
    )
    unchecked = tuple(np.flatnonzero(~checked).tolist())
    return Trajectory(np.arange(len(path)) * (cycle.period / samples), path, speed, unchecked)


def run_points(
    table: np.ndarray,
    scales: np.ndarray,
    limit: np.ndarray,
    static: float,
    tolerance: float,
    cycles: int,
    path: np.ndarray,
    speed: np.ndarray,
    checked: np.ndarray,
) -> int:
    """Compute `path` and `speed` from their first rows. Return the number of integration steps.

    Parameters
    ----------
    table, scales : (K, 24), (8,)
        Motion of the plate, from `pieces.tabulate`.
    limit : (M,)
        mu g of each part [m/s2].
    static : float
        Ratio of static to dynamic friction.
    tolerance : float
        Requested error of the displacement in one cycle [m].
    cycles : int
    path, speed : (cycles * samples + 1, M, 2)
        Positions [m] and velocities [m/s], plate_home.
    checked : (M,)
        Output. Whether each part's motion was computed within the maximum number of steps.
    """
    return _kernels.run_points(
        table, scales, limit, static, tolerance, cycles, path, speed, checked
    )
