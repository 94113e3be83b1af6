"""Proofs of infeasibility: never wrong, sharp for one part, and not empty for several."""

import numpy as np
import pytest

from plate_solver.averages import force_rules, is_out_of_reach, sinusoid_forces
from plate_solver.averages.unreachable import _best, _cells, _circles, _proves, _vectors

ARM = 0.2


def made_forces(rng: np.random.Generator, number: int, position: np.ndarray) -> np.ndarray:
    """Forces (M, 2) of a random motion of few harmonics: certainly in reach."""
    motion = rng.normal(size=(2 * number, 3)) * [1.0, 1.0, 1 / ARM]
    many = np.broadcast_to(motion, (len(position), *motion.shape)).copy()
    return sinusoid_forces(many, position, np.zeros_like(position), force_rules(number))


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_the_bound_for_one_part_is_tight(number):
    max_force = (number - 1) / (number + 1)
    direction = np.array([[0.6, 0.8]])
    position = np.array([[0.1, 0.05]])
    assert is_out_of_reach(position, (max_force + 1e-3) * direction, number, ARM)
    assert not is_out_of_reach(position, max(max_force - 1e-3, 0.0) * direction, number, ARM)


@pytest.mark.parametrize(("parts", "number"), [(2, 2), (3, 2), (6, 3), (10, 2)])
def test_forces_of_an_existing_motion_are_never_proven_infeasible(parts, number):
    rng = np.random.default_rng(parts)
    for _ in range(12):
        position = rng.uniform(-1, 1, (parts, 2)) * [0.3, 0.15]
        assert not is_out_of_reach(position, made_forces(rng, number, position), number, ARM)


@pytest.mark.parametrize("number", [2, 3])
def test_every_motion_stays_below_the_proven_bound(number):
    # The support function, halved cell by cell, must be above all forces of many motions.
    rng = np.random.default_rng(number)
    position = rng.uniform(-1, 1, (5, 2)) * [0.3, 0.15]
    direction = rng.normal(size=10)
    direction /= np.linalg.norm(direction)
    found = max(abs(made_forces(rng, number, position).ravel() @ direction) for _ in range(3000))
    max_force = (number - 1) / (number + 1)
    cells = _cells()
    seen = max_force * _best(_vectors(_circles(cells), position, ARM) @ direction)[0]
    assert found < seen * 1.001
    assert not _proves(cells, position, ARM, direction, 0.98 * seen / max_force)
    assert _proves(cells, position, ARM, direction, 1.4 * seen / max_force)


def test_maximum_forces_on_many_parts_are_proven_infeasible():
    rng = np.random.default_rng(1)
    position = rng.uniform(-1, 1, (12, 2)) * [0.3, 0.15]
    angle = rng.uniform(0, 2 * np.pi, 12)
    force = 0.33 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert is_out_of_reach(position, force, 2, ARM)
    assert not is_out_of_reach(position, 0.1 * force, 2, ARM)


def test_parts_in_one_place_cannot_be_pushed_apart():
    position = np.array([[0.1, 0.05], [-0.2, 0.0], [0.1, 0.05]])
    force = np.array([[0.05, 0.0], [0.0, 0.05], [0.05, 0.0]])
    assert not is_out_of_reach(position, force, 2, ARM)
    assert is_out_of_reach(position, force + [[0, 0], [0, 0], [0, 1e-3]], 2, ARM)
