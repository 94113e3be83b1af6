"""Simulated production, without ROS: a robot picks parts that a feeder presents.

The simulation consists of the control loop of `loop`, the rules of the feeder, and the hopper and
robot of the simulator. At the beginning, the plate is almost empty, so the hopper drops a heap of
parts first. The result is a `Production`, which contains the number of parts per minute and the
robot's waiting time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np

from plate_core import MAX_PARTS, PlateError, Rig, load_rig
from plate_core.tasks import FeedOrder, FeedTask, Scenario
from plate_feeder import Feeder, FeedStatus, ReadyPart, Reply
from plate_planner.tasks import FeedReport
from plate_sim import Grip, Move, Simulation

from .loop import Setup, run

__all__ = [
    "COMES",
    "LEAVES",
    "REQUESTS",
    "Act",
    "FeederCell",
    "Production",
    "Robot",
    "Tally",
    "check_robot",
    "filled",
    "percentiles",
    "produce",
]  # fmt: skip

LEAVES = 0.15
"""Time from a grip until the robot has left the image, divided by the robot's cycle."""

REQUESTS = 0.6
"""Time from a grip until the robot requests the next part, divided by the robot's cycle."""

COMES = 0.85
"""Time from a grip until the robot enters the image again, divided by the robot's cycle."""

AGAIN = 0.1
"""Time from a reply without a part until the robot requests a part again, divided by the robot's
cycle."""

SHORT_S = 1e-9
"""Tolerance for rounding errors of times [s]."""

CLIENT = "robot"


class Act(Enum):
    """Next action of a robot."""

    LEAVE = "leave"
    REQUEST = "ask"
    COME = "come"
    GRIP = "grip"


@dataclass(frozen=True)
class Robot:
    """Robot that picks one part per cycle of the length C.

    All following times are measured from the last grip. At 0, the robot detects whether it holds
    the part. Until 0.15 C, the robot hides a region of the camera image. Then the robot reports to
    the feeder whether it has the part. At 0.6 C, the robot requests the next part. If the reply
    arrives before 0.85 C, the robot enters the image at 0.85 C and grips at C. If the reply arrives
    later, the robot waits outside the image. The robot then enters the image when the reply
    arrives, and grips 0.15 C later. Only this delay counts as waiting time. A failed grip takes as
    long as a successful grip.

    Attributes
    ----------
    cycle_s : float
        Cycle length C [s].
    since : float
        Time of the last grip [s].
    next : Act
    pose : (x, y, angle) or None
        Pose of the next grip [m, m, rad, plate_home]. None until the feeder has replied.
    answered : float
        Time of the reply that contains the pose of the next grip [s].
    refused : float
        Time of the last reply without a part [s].
    """

    cycle_s: float
    since: float
    next: Act = Act.LEAVE
    pose: tuple[float, float, float] | None = None
    answered: float = -np.inf
    refused: float = -np.inf

    @classmethod
    def ready(cls, cycle_s: float) -> Robot:
        """Return a robot that requests its first part at time 0."""
        return cls(cycle_s, -REQUESTS * cycle_s, Act.REQUEST)

    def after_reply(self, pose: tuple[float, float, float] | None, now: float) -> Robot:
        """Return the robot after it has received a reply at the time `now` [s]. `pose` is the pose
        of the part [m, m, rad, plate_home], or None if the reply contains no part."""
        if pose is None:
            return replace(self, next=Act.REQUEST, refused=now)
        return replace(self, pose=pose, answered=now)

    @property
    def due(self) -> float:
        """Time of the next action [s]. Infinite while the robot waits for a reply."""
        if self.next is Act.LEAVE:
            return self.since + LEAVES * self.cycle_s
        if self.next is Act.REQUEST:
            return max(self.since + REQUESTS * self.cycle_s, self.refused + AGAIN * self.cycle_s)
        if self.pose is None:
            return np.inf
        comes = max(self.since + COMES * self.cycle_s, self.answered)
        return comes if self.next is Act.COME else comes + (1 - COMES) * self.cycle_s

    def step(self, now: float) -> tuple[Robot, Act | None]:
        """Perform the first action that is due at `now` [s]. Return the robot after this action,
        and the action. If no action is due, the action is None."""
        if self.due > now + SHORT_S:
            return self, None
        act = self.next
        if act is Act.GRIP:
            return Robot(self.cycle_s, self.due), act
        follows = {Act.LEAVE: Act.REQUEST, Act.REQUEST: Act.COME, Act.COME: Act.GRIP}
        return replace(self, next=follows[act]), act

    def waited(self, now: float) -> float:
        """Return how long the robot has waited for its next part until `now` [s]."""
        until = now if self.pose is None else self.answered
        return max(0.0, until - self.since - COMES * self.cycle_s)


