"""Cycles that begin in motion where the last one ends, and tails that bring the plate to rest."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BPoly

from plate_core import CycleError, PlateCycle, load_rig
from plate_core.motion import motor_state, plate_state, usage
from plate_core.serial_protocol import TICK_S
from plate_driver.cycle_starts import CycleStarts
from plate_driver.setpoints import Guard, MotorTable, SetpointStream, knots, prepare, refined
from plate_driver.setpoints.guard import SENT_KEPT
from plate_driver.setpoints.limits import check_setpoints
from plate_driver.transports import Measured

RIG = load_rig()
PERIOD, TAIL, KNOTS = 0.1, 0.05, 64
SIZE = 2e-4
"""Of a swing that is well within the limits [m], [rad]."""

STEP = 1e-3
MOST = 1 + 1e-4
"""Excess of a limit by rounding."""


def spliced(rng, before=None, size=SIZE) -> PlateCycle:
    """Random cycle that ends in motion: a swing from rest, cut anywhere; where one was before,
    begun in the state in which that ends, with its tail added."""
    t = np.linspace(0, PERIOD, KNOTS + 1)
    w = 2 * np.pi * rng.uniform(6, 9, 3)
    c, s = np.cos(np.outer(t, w)), np.sin(np.outer(t, w))
    swing = rng.uniform(-size, size, 3)
    states = [
        swing * (1 - c) ** 2,
        swing * 2 * w * (1 - c) * s,
        swing * 2 * w**2 * (s**2 + c - c**2),
    ]
    if before is not None:
        tail, ends = before.tail, t <= TAIL
        for state, old in zip(states, (tail.pose, tail.twist, tail.accel), strict=True):
            state[ends] += old(t[ends])
    end = PlateCycle.stopping(np.array([state[-1] for state in states]), TAIL)
    joined = [
        np.vstack([state, *old[None]]) for state, old in zip(states, end.knots[1:], strict=True)
    ]
    return PlateCycle.from_knots(np.append(t, PERIOD + end.times), *joined)


def closed(rng, size=SIZE) -> PlateCycle:
    """Random cycle from rest to rest."""
    t = np.linspace(0, PERIOD, KNOTS + 1)
    w, swing = 2 * np.pi / PERIOD, rng.uniform(-size, size, 3)
    c, s = np.cos(w * t), np.sin(w * t)
    wave = [(1 - c) ** 2, 2 * w * (1 - c) * s, 2 * w**2 * (s**2 + c - c**2)]
    states = [np.outer(row, swing) for row in wave]
    for state in states:
        state[[0, -1]] = 0
    return PlateCycle.from_knots(t, *states)


@pytest.fixture(name="rng")
def _rng():
    return np.random.default_rng(7)


@pytest.fixture(name="pair")
def _pair(rng):
    """A cycle from rest, and one that follows."""
    first = spliced(rng)
    return first, spliced(rng, first)


# Tables


def test_a_table_has_its_tail(pair):
    cycle, _ = pair
    table, scaled = prepare(RIG, cycle, 7)
    assert scaled.factor == 1
    assert table.cycle is cycle
    assert table.length == pytest.approx(PERIOD + TAIL)
    assert len(table.q) == len(table.times) == KNOTS + 3
    assert table.times[KNOTS] == table.times[KNOTS + 1] == cycle.period
    assert np.all(table.q[KNOTS] == table.q[KNOTS + 1])
    assert np.max(np.abs(table.qd[KNOTS])) > 1e-3
    assert table.tail.cycle is cycle.tail
    assert table.tail.tail is None
    assert np.all(table.tail.q[0] == table.q[KNOTS])
    for values in (table.q, table.qd, table.qdd):
        assert not values[-1].any()
    ticks = [knot.ticks for knot in knots(table)]
    assert ticks[KNOTS] == ticks[KNOTS + 1] == 10_000_000
    assert [knot.ticks for knot in refined(table.tail)][-1] == ticks[-1] - ticks[KNOTS]


def test_a_cycle_in_motion_begins_to_the_last_bit_where_the_last_one_ends(pair):
    first, second = pair
    before = prepare(RIG, first, 1)[0]
    times, *states = second.knots
    for state, off in zip(states, (5e-7, 5e-5, 5e-3), strict=True):
        state[0] += off  # as a sender that rounds
    table, scaled = prepare(RIG, PlateCycle.from_knots(times, *states), 2, before=(before.cycle,))
    assert scaled.factor == 1
    for mine, old in zip(
        (table.q, table.qd, table.qdd), (before.q, before.qd, before.qdd), strict=True
    ):
        np.testing.assert_array_equal(np.float32(mine[0]), np.float32(old[KNOTS]))
    assert knots(table)[0].position == knots(before)[KNOTS].position


def test_a_cycle_in_motion_with_another_start_state_is_refused(pair, rng):
    first, second = pair
    with pytest.raises(CycleError, match=r"differs from rest by .*, allowed: the same state"):
        prepare(RIG, second, 1)
    for other in (closed(rng), spliced(rng), second):
        with pytest.raises(CycleError, match="from the final state of the last cycle"):
            prepare(RIG, second, 1, before=(other,))
    prepare(RIG, second, 1, before=(first,))


def test_a_cycle_in_motion_is_never_scaled(rng):
    """A cycle from rest is scaled, with its tail. A cycle that continues the unscaled one then
    begins elsewhere."""
    first = spliced(rng, size=2e-2)
    table, scaled = prepare(RIG, first, 1)
    assert 0 < scaled.factor < 0.9
    np.testing.assert_allclose(table.cycle.tail.knot_pose, scaled.factor * first.tail.knot_pose)
    with pytest.raises(CycleError, match="begins in motion"):
        prepare(RIG, spliced(rng, first), 2, before=(table.cycle,))
    small = spliced(rng)
    with pytest.raises(CycleError) as caught:
        prepare(RIG, spliced(rng, small, size=2e-2), 2, before=(small,))
    assert "plate_cycle: stroke is " in str(caught.value)
    assert " m, allowed: 0.01 m; the cycle begins in motion, so it cannot be scaled" in str(
        caught.value
    )


def test_rounding_errors_at_a_limit_are_accepted(rng):
    first = spliced(rng)
    second = spliced(rng, first)
    used = prepare(RIG, second, 1, before=(first,))[1].usage
    tight = replace(RIG, limits=replace(RIG.limits, accel=used.accel / (1 + 2e-6)))
    table, scaled = prepare(tight, second, 1, before=(first,))
    assert scaled.factor == 1
    assert np.all(table.cycle.knot_pose == second.knot_pose)
    tight = replace(RIG, limits=replace(RIG.limits, accel=used.accel / 1.001))
    with pytest.raises(CycleError, match="cannot be scaled"):
        prepare(tight, second, 1, before=(first,))


def test_the_tail_keeps_the_limits_too(pair):
    """A cycle is scaled, or refused, even if only its tail exceeds a limit."""

    def hard(cycle):
        short = replace(cycle, tail=PlateCycle.stopping(cycle.state(-1), 0.0101))
        gentle, most = (usage(RIG, each).accel for each in (replace(cycle, tail=None), short))
        assert most > 1.02 * gentle
        return short, replace(RIG, limits=replace(RIG.limits, accel=(gentle + most) / 2))

    first, second = pair
    short, rig = hard(first)
    assert 0.5 < prepare(rig, short, 1)[1].factor < 0.995
    short, rig = hard(second)
    with pytest.raises(
        CycleError, match=r"acceleration is .* the cycle begins in motion, so it cannot be"
    ):
        prepare(rig, short, 1, before=(first,))


def test_a_tail_without_its_cycle_is_refused(pair):
    first, _ = pair
    with pytest.raises(CycleError, match="begins in motion and has no tail"):
        prepare(RIG, first.tail, 1, before=(first,))


@pytest.mark.parametrize("length", [0.0099, 10.1])
def test_strange_tails_are_refused(pair, length):
    first, _ = pair
    tail = PlateCycle.stopping(first.state(-1), length)
    with pytest.raises(CycleError, match=r"tail is [\d.]+ s, allowed: 0\.01 to 10 s"):
        prepare(RIG, replace(first, tail=tail), 1)


def test_the_final_check_covers_tail_splice_and_start(pair):
    first, second = pair
    before, table = (prepare(RIG, c, 1, before=b)[0] for c, b in ((first, ()), (second, (first,))))
    start = before.q[KNOTS], before.qd[KNOTS]
    arrays = table.times, table.q, table.qd, table.qdd
    check_setpoints(RIG, *arrays, start)
    with pytest.raises(CycleError, match="at rest is"):
        check_setpoints(RIG, *arrays)
    for row, value, message in (
        (-1, 1e-4, r"travel error at the start or at rest is 0\.0001 m"),
        (KNOTS, 1e-4, "for the same time differ"),
        (0, start[0][1] + 1e-4, r"travel error at the start or at rest is 0\.0001 m"),
    ):
        q = table.q.copy()
        q[row, 1] = value
        with pytest.raises(CycleError, match=message):
            check_setpoints(RIG, table.times, q, table.qd, table.qdd, start)
    fast = table.times.copy()
    fast[-1] = fast[-2] + 1e-6
    with pytest.raises(CycleError, match="speed is"):
        check_setpoints(RIG, fast, *arrays[1:], start)


def test_with_a_calibration_only_cycles_from_rest_are_taken(pair):
    """They are played with their tails, corrected as one motion."""
    first, second = pair
    seen = []

    def correction(cycle):
        seen.append(cycle)
        return cycle.scaled(0.5)

    table, scaled = prepare(RIG, first, 1, correction=correction)
    assert table.tail is None
    assert table.cycle.starts_at_rest
    assert table.cycle.period == scaled.cycle.period == pytest.approx(PERIOD + TAIL)
    t = np.linspace(0, TAIL, 20)
    np.testing.assert_allclose(seen[0].pose(PERIOD + t), first.tail.pose(t), atol=1e-15)
    with pytest.raises(CycleError, match="a calibration requires a cycle that begins at rest"):
        prepare(RIG, second, 2, correction=correction, before=(first,))


# Guard


def test_a_table_with_a_tail_is_played_once(pair):
    first, second = pair
    guard, _ = Guard(RIG, hold_cycles=5).accepted(first, 1, 10.0)
    assert guard.plays == 1
    assert guard.lasts_s == pytest.approx(PERIOD + TAIL)
    assert not guard.over(10.149)
    assert guard.over(10.151)
    # The next cycle begins at the splice. Until then, any state of the playing cycle is possible.
    late, _ = guard.accepted(second, 2, 10.12)
    assert late.statistics.late == pytest.approx(0.02)
    assert guard.accepted(second, 2, 10.08)[0].statistics.late == 0
    assert not late.over(10.12 + PERIOD + TAIL)
    assert late.over(10.12 + 2 * (PERIOD + TAIL) + 1e-6)
    rested, over = guard.at_time(10.2)
    assert over
    assert rested.statistics.rests == 1
    with pytest.raises(CycleError, match=r"begins in motion, .* from rest"):
        rested.accepted(second, 2, 10.2)
    rested.accepted(first, 2, 10.2)


@pytest.mark.parametrize("now", [10.151, 50.0, 2.0, 1e-6])
def test_a_table_that_has_ended_is_not_continued(pair, now):
    """Also before anything has called `at_time`: after its tail, and if the clock was set back."""
    first, second = pair
    guard, _ = Guard(RIG).accepted(first, 1, 10.0)
    with pytest.raises(CycleError, match=r"begins in motion, .* from rest"):
        guard.accepted(second, 2, now)
    again, _ = guard.accepted(first, 2, now)
    assert again.lasts_s == pytest.approx(PERIOD + TAIL)
    assert again.sent == (again.table.cycle,)
    again.accepted(second, 3, now + PERIOD)


@pytest.mark.parametrize("earlier", range(6))
def test_a_cycle_may_continue_any_of_the_last_tables(rng, earlier):
    guard = Guard(RIG)
    cycles = [spliced(rng) for _ in range(6)]
    for k, cycle in enumerate(cycles):
        guard, _ = guard.accepted(cycle, k, 0.1 * k)
    follower = spliced(rng, cycles[-1 - earlier])
    if earlier < SENT_KEPT:
        guard.accepted(follower, 9, 0.55)
    else:
        with pytest.raises(CycleError, match="begins in motion"):
            guard.accepted(follower, 9, 0.55)
    with pytest.raises(CycleError, match=r"begins in motion, .* from rest"):
        guard.resting(0.55).accepted(follower, 9, 0.55)


def test_a_cycle_cannot_continue_a_refused_cycle(pair, rng):
    first, second = pair
    guard, _ = Guard(RIG).accepted(first, 10, 10.0)
    with pytest.raises(CycleError, match="is older than the last"):
        guard.accepted(second, 9, 10.05)
    with pytest.raises(CycleError, match="begins in motion"):
        guard.accepted(spliced(rng, second), 11, 10.06)
    guard, _ = guard.accepted(second, 11, 10.07)
    guard.accepted(spliced(rng, second), 12, 10.15)


def test_a_cycle_may_continue_an_earlier_table_because_the_last_one_may_have_come_too_late(
    pair, rng
):
    first, second = pair
    guard, _ = Guard(RIG).accepted(first, 1, 10.0)
    late, _ = guard.accepted(second, 2, 10.12)
    after, _ = late.accepted(spliced(rng, first), 3, 10.14)
    assert after.table is not None
    np.testing.assert_array_equal(after.table.cycle.state(0), first.state(-1))
    for number in range(SENT_KEPT - 1):
        after, _ = after.accepted(spliced(rng, second), 4 + number, 10.16)
    with pytest.raises(CycleError, match="begins in motion"):
        after.accepted(spliced(rng, first), 9, 10.18)
    with pytest.raises(CycleError, match=r"begins in motion, .* from rest"):
        after.resting(10.2).accepted(spliced(rng, second), 9, 10.2)


def test_motors_that_are_too_warm_continue_with_a_scaled_cycle_from_rest(rng):
    """Cycles with twice the heat that motors bear for long: refused in motion once they are warm,
    then scaled from rest, and followed again as they have cooled."""
    loads = [np.max(usage(RIG, spliced(rng, spliced(rng))).thermal_load) for _ in range(50)]
    force = RIG.limits.continuous_force * np.sqrt(np.mean(loads) / 2)
    weak = replace(RIG, limits=replace(RIG.limits, continuous_force=force, thermal_time_s=1.5))
    guard = Guard(weak)
    before = None
    now = 0.0
    refused = []
    taken = []
    for k in range(200):
        now = k * PERIOD
        guard, _ = guard.at_time(now)
        if guard.table is None:  # the plate's rest was reported, so the next cycle begins at rest
            before = None
        cycle = spliced(rng, before)
        try:
            guard, scaled = guard.accepted(cycle, k, now)
        except CycleError as error:
            guard = guard.refused()
            refused.append(str(error))
            continue
        taken.append((k, scaled.factor, cycle.starts_at_rest))
        before = guard.table.cycle
        assert np.max(guard.thermal.at_time(weak, now).rise) <= 1 + 1e-6
    warm = [text for text in refused if "mean force at the motors' temperature" in text]
    assert "The plate comes to rest; cycles from rest can be" in warm[0]
    scaled = [k for k, factor, _ in taken if factor < 1]
    in_motion = [k for k, _, at_rest in taken if not at_rest]
    assert len(scaled) > 5
    assert max(scaled) > 150
    assert max(in_motion) > min(scaled)
    assert max(np.diff([k for k, _, _ in taken])) <= 5  # never starved


class Player:
    """A device that plays tables by its documented rules. It records at each `STEP` which table
    plays, and for how long [s]."""

    def __init__(self) -> None:
        self.now, self.steps = 0.0, []
        self.table = self.waiting = None
        self.began, self.spliced, self.tails = 0.0, 0, 0

    def send(self, table, plays) -> None:
        self.waiting, self.plays = table, plays
        self.pass_on()

    def take(self, at) -> None:
        self.table = self.waiting
        self.waiting = None
        self.began = at
        self.left = self.plays - 1
        self.ways = [self.way(part) for part in (self.table, self.table.tail) if part is not None]

    @staticmethod
    def way(table) -> BPoly:
        k = len(table.cycle.times)
        states = np.stack([table.q[:k], table.qd[:k], table.qdd[:k]], axis=1)
        return BPoly.from_derivatives(table.cycle.times.copy(), states)

    def pass_on(self) -> None:
        """Take over, go on with the tail, or rest."""
        if self.table is not None and self.now >= self.began + self.table.cycle.period:
            splice, k = self.began + self.table.cycle.period, len(self.table.cycle.times) - 1
            next_ = self.waiting
            if next_ is not None and not next_.cycle.starts_at_rest and self.into_tail() < STEP:
                mine = (self.table.q, self.table.qd, self.table.qdd)
                theirs = (next_.q, next_.qd, next_.qdd)
                if all(np.all(a[k] == b[0]) for a, b in zip(mine, theirs, strict=True)):
                    self.spliced += 1
                    self.take(splice)
                    return
            end = self.began + self.table.length
            if self.now < end:
                self.tails += self.into_tail() < STEP
                return
            if self.table.tail is None and self.left and self.waiting is None:
                self.began, self.left = end, self.left - 1
                return
            self.table = None
        if self.table is None and self.waiting is not None:
            if self.waiting.cycle.starts_at_rest:
                self.take(self.now)
            else:
                self.waiting = None

    def into_tail(self) -> float:
        return self.now - self.began - self.table.cycle.period

    def run(self, seconds) -> None:
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            self.pass_on()
            into, way = self.now - self.began, None
            if self.table is not None:
                way = self.ways[0]
                if into > self.table.cycle.period:
                    into, way = self.into_tail(), self.ways[-1]
            self.steps.append((way, into))

    @property
    def rows(self) -> np.ndarray:
        """Setpoints each `STEP` (n, 3, 4)."""
        parts = []
        for way, steps in itertools.groupby(self.steps, lambda step: step[0]):
            into = [step[1] for step in steps]
            parts.append(np.zeros((len(into), 3, 4)) if way is None else states(way, into))
        return np.concatenate(parts)


def states(way, times) -> np.ndarray:
    """Position, speed and acceleration (n, 3, 4) of a spline."""
    return np.stack([way(times, order) for order in range(3)], axis=1)


def judge(rows) -> None:
    """Rows (n, 3, 4) each `STEP`: within the limits, without a jump, at rest in the end."""
    q, qd, qdd = np.moveaxis(rows, 1, 0)
    limits = RIG.limits
    assert np.max(np.abs(q)) <= limits.stroke_m * MOST
    assert np.max(np.abs(qd)) <= limits.speed * MOST
    assert np.max(np.abs(qdd)) <= limits.accel * (1 + 1e-2)  # of motors: turning adds a little
    # The way from one to the next is that of their speeds (trapezoids with end corrections).
    way = STEP / 2 * (qd[1:] + qd[:-1]) - STEP**2 / 12 * np.diff(qdd, axis=0)
    assert np.max(np.abs(np.diff(q, axis=0) - way)) < 3e-6
    assert np.max(np.abs(np.diff(qd, axis=0))) <= limits.accel * STEP * 1.01
    assert not np.any(rows[-1])


def heat(rig, rows) -> float:
    """Greatest rise of a winding over that at the continuous force, by Newton, Euler and the
    heat's equation, of rows (n, 3, 4) each `STEP`."""
    q, qd, qdd = np.moveaxis(rows, 1, 0)
    _, _, accel = plate_state(rig, q, qd, qdd, tolerance=np.inf)
    plate = rig.plate
    inertia = plate.mass_kg * (plate.length_m**2 + plate.width_m**2) / 12
    lever, _, _ = motor_state(rig, 1e-7 * np.eye(3), np.zeros((3, 3)), np.zeros((3, 3)))
    force = accel * [plate.mass_kg, plate.mass_kg, inertia] @ np.linalg.pinv(lever / 1e-7).T
    decay, rise, most = np.exp(-STEP / rig.limits.thermal_time_s), np.zeros(4), 0.0
    for load in (force / rig.limits.continuous_force) ** 2:
        rise = load + (rise - load) * decay
        most = max(most, float(np.max(rise)))
    return most


