"""Friction of a disc with uniform pressure on the plate, in closed form.

The centre slips with the speed s. The spin c adds the slip w = R abs(c) at the edge. The mean slip
over the disc is the mean distance of the disc's points from a point at s/w radii. Complete elliptic
integrals give this distance. Force and torque are its derivatives with respect to s and w (Farkas,
Bartels, Unger and Wolf, PRL 90, 248302, 2003).
"""

from __future__ import annotations

from .. import _kernels


def disc_force(s: float, w: float) -> tuple[float, float]:
    """Return force [mu m g] and torque [mu m g R] on a disc with slip s of the centre and
    rotational slip w of the edge [m/s].

    Both slips are at least 0, and at least one of them is above 0.
    """
    return _kernels.disc_force(s, w)
