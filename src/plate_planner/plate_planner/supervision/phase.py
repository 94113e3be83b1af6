"""State machine of a task. The state contains the phase of the task, and the time and the reason of
the task's end.

The phases done, stuck, lost part and aborted are final. Only a new start ends a final phase. All
functions are pure. The functions receive a state as an argument, and return the new state.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from typing import NamedTuple

from plate_core import Parts, part_class
from plate_core.tasks import Scenario

TIME_TOLERANCE_S = 1e-6
"""Tolerance of the comparison of times [s]. The tolerance is necessary because stamps are rounded
to nanoseconds."""


CHECK_IMAGE = "look at the topic detections_image"
"""Advice for the user if parts are not detected."""

STILL_S = 3.0
"""If the distance to the goal has decreased within the last interval of this length, the task is
still making progress [s]."""


class Phase(StrEnum):
    """Phase of a task."""

    IDLE = "idle"
    RUNNING = "running"
    DONE = "done"
    STUCK = "stuck"
    LOST = "lost part"
    ABORTED = "aborted"

    @property
    def is_failure(self) -> bool:
        """Whether this phase is the end of a task without success."""
        return self in (Phase.STUCK, Phase.LOST, Phase.ABORTED)

    @property
    def is_end(self) -> bool:
        """Whether this phase is the end of a task, with or without success."""
        return self is Phase.DONE or self.is_failure


class Reason(IntEnum):
    """Reason why a task ended. plate_interfaces/TaskStatus describes each value."""

    NONE = 0
    TIME_LIMIT = 1
    NO_PROGRESS = 2
    TOO_FAR_OFF = 3
    PART_LEFT = 4
    PART_UNSEEN = 5
    PARTS_MISSING = 6
    CANCELED = 7
    PREEMPTED = 8
    STOPPED = 9
    NO_PARTS = 10
    NO_CYCLE = 11
    NO_DRIVER = 12
    DRIVER_STOPPED = 13
    CUT_OFF = 14
    STOOD_STILL = 15
    INVALID_GOAL = 16
    NOT_READY = 17
    BUSY = 18
    RIVAL = 19


class Failure(NamedTuple):
    """Reason of a failure, and its description."""

    reason: Reason
    text: str


@dataclass(frozen=True)
class TaskLimits:
    """Time limits of a task. Times are measured as differences of stamps [s]. If images are taken
    at cycle starts, these are the stamps of images, otherwise the stamps of cycle starts.

    Attributes
    ----------
    time_limit_s : float
        Maximum duration of the task.
    hold_s : float
        Duration for which the goal must be met until the task is done.
    start_timeout_s : float
        Maximum time from the start of the task until all parts are detected.
    unseen_timeout_s : float
        Time without a detection after which a part counts as lost.
    stuck_timeout_s : float
        Time without progress towards the goal after which the task counts as stuck.
    nearer_m : float
        Minimum decrease of the distance to the goal that counts as progress [m]. The distance to
        the goal is summed over the parts.
    """

    time_limit_s: float
    hold_s: float = 0.0
    start_timeout_s: float = 10.0
    unseen_timeout_s: float = 1.0
    stuck_timeout_s: float = 30.0
    nearer_m: float = 0.0


@dataclass(frozen=True)
class TaskState:
    """State of a task's supervision. Times are stamps [s]. A time is None if its event has not
    happened.

    Attributes
    ----------
    phase : Phase
    reason : Reason
        Reason why the task ended.
    detail : str
        Text about the end of the task. The text contains the result if the task is done, otherwise
        the cause and a remedy.
    waiting_since : float or None
        Stamp of the first image after the call of `start`.
    began : float or None
        Start of the task, as the stamp of the second image that shows the same complete set of
        parts.
    ended : float or None
        Stamp of the image at which the task ended.
    missing_since : tuple of (str, float)
        Names of the parts that are not detected. For each part, the time since which it has not
        been detected.
    met_since : float or None
        Time since which the detected parts have met the goal without interruption.
    nearest_m, nearest_at : float
        Minimum distance to the goal so far [m], and the time at which it was reached [s]. The
        distance is summed over the parts.
    """

    phase: Phase = Phase.IDLE
    reason: Reason = Reason.NONE
    detail: str = ""
    waiting_since: float | None = None
    began: float | None = None
    ended: float | None = None
    missing_since: tuple[tuple[str, float], ...] = ()
    met_since: float | None = None
    nearest_m: float = math.inf
    nearest_at: float = math.inf

    @property
    def active(self) -> bool:
        """Whether the task runs and has begun to move parts."""
        return self.phase is Phase.RUNNING and self.began is not None

    @property
    def text(self) -> str:
        """Text about the phase. When the task has ended, the text contains the duration and the
        reason, for example `done after 14.1 s: 10 of 10 parts ...`."""
        if not self.phase.is_end:
            return self.phase.value
        time = ""
        if self.began is not None and self.ended is not None:
            time = f" after {self.elapsed(self.ended):.1f} s"
        return f"{self.phase.value}{time}" + (f": {self.detail}" if self.detail else "")

    def held(self, t: float, limits: TaskLimits) -> bool:
        """Whether the goal has been met for the time `hold_s` in `limits`.

        The task is then done after the plate has come to rest and an image shows all parts.
        """
        met = self.active and self.met_since is not None
        return met and t - (self.met_since or 0.0) >= limits.hold_s - TIME_TOLERANCE_S

    def elapsed(self, t: float) -> float:
        """Return the time from the start of the task to the time t, or to its end if the task has
        ended [s]. The result is 0 if a clock was set back."""
        if self.began is None:
            return 0.0
        return max(0.0, (t if self.ended is None else self.ended) - self.began)


def missing_parts(scenario: Scenario, known: tuple[str, ...], parts: Parts) -> tuple[str, ...]:
    """Return names of the scenario's parts that are missing. If the ids of missing parts are in
    `known`, the names are these ids. Otherwise, the name contains the class and the number of
    missing parts."""
    present = Counter(part_class(i) for i in parts.ids)
    names: list[str] = []
    for label, count in Counter(scenario.labels).items():
        short = count - present[label]
        if short <= 0:
            continue
        absent = [i for i in known if part_class(i) == label and i not in parts.ids]
        names += absent[:short] if len(absent) >= short else [f"{short} of {count} {label} parts"]
    return tuple(names)


def started() -> TaskState:
    """Return the state of a task immediately after the start request."""
    return TaskState(phase=Phase.RUNNING)


def begin(
    state: TaskState,
    t: float,
    missing: tuple[str, ...],
    again: bool,
    limits: TaskLimits,
    others: str = "",
) -> TaskState:
    """Return the state after an image, before the task has begun. The task begins when two images
    show the same complete set of parts.

    A single image is not sufficient, because the detector may mistake a reflection for a part.

    Parameters
    ----------
    state : TaskState
    t : float
        Stamp of the image [s].
    missing : tuple of str
        Names of the parts of the scenario that are not detected.
    again : bool
        Whether the image shows the same parts as the last image that showed all parts.
    limits : TaskLimits
    others : str
        Text about other objects on the plate, which may be missing parts. Empty if there are no
        such objects.
    """
    if state.phase is not Phase.RUNNING or state.began is not None:
        return state
    waiting_since = t if state.waiting_since is None else state.waiting_since
    if again and not missing:
        return replace(state, waiting_since=waiting_since, began=t)
    if t - waiting_since > limits.start_timeout_s + TIME_TOLERANCE_S:
        problem = "no two images with equal parts within"
        if missing:
            problem = f"{', '.join(missing)} not detected within"
        why = _join_texts(
            f"{problem} {limits.start_timeout_s:g} s of the start", others, CHECK_IMAGE
        )
        return _end_task(state, t, Phase.ABORTED, Reason.PARTS_MISSING, why)
    return replace(state, waiting_since=waiting_since)


STOP = Failure(Reason.STOPPED, "stopped")
"""Failure of a task that the service `stop` has ended."""


def stopped(state: TaskState, t: float | None, why: Failure = STOP) -> TaskState:
    """Return the state of a task after it was stopped.

    If the task runs, it is aborted at the stamp t [s]. t is None if no image has arrived yet. If
    the task does not run, its phase becomes idle.
    """
    if state.phase is not Phase.RUNNING:
        return TaskState()
    return _end_task(state, t, Phase.ABORTED, *why)


@dataclass(frozen=True)
class Findings:
    """Evaluation of one image in a running task.

    Attributes
    ----------
    missing : tuple of str
        Parts of the scenario that are not detected.
    goal_met : bool
        Whether the goal is met in this image.
    to_go_m : float
        Distance to the goal [m], summed over the parts.
    problem : str
        Reason why the task cannot continue. Empty if it can continue.
    detail : callable
        Function that returns a text about the part that is farthest from its goal. The text
        contains the requested drift of this part and a remedy.
    outcome : str
        Text about the result, which is used if the task is done now.
    loss : callable
        Function that returns the failure for a missing part. The argument of the function is the
        name of the part.
    all_seen : bool
        Whether the image shows all parts. For parts that it does not show, predicted positions are
        used.
    at_rest : bool
        Whether the plate and the parts were at rest when the image was taken. If the plate moves, a
        part may leave the plate after the image.
    unanswered : str
        Text about the number of cycles without a new result of the solver. Empty if there were few
        such cycles.
    """

    missing: tuple[str, ...]
    goal_met: bool
    to_go_m: float
    problem: str = ""
    detail: Callable[[], str] = lambda: ""
    outcome: str = ""
    loss: Callable[[str], Failure] = lambda name: Failure(Reason.PART_UNSEEN, name)
    all_seen: bool = True
    at_rest: bool = True
    unanswered: str = ""


def evaluate(state: TaskState, t: float, findings: Findings, limits: TaskLimits) -> TaskState:
    """Return the state of a running task after an image with the stamp t [s]."""
    if not state.active:
        return state
    before = dict(state.missing_since)
    missing_since = tuple((name, before.get(name, t)) for name in findings.missing)
    met_since = state.met_since
    if not (
        findings.missing and findings.goal_met
    ):  # if parts are missing, it is unknown whether the goal is met, so keep the last value
        met_since = _hold_start(met_since, findings.goal_met, t)
    state = replace(state, missing_since=missing_since, met_since=met_since)
    # The distance to the goal does not include missing parts. If parts are missing, a smaller
    # distance is not progress.
    if not findings.missing and findings.to_go_m < state.nearest_m - limits.nearer_m:
        state = replace(state, nearest_m=findings.to_go_m, nearest_at=t)
    timeout = limits.unseen_timeout_s + TIME_TOLERANCE_S
    lost = tuple(name for name, since in missing_since if t - since > timeout)
    if lost:
        losses = [findings.loss(name) for name in lost]
        text = _join_texts(findings.unanswered, *(loss.text for loss in losses))
        return _end_task(state, t, Phase.LOST, losses[0].reason, text)
    if findings.problem:
        text = _join_texts(findings.unanswered, findings.problem)
        return _end_task(state, t, Phase.STUCK, Reason.TOO_FAR_OFF, text)
    held = state.held(t, limits)
    if held and findings.all_seen and findings.at_rest and not findings.missing:
        text = _join_texts(findings.outcome, findings.unanswered)
        return _end_task(state, t, Phase.DONE, Reason.NONE, text)
    reason, text = Reason.NONE, ""
    # If the goal was met within the time limit, allow additional time for an image of the parts at
    # rest.
    limit_s = limits.time_limit_s + (limits.unseen_timeout_s if held else 0.0)
    if state.elapsed(t) > limit_s + TIME_TOLERANCE_S:
        reason, text = Reason.TIME_LIMIT, f"time limit of {limits.time_limit_s:g} s"
        if state.nearest_at > max(t - STILL_S, t - state.elapsed(t)):
            text += " (the parts still get nearer to their goals: increase time_limit_s)"
    elif met_since is None and t - state.nearest_at > limits.stuck_timeout_s + TIME_TOLERANCE_S:
        reason = Reason.NO_PROGRESS
        text = f"no progress for {limits.stuck_timeout_s:g} s"
    if reason is Reason.NONE:
        return state
    return _end_task(
        state, t, Phase.STUCK, reason, _join_texts(text, findings.unanswered, findings.detail())
    )


def _end_task(
    state: TaskState, t: float | None, phase: Phase, reason: Reason, detail: str
) -> TaskState:
    return replace(state, phase=phase, reason=reason, detail=detail, ended=t)


def _hold_start(since: float | None, holds: bool, t: float) -> float | None:
    if not holds:
        return None
    return t if since is None else since


def _join_texts(*texts: str) -> str:
    return "; ".join(filter(None, texts))