WAITS, WAITED = [10, 3, 14, 40], [0.75, 0.1, 0.1, 0.05]
"""Between two cycles [0.01 s]: in time for the next splice, or not; and how often."""


def sender(rng, guard, last):
    """A cycle as somebody may send it, after the `last` one that was made."""
    before = None if guard.table is None else guard.table.cycle
    tailed = before if before is not None and before.tail is not None else None
    return [
        lambda: spliced(rng, tailed),  # as requested
        lambda: spliced(rng, tailed),
        lambda: spliced(rng, tailed),
        lambda: spliced(rng, last),  # continues a refused cycle, or one that ended long ago
        lambda: spliced(rng),
        lambda: closed(rng),
        lambda: spliced(rng, tailed, 3e-3),  # too much
        lambda: spliced(rng, size=3e-3),
        lambda: PlateCycle.rest(PERIOD),
        lambda: (tailed or last).tail,
        lambda: PlateCycle.from_samples(PERIOD, SIZE * rng.normal(size=(8, 3))),  # foreign
    ][rng.choice(11, p=[0.2, 0.2, 0.2, *[0.05] * 8])]()


def test_the_plate_never_jumps_with_random_cycles():
    totals, warmest = np.zeros(3, int), 0.0
    rig = replace(RIG, limits=replace(RIG.limits, continuous_force=1.0, thermal_time_s=3.0))
    for seed in range(6):
        rng = np.random.default_rng(seed)
        guard = Guard(rig, hold_cycles=2)
        player = Player()
        last = spliced(rng)
        refused = 0
        for k in range(60):
            cycle = sender(rng, guard, last)
            last = cycle if cycle.tail is not None else last
            try:
                if rng.random() < 0.05:
                    raise CycleError("it was too old, and was not sent")
                guard, _ = guard.accepted(cycle, k, player.now)
                player.send(guard.table, guard.plays)
            except CycleError:
                guard, refused = guard.refused(), refused + 1
            for _ in range(rng.choice(WAITS, p=WAITED)):
                player.run(0.01)
                guard, _ = guard.at_time(player.now)
        player.run(1.0)
        guard, _ = guard.at_time(player.now)
        assert guard.table is None
        rows = player.rows
        judge(rows)
        totals += player.spliced, player.tails, refused
        warmest = max(warmest, heat(rig, rows))
    assert np.min(totals) > 40, totals
    assert 0.6 < warmest <= 1.02


