"""Cycles streamed by the driver's transport to the device, in simulated time, over bad lines."""

import numpy as np
import pytest
from cuts import cut

from harness.serial import PlateCheck, open_port
from plate_core import CycleError, PlateCycle, load_rig
from plate_core.serial_protocol import State
from plate_driver.setpoints import MotorTable
from plate_driver.transports import LEAD_S, Condition, SerialTransport
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule, LineFaults

RIG = load_rig()
PERIOD_S = 0.2


def swing(size: float) -> MotorTable:
    """(1 - cos)^2 along x and y, at rest at both ends [m]."""
    t = np.linspace(0, PERIOD_S, 33)
    w = 2 * np.pi / PERIOD_S
    c, s = np.cos(w * t), np.sin(w * t)
    wave = [(1 - c) ** 2, 2 * w * (1 - c) * s, 2 * w**2 * (s**2 + c - c**2)]
    states = [np.outer(row, [size / 4, -size / 8, 0]) for row in wave]
    for state in states:
        state[[0, -1]] = 0
    return MotorTable.of(RIG, PlateCycle.from_knots(t, *states), 1)


class Bench:
    """Transport, line and device; notes each setpoint."""

    def __init__(self, trouble: LineFaults) -> None:
        self.judge = PlateCheck(RIG)
        self.travel: list[float] = []
        self.emulator = Emulator(DeviceLimits.of_rig(RIG), 2, FaultSchedule(trouble), self.see)
        self.transport = SerialTransport(
            lambda: open_port(self.emulator), lambda: self.emulator.now, 1, streams=True
        )
        self.transport.open()
        self.enable()

    def enable(self) -> None:
        """A person enables."""
        end = self.emulator.now + 5.0
        while self.transport.report().condition is not Condition.OFF and self.emulator.now < end:
            self.run(0.1)
        order = self.transport.enable()
        while not order.completed and self.emulator.now < end:
            self.run(0.1)
        assert order.done, order.failure

    def see(self, now: float, at: np.ndarray | None) -> None:
        self.judge.update(now, at)
        self.travel.append(float("nan") if at is None else float(at[0, 0]))

    def run(self, seconds: float, polls: bool = True) -> None:
        for tick in range(round(seconds * 1e3)):
            self.emulator.tick()
            if polls and tick % 5 == 0:
                self.transport.poll()

    @property
    def state(self) -> State:
        return self.emulator.state


@pytest.mark.parametrize(
    "trouble",
    [
        LineFaults(baud=921_600.0),
        LineFaults(dropped=3e-4, corrupted=3e-4, repeated=3e-4, split=0.3, baud=921_600.0),
        LineFaults(delay=0.02),
    ],
)
def test_cycles_are_streamed_and_the_newest_follows(trouble):
    bench = Bench(trouble)
    bench.transport.send(swing(0.004), 50)
    bench.run(2.5)
    assert bench.state is State.PLAYING
    assert np.nanmax(bench.travel[-400:]) == pytest.approx(0.004, rel=0.01)
    bench.transport.send(swing(0.002), 50)
    bench.run(1.0)
    assert np.nanmax(bench.travel[-400:]) == pytest.approx(0.002, rel=0.01)
    assert bench.state is State.PLAYING
    assert bench.transport.troubles() == []
    assert 0.1 < bench.transport.min_lead_s < LEAD_S
    assert (bench.transport.retries > 5) == bool(trouble.dropped)
    bench.transport.stop()
    bench.run(1.5)
    assert bench.state is State.OFF
    assert bench.judge.verdict().kept


@pytest.mark.parametrize("away", ["host", "line"])
def test_an_interrupted_host_or_device_brakes_the_plate_until_a_person_enables(away):
    bench = Bench(LineFaults())
    bench.transport.send(swing(0.008), 50)
    bench.run(2.0)
    if away == "host":
        bench.run(0.4, polls=False)
        assert bench.state in (State.BRAKING, State.OFF)
    else:
        bench.emulator.disconnect()
    bench.run(5.0)
    assert bench.state is State.OFF  # until a person has checked
    assert bench.transport.troubles()
    bench.enable()
    bench.transport.send(swing(0.008), 50)
    bench.run(2.0)
    assert bench.state is State.PLAYING
    assert np.nanmax(bench.travel[-400:]) == pytest.approx(0.008, rel=0.01)
    assert away == "line" or bench.transport.min_lead_s < 0.1
    assert bench.judge.verdict().kept


