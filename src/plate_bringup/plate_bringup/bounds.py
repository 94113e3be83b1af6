"""Upper bounds of the drift speed of one part on a plate that shakes along a line.

In a steady drift, friction acts for the same time in both directions, and the plate returns to its
initial position. During half of each cycle, the plate is slower than the part. The acceleration,
stroke and speed of the plate limit the slip during this half, and therefore the drift.

Proof for a motion with the period T. Let a = mu g. Let A be the maximum acceleration of the plate,
G = A/a, and S the stroke to either side. The plate moves along a line with velocity u, and the part
with velocity v, whose mean is v_0 > 0. Because the plate returns, the mean of the slip w = u - v is
-v_0. Therefore the area between w < 0 and the time axis is at least v_0 T. Because the velocity of
the part is periodic, the mean friction is 0. Friction accelerates the part by a while w > 0, and by
-a while w < 0. Hence w < 0 during at most T/2.

Bound by the acceleration: while w < 0, v' = -a. Therefore w' is between -(A - a) and A + a.
Consider an interval of length p with w = 0 at both ends and w < 0 between them. The area of w in
this interval is at most c p^2 with c = (A^2 - a^2)/(4 A). The sum over all such intervals is at
most c (T/2)^2:

    v_0 <= A T/16 (1 - 1/G^2)

Bound by the stroke: in an interval of length p, the plate moves back by at most 2 S. The part moves
forward by at most v_m p, where v_m <= v_0 + d with d = a T/4 is its maximum velocity. Therefore the
area of w is also at most 2 S + v_m p. The minimum of c p^2 and 2 S + v_m p is at most r p with r =
(v_m + sqrt(v_m^2 + 8 S c))/2. From v_0 T <= r T/2 follows

    v_0 <= d/2 + sqrt(d^2/4 + S c)

Two parts with the velocities v_1 and v_2 along the line that connects them: the velocity u of a
rigid plate along this line is the same under both parts. Assume that friction acts only along this
line, and that v_1 > v_2 at all times. In a steady drift, u < v_1 during at most T/2, and u > v_2
during at most T/2. At any time, at least one of these two conditions is true. Therefore both are
true during exactly T/2 each and never at the same time, so u would have to jump from below v_2 to
above v_1. This is impossible.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core import Rig

__all__ = ["SpeedBounds", "rest_to_rest_s", "shift_accel", "speed_bounds"]


class SpeedBounds(NamedTuple):
    """Upper bounds of the mean speed of one part [m/s]. There is one bound for each limit of the
    rig.

    Attributes
    ----------
    accel : float
        Bound by the acceleration of the plate in a cycle.
    stroke : float
        Bound by the stroke of the motors and the acceleration of the plate.
    speed : float
        Bound by the speed of the motors.
    """

    accel: float
    stroke: float
    speed: float

    @property
    def minimum(self) -> float:
        """Smallest bound [m/s]."""
        return min(self)

    @property
    def binding_limit(self) -> str:
        """Name of the limit that produces the smallest bound."""
        return self._fields[self.index(self.minimum)]


def speed_bounds(rig: Rig, period: float) -> SpeedBounds:
    """Return the bounds of the steady drift of one part, in cycles of `period` [s].

    Let T be the period, a = mu g, A = `shift_accel`, G = A/a, d = a T/4, and S the stroke. Each
    bound is computed for the line of motion that is most favourable for this bound:

        accel:   A T/16 (1 - 1/G^2)
        stroke:  d/2 + sqrt(d^2/4 + A S/4 (1 - 1/G^2))

    All bounds are 0 if the plate cannot make a part slide.
    """
    a, max_accel = rig.friction.accel, shift_accel(rig)
    net = max(1 - (a / max_accel) ** 2, 0.0)
    if max_accel <= a:
        return SpeedBounds(0.0, 0.0, 0.0)
    d = a * period / 4
    # travel of the motor that moves farthest per travel of the plate, along the best line
    travel = _min_over_directions(rig.motor_levers)
    stroke = d / 2 + np.sqrt(d**2 / 4 + max_accel * rig.limits.stroke_m / travel / 4 * net)
    return SpeedBounds(max_accel * period / 16 * net, float(stroke), rig.limits.speed / travel)


def shift_accel(rig: Rig) -> float:
    """Return the maximum acceleration of the plate along the most favourable line [m/s2].

    `accel_mps2` in the rig file and the peak force of the motors limit the acceleration. If the rig
    has flexures, the peak force is ignored, because the forces of the flexures can add to the
    forces of the motors.
    """
    if rig.suspension is not None:
        return float(rig.limits.accel)
    load = _min_over_directions(rig.motor_loads[2])
    return float(min(rig.limits.accel, rig.limits.force / load))


def _min_over_directions(rows: np.ndarray) -> float:
    """Return the minimum of max_k |rows[k] . d| over all unit vectors d = (cos a, sin a, 0). `rows`
    (4, 3) has the columns x, y and theta."""
    angle = np.linspace(0, np.pi, 181)
    return float(np.min(np.max(np.abs(rows[:, :2] @ [np.cos(angle), np.sin(angle)]), axis=0)))


def rest_to_rest_s(distance: float, friction_accel: float) -> float:
    """Return the minimum time in which friction can move a part by a distance [m] from rest to rest
    [s]."""
    return float(2 * np.sqrt(distance / friction_accel))
