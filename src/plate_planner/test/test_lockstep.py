"""When the planner answers: in lockstep, and with a free-running camera. No ROS."""

import itertools

import numpy as np
import pytest

from plate_core import PlateCycle
from plate_planner.lockstep import Lockstep
from plate_planner.request_schedule import RequestSchedule

REST = PlateCycle.rest(0.2)


def running():
    """Lockstep of a running task. The request for the image before, at 0 ns, has no answer yet."""
    lockstep = Lockstep(enabled=True)
    lockstep.add_start("start 0", 0)
    lockstep.add_image("image 0", 0, 0.0)
    assert lockstep.next_image() == ("image 0", ["start 0"])
    lockstep.goal_accepted()
    lockstep.request_sent(0)
    return lockstep


def test_without_lockstep_each_image_is_planned_at_once():
    lockstep = Lockstep(enabled=False)
    lockstep.request_sent(50)
    assert lockstep.next_image() is None
    lockstep.add_image("image", 100, 0.0)
    assert lockstep.next_image() == ("image", [])
    assert lockstep.next_image() is None


@pytest.mark.parametrize("order", list(itertools.permutations(("image", "start", "cycle"))))
def test_an_image_is_planned_when_start_and_cycle_have_arrived_in_any_order(order):
    lockstep = running()
    planned = []
    for name in order:
        if name == "image":
            lockstep.add_image("image 1", 100, 1.0)
        elif name == "start":
            lockstep.add_start("start 1", 100)
        else:
            assert lockstep.cycle_received(0)
        planned.append(lockstep.next_image())
    assert planned == [None, None, ("image 1", ["start 1"])]


def test_a_cycle_that_answers_an_earlier_request_does_not_count():
    lockstep = running()
    assert not lockstep.cycle_received(-100)
    assert lockstep.unanswered


def test_the_second_image_waits_for_a_goal_but_the_first_one_does_not():
    lockstep = Lockstep(enabled=True)
    lockstep.starts_required = False
    lockstep.add_image("image 0", 0, 0.0)
    assert lockstep.next_image() == ("image 0", [])
    lockstep.request_sent(0)
    assert lockstep.cycle_received(0)
    lockstep.add_image("image 0", 0, 0.1)
    assert lockstep.next_image() == ("image 0", [])
    lockstep.add_image("image 1", 100, 0.2)
    assert lockstep.next_image() is None
    lockstep.goal_accepted()
    assert lockstep.precedes_goal(0)
    assert not lockstep.precedes_goal(100)
    assert lockstep.next_image() == ("image 1", [])


def test_an_overdue_cycle_or_start_is_not_waited_for():
    lockstep = running()
    lockstep.add_image("image 1", 100, 1.0)
    lockstep.add_image("image 1", 100, 1.9)  # repeated: it has waited since 1.0 s
    lockstep.stop_waiting(1.5, 0.5, answer_overdue=True)
    assert not lockstep.unanswered
    assert lockstep.starts_required
    assert lockstep.next_image() is None
    lockstep.stop_waiting(1.6, 0.5, answer_overdue=False)
    assert lockstep.next_image() == ("image 1", [])
    # A report shows that somebody reports starts after all.
    lockstep.request_sent(100)
    lockstep.cycle_received(100)
    lockstep.add_start("start 2", 200)
    lockstep.add_image("image 2", 200, 2.0)
    assert lockstep.next_image() == ("image 2", ["start 2"])
    assert lockstep.starts_required


def test_with_a_free_running_camera_the_answer_is_due_before_the_cycle_ends():
    schedule = RequestSchedule(answer_s=0.05, period=0.1)
    assert not schedule.take_due()
    assert schedule.record_start(REST, 10.0)
    assert schedule.wait_s(arrival=10.02) == pytest.approx(0.13)
    assert schedule.wait_s(arrival=9.9) == pytest.approx(0.15)  # an early clock changes nothing
    assert schedule.take_due()
    assert not schedule.take_due()


def test_a_repeated_report_of_a_start_does_not_delay_the_answer():
    schedule = RequestSchedule(answer_s=0.05, period=0.1)
    wave = 1e-3 * np.sin(np.arange(8) / 8 * 2 * np.pi) ** 2
    moving = PlateCycle.from_samples(0.2, np.outer(wave, [1, 0, 0]))
    assert schedule.record_start(REST, 10.0)
    assert not schedule.record_start(REST, 10.01)
    assert schedule.record_start(moving, 10.02)  # another cycle
    assert schedule.record_start(moving, 10.2)
    assert schedule.record_start(moving, 9.0)  # the clock was set back
