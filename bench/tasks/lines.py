"""Serial lines of different speed, quality and latency: played tables, and time to a stop."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import Cache, Result, Table, by_case
from harness.serial import POLL_TICKS, Operator, Port
from plate_core import CycleError, load_rig
from plate_core.motion import HOLD_CYCLES
from plate_core.serial_protocol import State
from plate_driver.transports import Condition, SerialTransport
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule, LineFaults
from stages.device import PERIOD_S, shaking_table

BAUDS = (57_600, 115_200, 230_400, 460_800, 921_600)
LOST = (0.0, 0.01, 0.03, 0.05)
DELAYS_S = (0.0, 0.02, 0.1)

PIECES = 64
PLAY_S = 60.0
"""Simulated time during which a cycle is sent in each period [s]."""

BEGIN_S, STOP_S = 30.0, 5.0
"""Maximum time until the motors are ready, and until they brake [s]."""

STOPS = 5
"""Number of stops during motion."""


def line_run(baud: int, lost: float, delay_s: float, play_s: float, stops: int) -> dict[str, Any]:
    """Send a new cycle in each period over a simulated serial line. Then stop the device a few
    times, and return a row of results."""
    trouble = LineFaults(baud=float(baud), dropped=lost, delay=delay_s)
    emulator = Emulator(DeviceLimits.of_rig(load_rig()), 1, FaultSchedule(trouble))
    transport = SerialTransport(lambda: Port(emulator), lambda: emulator.now, 1, baud=float(baud))
    operator = Operator(transport)
    tables = [shaking_table(PIECES, size) for size in (5e-4, 6e-4)]
    transport.open()
    played: list[int] = []
    sent, due = [0], [0.0]

    def run(seconds: float, plays: bool, until: Any = None) -> None:
        """Simulate for some time. If `plays` is True, send a cycle in each period, unless the
        transport refuses it."""
        for tick in range(round(seconds * 1e3)):
            emulator.tick()
            if plays and emulator.now >= due[0]:
                due[0] = emulator.now + PERIOD_S
                try:
                    transport.send(tables[sent[0] % 2], HOLD_CYCLES)
                    sent[0] += 1
                except CycleError:
                    pass
            if tick % POLL_TICKS == 0:
                transport.poll()
                operator.check(emulator.now)
            playing = emulator.device.playing
            if plays and playing and playing != (played[-1] if played else 0):
                played.append(playing)
            if until is not None and until():
                return

    def ready() -> bool:
        return transport.report().condition is Condition.READY

    run(BEGIN_S, False, ready)
    row: dict[str, Any] = {"baud": baud, "lost": 100 * lost, "delay_ms": 1e3 * delay_s}
    if not ready():
        return row | {"tables": 0.0}
    enables = operator.enables
    run(play_s, True)
    times = []
    # number of enable commands after stops that were not requested
    own_stops = operator.enables - enables
    count = len(played)
    for _ in range(stops):
        run(BEGIN_S, True, lambda: emulator.state is State.PLAYING)
        if emulator.state is not State.PLAYING:
            break
        began = emulator.now
        transport.stop()
        run(STOP_S, False, lambda: emulator.state in (State.BRAKING, State.OFF))
        times.append(1e3 * (emulator.now - began))
        run(BEGIN_S, False, ready)
    return row | {
        "tables": 60 * count / play_s,
        "stops_own": own_stops,
        "brake_ms": float(np.median(times)) if times else None,
        "brake_most_ms": max(times) if times else None,
    }


def measure(quick: bool) -> Result:
    """Run all lines. A quick measurement uses only the fastest line and a slow line."""
    bauds, lost, delays = ((115_200, 921_600), (0.0, 0.03), (0.0, 0.1)) if quick else (
        BAUDS, LOST, DELAYS_S
    )  # fmt: skip
    seconds, stops = (5.0, 1) if quick else (PLAY_S, STOPS)
    kinds = [(b, n, d, seconds, stops) for b in bauds for n in lost for d in delays]
    found = by_case(line_run, {kind: [kind] for kind in kinds}, Cache.of(__name__))
    rows = [row for [row] in found.values()]
    facts = {"pieces": PIECES, "period": 1e3 * PERIOD_S, "seconds": seconds}
    return Result([Table.of("lines", rows, **facts)])
