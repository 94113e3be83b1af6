"""Limits as errors: violations and gradients compared with differences, and their effect on
steering."""

import numpy as np
import pytest

from plate_core.motion import usage
from plate_solver import Limits
from plate_solver._kernels import PENALTY_USE
from plate_solver.limits import limit_use
from plate_solver.sinusoids import SinusoidFamily, sinusoid_basis


@pytest.fixture
def limits(rig):
    return Limits.of(rig)


def family(limits):
    return SinusoidFamily(sinusoid_basis(3, 0.1, True, 200), limits)


@pytest.mark.parametrize("period", [0.1, 0.4])
def test_slopes_are_derivatives_of_the_excess(limits, period, check_excess_slopes):
    # 0.1 s presses on the acceleration, 0.4 s on the stroke.
    check_excess_slopes(limits, period)


def test_excess_begins_at_the_aim(limits, excess_of):
    limited = family(limits)
    theta = limited.random(np.random.default_rng(1))
    used = limited.use(theta)
    assert len(excess_of(limited, limits, (PENALTY_USE - 1e-3) / used * theta)[0]) == 0
    # Only some instants are evaluated: their peak is a little lower.
    assert len(excess_of(limited, limits, (PENALTY_USE + 0.1) / used * theta)[0]) > 0


@pytest.mark.parametrize("size", [1.0, 5.0])
def test_limits_of_the_rig_are_used(rig, limits, size):
    limited = family(limits)
    for seed in range(5):
        cycle = limited.cycle(size * limited.random(np.random.default_rng(seed)))
        points = (cycle.control_points(order) for order in range(3))
        used = limit_use(*points, np.ones(1), Limits.of(rig, 1.0), False)
        # Control points lie around the motion, at 8 knots to a wave by a little.
        assert used == pytest.approx(usage(rig, cycle).worst, rel=5e-3)
