"""The client where there is no planner, or one that says nothing."""

import os

import pytest

pytest.importorskip("rclpy")

from plate_client import PlateClient, client
from plate_core import PlateError
from plate_core.tasks import PartTarget
from plate_interfaces.action import SortParts


def test_targets_that_nobody_hears_are_said(monkeypatch):
    monkeypatch.setattr(client, "FOUND_S", 0.1)
    why = "nobody hears targets: does the planner run"
    with (
        PlateClient.connect(f"/nobody_{os.getpid()}") as plate,
        pytest.raises(PlateError, match=why),
    ):
        plate.move_targets([PartTarget("black_1", (0.0, 0.0))])


@pytest.fixture(name="silent")
def _silent(monkeypatch):
    """A client whose goals nobody answers; all waits are over at once."""
    monkeypatch.setattr(client, "FOUND_S", 0.0)
    with PlateClient.connect(f"/silent_{os.getpid()}") as plate:
        plate._until = lambda true, timeout_s: true()
        monkeypatch.setattr(plate, "send", lambda task, waiting: client.Task("sort_parts"))
        yield plate


def test_a_planner_that_says_nothing_of_a_task_is_not_waited_for(silent):
    task, said = client.Task("sort_parts"), []
    with pytest.raises(PlateError, match="the planner has said nothing for 2 s"):
        silent.wait(task, meanwhile=lambda: said.append(task))
    rounds = len(said)
    assert rounds * client.AGAIN_S == pytest.approx(client.SILENT_S)

    def speak():
        task.heard += len(said) == rounds + 5
        said.append(task)

    with pytest.raises(PlateError, match="said nothing"):
        silent.wait(task, meanwhile=speak)
    assert len(said) > 2 * rounds + 5


def test_a_goal_that_is_not_answered_is_sent_again_and_then_given_up(silent):
    said = []
    with pytest.raises(PlateError, match="the planner does not answer the goal"):
        silent.start(SortParts.Goal(), ready_timeout_s=0.01, waiting=said.append)
    assert set(said) == {"the planner does not answer the goal"}
