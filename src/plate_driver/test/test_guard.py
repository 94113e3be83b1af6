"""No sequence of inputs whatever makes an applied setpoint break a limit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from scipy.integrate import trapezoid
from scipy.interpolate import BPoly

from plate_core import CycleError, PlateCycle, PlateError, load_rig
from plate_core.motion import corner_accel, motor_state
from plate_driver.calibration.response import Response
from plate_driver.setpoints.guard import Guard

RIG = load_rig()
LIMITS = RIG.limits
EXCESS = 1e-5
"""Excess of a limit by rounding [fraction]."""

SIZES = st.sampled_from([0.0, 1e-9, 1e-4, 1e-3, 0.01, 1.0, 1e4, 1e60, 1e200, np.nan, np.inf])
TIMES = st.sampled_from([0.0, 1e-4, 0.02, 0.2, 3.0, 1e6])
STAMPS = st.one_of(st.integers(-(2**31), 2**62), st.integers(0, 10**10))


def wild_cycle(seed: int, knots: int, size: float, period: float, smooth: int) -> PlateCycle:
    """Any content of a message; CycleError if it is no cycle."""
    rng = np.random.default_rng(seed)
    rate = [1.0, knots / period, (knots / period) ** 2]
    times = np.append(0.0, np.cumsum(rng.uniform(0.05, 1, knots)))
    states = [size * r * rng.normal(size=(knots + 1, 3)) for r in rate]
    if smooth:  # from rest to rest, as the solver's are
        shape = np.sin(np.pi * times / times[-1])[:, None] ** 4
        states = [states[0] * shape, states[1] * shape, states[2] * shape]
    if seed % 7:
        for state in states:
            state[-1] = state[0]
    if seed % 11 == 5:
        times[knots // 2] = times[-1]  # unsorted
    return PlateCycle.from_knots(times * period / times[-1], *states)


def used_fractions(table) -> dict[str, float]:
    """Use of the limits by other means than the driver's: scipy's splines, densely sampled."""
    states = np.stack([table.q, table.qd, table.qdd], axis=1)  # (k, 3, 4)
    spline = BPoly.from_derivatives(table.cycle.times.copy(), states)
    t = (table.cycle.times[:-1, None] + np.diff(table.cycle.times)[:, None] * U).ravel()
    pose, twist, accel = table.cycle.pose(t), table.cycle.twist(t), table.cycle.accel(t)
    found = {
        "stroke": np.max(np.abs(spline(t))) / LIMITS.stroke_m,
        "speed": np.max(np.abs(spline(t, 1))) / LIMITS.speed,
        "accel": np.max(corner_accel(RIG, pose, twist, accel)) / LIMITS.accel,
    }
    # Newton and Euler for a uniform plate, motors by least squares at home.
    inertia = RIG.plate.mass_kg * (RIG.plate.length_m**2 + RIG.plate.width_m**2) / 12
    lever, _, _ = motor_state(RIG, 1e-7 * np.eye(3), np.zeros((3, 3)), np.zeros((3, 3)))
    wrench = accel * [RIG.plate.mass_kg, RIG.plate.mass_kg, inertia]
    force = wrench @ np.linalg.pinv(lever / 1e-7).T
    found["force"] = np.max(np.abs(force)) / LIMITS.force
    load = trapezoid(force**2, t, axis=0) / t[-1]
    return found | {"load": load / LIMITS.continuous_force**2}


U = np.linspace(0, 1, 33)


class Anything(RuleBasedStateMachine):
    """The driver's guard under whatever may come, and a heat model of its own that integrates."""

    def __init__(self) -> None:
        super().__init__()
        self.guard = Guard(RIG)
        self.now = 100.0
        self.applied = self.guard.table
        self.load = np.zeros(4)
        self.heat = np.zeros(4)

    def take(self, guard: Guard) -> None:
        self.guard = guard
        if guard.table is None:  # the motors rest by themselves
            self.load = np.zeros(4)
        if guard.table is None or guard.table is self.applied:
            return
        self.applied = guard.table
        found = used_fractions(guard.table)
        self.load = found.pop("load")
        for name, fraction in found.items():
            if name != "accel" or self.guard.correction is None:
                assert fraction <= 1 + EXCESS, f"{name}: {fraction}"
        assert np.all(np.abs(guard.table.q[[0, -1]]) < 3e-5)
        assert np.all(np.isfinite(guard.table.qdd))

    @rule(
        seed=st.integers(0, 10**6), knots=st.integers(1, 40), size=SIZES, smooth=st.integers(0, 1),
        period=st.sampled_from([1e-3, 0.01, 0.05, 0.2, 1.0, 9.9, 20.0]), stamp=STAMPS,
    )  # fmt: skip
    def a_cycle_comes(self, seed, knots, size, smooth, period, stamp):
        try:
            with np.errstate(all="ignore"):
                guard, scaled = self.guard.accepted(
                    wild_cycle(seed, knots, size, period, smooth), stamp, self.now
                )
        except PlateError:
            self.guard = self.guard.refused()
            return
        assert scaled.factor <= 1
        self.take(guard)

    @rule(strong=st.integers(1, 5))
    def the_hardest_cycle_is_repeated(self, strong):
        t = np.arange(64) / 64
        pose = np.outer(np.sin(2 * np.pi * t * strong) * np.sin(np.pi * t) ** 4, [1, 1, 3.0])
        guard, stamp = self.guard, (self.guard.last_ns or 0) + 1
        self.take(guard.accepted(PlateCycle.from_samples(0.2, pose), stamp, self.now)[0])

    @rule(wait=TIMES)
    def time_goes_by(self, wait):
        """The watchdog looks every 20 ms of it."""
        if wait >= 0:
            steps = min(100, max(1, round(wait / 0.02)))
            for _ in range(steps):
                self.now += wait / steps if wait < 10 else 0.02
                span = wait / steps if wait < 10 else 0.02
                decay = np.exp(-span / LIMITS.thermal_time_s)
                self.heat = self.load + (self.heat - self.load) * decay
                self.take(self.guard.at_time(self.now)[0])

    @rule(back=st.sampled_from([1e-4, 0.2, 1.5, 1e6]))
    def the_clock_is_put_back(self, back):
        back = min(back, self.now - 1e-9)
        self.now -= back
        self.take(self.guard.at_time(self.now)[0])
        assert back < 1.1 or self.guard.table is None

    @rule()
    def the_plate_is_stopped(self):
        self.take(self.guard.resting(self.now))
        assert self.guard.table is None

    @precondition(lambda self: self.guard.table is None)
    @rule(gain=st.floats(0.05, 20), seed=st.integers(0, 100))
    def something_was_learned(self, gain, seed):
        rng = np.random.default_rng(seed)
        matrix = gain * (np.eye(3) + 0.3 * rng.normal(size=(20, 3, 3)) * (1 + 1j))
        response = Response(np.arange(1.0, 21) * 5, matrix, 0.33)
        self.guard = Guard(RIG, correction=response.command)

    @invariant()
    def motors_stay_cool(self):
        assert np.all(self.heat <= 1 + 1e-3)