@dataclass
class Tally:
    """Counters and times of a running production.

    Attributes
    ----------
    time_s : float
        Elapsed time [s].
    first_s : float
        Time of the first successful grip [s]. NaN before the first successful grip.
    picks, failed : int
        Number of successful grips and number of failed grips.
    waited_s : float
        Total waiting time of the robot since the first pick [s].
    error_m, error_rad : list of float
        Errors of the position [m] and the angle [rad] that the feeder reported, one for each grip.
    refused : list of str
        Code and text of each reply to the robot's requests that contained no part.
    cpu_s : float
        CPU time of vision, planner, solver and driver [s].
    """

    time_s: float = 0.0
    first_s: float = np.nan
    picks: int = 0
    failed: int = 0
    waited_s: float = 0.0
    error_m: list[float] = field(default_factory=list)
    error_rad: list[float] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    cpu_s: float = 0.0

    def gripped(self, robot: Robot, result: Grip) -> None:
        """Record a grip and its result."""
        self.picks += result.success
        self.failed += not result.success
        if not np.isnan(self.first_s):
            self.waited_s += robot.waited(robot.due)
        elif result.success:
            self.first_s = robot.due
        self.error_m.append(result.error_m)
        self.error_rad.append(abs(result.error_rad))


@dataclass(frozen=True)
class Production:
    """Result of a production.

    Attributes
    ----------
    parts_per_min : float
        Number of picks after the first pick, divided by the time since the first pick [1/min]. If
        there was only one pick, the value is 1 divided by the whole time.
    waiting : float
        Waiting time of the robot, divided by the time since the first pick. 1 if there was no
        second pick.
    first_s : float
        Time until the first pick [s].
    picks, failed : int
        Number of successful grips and number of failed grips.
    lost, discharged : int
        Numbers of parts that left the plate. A part that leaves over an edge without the chute is
        lost. A part that leaves over the edge with the chute is lost if its class is requested.
        A part of another class that leaves over this edge is discharged.
    error_mm, error_deg : (median, 95th percentile, maximum)
        Errors of the reported positions and angles of the parts at the grip.
    cpu : float
        CPU time per simulated second, without the CPU time of the simulator.
    refused : tuple of str
        Code and text of each reply to the robot's requests that contained no part.
    """

    parts_per_min: float
    waiting: float
    first_s: float
    picks: int
    failed: int
    lost: int
    discharged: int
    error_mm: tuple[float, float, float]
    error_deg: tuple[float, float, float]
    cpu: float
    refused: tuple[str, ...] = ()

    @classmethod
    def of(cls, tally: Tally, robot: Robot, simulation: Simulation, task: FeedTask) -> Production:
        """Return the result of a production until now."""
        astray = sum(simulation.discharged_classes[pick.label] for pick in task.picks)
        counts = tally.picks >= 2
        since = tally.time_s - tally.first_s if counts else max(tally.time_s, SHORT_S)
        waited = tally.waited_s + robot.waited(tally.time_s)
        return cls(
            parts_per_min=60 * (tally.picks - counts) / since,
            waiting=waited / since if counts else 1.0,
            first_s=tally.first_s,
            picks=tally.picks,
            failed=tally.failed,
            lost=simulation.dropped + astray,
            discharged=simulation.discharged - astray,
            error_mm=percentiles(tally.error_m, 1e3),
            error_deg=percentiles(tally.error_rad, 180 / np.pi),
            cpu=tally.cpu_s / max(tally.time_s, SHORT_S),
            refused=tuple(tally.refused),
        )

    @property
    def row(self) -> dict[str, Any]:
        """Result as a dictionary that can be converted to JSON."""
        return asdict(self)


def percentiles(values: Sequence[float], unit: float) -> tuple[float, float, float]:
    """Return the median, the 95th percentile and the maximum of the finite values, multiplied by
    `unit`. If no value is finite, return NaN."""
    finite = unit * np.array([value for value in values if np.isfinite(value)])
    if not len(finite):
        return (np.nan, np.nan, np.nan)
    return (float(np.median(finite)), float(np.percentile(finite, 95)), float(np.max(finite)))


class FeederCell:
    """Devices around the plate in production: a feeder with its rules, a hopper and a robot.

    Attributes
    ----------
    feeder : Feeder
    robot : Robot
    tally : Tally
    simulation : Simulation or None
        Simulation of the plate. None before the first call of `act`.
    """

    def __init__(self, task: FeedTask, rig: Rig, cycle_s: float) -> None:
        self.feeder, self.robot, self.tally = Feeder(task, rig), Robot.ready(cycle_s), Tally()
        self.simulation: Simulation | None = None
        # Id of the part that the feeder reserved for the robot, and whether the robot holds this
        # part.
        self._id, self._has = "", False

    def act(self, simulation: Simulation, now: float) -> None:
        """Perform all actions of the robot that are due at `now` [s]."""
        self.simulation, self.tally.time_s = simulation, now
        while True:
            before = self.robot
            self.robot, act = before.step(now)
            if act is None:
                return
            if act is Act.REQUEST:
                self._process_reply(self.feeder.get_part(CLIENT, now=now), now)
            elif act is Act.LEAVE:
                simulation.move_robot(Move.AWAY)
                self.feeder.part_taken(CLIENT, self._id, self._has)
            elif act is Act.COME and before.pose is not None:
                simulation.move_robot(Move.OVER, *before.pose)
            elif before.pose is not None:
                result = simulation.move_robot(Move.GRIP, *before.pose)
                self.tally.gripped(before, result)
                self._has = result.success

    def order(self, report: FeedReport, now: float) -> FeedOrder:
        """Pass the planner's report to the feeder, and return the feeder's order."""
        self.feeder.receive_status(status_of(report), now)
        output = self.feeder.step(now)
        if output.open_s is not None and self.simulation is not None:
            # As in the feeder node, the hopper is not opened if the plate is full.
            with suppress(PlateError):
                self.simulation.open_hopper(output.open_s)
        for _, reply in output.replies:
            self._process_reply(reply, now)
        return output.order

    def _process_reply(self, reply: Reply | None, now: float) -> None:
        """Process the feeder's reply to the robot. None means that the feeder will reply later."""
        if reply is None:
            return
        part = reply.part
        if part is None:
            self.tally.refused.append(f"{int(reply.code)} {reply.text}")
            self.robot = self.robot.after_reply(None, now)
            return
        self._id = part.id
        self.robot = self.robot.after_reply((part.x, part.y, part.angle), now)


