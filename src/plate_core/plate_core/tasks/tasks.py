"""Data classes of a scenario: groups of parts, the kinds of task, and the scenario itself. The
modules `scenario` and `feed` read and check the data, and the planner implements the tasks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

Point = tuple[float, float]
"""x, y [m, plate_home]."""


@dataclass(frozen=True)
class PartGroup:
    """Parts of one class, with given or random start positions.

    Attributes
    ----------
    label : str
        Class, such as `black`.
    count : int
        Number of parts.
    position : tuple of (x, y), or None
        Start positions [m, plate_home], one for each part. None means random positions.
    """

    label: str
    count: int
    position: tuple[Point, ...] | None = None


@dataclass(frozen=True)
class Side:
    """A region at a side or corner of the plate.

    `x` and `y` are the signs of the coordinates in this region: 1, -1, or 0 for any sign. A part is
    in the region of a side if it is beyond the goal line, and in the region of a corner if it is
    beyond both goal lines.
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
    """Move the parts of every class to the region of their class.

    Attributes
    ----------
    regions : mapping of str to Side or Bin
        Region of each class.
    goal_fraction : float
        Position of the goal line of a side, as a fraction of the plate's half length or half width.
    hold_s : float
        The task succeeds when all parts have been in their regions for this time [s].
    """

    regions: Mapping[str, Region]
    goal_fraction: float
    hold_s: float


@dataclass(frozen=True)
class PathTask:
    """A polygon that one part must follow. Circles and splines are polygons with short chords.

    Attributes
    ----------
    label : str
        Class of the part.
    waypoint : tuple of (x, y)
        Corners [m, plate_home]. The path starts at the first corner.
    speed : float
        Maximum speed along the path [m/s].
    closed : bool
        Whether the last corner is connected to the first corner.
    laps : float
        Number of laps of a closed path. 1 for an open path.
    profile : tuple of (fraction, speed)
        Speed [m/s] at fractions of a lap's length from 0 to 1, interpolated linearly over the
        length. If empty, the speed is constant.
    """

    label: str
    waypoint: tuple[Point, ...]
    speed: float
    closed: bool
    laps: float
    profile: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class FollowTask:
    """Each part follows its own path. The task ends if the error of a part exceeds `max_error_m`
    [m]."""

    paths: tuple[PathTask, ...]
    max_error_m: float


@dataclass(frozen=True)
class AssembleTask:
    """Move parts to positions. Any part of the right class can be moved to a position.

    Attributes
    ----------
    labels : tuple of str, length P
        Class of the part at each position.
    place : tuple of (x, y), length P
        Positions [m, plate_home].
    tolerance_m : float
        Maximum distance between a part's centre and its position [m].
    hold_s : float
        The task succeeds when all parts have been within the tolerance for this time [s].
    """

    labels: tuple[str, ...]
    place: tuple[Point, ...]
    tolerance_m: float
    hold_s: float


@dataclass(frozen=True)
class Pose:
    """Requested position and angle of one part.

    Attributes
    ----------
    label : str
        Class of the part.
    place : (x, y), or None
        Position [m, plate_home]. If None, the part stays in place, or can end anywhere if
        `PoseTask.anywhere` is True.
    angle : float
        Angle of the part's mark, counter-clockwise from x [rad]. If the part has rotational
        symmetry, all equivalent angles are accepted.
    """

    label: str
    place: Point | None
    angle: float


@dataclass(frozen=True)
class PoseTask:
    """Move parts to positions and angles.

    Attributes
    ----------
    poses : tuple of Pose
        One pose for each part.
    tolerance_m : float
        Maximum distance between a part's centre and its position [m]. The task fails if a part that
        must stay in place exceeds this distance.
    tolerance_rad : float
        Maximum error of a part's angle [rad].
    hold_s : float
        The task succeeds when all parts have been within the tolerances for this time [s].
    anywhere : bool
        Whether parts without a position can end anywhere on the plate.
    """

    poses: tuple[Pose, ...]
    tolerance_m: float
    tolerance_rad: float
    hold_s: float
    anywhere: bool = False


@dataclass(frozen=True)
class PartTarget:
    """Target of one part.

    Attributes
    ----------
    id : str
        Id of the part, such as `black_3`.
    place : (x, y)
        Target position [m, plate_home].
    angle : float or None
        Target angle, counter-clockwise from x [rad], as in `Pose`. None: any angle is accepted.
    """

    id: str
    place: Point
    angle: float | None = None


