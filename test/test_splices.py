"""Tables with tails: the next one takes over at the splice, or the tail leads to
rest; nothing jumps, whatever comes and when."""

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import pytest
from device_orders import (
    ENABLE,
    HELLO,
    HOMEWARD,
    READY,
    SPEED,
    STROKE_M,
    Run,
    Simulated,
    alive,
    ordered,
    parse_run,
    run,
    running,
    say,
    spline,
    uploaded,
)  # fmt: skip
from scipy.interpolate import BPoly

from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Begin,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Knot,
    State,
    Status,
    Stop,
    Telemetry,
    Trigger,
)

REST = np.zeros((3, 4))
SPREAD = np.array([[8e-4], [0.06], [6.0]])
"""Of the states at knots: position [m], speed [m/s], acceleration [m/s2]."""

ACCEL, SLACK = 100.0, 1.002
REST_M, REST_SPEED = 2e-6, 2e-3
TICK_S = 1e-3
STEP_TICKS = 2_500_000
"""From knot to knot [10 ns]."""


@dataclass(frozen=True)
class Spliced:
    """A table: its knots, and when it is spliced [10 ns]; 0: it has no tail."""

    knots: tuple[Knot, ...]
    splice_ticks: int = 0
    repeats: int = 1

    @cached_property
    def spline(self) -> BPoly:
        return spline(self.knots)

    @property
    def splice(self) -> np.ndarray:
        """State (3, 4) at the splice, or at the first knot after it; without a tail, at the end."""
        end = self.splice_ticks or self.length
        knot = next(k for k in self.knots if k.ticks >= end)
        return np.array([knot.position, knot.velocity, knot.acceleration])

    @property
    def length(self) -> int:
        return self.knots[-1].ticks

    def frames(self, number: int, first: int) -> list[bytes]:
        return uploaded(number, self.knots, first, self.repeats, self.splice_ticks)


def made(rng: np.random.Generator, start: np.ndarray, tail: bool, scale: float = 1.0) -> Spliced:
    """A table of some random knots from a state (3, 4) to rest; with a tail, or without."""
    counts = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    steps = np.round(STEP_TICKS * rng.uniform(0.8, 1.4, sum(counts))).astype(int)
    states = scale * SPREAD * rng.uniform(-1, 1, (len(steps) + 1, 3, 4))
    states[0], states[-1] = start, REST
    ticks = np.append(0, np.cumsum(steps)).tolist()
    rows = np.float32(states).tolist()
    knots = tuple(Knot(t, *map(tuple, row)) for t, row in zip(ticks, rows, strict=True))
    return Spliced(knots, ticks[counts[0]] if tail else 0)


def chain(seed: int, count: int = 2) -> list[Spliced]:
    """Tables that follow upon each other."""
    rng, tables = np.random.default_rng(seed), []
    start = REST
    for _ in range(count):
        tables.append(made(rng, start, tail=True))
        start = tables[-1].splice
    return tables


def sent(tables: list[Spliced], first: int = 110) -> tuple[list[bytes], list[int]]:
    """The bytes of tables 1, 2, ..., and the numbers of their Commits."""
    data, commits = [], []
    for number, table in enumerate(tables, 1):
        frames = table.frames(number, first)
        first += len(frames)
        data.append(b"".join(frames))
        commits.append(first - 1)
    return data, commits


def telemetry_of(done: Run) -> list[Telemetry]:
    return [p.message for p in done.packets if isinstance(p.message, Telemetry)]


def table_starts(done: Run) -> dict[int, int]:
    """When each table began to play [10 ns]."""
    return {
        m.table: 100 * m.device_us - m.ticks
        for m in reversed(telemetry_of(done))
        if m.table and m.state is State.PLAYING
    }


def assert_played(done: Run, tables: dict[int, Spliced]) -> None:
    """Wherever a table plays, the setpoint is that of its spline."""
    playing = [m for m in telemetry_of(done) if m.state is State.PLAYING]
    at = setpoints(done, playing)
    for number in {m.table for m in playing}:
        rows = [m.table == number for m in playing]
        times = [m.ticks * 1e-8 for m in playing if m.table == number]
        for order, tolerance in enumerate((1e-7, 3e-5, 5e-2)):
            expected = tables[number].spline(times, nu=order)
            np.testing.assert_allclose(at[rows, order], expected, atol=tolerance)


