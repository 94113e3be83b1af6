"""The supervisor: every way from one phase to another, just before and just after."""

from dataclasses import replace

import pytest

from plate_planner.task import Phase, TaskLimits, TaskState, begin, judge, started

LIMITS = TaskLimits(time_limit_s=10.0, hold_s=0.5, wait_s=3.0, patience_s=1.0)
EPS = 1e-3
RUNNING = begin(started(), 100.0, (), LIMITS)
GONE = ("black_1",)


def run(*images, state=RUNNING):
    """Feed images (t, missing, goal met) and return the last state."""
    for t, missing, met in images:
        state = judge(begin(state, t, missing, LIMITS), t, missing, met, "", LIMITS)
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


def test_it_gives_up_waiting_for_parts():
    waiting = run((5.0, GONE, False), state=started())
    assert run((8.0, GONE, False), state=waiting).phase is Phase.RUNNING
    state = run((8.0 + EPS, ("2 of 5 black parts", "grey_1"), False), state=waiting)
    assert state.text == "failed: 2 of 5 black parts, grey_1 not seen within 3 s of start"


def test_done_when_the_goal_was_met_for_the_hold_time():
    assert run((101.0, (), True), (101.5 - EPS, (), True)).phase is Phase.RUNNING
    state = run((101.0, (), True), (101.5, (), True))
    assert (state.text, state.ended, state.elapsed(200.0)) == ("done", 101.5, 1.5)


def test_a_break_starts_the_hold_time_again():
    assert run((101.0, (), True), (101.3, (), False), (101.6, (), True)).phase is Phase.RUNNING
    assert run((101.0, (), True), (101.3, GONE, True), (101.6, (), True)).phase is Phase.RUNNING


def test_without_a_hold_time_the_first_image_counts():
    state = judge(RUNNING, 101.0, (), True, "", replace(LIMITS, hold_s=0.0))
    assert state.phase is Phase.DONE


def test_a_part_may_hide_for_a_while():
    assert run((101.0, GONE, False), (102.0, GONE, False)).phase is Phase.RUNNING
    assert (
        run((101.0, GONE, False), (101.9, (), False), (102.8, GONE, False)).phase is Phase.RUNNING
    )
    state = run((101.0, GONE, False), (102.0 + EPS, GONE, False))
    assert (state.text, state.ended) == ("failed: lost black_1", 102.0 + EPS)


def test_the_time_limit():
    assert run((110.0, (), False)).phase is Phase.RUNNING
    assert run((110.0 + EPS, (), False)).text == "failed: time limit of 10 s"


def test_done_at_the_last_moment_is_done():
    state = run((109.5, (), True), (110.0, (), True))
    assert state.phase is Phase.DONE


def test_a_problem_fails_the_task_with_its_reason():
    state = judge(RUNNING, 101.0, (), True, "black_1 is off", LIMITS)
    assert state.text == "failed: black_1 is off"


@pytest.mark.parametrize("phase", [Phase.DONE, Phase.FAILED, Phase.IDLE])
def test_what_has_ended_stays_ended(phase):
    ended = replace(RUNNING, phase=phase, ended=103.0)
    assert run((104.0, (), True), (999.0, GONE, False), state=ended) == ended
