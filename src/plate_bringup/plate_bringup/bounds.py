"""Upper bounds of the drift speed of one part on a plate that shakes along a line.

In a steady drift, friction acts for the same time in both directions, and the plate returns to its
initial position. During half of the time the plate is slower than the part. The acceleration,
stroke and speed of the plate limit the slip in this half, and therefore the drift.

Proof for a motion with the period T. Let a = mu g. Let A be the maximum acceleration of the plate,
G = A/a, and S the stroke to either side. The plate moves along a line with velocity u, and the part
with velocity v, whose mean is v_0 > 0. Because the plate returns, the mean of the slip w = u - v is
-v_0, and the area of w below 0 is at least v_0 T. Because the velocity of the part is periodic, the
mean friction is 0. Friction accelerates the part by a while w > 0, and by -a while w < 0. Hence w <
0 during at most T/2.

Acceleration: while w < 0, v' = -a. Therefore w' is between -(A - a) and A + a. In an interval of
length p at whose ends w = 0, the area is at most c p^2 with c = (A^2 - a^2)/(4 A). The sum over all
intervals is at most c (T/2)^2:

    v_0 <= A T/16 (1 - 1/G^2)

Stroke: in an interval of length p, the plate moves back by at most 2 S, and the part moves forward
by at most v_m p. The maximum velocity of the part is v_m <= v_0 + d, with d = a T/4. The area is
therefore also at most 2 S + v_m p. The minimum of both bounds is at most r p with r = (v_m +
sqrt(v_m^2 + 8 S c))/2. Then v_0 T <= r T/2 gives

    v_0 <= d/2 + sqrt(d^2/4 + S c)

Two parts: a rigid plate has the same velocity u under both parts along the line that connects them.
Assume that friction acts only along this line, and that v_1 > v_2 at all times. In a steady drift,
u < v_1 during at most T/2, and u > v_2 during at most T/2. At any time at least one of the two
conditions is true. Therefore u would have to jump from below v_2 to above v_1, which is impossible.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core import Rig

__all__ = ["SpeedBounds", "rest_to_rest_s", "shift_accel", "speed_bounds"]


class SpeedBounds(NamedTuple):
    """Upper bounds of the mean speed of one part [m/s]. Each bound results from one limit of the
    rig.

    Attributes
    ----------
    accel : float
        Bound by the acceleration of the plate in a cycle of length T.
    stroke : float
        Bound by the stroke of the motors and the acceleration.
    speed : float
        Bound by the speed of the motors.
    """

    accel: float
    stroke: float
    speed: float

    @property
    def least(self) -> float:
        """The smallest bound [m/s]."""
        return min(self)

    @property
    def binds(self) -> str:
        """Name of the limit with the smallest bound."""
        return self._fields[self.index(self.least)]


def speed_bounds(rig: Rig, period: float) -> SpeedBounds:
    """Return the bounds of the steady drift of one part, in cycles of `period` [s].

    Let a = mu g, A = `shift_accel`, G = A/a, d = a T/4, and let S be the stroke. Each bound applies
    to its most favourable line of motion:

        accel:   A T/16 (1 - 1/G^2)
        stroke:  d/2 + sqrt(d^2/4 + A S/4 (1 - 1/G^2))

    All bounds are 0 if the plate cannot make a part slide.
    """
    a, most = rig.friction.accel, shift_accel(rig)
    net = max(1 - (a / most) ** 2, 0.0)
    if most <= a:
        return SpeedBounds(0.0, 0.0, 0.0)
    d = a * period / 4
    travel = _travel(rig)
    stroke = d / 2 + np.sqrt(d**2 / 4 + most * rig.limits.stroke_m / travel / 4 * net)
    return SpeedBounds(most * period / 16 * net, float(stroke), rig.limits.speed / travel)


def shift_accel(rig: Rig) -> float:
    """Return the maximum instantaneous acceleration of the plate along its most favourable line
    [m/s2].

    The acceleration is limited by `accel_mps2` in the rig file and by the peak force of the motors.
    If the rig has flexures, only `accel_mps2` is considered, because the flexures may support the
    motors.
    """
    if rig.suspension is not None:
        return float(rig.limits.accel)
    load = _least(rig.motor_loads[2])
    return float(min(rig.limits.accel, rig.limits.force / load))


def _travel(rig: Rig) -> float:
    """Return the maximum travel of any motor per travel of the plate, along the most favourable
    line [-]."""
    return _least(rig.motor_levers)


def _least(rows: np.ndarray) -> float:
    """The result is the minimum over all directions of the maximum magnitude of row . direction.
    The rows (4, 3) have the columns x, y and theta."""
    angle = np.linspace(0, np.pi, 181)
    return float(np.min(np.max(np.abs(rows[:, :2] @ [np.cos(angle), np.sin(angle)]), axis=0)))


def rest_to_rest_s(distance: float, friction_accel: float) -> float:
    """Return the minimum time [s] in which friction can move a part by a distance [m] from rest to
    rest."""
    return float(2 * np.sqrt(distance / friction_accel))
