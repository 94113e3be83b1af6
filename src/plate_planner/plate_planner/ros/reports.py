"""Publishers of the planner's topics task_status, part_targets and feed_status.

`TaskReports` stores the last published values, so that unchanged targets are not published again
and an unchanged text is not logged again.
"""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from std_msgs.msg import Header

from plate_core.ros import DATA, LATCHED, SafeLifecycleNode, targets_to_msg
from plate_core.tasks import FeedTask, PartTarget
from plate_interfaces.msg import FeedStatus, Part, Parts, Targets, TaskStatus

from ..supervision import Reason
from ..task_run import Run, TaskRunner
from .messages import feed_to_msg, run_to_msg

ACKNOWLEDGED_S = 0.5
"""Maximum time to wait for the acknowledgement of the last status [s]."""


class TaskReports:
    """Publishes the planner's topics task_status, part_targets and feed_status.

    Parameters
    ----------
    node : SafeLifecycleNode
    """

    def __init__(self, node: SafeLifecycleNode[Any]) -> None:
        self._statuses = node.managed_publisher(TaskStatus, "task_status", LATCHED)
        self._targets = node.managed_publisher(Targets, "part_targets", LATCHED)
        self._feed = node.managed_publisher(FeedStatus, "feed_status", DATA)
        self.begin()

    def begin(self) -> None:
        """Delete the stored values: the published targets, the parts of the last image, and the
        logged text."""
        self._published_targets: tuple[PartTarget, ...] | None = None
        # parts of the last image; the keys are the ids of the parts
        self._shown: dict[str, Part] = {}
        self._logged_text = ""

    def record_image(self, msg: Parts) -> None:
        """Store the parts of the last image, because feed_status needs them."""
        self._shown = {part.id: part for part in msg.parts}

    def await_delivery(self) -> None:
        """Wait until all subscribers have received the last status, for at most `ACKNOWLEDGED_S`.
        If the process ended earlier, a slow subscriber could wait forever for the end of a
        task."""
        self._statuses.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_S))

    def publish_status(
        self, run: Run | None, answered: Time, reason: Reason = Reason.NONE
    ) -> TaskStatus:
        """Publish the status of a task, and return it.

        Parameters
        ----------
        run : Run or None
            Task whose status is published. None if there was no task.
        answered : Time
            Stamp of the last image or cycle start for which a request was published.
        reason : Reason
            Reason in the status if `run` is None.
        """
        if run is None:
            status = TaskStatus(header=Header(stamp=answered), text="idle", reason=int(reason))
        else:
            status = run_to_msg(run, answered)
        self._statuses.publish(status)
        return status

    def publish_targets(self, tasks: TaskRunner, stamp: Time) -> None:
        """Publish the targets of a running `move` task if they have changed."""
        if tasks.targets != self._published_targets:
            self._published_targets = tasks.targets
            self._targets.publish(targets_to_msg(tasks.targets, stamp))

    def publish_feed(self, run: Run, moves: bool, stamp: Time) -> None:
        """Publish the state of a `feed` task. Do nothing for other tasks. `moves` states whether
        the task requests a motion of the plate after the image with the stamp `stamp`."""
        memory = run.state.memory
        if isinstance(run.planner.scenario.task, FeedTask) and memory is not None:
            self._feed.publish(feed_to_msg(memory.report, moves, self._shown, stamp))

    def is_new(self, text: str) -> bool:
        """Return whether `text` differs from the text of the last call, so that it must be
        logged."""
        new, self._logged_text = text != self._logged_text, text
        return new

    def forget_text(self) -> None:
        """Delete the stored text, so that `is_new` returns True even if it is called with the same
        text."""
        self._logged_text = ""