# Streams


def sampled(sent) -> np.ndarray:
    """Setpoints each `STEP` (n, 3, 4) of knots that were sent."""
    times = 1e-8 * np.array([knot.ticks for knot in sent])
    given = np.array([[k.position, k.velocity, k.acceleration] for k in sent])
    way = BPoly.from_derivatives(times, given)
    return np.concatenate([states(way, np.arange(0, times[-1], STEP)), given[-1:]])


def test_a_stream_continues_in_motion_or_with_the_tail(pair):
    first, second = (
        prepare(RIG, c, 1, before=b)[0] for c, b in zip(pair, ((), (pair[0],)), strict=True)
    )
    started, sent = SetpointStream.of(first, 1).until(0.09)
    # Nothing beyond the splice was sent yet: both ways are open.
    on, more = started.followed_by(second, 1).until(50.0)
    assert on.ended
    assert on.time == pytest.approx(2 * PERIOD + TAIL + 0.01)
    expected = [*refined(first), *refined(second)[1:], *refined(second.tail)[1:]]
    assert [k.position for k in (*sent, *more)][:-1] == [k.position for k in expected]
    ended, rest = started.until(50.0)
    assert ended.time == pytest.approx(0.2)  # devices refuse shorter streams
    judge(sampled([*sent, *more]))
    judge(sampled([*sent, *rest]))


