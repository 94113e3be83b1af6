"""The phase of a task: every way from one phase to another, just before and just after."""

import math
from dataclasses import replace

import pytest

from plate_planner.supervision import (
    Failure,
    Findings,
    Phase,
    Reason,
    TaskLimits,
    TaskState,
    begin,
    evaluate,
    started,
    stopped,
)
from plate_planner.supervision.phase import CHECK_IMAGE

LIMITS = TaskLimits(
    time_limit_s=10.0, hold_s=0.5, start_timeout_s=3.0, unseen_timeout_s=1.0, nearer_m=0.002
)
EPS = 1e-3
RUNNING = begin(started(), 100.0, (), True, LIMITS)
GONE = ("black_1",)


def run(*images, state=RUNNING):
    """Feed images (t, missing, goal met) and return the last state."""
    for t, missing, met in images:
        state = begin(state, t, missing, True, LIMITS)
        state = evaluate(state, t, Findings(missing, met, 0.0), LIMITS)
    return state


def test_idle_stays_idle():
    state = run((1.0, (), True), (2.0, GONE, False), state=TaskState())
    assert state == TaskState()
    assert state.text == "idle"
    assert not state.active


def test_time_begins_with_the_first_image_that_shows_all_parts():
    state = run((5.0, GONE, False), (6.0, GONE, False), state=started())
    assert (state.phase, state.active, state.elapsed(6.0)) == (Phase.RUNNING, False, 0.0)
    state = run((7.5, (), False), state=state)
    assert (state.active, state.began, state.elapsed(9.0)) == (True, 7.5, 1.5)


def test_a_task_ends_if_parts_stay_missing():
    waiting = run((5.0, GONE, False), state=started())
    assert run((8.0, GONE, False), state=waiting).phase is Phase.RUNNING
    state = run((8.0 + EPS, ("2 of 5 black parts", "grey_1"), False), state=waiting)
    why = "aborted: 2 of 5 black parts, grey_1 not detected within 3 s of the start; "
    assert state.text == why + CHECK_IMAGE


def test_a_task_ends_if_the_same_parts_go_missing_again():
    waiting = begin(started(), 5.0, (), False, LIMITS)
    assert not waiting.active
    assert begin(waiting, 8.0, (), False, LIMITS).phase is Phase.RUNNING
    state = begin(waiting, 8.0 + EPS, (), False, LIMITS)
    assert (
        state.text
        == "aborted: no two images with equal parts within 3 s of the start; " + CHECK_IMAGE
    )


def test_done_when_the_goal_was_met_for_the_hold_time():
    assert run((101.0, (), True), (101.5 - EPS, (), True)).phase is Phase.RUNNING
    state = run((101.0, (), True), (101.5, (), True))
    assert (state.text, state.ended, state.elapsed(200.0)) == ("done after 1.5 s", 101.5, 1.5)


def test_a_break_starts_the_hold_time_again():
    assert run((101.0, (), True), (101.3, (), False), (101.6, (), True)).phase is Phase.RUNNING
    assert run((101.0, (), True), (101.3, GONE, False), (101.6, (), True)).phase is Phase.RUNNING


def test_without_a_hold_time_the_first_image_counts():
    state = evaluate(RUNNING, 101.0, Findings((), True, 0.0), replace(LIMITS, hold_s=0.0))
    assert state.phase is Phase.DONE


def fell(name):
    return Failure(Reason.PART_LEFT, f"{name} fell")


def test_the_end_reports_the_result_and_the_fate_of_a_part():
    limits = replace(LIMITS, hold_s=0.0)
    done = evaluate(RUNNING, 101.0, Findings((), True, 0.0, outcome="4 of 4 parts"), limits)
    assert done.text == "done after 1.0 s: 4 of 4 parts"
    found = Findings(("black_1", "grey_2"), False, 0.0, loss=fell)
    state = evaluate(evaluate(RUNNING, 101.0, found, LIMITS), 102.1, found, LIMITS)
    assert state.text == "lost part after 2.1 s: black_1 fell; grey_2 fell"
    assert state.reason is Reason.PART_LEFT