def setpoints(done: Run, messages: list[Telemetry]) -> np.ndarray:
    """Commanded setpoints (n, 3, 4) in the ticks between messages."""
    times = np.array([m.device_us * 1e-6 for m in messages])
    rows = np.searchsorted(done.times, times - 1e-7)
    assert np.all(np.abs(done.times[rows] - times) < 1e-7)
    return done.setpoints[rows]


def test_the_next_table_takes_over_at_the_splice(device):
    tables = chain(1)
    data, commits = sent(tables)
    done = run(device, *READY, data[0], 0.005, data[1], *alive(0.3))
    assert [done.answers()[commit] for commit in commits] == [Status.DONE] * 2
    began = table_starts(done)
    assert began[2] - began[1] == tables[0].splice_ticks
    assert_played(done, dict(enumerate(tables, 1)))
    assert (done.state, done.faults) == (State.READY, Fault.NONE)
    assert (
        max(m.ticks for m in telemetry_of(done) if m.table == 2) > tables[1].splice_ticks
    )  # its tail
    assert not done.setpoints[-50:].any()


def test_without_one_the_tail_leads_to_rest(device):
    [table] = chain(2, 1)
    data, _ = sent([table])
    done = run(device, *READY, data[0], *alive(0.3))
    assert_played(done, {1: table})
    assert (done.state, done.faults) == (State.READY, Fault.NONE)
    moves = done.times[done.setpoints[:, 2].any(axis=1)]
    assert moves[-1] - moves[0] == pytest.approx(table.length * 1e-8, abs=3e-3)
    # A table that arrives in the tail, and begins at rest, begins at its end.
    waits = chain(3, 1)[0]
    data, commits = sent([table, waits])
    late = table.splice_ticks * 1e-8 + 0.003
    done = run(device, *READY, data[0], late, data[1], *alive(0.4))
    assert done.answers()[commits[1]] is Status.DONE
    assert table_starts(done)[2] - table_starts(done)[1] == table.length
    assert_played(done, {1: table, 2: waits})
    # So does a table that arrives before the splice.
    done = run(device, *READY, data[0], 0.004, data[1], *alive(0.4))
    assert table_starts(done)[2] - table_starts(done)[1] == table.length


def nudged(table: Spliced, row: str) -> Spliced:
    """The table with one first value that is the next float."""
    first = table.knots[0]
    values = list(getattr(first, row))
    values[2] = float(np.nextafter(np.float32(values[2]), np.float32(1)))
    return replace(table, knots=(replace(first, **{row: tuple(values)}), *table.knots[1:]))


@pytest.mark.parametrize("case", ["late", "position", "velocity", "acceleration", "rest", "closed"])
def test_a_table_in_motion_begins_at_a_future_splice_or_is_refused(device, case):
    tables = chain(4)
    wait = tables[0].splice_ticks * 1e-8 + 0.002 if case == "late" else 0.005
    if case in ("position", "velocity", "acceleration"):
        tables[1] = nudged(tables[1], case)
    elif case == "rest":  # nothing plays
        tables, wait = [replace(tables[0], repeats=0), tables[1]], 0.005
    elif case == "closed":  # the playing table has no splice
        tables[0] = replace(tables[0], splice_ticks=0)
    data, commits = sent(tables)
    done = run(device, *READY, data[0], wait, data[1], *alive(0.3))
    assert done.answers()[commits[1]] is Status.JUMP
    assert 2 not in {m.table for m in telemetry_of(done)}
    assert (done.state, done.faults) == (State.READY, Fault.NONE)
    assert_played(done, {1: tables[0]})


def test_a_table_without_a_tail_may_follow_too(device):
    first, second = chain(5)
    tables = [first, replace(second, splice_ticks=0)]
    data, commits = sent(tables)
    done = run(device, *READY, data[0], 0.005, data[1], *alive(0.3))
    assert done.answers()[commits[1]] is Status.DONE
    assert table_starts(done)[2] - table_starts(done)[1] == first.splice_ticks
    assert_played(done, dict(enumerate(tables, 1)))
    assert done.state is State.READY


def still(*ticks: int) -> tuple[Knot, ...]:
    return tuple(Knot(t, (0.0,) * 4, (0.0,) * 4, (0.0,) * 4) for t in ticks)


