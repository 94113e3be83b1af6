"""Computes the table of a cycle's quintic pieces. Compiled code evaluates the exact motion of the
plate from this table.

`pieces.hpp` evaluates pose, twist and acceleration for the event-driven simulation of points. The
simulation of parts with a finite size needs only pose and twist, which `course.hpp` evaluates for
all axes at once.

Let O be the centre of the plate, theta its angle, P the position of a part, and v the velocity of
the part. The surface under the part has the velocity v_s = O' + theta' x (P - O), equation (2) of
the paper. Along the path of the part, v_s changes at the rate O'' + theta'' x (P - O) + theta' x (v
- O').

If the plate is tilted, `friction.point_events` works in a frame that falls freely along the tilt
from the start of each cycle. In this frame, gravity has no component along the plate, and the
plate's acceleration is O'' minus gravity along the plate. Slips are the same in both frames.

A table (K, 24) has one row for each piece between two knots. The columns are:

- times of the start and the end of the piece [s]
- coefficients of the six powers of the time since the start of the piece, for x, y [m] and theta
  [rad]
- bounds of the acceleration of a part that sticks (see `ride_bound`)
- whether theta changes at any time of the cycle
- whether the cycle is closed, so that its end state equals its start state
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from .. import _kernels
from .motion import PlateMotion

WIDTH = 24
"""Columns of a table."""


def tabulate(
    cycle: PlateCycle | PlateMotion, gravity: tuple[float, float] | np.ndarray = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Return the table (K, 24) of a cycle, and eight numbers that describe the whole cycle
    (scales).

    The scales are:

    - bounds of the rates of O' [m/s2], theta' [rad/s2], O'' [m/s3] and theta'' [rad/s3]
    - direction (2,) of the line along which the plate accelerates, or 0 if it does not accelerate
      along one line
    - gravity along the plate (2,) [m/s2]
    """
    table, scales = np.empty((len(cycle.coefficients), WIDTH)), np.empty(8)
    closed = isinstance(cycle, PlateCycle) and cycle.closes
    _kernels.tabulate(cycle.times, cycle.coefficients, *gravity, closed, table, scales)
    return table, scales
