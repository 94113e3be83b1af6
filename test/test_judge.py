"""The judge of recorded motions: against sums by hand, and against the guard that it judges."""

from dataclasses import replace

import numpy as np
import pytest
from cuts import cut
from record.limits import limit_fractions, thermal_load
from shaking import shaking

from plate_core import PlateCycle, load_rig
from plate_core.motion import usage
from plate_core.rig import Suspension, mass_matrix

RIG = load_rig()
PERIOD = 0.1
PHASE = 2 * np.pi * np.arange(256) / 256
W = 2 * np.pi / PERIOD


def wave(x=0.0, y=0.0, theta=0.0):
    return PlateCycle.from_samples(PERIOD, np.outer(np.sin(PHASE), [x, y, theta]))


def test_a_wave_along_x_by_hand():
    """2 kg, two motors along x share: 200 N, 10 mm, 1 m/s and 100 m/s2 are allowed."""
    accel = 0.004 * W**2
    hand = [0.4, 0.004 * W, accel / 100, accel / 200]
    np.testing.assert_allclose(limit_fractions(RIG, wave(x=0.004)), hand, rtol=1e-4)
    load = (accel / 100) ** 2 / 2
    np.testing.assert_allclose(thermal_load(RIG, wave(x=0.004)), [load, load, 0, 0], atol=1e-4)


def test_limit_fractions_of_a_rotation_agree_with_a_manual_calculation():
    """The corners, 0.335 m from the middle, have w^2 r beside theta'' r; 0.075 kg m2 are turned by
    four motors, of levers 0.1, 0.1, 0.2 and 0.2 m, each by its lever over the sum of squares."""
    angle = 0.02
    t = np.linspace(0, PERIOD, 100_001)
    out, round_ = (angle * W * np.cos(W * t)) ** 2, angle * W**2 * np.sin(W * t)
    corners = np.max(np.hypot(out, round_)) * np.hypot(0.3, 0.15)
    force = 0.2 / (2 * 0.1**2 + 2 * 0.2**2) * 0.075 * angle * W**2
    _, _, accel, max_force = limit_fractions(RIG, wave(theta=angle))
    assert accel == pytest.approx(corners / 100, rel=1e-4)
    assert max_force == pytest.approx(force / 200, rel=1e-4)


@pytest.mark.parametrize("seed", range(10))
def test_the_judge_agrees_with_the_guard(seed):
    """Both are written separately; the guard's bounds may be a little higher than samples show."""
    rng = np.random.default_rng(seed)
    rig = RIG
    if seed % 2:  # all matrices full, so that no term may be left out
        push = rng.normal(size=(2, 3, 3)) * [[[1], [1], [0.1]]]
        damping, stiffness = ((s * a @ a.T).tolist() for s, a in zip((20, 2000), push, strict=True))
        mass = mass_matrix(2.0, 0.05, (0.01, -0.02))
        rig = replace(RIG, suspension=Suspension(mass, damping, stiffness, (1, 1, 1)))
    harmonics = np.array([f(k * PHASE) for k in (1, 2, 3) for f in (np.sin, np.cos)])
    pose = 1e-3 * harmonics.T @ (rng.normal(size=(6, 3)) * [1, 1, 5])
    cycle = PlateCycle.from_samples(PERIOD, pose)
    reported, limits = usage(rig, cycle), rig.limits
    guard = [
        reported.stroke_m / limits.stroke_m, reported.speed / limits.speed,
        reported.accel / limits.accel,
        reported.force / limits.force,
    ]  # fmt: skip
    np.testing.assert_allclose(limit_fractions(rig, cycle), guard, rtol=1e-3)
    np.testing.assert_allclose(thermal_load(rig, cycle), reported.thermal_load, rtol=1e-3)


def jump(seconds):
    """A cycle whose velocity changes by 0.5 m/s within `seconds`, and changes back."""
    times = [0.0, 0.01, 0.05, 0.05 + seconds, 0.09, 0.1]
    speed = [0.0, -0.1, -0.1, 0.4, 0.0, 0.0]
    position = np.concatenate(
        [[0], np.cumsum(np.diff(times) * (np.array(speed[1:]) + speed[:-1]) / 2)]
    )
    position[-1] = position[-2] = 0.0
    states = [np.outer(row, [1.0, 0, 0]) for row in (position, speed, np.zeros(6))]
    return PlateCycle.from_knots(times, *states)


@pytest.mark.parametrize("seconds", [1e-9, 1e-7, 1e-5, 1e-4])
def test_a_jump_between_two_samples_is_seen(seconds):
    _, _, accel, _ = limit_fractions(RIG, jump(seconds))
    assert accel > 0.5 / seconds / RIG.limits.accel


@pytest.fixture(name="ros")
def _ros():
    """Functions that record motor tables, and starts of cycles at times [s]."""
    pytest.importorskip("rclpy")
    from graph.observer import Record
    from rclpy.serialization import serialize_message
    from record.judge import check_limits

    from plate_core.ros import cycle_to_msg, motors_to_msg, to_time

    def faults(cycles=(), starts=()):
        stamp = to_time(1)
        tables = [serialize_message(motors_to_msg(RIG, cycle, stamp)) for cycle in cycles]
        starts = [
            serialize_message(cycle_to_msg(cycle, to_time(round(1e9 * at)))) for at, cycle in starts
        ]
        return list(check_limits(Record(tables=tables, starts=starts), RIG).faults)

    return faults


CALM = shaking(0.0005, 0.3)
FIRST, SECOND = cut(CALM, 0, 16), cut(CALM, 16, 32)
OTHER = cut(shaking(0.0004, 0.3), 16, 32)


def test_a_recording_that_begins_in_motion_is_a_fault(ros):
    assert ros([FIRST, SECOND]) == []
    [fault] = ros([SECOND])
    assert fault.startswith("motor table 0: begins neither at rest nor in the end of another")
    assert len(ros([FIRST, OTHER])) == 1


def test_a_table_that_continues_an_earlier_one_must_not_be_played_in_between(ros):
    """The tables are valid, because the device refuses one that comes too late."""
    third = cut(CALM, 32, 48)
    tables = [FIRST, SECOND, third]
    assert ros(tables, [(0, FIRST), (0.1, SECOND), (0.2, third), (0.3, third.tail)]) == []
    assert ros(tables, [(0, FIRST), (0.1, FIRST.tail), (0.15, PlateCycle.rest(0.1))]) == []
    [fault] = ros(tables, [(0, FIRST), (0.1, third)])
    assert fault.startswith("cycle started at 0.100 s: the plate jumps by ")
    assert len(ros(tables, [(0, FIRST), (0.1, PlateCycle.rest(0.1))])) == 1
    assert len(ros(tables, [(0, PlateCycle.rest(0.1)), (0.1, SECOND)])) == 1
    # Published again, or a report between them was lost.
    assert ros(tables, [(0, FIRST), (0, FIRST), (0.1, SECOND)]) == []
    assert ros(tables, [(0, FIRST), (0.2, third)]) == []