@pytest.mark.parametrize(
    ("table", "status"),
    [
        (Spliced(still(0, 1_000_000, 2_000_000), 1_000_000), Status.DONE),
        (Spliced(still(0, 1_000_000, 2_000_000), 1_000_001), Status.WRONG_TIMES),
        (Spliced(still(0, 999_999, 2_000_000), 999_999), Status.WRONG_TIMES),
        (Spliced(still(0, 1_000_000, 1_999_999), 1_000_000), Status.WRONG_TIMES),
        (Spliced(still(0, 1_000_000, 2_000_000), 2_000_000), Status.WRONG_TIMES),
        (Spliced(still(0, 1_000_000, 2_000_000), 2**32 - 1), Status.WRONG_TIMES),
        (Spliced(still(0, 2_000_000), 1_000_000), Status.WRONG_TIMES),
        (Spliced(still(0, 1_000_000, 2_000_000), 1_000_000, repeats=2), Status.REPEATS),
        (Spliced(still(0, 1_000_000, 2_000_000), 0, repeats=2), Status.DONE),
        (replace(chain(4)[1], repeats=2), Status.REPEATS),
        (replace(chain(4)[1], repeats=2, splice_ticks=0), Status.REPEATS),
    ],
)
def test_allowed_positions_of_a_splice(device, table, status):
    data, [commit] = sent([table])
    done = run(device, *READY, data[0], 0.05)
    assert done.answers()[commit] is status


def test_a_stream_has_no_splice(device):
    done = run(device, *READY, say(110, Begin(1, 0, 0, 10_000_000)))
    assert done.answers()[110] is Status.WRONG_TIMES


@pytest.mark.parametrize(("part", "fraction"), [("cycle", 1.0), ("tail", 0.5)])
def test_motors_bear_the_cycle_alone_and_all_of_it(device, part, fraction):
    """Two motors lift 2 kg: 1 N for each m/s2. Travel a (1 - cos wt)^2 has accelerations
    2 a w^2 (cos wt - cos 2wt), whose mean square is (2 a w^2)^2."""
    t, mean = np.linspace(0, 0.05, 41), 48.0
    w = 2 * np.pi / t[-1]
    a, c, s = mean / 2 / w**2, np.cos(w * t), np.sin(w * t)
    rows = np.stack([a * (1 - c) ** 2, 2 * a * w * s * (1 - c), mean * (c - np.cos(2 * w * t))], 1)
    states = np.float32(rows[:, :, None] * np.array([0.0, 0.0, 1.0, 1.0])).tolist()
    begin = 5_000_000 if part == "tail" else 0
    ticks = (begin + np.round(t * 1e8).astype(int)).tolist()
    moves = tuple(Knot(k, *map(tuple, state)) for k, state in zip(ticks, states, strict=True))
    rests = still(0) if part == "tail" else still(10_000_000)
    knots = rests + moves if part == "tail" else moves + rests
    data, [commit] = sent([Spliced(knots, 5_000_000)])
    for room, status in ((0.99, Status.LIMIT), (1.01, Status.DONE)):
        bears = f"{room * mean * fraction**0.5}"
        done = parse_run(device(ordered(*READY, data[0], 0.05), "60", bears))
        assert done.answers()[commit] is status


def test_a_stop_brakes_along_the_tail_and_takes_nothing_over(device):
    tables = chain(6)
    data, _ = sent(tables)
    splice_s = tables[0].splice_ticks * 1e-8
    for stop_s in (0.002, splice_s - 0.003, splice_s + 0.004):
        orders = [*READY, data[0], 0.004, data[1] if stop_s < splice_s else b"", stop_s]
        done = run(device, *orders, say(300, Stop(0)), *alive(1.0))
        assert (done.state, done.faults) == (State.OFF, Fault.STOPPED)
        assert_smooth(done, tables)
        braking = [m for m in telemetry_of(done) if m.state is State.BRAKING and m.table]
        assert {m.table for m in braking} <= {1, 2}
        assert len({m.table for m in braking}) == 1
        assert np.all(np.diff([m.ticks for m in braking]) >= 0)  # it never begins again
        np.testing.assert_allclose(done.setpoints[-1, 0], 0, atol=REST_M)


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.999])
def test_a_tail_has_its_image_as_a_cycle_has(device, phase):
    tables = chain(7)
    ready = [HELLO, say(100, Trigger(int(phase * 2**16), 2)), ENABLE, *HOMEWARD]
    data, _ = sent(tables)
    done = run(device, *ready, data[0], 0.005, data[1], *alive(0.3))
    began = table_starts(done)
    parts = [(began[1], tables[0].splice_ticks), (began[2], tables[1].splice_ticks)]
    end = began[2] + tables[1].splice_ticks
    parts.append((end, tables[1].length - tables[1].splice_ticks))
    due = [1000 * np.ceil((begin + phase * length) / 1e5) for begin, length in parts]
    rises = np.array([at for at, high in done.line if high])
    playing = rises[(rises >= began[1] / 100) & (rises <= end / 100 + parts[-1][1] / 100)]
    if phase == 0.999:  # in the tick that ends a play; the last one then rests
        due = due[: len(playing)]
        assert len(due) >= 2
    np.testing.assert_allclose(playing, due, atol=1)


