"""Order in which the planner processes messages if a simulator runs in lockstep. This module does
not use ROS.

The planner may receive an image before messages that it must process first. Such messages are the
cycle that led to this image, the report of this cycle's start, and a goal. The order of arrival is
random. To make runs repeatable, the class `Lockstep` delays an image until these messages have
arrived.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

__all__ = ["Lockstep"]

Image = TypeVar("Image")
Start = TypeVar("Start")

STARTS_KEPT = 64
"""Maximum number of reported cycle starts that are stored until the next image is processed. Older
reports are dropped."""


class Lockstep(Generic[Image, Start]):
    """Stores the newest image, and the reported cycle starts, until the planner can process this
    image.

    In lockstep, an image waits for the report of the cycle start at which the image was taken. If a
    request was published before the image, the image also waits for the message plate_cycle that
    results from this request, and for the first goal. Without lockstep, each image is processed at
    once.

    Parameters
    ----------
    enabled : bool
        Whether the simulator runs in lockstep.

    Attributes
    ----------
    request_ns : int or None
        Stamp of the last request [ns].
    unanswered : bool
        Whether the message plate_cycle for the last request has not arrived yet.
    starts_required : bool
        Whether an image must wait for the report of the cycle start at which it was taken. The
        value becomes False if no start is reported within the timeout. The value becomes True again
        when the start for an image is reported.
    """

    def __init__(self, enabled: bool) -> None:
        self.enabled = enabled
        self.request_ns: int | None = None
        self.unanswered = False
        self.starts_required = True
        self._goal_received = False
        self._request_before_goal_ns: int | None = None
        # image that waits for its cycle start, and its stamp [ns]
        self._image: tuple[Image, int] | None = None
        self._image_time = 0.0  # arrival of this image [s, steady clock]
        self._starts: deque[Start] = deque(maxlen=STARTS_KEPT)
        self._start_ns = -1  # stamp of the last cycle start [ns]

    @property
    def image_waits(self) -> bool:
        """Whether an image waits to be processed."""
        return self._image is not None

    def add_image(self, image: Image, stamp_ns: int, now: float) -> None:
        """Store an image that arrived at the time `now` [s, steady clock]. The image replaces an
        earlier image that still waits."""
        if self._image is None or self._image[1] != stamp_ns:
            self._image_time = now
        self._image = image, stamp_ns

    def add_start(self, start: Start, stamp_ns: int) -> None:
        """Store the report of a cycle start until the next image is processed."""
        self._starts.append(start)
        self._start_ns = stamp_ns

    def next_image(self) -> tuple[Image, list[Start]] | None:
        """Remove and return the waiting image, and the cycle starts that the planner must record
        before the image. Return None if no image waits, or if the image must wait longer."""
        if self._image is None:
            return None
        image, stamp_ns = self._image
        starts: list[Start] = []
        if self.enabled:
            follows_request = self.request_ns is not None and stamp_ns > self.request_ns
            if follows_request and (self.unanswered or not self._goal_received):
                return None
            if self._update_start_missing(stamp_ns):
                return None
            starts = list(self._starts)
            self._starts.clear()
        self._image = None
        return image, starts

    def _update_start_missing(self, stamp_ns: int) -> bool:
        """Whether an image must still wait for the report of the cycle start at which it was
        taken."""
        reported = self._start_ns == stamp_ns
        self.starts_required = self.starts_required or reported
        return self.starts_required and not reported

    def request_sent(self, stamp_ns: int) -> None:
        """Record that a request with the stamp `stamp_ns` [ns] was published."""
        self.request_ns, self.unanswered = stamp_ns, True

    def cycle_received(self, stamp_ns: int) -> bool:
        """Record that a cycle has arrived. Return whether it results from the last request."""
        answers = stamp_ns == self.request_ns
        if answers:
            self.unanswered = False
        return answers

    def goal_accepted(self) -> None:
        """Record that a goal was accepted and its task begins."""
        self._goal_received, self._request_before_goal_ns = True, self.request_ns

    def precedes_goal(self, stamp_ns: int) -> bool:
        """Whether the stamp `stamp_ns` [ns] is the stamp of the last request that was published
        before the last goal. For an image with this stamp, the driver accepts only a cycle at
        rest."""
        return stamp_ns == self._request_before_goal_ns

    def stop_waiting(self, now: float, timeout_s: float, answer_overdue: bool) -> None:
        """Stop waiting for messages that have not arrived in time.

        Parameters
        ----------
        now : float
            Time of the steady clock [s].
        timeout_s : float
            If the image has waited longer than this time [s], it no longer waits for the report of
            a cycle start.
        answer_overdue : bool
            Whether to stop waiting for the message plate_cycle that results from the last request.
        """
        if answer_overdue:
            self.unanswered = False
        if now - self._image_time > timeout_s:
            self.starts_required = False
