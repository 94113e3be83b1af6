"""The plate's exact motion for kernels: the quintic pieces of a cycle in one table.

`pieces.hpp` has the evaluation of the plate's pose, twist and acceleration that the judge of points
uses; steps of finite parts need pose and twist alone, all axes at once (`course.hpp`).

The surface under a part at P has the velocity v_s = O' + theta' x (P - O), equation (2) of the
paper; its rate along the part's path is O'' + theta'' x (P - O) + theta' x (v - O').

On a tilted plate the judge (`friction.point_events`) works in a frame that falls freely down the
tilt from the start of each cycle: there nothing pulls, and the plate's acceleration is O'' less
gravity along the plate. Slips are the same in both.

A table (K, 24) has a row per piece between two knots: times of its start and end [s]; six powers
of the time since its start of x, y [m] and theta [rad], each; what a riding part can feel (see
`ride_bound`); whether theta changes anywhere; and whether the end of the cycle is its start.
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
    """Return a cycle's table (K, 24), and its scales (8,).

    Scales are bounds of the rates: of O' [m/s2], theta' [rad/s2], O'' [m/s3] and
    theta'' [rad/s3]; the direction (2,) of the line on which the plate accelerates, 0 if there is
    none; and gravity along the plate (2,) [m/s2].
    """
    table, scales = np.empty((len(cycle.coefficients), WIDTH)), np.empty(8)
    _kernels.tabulate(
        cycle.times, cycle.coefficients, *gravity, isinstance(cycle, PlateCycle), table, scales
    )
    return table, scales
