"""Peaks on the exact splines, against numpy's roots; forces and heat, against simple mechanics."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_core.motion import corner_accel, motor_state, quintic_pieces
from plate_core.rig import Suspension
from plate_driver.setpoints.peaks import CERTAINTY, peaks, polynomial_peaks
from plate_driver.setpoints.thermal import AMBIENT_C, ThermalState

RIG = load_rig()
MASS = RIG.plate.mass_kg


def random_cycle(seed: int) -> PlateCycle:
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0], np.cumsum(rng.uniform(0.002, 0.02, 12))])
    state = [rng.normal(size=(13, 3)) * s for s in (0.002, 0.2, 30)]
    for a in state:
        a[-1] = a[0]
    return PlateCycle.from_knots(times, *state)


def by_roots(times: np.ndarray, states: list[np.ndarray], order: int) -> float:
    """Greatest magnitude of a derivative of all motors' quintics, at ends and stationary points."""
    most = 0.0
    for piece, step in zip(quintic_pieces(times, *states), np.diff(times), strict=True):
        for column in piece.T:
            p = np.polynomial.Polynomial(column).deriv(order)
            turn = p.deriv().roots()
            real = turn.real[np.abs(turn.imag) < 1e-9]
            t = np.concatenate([[0, step], real[(real > 0) & (real < step)]])
            most = max(most, float(np.max(np.abs(p(t)))))
    return most


@pytest.mark.parametrize("seed", range(5))
def test_peaks_are_those_of_the_roots(seed):
    cycle = random_cycle(seed)
    q = motor_state(RIG, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    found = peaks(RIG, cycle)
    for value, order in ((found.stroke_m, 0), (found.speed, 1)):
        exact = by_roots(cycle.times, list(q), order)
        assert exact <= value * (1 + 1e-12)
        assert value <= exact * (1 + 2 * CERTAINTY)
    t = np.linspace(0, cycle.period, 200_001)
    dense = corner_accel(RIG, cycle.pose(t), cycle.twist(t), cycle.accel(t)).max()
    assert dense * (1 - 1e-9) <= found.accel <= dense * (1 + 1e-5)


def test_forces_carry_the_plate():
    cycle = random_cycle(1)
    along = PlateCycle.from_knots(
        cycle.times, *(a * [1, 0, 0] for a in (cycle.knot_pose, cycle.knot_twist, cycle.knot_accel))
    )
    t = np.linspace(0, along.period, 100_001)
    accel = np.abs(along.accel(t)[:, 0])
    found = peaks(RIG, along)
    # Motors 1 and 2 push along x, at equal distances from the centre: they share it.
    assert found.force == pytest.approx(MASS * accel.max() / 2, rel=1e-5)
    expected = np.mean((MASS * accel[:-1] / 2) ** 2) / RIG.limits.continuous_force**2
    np.testing.assert_allclose(
        found.thermal_load, [expected, expected, 0, 0], rtol=1e-3, atol=1e-12
    )


def test_flexures_are_stretched_by_the_motors():
    stiffness = 1e4
    hung = Suspension(
        mass=np.diag([MASS, MASS, 0.075]), damping=np.zeros((3, 3)),
        stiffness=np.diag([stiffness, stiffness, 100]), feedforward=(0, 0, 1),
    )  # fmt: skip
    t = np.arange(64) / 64
    pose = np.column_stack([0.005 * np.sin(2 * np.pi * t), 0 * t, 0 * t])
    slow = PlateCycle.from_samples(1.0, pose)  # at 1 Hz the mass takes 0.4 N, the flexures 50 N
    needed = 0.005 * (stiffness - MASS * (2 * np.pi) ** 2) / 2
    assert peaks(replace(RIG, suspension=hung), slow).force == pytest.approx(needed, rel=1e-5)


def test_heat_follows_its_equation():
    limits = RIG.limits
    heat = ThermalState().under(np.array([0.5, 1.0, 2.0, 0.0]))
    later = heat.at_time(RIG, limits.thermal_time_s)
    np.testing.assert_allclose(later.rise, (1 - np.exp(-1)) * heat.load)
    steps = ThermalState().under(heat.load)
    for k in range(1, 11):
        steps = steps.at_time(RIG, k * limits.thermal_time_s / 10)
    np.testing.assert_allclose(steps.rise, later.rise)
    assert later.celsius(RIG) == pytest.approx(
        AMBIENT_C + 2 * (1 - np.exp(-1)) * limits.heat_rise_k
    )
    # The clock was put back: nothing has happened yet.
    np.testing.assert_array_equal(later.at_time(RIG, 0.0).rise, later.rise)


@pytest.mark.parametrize("rise", [0.0, 0.5, 0.999, 1.0])
def test_there_is_room_up_to_the_limit_and_no_further(rise):
    heat = ThermalState(rise=np.full(4, rise))
    room = heat.allowed_load(RIG, 3.0)
    assert np.all(room >= 1)
    np.testing.assert_allclose(heat.under(room).at_time(RIG, 3.0).rise, 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_enough_tells_the_same_of_a_limit(seed):
    cycle = random_cycle(seed)
    q = motor_state(RIG, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    pieces, steps = quintic_pieces(cycle.times, *q), np.diff(cycle.times)
    exact = polynomial_peaks(pieces, steps)
    for limit in [*(exact * (1 - 1e-5)), *(exact * (1 + 1e-5)), 0.0, 1.0]:
        quick = polynomial_peaks(pieces, steps, limit)
        np.testing.assert_array_equal(quick > limit, exact > limit)
        np.testing.assert_allclose(quick[quick > limit], exact[quick > limit], rtol=3e-6)
