"""Discs that meet: no overlap, momentum kept, no energy gained."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_sim import WorldState, record_cycle, simulate

RIG = load_rig()
RADIUS = RIG.parts.radius_m
SMOOTH = 0.0
"""Friction coefficient that leaves only the contacts."""


def discs(position, velocity=None):
    state = WorldState.at_rest(tuple(f"black_{i}" for i in range(len(position))), position)
    return state if velocity is None else replace(state, velocity=np.array(velocity, float))


def deepest_overlap(path):
    """Greatest overlap [m] of any two discs at any step of a path (k, M, 2)."""
    i, j = np.triu_indices(path.shape[1], 1)
    return 2 * RADIUS - np.min(np.linalg.norm(path[:, i] - path[:, j], axis=2))


def test_head_on_discs_stop_each_other_and_go_on_together():
    state = discs([[-0.02, 0], [0.02, 0]], [[0.3, 0], [-0.1, 0]])
    end, run = record_cycle(state, PlateCycle.rest(0.2), RIG, mu=SMOOTH)
    assert deepest_overlap(run.position) < 1e-6
    assert end.velocity == pytest.approx(np.array([[0.1, 0], [0.1, 0]]))
    assert np.sum(end.position, axis=0) == pytest.approx([0.04, 0])


def test_rims_do_not_rub():
    state = discs([[-0.02, 0.005], [0.02, -0.005]], [[0.3, 0.0], [-0.3, 0.0]])
    end, _ = record_cycle(state, PlateCycle.rest(0.1), RIG, mu=SMOOTH)
    assert np.sum(end.velocity, axis=0) == pytest.approx(0, abs=1e-12)
    # What is left is the part of the speed across the line of centres at the moment of contact.
    sine = 0.01 / (2 * RADIUS)
    assert np.linalg.norm(end.velocity[0]) == pytest.approx(0.3 * sine, rel=2e-2)


def test_crowd_keeps_momentum_and_gains_no_energy():
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    state = discs((grid - [2, 1.5]) * 0.022, rng.normal(0, 0.2, (20, 2)))
    end, run = record_cycle(state, PlateCycle.rest(0.3), RIG, mu=SMOOTH)
    assert end.dropped == 0
    momentum = np.sum(run.velocity, axis=1)
    assert momentum == pytest.approx(np.broadcast_to(momentum[0], momentum.shape), abs=1e-12)
    energy = np.sum(run.velocity**2, axis=(1, 2))
    assert np.all(np.diff(energy) <= 1e-15)
    assert energy[-1] < 0.9 * energy[0]  # they did meet
    assert deepest_overlap(run.position) < 2e-5


def test_pressed_discs_do_not_overlap():
    # Nine discs thrown at their common centre, on a plate that shakes them.
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    state = discs(np.vstack([0.06 * ring, [[0, 0]]]), np.vstack([-0.6 * ring, [[0, 0]]]))
    t = np.arange(64) / 64
    pose = 1e-3 * np.stack([np.cos(2 * np.pi * t) - 1, np.sin(4 * np.pi * t), 0 * t], axis=1)
    _, run = record_cycle(state, PlateCycle.from_samples(0.15, pose), RIG)
    assert deepest_overlap(run.position) < 2e-5
    assert np.max(np.linalg.norm(run.position[-1], axis=1)) < 0.04


def test_discs_that_overlap_at_the_start_are_parted_without_speed():
    state = discs([[0, 0], [0.01, 0], [0.005, 0.006]])
    end, run = record_cycle(state, PlateCycle.rest(0.05), RIG)
    assert deepest_overlap(run.position[-1:]) < 2e-6
    assert np.all(end.velocity == 0)


def test_discs_in_one_point_are_parted():
    end, run = record_cycle(discs([[0, 0], [0, 0]]), PlateCycle.rest(0.01), RIG)
    assert deepest_overlap(run.position[-1:]) < 1e-6
    assert np.all(np.isfinite(end.position))


def test_discs_apart_move_like_points():
    rng = np.random.default_rng(1)
    cycle = PlateCycle.from_samples(0.1, 1e-3 * rng.normal(size=(12, 3)) * [1, 1, 4])
    state = discs([[-0.1, 0.05], [0.1, 0.0], [0.0, -0.08]])
    _, run = record_cycle(state, cycle, RIG)
    points = simulate(
        cycle, state.position, state.velocity, RIG.friction.mu, RIG.friction.gravity,
        samples=len(run.time) - 1,
    )  # fmt: skip
    assert np.array_equal(run.position, points.position)
    assert np.array_equal(run.velocity, points.velocity)
