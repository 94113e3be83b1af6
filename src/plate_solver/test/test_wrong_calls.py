"""Kernels refuse arrays whose sizes, axes or types do not belong together."""

import numpy as np
import pytest

from plate_core import load_rig
from plate_solver import _kernels
from plate_solver._kernels import LANES, TRACE, TURNING_TRACE
from plate_solver.cycle_map import blocks_of, turning_blocks_of
from plate_solver.goal import Ends
from plate_solver.limits import Limits
from plate_solver.sinusoids import sinusoid_basis
from plate_solver.sinusoids.descent import Motions

PARTS, STEPS, BINS = 3, 8, 2
LIMITS = Limits.of(load_rig())
RNG = np.random.default_rng(0)
BASIS = sinusoid_basis(4, 0.1, True, 256)
MOTIONS = Motions.of(BASIS, LIMITS).kept


def random(*shape):
    return RNG.uniform(0.1, 1.0, shape)


def single(*shape):
    return random(*shape).astype(np.float32)


MOTION = random(STEPS, 3), random(STEPS, 3)
POINTS = random(PARTS, 2), random(PARTS, 2)
SPINS = random(PARTS), random(PARTS, 3)
STATE = blocks_of(*POINTS, np.ones(PARTS), 1e-3)
TURNING = turning_blocks_of(*POINTS, np.ones(PARTS), 1e-3, *SPINS)
TRACED = single(STEPS, 1, TRACE), MOTION[1], 1e-3, 0.1
TRACED_TURNING = single(STEPS, 1, TURNING_TRACE), *TRACED[1:]
ENDS = Ends(*random(5, 2 * PARTS), np.array([[0, 1], [1, 2]]), random(2), PARTS)
SETTLING = (
    *(random(256, 3) for _ in range(2)),
    *(random(*BASIS.checks[0].shape[:1], 3) for _ in range(3)),
)
CALLS = {
    "limit_use": (*(random(2, STEPS, 3) for _ in range(3)), random(2), LIMITS, True),
    "least_norm_step": (random(3, 4), random(3), 0.1),
    "end_state": (*POINTS, *MOTION, random(STEPS), random(PARTS)),
    "end_state_gradient": (*POINTS, *MOTION, random(STEPS), random(PARTS), 0.1),
    "end_turning": (*POINTS, *SPINS, *MOTION, random(STEPS), random(PARTS)),
    "end_turning_gradient": (*POINTS, *SPINS, *MOTION, random(STEPS), random(PARTS), 0.1),
    "trace": (STATE, *MOTION, 1e-3, single(STEPS, 1, TRACE)),
    "adjoint": (*TRACED, single(BINS, 1, 2, 3 * LANES)),
    "trace_turning": (TURNING, *MOTION, 1e-3, single(STEPS, 1, TURNING_TRACE)),
    "adjoint_turning": (*TRACED_TURNING, single(BINS, 1, 3, 3 * LANES)),
    "end_errors": (random(2 * PARTS), ENDS),
    "request_flags": (*POINTS, random(PARTS, 2), random(PARTS), random(PARTS, 2)),
    "settling_of": SETTLING,
    "descend": (
        MOTIONS,
        _kernels.settling_of(*SETTLING),
        STATE,
        ENDS,
        0.1,
        1.3,
        random(3 * BASIS.size),
        1e-3,
        2,
    ),
}


MAY_BE_LONGER = {
    ("limit_use", 3, 0), ("end_state", 5, 0), ("end_state_gradient", 5, 0), ("end_turning", 7, 0),
    ("end_turning_gradient", 7, 0), ("descend", 2, 0), ("least_norm_step", 0, 1),
    ("adjoint", 4, 0), ("adjoint_turning", 4, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_arrays_that_do_not_belong_together_are_refused(name, check_refusals):
    check_refusals(name, CALLS[name], MAY_BE_LONGER)


def test_pairs_of_parts_that_there_are_not_are_refused():
    for part in (-1, PARTS):
        wrong = ENDS._replace(pair=np.array([[0, 1], [1, part]]))
        with pytest.raises(ValueError, match="pair"):
            _kernels.end_errors(random(2 * PARTS), wrong)
    with pytest.raises(ValueError, match="parts"):
        _kernels.end_errors(random(2 * PARTS), ENDS._replace(parts=PARTS + 1))


@pytest.mark.parametrize("name", ["trace", "adjoint", "trace_turning", "adjoint_turning"])
def test_output_arrays_that_would_be_copied_are_refused(name):
    """A copy that is written in vain would be no error that anybody sees."""
    right = CALLS[name]
    written = (0, 4) if "trace" in name else (4,)
    for at in written:
        for wrong in (right[at].astype(float), np.asfortranarray(right[at])):
            if wrong.flags.c_contiguous and wrong.dtype == np.float32:
                continue  # one block: the same in either order
            with pytest.raises(TypeError):
                getattr(_kernels, name)(*right[:at], wrong, *right[at + 1 :])
