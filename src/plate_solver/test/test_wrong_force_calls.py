"""Kernels of averaged forces and of rotations refuse arrays that do not belong together."""

import numpy as np
import pytest

from plate_core import load_rig
from plate_solver import _kernels
from plate_solver.averages import force_rules
from plate_solver.averages.rotations import SequenceForces
from plate_solver.averages.sinusoids import motions_of
from plate_solver.averages.unreachable import _cells, _circles
from plate_solver.limits import Limits
from plate_solver.rotations.family import RotationFamily
from plate_solver.sinusoids import sinusoid_basis

PARTS = 3
STEPS = 8
NUMBER = 2
ROWS = 4
LIMITS = Limits.of(load_rig())
RNG = np.random.default_rng(0)


def random(*shape):
    return RNG.uniform(0.1, 1.0, shape)


PLACES = random(PARTS, 2), random(PARTS, 2)
RULES, BASIS = force_rules(NUMBER), sinusoid_basis(NUMBER, 0.05, False)
SLIP, WORK = random(2 * NUMBER + 1, 2), random(5, RULES.waves.shape[1])
MOTIONS = motions_of(NUMBER, BASIS, LIMITS)
START = random(1, 3 * BASIS.size)
HALF, LOADS = random(2), random(4, 3)
FAMILY = RotationFamily(random(2, 3), LIMITS, 0.1, 0.25, steps=(2, 3)).kernel_data
THETA = random(9)
COUNT = 15  # of steps, in three ramps and three holds
ASKED = np.ones(3 * PARTS, bool)
FORCES = SequenceForces(FAMILY, *PLACES, ASKED, random(3 * PARTS), random(3 * PARTS))
PROGRAMME = random(ROWS, 6), random(ROWS), random(6 + 2 * ROWS)
UNIT = np.arange(6, 6 + ROWS)
CASES = random(PARTS, 2 * NUMBER, 3)
CALLS = {
    "spline_force": (random(5), random(4, 6, 3), *PLACES),
    "step_forces": (*PLACES, random(STEPS, 3), random(STEPS)),
    "step_force_gradient": (*PLACES, random(STEPS, 3), random(STEPS)),
    "find_dips": (random(STEPS), STEPS, random(STEPS)),
    "branch_point": (SLIP, 1.0, 0.0, 0.1),
    "slip_at": (random(2 * NUMBER, 3), 0.1, 0.2, 0.0, 0.0, SLIP),
    "force_of": (SLIP, RULES, 1, WORK, random(3, 2 * NUMBER)),
    "sinusoid_forces": (CASES, *PLACES, RULES),
    "invert": (START, random(5, 3 * BASIS.size), *PLACES, PLACES[1], MOTIONS, 1e-3, 2, 2),
    "ramps": (random(2, 3), HALF, LOADS, 10.0),
    "run_of": (THETA, FAMILY),
    "runnable": (THETA, FAMILY),
    "pull_back": (THETA, FAMILY, random(3, COUNT, 2), random(3, COUNT, 2), random(COUNT, 2)),
    "gap_slopes": (THETA, FAMILY),
    "force_slopes": (THETA, FAMILY, *PLACES, ASKED),
    "fit_mean_force": (FORCES, THETA, 1e-3, 2),
    "mean_force_error": (FORCES, random(STEPS, 3), random(STEPS)),
    "simplex": (*PROGRAMME, UNIT, np.ones(ROWS), 9),
    "short_tour": (random(4, 3), HALF),
    "unit_slips": (_circles(_cells()[:2]), PLACES[0], 0.2),
    "best_triple": (random(2, 48),),
    "proves": (_cells()[:2], PLACES[0], 0.2, random(2 * PARTS), 9.0),
}
MAY_BE_LONGER = {
    ("invert", 0, 0), ("invert", 1, 0), ("ramps", 0, 0), ("ramps", 2, 0),
    ("unit_slips", 0, 0), ("unit_slips", 0, 1), ("unit_slips", 1, 0), ("best_triple", 0, 0),
    ("best_triple", 0, 1), ("short_tour", 0, 0), ("proves", 0, 0), ("sinusoid_forces", "waves", 1),
    "loads",
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_arrays_that_do_not_belong_together_are_refused(name, check_refusals):
    check_refusals(name, CALLS[name], MAY_BE_LONGER)


@pytest.mark.parametrize("column", [-1, 6 + 2 * ROWS])
def test_columns_that_there_are_not_are_refused(column):
    wrong = np.array([6, 7, 8, column])
    with pytest.raises(ValueError, match="column"):
        _kernels.simplex(*PROGRAMME, wrong, np.ones(ROWS), 9)
