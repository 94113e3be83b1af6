"""How long an upload takes at 921,600 baud in simulated time; and a device in real time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from multiprocessing.synchronize import Event
from typing import Any

import numpy as np

from harness.serial import Port
from plate_core import PlateCycle, load_rig
from plate_driver.setpoints import MotorTable, prepare
from plate_driver.transports import Condition, SerialTransport
from plate_sim.device import (
    TICK_US,
    DeviceLimits,
    Emulator,
    FaultSchedule,
    LineFaults,
    PseudoTerminal,
)

POLL_S = 0.005
"""The driver's."""

PERIOD_S = 0.2
REPEATS = 50
"""Times that a table is played if no other one comes: as long as a device allows."""

MOST_BEHIND_US = 100_000
"""Time that a device without a processor makes up for; what is more, it loses."""

BEGIN_S = 10.0
"""Longest wait for the first table to be played [s]."""


def shaking(knots: int, amplitude: float) -> MotorTable:
    """Table of a cycle of `PERIOD_S` that starts at rest; amplitude [m]."""
    t = np.arange(knots) * PERIOD_S / knots
    wave = np.sin(np.pi * t / PERIOD_S) ** 4
    phase = 8 * np.pi * t / PERIOD_S
    pose = amplitude * np.column_stack([wave * np.sin(phase), wave * np.cos(phase), 2 * wave])
    cycle = PlateCycle.from_samples(PERIOD_S, pose)
    twist, accel = cycle.knot_twist.copy(), cycle.knot_accel.copy()
    twist[[0, -1]] = accel[[0, -1]] = 0
    still = PlateCycle.from_knots(cycle.times, cycle.knot_pose, twist, accel)
    return prepare(load_rig(), still, 1)[0]


def upload_s(knots: int) -> float:
    """Return the simulated time [s] of an upload to a device that plays."""
    line = FaultSchedule(LineFaults(baud=921_600.0))
    emulator = Emulator(DeviceLimits.of_rig(load_rig()), 0, line)
    transport = SerialTransport(lambda: Port(emulator), lambda: emulator.now, seed=1)
    transport.open()
    every = round(POLL_S * 1e6) // TICK_US

    def wait(ready: Any) -> float:
        began, ticks = emulator.now, 0
        while emulator.now - began < BEGIN_S:
            emulator.tick()
            ticks += 1
            if ticks % every == 0:
                transport.poll()
                if ready():
                    break
        return emulator.now - began

    wait(lambda: transport.report().condition is Condition.OFF)
    transport.enable()
    wait(lambda: transport.report().condition is Condition.READY)
    transport.send(shaking(knots, 0.0005), REPEATS)
    wait(lambda: emulator.device.playing)
    wait(lambda: not transport.busy and not emulator.device.waiting)
    transport.send(shaking(knots, 0.0006), REPEATS)
    return wait(lambda: not transport.busy)


def device(link: str, ready: Event, done: Event) -> Iterator[tuple[bytes, float]]:
    """Be the device, in real time, until told to end.

    Yields what has come from the host since it last looked, and how late its ticks are [s].
    """
    emulator, terminal = Emulator(DeviceLimits.of_rig(load_rig())), PseudoTerminal(link)
    terminal.plug()
    ready.set()
    began = time.monotonic_ns()
    while not done.is_set():
        data = terminal.read()
        due = (time.monotonic_ns() - began) // 1_000 - emulator.now_us
        yield data, 1e-6 * max(0, due - TICK_US)
        began += 1_000 * max(0, due - MOST_BEHIND_US)
        ticks = min(due, MOST_BEHIND_US) // TICK_US
        emulator.to_device.sent(data, emulator.now + ticks * TICK_US * 1e-6)
        for _ in range(ticks):
            emulator.tick()
        terminal.write(emulator.to_host.arrived(emulator.now))
        time.sleep(0.0005)
    terminal.unplug()
