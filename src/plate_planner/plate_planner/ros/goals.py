"""Action servers of the planner.

Each action has one server. The server passes each goal to the node. While the task of a goal runs,
the goal has the ROS state *accepted*. The goal is executed only when the task ends.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.node import Node

from plate_core.ros import ACTIONS, RESULT_S, action_name
from plate_interfaces.msg import TaskProgress, TaskStatus


class GoalServers:
    """Accepts goals of all actions, and sends the result of each goal to its client.

    Parameters
    ----------
    node : Node
    on_goal : callable
        Function that is called with the handle of each new goal. The owner of this object must
        later call `finish` for this goal.
    on_cancel : callable
        Function that is called with the handle of a goal that a client wants to cancel. The
        function returns whether the cancellation is accepted.
    """

    def __init__(
        self,
        node: Node,
        on_goal: Callable[[Any], None],
        on_cancel: Callable[[Any], CancelResponse],
    ) -> None:
        # results that are not delivered yet; the keys are the ids of the goals
        self._results: dict[bytes, TaskStatus] = {}
        self._servers = [
            ActionServer(
                node, action, name, self._make_result, handle_accepted_callback=on_goal,
                cancel_callback=on_cancel, result_timeout=RESULT_S,
            )
            for name, action in ACTIONS.items()
        ]  # fmt: skip

    def finish(self, goal: Any, status: TaskStatus) -> None:
        """Complete a goal: send the status `status` as its result to the client.

        The goal is executed only here. If a goal were executed when it is accepted, rclpy would
        continuously poll a coroutine that waits for the end of the task.
        """
        self._results[bytes(goal.goal_id.uuid)] = status
        goal.execute()

    def feed_back(self, goal: Any, progress: TaskProgress) -> None:
        """Send the progress of a task as action feedback to the client of the goal."""
        feedback = ACTIONS[action_name(goal.request)].Feedback()
        feedback.progress = progress
        goal.publish_feedback(feedback)

    def destroy(self) -> None:
        """Destroy the servers."""
        for server in self._servers:
            server.destroy()

    def _make_result(self, goal: Any) -> Any:
        status = self._results.pop(bytes(goal.goal_id.uuid))
        if status.state == TaskStatus.DONE:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        result = ACTIONS[action_name(goal.request)].Result()
        result.status = status
        return result
