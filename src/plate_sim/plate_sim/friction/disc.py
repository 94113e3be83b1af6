"""Friction of a disc that presses evenly on the plate, without quadrature.

Its centre slips at s, its rim, by the spin, at w = R |c|. The mean slip over the disc is the mean
distance from a point at s/w radii to the points of a disc, which complete elliptic integrals give;
force and torque are its derivatives by s and w (Farkas, Bartels, Unger and Wolf, PRL 90, 248302,
2003).
"""

from __future__ import annotations

from .. import _kernels


def disc_force(s: float, w: float) -> tuple[float, float]:
    """Force [mu m g] and torque [mu m g R] on a disc whose centre slips at s and rim at w [m/s].

    Both at least 0, and not both 0.
    """
    return _kernels.disc_force(s, w)
