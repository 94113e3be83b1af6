"""Inversion of the averaged map with Method B (section 3.2.3), from the first start to the finished
spline.

The first start is the last solution. After that, the search consists of rounds. Each round has one
fresh start and several perturbations of the best motion of this round. A fresh start is moved
towards the request by continuation: it is solved for increasing fractions of the request. The
result of the search is converted to a spline within the rig's limits. The forces of this spline are
evaluated with another quadrature than in the search.

The averaged forces of parts at rest do not change if the motion is scaled or shifted in time. Steps
of minimum norm are orthogonal to these two directions. All motions have the largest amplitude that
the limits allow, because the velocities of the parts then have the smallest influence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..limits import Limits
from ..sinusoids.basis import SinusoidBasis
from .sinusoid_force import force_rules

FEW_CANDIDATES = 12
"""Number of random motions that are compared for each fresh start."""

Motions = _kernels.AveragedMotions
"""A basis of sinusoidal motions and the limits, in the form that the C++ kernels use."""


def motions_of(number: int, basis: SinusoidBasis, limits: Limits) -> Motions:
    """Return the motions of a basis with `number` harmonics, within limits."""
    return _kernels.averaged_motions(force_rules(number), basis, limits, FEW_CANDIDATES)


class Found(NamedTuple):
    """Result of `invert`.

    Attributes
    ----------
    theta : (3 h,)
        Parameters of the motion. Its amplitude reaches the limits.
    pose, twist, accel : (k + 1, 3)
        Pose, twist and acceleration of the motion at its knots.
    spline : (k, 6, 3)
        Polynomial coefficients, as in `PlateCycle.coefficients`.
    error : (M, 2)
        Requested force minus the force of the spline [mu m g].
    worst : float
        Maximum absolute force error [mu m g].
    condition : float
        Condition number of the derivative of the forces with respect to the parameters.
    iterations, tries : int
        Number of steps of all starts, and number of starts.
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
    """Find a motion with the requested average forces.

    The quadrature of the search may count two close dips as one. Then the error of the finished
    spline may exceed the tolerance. In this case the motion is corrected with adaptive panels. If
    this also fails, the search is repeated from other starts.

    Parameters
    ----------
    warm : (F, 3 h)
        The last solution. F is 1 if there is a last solution, otherwise 0.
    pool : (S, 3 h)
        Pool of random motions. For a fresh start, the next `FEW_CANDIDATES` motions of the pool and
        their opposites are compared, and the best one is used. Perturbations are also taken from
        the pool.
    position, velocity, force : (M, 2)
        Positions [m] and velocities [m/s] of the parts, plate_home; requested forces [mu m g].
    motions : Motions
    tolerance : float
        Maximum force error that counts as success [mu m g].
    iterations, tries : int
        Maximum number of steps from one start, and maximum number of starts.
    """
    return Found(
        *_kernels.invert(
            warm, pool, position, velocity, force, motions, tolerance, iterations, tries
        )
    )