@dataclass(frozen=True)
class MoveTask:
    """Move individual parts to targets. The targets can be changed while the task runs.

    Attributes
    ----------
    targets : tuple of PartTarget
        One target for each part that must move. The other parts stay in place, but the planner
        moves them out of the way if necessary.
    tolerance_m : float
        Maximum distance between a part's centre and its target [m].
    tolerance_rad : float
        Maximum error of a part's angle [rad], for targets with an angle.
    hold_s : float
        The task succeeds when all parts have been within the tolerances for this time [s].
    until_canceled : bool
        Whether the task runs until it is canceled. Such a task never succeeds, and the planner
        never reports it as stuck.
    """

    targets: tuple[PartTarget, ...]
    tolerance_m: float
    tolerance_rad: float
    hold_s: float
    until_canceled: bool = False


@dataclass(frozen=True)
class Pick:
    """Request for parts of one class that a robot can grip.

    Attributes
    ----------
    label : str
        Class of the parts.
    ready : int
        Number of parts that must be ready at the same time.
    low, high : (x, y)
        Lower and upper corner of the pick window for the parts' centres [m, plate_home].
    angle : float or None
        Required angle, counter-clockwise from x [rad]. None: any angle is accepted.
    tolerance_rad : float
        Maximum error of the angle [rad].
    """

    label: str
    ready: int
    low: Point
    high: Point
    angle: float | None = None
    tolerance_rad: float = 0.0


@dataclass(frozen=True)
class Hopper:
    """A hopper, which drops new parts onto the plate.

    Attributes
    ----------
    fill : int
        Number of parts on the plate after a refill. This number determines the opening time of the
        hopper.
    least : int
        The hopper opens when fewer parts than this are on the plate.
    rate : float
        Number of dropped parts per second while the hopper is open [1/s].
    place : (x, y)
        Centre of the area in which parts drop [m, plate_home].
    spread_m : float
        Radius of this area, which is a disc [m].
    mix : mapping of str to float
        Fraction of each class among the dropped parts. The sum is 1.
    """

    fill: int
    least: int
    rate: float
    place: Point
    spread_m: float
    mix: Mapping[str, float]


class FeedMode(IntEnum):
    """Mode of a feed task."""

    FEED = 0
    """Make parts ready. Prepare parts. The plate rests when enough parts are ready."""
    REST = 1
    """Keep the plate at rest, because a robot is above the plate."""
    PURGE = 2
    """Move all parts to the chute."""


@dataclass(frozen=True)
class FeedOrder:
    """Order that changes a running feed task.

    Attributes
    ----------
    mode : FeedMode
    picks : tuple of Pick
        Picks that replace the picks of the task. If empty, the picks of the task are used.
    hidden : bool
        Whether a robot can hide parts from the camera while the plate rests. The planner assumes
        hidden parts at their last detected positions.
    """

    mode: FeedMode = FeedMode.FEED
    picks: tuple[Pick, ...] = ()
    hidden: bool = False


@dataclass(frozen=True)
class FeedTask:
    """Keep parts ready for a robot while parts are added and removed, until the task is canceled.

    Attributes
    ----------
    picks : tuple of Pick
        At most one pick per class. Parts of other classes are moved to the chute.
    clearance_m : float
        Minimum distance between the edges of a ready part and of any other part [m], required by
        the gripper.
    chute : Side or None
        Side over which unwanted parts leave the plate. If None, unwanted parts stay on the plate.
    hopper : Hopper or None
        Hopper that adds parts. None if parts are added by other means.
    timeout_s : float
        Maximum wait for a part [s].
    valid_s : float
        Time for which a part is reserved for the robot [s].
    order : FeedOrder
        Present order. The order can be changed while the task runs.
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
    """A task with its parts and its time limit.

    Attributes
    ----------
    name, description : str
    parts : tuple of PartGroup
    task : Task
    time_limit_s : float
        Maximum duration of the task [s]. Infinite if there is no limit.
    marked : bool
        Whether the parts have a mark that shows their angle. Marked parts start at random angles.
    rig : str
        Rig for which the scenario is made, as an argument of `load_rig`. Empty for any rig.
    file : str
        Name of the scenario's file. Empty if the scenario was not read from a file.
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
        """Text with which every message about the scenario begins."""
        return self.file or f"scenario {self.name}"

    @property
    def count(self) -> int:
        """Number of parts."""
        return sum(group.count for group in self.parts)

    @property
    def labels(self) -> tuple[str, ...]:
        """Class of every part, in the order of `parts`."""
        return tuple(group.label for group in self.parts for _ in range(group.count))