def test_a_time_limit_reports_whether_parts_still_approached():
    near = evaluate(RUNNING, 100.0, Findings((), False, 0.2), LIMITS)
    near = evaluate(near, 109.0, Findings((), False, 0.1), LIMITS)
    state = evaluate(near, 110.1, Findings((), False, 0.1, detail=lambda: "8 mm to go"), LIMITS)
    assert state.text == (
        "stuck after 10.1 s: time limit of 10 s (the parts still get nearer to "
        "their goals: increase time_limit_s); 8 mm to go"
    )


def test_the_explanation_of_a_failure_is_computed_only_at_the_end():
    called = []
    found = Findings(GONE, False, 0.1, detail=lambda: called.append(1) or "", loss=called.append)
    state = evaluate(evaluate(RUNNING, 101.0, found, LIMITS), 102.0, found, LIMITS)
    assert (state.phase, called) == (Phase.RUNNING, [])


def test_a_part_may_hide_for_a_while():
    assert run((101.0, GONE, False), (102.0, GONE, False)).phase is Phase.RUNNING
    assert (
        run((101.0, GONE, False), (101.9, (), False), (102.8, GONE, False)).phase is Phase.RUNNING
    )
    state = run((101.0, GONE, False), (102.0 + EPS, GONE, False))
    assert (state.text, state.ended) == ("lost part after 2.0 s: black_1", 102.0 + EPS)


def test_a_task_is_not_done_while_a_part_is_only_predicted():
    """The part may have fallen off. Once all parts are detected again, the hold continues."""
    state = evaluate(RUNNING, 100.0, Findings((), True, 0.0), LIMITS)
    hidden = evaluate(state, 101.0, Findings((), True, 0.0, all_seen=False), LIMITS)
    assert hidden.phase is Phase.RUNNING
    assert evaluate(hidden, 101.1, Findings((), True, 0.0), LIMITS).phase is Phase.DONE


def test_a_task_is_not_done_before_the_plate_rests():
    """An image of a moving plate shows a part that this cycle leaves behind the edge."""
    swing, still = (Findings((), True, 0.0, at_rest=rest) for rest in (False, True))
    held = evaluate(evaluate(RUNNING, 101.0, swing, LIMITS), 101.5, swing, LIMITS)
    assert held.phase is Phase.RUNNING
    assert held.held(101.5, LIMITS)
    assert evaluate(held, 101.8, still, LIMITS).text == "done after 1.8 s"
    slid = evaluate(held, 101.8, replace(still, goal_met=False), LIMITS)
    assert (slid.phase, slid.held(101.8, LIMITS)) == (Phase.RUNNING, False)
    gone = replace(still, missing=GONE, loss=fell)
    end = evaluate(evaluate(held, 101.8, gone, LIMITS), 102.8 + EPS, gone, LIMITS)
    assert (end.phase, end.reason) == (Phase.LOST, Reason.PART_LEFT)


def test_a_goal_held_within_the_time_limit_gets_time_to_come_to_rest():
    swing, still = (Findings((), True, 0.0, at_rest=rest) for rest in (False, True))
    held = evaluate(evaluate(RUNNING, 109.5, swing, LIMITS), 110.0, swing, LIMITS)
    assert evaluate(held, 110.3, still, LIMITS).phase is Phase.DONE
    assert evaluate(held, 111.0, swing, LIMITS).phase is Phase.RUNNING
    assert evaluate(held, 111.0 + EPS, swing, LIMITS).reason is Reason.TIME_LIMIT


def test_the_time_limit():
    assert run((110.0, (), False)).phase is Phase.RUNNING
    state = run((101.0, (), False), (110.0 + EPS, (), False))
    assert state.text == "stuck after 10.0 s: time limit of 10 s"


def test_done_at_the_last_moment_is_done():
    state = run((109.5, (), True), (110.0, (), True))
    assert state.phase is Phase.DONE


def test_a_problem_ends_the_task_with_its_reason():
    state = evaluate(RUNNING, 101.0, Findings((), True, 0.0, "black_1 is off"), LIMITS)
    assert (state.phase, state.text) == (Phase.STUCK, "stuck after 1.0 s: black_1 is off")


