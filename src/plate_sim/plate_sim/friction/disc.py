"""Formulas for the friction of a disc with uniform pressure on the plate.

Let R be the radius of the disc, s the slip speed of its centre, and c its angular velocity relative
to the plate. The rotation adds the slip w = R abs(c) at the edge. In units of w/R, the mean slip
over the disc is the mean distance of the disc's points from a point at the distance R s/w from the
centre. Complete elliptic integrals give this mean distance. Force and torque are the derivatives of
the mean slip with respect to s and w (Farkas, Bartels, Unger and Wolf, PRL 90, 248302, 2003).
"""

from __future__ import annotations

from .. import _kernels


def disc_force(s: float, w: float) -> tuple[float, float]:
    """Return the friction force [mu m g] and the friction torque [mu m g R] on a disc. s is the
    slip speed of the centre, and w the slip speed of the edge due to rotation [m/s].

    s and w are at least 0, and at least one of them is above 0.
    """
    return _kernels.disc_force(s, w)
