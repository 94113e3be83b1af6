"""Interface between the planner and the rules of a task. `Situation` is the input of the rules at
each image or cycle, and `Assessment` is their output. `TaskRules` is the base class of all
rules."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from plate_core import Parts, Targets
from plate_core.tasks import Scenario

from .drift import DriftInterval

POSITION_ERROR_M, ANGLE_ERROR_RAD = 3e-4, 0.01
"""Maximum error of the measured position [m] and of the measured angle [rad] of a part. Tasks are
evaluated with measured poses."""

BAND = 0.3
"""Half width of the target intervals of positions and angles, divided by the task's tolerance
[-]."""

NEARER_M = 0.002
"""Minimum decrease of the distance to the goal, summed over the parts, that counts as progress [m].
The value is larger than the noise of the camera."""

BIAS_GAIN = 0.3
"""Gain of the drift bias observer: weight of the newest prediction error [-]."""

BIAS_M = 5e-3
"""Maximum prediction error per cycle that counts as drift bias [m]. If the error is larger, it is
assumed that something has pushed the part."""


@dataclass(frozen=True)
class Situation:
    """Input of the task rules at one image.

    Attributes
    ----------
    parts : Parts
        M parts on the plate, with their positions at the time `stamp`.
    stamp : float
        Stamp of the image [s].
    start : float
        Time at which the solver's result for this request begins [s].
    rests : float
        Time at which the plate comes to rest if no motion is requested from `start` on [s].
    period : float
        Length of a cycle [s].
    motion_known : bool
        Whether the executed cycles of the plate are known. If False, predictions assume that the
        parts follow the last request.
    latency_known : bool
        Whether the image latency is known to within a few milliseconds.
    predicted : (M, 2)
        Predicted positions of the parts at `start` [m, plate_home].
    shortfall : (M,)
        Magnitude of the difference between the requested and the predicted drift in the running
        cycle [m/s].
    active : bool
        Whether the task has begun and has not ended.
    seen : Parts
        Parts on the plate that the last image shows, at their measured positions.
    taken : float
        Time at which the last image was taken [s].
    kept : bool
        Whether the last image was ignored, see `TaskRules.keeps_last`.
    late : int
        Maximum delay of the solver's last results [cycles].
    resting_since : float
        Time since which the plate has been at rest [s]. Infinite if it is not certain that the
        plate is at rest.
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
    """Output of the task rules for one image.

    Attributes
    ----------
    request : DriftInterval or Targets or None
        Request for the M parts, either their drifts in the next cycle or their targets. If None,
        the plate rests.
    goal_met : bool
        Whether the goal is met in this image.
    count : int
        Number of parts at their goals.
    total : int
        Number of parts that the task counts. Only tasks in which this number may exceed the number
        of parts in the scenario set this value.
    distance : (M,)
        Distance of each part from its goal [m].
    to_go_m : float
        Distance to the goal [m], summed over the parts.
    problem : str
        Reason why the task cannot continue. Empty if it can continue.
    missing : tuple of str, or None
        Names of the missing parts. If None, all parts of the scenario that are not detected count
        as missing.
    rms_error_m, max_error_m : float
        Root mean square and maximum of the position errors, as the task defines them [m].
    turn_error : float
        Maximum angle error [rad].
    speed_scaling, pace : float
        Present and mean speed of the references, as a fraction of the speed of their paths [-].
    outcome : str
        Text about the result, which is used if the task is done now.
    doing : str
        Text about the running task.
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
    """Rules of one task on one rig. The methods are pure functions. The memory is an argument and a
    result of `assess`.

    A new task must implement `hold_s` and `assess`. The default implementations of the other
    methods are suitable for most tasks.
    """

    @property
    def hold_s(self) -> float:
        """Time for which the goal must be met before the task is done [s]."""
        ...

    def assess(self, memory: Any, now: Situation) -> tuple[Any, Assessment]:
        """Evaluate one image and return the request to the solver. This method is also called while
        the task is not active.

        Parameters
        ----------
        memory
            Memory that the last call has returned. None at the first call after the start of the
            task.
        now : Situation

        Returns
        -------
        memory
            Memory for the next call.
        assessment : Assessment
        """
        ...

    @property
    def endless(self) -> bool:
        """Whether the task runs until it is canceled. Such a task never ends as done or stuck."""
        return False

    @property
    def open_ended(self) -> bool:
        """Whether parts may be added and removed during the task. Such a task begins with any
        number of parts, and no part counts as missing."""
        return False

    @property
    def precise(self) -> bool:
        """Whether each part moves to a position with a small tolerance. In such a task, the plate
        rests between motions near the targets if predictions are inaccurate."""
        return False

    def keeps_last(self, memory: Any) -> bool:
        """Whether the planner ignores the next image and uses the last detected parts again."""
        return False

    @property
    def nearer_m(self) -> float:
        """Minimum decrease of the distance that counts as progress [m]."""
        return NEARER_M

    def check(self, scenario: Scenario) -> None:
        """Raise a `ScenarioError` if the scenario is infeasible on this rig."""
        return

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about requests that this rig will probably not achieve. Each warning
        contains a remedy."""
        return ()

    @property
    def bias_gain(self) -> float:
        """Gain of the drift bias observer: weight of the newest prediction error [-]."""
        return BIAS_GAIN

    def bias_axes(self, memory: Any, parts: Parts, t: float) -> np.ndarray:
        """Return unit vectors (M, 2, 2), in rows, along which the bias of each part is nearly
        constant."""
        return np.tile(np.eye(2), (len(parts), 1, 1))

    def bias_limit(self, memory: Any, parts: Parts, period: float) -> np.ndarray:
        """Return the maximum drift bias (M,) [m/s]."""
        return np.full(len(parts), BIAS_M / period)