def at_distances(*to_go, missing=(), met=False, stuck_timeout_s=3.0):
    """Return the last state after images a second apart with these distances to the goal [m]."""
    state, limits = RUNNING, replace(LIMITS, stuck_timeout_s=stuck_timeout_s, unseen_timeout_s=50.0)
    for k, distance in enumerate(to_go):
        found = Findings(missing, met, distance, detail=lambda: "grey_2 is 8.0 mm short")
        state = evaluate(state, 100.0 + k, found, limits)
    return state


def test_no_progress_for_long_is_stuck_and_names_the_part():
    assert at_distances(0.1, 0.09, 0.09, 0.0885, 0.09).phase is Phase.RUNNING
    state = at_distances(0.1, 0.09, 0.09, 0.0885, 0.09, 0.0885)
    reason = "no progress for 3 s; grey_2 is 8.0 mm short"
    assert state.text == f"stuck after 5.0 s: {reason}"
    assert at_distances(0.1, 0.09, 0.09, 0.087, 0.09, 0.089).phase is Phase.RUNNING


def test_unseen_parts_are_no_progress_and_a_goal_that_is_met_is_not_stuck():
    hidden = at_distances(0.1, 0.02, 0.02, missing=GONE)
    assert hidden.nearest_m == math.inf
    limits = replace(LIMITS, stuck_timeout_s=0.2)
    state = evaluate(RUNNING, 100.0, Findings((), True, 0.0), limits)
    assert evaluate(state, 100.4, Findings((), True, 0.0), limits).phase is Phase.RUNNING


def test_to_stop_aborts_a_running_task_only():
    assert stopped(RUNNING, 103.0).text == "aborted after 3.0 s: stopped"
    assert stopped(RUNNING, 103.0).reason is Reason.STOPPED
    assert stopped(started(), None).text == "aborted: stopped"
    done = replace(RUNNING, phase=Phase.DONE, ended=103.0)
    assert stopped(done, 104.0) == stopped(TaskState(), 104.0) == TaskState()


@pytest.mark.parametrize("phase", [Phase.DONE, Phase.STUCK, Phase.LOST, Phase.ABORTED, Phase.IDLE])
def test_an_ended_task_stays_ended(phase):
    ended = replace(RUNNING, phase=phase, ended=103.0)
    assert run((104.0, (), True), (999.0, GONE, False), state=ended) == ended


def test_the_timeout_is_for_each_part():
    # Every image lacks a part, but never the same one for long.
    images = [(100.0 + 0.4 * k, (f"black_{k % 2 + 1}",), False) for k in range(20)]
    assert run(*images).active
    same = [(100.0 + 0.4 * k, ("black_3", f"black_{k % 2 + 1}"), False) for k in range(20)]
    state = run(*same)
    assert state.phase is Phase.LOST
    assert (state.reason, state.detail) == (Reason.PART_UNSEEN, "black_3")


def test_an_incomplete_image_does_not_break_the_hold_nor_end_the_task():
    unseen = run((100.0, (), True), (100.3, GONE, True), (100.6, GONE, True))
    assert unseen.active
    assert run((100.7, (), True), state=unseen).phase is Phase.DONE
    # A part that is seen short of its goal does break it.
    assert run((100.7, (), False), (100.8, (), True), state=unseen).active
    assert run((100.0, GONE, True), (100.6, (), True)).active


@pytest.mark.parametrize(
    ("found", "phase"),
    [
        (Findings((), True, 0.0, outcome="10 of 10"), Phase.DONE),
        (Findings((), False, 1.0, problem="30 mm off"), Phase.STUCK),
        (Findings((), False, 1.0, detail=lambda: "black_1"), Phase.STUCK),
        (Findings(GONE, False, 1.0), Phase.LOST),
    ],
)
def test_an_end_reports_the_number_of_unanswered_cycles(found, phase):
    texts = []
    for slow in ("", "9 of 90 cycles were not answered in time"):
        now = replace(found, unanswered=slow)
        state = evaluate(evaluate(RUNNING, 109.0, now, LIMITS), 111.0, now, LIMITS)
        assert state.phase is phase
        texts.append(state.text)
    assert slow in texts[1]
    assert len(texts[1]) == len(texts[0]) + len(slow) + len("; ")
