"""How fast one part can drift at most on a plate that shakes along a line.

In a steady drift friction pulls a part as long one way as the other, and meanwhile the plate comes
back to where it was. What the plate can do in the half in which it is slower than the part is
limited by its acceleration, its stroke and its speed.

Proof, of a motion that repeats with T: a = mu g, A the plate's greatest acceleration, G = A/a, S
its stroke to either side. Let the plate go along a line with velocity u, and the part with v, on
average v_0 > 0. The plate comes home, so the mean of the slip w = u - v is -v_0, and the area of w
below 0 is v_0 T or more. The part's velocity repeats, so the mean friction is 0: it is a while
w > 0 and -a while w < 0, hence w < 0 for at most T/2.

Acceleration: meanwhile v' = -a, so w' is between -(A - a) and A + a, and in an interval p from
w = 0 to w = 0 it has an area of c p^2 at most, c = (A^2 - a^2)/(4 A). All intervals together have
c (T/2)^2 or less:

    v_0 <= A T/16 (1 - 1/G^2)

Stroke: in an interval p the plate goes back by 2 S at most, and the part goes on by v_m p at most,
where v_m <= v_0 + d, d = a T/4, is its greatest velocity: so the area is at most 2 S + v_m p too.
The lesser of both is r p or less, r = (v_m + sqrt(v_m^2 + 8 S c))/2, and v_0 T <= r T/2 gives

    v_0 <= d/2 + sqrt(d^2/4 + S c)

Two parts: along the line that joins them a rigid plate has the same velocity u under both. Let
friction act along it alone, and v_1 > v_2 all the time. In a steady drift u < v_1 for at most T/2,
and u > v_2 for at most T/2; but one or the other is true at any time, so u, which has to pass from
one side of the two to the other, would have to jump.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core import Rig
from plate_core.rig import motor_levers

__all__ = ["SpeedBounds", "rest_to_rest_s", "shift_accel", "speed_bounds"]


class SpeedBounds(NamedTuple):
    """Greatest mean speeds of one part [m/s], each by one limit of the rig alone.

    Attributes
    ----------
    accel : float
        By the plate's acceleration in a cycle of length T.
    stroke : float
        By the motors' stroke, and the acceleration, whatever T is.
    speed : float
        By the motors' speed.
    """

    accel: float
    stroke: float
    speed: float

    @property
    def least(self) -> float:
        """The one that binds [m/s]."""
        return min(self)

    @property
    def binds(self) -> str:
        """What the one that binds is about."""
        return self._fields[self.index(self.least)]


def speed_bounds(rig: Rig, period: float) -> SpeedBounds:
    """Return the bounds of one part's steady drift, in cycles of `period` [s].

    With a = mu g, A = `shift_accel`, G = A/a, d = a T/4, and S the stroke, each along the line that
    allows most of it:

        accel:   A T/16 (1 - 1/G^2)
        stroke:  d/2 + sqrt(d^2/4 + A S/4 (1 - 1/G^2))

    All are 0 where the plate cannot make a part slide.
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
    """Return the greatest acceleration of the plate along any line [m/s2], for a moment.

    By the file's limit and by the motors' peak force; flexures, which may help, leave the first.
    """
    if rig.suspension is not None:
        return float(rig.limits.accel)
    load = _least(rig.motor_loads[2])
    return float(min(rig.limits.accel, rig.limits.force / load))


def _travel(rig: Rig) -> float:
    """Travel of the motor that moves most, over that of the plate, along the best line [-]."""
    return _least(motor_levers(rig))


def _least(rows: np.ndarray) -> float:
    """Least over directions of the greatest |row . direction|; rows (4, 3) of x, y and theta."""
    angle = np.linspace(0, np.pi, 181)
    return float(np.min(np.max(np.abs(rows[:, :2] @ [np.cos(angle), np.sin(angle)]), axis=0)))


def rest_to_rest_s(way: float, friction_accel: float) -> float:
    """Return the least time [s] in which friction takes a part over a way [m] from rest to rest."""
    return float(2 * np.sqrt(way / friction_accel))
