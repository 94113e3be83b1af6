"""A simulated device that runs in real time at a pseudo-terminal, and a test cycle for it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from multiprocessing.synchronize import Event

import numpy as np

from plate_core import PlateCycle, load_rig
from plate_driver.setpoints import MotorTable, prepare
from plate_sim.device import TICK_US, DeviceLimits, Emulator, PseudoTerminal

PERIOD_S = 0.2

MAX_BEHIND_US = 100_000
"""Maximum time that the device simulates at once to catch up with real time [us]. The device falls
behind if its process gets no CPU time."""


def shaking_table(knots: int, amplitude: float) -> MotorTable:
    """Return the table of a cycle that starts at rest. The cycle has the length `PERIOD_S`, a
    number of knots, and an amplitude [m]."""
    t = np.arange(knots) * PERIOD_S / knots
    wave = np.sin(np.pi * t / PERIOD_S) ** 4
    phase = 8 * np.pi * t / PERIOD_S
    pose = amplitude * np.column_stack([wave * np.sin(phase), wave * np.cos(phase), 2 * wave])
    cycle = PlateCycle.from_samples(PERIOD_S, pose)
    twist, accel = cycle.knot_twist.copy(), cycle.knot_accel.copy()
    twist[[0, -1]] = accel[[0, -1]] = 0
    still = PlateCycle.from_knots(cycle.times, cycle.knot_pose, twist, accel)
    return prepare(load_rig(), still, 1)[0]


def run_device(link: str, ready: Event, done: Event) -> Iterator[bytes]:
    """Run the device in real time until `done` is set. At each poll of the port, yield the bytes
    that arrived since the previous poll."""
    emulator, terminal = Emulator(DeviceLimits.of_rig(load_rig())), PseudoTerminal(link)
    terminal.plug()
    ready.set()
    began = time.monotonic_ns()
    while not done.is_set():
        data = terminal.read()
        due = (time.monotonic_ns() - began) // 1_000 - emulator.now_us
        yield data
        began += 1_000 * max(0, due - MAX_BEHIND_US)
        ticks = min(due, MAX_BEHIND_US) // TICK_US
        emulator.to_device.sent(data, emulator.now + ticks * TICK_US * 1e-6)
        for _ in range(ticks):
            emulator.tick()
        terminal.write(emulator.to_host.arrived(emulator.now))
        time.sleep(0.0005)
    terminal.close()