@pytest.mark.parametrize("period", [0.01, 0.1, 0.19, 0.195, 0.25])
def test_a_short_stream_rests_until_the_device_accepts_its_length(rng, period):
    size = 0.05 * SIZE * period**2
    wave = np.sin(np.pi * np.arange(12) / 12)[:, None] ** 4 * size * rng.normal(size=3)
    table = prepare(RIG, PlateCycle.from_samples(period, wave), 1)[0]
    stream, sent = SetpointStream.of(table, 1).until(50.0)
    assert stream.ended
    assert stream.time == pytest.approx(max(period + 0.01, 0.2))
    times = np.array([k.ticks for k in sent]) * TICK_S
    assert times[-1] == pytest.approx(stream.time)
    assert len(sent) == stream.sent
    assert np.all(np.diff(times) > 0)
    assert np.max(np.diff(times)) <= 0.04 + 1e-9
    assert not any(any(k.velocity) or any(k.acceleration) for k in sent[-1:])


def test_a_stream_beyond_the_splice_refuses_a_continuation(pair, rng):
    first, second = (
        prepare(RIG, c, 1, before=b)[0] for c, b in zip(pair, ((), (pair[0],)), strict=True)
    )
    stream, sent = SetpointStream.of(first, 1).until(0.11)
    assert stream.playing.cycle is first.cycle.tail
    with pytest.raises(CycleError, match="not in the final state of the current cycle"):
        stream.followed_by(second, 1)
    swing = prepare(RIG, closed(rng), 2)[0]
    stream, more = stream.followed_by(swing, 2).until(50.0)
    assert stream.time == pytest.approx(PERIOD + TAIL + 2 * PERIOD + 0.01)
    judge(sampled([*sent, *more]))
    with pytest.raises(CycleError, match="begins in motion, but the plate is at rest"):
        SetpointStream.of(second, 1)


