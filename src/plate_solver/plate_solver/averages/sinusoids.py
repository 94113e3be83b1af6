"""Finds a motion of Method B (section 3.2.3) that exerts requested averaged forces. The result is a
finished spline.

The search first starts from the solution of the last request. After that, the search consists of
rounds. Each round starts once from a new random motion, and then several times from perturbations
of the best motion of this round. From a random motion, the search solves increasing fractions of
the request one after the other (continuation). The result of the search is converted to a spline
within the rig's limits. The forces of this spline are evaluated with another quadrature than in the
search.

The averaged forces on parts at rest do not change if the amplitude of the motion is changed, or if
the motion is shifted in time. The steps of the search have minimum norm, so that they are
orthogonal to these two changes. All motions have the largest amplitude that the limits allow,
because the velocities of the parts then have the smallest influence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core.motion import PIECES, control_points

from .. import _kernels
from ..limits import Limits
from ..sinusoids.basis import SinusoidBasis
from .sinusoid_force import force_rules

FEW_CANDIDATES = 12
"""Number of random motions that are compared to select each random start."""

Motions = _kernels.AveragedMotions
"""A basis of sinusoidal motions and the limits of the rig, in the form that the C++ kernels use."""


def motions_of(number: int, basis: SinusoidBasis, limits: Limits) -> Motions:
    """Convert a basis with `number` harmonics and the limits of a rig to the form that the C++
    kernels use."""
    # For up to two harmonics, one piece per knot interval is sufficient: the control points
    # overestimate the motion by only 0.1 %.
    pieces = 1 if number <= 2 else PIECES
    spline = basis.spline.reshape(len(basis.times) - 1, 6, -1)
    hull = np.vstack([control_points(basis.times, spline, order, pieces) for order in range(3)])
    return _kernels.averaged_motions(force_rules(number), basis, hull, limits, FEW_CANDIDATES)


class InversionResult(NamedTuple):
    """Result of `invert`.

    Attributes
    ----------
    theta : (3 h,)
        Parameters of the motion, whose amplitude reaches the limits.
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
) -> InversionResult:
    """Find a motion with the requested average forces.

    If the slip of a part is nearly zero at two times that are close together, the quadrature of the
    search may treat them as one time. In this case, the error of the finished spline may exceed the
    tolerance. The motion is then corrected with an adaptive quadrature. If this also fails, the
    search is repeated from other starts.

    Parameters
    ----------
    warm : (F, 3 h)
        Parameters of the last solution. F is 1 if there is a last solution, otherwise 0.
    pool : (S, 3 h)
        Parameters of random motions (pool). To select a random start, the next `FEW_CANDIDATES`
        motions of the pool and their opposites are compared, and the best motion is used.
        Perturbations also come from the pool.
    position, velocity, force : (M, 2)
        Positions [m] and velocities [m/s] of the parts, in plate_home, and requested forces [mu m
        g].
    motions : Motions
    tolerance : float
        Maximum force error that counts as success [mu m g].
    iterations, tries : int
        Maximum number of steps from one start, and maximum number of starts.
    """
    return InversionResult(
        *_kernels.invert(
            warm, pool, position, velocity, force, motions, tolerance, iterations, tries
        )
    )
