"""Steps of a clock: the earliest time of a stamp, against clocks whose steps are known."""

import numpy as np
import pytest

from plate_core.clock_steps import KEPT_S, MAX_STEPS, STEP_NS, ClockSteps, read_together

S = 1_000_000_000


def readings(*pairs):
    """Return the record after readings (steady clock, clock), both in s."""
    record = ClockSteps()
    for now, clock in pairs:
        record = record.with_reading(now, round(S * clock))
    return record


def test_a_stamp_is_its_own_time_if_the_clock_does_not_step():
    record = readings((0, 100), (1, 101), (2, 102.015))  # 15 ms is no step
    assert record.steps == ()
    assert record.earliest_ns(101 * S) == 101 * S


def test_a_stamp_from_before_a_step_back_is_older_than_it_seems():
    record = readings((0, 100), (1, 101), (1.02, 100.12))  # by 0.9 s
    assert record.earliest_ns(100 * S) == 99.1 * S
    assert record.earliest_ns(round(101.02 * S)) == round(100.12 * S)
    # No clock has shown a later time before the step.
    assert record.earliest_ns(round(101.03 * S)) == round(101.03 * S)


def test_a_step_forward_does_not_reduce_the_age_of_a_stamp():
    record = readings((0, 100), (1, 101.9))
    assert record.earliest_ns(round(100.9 * S)) == round(100.9 * S)


def test_steps_forth_and_back_are_added():
    record = readings((0, 100), (1, 101.5), (2, 102))
    assert record.earliest_ns(100 * S) == round(99.5 * S)  # as of a clock that was 0.5 s ahead
    assert readings((0, 100), (1, 100.7), (2, 101.4)).earliest_ns(100 * S) == round(99.4 * S)


def test_a_step_is_forgotten_when_no_message_can_be_on_its_way():
    record = readings((0, 100), (1, 0), (KEPT_S + 0.9, KEPT_S - 0.1))
    assert record.earliest_ns(50 * S) == -51 * S
    assert record.with_reading(KEPT_S + 1.1, round(S * (KEPT_S + 0.1))).steps == ()


def test_stamps_of_a_clock_with_too_many_steps_are_too_old():
    """The clock is set forth by 0.1 s at each reading, so its steps alone make no stamp older."""
    record = readings(*((k, 100 + 1.1 * k) for k in range(MAX_STEPS + 1)))
    assert record.usable
    assert record.earliest_ns(110 * S) == 110 * S
    now = MAX_STEPS + 1.0
    for k in range(3):  # further steps
        record = record.with_reading(now + k, round(S * (100 + 1.1 * (now + k))))
        assert not record.usable
        assert record.earliest_ns(110 * S) == round((110 - KEPT_S) * S)
    offset = 100 + 0.1 * (now + 2)
    # MAX_STEPS + 3 steps were noticed, from 1 s on. Three of them must be forgotten.
    later = [record.with_reading(t, round(S * (t + offset))) for t in (KEPT_S + 2.9, KEPT_S + 3.1)]
    assert [one.usable for one in later] == [False, True]


@pytest.mark.parametrize("seed", range(5))
def test_no_stamp_is_older_than_its_earliest_time(seed):
    """A clock with random steps is read every 20 ms; the true time of each stamp is known."""
    rng = np.random.default_rng(seed)
    times = np.arange(0, 10, 0.02)
    begins, sizes = np.sort(rng.uniform(0, 10, 4)), rng.uniform(-1, 1, 4)
    clock = [100 + t + sizes[begins <= t].sum() for t in times]
    record, seen = ClockSteps(), []
    for t, shown in zip(times, clock, strict=True):
        record = record.with_reading(t, round(S * shown))
        seen.append((t, round(S * shown)))
        for taken, stamp_ns in seen[:: rng.integers(10, 50)]:
            age_ns = round(S * shown) - record.earliest_ns(stamp_ns)
            assert age_ns >= S * (t - taken) - 4 * STEP_NS


def test_an_interruption_between_the_clocks_is_no_step():
    time, pauses = [1.0], [0.05]

    def clock_ns():
        shown = round(S * time[0]) + 100 * S
        time[0] += pauses.pop() if pauses else 0.0
        return shown

    record = readings((0, 100))
    assert len(record.with_reading(1.05, 101 * S).steps) == 1  # the interrupted reading
    assert record.with_reading(*read_together(lambda: time[0], clock_ns)).steps == ()


def test_if_each_reading_is_interrupted_the_shortest_one_counts():
    pauses, time = [0.05, 0.03, 0.01, 0.04, 0.05], [1.0]

    def clock_ns():
        time[0] += pauses.pop(0)
        return 7

    now, clock = read_together(lambda: time[0], clock_ns)
    assert (now, clock, pauses) == (pytest.approx(1.09), 7, [])
