"""The words of a scenario: groups of parts, and the tasks that can be set them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

Point = tuple[float, float]
"""x, y [m, plate_home]."""


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
    position: tuple[Point, ...] | None = None


@dataclass(frozen=True)
class Side:
    """A side or corner of the plate: where x and y have these signs, 0 for any.

    Beyond the goal line along x, along y, or along both.
    """

    x: int
    y: int


@dataclass(frozen=True)
class Bin:
    """A polygon on the plate, given by its corners [m, plate_home]."""

    corner: tuple[Point, ...]


Region = Side | Bin


@dataclass(frozen=True)
class SortTask:
    """Bring every class to its region of the plate.

    Attributes
    ----------
    regions : mapping of str to Side or Bin
        Where each class belongs.
    goal_fraction : float
        A part has come to a side beyond this fraction of the plate's half length or half width.
    hold_s : float
        The task is done when all parts have been sorted for this time [s].
    """

    regions: Mapping[str, Region]
    goal_fraction: float
    hold_s: float


@dataclass(frozen=True)
class PathTask:
    """A polygon that one part is to follow; circles and splines are polygons of fine chords.

    Attributes
    ----------
    label : str
        Class of the part.
    waypoint : tuple of (x, y)
        Corners [m, plate_home]; the first is the start.
    speed : float
        Greatest speed along the path [m/s].
    closed : bool
        Whether the last corner leads back to the first.
    laps : float
        How many times round, for closed paths; 1 otherwise.
    profile : tuple of (fraction, speed)
        Speed [m/s] at fractions of a lap's length from 0 to 1, linear in length between them;
        empty: `speed` all the way.
    """

    label: str
    waypoint: tuple[Point, ...]
    speed: float
    closed: bool
    laps: float
    profile: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class FollowTask:
    """Every part follows its own path; a part further off than `max_error_m` ends the task."""

    paths: tuple[PathTask, ...]
    max_error_m: float


@dataclass(frozen=True)
class AssembleTask:
    """Bring parts to places, any part of its class to each.

    Attributes
    ----------
    labels : tuple of str, length P
        Class of the part that belongs to each place.
    place : tuple of (x, y), length P
        [m, plate_home].
    tolerance_m : float
        A part is there when its centre is this near [m].
    hold_s : float
        The task is done when all parts have been there for this time [s].
    """

    labels: tuple[str, ...]
    place: tuple[Point, ...]
    tolerance_m: float
    hold_s: float


@dataclass(frozen=True)
class Pose:
    """Where one part is to be, and which way its mark is to point.

    Attributes
    ----------
    label : str
        Class of the part.
    place : (x, y), or None
        [m, plate_home]; None: where the part is when the task begins, and there it has to stay,
        unless it may be anywhere.
    angle : float
        Counter-clockwise from x [rad]; of a part that looks the same in several directions, of any
        of them.
    """

    label: str
    place: Point | None
    angle: float


@dataclass(frozen=True)
class PoseTask:
    """Bring parts to places and angles.

    Attributes
    ----------
    poses : tuple of Pose
        One for each part.
    tolerance_m : float
        A part is there when its centre is this near [m]; one that is to stay where it is may never
        be further off.
    tolerance_rad : float
        It has turned when its angle is this near [rad].
    hold_s : float
        The task is done when all parts have been so for this time [s].
    anywhere : bool
        Whether parts without a place may be anywhere on the plate.
    """

    poses: tuple[Pose, ...]
    tolerance_m: float
    tolerance_rad: float
    hold_s: float
    anywhere: bool = False


@dataclass(frozen=True)
class PartTarget:
    """Where one part is to come.

    Attributes
    ----------
    id : str
        Of the part, such as `black_3`.
    place : (x, y)
        [m, plate_home].
    angle : float or None
        Counter-clockwise from x [rad], as in `Pose`; None: any.
    """

    id: str
    place: Point
    angle: float | None = None


@dataclass(frozen=True)
class MoveTask:
    """Bring parts to targets of their own, which may be changed while it runs.

    Attributes
    ----------
    targets : tuple of PartTarget
        Of as many parts as are to be moved; the others are to stay where they are, but give way.
    tolerance_m : float
        A part is there when its centre is this near [m].
    tolerance_rad : float
        And has turned when its angle is this near [rad], if its target has one.
    hold_s : float
        The task is done when all have been there for this time [s].
    until_canceled : bool
        Whether it goes on until it is canceled: it is never done, and never stuck.
    """

    targets: tuple[PartTarget, ...]
    tolerance_m: float
    tolerance_rad: float
    hold_s: float
    until_canceled: bool = False


@dataclass(frozen=True)
class Pick:
    """Parts of one class that are to be ready for a robot.

    Attributes
    ----------
    label : str
        Class of the parts.
    ready : int
        How many are to be ready at once.
    low, high : (x, y)
        Corners of the pick window: their centres are to lie in it [m, plate_home].
    angle : float or None
        In which they are to lie, counter-clockwise from x [rad]; None: any.
    tolerance_rad : float
        How far from that angle they may lie [rad].
    """

    label: str
    ready: int
    low: Point
    high: Point
    angle: float | None = None
    tolerance_rad: float = 0.0


@dataclass(frozen=True)
class Hopper:
    """Where new parts come from.

    Attributes
    ----------
    fill : int
        It is opened when fewer parts than `least` are on the plate, for as long as those take that
        are missing to `fill`.
    least : int
    rate : float
        Parts that drop while it is open [1/s].
    place : (x, y)
        Where they drop [m, plate_home].
    spread_m : float
        And how far around it [m].
    mix : mapping of str to float
        Fractions of the classes among them; their sum is 1.
    """

    fill: int
    least: int
    rate: float
    place: Point
    spread_m: float
    mix: Mapping[str, float]


class FeedMode(IntEnum):
    """What a feeder does now."""

    FEED = 0
    """Get parts ready; the plate rests when enough are."""
    REST = 1
    """The plate rests: a robot is over it."""
    PURGE = 2
    """All parts to the chute."""


@dataclass(frozen=True)
class FeedOrder:
    """What a running task of `feed` is to do from now on.

    Attributes
    ----------
    mode : FeedMode
    picks : tuple of Pick
        What is to be ready; none: what the task has.
    hidden : bool
        Whether a robot may hide parts from the camera, while the plate rests: they lie where they
        were seen before.
    """

    mode: FeedMode = FeedMode.FEED
    picks: tuple[Pick, ...] = ()
    hidden: bool = False


@dataclass(frozen=True)
class FeedTask:
    """Have parts ready for a robot while parts come and go, until it is canceled.

    Attributes
    ----------
    picks : tuple of Pick
        Each class once; parts of other classes are brought to the chute.
    clearance_m : float
        The gripper's: least distance of a ready part's rim from that of any other part [m].
    chute : Side or None
        Over this side parts leave the plate that nobody wants; None: they stay.
    hopper : Hopper or None
        None: parts are put on the plate by others.
    timeout_s : float
        Longest wait for a part [s].
    valid_s : float
        So long a part is reserved for the robot [s].
    order : FeedOrder
        What is done now; it may be changed while it runs.
    """

    picks: tuple[Pick, ...]
    clearance_m: float
    chute: Side | None = None
    hopper: Hopper | None = None
    timeout_s: float = 30.0
    valid_s: float = 10.0
    order: FeedOrder = FeedOrder()


Task = SortTask | FollowTask | AssembleTask | PoseTask | MoveTask | FeedTask


@dataclass(frozen=True)
class Scenario:
    """One task: its parts, what is to be done, and the time it may take [s], infinite if any.

    Parts that are `marked` show their angle by a spot, and start at any angle. `rig` is the one
    that it is made for, as `load_rig` takes it; empty: any. `file` is the name of the file that it
    was read from; empty if it comes from none.
    """

    name: str
    description: str
    parts: tuple[PartGroup, ...]
    task: Task
    time_limit_s: float
    marked: bool = False
    rig: str = ""
    file: str = ""

    @property
    def where(self) -> str:
        """Beginning of every message about it."""
        return self.file or f"scenario {self.name}"

    @property
    def count(self) -> int:
        """Number of parts."""
        return sum(group.count for group in self.parts)

    @property
    def labels(self) -> tuple[str, ...]:
        """Class of every part, in the order of `parts`."""
        return tuple(group.label for group in self.parts for _ in range(group.count))
