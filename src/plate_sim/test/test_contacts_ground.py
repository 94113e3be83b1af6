"""Discs on a tilted plate, on one that holds them by more than it rubs, on one far from home."""

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_sim import Contacts, Ground, PlateMotion, simulate, simulate_bodies
from plate_sim.friction import disc
from plate_sim.plate import LEVEL

RIG = load_rig()
RADIUS, HALF = RIG.parts.radius_m, RIG.plate.half
MU, GRAVITY = 0.25, 9.81
MU_G = MU * GRAVITY


def run(cycle, position, velocity, steps, ground=LEVEL, walls=False, cycles=1):
    """Where discs are at every step, and how they move (k, M, 2)."""
    run = simulate_bodies(
        cycle, disc(RADIUS), position, 0, velocity, 0, MU, GRAVITY, cycles, steps,
        contacts=Contacts(walls=walls), ground=ground, half=HALF, step=cycle.period / steps,
    )  # fmt: skip
    assert run.on_plate.all()
    return run.position, run.velocity


def along_x(accel, period=0.1, knots=8):
    """A plate that accelerates evenly from rest, and does not come back."""
    t = np.linspace(0, period, knots + 1)
    pieces = np.zeros((knots, 6, 3))
    pieces[:, 0, 0], pieces[:, 1, 0] = 0.5 * accel * t[:-1] ** 2, accel * t[:-1]
    pieces[:, 2, 0] = 0.5 * accel
    return PlateMotion(t, pieces)


@pytest.mark.parametrize("step", [1e-3, 5e-5])
def test_a_tilted_plate_lets_go_where_friction_does_not_suffice(step):
    ground = Ground(tilt=(0.3, -0.2))
    pull = np.array(ground.effect(GRAVITY)[:2])
    assert np.hypot(*pull) > MU_G
    path, speed = run(PlateCycle.rest(0.1), [[0, 0]], [[0, 0]], round(0.1 / step), ground)
    accel = pull * (1 - MU_G / np.hypot(*pull))
    assert speed[-1, 0] == pytest.approx(0.1 * accel, rel=1e-9)
    assert path[-1, 0] == pytest.approx(0.005 * accel, rel=1e-9)


def test_a_little_tilt_holds_and_moves_nothing():
    path, speed = run(PlateCycle.rest(0.1), [[0, 0]], [[0, 0]], 100, Ground(tilt=(0.1, 0.1)))
    assert np.abs(path).max() < 1e-15
    assert np.abs(speed).max() < 1e-15


@pytest.mark.parametrize("step", [1e-3, 5e-5])
@pytest.mark.parametrize("fraction", [0.9, 1.3, 1.7])
def test_static_friction_holds_up_to_its_own_bound(fraction, step):
    # Holds to 1.5 mu g; once loose, mu g.
    path, speed = run(
        along_x(fraction * MU_G), [[0, 0]], [[0, 0]], round(0.1 / step), Ground(static_ratio=1.5)
    )
    accel = fraction * MU_G if fraction < 1.5 else MU_G
    assert speed[-1, 0] == pytest.approx([0.1 * accel, 0], rel=1e-6)
    assert path[-1, 0] == pytest.approx([0.005 * accel, 0], rel=1e-6)


@pytest.mark.parametrize("step", [1e-3, 5e-5])
def test_a_disc_whose_slip_vanishes_is_held_by_static_friction(step):
    # The plate speeds up at 1.3 mu g from rest, the disc is ahead of it at first.
    ahead, accel = 0.05, 1.3 * MU_G
    motion = along_x(accel)
    path, speed = run(motion, [[0, 0]], [[ahead, 0]], round(0.1 / step), Ground(static_ratio=1.5))
    meet = ahead / (accel + MU_G)
    where = ahead * meet - 0.5 * MU_G * meet**2 + 0.5 * accel * (0.01 - meet**2)
    assert speed[-1, 0] == pytest.approx([0.1 * accel, 0], rel=1e-6)
    assert path[-1, 0, 0] == pytest.approx(where, abs=10 * accel * step**2)
    # With one friction for both it would be left behind at once.
    _, level = run(motion, [[0, 0]], [[ahead, 0]], round(0.1 / step))
    assert level[-1, 0, 0] < 0.85 * speed[-1, 0, 0]


def test_a_held_disc_rides_on_a_turning_plate():
    t = np.arange(64) / 64
    pose = np.stack([0 * t, 0 * t, 0.8 * (1 - np.cos(2 * np.pi * t))], axis=1)
    cycle = PlateCycle.from_samples(0.6, pose)
    start = np.array([[0.04, 0.02]])
    needs = np.linalg.norm(start) * np.abs(cycle.accel(np.linspace(0, 0.6, 500))[:, 2]).max()
    assert 1.5 * MU_G < needs < 2.5 * MU_G
    path, _ = run(cycle, start, 0 * start, 600, Ground(static_ratio=3.0))
    angle = cycle.pose(np.linspace(0, 0.6, 601))[:, 2]
    c, s = np.cos(angle), np.sin(angle)
    expected = np.stack([c * 0.04 - s * 0.02, s * 0.04 + c * 0.02], axis=1)
    assert np.abs(path[:, 0] - expected).max() < 2e-6


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "ground", [Ground(1.0, (0.05, -0.1)), Ground(1.6), Ground(1.4, (0.1, 0.1))]
)
def test_discs_move_like_points_on_any_ground(seed, ground):
    rng = np.random.default_rng(seed)
    cycle = PlateCycle.from_samples(0.1, 3e-4 * rng.normal(size=(8, 3)) * [1, 1, 2])
    start = np.array([[-0.1, 0.05], [0.1, 0.0], [0.0, -0.08]])
    path, _ = run(cycle, start, 0 * start, 4000, ground)
    points = simulate(cycle, start, 0 * start, MU, GRAVITY, samples=4000, ground=ground)
    assert np.abs(points.position[-1] - start).max() > 1e-4  # they do slide
    assert np.abs(path[::40] - points.position[::40]).max() < 3e-6


def test_a_motion_need_not_start_at_home_nor_end_where_it_starts():
    pieces = np.zeros((4, 6, 3))
    t = np.linspace(0, 0.1, 5)
    pieces[:, 0] = [0.05, -0.02, 0.1] + np.outer(t[:-1], [0.5, 0, 0])
    pieces[:, 1] = [0.5, 0, 0]
    motion = PlateMotion(t, pieces)
    # In the plate's corner: beyond the walls of a plate at home, and of one turned back.
    c, s = np.cos(0.1), np.sin(0.1)
    corner = HALF - RADIUS - 1e-6
    position = np.array([[c * corner[0] - s * corner[1], s * corner[0] + c * corner[1]]])
    position += [0.05, -0.02]
    path, speed = run(motion, position, [[0.5, 0]], 100, walls=True)
    assert path[-1, 0] == pytest.approx(position[0] + [0.05, 0], abs=1e-12)
    assert speed[-1, 0] == pytest.approx([0.5, 0], abs=1e-12)
    # And it is pushed by the wall where that is.
    path, speed = run(motion, position, [[3.0, 0]], 1000, walls=True)
    rim = path[1:, 0] - motion.pose(np.linspace(0, 0.1, 1001)[1:])[:, :2]
    along = c * rim[:, 0] + s * rim[:, 1]
    assert along.max() <= corner[0] + 1.1e-6 + 1e-12
    assert speed[1, 0] @ [c, s] == pytest.approx(0.5 * c, abs=3 * MU_G * 1e-3)