def test_the_plate_never_jumps_with_random_streamed_cycles():
    totals = np.zeros(3, int)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        guard, last, now = Guard(RIG), spliced(rng), 0.0
        stream, streams = SetpointStream.of(MotorTable.rest(RIG, PERIOD, 0), 1), [[]]
        for k in range(60):
            cycle = sender(rng, guard, last)
            last = cycle if cycle.tail is not None else last
            try:
                new, _ = guard.accepted(cycle, k, now)
                if stream.ended:
                    stream = SetpointStream.of(new.table, new.plays)
                    streams.append([])
                else:
                    stream = stream.followed_by(new.table, new.plays)
                guard = new
            except CycleError:
                totals[0] += 1
            now += 0.01 * rng.choice(WAITS, p=WAITED)
            guard, _ = guard.at_time(now)
            # Just inside, or just beyond the end of the sent path.
            stream, more = stream.until(stream.begin * 1e-8 + PERIOD + rng.choice([0.02, -0.04]))
            streams[-1] += more
            cycle = stream.playing.cycle
            totals[1] += cycle.tail is None and not cycle.closes
            totals[2] += cycle.tail is not None and not cycle.starts_at_rest
        stream, more = stream.until(1e6)
        assert stream.ended
        streams[-1] += more
        for sent in streams:
            steps = np.diff([knot.ticks for knot in sent])
            assert np.all((steps > 0) & (steps <= 5_000_000))
            judge(sampled(sent))
    assert np.min(totals) > 40, totals


