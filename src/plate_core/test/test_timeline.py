"""Which cycle runs and which one follows: each case of the rule, and its limits."""

import numpy as np
import pytest

from plate_core import PlateCycle
from plate_core.motion import HANDOVER_S, HOLD_CYCLES, IDLE_S, Timeline, in_time, next_cycle

HOME, STATE = np.zeros((3, 3)), np.array([[1e-3, 0, 0], [0.02, 0, 0], [0, 0, 0]])


def swing(height_m, period=0.1):
    """A cycle from rest to rest, `height_m` [m] to +x half-way; it has no tail."""
    pose = np.outer([0.0, height_m, 0.0], [1, 0, 0])
    return PlateCycle.from_knots(np.array([0.0, period / 2, period]), pose, 0 * pose, 0 * pose)


def going(begin, end):
    """A cycle of 50 ms from one state of the plate to another, with a tail of 20 ms."""
    knots = np.stack([begin, end, end, HOME], axis=1)
    return PlateCycle.from_knots(np.array([0.0, 0.05, 0.05, 0.07]), *knots)


LEAVES, GOES_ON, OTHER = going(HOME, STATE), going(STATE, 2 * STATE), going(3 * STATE, STATE)
SWING, BIGGER, SHORT = swing(1e-3), swing(2e-3), swing(1e-3, 1e-3)


def player(cycle, *sent):
    """A player that has run a cycle for 3 s, and the tables that were sent to it meanwhile."""
    timeline = Timeline(cycle, 3.0)
    for one in sent:
        timeline = timeline.send(one)
    return timeline


def test_a_cycle_is_in_time_from_the_hand_over_on():
    assert HANDOVER_S == 0.004
    assert in_time(0.0, HANDOVER_S)
    assert in_time(-1.0, HANDOVER_S)
    assert not in_time(0.0, np.nextafter(HANDOVER_S, 0.0))
    assert not in_time(0.0, 0.0)


@pytest.mark.parametrize(
    ("running", "sent", "expected"),
    [
        (SWING, [BIGGER], BIGGER),
        (SWING, [SWING, BIGGER], BIGGER),  # two: the newest one
        (LEAVES, [GOES_ON], GOES_ON),
        (LEAVES, [GOES_ON, SWING], GOES_ON),  # the newest one that follows
        (LEAVES, [], LEAVES.tail),
        (LEAVES, [SWING, OTHER], LEAVES.tail),
        (LEAVES.tail, [GOES_ON, SWING], SWING),
    ],
)
@pytest.mark.parametrize("repeat", [False, True])
def test_the_next_cycle_is_selected_by_the_rule(running, sent, expected, repeat):
    assert next_cycle(running, sent, repeat) is expected


@pytest.mark.parametrize(("running", "sent"), [(SWING, []), (SWING, [GOES_ON]), (SHORT, [])])
def test_a_cycle_is_repeated_only_on_request(running, sent):
    assert next_cycle(running, sent, repeat=True) is running
    assert not next_cycle(running, sent).moves


@pytest.mark.parametrize(
    ("running", "repeat"), [(SWING, False), (LEAVES.tail, True), (LEAVES.tail, False)]
)
def test_without_any_the_plate_rests(running, repeat):
    rest = next_cycle(running, [GOES_ON], repeat, 0.03)
    assert not rest.moves
    assert rest.period == 0.03
    assert next_cycle(running, [], repeat).period == IDLE_S


def test_a_player_starts_at_rest_and_stays_there():
    timeline = Timeline.at_rest(0.03)
    for count in range(4):
        assert not timeline.cycle.moves
        assert timeline.filling
        assert timeline.repeats == 0
        assert timeline.begin == pytest.approx(0.03 * count)
        timeline = timeline.next(5, 0.03)
    assert Timeline.at_rest().cycle.period == IDLE_S


