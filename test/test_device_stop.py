"""A stop stays a stop, on both devices: on the wire, every way that might undo it, and any sequence
of messages without an Enable that names the present stop."""

from dataclasses import replace

import numpy as np
import pytest
from device_orders import (
    BOOT,
    ENABLE,
    GENTLE,
    HELLO,
    HOMEWARD,
    READY,
    UPLOAD_S,
    alive,
    run,
    say,
    upload,
    wave,
)  # fmt: skip

from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Begin,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knots,
    Message,
    State,
    Status,
    Stop,
    Telemetry,
)

PLAYING = [*READY, upload(1, GENTLE, 110), UPLOAD_S, 0.05]
STOPPED = [*PLAYING, say(300, Stop(0)), *alive(0.8)]
CUT = [*PLAYING, say(300, Stop(1)), 0.05]
FIRST = BOOT + 1
"""Number of the first stop after the start."""


def enables(*stops: int, first: int = 400) -> list[bytes]:
    return [say(first + i, Enable(stop % 2**16)) for i, stop in enumerate(stops)]


WAYS: dict[str, tuple[list[bytes | float | str], list[bytes | float | str]]] = {
    "the enable from before is repeated": (STOPPED, [ENABLE]),
    "it comes again with a newer number": (STOPPED, enables(BOOT)),
    "any other stop is named": (STOPPED, enables(0, FIRST + 1, FIRST - 2, BOOT + 2**15, 65535)),
    "an enable for an earlier stop": (
        [*STOPPED, say(301, Stop(0)), say(302, Stop(0))],
        enables(BOOT, FIRST, FIRST + 1),
    ),
    "enabled in advance": ([*PLAYING, *enables(FIRST), say(500, Stop(1)), 0.05], [ENABLE]),
    "stopped again while the enable was on its way": (
        [*STOPPED, say(301, Stop(0))],
        enables(FIRST),
    ),
    "stopped again in the same tick": (STOPPED, [b"".join([say(401, Stop(0)), *enables(FIRST)])]),
    "another host says hello": (STOPPED, [say(1, Hello(VERSION, 78)), say(2, Enable(BOOT))]),
    "hello of the same session": (STOPPED, [HELLO, ENABLE]),
    "reset": ([*STOPPED, "reset"], [say(1, Hello(VERSION, 79)), say(2, Enable(BOOT))]),
    "reset while it plays": ([*PLAYING, "reset"], [HELLO, ENABLE, *enables(BOOT, BOOT + 2)]),
    "home": (STOPPED, [say(400, Home())]),
    "a table": (STOPPED, [upload(2, GENTLE, 400)]),
    "the table of before is committed again": (STOPPED, [say(400, Commit(1, 3))]),
    "after the watchdog": ([*PLAYING, 1.2], [say(1, Heartbeat(1)), *enables(BOOT)]),
    "after the watchdog, a table": ([*PLAYING, 1.2], [upload(2, GENTLE, 400)]),
    "the supply dips twice, and the first dip is cleared": (
        [*PLAYING, "fault 8", 0.01, "fault 0", 0.01, "fault 8", 0.01, "fault 0"],
        enables(FIRST),
    ),
    "the supply dips while the motors are off": (
        [*CUT, "fault 8", 0.01, "fault 0"],
        enables(FIRST),
    ),
    "a second fault while there is one": (
        [*CUT, "fault 8", 0.01, "fault 24", 0.01, "fault 0"],
        enables(FIRST, FIRST + 1),
    ),
    "the fault is still there": ([*PLAYING, "fault 8", 0.01], enables(FIRST)),
    "while it brakes": ([*PLAYING, say(300, Stop(0))], []),
    "time passes": (STOPPED, []),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_stop_is_not_cleared(device, way):
    before, after = WAYS[way]
    tried = run(device, *before, *after, say(1, Heartbeat(1)), *alive(1.2))
    assert tried.state is State.OFF
    # Current was switched on once, by the one Enable that was right, and off once.
    assert [on for _, on in tried.switched] == [True, False]
    reported = [p.message for p in tried.packets if isinstance(p.message, Telemetry)]
    assert reported[-1].stop == tried.stop
    assert reported[-1].state is State.OFF


@pytest.mark.parametrize("way", sorted(set(WAYS) - {"the fault is still there"}))
def test_an_enable_for_the_present_stop_clears_it(device, way):
    """So none of the ways was without effect for another reason."""
    before, after = WAYS[way]
    orders = [*before, *after, say(1, Heartbeat(1)), *alive(0.7)]
    stop = run(device, *orders).stop
    session = say(600, Hello(VERSION, 77)) if "reset" in way else b""
    done = run(device, *orders, session, *enables(stop, first=700), *HOMEWARD)
    assert done.answers()[700] is Status.DONE
    assert (done.state, done.faults) == (State.READY, Fault.NONE)


def test_a_stop_that_is_pressed_twice_needs_one_enable_for_the_second(device):
    twice = [*STOPPED, say(301, Stop(0))]
    done = run(device, *twice, *enables(FIRST, FIRST + 1), *HOMEWARD)
    assert done.stop == FIRST + 1
    assert [done.answers()[k] for k in (400, 401)] == [Status.WRONG_STOP, Status.DONE]
    assert done.state is State.READY


def test_a_stop_that_the_line_repeats_is_one(device):
    """The plate is at rest before and after; if this ends a play since the enable, it counts as a
    new stop."""
    again = say(300, Stop(0))
    for orders in (
        [*PLAYING, again, again, *alive(0.8)],
        [*STOPPED, again, again, 0.1],
        [*CUT, say(300, Stop(1)), 0.1],
    ):
        done = run(device, *orders)
        assert (done.stop, done.state, done.faults) == (FIRST, State.OFF, Fault.STOPPED)
    for stop in (Stop(0), Stop(1)):
        late = [*PLAYING, say(300, stop), *alive(0.8), *enables(FIRST), *HOMEWARD]
        assert run(device, *late).state is State.READY
        done = run(device, *late, say(300, stop), 0.1)
        assert (done.stop, done.state) == (FIRST + 1, State.OFF)


def test_stops_are_counted_also_without_a_session_and_without_current(device):
    done = run(device, say(1, Stop(0)), say(2, Stop(1)), say(2, Stop(1)), say(3, Stop(0)))
    assert (done.stop, done.state) == (BOOT + 3, State.OFF)
    assert Fault.STOPPED in done.faults
    assert set(done.answers().values()) == {Status.DONE}


def test_a_hello_stops_the_motors_only_while_current_flows(device):
    other = say(1, Hello(VERSION, 78))
    assert run(device, *PLAYING, other, 0.05).stop == FIRST
    assert run(device, *PLAYING, HELLO, 0.05).stop == BOOT
    assert run(device, *READY, other, 0.05).stop == FIRST
    assert run(device, *PLAYING, say(300, Stop(0)), other, 0.05).stop == FIRST + 1  # it brakes
    assert run(device, *STOPPED, other, 0.05).stop == FIRST


def test_a_timeout_causes_one_stop_and_not_one_in_each_tick(device):
    done = run(device, *PLAYING, 0.26, 0.3)
    assert (done.stop, done.state) == (FIRST, State.BRAKING)
    done = run(device, *PLAYING, 3.0)
    assert (done.stop, done.state, done.faults) == (FIRST, State.OFF, Fault.HOST_SILENT)
    done = run(device, *PLAYING, say(300, Stop(0)), 3.0)  # a stop, and silence while it brakes
    assert (done.stop, done.faults) == (FIRST + 1, Fault.STOPPED | Fault.HOST_SILENT)


def test_enable_while_current_flows(device):
    done = run(device, *READY, *enables(BOOT, BOOT + 1), 0.1)
    assert [done.answers()[k] for k in (400, 401)] == [Status.DONE, Status.WRONG_STOP]
    assert (done.state, done.stop) == (State.READY, BOOT)
    done = run(device, *PLAYING, say(300, Stop(0)), 0.02, *enables(FIRST, BOOT))
    assert [done.answers()[k] for k in (400, 401)] == [Status.WRONG_STATE, Status.WRONG_STOP]


def test_repeated_and_old_commands_start_nothing(device):
    done = run(device, *READY, say(300, Stop(0)), 0.1, say(101, Enable(FIRST)), 0.1)
    assert done.state is State.OFF
    assert done.answers()[101] is Status.OLD
    once = [HELLO, say(102, Enable(BOOT)), 0.1, say(103, Stop(1)), say(102, Enable(BOOT)), 0.1]
    assert run(device, *once).state is State.OFF


def test_without_a_session_nothing_moves(device):
    other = say(2, Hello(VERSION + 1, 9))
    done = run(device, say(1, Enable(BOOT)), other, say(3, Enable(BOOT)), 0.5)
    assert (done.state, done.switched) == (State.OFF, [])
    assert done.answers() == {1: Status.NO_SESSION, 3: Status.NO_SESSION}


KNOTS = wave(0.004)
WHOLE = upload(1, KNOTS, 0)


def drawn(rng: np.random.Generator, present: int) -> list[bytes | float | str]:
    """Any messages in any order, with any numbers, but no Enable that names a stop which is the
    present one: all that are named lie behind it, or too far ahead for a sequence to get there."""
    number, orders = int(rng.integers(2**16)), []
    orders.append(say(number, Hello(VERSION, int(rng.integers(1, 4)))))
    for _ in range(int(rng.integers(10, 40))):
        number = (number + int(rng.choice([0, 1, 1, 1, 2, 40, -3, 2**15]))) % 2**16
        wrong = (present - int(rng.integers(1, 3)) if rng.random() < 0.5 else
                 present + int(rng.integers(100, 2**15))) % 2**16  # fmt: skip
        kinds: list[Message] = [
            Hello(VERSION, int(rng.integers(1, 4))),
            Hello(1, 5),
            Heartbeat(3),
            Enable(wrong),
            Enable(wrong),
            Stop(0),
            Stop(1),
            Home(),
            Begin(1, len(KNOTS), 0),
            Knots(1, 0, KNOTS[:4]),
            Commit(1, int(rng.integers(0, 3))),
        ]
        if rng.random() < 0.15:
            orders.append(WHOLE)
        orders.append(say(number, kinds[int(rng.integers(len(kinds)))]))
        if rng.random() < 0.1:
            orders += [f"fault {int(rng.choice([8, 16]))}", 0.002, "fault 0"]
        if rng.random() < 0.2:
            orders.append(float(rng.uniform(0, 0.3)))
    return orders


def test_only_an_enable_for_the_present_stop_switches_current_on(device):
    rng = np.random.default_rng(17)
    answers = []
    for _ in range(100):
        done = run(device, *drawn(rng, BOOT))
        assert (done.state, done.switched) == (State.OFF, [])
        assert not len(done.times)
        answers += list(done.answers().values())
    refused = {Status.WRONG_STOP, Status.WRONG_STATE, Status.OLD, Status.WRONG_TABLE}
    assert refused <= set(answers)
    assert answers.count(Status.WRONG_STOP) > 100


def test_with_the_present_stop_number_the_same_sequences_enable_the_motors(device):
    """With the present stop named, the same sequences end with current on."""
    rng = np.random.default_rng(17)
    for _ in range(20):
        orders = [*drawn(rng, BOOT), say(9, Hello(VERSION, 50)), 0.06]
        stop = run(device, *orders).stop
        done = run(device, *orders, say(10, Enable(stop)), 0.05)
        assert (done.state, [on for _, on in done.switched]) == (State.HOMING, [True])


def test_a_stop_in_the_middle_of_a_stream_message(device):
    """Its knots are checked for two ticks, during which nothing is read; then the stop arrives."""
    knots = wave(0.004)
    parts = []
    for i in range(0, 96, 4):
        part = [
            replace(knots[k % 24], ticks=knots[k % 24].ticks + k // 24 * 10**7)
            for k in range(i, i + 4)
        ]
        parts.append(say(i, Knots(9, i, tuple(part))))
    orders = [*READY, say(110, Begin(9, 0, 0)), *[[p, 0.003] for p in parts[:18]]]
    flat = [o for order in orders for o in (order if isinstance(order, list) else [order])]
    flat += [say(111, Commit(9, 1)), 0.02]
    assert run(device, *flat).state is State.PLAYING
    done = run(device, *flat, b"".join([*parts[18:], say(500, Stop(1))]), 0.03)
    assert (done.state, done.stop) == (State.OFF, FIRST)
