"""Method B's inversion of the averaged map (3.2.3), from first guess to finished spline.

Starts are, in this order: the last solution; then rounds of one fresh guess and disturbances of the
best motion that the round has found. A fresh guess is led to a far request by continuation, in
fractions that grow to the whole. What is found is made a spline within the rig's limits, and its
forces are judged on that spline, by a quadrature that the search has not used.

Scale and shift in time leave the averaged forces of parts at rest unchanged. Steps of least norm
are orthogonal to both, so none is wasted on them; the scale is spent on the limits: motions are
kept at full amplitude, where the parts' own velocities matter least.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..limits import Limits
from ..sinusoids.basis import SinusoidBasis
from .sinusoid_force import force_rules

FEW_CANDIDATES = 12
"""Random motions that are tried at the parts' places for each fresh guess."""

Motions = _kernels.AveragedMotions
"""A basis of sinusoidal motions, with the limits that they are kept within; made once."""


def motions_of(number: int, basis: SinusoidBasis, limits: Limits) -> Motions:
    """Return the motions of a basis with `number` harmonics, within limits."""
    return _kernels.averaged_motions(force_rules(number), basis, limits, FEW_CANDIDATES)


class Found(NamedTuple):
    """What `invert` finds.

    Attributes
    ----------
    theta : (3 h,)
        Parameters, at full amplitude.
    pose, twist, accel : (k + 1, 3)
        The motion at its knots.
    spline : (k, 6, 3)
        As `PlateCycle.coefficients`.
    error : (M, 2)
        Request minus force of this spline [mu m g].
    worst : float
        Greatest of them.
    condition : float
        Condition number of the forces' derivative by the parameters.
    iterations, tries : int
    """

    theta: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    accel: np.ndarray
    spline: np.ndarray
    error: np.ndarray
    worst: float
    condition: float
    iterations: int
    tries: int


def invert(
    warm: np.ndarray,
    pool: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    tolerance: float,
    iterations: int,
    tries: int,
) -> Found:
    """Find a motion with the wanted average forces.

    Two dips may be taken for one by the search's quadrature. Where the judge sees more error than
    is allowed, the motion is corrected on panels, and if need be the search done anew.

    Parameters
    ----------
    warm : (F, 3 h)
        The last solution, if there is one.
    pool : (S, 3 h)
        Random motions. A fresh guess is the best of the next `FEW_CANDIDATES`, forwards and
        backwards, at the parts' places; disturbances are taken from here too.
    position, velocity, force : (M, 2)
        Parts [m], [m/s], plate_home; wanted forces [mu m g].
    motions : Motions
    tolerance : float
        Greatest error that is allowed [mu m g].
    iterations, tries : int
        Most steps from one start, and most starts.
    """
    return Found(
        *_kernels.invert(
            warm, pool, position, velocity, force, motions, tolerance, iterations, tries
        )
    )
