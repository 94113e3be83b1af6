"""The supervisor: idle, running, done or failed, and why. A pure state machine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

TIME_TOLERANCE_S = 1e-6
"""Stamps are sums of periods in nanoseconds: closer than this, two times are the same."""


class Phase(Enum):
    """Where a task is."""

    IDLE = "idle"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class TaskLimits:
    """When to give up, and when to call it done, all in seconds of the images' time.

    Attributes
    ----------
    time_limit_s : float
        Longest run.
    hold_s : float
        Done when the goal has been met for this long.
    wait_s : float
        Longest time from `start` until all parts are seen.
    patience_s : float
        A part unseen for longer than this is lost.
    """

    time_limit_s: float
    hold_s: float = 0.0
    wait_s: float = 10.0
    patience_s: float = 1.0


@dataclass(frozen=True)
class TaskState:
    """State of the supervisor. Times are stamps [s], None where the event has not happened.

    Attributes
    ----------
    phase : Phase
    reason : str
        Why it failed.
    asked : float or None
        First image after `start`.
    began : float or None
        First image with all parts: time zero of the task.
    ended : float or None
        Image at which it was done or failed.
    missing_since, met_since : float or None
        Since when a part has been unseen, the goal has been met, without a break.
    """

    phase: Phase = Phase.IDLE
    reason: str = ""
    asked: float | None = None
    began: float | None = None
    ended: float | None = None
    missing_since: float | None = None
    met_since: float | None = None

    @property
    def active(self) -> bool:
        """Whether parts are to be moved now."""
        return self.phase is Phase.RUNNING and self.began is not None

    @property
    def text(self) -> str:
        """The phase, with the reason of a failure: `failed: time limit ...`."""
        return f"failed: {self.reason}" if self.phase is Phase.FAILED else self.phase.value

    def elapsed(self, t: float) -> float:
        """Time [s] since the task began, until `t` or its end."""
        if self.began is None:
            return 0.0
        return (t if self.ended is None else self.ended) - self.began


def started() -> TaskState:
    """Return the state of a task that was just told to start."""
    return TaskState(phase=Phase.RUNNING)


def begin(state: TaskState, t: float, missing: tuple[str, ...], limits: TaskLimits) -> TaskState:
    """Begin a task that was told to start, as soon as no part is missing.

    Parameters
    ----------
    state : TaskState
    t : float
        Stamp of the image [s].
    missing : tuple of str
        Parts of the scenario that are not seen, as a reader would name them.
    limits : TaskLimits
    """
    if state.phase is not Phase.RUNNING or state.began is not None:
        return state
    asked = t if state.asked is None else state.asked
    if not missing:
        return replace(state, asked=asked, began=t)
    if t - asked > limits.wait_s + TIME_TOLERANCE_S:
        return _fail(state, t, f"{_listed(missing)} not seen within {limits.wait_s:g} s of start")
    return replace(state, asked=asked)


def judge(
    state: TaskState,
    t: float,
    missing: tuple[str, ...],
    goal_met: bool,
    problem: str,
    limits: TaskLimits,
) -> TaskState:
    """Judge a running task after one image.

    Parameters
    ----------
    state : TaskState
    t : float
        Stamp of the image [s].
    missing : tuple of str
        Parts of the scenario that are not seen.
    goal_met : bool
        Whether the goal is met in this image.
    problem : str
        Why the task cannot go on; empty if it can.
    limits : TaskLimits
    """
    if not state.active:
        return state
    missing_since = _since(state.missing_since, bool(missing), t)
    met_since = _since(state.met_since, goal_met and not missing, t)
    state = replace(state, missing_since=missing_since, met_since=met_since)
    if missing_since is not None and t - missing_since > limits.patience_s + TIME_TOLERANCE_S:
        return _fail(state, t, f"lost {_listed(missing)}")
    if problem:
        return _fail(state, t, problem)
    if met_since is not None and t - met_since >= limits.hold_s - TIME_TOLERANCE_S:
        return replace(state, phase=Phase.DONE, ended=t)
    if state.elapsed(t) > limits.time_limit_s + TIME_TOLERANCE_S:
        return _fail(state, t, f"time limit of {limits.time_limit_s:g} s")
    return state


def _fail(state: TaskState, t: float, reason: str) -> TaskState:
    return replace(state, phase=Phase.FAILED, reason=reason, ended=t)


def _since(since: float | None, holds: bool, t: float) -> float | None:
    if not holds:
        return None
    return t if since is None else since


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names)
