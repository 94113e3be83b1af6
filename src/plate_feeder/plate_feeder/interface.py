"""Data that the feeder exchanges with the planner, the clients and the hopper."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from plate_core import Parts, part_class
from plate_core.tasks import FeedMode, FeedOrder

from .codes import Code


@dataclass(frozen=True)
class ReadyPart:
    """A part that a robot may grip.

    Attributes
    ----------
    id : str
        Id of the part, such as `black_3`.
    x, y : float
        Position of the centre [m, plate_home].
    angle : float
        Angle, counter-clockwise from x [rad].
    covariance : tuple of 9 floats
        Covariance matrix of (x, y, angle), row by row [m2, m rad, rad2]. If the covariance is
        unknown, the first value is -1.
    """

    id: str
    x: float
    y: float
    angle: float = 0.0
    covariance: tuple[float, ...] = (-1.0, *8 * (0.0,))

    @property
    def label(self) -> str:
        """Class of the part."""
        return part_class(self.id)

    @property
    def alone(self) -> Parts:
        """Convert this part to a `Parts` object with one row."""
        return Parts.make((self.id,), np.array([[self.x, self.y]]), angle=np.array([self.angle]))


@dataclass(frozen=True)
class FeedStatus:
    """Status of the planner's feed task after one image.

    Attributes
    ----------
    stamp : float
        Stamp of the image, measured by the clock of the camera [s]. The feeder compares the stamp
        only with other stamps.
    mode : FeedMode
        Current mode of the planner.
    at_rest : bool
        Whether the plate rests, so that the parts are still where the image shows them.
    ready : tuple of ReadyPart
    seen : mapping of str to int
        Number of parts on the plate, by class.
    discharged : int
        Number of parts that have left the plate over the chute since this task began.
    lost : int
        Number of parts that have left the plate over other edges since this task began.
    """

    stamp: float
    mode: FeedMode
    at_rest: bool
    ready: tuple[ReadyPart, ...] = ()
    seen: Mapping[str, int] = field(default_factory=dict)
    discharged: int = 0
    lost: int = 0

    @property
    def total(self) -> int:
        """Number of parts on the plate."""
        return sum(self.seen.values())


@dataclass(frozen=True)
class Reply:
    """Reply to a command.

    Attributes
    ----------
    code : Code
    text : str
        Result, or the reason for a refusal.
    part : ReadyPart or None
        Part for the robot. None if the reply contains no part.
    valid_until : float
        Time at which the reservation of the part ends, on the steady clock of the feeder [s].
    left : int
        Number of parts that are still on the plate after a purge.
    """

    code: Code
    text: str
    part: ReadyPart | None = None
    valid_until: float = math.nan
    left: int = 0


@dataclass(frozen=True)
class Output:
    """Requests of the feeder to the planner and the hopper, and replies to clients.

    Attributes
    ----------
    run : bool
        Whether the planner's task should run. If False, cancel it.
    order : FeedOrder
        Order to the running task.
    open_s : float or None
        Time for which the hopper must be open from now on [s]. 0 closes the hopper. None leaves the
        hopper unchanged.
    replies : tuple of (client, Reply)
        Replies to commands that were waiting.
    """

    run: bool
    order: FeedOrder
    open_s: float | None = None
    replies: tuple[tuple[Hashable, Reply], ...] = ()


@dataclass(frozen=True)
class Quantity:
    """Numbers of parts.

    Attributes
    ----------
    seen : mapping of str to int
        Number of parts on the plate, by class.
    ready : int
        Number of parts that a robot may get now.
    taken : int
        Number of parts that robots have taken since the feeder started.
    discharged : int
        Number of parts that have left the plate over the chute since the feeder started.
    lost : int
        Number of parts that have left the plate over other edges since the feeder started.
    """

    seen: Mapping[str, int]
    ready: int
    taken: int
    discharged: int
    lost: int


@dataclass(frozen=True)
class Reserved:
    """A part that is reserved.

    Attributes
    ----------
    client : hashable or None
        Client for which the part is reserved. None if this client has disconnected.
    part : ReadyPart
    until : float
        Time at which the reservation ends, on the steady clock of the feeder [s].
    """

    client: Hashable | None
    part: ReadyPart
    until: float


class State(Enum):
    """State of the feeder."""

    IDLE = "idle"  # no task runs; the next command starts a task
    # the task was stopped or has failed; the next command restarts the task if this is permitted
    STOPPED = "stopped"
    STARTING = "starting"  # the feeder has requested the task from the planner
    FEEDING = "feeding"  # the planner makes parts ready for picking
    READY = "ready"  # enough parts are ready, and the plate rests
    WAITING = "waiting"  # a get_part command waits for a part
    RESERVED = "reserved"  # a part is reserved, the plate rests
    PURGING = "purging"
    SILENT = "silent"  # the planner sends no feed_status