# Whatever comes, and when


def assert_smooth(done: Run, tables: list[Spliced]) -> None:
    """Setpoints keep the limits, and are continuous: position, speed, and acceleration, except for
    the terms of a brake and of the motion home."""
    q, v, a = np.moveaxis(done.setpoints, 1, 0)
    assert np.max(np.abs(q)) <= STROKE_M * SLACK
    assert np.max(np.abs(v)) <= SPEED * SLACK
    assert np.max(np.abs(a)) <= ACCEL * 1.1
    jerks = [np.max(np.abs(t.spline(np.arange(t.length)[::20_000] * 1e-8, nu=3))) for t in tables]
    jerk = 1.1 * max(jerks, default=0.0) + 3_000  # a brake: 12 v / Tb^2 and 2 rate rate' a
    dt = np.diff(done.times)[:, None]
    on_end = dt[:, 0] < 1.5e-3  # else current was off between them
    step = np.abs(np.diff(q, axis=0) - dt * (v[1:] + v[:-1]) / 2)[on_end]
    turn = np.abs(np.diff(v, axis=0) - dt * (a[1:] + a[:-1]) / 2)[on_end]
    assert np.max(step, initial=0) <= REST_M + jerk * TICK_S**3 / 6
    assert np.max(turn, initial=0) <= REST_SPEED + jerk * TICK_S**2 / 4
    assert np.max(np.abs(np.diff(a, axis=0))[on_end], initial=0) <= jerk * TICK_S


@dataclass
class Story:
    """A host that does what it likes, with the simulator's device.

    Attributes
    ----------
    orders : list of str
        All of them, for the firmware.
    tables : dict
        By their numbers.
    follows : dict
        The table that one was made to follow; missing: it was made to begin at rest.
    commits : dict
        Sequence numbers of the tables' Commits.
    number : int
        The last sequence number.
    cuts : list of float
        When it had current taken away at once [s].
    played : int
        The table that played last; 0: none has.
    """

    rng: np.random.Generator
    simulated: Simulated = field(default_factory=Simulated)
    orders: list[str] = field(default_factory=list)
    tables: dict[int, Spliced] = field(default_factory=dict)
    follows: dict[int, int] = field(default_factory=dict)
    commits: dict[int, int] = field(default_factory=dict)
    number: int = 100
    cuts: list[float] = field(default_factory=list)
    played: int = 0

    def obey(self, *orders: bytes | float) -> None:
        text = ordered(*orders).removesuffix("run 1000\n").splitlines()
        for line in text:
            self.simulated.obey(line)
            self.played = self.simulated.device.playing or self.played
        self.orders += text

    def say(self, message) -> bytes:
        self.number += 1
        return say(self.number, message)

    def ready(self) -> None:
        """Give it current, whatever state it is in, and wait until it is at home."""
        for _ in range(20):
            if self.simulated.device.state in (State.READY, State.PLAYING):
                return
            self.obey(self.say(Enable(self.simulated.device.stops)), 0.05)

    def send(self, table: Spliced) -> int:
        frames = table.frames(len(self.tables) + 1, self.number + 1)
        self.number += len(frames)
        number = len(self.tables) + 1
        self.tables[number], self.commits[number] = table, self.number
        self.obey(say(0, Heartbeat(1)) + b"".join(frames), 0.004)
        return number

    def act(self) -> None:
        """Do one thing, and let some time pass."""
        rng, kind = self.rng, self.rng.random()
        if kind < 0.7:
            self.ready()
        if kind < 0.5 and self.tables:
            self.follow()
        elif kind < 0.8:  # from rest
            tail = rng.random() < 0.7
            table = made(rng, REST, tail, float(rng.choice([1.0, 1.0, 1.0, 8.0])))
            repeats = int(rng.integers(1, 4)) if not tail or rng.random() < 0.1 else 1
            if rng.random() < 0.05:
                table = replace(table, splice_ticks=table.splice_ticks + 1)
            self.send(replace(table, repeats=repeats))
        elif kind < 0.86:
            now = int(rng.random() < 0.3)
            self.cuts += [self.simulated.device.now_us * 1e-6] * now
            self.obey(self.say(Stop(now)))
        elif kind < 0.89:
            self.obey(0.26)  # silent
        elif kind < 0.91:
            self.obey(self.say(Hello(VERSION, int(rng.integers(2**32)))))
        else:
            self.ready()
        wait_s = float(rng.choice([0.001, 0.01, 0.05])) * rng.random()
        self.obey(say(0, Heartbeat(1)), wait_s)

    def follow(self) -> None:
        """Send a table that begins where the one that plays, or was sent last, is spliced; or
        almost; mostly when no other one waits."""
        for _ in range(100 if self.rng.random() < 0.8 else 0):
            if self.simulated.device.waiting:
                self.obey(0.001)
        known = self.played and self.rng.random() < 0.9
        other = self.played if known else max(self.tables)
        table = made(self.rng, self.tables[other].splice, tail=self.rng.random() < 0.8)
        if self.rng.random() < 0.1:
            table = nudged(table, str(self.rng.choice(["position", "velocity", "acceleration"])))
        elif self.rng.random() < 0.05:
            table = replace(table, repeats=2)
        self.follows[self.send(table)] = other


