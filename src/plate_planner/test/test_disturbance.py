"""The disturbance observer against drifts that are known."""

import numpy as np
import pytest

from plate_planner.disturbance import Disturbance

T = 0.1
MOST = np.array([0.05, 0.05])


def axes(*angles):
    cos, sin = np.cos(angles), np.sin(angles)
    return np.stack([np.column_stack([cos, sin]), np.column_stack([-sin, cos])], axis=1)


def observed(drift, cycles, gain, most=MOST, age=0.0, late=0.0):
    """Return the observer after cycles in which parts drift by `drift` [m/s] more than foretold."""
    seen = Disturbance.none(2)
    for k in range(cycles):
        place = np.full((2, 2), 0.3 * k)
        seen = seen.foretell(place, k * T, age)
        seen = seen.see(place + T * drift, k * T + late, age, T, axes(0.4, 2.0), gain, most)
    return seen


def test_it_goes_to_the_true_drift_by_its_gain():
    drift = np.array([[0.01, -0.02], [0.0, 0.03]])
    for cycles in (1, 2, 8):
        left = observed(drift, cycles, 0.7).along(axes(0.4, 2.0)) - drift
        assert left == pytest.approx(-(0.3**cycles) * drift, abs=1e-12)


def test_it_turns_with_the_path():
    seen = observed(np.array([[0.01, 0.0], [0.0, 0.0]]), 40, 0.7)
    assert seen.along(axes(0.4 + np.pi / 2, 2.0))[0] == pytest.approx([0.0, 0.01])


def test_it_believes_no_more_than_it_may():
    seen = observed(np.array([[5.0, 0.0], [0.0, -5.0]]), 40, 0.7)
    assert np.max(np.abs(seen.drift)) == pytest.approx(0.05)


def test_it_learns_nothing_from_what_was_not_foretold_or_not_seen():
    drift = np.array([[0.01, np.nan], [0.01, 0.02]])
    assert not np.any(observed(drift, 5, 0.7).drift[0])
    assert np.any(observed(drift, 5, 0.7).drift[1])
    for other in ({"late": 0.5 * T}, {"age": None}):
        assert not np.any(observed(np.full((2, 2), 0.01), 5, 0.7, **other).drift)
