"""Action client that starts and cancels the planner's feed task."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node

from plate_core.ros import new_goal_id
from plate_interfaces.action import FeedParts
from plate_interfaces.msg import TaskStatus

END_S = 5.0
"""Maximum time for the planner to end a canceled task [s]."""

ANSWER_S = 1.0
"""If the planner does not reply to a goal within this time [s], the goal is sent again. The planner
may have been killed or may have stalled, or the reply was lost. The new goal has the same id, so
the planner executes it only once."""


class FeedGoal:
    """Action goal of `feed_parts`. The method `request` starts the goal and cancels it.

    Parameters
    ----------
    node : Node
    goal : FeedParts.Goal
    ended : callable
        Function that is called with the planner's status when the task has ended by itself or was
        refused.

    Attributes
    ----------
    runs : bool
        Whether the planner has accepted the goal.
    """

    def __init__(
        self, node: Node, goal: FeedParts.Goal, ended: Callable[[TaskStatus], None]
    ) -> None:
        self._goal, self._ended = goal, ended
        self._client = ActionClient(node, FeedParts, "feed_parts")
        self._handle: Any = None
        self._number = 0  # number of the newest goal; replies to earlier goals are ignored
        self._id, self._tries = new_goal_id(), 0
        self._sent = self.runs = self._seen = False
        self._answer_by = 0.0
        self._ending, self._until = 0, 0.0  # number of the canceled goal; deadline for its end

    def request(self, run: bool) -> None:
        """Start the task if `run` is True, otherwise cancel it. The caller must call this method
        repeatedly, because lost messages are sent again only in this method."""
        if self._sent and not run:
            self._cancel_goal()
        now = time.monotonic()
        waits = (self._ending and now < self._until) or (
            self._sent and (self.runs or now < self._answer_by)
        )
        if run and not waits and self._client.server_is_ready():
            if not self._sent:
                self._number, self._tries = self._number + 1, 0
                self._id = new_goal_id()
            self._sent, self._ending, self._tries = True, 0, self._tries + 1
            number, is_repeated, self._answer_by = self._number, self._tries > 1, now + ANSWER_S
            future = self._client.send_goal_async(self._goal, goal_uuid=self._id)
            future.add_done_callback(lambda done: self._on_answer(number, is_repeated, done))

    def on_task_status(self, status: TaskStatus) -> None:
        """Process a `task_status` message of the planner. This method detects that the planner has
        restarted and therefore no longer executes the task."""
        running = status.state == TaskStatus.RUNNING and status.task == "feed"
        if self.runs and self._seen and not running:
            reason = status.reason
            if status.state == TaskStatus.RUNNING:  # another task has replaced this one
                reason = TaskStatus.PREEMPTED
            text = f"the planner's task has ended: {status.text}"
            self._end_goal(TaskStatus(reason=reason, text=text))
        elif self.runs:
            self._seen = running

    def close(self) -> None:
        """Destroy the client."""
        self._client.destroy()

    def _cancel_goal(self) -> None:
        if self._handle is not None:
            self._handle.cancel_goal_async()
        self._ending, self._until = self._number, time.monotonic() + END_S
        self._sent = self.runs = self._seen = False
        self._handle = None

    def _end_goal(self, status: TaskStatus) -> None:
        self._sent = self.runs = self._seen = False
        self._handle = None
        self._ended(status)

    def _on_answer(self, number: int, is_repeated: bool, future: Any) -> None:
        handle = future.result()
        is_newest = self._sent and number == self._number
        if is_newest and self.runs:
            return
        # rclpy refuses a goal that is sent again with the same id
        if handle is not None and (handle.accepted or is_repeated):
            handle.get_result_async().add_done_callback(lambda done: self._on_end(number, done))
            if is_newest:
                self._handle, self.runs = handle, True
            else:
                handle.cancel_goal_async()
        elif is_newest:
            self._end_goal(TaskStatus(text="the planner refused the goal"))

    def _on_end(self, number: int, future: Any) -> None:
        if self._ending == number:
            self._ending = 0
        if self._sent and number == self._number:
            self._end_goal(future.result().result.status)