# Its reports


def test_starts_of_tails_are_reported_too(pair, rng):
    """Of a device that plays A, B, the tail of B, rests, and plays from rest; half of the telemetry
    is lost, or that of the tail."""
    first, second = (MotorTable.of(RIG, cycle, 1) for cycle in pair)
    third = MotorTable.of(RIG, closed(rng), 3)
    plan = [(1.0, 1, first, PERIOD), (1.1, 2, second, PERIOD + TAIL), (1.3, 3, third, PERIOD)]
    begins = {1.0: first.cycle, 1.1: second.cycle, 1.2: second.cycle.tail, 1.3: third.cycle}

    def reported_cycles(lost):
        starts, found = CycleStarts(0.0), {}
        for time in np.arange(0.905, 1.5, 0.01):
            if lost(time):
                continue
            played = [row for row in plan if row[0] <= time < row[0] + row[3]]
            began, number, table, _ = played[0] if played else (0.0, 0, None, 0)
            if table is not None and time >= began + PERIOD:
                began, table = began + PERIOD, table.tail
            new = Measured(time, time + 5, number, (0,) * 4, (0,) * 4, table, began)
            cycle = PlateCycle.rest(0.1) if table is None else table.cycle
            starts, at, problem = starts.updated(new, cycle.period, time + 1e-3)
            assert not problem
            if at is not None:
                found[round(at, 6)] = cycle
        return found

    for lost in (lambda _: False, lambda time: round(time * 100) % 2):
        found = reported_cycles(lost)
        assert {at: cycle for at, cycle in found.items() if at in begins} == begins
        rests = [at for at in found if at not in begins]
        assert any(at == pytest.approx(1.25) for at in rests)
        assert not any(1.0 < at < 1.24 for at in rests)
    # If no tail was reported, the plate gets no order to rest before the tail's end.
    found = reported_cycles(lambda time: 1.19 < time < 1.26)
    assert 1.2 not in found
    assert not any(1.1 < at < 1.249 for at in found)
