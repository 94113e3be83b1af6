"""One descent of a sinusoidal motion on the cycle map, in C++ from start to finish.

Samples, the map and its derivatives, what is asked of the parts' ends, the rig's limits and the
steps of Levenberg and Marquardt: all in one call, as each takes some ten microseconds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..cycle_map import blocks_of, turning_blocks_of
from ..fit import Fit
from ..goal import Ends, Goal
from ..limits import Limits
from .basis import TAIL_LOOKS, SinusoidBasis

BIN = 4
"""Steps whose derivatives are summed before they meet the basis."""


class Motions(NamedTuple):
    """A basis of sinusoidal motions, and the limits that it presses against.

    Attributes
    ----------
    basis : SinusoidBasis
    kept : _kernels.Motions
        Both, as kernels keep them.
    """

    basis: SinusoidBasis
    kept: _kernels.Motions

    @classmethod
    def of(cls, basis: SinusoidBasis, limits: Limits) -> Motions:
        """Take a basis whose number of steps is a multiple of `BIN`."""
        twist_bins = basis.twist.reshape(-1, BIN, basis.size).mean(axis=1)
        scale = np.array([1.0, 1.0, 1 / limits.arm_m])
        kept = _kernels.motions_of(
            basis.pose, basis.twist, twist_bins, *basis.looks,
            TAIL_LOOKS * basis.free_end, scale, basis.dt, limits,
        )  # fmt: skip
        return cls(basis, kept)


class Problem(NamedTuple):
    """What a descent is to do.

    Attributes
    ----------
    motions : Motions
    settling : _kernels.Settling
        What the plate does without them, from the state in which it begins.
    start : (b, STATE) or (b, TURNING_STATE)
        Parts at the start, in blocks.
    ends : Ends
    coast : float
        [s].
    most : float
        Fraction of the limits that may be used on the way.
    """

    motions: Motions
    settling: _kernels.Settling
    start: np.ndarray
    ends: Ends
    coast: float
    most: float

    @classmethod
    def of(cls, goal: Goal, motions: Motions, most: float) -> Problem:
        """Take a goal."""
        basis = motions.basis
        state = goal.position, goal.velocity, goal.friction_accel, basis.dt
        if goal.turns is None:
            start = blocks_of(*state)
        else:
            start = turning_blocks_of(*state, goal.turns.spin, goal.turns.spread)
        plate = np.zeros((3, 3)) if goal.plate is None else goal.plate
        moved = (matrix @ plate for matrix in (*basis.settling[:2], *basis.settling_looks))
        settling = _kernels.settling_of(*moved)
        return cls(motions, settling, start, goal.ends, goal.coast, most)


def descend(problem: Problem, theta: np.ndarray, tolerance: float, iterations: int) -> Fit:
    """Improve a motion (3 h,) until no part misses more than `tolerance` [m], or it helps no more.

    The errors of the result are those of the ends, and then limits that are exceeded.
    """
    motions, settling, start, ends, coast, most = problem
    return Fit(
        *_kernels.descend(
            motions.kept, settling, start, ends, coast, most, theta, float(tolerance), iterations
        )
    )