def test_each_cycle_begins_in_the_end_state_of_the_previous_cycle():
    timeline = player(SWING, SHORT)
    assert (timeline.begin, timeline.end) == (3.0, 3.1)
    timeline = timeline.next()
    assert timeline.cycle is SHORT
    assert (timeline.begin, timeline.end) == (3.1, 3.1 + 1e-3)


def test_the_repetitions_of_each_cycle_that_was_sent_are_counted_from_zero():
    timeline = player(SWING, BIGGER).next(2)
    assert timeline == Timeline(BIGGER, 3.1)
    again = timeline.next(2)
    assert again == Timeline(BIGGER, again.begin, repeats=1)
    assert again.send(BIGGER).next(2).repeats == 0


@pytest.mark.parametrize("hold", [1, 2, 5])
def test_a_cycle_is_played_as_often_as_it_is_held_and_then_the_plate_rests(hold):
    timeline, played = player(SWING), []
    for _ in range(hold + 1):
        timeline = timeline.next(hold, 0.07)
        played.append(timeline)
    more = hold - 1  # it has been played once
    assert [one.repeats for one in played] == [*range(1, hold), 0, 0]
    assert all(one.cycle is SWING for one in played[:more])
    assert not any(one.filling for one in played[:more])
    assert all(one.filling and one.cycle.period == 0.07 for one in played[more:])
    assert not any(one.cycle.moves for one in played[more:])
    assert played[-1].send(SWING).next(hold, 0.07).cycle is SWING


def test_without_another_cycle_the_plate_rests_after_one_play():
    assert HOLD_CYCLES == 1
    assert not player(SWING).next().cycle.moves


def test_a_tail_runs_once_and_then_what_begins_at_rest():
    tail = player(LEAVES).next()
    assert tail.cycle is LEAVES.tail
    assert tail.filling
    assert tail.begin == pytest.approx(3.05)
    rest = tail.next(5, 0.03)
    assert not rest.cycle.moves
    assert rest.begin == pytest.approx(3.07)
    waits = player(LEAVES, SWING).next()
    assert waits.cycle is LEAVES.tail
    assert waits.waiting is SWING
    assert waits.next().cycle is SWING
    assert waits.send(BIGGER).next().cycle is BIGGER  # a newer one
    assert not waits.next().next().cycle.moves  # the waiting cycle was played
    assert waits.next().waiting is None


def test_a_tail_that_ends_as_it_begins_is_not_repeated():
    still = going(HOME, HOME)
    tail = player(still).next()
    assert tail.cycle is still.tail
    assert tail.cycle.closes
    assert tail.next(5, 0.03).cycle.period == 0.03


def test_a_waiting_cycle_that_cannot_follow_is_discarded():
    tail = player(LEAVES, OTHER).next()
    assert tail.cycle is LEAVES.tail
    assert tail.waiting is None
    rest = player(SWING, GOES_ON).next()
    assert not rest.cycle.moves
    assert rest.waiting is None


def test_the_newest_that_follows_waits_and_only_rest_goes_before_it():
    rest = PlateCycle.rest(0.1)
    assert player(LEAVES, GOES_ON, SWING).waiting is GOES_ON
    assert player(LEAVES, SWING, GOES_ON).waiting is GOES_ON
    assert player(LEAVES, SWING, BIGGER).waiting is BIGGER
    newer = going(STATE, STATE)
    assert player(LEAVES, GOES_ON, newer).next().cycle is newer
    stop = player(LEAVES, GOES_ON, rest)  # may be a stop
    assert stop.next().cycle is LEAVES.tail
    assert stop.next().next().cycle is rest


def test_a_sent_cycle_does_not_change_the_running_cycle():
    before = Timeline(SWING, 3.0, repeats=1)
    after = before.send(BIGGER)
    assert after == Timeline(SWING, 3.0, repeats=1, waiting=BIGGER)
    assert Timeline(LEAVES.tail, 3.0, filling=True).send(SWING).filling
