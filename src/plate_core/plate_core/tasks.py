"""The words of a scenario: groups of parts, and the tasks that can be set them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PartGroup:
    """Parts of one class: given positions, or a count to be scattered.

    Attributes
    ----------
    label : str
        Class, such as `black`.
    count : int
        Number of parts.
    position : tuple of (x, y), or None
        Start positions [m, plate_home], one for each part; None: at random.
    """

    label: str
    count: int
    position: tuple[tuple[float, float], ...] | None = None


@dataclass(frozen=True)
class SortTask:
    """Bring every class to its side of the plate.

    Attributes
    ----------
    sides : mapping of str to int
        Class -> -1 (left, -x) or +1 (right, +x).
    goal_fraction : float
        A part is sorted beyond this share of the half length, on its own side.
    hold_s : float
        The task is done when all parts have been sorted for this time [s].
    """

    sides: Mapping[str, int]
    goal_fraction: float
    hold_s: float


@dataclass(frozen=True)
class PathTask:
    """A polygon that one part is to follow at constant speed.

    Attributes
    ----------
    label : str
        Class of the part.
    waypoint : tuple of (x, y)
        Corners [m, plate_home]; the first is the start.
    speed : float
        Speed along the path [m/s].
    closed : bool
        Whether the last corner leads back to the first.
    laps : float
        How many times round, for closed paths; 1 otherwise.
    """

    label: str
    waypoint: tuple[tuple[float, float], ...]
    speed: float
    closed: bool
    laps: float


@dataclass(frozen=True)
class FollowTask:
    """Every part follows its own path; a part further off than `max_error_m` fails the task."""

    paths: tuple[PathTask, ...]
    max_error_m: float


@dataclass(frozen=True)
class Scenario:
    """One task: its parts, what is to be done, and the time it may take [s]."""

    name: str
    description: str
    parts: tuple[PartGroup, ...]
    task: SortTask | FollowTask
    time_limit_s: float

    @property
    def count(self) -> int:
        """Number of parts."""
        return sum(group.count for group in self.parts)

    @property
    def labels(self) -> tuple[str, ...]:
        """Class of every part, in the order of `parts`."""
        return tuple(group.label for group in self.parts for _ in range(group.count))