def test_a_stream_continues_in_motion_or_is_brought_to_rest():
    """With cycles that are longer than the stream is ahead; a device in motion brakes if its stream
    is broken off."""
    times, *states = swing(0.004).cycle.knots
    slow = [state * 0.25**order for order, state in enumerate(states)]
    whole = PlateCycle.from_knots(4 * times, *slow)
    first, second = (MotorTable.of(RIG, cut(whole, *k, 0.2), 1) for k in ((0, 18), (18, 30)))
    bench = Bench(LineFaults())
    bench.transport.send(first, 1)
    bench.run(0.1)
    bench.transport.send(second, 1)
    bench.run(0.8)
    assert bench.state is State.PLAYING  # 0.45 s and 0.3 s, and then 0.2 s of the tail
    bench.run(0.4)
    assert bench.state is State.READY
    assert bench.travel[-1] == 0
    bench.transport.send(first, 1)
    bench.run(0.25)
    with pytest.raises(CycleError, match="not in the final state of the current cycle"):
        bench.transport.send(second, 1)
    bench.run(1.0)
    assert bench.state is State.READY
    with pytest.raises(CycleError, match="begins in motion, but the plate is at rest"):
        bench.transport.send(second, 1)
    assert bench.transport.troubles() == []
    assert bench.judge.verdict().kept


def dense(pieces: int, period_s: float) -> MotorTable:
    """`swing` with this number of pieces in this time."""
    times, *states = swing(0.0004).cycle.knots
    speed = PERIOD_S / period_s
    slow = PlateCycle.from_knots(
        times / speed, *(state * speed**order for order, state in enumerate(states))
    )
    t = np.linspace(0, period_s, pieces + 1)
    return MotorTable.of(
        RIG, PlateCycle.from_knots(t, slow.pose(t), slow.twist(t), slow.accel(t)), 1
    )


@pytest.mark.parametrize(
    ("pieces", "period_s", "plays", "ahead"),
    [
        (600, 0.25, 1, 602),
        (505, 0.25, 1, 0),
        (600, 0.5, 1, 0),
        (760, 0.5, 1, 517),
        (160, 0.1, 4, 545),
        (160, 0.1, 3, 0),
    ],
)
def test_a_table_that_the_device_cannot_store_ahead_is_refused(pieces, period_s, plays, ahead):
    """A stream begins only after its first setpoints were stored. Without the check, a dense one
    would never begin, and the driver would report nothing."""
    bench, table = Bench(LineFaults()), dense(pieces, period_s)
    if ahead:
        with pytest.raises(
            CycleError, match=f"plate_cycle: {ahead} setpoints within 0.34 s, allow"
        ):
            bench.transport.send(table, plays)
    else:
        bench.transport.send(table, plays)
        bench.run(0.6)
        assert np.nanmax(np.abs(bench.travel)) > 1e-4
    bench.run(1.0)
    bench.transport.send(swing(0.004), 1)
    bench.run(0.4)
    assert np.nanmax(bench.travel) > 0.003
    assert bench.judge.verdict().kept


def test_a_stream_ends_at_rest_without_further_cycles():
    """The host has nothing more to send: no fault, and the next cycle needs no enable."""
    bench = Bench(LineFaults(baud=921_600.0))
    bench.transport.send(swing(0.004), 3)
    bench.run(0.6)
    assert bench.state is State.PLAYING
    bench.run(1.0)
    assert bench.state is State.READY
    assert bench.transport.troubles() == []
    moved = np.array(bench.travel)
    plays = np.sum((moved[1:] > 0.002) & (moved[:-1] <= 0.002))
    assert plays == 3
    bench.transport.send(swing(0.002), 2)
    bench.run(0.3)
    assert bench.state is State.PLAYING
    bench.run(1.0)
    assert bench.state is State.READY
    assert np.nanmax(bench.travel[-1200:]) == pytest.approx(0.002, rel=0.01)
    assert bench.judge.verdict().kept