Anything.TestCase.settings = settings(
    max_examples=40, stateful_step_count=25, deadline=None, derandomize=True,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
TestAnything = Anything.TestCase


def test_the_checker_detects_an_exceeded_limit():
    """A guard that lets everything through would be found out."""
    guard, _ = Guard(RIG).accepted(wild_cycle(1, 12, 1e-3, 0.2, 1), 1, 0.0)
    table = guard.table
    for factor in (1.01, 10.0):
        wrong = type(table)(0, table.cycle, factor * table.q, factor * table.qd, factor * table.qdd)
        used = used_fractions(wrong)
        assert used["stroke"] == pytest.approx(factor * used_fractions(table)["stroke"])
    assert max(v for k, v in used_fractions(table).items() if k != "load") > 0.99


def test_a_refused_cycle_does_not_change_the_guard():
    guard, _ = Guard(RIG).accepted(wild_cycle(1, 12, 1e-4, 0.2, 1), 10**9, 0.0)
    with pytest.raises(CycleError, match="is older than the last"):
        guard.accepted(wild_cycle(1, 12, 1e-4, 0.2, 1), 10**9 - 1, 0.1)


def test_when_cycles_cease_to_come_the_plate_counts_as_resting():
    cycle = wild_cycle(1, 12, 1e-4, 0.2, 1)
    guard, _ = Guard(RIG, hold_cycles=5).accepted(cycle, 1, 10.0)
    assert guard.plays == 5
    assert guard.at_time(10.9999) == (guard, False)
    rested, over = guard.at_time(11.0001)
    assert over
    assert rested.table is None
    assert rested.at_time(20.0) == (rested, False)  # reported once
    # Motors that hold for less than that are not taken to go on.
    guard, _ = Guard(RIG, hold_cycles=5, hold_s=0.5).accepted(cycle, 1, 10.0)
    assert guard.plays == 2
    assert guard.at_time(10.4001)[1]


def test_a_clock_that_is_set_back_invalidates_earlier_cycles():
    """As after a restart of the simulator: its clock can arrive a little later than its images."""
    cycle = wild_cycle(1, 12, 1e-4, 0.2, 1)
    guard, _ = Guard(RIG).accepted(cycle, 100 * 10**9, 100.0)
    assert guard.at_time(99.1) == guard.at_time(0.0) == (guard, False)
    rested, over = guard.at_time(2.0)
    assert over
    assert (rested.table, rested.sent_at) == (None, 2.0)  # silence counts from here on
    again, _ = rested.accepted(cycle, 2 * 10**9, 2.1)
    assert again.statistics.late == 0.0
    assert not again.at_time(2.2)[1]
    assert again.at_time(2.1 + again.lasts_s + 0.01)[1]


def test_an_experiment_lasts_less_than_motors_hold_and_leaves_no_trace():
    from plate_driver.calibration.calibration import Calibration

    before = Guard(RIG, hold_s=10.0)
    calibration = Calibration.start(RIG)
    guard, _ = before.experimenting(calibration.cycle, 0.0)
    assert guard.plays * guard.table.cycle.period <= 10.0
    assert (guard.plays - 1) * guard.table.cycle.period >= calibration.duration - 1e-9
    assert guard.after_experiment(before).hold_cycles == before.hold_cycles


def test_hot_motors_get_less():
    """At full force for minutes: the fraction that may be used falls to the continuous one."""
    limits = replace(LIMITS, continuous_force=5.0, thermal_time_s=5.0)
    small = Guard(replace(RIG, limits=limits))
    t = np.arange(64) / 64
    pose = np.outer(np.sin(4 * np.pi * t) * np.sin(np.pi * t) ** 4, [0.005, 0, 0])
    cycle = PlateCycle.from_samples(0.2, pose)
    factors = []
    now = 0.0
    guard = small
    for k in range(150):
        guard, scaled = guard.accepted(cycle, k, now)
        factors.append(scaled.factor)
        now += 0.2
    assert factors[0] == pytest.approx(max(factors))
    assert factors[-1] < 0.8 * factors[0]
    assert float(np.max(guard.thermal.at_time(guard.rig, now).rise)) == pytest.approx(1, abs=0.02)
    assert scaled.usage.thermal_load.max() == pytest.approx(1, abs=0.02)
