"""usage() against brute force over a dense grid of times and plate points, numpy's roots, and
simple mechanics for force and heat."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_core.motion import (
    corner_accel,
    motor_state,
    polynomial_peaks,
    quintic_pieces,
    usage,
)
from plate_core.motion.limits import CERTAINTY
from plate_core.rig import Suspension

RIG = load_rig()
MASS = RIG.plate.mass_kg
PERIOD = 0.1


def random_cycle(seed: int) -> PlateCycle:
    """Smooth random cycle of three harmonics, about as large as the rig allows."""
    rng = np.random.default_rng(seed)
    t = np.arange(48) * PERIOD / 48
    pose = np.zeros((48, 3))
    for h in (1, 2, 3):
        phase = rng.uniform(0, 2 * np.pi, 3)
        size = rng.uniform(0, 1, 3) * [3e-3, 3e-3, 1e-2] / h**2
        pose += size * np.sin(2 * np.pi * h * t[:, None] / PERIOD + phase)
    return PlateCycle.from_samples(PERIOD, pose)


def brute_force(cycle: PlateCycle) -> tuple[float, float, float]:
    """Peaks of travel, speed and acceleration from positions alone, by differences in time."""
    n, step = 4000, 2e-6
    t = step + np.arange(n) * (cycle.period - 2 * step) / (n - 1)

    def points(times, at):
        pose = cycle.pose(times)
        cos, sin = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
        x = pose[:, :1] + cos * at[:, 0] - sin * at[:, 1]
        y = pose[:, 1:2] + sin * at[:, 0] + cos * at[:, 1]
        return np.stack([x, y], axis=2)

    motors = np.array([m.point for m in RIG.motors])
    ways = np.array([m.direction for m in RIG.motors])
    before, now, after = (
        np.sum((points(t + d, motors) - motors) * ways, axis=2) for d in (-step, 0, step)
    )
    grid_x, grid_y = np.meshgrid(np.linspace(-0.3, 0.3, 5), np.linspace(-0.15, 0.15, 5))
    grid = np.column_stack([grid_x.ravel(), grid_y.ravel()])
    second = (points(t + step, grid) - 2 * points(t, grid) + points(t - step, grid)) / step**2
    return (
        float(np.max(np.abs(now))),
        float(np.max(np.abs(after - before)) / (2 * step)),
        float(np.max(np.linalg.norm(second, axis=2))),
    )


@pytest.mark.parametrize("seed", range(5))
def test_usage_is_the_peak(seed):
    cycle = random_cycle(seed)
    found = usage(RIG, cycle)
    peaks = brute_force(cycle)
    for ours, exact in zip((found.stroke_m, found.speed, found.accel), peaks, strict=True):
        assert 0.9999 * exact < ours < 1.002 * exact


def test_peak_between_knots_is_not_missed():
    # Two knots at home; all the motion is between them.
    twist = np.array([[0.5, 0, 0]] * 2)
    zero = np.zeros((2, 3))
    cycle = PlateCycle.from_knots([0, PERIOD], zero, twist, zero)
    peak = np.max(np.abs(cycle.pose(np.linspace(0, PERIOD, 10001))))
    assert peak <= usage(RIG, cycle).stroke_m < 1.1 * peak


@pytest.mark.parametrize("limit", ["stroke_m", "speed", "accel"])
def test_worst_is_the_largest_fraction(limit):
    cycle = random_cycle(9)
    found = usage(RIG, cycle)
    tight = {"stroke_m": 1.0, "speed": 100.0, "accel": 1e4, limit: getattr(found, limit) / 3}
    rig = replace(RIG, limits=replace(RIG.limits, **tight))
    assert usage(rig, cycle).worst == pytest.approx(3)


def test_a_cycle_at_rest_uses_no_limit():
    assert usage(RIG, PlateCycle.rest(PERIOD)).worst == 0


def test_corner_of_a_spinning_plate_is_pulled_inwards():
    zero = np.zeros((1, 3))
    accel = corner_accel(RIG, zero, np.array([[0, 0, 2.0]]), zero)
    np.testing.assert_allclose(accel, 4 * np.hypot(0.3, 0.15))


def uneven_cycle(seed: int) -> PlateCycle:
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0], np.cumsum(rng.uniform(0.002, 0.02, 12))])
    state = [rng.normal(size=(13, 3)) * s for s in (0.002, 0.2, 30)]
    for a in state:
        a[-1] = a[0]
    return PlateCycle.from_knots(times, *state)


def by_roots(times: np.ndarray, states: list[np.ndarray], order: int) -> float:
    """Greatest magnitude of a derivative of all motors' quintics, at ends and stationary points."""
    maximum = 0.0
    for piece, step in zip(quintic_pieces(times, *states), np.diff(times), strict=True):
        for column in piece.T:
            p = np.polynomial.Polynomial(column).deriv(order)
            turn = p.deriv().roots()
            real = turn.real[np.abs(turn.imag) < 1e-9]
            t = np.concatenate([[0, step], real[(real > 0) & (real < step)]])
            maximum = max(maximum, float(np.max(np.abs(p(t)))))
    return maximum


