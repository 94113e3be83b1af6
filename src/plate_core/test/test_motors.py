"""Limits of the motors, compared with linear programmes over corners and over motor forces, and
with statics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from plate_core import PlateCycle, load_rig
from plate_core.motion import usage
from plate_core.rig import (
    Motor,
    Suspension,
    mass_matrix,
)
from plate_core.rig.motors import PEAK_OVER_RMS, force_per_accel

RIG = load_rig()


def weak(force, continuous, rig=RIG):
    return replace(rig, limits=replace(rig.limits, force=force, continuous_force=continuous))


def scattered(seed):
    """A rig with motors anywhere on a plate of any shape."""
    rng = np.random.default_rng(seed)
    plate = replace(RIG.plate, length_m=rng.uniform(0.1, 1), width_m=rng.uniform(0.1, 1))
    angle = rng.uniform(-np.pi, np.pi, 4)
    motors = tuple(
        Motor(f"motor_{i + 1}", tuple(rng.uniform(-1, 1, 2) * plate.half), (np.cos(a), np.sin(a)))
        for i, a in enumerate(angle)
    )
    return replace(RIG, plate=plate, motors=motors)


@pytest.mark.parametrize("seed", range(6))
def test_force_for_an_acceleration_against_a_linear_programme(seed):
    """Discs of the corners' accelerations as polygons of 360 sides around them: 4e-5 too large."""
    rig = scattered(seed) if seed else RIG
    angle = np.radians(np.arange(360))
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    rows = [
        np.column_stack([normal, normal @ [-y, x]]) for x, y in rig.plate.corners
    ]  # of a + theta'' J r
    for maximum, row in zip(
        force_per_accel(rig.motor_loads[2], rig.plate.half), rig.motor_loads[2], strict=True
    ):
        best = linprog(-row, np.vstack(rows), np.ones(4 * 360), bounds=(None, None))
        assert maximum == pytest.approx(-best.fun, rel=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_reach_against_the_best_that_motors_could_give(seed):
    """No sharing of the load gives more than the best one, found by a linear programme; motors of
    the default rig share as well as can be."""
    rig = weak(20.0, 20.0, scattered(seed) if seed else RIG)
    mass, levers, best = rig.plate_mass, rig.motor_levers.T, []
    for angle in np.linspace(0, np.pi, 33):
        way = mass @ [np.cos(angle), np.sin(angle), 0.0]
        found = linprog(
            [0, 0, 0, 0, -1], A_eq=np.column_stack([levers, -way]), b_eq=np.zeros(3),
            bounds=[(-20.0, 20.0)] * 4 + [(0, None)],
        )  # fmt: skip
        best.append(-found.fun)
    assert rig.reach.accel <= min(best) * (1 + 1e-9)
    if not seed:
        assert rig.reach.accel == pytest.approx(min(best))


@pytest.mark.parametrize("seed", range(20))
def test_motions_within_reach_have_the_force(seed):
    """Any motion whose corners stay below it, except for the part caused by the plate's spin."""
    rng = np.random.default_rng(seed)
    rig = weak(20.0, 20.0, scattered(seed % 5 + 1))
    t = np.arange(64) / 64 * 0.1
    waves = np.concatenate(
        [f(2 * np.pi * k * t / 0.1)[None] for k in (1, 2, 3) for f in (np.sin, np.cos)]
    )
    size = rng.normal(size=(6, 3)) / [1, 1, np.hypot(*rig.plate.half)]
    cycle = PlateCycle.from_samples(0.1, 1e-3 * waves.T @ size)
    cycle = cycle.scaled(rig.reach.accel / usage(rig, cycle).accel)
    assert usage(rig, cycle).force <= 20.0 * 1.02


def test_the_weakest_limit_determines_the_reach():
    assert RIG.reach == (100.0, "accel_mps2")
    assert weak(20.0, 15.0).reach.accel == pytest.approx(20.0)
    assert weak(20.0, 15.0).reach.limit.startswith("force_n of motor_")
    hot = weak(20.0, 4.0).reach
    assert hot.accel == pytest.approx(4.0 * PEAK_OVER_RMS)
    assert hot.limit.startswith("continuous_force_n of motor_")
    heavy = replace(weak(20.0, 15.0), plate=replace(RIG.plate, mass_kg=4.0))
    assert heavy.reach.accel == pytest.approx(10.0)
    assert heavy.gamma == pytest.approx(10.0 / (0.25 * 9.81))


def test_flexures_take_force_where_the_plate_is():
    """By hand: springs alone, stretched by 3 mm along x, two motors share."""
    none, springs = ((0.0,) * 3,) * 3, ((5000.0, 0.0, 0.0), (0.0, 5000.0, 0.0), (0.0, 0.0, 50.0))
    hung = replace(RIG, suspension=Suspension(mass_matrix(2.0, 0.075), none, springs, (1, 1, 1)))
    pose, twist, accel = hung.motor_loads
    np.testing.assert_allclose(pose @ [0.003, 0, 0], [7.5, 7.5, 0, 0], atol=1e-9)
    np.testing.assert_array_equal(twist, np.zeros((4, 3)))
    np.testing.assert_allclose(accel @ [10.0, 0, 0], [10, 10, 0, 0], atol=1e-9)
    np.testing.assert_array_equal(RIG.motor_loads[:2], np.zeros((2, 4, 3)))


def test_a_user_of_a_rig_cannot_change_its_cached_arrays():
    """Otherwise it would change the rig of all others, also of its shallow copies."""
    shapes = RIG.part_type("nut"), RIG.part_type("part")
    arrays = [RIG.motor_levers, RIG.plate_mass, RIG.motor_loads]
    for array in (*arrays, *(a for shape in shapes for a in (shape.polygon, shape.spread_m2))):
        with pytest.raises(ValueError, match="read-only"):
            array[0] *= 2
    heavy = replace(RIG, plate=replace(RIG.plate, mass_kg=2 * RIG.plate.mass_kg))
    np.testing.assert_allclose(heavy.motor_loads[2], 2 * RIG.motor_loads[2])
