"""One descent of a sinusoidal motion on the cycle map, computed by C++ kernels.

One call runs the Levenberg-Marquardt method on the coefficients of the motion. The method minimises
the errors of the parts' final positions and rotations (`goal.ends`), and the limit violations. The
inputs are a `Problem` and initial parameters. The output is a `Fit`. The whole descent is a single
call, because an evaluation takes only about ten microseconds and Python overhead would dominate.

On the cycle map, the displacement depends on the amplitude. If each step of the search were scaled
down to the limits, the step would bring no progress. Therefore motions may exceed the limits
slightly during the search. Each violation is an additional error. The last descents have the
maximum utilisation 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..cycle_map import blocks_of, turning_blocks_of
from ..fit import Fit
from ..goal import Ends, Goal
from ..limits import Limits
from .basis import TAIL_CHECKS, SinusoidBasis

BIN = 4
"""Number of steps whose derivatives are summed before they are multiplied by the basis."""


class Motions(NamedTuple):
    """A basis of sinusoidal motions, and the limits of the rig.

    Attributes
    ----------
    basis : SinusoidBasis
    kept : _kernels.Motions
        Basis and limits in the form that the C++ kernels use.
    """

    basis: SinusoidBasis
    kept: _kernels.Motions

    @classmethod
    def of(cls, basis: SinusoidBasis, limits: Limits) -> Motions:
        """Prepare a basis for the kernels. The number of steps of the basis must be a multiple of
        `BIN`."""
        twist_bins = basis.twist.reshape(-1, BIN, basis.size).mean(axis=1)
        scale = np.array([1.0, 1.0, 1 / limits.arm_m])
        kept = _kernels.motions_of(
            basis.pose, basis.twist, twist_bins, *basis.checks,
            TAIL_CHECKS * basis.free_end, scale, basis.dt, limits,
        )  # fmt: skip
        return cls(basis, kept)


class Problem(NamedTuple):
    """Input of a descent.

    Attributes
    ----------
    motions : Motions
    settling : _kernels.Settling
        Motion of the plate from its initial state to rest. The motion of the basis is added to this
        motion.
    start : (b, 5 LANES) or (b, 10 LANES)
        States of the parts at the start of the cycle, in blocks for the C++ kernels.
    ends : Ends
    coast : float
        Time of the extrapolation, as in `Goal` [s].
    max_use : float
        Largest permitted utilisation of any rig limit during the search (1: exactly at the limit).
    """

    motions: Motions
    settling: _kernels.Settling
    start: np.ndarray
    ends: Ends
    coast: float
    max_use: float

    @classmethod
    def of(cls, goal: Goal, motions: Motions, max_use: float) -> Problem:
        """Convert a goal to a problem."""
        basis = motions.basis
        state = goal.position, goal.velocity, goal.friction_accel, basis.dt
        if goal.part_rotations is None:
            start = blocks_of(*state)
        else:
            start = turning_blocks_of(*state, goal.part_rotations.spin, goal.part_rotations.spread)
        plate = np.zeros((3, 3)) if goal.plate is None else goal.plate
        moved = (matrix @ plate for matrix in (*basis.settling[:2], *basis.settling_checks))
        settling = _kernels.settling_of(*moved)
        return cls(motions, settling, start, goal.ends, goal.coast, max_use)


def descend(problem: Problem, theta: np.ndarray, tolerance: float, iterations: int) -> Fit:
    """Improve the parameters (3 h,) until no error exceeds `tolerance` [m] or the progress stalls.

    The result contains the errors of the final positions and rotations, followed by the limit
    violations.
    """
    motions, settling, start, ends, coast, max_use = problem
    return Fit(
        *_kernels.descend(
            motions.kept, settling, start, ends, coast, max_use, theta, float(tolerance), iterations
        )
    )