def status_of(report: FeedReport) -> FeedStatus:
    """Convert the planner's report on an image to a status for the feeder."""
    ready = report.ready
    parts = zip(ready.ids, ready.position.tolist(), ready.angle.tolist(), strict=True)
    return FeedStatus(
        stamp=report.stamp,
        mode=report.mode,
        at_rest=report.at_rest,
        ready=tuple(ReadyPart(name, x, y, angle) for name, (x, y), angle in parts),
        seen=report.seen,
        discharged=report.discharged,
        lost=report.lost,
    )


def check_robot(task: FeedTask, cycle_s: float) -> None:
    """Raise an error if the feeder's reservations are too short for a robot with this cycle time.
    The robot must have left the plate before the reservation of its part ends.

    Raises
    ------
    PlateError
        If the cycle of the robot is too long for the `valid_s` of the task.
    """
    min_s = (1 + LEAVES - REQUESTS) * cycle_s
    if task.valid_s < min_s:
        raise PlateError(
            f"valid_s is {task.valid_s:g} s, allowed: at least {min_s:g} s, because a robot with a "
            f"cycle of {cycle_s:g} s needs this time from the feeder's reply until its gripper has "
            "left the plate"
        )


def filled(recipe: Scenario, fill: int) -> Scenario:
    """Return the recipe with a hopper that keeps `fill` parts on the plate.

    At the start, the plate contains one part of the first requested class. The plate also contains
    the recipe's parts of all classes that are not requested.

    Raises
    ------
    PlateError
        If the recipe is not a feed task with a hopper, or if `fill` is out of range.
    """
    task = recipe.task
    if not isinstance(task, FeedTask) or task.hopper is None:
        raise PlateError(
            f"recipe is {recipe.name!r}, allowed: a scenario of kind feed with a hopper"
        )
    hopper, ready = task.hopper, sum(pick.ready for pick in task.picks)
    if not ready <= fill <= MAX_PARTS:
        raise PlateError(
            f"fill is {fill}, allowed: {ready} (the number of ready parts) to {MAX_PARTS}"
        )
    min_fill = max(1, round(fill * hopper.least / hopper.fill))
    labels = [pick.label for pick in task.picks]
    groups = tuple(
        replace(group, count=int(group.label == labels[0]), position=None)
        if group.label in labels
        else group
        for group in recipe.parts
    )
    return replace(
        recipe,
        parts=groups,
        task=replace(task, hopper=replace(hopper, fill=fill, least=min_fill)),
    )


def produce(
    setup: Setup,
    cycle_s: float,
    time_s: float,
    rig: Rig | None = None,
    note: Callable[[FeederCell], None] = lambda _: None,
) -> Production:
    """Simulate a production with a feeder and a robot.

    Parameters
    ----------
    setup : Setup
        Setup of a feed task.
    cycle_s, time_s : float
        Cycle of the robot, and duration of the production [s].
    rig : Rig, optional
        Rig. Default: the rig of the recipe.
    note : callable
        Function that is called after each computed cycle.

    Raises
    ------
    PlateError
        If the task ends unexpectedly, or if the robot is too slow for the recipe.
    """
    recipe = setup.recipe
    rig = rig or load_rig(recipe.rig)
    if not isinstance(recipe.task, FeedTask):
        raise PlateError(f"recipe is {recipe.name!r}, allowed: a scenario of kind feed")
    check_robot(recipe.task, cycle_s)
    cell = FeederCell(recipe.task, rig, cycle_s)
    for moment in run(setup, rig, cell=cell):
        cell.tally.cpu_s += moment.step_s
        note(cell)
        if moment.progress.ended:
            raise PlateError(
                f"the task of recipe {recipe.name} ended too early, after {moment.time:.1f} s: "
                f"{moment.progress.text}"
            )
        if cell.tally.time_s >= time_s:
            break
    if cell.simulation is None:
        raise PlateError(f"time_s is {time_s:g}, allowed: above 0")
    return Production.of(cell.tally, cell.robot, cell.simulation, recipe.task)
