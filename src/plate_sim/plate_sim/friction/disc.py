"""Friction of a disc with uniform pressure on the plate, in closed form.

The centre slips at s, and the spin c adds the slip w = R abs(c) at the edge. The mean slip over the
disc is the mean distance from a point at s/w radii to the points of a disc, which is given by
complete elliptic integrals. Force and torque are its derivatives with respect to s and w (Farkas,
Bartels, Unger and Wolf, PRL 90, 248302, 2003).
"""

from __future__ import annotations

from .. import _kernels


def disc_force(s: float, w: float) -> tuple[float, float]:
    """Return force [mu m g] and torque [mu m g R] on a disc with slip s and rotational slip w
    [m/s].

    Both are at least 0, and not both are 0.
    """
    return _kernels.disc_force(s, w)
