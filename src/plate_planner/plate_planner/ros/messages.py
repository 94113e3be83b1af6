"""Conversion of the planner's state to ROS messages."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from plate_core.ros import FRAME
from plate_interfaces.msg import FeedStatus, Part, PartCount, TaskProgress, TaskStatus

from ..supervision import Phase, Progress
from ..task_run import Run
from ..tasks import FeedReport

STATES = {
    Phase.IDLE: TaskStatus.IDLE,
    Phase.RUNNING: TaskStatus.RUNNING,
    Phase.DONE: TaskStatus.DONE,
    Phase.STUCK: TaskStatus.STUCK,
    Phase.LOST: TaskStatus.LOST,
    Phase.ABORTED: TaskStatus.ABORTED,
}
"""Value of `TaskStatus.state` for each phase of a task."""


def progress_to_msg(progress: Progress) -> TaskProgress:
    """Convert the progress of a task to a message."""
    return TaskProgress(
        time_s=float(progress.time_s),
        parts_total=progress.parts_total,
        parts_seen=progress.parts_seen,
        parts_sorted=int(progress.parts_sorted),
        to_go_m=float(progress.to_go_m),
        rms_error_m=float(progress.rms_error_m),
        max_error_m=float(progress.max_error_m),
        turn_error=float(progress.turn_error),
        pace=float(progress.pace),
    )


def run_to_msg(run: Run, answered: Time) -> TaskStatus:
    """Convert the state of a task to a TaskStatus message with the stamp `answered`."""
    status = TaskStatus(
        header=Header(stamp=answered), task=run.name, state=STATES[run.task.phase],
        reason=int(run.task.reason), text=run.task.text,
    )  # fmt: skip
    if run.progress is None:
        status.progress.parts_total = run.planner.scenario.count
    else:
        status.progress = progress_to_msg(run.progress)
        if run.progress.phase is run.task.phase:
            status.text = run.progress.text
    return status


def feed_to_msg(
    report: FeedReport, moves: bool, shown: Mapping[str, Part], stamp: Time
) -> FeedStatus:
    """Convert the report of a feed task to a FeedStatus message.

    Parameters
    ----------
    report : FeedReport
    moves : bool
        Whether the planner requests a motion of the plate after the last image.
    shown : mapping of str to Part
        Parts of the last image, by id. The message omits ready parts that this image does not show.
    stamp : Time
        Stamp of the last image.
    """
    return FeedStatus(
        header=Header(stamp=stamp, frame_id=FRAME),
        mode=int(report.mode),
        at_rest=report.at_rest and not moves,
        ready=[shown[name] for name in report.ready.ids if name in shown],
        seen=[PartCount(type=name, count=count) for name, count in report.seen.items()],
        discharged=report.discharged,
        lost=report.lost,
    )
