"""The client without a planner, or with a planner that sends nothing."""

import os
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from plate_client import PlateClient
from plate_client.ros import client
from plate_core import PlateError
from plate_core.tasks import PartTarget
from plate_interfaces.action import SortParts
from plate_interfaces.msg import TaskProgress


def test_targets_without_subscribers_are_reported(monkeypatch):
    monkeypatch.setattr(client, "DISCOVERY_S", 0.1)
    why = "no node in this ROS domain subscribes to targets; start the planner"
    with (
        PlateClient.connect(f"/nobody_{os.getpid()}") as plate,
        pytest.raises(PlateError, match=why),
    ):
        plate.move_targets([PartTarget("black_1", (0.0, 0.0))])


@pytest.fixture(name="silent")
def _silent(monkeypatch):
    """A client without a planner, and a goal; all waits are over at once."""
    monkeypatch.setattr(client, "ANSWER_S", -1.0)
    with PlateClient.connect(f"/silent_{os.getpid()}") as plate:
        plate._until = lambda true, timeout_s: true()
        task = client.Task("sort_parts", lambda feedback, answer: plate.sent.append(answer))
        plate.sent = []
        monkeypatch.setattr(plate, "send", lambda goal, waiting: task.send() or task)
        yield plate, task


def test_a_planner_without_feedback_is_not_waited_for(silent):
    plate, task = silent
    task.send()
    said = []
    with pytest.raises(PlateError, match="the planner has sent no message for 2 s"):
        plate.wait(task, meanwhile=lambda: said.append(task))
    rounds = len(said)
    assert rounds * client.AGAIN_S == pytest.approx(client.TIMEOUT_S)

    def speak():
        task.feedbacks += len(said) == rounds + 5
        said.append(task)

    with pytest.raises(PlateError, match="the planner has sent no message"):
        plate.wait(task, meanwhile=speak)
    assert len(said) > 2 * rounds + 5


def test_a_goal_that_is_not_answered_is_sent_again_and_then_given_up(silent):
    plate, _ = silent
    with pytest.raises(PlateError, match="the planner has not answered the goal"):
        plate.start(SortParts.Goal())
    assert len(plate.sent) > 1


def test_a_goal_of_which_only_the_answer_was_lost_runs_on(silent):
    """It is known to the planner, which refuses its id when it comes again."""
    plate, task = silent
    results = []
    handle = SimpleNamespace(
        accepted=False,
        get_result_async=lambda: SimpleNamespace(add_done_callback=results.append),
        cancel_goal_async=lambda: pytest.fail("canceled"),
    )

    def until(true, timeout_s):
        task.progress = TaskProgress(parts_total=4)  # its feedback comes
        if len(plate.sent) > 1:
            plate.sent[1](SimpleNamespace(result=lambda: handle))
        return true()

    plate._until = until
    assert plate.start(SortParts.Goal()) is task
    assert len(plate.sent) == 2
    assert results == [task._on_result]
    assert not task.ended


def test_a_goal_that_is_refused_at_once_has_ended(silent):
    plate, _ = silent

    def until(true, timeout_s):
        plate.sent[0](SimpleNamespace(result=lambda: SimpleNamespace(accepted=False)))
        return true()

    plate._until = until
    assert plate.start(SortParts.Goal()).status.text == "the planner refused the goal"
