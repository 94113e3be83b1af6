"""A task, as the planner sees it: what it gets at each image, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from plate_core import Parts, Targets
from plate_core.tasks import Scenario

from .drift import DriftInterval

SIGHT_M, SIGHT_RAD = 3e-4, 0.01
"""A task is judged by what the camera sees: the truth may differ by so much [m, rad]."""

NEARER_M = 0.002
"""What counts as nearer to the goal, summed over parts [m]: more than the camera's noise."""

BIAS_GAIN = 0.3
"""Fraction of what a cycle does otherwise than predicted that is expected of the next one [-]."""

BIAS_M = 5e-3
"""A part further from its prediction was pushed: as far as this it counts as drift bias [m]."""


@dataclass(frozen=True)
class Situation:
    """What there is to know at one image.

    Attributes
    ----------
    parts : Parts
        M parts on the plate, where they are at the stamp.
    stamp : float
        Of the image [s].
    start : float
        Stamp at which the answer begins to act [s].
    rests : float
        Stamp from which the plate rests if nothing is asked from `start` on [s].
    period : float
        Length of a cycle [s].
    motion_known : bool
        Whether the plate's cycles are known; else predictions are what parts were asked to do.
    latency_known : bool
        Whether it is known how old images are, but for a few milliseconds.
    predicted : (M, 2)
        Where the parts will be at `start` [m, plate_home].
    shortfall : (M,)
        Drift that the running cycle, by the motion model, lacks of what was asked of it [m/s].
    active : bool
        Whether it goes on: it has begun and not ended.
    seen : Parts
        Parts on the plate as the last image shows them.
    taken : float
        When that was taken [s].
    kept : bool
        Whether that image did not count: see `TaskRules.keeps_last`.
    late : int
        Maximum delay of the last answers, in cycles.
    resting_since : float
        Since when the plate has been at rest, as far as is known [s]; infinite if it has not.
    """

    parts: Parts
    stamp: float
    start: float
    rests: float
    period: float
    motion_known: bool
    latency_known: bool
    predicted: np.ndarray
    shortfall: np.ndarray
    active: bool
    seen: Parts
    taken: float
    kept: bool = False
    late: int = 0
    resting_since: float = -np.inf


@dataclass(frozen=True)
class Assessment:
    """What one image means for the task.

    Attributes
    ----------
    request : DriftInterval or Targets or None
        Request for the M parts: their drift in the next cycle, or their targets. None: the plate
        rests.
    goal_met : bool
        Whether the goal is met in this image.
    count : int
        Parts that are where they belong.
    total : int
        Parts that the task counts, where they may be more than the scenario's.
    distance : (M,)
        How far each part is from where it should be [m].
    to_go_m : float
        Distance to the goal, summed over parts [m].
    problem : str
        Why the task cannot go on; empty if it can.
    missing : tuple of str, or None
        Parts that the task misses; None: those of the scenario that are not seen.
    rms_error_m, max_error_m : float
        Distances from where parts should be, as the task counts them [m].
    turn_error : float
        The greatest angle that is missing [rad].
    speed_scaling, pace : float
        Speed of references over that of their paths, now and on average [-].
    outcome : str
        What there is to tell if the task is done now.
    doing : str
        What there is to tell while it runs.
    """

    request: DriftInterval | Targets | None = None
    goal_met: bool = False
    count: int = 0
    total: int = 0
    distance: np.ndarray = field(default_factory=lambda: np.zeros(0))
    to_go_m: float = 0.0
    problem: str = ""
    missing: tuple[str, ...] | None = None
    rms_error_m: float = 0.0
    max_error_m: float = 0.0
    turn_error: float = 0.0
    speed_scaling: float = 1.0
    pace: float = 1.0
    outcome: str = ""
    doing: str = ""


class TaskRules(Protocol):
    """The rules of one task on one rig. Pure: what it remembers is handed to it and back.

    Only `hold_s` and `assess` have to be written; the rest suits most tasks.
    """

    @property
    def hold_s(self) -> float:
        """The task is done when its goal has been met for this long [s]."""
        ...

    def assess(self, memory: Any, now: Situation) -> tuple[Any, Assessment]:
        """Judge one image, and say what is wanted; also when the task is not active.

        Parameters
        ----------
        memory
            What the last call returned; None at the first call after start.
        now : Situation

        Returns
        -------
        memory
            For the next call.
        assessment : Assessment
        """
        ...

    @property
    def endless(self) -> bool:
        """Whether it goes on until it is canceled: it is never done, and never stuck."""
        return False

    @property
    def open_ended(self) -> bool:
        """Whether parts may come and go: it begins with any, and misses none."""
        return False

    def keeps_last(self, memory: Any) -> bool:
        """Whether parts are where they were seen last, whatever an image shows."""
        return False

    @property
    def nearer_m(self) -> float:
        """What counts as nearer to the goal [m]; a task that comes no nearer is stuck."""
        return NEARER_M

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario that cannot be done on this rig, with a `ScenarioError`."""
        return

    def doubts(self) -> tuple[str, ...]:
        """Say what is asked that this rig will probably not do, and what would do."""
        return ()

    @property
    def bias_gain(self) -> float:
        """Fraction of what a cycle does otherwise than predicted that counts as drift bias [-]."""
        return BIAS_GAIN

    def bias_axes(self, memory: Any, parts: Parts, t: float) -> np.ndarray:
        """Unit vectors (M, 2, 2), in rows, along which the bias of parts stays the same."""
        return np.tile(np.eye(2), (len(parts), 1, 1))

    def bias_limit(self, memory: Any, parts: Parts, period: float) -> np.ndarray:
        """Greatest bias (M,) to be believed [m/s]."""
        return np.full(len(parts), BIAS_M / period)