@pytest.mark.parametrize("seed", range(5))
def test_peaks_are_those_of_the_roots(seed):
    cycle = uneven_cycle(seed)
    q = motor_state(RIG, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    found = usage(RIG, cycle)
    for value, order in ((found.stroke_m, 0), (found.speed, 1)):
        exact = by_roots(cycle.times, list(q), order)
        assert exact <= value * (1 + 1e-12)
        assert value <= exact * (1 + 2 * CERTAINTY)
    t = np.linspace(0, cycle.period, 200_001)
    dense = corner_accel(RIG, cycle.pose(t), cycle.twist(t), cycle.accel(t)).max()
    assert dense * (1 - 1e-9) <= found.accel <= dense * (1 + 1e-5)


def test_forces_carry_the_plate():
    cycle = uneven_cycle(1)
    along = PlateCycle.from_knots(
        cycle.times, *(a * [1, 0, 0] for a in (cycle.knot_pose, cycle.knot_twist, cycle.knot_accel))
    )
    t = np.linspace(0, along.period, 100_001)
    accel = np.abs(along.accel(t)[:, 0])
    found = usage(RIG, along)
    # Motors 1 and 2 push along x, at equal distances from the centre: they share it.
    assert found.force == pytest.approx(MASS * accel.max() / 2, rel=1e-5)
    expected = np.mean((MASS * accel[:-1] / 2) ** 2) / RIG.limits.continuous_force**2
    np.testing.assert_allclose(
        found.thermal_load, [expected, expected, 0, 0], rtol=1e-3, atol=1e-12
    )


def test_flexures_are_stretched_by_the_motors():
    stiffness = 1e4
    soft = Suspension(
        mass=np.diag([MASS, MASS, 0.075]), damping=np.zeros((3, 3)),
        stiffness=np.diag([stiffness, stiffness, 100]), feedforward=(0, 0, 1),
    )  # fmt: skip
    t = np.arange(64) / 64
    pose = np.column_stack([0.005 * np.sin(2 * np.pi * t), 0 * t, 0 * t])
    slow = PlateCycle.from_samples(1.0, pose)  # at 1 Hz the mass takes 0.4 N, the flexures 50 N
    needed = 0.005 * (stiffness - MASS * (2 * np.pi) ** 2) / 2
    assert usage(replace(RIG, suspension=soft), slow).force == pytest.approx(needed, rel=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_an_early_result_agrees_on_a_limit(seed):
    cycle = uneven_cycle(seed)
    q = motor_state(RIG, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    pieces, steps = quintic_pieces(cycle.times, *q), np.diff(cycle.times)
    exact = polynomial_peaks(pieces, steps)
    for limit in [*(exact * (1 - 1e-5)), *(exact * (1 + 1e-5)), 0.0, 1.0]:
        quick = polynomial_peaks(pieces, steps, limit)
        np.testing.assert_array_equal(quick > limit, exact > limit)
        np.testing.assert_allclose(quick[quick > limit], exact[quick > limit], rtol=3e-6)
