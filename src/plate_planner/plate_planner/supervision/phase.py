"""The phase of a task: where it is, how it ended, when and why. A pure state machine.

Done, stuck, lost part and aborted are ends: only a new start leads out of them.
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
"""Stamps are sums of periods in nanoseconds: closer than this, two times are the same."""


LOOK = "detections_image shows what the camera sees"
"""Where to look when parts are not seen."""

STILL_S = 3.0
"""A task that came nearer within this time was still getting on [s]."""


class Phase(StrEnum):
    """Where a task is."""

    IDLE = "idle"
    RUNNING = "running"
    DONE = "done"
    STUCK = "stuck"
    LOST = "lost part"
    ABORTED = "aborted"

    @property
    def is_failure(self) -> bool:
        """Whether a task ended without being done."""
        return self in (Phase.STUCK, Phase.LOST, Phase.ABORTED)

    @property
    def is_end(self) -> bool:
        """Whether a task has come to its end, good or bad."""
        return self is Phase.DONE or self.is_failure


class Reason(IntEnum):
    """Why a task ended, as in plate_interfaces/TaskStatus, which says what each one means."""

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
    """Why something cannot go on, and what there is to say of it."""

    reason: Reason
    text: str


@dataclass(frozen=True)
class TaskLimits:
    """When to give up, and when to call it done, all in seconds of the time of the cycles' starts,
    or of the images where they are taken at these.

    Attributes
    ----------
    time_limit_s : float
        Longest run.
    hold_s : float
        Done when the goal has been met for this long.
    start_timeout_s : float
        Longest time from `start` until all parts are seen.
    unseen_timeout_s : float
        A part unseen for longer than this is lost.
    stuck_timeout_s : float
        A task that comes no nearer to its goal for longer than this is stuck.
    nearer_m : float
        What counts as nearer, summed over parts [m].
    """

    time_limit_s: float
    hold_s: float = 0.0
    start_timeout_s: float = 10.0
    unseen_timeout_s: float = 1.0
    stuck_timeout_s: float = 30.0
    nearer_m: float = 0.0


@dataclass(frozen=True)
class TaskState:
    """State of the supervisor. Times are stamps [s], None where the event has not happened.

    Attributes
    ----------
    phase : Phase
    reason : Reason
        Why it ended.
    detail : str
        What there is to say of its end: the result if it is done, else why, and what would help.
    asked : float or None
        First image after `start`.
    began : float or None
        Second image with the same parts, all: time zero of the task.
    ended : float or None
        Image at which it ended.
    missing_since : tuple of (str, float)
        Parts that are unseen, and since when, without a break.
    met_since : float or None
        Since when the goal has been met, as far as parts were seen.
    nearest_m, nearest_at : float
        Least distance to the goal so far, summed over parts [m], and when it was reached [s].
    """

    phase: Phase = Phase.IDLE
    reason: Reason = Reason.NONE
    detail: str = ""
    asked: float | None = None
    began: float | None = None
    ended: float | None = None
    missing_since: tuple[tuple[str, float], ...] = ()
    met_since: float | None = None
    nearest_m: float = math.inf
    nearest_at: float = math.inf

    @property
    def active(self) -> bool:
        """Whether parts are to be moved now."""
        return self.phase is Phase.RUNNING and self.began is not None

    @property
    def text(self) -> str:
        """The phase; of an end with time and reason: `done after 14.1 s: 10 of 10 parts ...`."""
        if not self.phase.is_end:
            return self.phase.value
        time = ""
        if self.began is not None and self.ended is not None:
            time = f" after {self.elapsed(self.ended):.1f} s"
        return f"{self.phase.value}{time}" + (f": {self.detail}" if self.detail else "")

    def held(self, t: float, limits: TaskLimits) -> bool:
        """Whether the goal has been met for long enough: the plate is to rest, and once it does an
        image has to show all parts."""
        met = self.active and self.met_since is not None
        return met and t - (self.met_since or 0.0) >= limits.hold_s - TIME_TOLERANCE_S

    def elapsed(self, t: float) -> float:
        """Time [s] since the task began, until `t` or its end; 0 where a clock was put back."""
        if self.began is None:
            return 0.0
        return max(0.0, (t if self.ended is None else self.ended) - self.began)


def missing_parts(scenario: Scenario, known: tuple[str, ...], parts: Parts) -> tuple[str, ...]:
    """Name the parts of the scenario that are not there, by id where it is `known`."""
    there = Counter(part_class(i) for i in parts.ids)
    names: list[str] = []
    for label, wanted in Counter(scenario.labels).items():
        short = wanted - there[label]
        if short <= 0:
            continue
        gone = [i for i in known if part_class(i) == label and i not in parts.ids]
        names += gone[:short] if len(gone) >= short else [f"{short} of {wanted} {label} parts"]
    return tuple(names)


def started() -> TaskState:
    """Return the state of a task that was just told to start."""
    return TaskState(phase=Phase.RUNNING)


def begin(
    state: TaskState,
    t: float,
    missing: tuple[str, ...],
    again: bool,
    limits: TaskLimits,
    others: str = "",
) -> TaskState:
    """Begin a task that was told to start, as soon as the same parts, all, are seen twice.

    In one image a glare may stand for a part that was not seen.

    Parameters
    ----------
    state : TaskState
    t : float
        Stamp of the image [s].
    missing : tuple of str
        Parts of the scenario that are not seen, as a reader would name them.
    again : bool
        Whether these parts, and no others, are those of the last image with all parts.
    limits : TaskLimits
    others : str
        Says what else is on the plate: a missing part may be among it. Empty if nothing is.
    """
    if state.phase is not Phase.RUNNING or state.began is not None:
        return state
    asked = t if state.asked is None else state.asked
    if again and not missing:
        return replace(state, asked=asked, began=t)
    if t - asked > limits.start_timeout_s + TIME_TOLERANCE_S:
        what = f"{_listed(missing)} not seen" if missing else "no two images with the same parts"
        why = _joined(f"{what} within {limits.start_timeout_s:g} s of start", others, LOOK)
        return _end(state, t, Phase.ABORTED, Reason.PARTS_MISSING, why)
    return replace(state, asked=asked)


STOP = Failure(Reason.STOPPED, "stopped")
"""A person's stop, by the service."""