def checked(story: Story, done: Run) -> Counter:
    """Check the actions of a device. Return how often each event has happened."""
    answers, seen = done.answers(), Counter()
    good = {n: t for n, t in story.tables.items() if answers.get(story.commits[n]) is Status.DONE}
    seen.update(answers[c].name for c in story.commits.values() if c in answers)
    assert_smooth(done, list(good.values()))
    assert_played(done, good)  # only the accepted ones
    playing, messages = table_starts(done), telemetry_of(done)
    ready = [(last, m) for last, m in pairwise(messages) if m.state is State.READY]
    rests = setpoints(done, [m for _, m in ready])
    rests = rests[[last.state is State.PLAYING for last, _ in ready]]
    assert np.all(np.abs(rests[:, 0]) <= REST_M)
    assert not rests[:, 1:].any()
    for at, on in done.switched:
        states = [m.state for m in messages if m.device_us * 1e-6 < at]
        cut = any(0 < at - cut < 0.1 for cut in story.cuts)
        if not on and not cut and states[-1] is State.BRAKING:
            seen["brought home"] += 1
            assert np.max(np.abs(done.setpoints[done.times < at][-1, 0])) < 1e-5
    for number, begin in playing.items():
        table, other = good[number], story.follows.get(number)
        joined = other in playing and begin == playing[other] + good[other].splice_ticks
        if np.any(np.abs(table.knots[0].velocity) > REST_SPEED):
            assert joined
        seen["joined"] += joined
        seen["again"] += table.repeats > 1
    for m in messages:
        tail = m.table in good and 0 < good[m.table].splice_ticks <= m.ticks
        seen[f"{m.state.name} {'in a tail' if tail else ''}".strip()] += 1
    return seen


def test_the_plate_never_jumps_with_random_orders(program):
    firmware, seen = running(program), Counter()
    for seed in range(10):
        story = Story(np.random.default_rng(seed))
        story.obey(HELLO)
        story.ready()
        for _ in range(20):
            story.act()
        story.obey(1.2)  # the host is dead
        printed = firmware("\n".join([*story.orders, ""]))
        assert printed == "\n".join([*story.simulated.lines, ""])
        done = parse_run(printed)
        seen += checked(story, done)
        assert done.state is State.OFF
    expected = [
        "joined",
        "brought home",
        "again",
        "PLAYING in a tail",
        "BRAKING in a tail",
        "BRAKING",
    ]
    assert min(seen[what] for what in expected) > 5, seen
    refused = [Status.JUMP, Status.LIMIT, Status.REPEATS, Status.WRONG_TIMES, Status.WRONG_STATE]
    assert min(seen[status.name] for status in refused) > 0, seen
    assert seen["DONE"] > 50
