"""prepare(): the whole way of a cycle through the driver; and the order of stamps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BPoly

from plate_core import CycleError, PlateCycle, load_rig
from plate_core.motion import motor_state, plate_state
from plate_driver.setpoints import motor_table
from plate_driver.setpoints.motor_table import (
    MAX_KNOTS,
    RESTART_NS,
    MotorTable,
    check_order,
    prepare,
)

RIG = load_rig()
SECOND = 1_000_000_000


def foreign(size: float, period: float = 0.1, knots: int = 16) -> PlateCycle:
    pose = size * np.random.default_rng(knots).normal(size=(knots, 3)) * [1, 1, 5]
    return PlateCycle.from_samples(period, pose)


def test_a_plate_at_rest_has_a_table_of_zeros():
    table, scaled = prepare(RIG, PlateCycle.rest(0.05), 7)
    assert table.stamp_ns == 7
    assert scaled.factor == 1
    assert not np.any(table.q)
    assert not np.any(MotorTable.rest(RIG, 0.05, 7).qdd)


@pytest.mark.parametrize("size", [1e-4, 0.01, 100.0])
def test_table_reproduces_the_cycle(size):
    table, scaled = prepare(RIG, foreign(size), 1)
    assert table.cycle is scaled.cycle
    pose, twist, accel = plate_state(RIG, table.q, table.qd, table.qdd)
    np.testing.assert_allclose(pose, scaled.cycle.knot_pose, atol=1e-14)
    np.testing.assert_allclose(twist, scaled.cycle.knot_twist, atol=1e-12)
    np.testing.assert_allclose(accel, scaled.cycle.knot_accel, atol=1e-9)


@pytest.mark.parametrize("size", [0.001, 0.01, 100.0])
def test_motors_that_spline_by_themselves_keep_the_limits_too(size):
    # Motor controllers draw quintics through the motors' knots, not through the plate's: the two
    # differ by the small curvature of the kinematics, which must not break a limit.
    for seed in range(10):
        table, _ = prepare(RIG, foreign(size, knots=12 + seed), 1)
        states = np.stack([table.q, table.qd, table.qdd], axis=1)
        times = table.cycle.times.copy()  # scipy 1.11 takes no read-only array
        spline = BPoly.from_derivatives(times, states)
        t = np.linspace(0, table.cycle.period, 5000)
        assert np.max(np.abs(spline(t))) <= RIG.limits.stroke_m * (1 + 1e-3)
        assert np.max(np.abs(spline.derivative()(t))) <= RIG.limits.speed * (1 + 1e-3)
        ours = motor_state(RIG, table.cycle.pose(t), table.cycle.twist(t), table.cycle.accel(t))[0]
        np.testing.assert_allclose(spline(t), ours, atol=2e-5)


def test_the_final_check_is_independent_of_the_scaling(monkeypatch):
    def wrong(rig, cycle, load):
        return replace(scale_to_limits(rig, cycle, load), cycle=cycle)

    scale_to_limits = motor_table.scale_to_limits
    monkeypatch.setattr(motor_table, "scale_to_limits", wrong)
    with pytest.raises(CycleError, match=r"motor_1: travel is .* m, allowed: 0\.01 m"):
        prepare(RIG, foreign(0.1), 1)


def test_a_table_may_be_sent_until_it_is_too_old():
    table = replace(MotorTable.rest(RIG, 0.05, 7), until=5.0)
    table.check_age(5.0)
    with pytest.raises(CycleError, match=r"was ready 0\.01 s too late"):
        table.check_age(5.01)


def test_scaled_from_rest_is_still_from_rest():
    table, scaled = prepare(RIG, foreign(1.0), 1, repeats=2)
    assert 0 < scaled.factor < 0.1
    assert table.cycle.starts_at_rest
    assert table.cycle.period == pytest.approx(0.4)


@pytest.mark.parametrize("period", [0.0099, 10.1])
def test_strange_periods_are_refused(period):
    with pytest.raises(CycleError, match=r"period is [\d.]+ s, allowed: 0\.01 to 10 s"):
        prepare(RIG, PlateCycle.rest(period), 1)


def test_fades_count():
    message = r"period is 4 s \(12 s with fades\), allowed: 0\.01 to 10 s"
    with pytest.raises(CycleError, match=message):
        prepare(RIG, foreign(1e-4, period=4.0), 1)


def test_too_many_knots_are_refused():
    with pytest.raises(CycleError, match="2002 knots, allowed: at most 2000"):
        prepare(RIG, foreign(1e-4, knots=MAX_KNOTS + 1), 1)


def test_stamps_in_order():
    check_order(None, 0)
    check_order(5, 5)
    check_order(5, 6)


def test_old_stamps_are_refused():
    now = 100 * SECOND
    for late in (1, RESTART_NS):
        with pytest.raises(CycleError, match=r"is older than the last, 100\.0+ s, allowed"):
            check_order(now, now - late)


def test_stamps_far_back_are_a_new_beginning():
    check_order(100 * SECOND, 100 * SECOND - RESTART_NS - 1)
    check_order(100 * SECOND, 0)