def stopped(state: TaskState, t: float | None, why: Failure = STOP) -> TaskState:
    """Stop: a running task is aborted at stamp t [s], None if there was no image; else idle."""
    if state.phase is not Phase.RUNNING:
        return TaskState()
    return _end(state, t, Phase.ABORTED, *why)


@dataclass(frozen=True)
class Findings:
    """What one image says of a running task.

    Attributes
    ----------
    missing : tuple of str
        Parts of the scenario that are not seen.
    goal_met : bool
        Whether the goal is met in this image.
    to_go_m : float
        Distance to the goal, summed over parts [m].
    problem : str
        Why the task cannot go on; empty if it can.
    detail : callable
        Says which part is furthest from its goal, what was asked of it, and what would help.
    outcome : str
        What there is to tell if the task is done now.
    loss : callable
        Tells of a missing part, by its name, what became of it.
    all_seen : bool
        Whether the image shows all parts: others may be where they are predicted, or gone.
    at_rest : bool
        Whether it was taken when plate and parts lay still: a moving plate may leave a part behind
        that the image still shows on it.
    unanswered : str
        How many cycles no answer began, if they were many.
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


def judge(state: TaskState, t: float, found: Findings, limits: TaskLimits) -> TaskState:
    """Judge a running task after one image, stamp t [s]."""
    if not state.active:
        return state
    before = dict(state.missing_since)
    missing_since = tuple((name, before.get(name, t)) for name in found.missing)
    met_since = state.met_since
    if not (found.missing and found.goal_met):  # else what is not seen may have met it, or not
        met_since = _since(met_since, found.goal_met, t)
    state = replace(state, missing_since=missing_since, met_since=met_since)
    # Unseen parts have no distance: the sum without them would look like progress.
    if not found.missing and found.to_go_m < state.nearest_m - limits.nearer_m:
        state = replace(state, nearest_m=found.to_go_m, nearest_at=t)
    timeout = limits.unseen_timeout_s + TIME_TOLERANCE_S
    lost = tuple(name for name, since in missing_since if t - since > timeout)
    if lost:
        losses = [found.loss(name) for name in lost]
        text = _joined(found.unanswered, *(loss.text for loss in losses))
        return _end(state, t, Phase.LOST, losses[0].reason, text)
    if found.problem:
        text = _joined(found.unanswered, found.problem)
        return _end(state, t, Phase.STUCK, Reason.TOO_FAR_OFF, text)
    held = state.held(t, limits)
    if held and found.all_seen and found.at_rest and not found.missing:
        text = _joined(found.outcome, found.unanswered)
        return _end(state, t, Phase.DONE, Reason.NONE, text)
    reason, text = Reason.NONE, ""
    # What was held in time is still to be seen at rest.
    longest = limits.time_limit_s + (limits.unseen_timeout_s if held else 0.0)
    if state.elapsed(t) > longest + TIME_TOLERANCE_S:
        reason, text = Reason.TIME_LIMIT, f"time limit of {limits.time_limit_s:g} s"
        if state.nearest_at > max(t - STILL_S, t - state.elapsed(t)):
            text += " (still getting nearer: a longer time_limit_s would do)"
    elif met_since is None and t - state.nearest_at > limits.stuck_timeout_s + TIME_TOLERANCE_S:
        reason = Reason.NO_PROGRESS
        text = f"no nearer to the goal for {limits.stuck_timeout_s:g} s"
    if reason is Reason.NONE:
        return state
    return _end(state, t, Phase.STUCK, reason, _joined(text, found.unanswered, found.detail()))


def _end(state: TaskState, t: float | None, phase: Phase, reason: Reason, detail: str) -> TaskState:
    return replace(state, phase=phase, reason=reason, detail=detail, ended=t)


def _since(since: float | None, holds: bool, t: float) -> float | None:
    if not holds:
        return None
    return t if since is None else since


def _joined(*texts: str) -> str:
    return "; ".join(filter(None, texts))


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names)
