"""Drift intervals: towards targets, and as mean forces; by values computed by hand."""

import numpy as np
import pytest
from plant import MASS, RIG

from plate_core import Parts, Targets
from plate_planner.tasks import DriftInterval

IDS = ("black_1", "grey_1")


def test_drift_leads_towards_targets_at_a_rate_up_to_a_limit():
    """1.5 1/s times the distance, at most 0.05 m/s; free along an axis without a weight."""
    position = np.array([[0.0, 0.01], [0.1, 0.0]])
    weight = np.array([[1.0, 0.0], [0.2, 3.0]])
    targets = Targets(
        np.array([[0.01, 9.0], [-0.1, -0.002]]), np.array([[0.02, 9.0], [0.0, 0.004]]), weight
    )
    drift = DriftInterval.towards(position, targets)
    assert drift.low == pytest.approx(np.array([[0.015, -0.05], [-0.05, -0.003]]))
    assert drift.high == pytest.approx(np.array([[0.03, 0.05], [-0.05, 0.006]]))


def test_force_changes_the_present_drift_into_the_requested():
    """F = m (v_requested - v)/T in newtons, T = 0.2 s; and the half width of its interval."""
    parts = Parts.make(IDS, np.zeros((2, 2)), np.array([[0.01, 0.0], [0.0, -0.02]]))
    drift = DriftInterval(np.full((2, 2), 0.01), np.full((2, 2), 0.03))
    force, tolerance = drift.force(parts, RIG, 0.2)
    assert force == pytest.approx(MASS / 0.2 * np.array([[0.01, 0.02], [0.02, 0.04]]))
    assert tolerance == pytest.approx(np.full((2, 2), MASS / 0.2 * 0.01))


def test_force_is_limited_to_friction():
    parts = Parts.make(IDS, np.zeros((2, 2)), np.array([[9.0, -9.0], [0.0, 0.0]]))
    force, _ = DriftInterval(np.zeros((2, 2)), np.zeros((2, 2))).force(parts, RIG, 0.1)
    limit = MASS * RIG.friction.mu * RIG.friction.gravity
    assert force == pytest.approx(np.array([[-limit, limit], [0.0, 0.0]]))


def test_the_bias_is_subtracted_from_the_requested_drift():
    bias = np.array([[0.001, -0.002]])
    drift = DriftInterval(np.array([[0.01, 0.0]]), np.array([[0.02, 0.0]])).less(bias)
    assert drift.low == pytest.approx(np.array([[0.009, 0.002]]))
    assert drift.high == pytest.approx(np.array([[0.019, 0.002]]))
    assert drift.centre == pytest.approx(np.array([[0.014, 0.002]]))
