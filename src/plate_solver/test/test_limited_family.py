"""Limits as errors: excess and slopes against differences, and what steering makes of them."""

import numpy as np
import pytest

from plate_solver.harmonics import harmonics
from plate_solver.limited_family import AIM, EXCESS_M, LimitedSinusoids
from plate_solver.solution import Bounds


@pytest.fixture
def bounds(rig):
    return Bounds.of(rig)


def family(bounds, room=1.3, period=0.1):
    return LimitedSinusoids(harmonics(3, period, True, 200), bounds, room)


@pytest.mark.parametrize("period", [0.1, 0.4])
def test_slopes_are_derivatives_of_the_excess(bounds, period):
    # 0.1 s presses on the acceleration, 0.4 s on the stroke.
    limited = family(bounds, period=period)
    rng = np.random.default_rng(0)
    for _ in range(5):
        theta = 1.2 * limited.random(rng)
        slopes = limited.penalty_slopes(theta)
        way = rng.normal(size=theta.size)
        step = 1e-7 * np.linalg.norm(theta) / np.linalg.norm(way)
        ahead, behind = (limited.penalty(theta + sign * step * way) for sign in (1, -1))
        assert len(ahead) == len(behind) == len(slopes) > 0
        difference = (behind - ahead) / (2 * step)
        np.testing.assert_allclose(slopes @ way, difference, rtol=1e-5, atol=1e-6 * EXCESS_M)


def test_excess_begins_at_the_aim(bounds):
    limited = family(bounds)
    theta = limited.random(np.random.default_rng(1))
    basis, coefficients = limited.basis, limited.coefficients(theta)
    share = bounds.share(*(m @ coefficients for m in (basis.pose, basis.twist, basis.accel)))
    assert len(limited.penalty((AIM - 1e-3) / share * theta)) == 0
    # Instants looked at are not all samples: their peak is a little lower.
    assert len(limited.penalty((AIM + 0.1) / share * theta)) > 0


@pytest.mark.parametrize("room", [1.0, 1.3])
def test_admissible_motions_stay_within_the_room(bounds, room):
    limited = family(bounds, room)
    basis = limited.basis
    for size in (1e-3, 1.0, 1e3):
        theta = limited.admissible(size * limited.random(np.random.default_rng(2)))
        c = limited.coefficients(theta)
        share = bounds.share(basis.pose @ c, basis.twist @ c, basis.accel @ c)
        assert share <= room * (1 + 1e-12)
        assert size > 1e-2 or share == pytest.approx(size)
    assert not limited.admissible(np.zeros_like(theta)).any()
