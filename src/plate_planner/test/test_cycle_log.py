"""Which cycle ran when and how long one is: lost images, gaps, stamps that go back."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle
from plate_core.status import MAX_AGE_S
from plate_planner.estimation.cycle_log import MEMORY_S, CycleClock, CycleLog

SHORT, LONG = PlateCycle.rest(0.1), PlateCycle.rest(0.2)


def names(log):
    lengths = {SHORT.period: "short", LONG.period: "long"}
    return [(round(begin, 6), lengths[cycle.period]) for begin, cycle in log.runs]


def test_the_answer_to_an_image_runs_from_the_next_image_on():
    log = CycleLog().advance(0.0)
    assert not log.known
    log = log.record_cycle(SHORT, 0.01).advance(0.1).record_cycle(LONG, 0.11).advance(0.2)
    assert names(log) == [(0.1, "short"), (0.2, "long")]
    assert log.end == pytest.approx(0.4)
    assert log.period == pytest.approx(0.2)


def test_a_late_cycle_runs_a_cycle_later_and_the_plate_rests_for_the_time_of_the_last():
    log = CycleLog().record_cycle(SHORT, 0.0).advance(0.1).record_cycle(LONG, 0.1999).advance(0.2)
    assert names(log) == [(0.1, "short"), (0.2, "short")]
    assert names(log.advance(0.3)) == [(0.1, "short"), (0.2, "short"), (0.3, "long")]


def test_a_missed_image_leaves_no_hole():
    log = CycleLog().record_cycle(SHORT, 0.0).advance(0.1).record_cycle(LONG, 0.1).advance(0.6)
    assert names(log) == [(0.1, "short"), (0.2, "long"), (0.4, "long"), (0.6, "long")]


def test_stamps_that_jitter_are_where_cycles_begin():
    log = CycleLog().record_cycle(SHORT, 0.0).advance(0.1)
    for t in (0.203, 0.299, 0.401):
        log = log.advance(t)
    assert [run[0] for run in log.runs] == [0.1, 0.203, 0.299, 0.401]


def test_time_that_restarts():
    log = CycleLog().record_cycle(SHORT, 5.0).advance(5.1).record_cycle(LONG, 5.1).advance(0.0)
    assert not log.known
    assert log.sent == ()


def test_an_image_of_a_trigger_line_belongs_to_the_last_pulse_before_its_stamp():
    wave = np.sin(np.pi * np.arange(10) / 10) ** 4
    moving = PlateCycle.from_samples(0.1, 1e-3 * wave[:, None] * [1, 0, 0])
    log = CycleLog().started(SHORT, 0.9).started(moving, 1.0).started(moving, 1.1)
    for stamp, taken in ((1.03, 1.03), (1.06, 1.03), (1.104, 1.03), (1.106, 1.13), (1.19, 1.13)):
        assert log.triggered(stamp, 0.3) == pytest.approx(taken)
    assert log.triggered(1.18, 0.0) == pytest.approx(1.2)  # its start is not reported yet
    assert log.triggered(0.95, 0.3) == 0.95  # at rest it is all the same


def test_pieces_cover_the_requested_time():
    log = CycleLog().record_cycle(SHORT, 0.0).advance(0.1).record_cycle(LONG, 0.1).advance(0.2)
    pieces = list(log.between(0.05, 0.35))
    assert [cycle is SHORT for cycle, *_ in pieces] == [True, False]
    assert np.array([p[1:] for p in pieces]) == pytest.approx(
        np.array([[0.1, 0, 0.1], [0.2, 0, 0.15]])
    )
    assert not list(log.between(0.0, 0.1))
    # A run that was cut short by an early image is used as far as it went.
    cut = CycleLog(((0.0, SHORT), (0.09, LONG)))
    assert [p[3] - p[2] for p in cut.between(0.0, 0.29)] == pytest.approx([0.09, 0.2])


def test_the_log_drops_old_cycles():
    log = CycleLog().record_cycle(SHORT, 0.0)
    for k in range(1, 100):
        log = log.advance(0.1 * k)
    assert 15 <= len(log.runs) <= 17


def period_after(*stamps: float) -> float:
    clock = CycleClock.starting(0.1)
    for t in stamps:
        clock = clock.tick(t)
    return clock.period


def test_the_default_until_two_stamps_are_known():
    assert period_after() == 0.1
    assert period_after(5.0) == 0.1
    assert period_after(5.0, 5.05) == pytest.approx(0.05)


def test_one_lost_image_does_not_change_the_period():
    assert period_after(0.0, 0.05, 0.10, 0.20, 0.25) == pytest.approx(0.05)


def test_a_new_period_is_followed_after_two_images():
    assert period_after(0.0, 0.05, 0.10, 0.15, 0.35, 0.55) == pytest.approx(0.2)


@pytest.mark.parametrize("gap", [60.0, -10.0, 0.0, 1e-4])
def test_gaps_and_steps_back_leave_the_last_plausible_period(gap):
    assert period_after(0.0, 0.05, 0.10, 0.10 + gap) == pytest.approx(0.05)
    assert period_after(0.0, 0.05, 0.10, 0.10 + gap, 0.15 + gap) == pytest.approx(0.05)


def test_going_back_is_noticed():
    clock = CycleClock.starting(0.1)
    assert not clock.went_back(3.0)
    clock = clock.tick(3.0)
    assert clock.went_back(2.9)
    assert not clock.went_back(3.0)


def test_reports_determine_the_running_cycle_for_any_image_times():
    log = CycleLog().started(SHORT, 1.0).record_cycle(LONG, 1.05).advance(1.043)
    assert names(log) == [(1.0, "short")]
    # Until the next report the newest one follows at its end, else rest.
    assert names(log.advance(1.13)) == [(1.0, "short"), (1.1, "long")]
    assert names(log.started(LONG, 1.1004).advance(1.13)) == [(1.0, "short"), (1.1004, "long")]
    assert names(log.advance(1.13).started(SHORT, 1.102)) == [(1.0, "short"), (1.102, "short")]
    assert names(log.started(SHORT, 1.1).advance(1.33)) == [
        (1.0, "short"), (1.1, "short"), (1.2, "short"), (1.3, "short")
    ]  # fmt: skip


def test_reports_that_go_back_restart_the_log():
    log = CycleLog().started(SHORT, 9.0).started(LONG, 2.0)
    assert names(log) == [(2.0, "long")]


def test_a_reported_cycle_that_none_could_play_is_ignored():
    log = CycleLog().started(SHORT, 1.8e9)
    assert log.started(PlateCycle.rest(1e-9), 1.8e9 + 1) is log
    assert log.advance(1.8e9 + 1.02).end > 1.8e9 + 1


def swinging(k):
    """A cycle that differs from others."""
    pose = np.outer([0.0, 1e-4 * k, 0.0], [1, 0, 0])
    return PlateCycle.from_knots(np.array([0.0, 0.05, 0.1]), pose, 0 * pose, 0 * pose)


def played(count, late, log=None):
    """A log of `count` cycles of 0.1 s, each `late` cycles later than requested."""
    log = (log or CycleLog()).started(swinging(0), 0.0)
    for k in range(1, count):
        log = log.record_cycle(swinging(k), 0.1 * k - 0.02, 0.1 * (k - 1))
        log = log.started(swinging(max(k - late, 0)), 0.1 * k)
    return log


@pytest.mark.parametrize("late", [0, 1, 2, 3])
def test_the_delay_of_results_is_estimated(late):
    log = played(12, late)
    assert log.delay == late
    ahead = log.until_result
    assert ahead.end == pytest.approx(log.end + 0.1 * late)
    # The sent cycles begin one after the other.
    last = [cycle.knot_pose[1, 0] for _, cycle in ahead.runs[-1 - late :]]
    assert last == pytest.approx([1e-4 * k for k in range(11 - late, 12)])


def test_the_plate_rests_until_a_delayed_cycle_begins():
    log = replace(played(14, 3), sent=played(14, 3).sent[1:])
    ahead = log.until_result
    last = [cycle.knot_pose[1, 0] for _, cycle in ahead.runs[-4:]]
    assert last == pytest.approx([10e-4, 0.0, 12e-4, 13e-4])
    assert ahead.end == pytest.approx(log.end + 0.3)


def test_one_late_result_does_not_change_the_estimated_delay():
    log = played(8, 0)
    log = (
        log.record_cycle(swinging(50), 0.75, 0.7)
        .started(swinging(7), 0.8)
        .started(swinging(50), 0.9)
    )
    assert log.delay == 0
    assert log.until_result == log


def test_a_cycle_that_is_due_is_expected_before_it_is_reported():
    log = played(12, 1)  # from 1.1 to 1.2 s the tenth sent cycle runs
    for one in (log, log.record_cycle(swinging(12), 1.19, 1.1)):
        assert one.advance(1.21).runs[-1][1].knot_pose[1, 0] == pytest.approx(11e-4)


def test_rest_and_unknown_cycles_are_ignored():
    log = played(12, 1)
    for k in range(12, 20):
        log = log.record_cycle(PlateCycle.rest(0.1), 0.1 * k - 0.02, 0.1 * (k - 1))
        log = log.started(PlateCycle.rest(0.1), 0.1 * k)
    assert log.delay == 1
    assert log.started(swinging(99), 2.0).delay == 1


HOME, STATE = np.zeros((3, 3)), np.array([[1e-3, 0, 0], [0.02, 0, 0], [0, 0, 0]])


def going(begin, end):
    """A cycle of 0.1 s from one state of the plate to another, with a tail of 0.05 s."""
    knots = np.stack([begin, end, end, HOME], axis=1)
    return PlateCycle.from_knots(np.array([0.0, 0.1, 0.1, 0.15]), *knots)


LEAVES, GOES_ON = going(HOME, STATE), going(STATE, 2 * STATE)


def reported(*runs):
    """A log of reported runs, of a camera that is triggered at their starts."""
    log = CycleLog()
    for begin, cycle in runs:
        log = log.started(cycle, begin, triggered=True)
    return log


def test_the_state_of_the_plate_is_certain_only_while_reports_come():
    assert not CycleLog().certain
    assert not CycleLog().record_cycle(LEAVES, 0.95).advance(1.0).certain
    log = reported((1.0, LEAVES)).record_cycle(GOES_ON, 1.05, 1.0)
    assert log.certain
    assert np.array_equal(log.until_result.plate, STATE)
    log = log.advance(1.1)  # the report may come after the image
    assert log.certain
    assert np.array_equal(log.until_result.plate, 2 * STATE)
    log = log.advance(1.2)
    assert not log.certain
    assert log.runs[-1][1] is GOES_ON.tail
    assert log.started(SHORT, 1.25, triggered=True).certain


def test_a_report_overrides_the_expected_start():
    expected = reported((1.0, LEAVES)).record_cycle(GOES_ON, 1.05, 1.0).advance(1.1)
    log = expected.started(LEAVES.tail, 1.1, triggered=True)
    assert [cycle for _, cycle in log.runs] == [LEAVES, LEAVES.tail]
    assert np.array_equal(log.until_result.plate, HOME)
    assert log.end == pytest.approx(1.15)
    # A refused cycle is no longer expected, because it does not begin at rest.
    assert not log.advance(1.15).runs[-1][1].moves


def test_a_report_that_comes_again_changes_nothing():
    log = reported((1.0, LEAVES), (1.1, GOES_ON)).record_cycle(SHORT, 1.15, 1.1)
    for begin, cycle in log.runs:
        assert log.started(cycle, begin, triggered=True) is log


def test_a_cycle_that_has_begun_does_not_begin_again_without_its_report():
    log = (
        reported((1.0, SHORT))
        .record_cycle(LEAVES, 1.05, 1.0)
        .advance(1.1)
        .advance(1.2)
        .advance(1.25)
    )
    assert [cycle.moves for _, cycle in log.runs] == [False, True, True, False]
    assert not log.advance(1.35).runs[-1][1].moves


def test_an_image_older_than_the_last_report_does_not_replace_it():
    log = reported((1.0, LEAVES), (1.1, LEAVES.tail), (1.15, SHORT))
    assert log.advance(1.1) == log
    assert log.advance(1.0).certain
    assert not log.advance(0.9).known  # time has restarted


def test_a_tail_does_not_change_the_cycle_period():
    log = reported((1.0, LEAVES), (1.1, LEAVES.tail))
    assert log.period == pytest.approx(0.1)
    assert log.end == pytest.approx(1.15)
    assert log.advance(1.15).period == pytest.approx(0.1)
    # One that waits for the end of a tail is not late.
    log = CycleLog().started(LEAVES, 1.0).record_cycle(swinging(3), 1.05, 1.0)
    log = log.started(LEAVES.tail, 1.1).started(swinging(3), 1.15)
    assert log.delays == (0,)


def test_the_motion_is_not_certain_if_results_are_late():
    assert played(12, 0).certain
    assert not played(12, 1).certain


def test_a_cycle_is_known_again_in_spite_of_rounding():
    log = played(12, 0).record_cycle(swinging(12), 1.15, 1.1)
    rounded = replace(swinging(12), knot_pose=swinging(12).knot_pose + 1e-16)
    assert log.started(rounded, 1.2).sent == ()


@pytest.mark.parametrize("tail_s", [1e-6, 1e9])
def test_a_report_with_an_impossible_tail_is_ignored(tail_s):
    still, times = np.zeros((4, 3)), np.array([0.0, 0.1, 0.1, 0.1 + tail_s])
    odd = PlateCycle.from_knots(times, still, still, still)
    log = CycleLog().record_cycle(PlateCycle.rest(0.1), 0.0).advance(0.1)
    assert log.record_cycle(odd, 0.11) == log
    assert log.started(odd, 0.2) == log


def test_cycles_that_move_the_plate_without_an_answer_are_counted():
    log = played(12, 0)
    assert (log.begun, log.unanswered_cycles) == (12, 0)
    again = log.started(swinging(11), 1.2)
    assert (again.begun, again.unanswered_cycles) == (13, 1)
    assert again.started(swinging(11), 1.2) == again  # reported once more
    assert log.started(SHORT, 1.2).unanswered_cycles == 0  # rest
    # No request leads to a tail, unless rest was requested.
    log = CycleLog().started(SHORT, 0.9).record_cycle(LEAVES, 0.95, 0.9).started(LEAVES, 1.0)
    assert log.started(LEAVES.tail, 1.1).unanswered_cycles == 1
    assert log.record_cycle(SHORT, 1.05, 1.0).started(LEAVES.tail, 1.1).unanswered_cycles == 0


def test_a_cycle_that_is_played_otherwise_than_sent_is_no_lack_of_an_answer():
    log = played(12, 0).record_cycle(swinging(12), 1.15, 1.1)
    smaller = swinging(12).scaled(0.9)  # beyond a limit
    log = log.started(smaller, 1.2)
    assert (log.begun, log.unanswered_cycles) == (13, 0)
    assert log.started(smaller, 1.3).unanswered_cycles == 1
    # Nor is one whose report overtakes the cycle itself.
    assert played(12, 0).started(swinging(12), 1.2).unanswered_cycles == 0


def test_a_clock_that_was_set_back_makes_all_older_things_forgotten():
    log = played(12, 1).record_cycle(swinging(12), 1.15, 1.1)
    new = log.started(SHORT, log.begin - MEMORY_S - 1e-3)
    assert new == CycleLog(((new.begin, SHORT),), free_running=True, last_report=new.begin)
    assert not log.started(SHORT, log.begin - MEMORY_S - 1e-3, triggered=True).free_running
    # So old is the oldest report that is taken for a late one.
    late = log.started(SHORT, log.begin - MEMORY_S)
    assert (late.begun, late.delays) == (log.begun + 1, log.delays)


def test_reports_also_show_whether_images_are_taken_at_starts():
    log = CycleLog().started(SHORT, 1.0)
    assert log.free_running
    assert not log.started(SHORT, 1.1, triggered=True).free_running


def test_sent_cycles_are_kept_during_a_long_time_without_images():
    log = CycleLog().record_cycle(SHORT, 0.0).advance(0.1).record_cycle(swinging(3), 0.15)
    late = 0.2 + MEMORY_S + 1e-3
    log = log.advance(late)
    assert [begin for begin, _ in log.runs] == [late]
    assert log.runs[0][1].moves
    assert log.solved_start == 0.1


def test_an_expected_cycle_may_move_the_plate_until_it_has_begun():
    log = reported((1.0, SHORT)).record_cycle(LEAVES, 1.05, 1.0)
    assert log.may_move(1.1)
    assert not log.may_move(1.0 - MEMORY_S - 1e-3)  # the clock was put back
    assert log.started(SHORT, 1.1).may_move(1.1)
    assert not log.started(LEAVES, 1.1).may_move(1.1)
    assert log.record_cycle(SHORT, 1.06, 1.0).may_move(1.1)  # rest does not call it back
    ends = 1.0 + MAX_AGE_S + LEAVES.period
    assert log.may_move(ends - 1e-6)
    assert not log.may_move(ends)


def test_a_cycle_that_waits_for_its_report_is_sent_until_then():
    log = (
        reported((1.0, SHORT))
        .record_cycle(swinging(1), 1.02, 1.0)
        .record_cycle(swinging(2), 1.05, 1.0)
    )
    assert log.advance(1.1).sent == log.sent
    assert [one.cycle.knot_pose[1, 0] for one in log.started(swinging(1), 1.1).sent] == [2e-4]
    assert log.started(swinging(2), 1.1).sent == ()
    assert log.started(swinging(3), 1.1).sent == log.sent


def test_a_report_keeps_what_ended_a_short_while_ago():
    log = CycleLog().started(SHORT, 1.0)  # to 1.1 s
    assert names(log.started(SHORT, 1.1 + MEMORY_S - 0.05)) == [(1.0, "short"), (2.55, "short")]
    assert names(log.started(SHORT, 1.1 + MEMORY_S + 0.05)) == [(2.65, "short")]
