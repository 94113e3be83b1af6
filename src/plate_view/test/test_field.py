"""Drift and mean force, compared with values computed by hand, and with the plate at rest."""

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_view.field import drift, grid, mean_force

RIG = load_rig()
POINT = np.array([[0.0, 0.0], [0.1, 0.05], [-0.2, -0.1]])


def along_x(samples):
    pose = np.zeros((len(samples), 3))
    pose[:, 0] = samples
    return PlateCycle.from_samples(0.1, pose)


def test_a_plate_at_rest_moves_nothing():
    cycle = PlateCycle.rest(0.1)
    assert not np.any(mean_force(cycle, POINT))
    assert not np.any(drift(cycle, POINT, RIG.friction.accel))


def test_slow_forth_and_quick_back_pulls_forth():
    """Triangle with 3/4 of the time forth: the mean force is 3/4 - 1/4 = 1/2 mu m g."""
    n = 400
    t = np.arange(n) / n
    smooth = along_x(0.005 * np.interp(t, [0, 0.75, 1], [-0.5, 0.5, -0.5]))
    force = mean_force(smooth, POINT)
    assert force[:, 0] == pytest.approx(0.5, abs=0.02)
    assert np.allclose(force[:, 1], 0, atol=1e-9)
    assert np.all(drift(smooth, POINT, RIG.friction.accel)[:, 0] > 0)


def test_with_high_friction_parts_move_with_the_plate():
    """With friction without end parts stick, and come back with the plate."""
    n = 64
    cycle = along_x(0.005 * (1 - np.cos(2 * np.pi * np.arange(n) / n)))
    assert np.abs(drift(cycle, POINT, 1e4)).max() < 2e-4


def test_drift_of_a_part_that_always_slides():
    """While the plate is much faster than the part, friction is constant: x = mu g t^2/2 forth,
    then the same back, over a symmetric triangle."""
    n, accel, period = 800, 0.1, 0.1
    samples = 0.02 * np.interp(np.arange(n) / n, [0, 0.5, 1], [0, 1, 0])
    moved = drift(along_x(samples), POINT[:1], accel)[0, 0] * period
    assert moved == pytest.approx(accel * (period / 2) ** 2, rel=0.03)


def test_a_turning_plate_drags_round():
    pose = np.zeros((400, 3))
    pose[:, 2] = 0.05 * np.interp(np.arange(400) / 400, [0, 0.75, 1], [-0.5, 0.5, -0.5])
    force = mean_force(PlateCycle.from_samples(0.1, pose), POINT[1:])
    round_about = np.column_stack([-POINT[1:, 1], POINT[1:, 0]])
    round_about /= np.linalg.norm(round_about, axis=1)[:, None]
    assert np.sum(force * round_about, axis=1) == pytest.approx(0.5, abs=0.03)


def test_the_grid_covers_the_plate_evenly():
    x, y = grid(RIG)
    assert np.ptp(np.diff(x)) < 1e-12
    assert np.diff(x)[0] == pytest.approx(np.diff(y)[0], rel=0.1)
    assert np.abs(x).max() < RIG.plate.half[0]
    assert np.abs(y).max() < RIG.plate.half[1]
