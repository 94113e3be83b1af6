"""The example of a transport: tables to a trajectory controller, which is played here by its rules:
the newest trajectory replaces the last at once, quintics lead from the state now to its first point
and from point to point, the last point is held."""

import sys
from pathlib import Path

import numpy as np
import pytest
from cuts import cut
from scipy.interpolate import BPoly
from shaking import shaking

from plate_core import CycleError, load_rig
from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_driver.setpoints import MotorTable, prepare
from plate_driver.status import CHECK_RIG, driver_status
from plate_driver.transports import Condition, Latch

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "plate_trajectory_controller"
RIG = load_rig()
PERIOD, TICK = 0.1, 1e-3


@pytest.fixture(name="relay_module")
def _relay_module(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLE))
    import plate_trajectory_controller.relay as relay

    yield relay
    for name in [name for name in sys.modules if name.startswith("plate_trajectory_controller")]:
        del sys.modules[name]


class Controller:
    """Relay, controller and motors that follow their commands."""

    def __init__(self, module) -> None:
        self.now, self.speaks, self.jammed = 0.0, True, False
        self.state = np.zeros((3, 4))
        self.rows: list[np.ndarray] = []
        self.published: list[MotorTable] = []
        self._way: BPoly | None = None
        self._began = self._end = 0.0
        self.relay = module.Relay(RIG, self.command, self.published.append, lambda: self.now)

    def command(self, way) -> None:
        times = way.times
        states = np.stack([way.position, way.velocity, way.acceleration], axis=1)
        if times[0] > 0:
            times = np.append(0.0, times)
            states = np.concatenate([self.state[None], states])
        self._way = BPoly.from_derivatives(times.copy(), states)
        self._began, self._end = self.now, float(times[-1])

    def run(self, seconds: float) -> None:
        for tick in range(round(seconds / TICK)):
            self.now += TICK
            if self._way is not None:
                t = min(self.now - self._began, self._end)
                self.state = np.stack([self._way(t, nu) for nu in range(3)])
                if t == self._end:
                    self.state[1:] = 0
            self.rows.append(self.state)
            if self.speaks and tick % 5 == 0:
                self.relay.receive(self.state[0])
            if tick % 3 == 0:
                self.relay.poll()


@pytest.fixture(name="rig")
def _rig(relay_module):
    return Controller(relay_module)


def table(amplitude: float) -> MotorTable:
    return prepare(RIG, shaking(amplitude), 1)[0]


def check(rig: Controller) -> None:
    rows = np.array(rig.rows)
    for values, limit in zip(
        (rows[:, 0], rows[:, 1], rows[:, 2]),
        (RIG.limits.stroke_m, RIG.limits.speed, RIG.limits.accel),
        strict=True,
    ):
        assert np.max(np.abs(values)) <= limit
    steps = np.abs(np.diff(rows[:, 0], axis=0))
    assert np.max(steps) <= RIG.limits.speed * TICK


def test_the_relay_does_not_move_before_an_enable(rig):
    assert rig.relay.report().condition is Condition.GONE
    rig.run(0.1)
    report = rig.relay.report()
    assert report.condition is Condition.OFF
    assert driver_status(True, Latch(), report, calibrating=False) == DriverStatus(
        DriverState.STOPPED, DriverReason.OTHER, f"stopped: {report.text}; {CHECK_RIG}"
    )
    with pytest.raises(CycleError, match="the motors are off"):
        rig.relay.send(table(0.001), 3)
    rig.run(0.2)
    assert not np.any(rig.state)


def test_tables_are_played_and_rest_by_themselves(rig):
    rig.run(0.1)
    assert rig.relay.enable().done
    rig.relay.send(table(0.001), 3)
    rig.run(0.25)
    rig.relay.send(table(0.0005), 2)
    rig.run(1.0)
    check(rig)
    peaks = np.max(np.abs(np.array(rig.rows)[:, 0]), axis=1)
    moving = np.flatnonzero(peaks > 1e-9)
    assert 0.45 < (moving[-1] - moving[0]) * TICK < 0.55  # three and two times 0.1 s
    assert peaks[moving[0] + 350 :].max() < 0.6 * peaks.max()
    assert len(rig.published) == 2
    assert not np.any(rig.state)


def test_a_cycle_with_a_tail_is_played_to_rest_and_none_in_motion(rig):
    cycle = cut(shaking(0.001), 0, 18)
    rig.run(0.1)
    rig.relay.enable()
    rig.relay.send(MotorTable.of(RIG, cycle, 1), 1)
    rig.run(0.3)
    check(rig)
    moving = np.flatnonzero(np.max(np.abs(np.array(rig.rows)[:, 0]), axis=1) > 1e-9)
    assert (moving[-1] - moving[0]) * TICK == pytest.approx(cycle.period + 0.05, abs=0.01)
    assert not np.any(rig.state)
    with pytest.raises(CycleError, match="begins in motion, allowed: a cycle that begins at rest"):
        rig.relay.send(MotorTable.of(RIG, cycle.tail, 1), 1)


def test_a_stop_brakes_along_the_path_and_latches(rig):
    rig.run(0.1)
    rig.relay.enable()
    rig.relay.send(table(0.002), 100)
    for moment in (0.113, 0.137, 0.151):
        rig.run(moment)
        order = rig.relay.stop()
        assert not order.completed
        assert rig.relay.enable().failure == "the motors are braking"
        rig.run(1.0)
        assert order.done
        assert np.max(np.abs(rig.state[0])) < 1e-9
        with pytest.raises(CycleError):
            rig.relay.send(table(0.002), 100)
        assert rig.relay.stop().failure == ""  # pressed again
        rig.run(0.2)
        assert rig.relay.enable().done
        rig.relay.send(table(0.002), 100)
    check(rig)


def test_the_relay_refuses_a_power_cut_and_an_enable_without_feedback(rig):
    rig.run(0.1)
    rig.relay.enable()
    rig.relay.send(table(0.002), 100)
    rig.run(0.1)
    assert "cannot cut the current" in rig.relay.stop(cut=True).failure
    rig.speaks = False
    rig.run(0.3)
    assert rig.relay.report().condition is Condition.GONE
    assert "no joint_states" in rig.relay.enable().failure
    order = rig.relay.stop()
    rig.run(1.5)
    assert order.completed
    assert not order.done
