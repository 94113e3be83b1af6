"""Each reason of the driver is provoked, by the C firmware in simulated time or by a defect."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest
from simulated_firmware import (
    RIG,
    SimulatedFirmware,
    enabled,
    link,
    pass_time,
    play,
    settled,
    shaking,
)

from plate_core.driver_status import DriverReason, DriverState
from plate_core.serial_protocol import (
    Reader,
    Telemetry,
    frame,
    parse,
)  # fmt: skip
from plate_driver.status import driver_status
from plate_driver.transports import (
    Latch,
    Measured,
    SerialTransport,
    TransportThread,
)  # fmt: skip

Provoke = Callable[[SimulatedFirmware, Latch], SerialTransport | TransportThread]

PROVOKE: dict[DriverReason, tuple[DriverState, Provoke]] = {}
"""By reason: the state that has it, and a function that brings motors and latch there."""


def provokes(reason: DriverReason, state: DriverState) -> Callable[[Provoke], Provoke]:
    def keep(provoke: Provoke) -> Provoke:
        PROVOKE[reason] = state, provoke
        return provoke

    return keep


@provokes(DriverReason.NONE, DriverState.READY)
def provoke_nothing(firmware, latch):
    return enabled(firmware)


def stopped_by(firmware: SimulatedFirmware, latch: Latch, reason: DriverReason) -> SerialTransport:
    transport = enabled(firmware)
    play(firmware, transport, 0.3)
    latch.close(reason)
    settled(firmware, transport, transport.stop(cut=reason is DriverReason.POWER_CUT))
    pass_time(firmware, transport, 1.0)
    return transport


for by_person in (DriverReason.SWITCHED_OFF, DriverReason.EMERGENCY_STOP, DriverReason.POWER_CUT):
    off = by_person is DriverReason.SWITCHED_OFF
    state = DriverState.DISABLED if off else DriverState.STOPPED
    PROVOKE[by_person] = state, partial(stopped_by, reason=by_person)

EVENTS = {
    DriverReason.SUPPLY: (DriverState.STOPPED, lambda board: board.order("fault 8")),
    # A failing supply may be its doing.
    DriverReason.HARDWARE: (DriverState.STOPPED, lambda board: board.order("fault 24")),
    DriverReason.DEVICE_RESET: (DriverState.STOPPED, lambda board: board.order("reset")),
    DriverReason.NO_ANSWER: (DriverState.ERROR, lambda board: setattr(board, "loss", 1.0)),
    DriverReason.PORT: (DriverState.ERROR, lambda board: setattr(board, "cut", True)),
}
"""Event on a board with current, and the state after it."""


def provoke_event(firmware, latch, event):
    transport = enabled(firmware)
    event(firmware)
    pass_time(firmware, transport, 2.0)
    return transport


for happened, (state, event) in EVENTS.items():
    PROVOKE[happened] = state, partial(provoke_event, event=event)


@provokes(DriverReason.EARLIER_STOP, DriverState.STOPPED)
def provoke_earlier_stop(firmware, latch):
    before = enabled(firmware)
    settled(firmware, before, before.stop())
    before.close()
    transport = link(firmware, seed=8)
    pass_time(firmware, transport, 1.0)
    return transport


@provokes(DriverReason.HOST_SILENT, DriverState.STOPPED)
def provoke_host_silent(firmware, latch):
    transport = enabled(firmware)
    for _ in range(800):  # without polls
        firmware.tick()
    pass_time(firmware, transport, 0.2)
    return transport


@provokes(DriverReason.LIMIT, DriverState.STOPPED)
def provoke_limit(firmware, latch):
    transport = link(firmware)
    firmware.order("place 0.0101")  # [m]: no way leads home from there
    pass_time(firmware, transport, 0.5)
    assert settled(firmware, transport, transport.enable()).failure
    return transport


@provokes(DriverReason.HEAT, DriverState.STOPPED)
def provoke_heat(firmware, latch):
    firmware.options = "0.005", "20"  # quicker than the table, which as a whole is allowed
    firmware.reset()
    transport = enabled(firmware)
    transport.send(shaking(0.002), 50)
    pass_time(firmware, transport, 1.5)
    return transport


@provokes(DriverReason.FOLLOWING, DriverState.STOPPED)
def provoke_following(firmware, latch):
    transport = enabled(firmware)
    transport.send(shaking(0.008), 50)
    pass_time(firmware, transport, 0.5)
    firmware.order("jam 1")
    pass_time(firmware, transport, 0.5)
    return transport


@provokes(DriverReason.DEVICE_CLOCK, DriverState.STOPPED)
def provoke_device_clock(firmware, latch):
    transport = enabled(firmware)
    play(firmware, transport, 0.5)
    firmware.fast = 0.2
    pass_time(firmware, transport, 2.0)
    return transport


@provokes(DriverReason.NO_TELEMETRY, DriverState.ERROR)
def provoke_no_telemetry(firmware, latch):
    transport = enabled(firmware)
    read, reader = firmware.read, Reader()

    def read_without(size: int) -> bytes:
        nonlocal reader
        reader, packets = reader.fed(read(size))
        kept = [data for data in packets if not isinstance(parse(data).message, Telemetry)]
        return b"".join(map(frame, kept))

    firmware.read = read_without
    pass_time(firmware, transport, 0.7)
    return transport


@provokes(DriverReason.WRONG_DEVICE, DriverState.ERROR)
def provoke_wrong_device(firmware, latch):
    limits = replace(RIG.limits, stroke_m=0.02)
    transport = SerialTransport(firmware.opened, lambda: firmware.now, 7, limits=limits)
    transport.open()
    pass_time(firmware, transport, 0.5)
    return transport


@provokes(DriverReason.DEFECT, DriverState.ERROR)
def provoke_defect(firmware, latch):
    transport = enabled(firmware)

    def poll() -> list[Measured]:
        raise RuntimeError("a defect")

    transport.poll = poll
    thread = TransportThread(transport, latch, lambda error: None)
    thread.poll()
    return thread


@provokes(DriverReason.STOP_UNANSWERED, DriverState.ERROR)
def provoke_stop_unanswered(firmware, latch):
    transport = enabled(firmware)
    firmware.loss = 1.0
    latch.close(DriverReason.EMERGENCY_STOP)
    latch.late = settled(firmware, transport, transport.stop())
    pass_time(firmware, transport, 1.0)
    return transport


OTHERS = {DriverReason.OTHER: "test_trajectory_relay.py"}
"""Provoked there: no transport of ours has it."""


@pytest.mark.parametrize(
    "reason", [r for r in DriverReason if r not in OTHERS], ids=lambda reason: reason.name
)
def test_every_reason_of_the_driver_can_be_provoked(firmware, reason):
    latch = Latch()
    state, provoke = PROVOKE[reason]
    motors = provoke(firmware, latch)
    report = motors.report if isinstance(motors, TransportThread) else motors.report()
    status = driver_status(True, latch, report, calibrating=False)
    assert (status.state, status.reason) == (state, reason), status
    assert status.text.startswith(state.name.lower())
