"""scale_to_limits() exceeds no limit, keeps the form of motions, and scales no more than needed."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import CycleError, PlateCycle, load_rig
from plate_core.motion import corner_accel, motor_state, usage
from plate_driver.setpoints.limits import ROUNDING, check_setpoints, scale_to_limits

RIG = load_rig()


def random_cycle(seed: int, size: float) -> PlateCycle:
    """Wild cycle: random states at random times, or smooth samples; about `size` m."""
    rng = np.random.default_rng(seed)
    period = rng.uniform(0.02, 0.5)
    knots = int(rng.integers(3, 30))
    pose = size * rng.normal(size=(knots, 3)) * [1, 1, rng.uniform(0, 10)]
    if seed % 3 == 0:
        return PlateCycle.from_samples(period, pose)
    rate = knots / period
    twist = size * rate * rng.normal(size=(knots, 3)) * [1, 1, 5]
    accel = size * rate**2 * rng.normal(size=(knots, 3)) * [1, 1, 5]
    if seed % 3 == 1:
        return PlateCycle.from_samples(period, pose, twist, accel)
    times = np.concatenate([[0], np.sort(rng.uniform(0, period, knots - 1)), [period]])
    close = [np.vstack([a, a[:1]]) for a in (pose, twist, accel)]
    return PlateCycle.from_knots(times, *close)


def dense_fractions(cycle: PlateCycle) -> np.ndarray:
    """Largest share of stroke, speed and acceleration limit on 64 samples of each interval."""
    steps = np.arange(64) / 64
    t = (cycle.times[:-1, None] + np.diff(cycle.times)[:, None] * steps).ravel()
    pose, twist, accel = cycle.pose(t), cycle.twist(t), cycle.accel(t)
    q, qd, _ = motor_state(RIG, pose, twist, accel)
    peaks = [np.abs(q).max(), np.abs(qd).max(), corner_accel(RIG, pose, twist, accel).max()]
    return np.array(peaks) / [RIG.limits.stroke_m, RIG.limits.speed, RIG.limits.accel]


@pytest.mark.parametrize("size", [1e-5, 1e-3, 0.1, 10.0, 1e6])
def test_limits_are_kept_with_the_smallest_necessary_scaling(size):
    for seed in range(20):
        cycle = random_cycle(seed, size)
        found = scale_to_limits(RIG, cycle)
        fractions = dense_fractions(found.cycle)
        assert np.all(fractions <= 1 + ROUNDING), f"seed {seed}: {fractions}"
        assert found.usage.overall == usage(RIG, found.cycle).overall
        np.testing.assert_allclose(found.cycle.knot_pose, found.factor * cycle.knot_pose)
        np.testing.assert_array_equal(found.cycle.times, cycle.times)
        if found.factor < 1:
            larger = usage(RIG, cycle.scaled(1.02 * found.factor)).overall
            assert found.usage.overall > 0.97 or larger > 1


def test_gentle_cycle_is_not_touched():
    cycle = random_cycle(0, 1e-5)
    found = scale_to_limits(RIG, cycle)
    assert found.cycle is cycle
    assert found.factor == 1
    assert found.requested is found.usage


def test_exactly_at_the_limit_is_allowed():
    cycle = random_cycle(0, 1e-4)
    rig = replace(RIG, limits=replace(RIG.limits, accel=usage(RIG, cycle).accel))
    assert scale_to_limits(rig, cycle).factor == 1
    tighter = replace(rig, limits=replace(rig.limits, accel=rig.limits.accel * (1 - 1e-5)))
    found = scale_to_limits(tighter, cycle)
    assert 0.99 < found.factor < 1
    assert found.usage.accel <= tighter.limits.accel


@pytest.mark.parametrize("limit", ["stroke_m", "speed", "accel", "force"])
def test_every_limit_counts(limit):
    cycle = random_cycle(0, 1e-4)
    free = {"stroke_m": 1.0, "speed": 100.0, "accel": 1e4, "force": 1e4, "continuous_force": 1e4}
    peak = getattr(usage(RIG, cycle), limit)
    rig = replace(RIG, limits=replace(RIG.limits, **(free | {limit: peak / 4})))
    found = scale_to_limits(rig, cycle)
    assert found.requested.overall == pytest.approx(4)
    assert found.factor == pytest.approx(0.25, rel=0.01)
    assert getattr(found.usage, limit) <= peak / 4


def test_weak_motors_get_their_continuous_load():
    weak = replace(RIG, limits=replace(RIG.limits, continuous_force=10.0))
    found = scale_to_limits(weak, random_cycle(0, 1e-3))
    assert found.factor < 1
    assert 0.95 < np.max(found.usage.thermal_load) <= 1 + ROUNDING


def test_a_cycle_at_rest_is_not_scaled():
    assert scale_to_limits(RIG, PlateCycle.rest(0.05)).factor == 1


def absurd_cycle(size: float) -> PlateCycle:
    t = np.arange(12) / 12
    wave = [np.sin(2 * np.pi * t), np.cos(2 * np.pi * t), np.sin(4 * t)]
    return PlateCycle.from_samples(0.1, size * np.column_stack(wave))


@pytest.mark.parametrize("size", [1e30, 1e60])
def test_absurd_cycles_are_scaled(size):
    assert np.all(dense_fractions(scale_to_limits(RIG, absurd_cycle(size)).cycle) <= 1)


@pytest.mark.parametrize("size", [1e120, 1e290])
def test_a_cycle_that_is_too_large_to_compute_is_refused(size):
    cycle = absurd_cycle(size)
    with pytest.raises(CycleError, match="too large to compute, allowed: 10 mm of stroke, 1 m/s, "):
        scale_to_limits(RIG, cycle)


def setpoints() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return np.array([0, 0.01, 0.02]), np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((3, 4))


def test_setpoints_at_the_limits_pass():
    # The quintic from rest to a stroke in a time h has its greatest speed, 15/8 stroke/h, halfway.
    limits = RIG.limits
    h = 15 / 8 * limits.stroke_m / limits.speed
    times, q, qd, qdd = setpoints()
    q[1] = -limits.stroke_m
    check_setpoints(RIG, times * h / 0.01, q, qd, qdd)
    with pytest.raises(CycleError, match=r"motor_1: speed is 1\.001 m/s, allowed: 1 m/s"):
        check_setpoints(RIG, times * h / 0.01 / 1.001, q, qd, qdd)


def test_an_excess_between_two_knots_is_refused():
    times, q, qd, qdd = setpoints()
    q[1, 2], qd[1, 2] = 0.0099, 0.5
    with pytest.raises(CycleError, match=r"motor_3: travel is 0\.0103\d* m, allowed: 0\.01 m"):
        check_setpoints(RIG, times, q, qd, qdd)


@pytest.mark.parametrize(
    ("array", "index", "value", "message"),
    [
        (1, (1, 2), 0.0101, "motor_3: travel is 0.0101 m, allowed: 0.01 m"),
        (1, (1, 0), -0.0101, "motor_1: travel is 0.0101 m"),
        (2, (1, 3), 1.001, "motor_4: speed is 1.001 m/s, allowed: 1 m/s"),
        (3, (1, 3), -np.inf, "a value is not finite"),
        (1, (0, 1), 1e-4, "motor_2: travel at rest is 0.0001 m, allowed: 2e-05 m"),
        (2, (2, 1), 0.1, "motor_2: speed at rest is 0.1 m/s"),
        (1, (1, 1), np.nan, "a value is not finite"),
        (2, (1, 1), np.inf, "a value is not finite"),
        (0, (1,), np.nan, "a value is not finite"),
        (0, (1,), 0.03, "times must start at 0"),
        (0, (0,), 0.001, "times must start at 0"),
    ],
)
def test_wrong_setpoints_are_refused(array, index, value, message):
    arrays = setpoints()
    arrays[array][index] = value
    with pytest.raises(CycleError, match=message):
        check_setpoints(RIG, *arrays)
