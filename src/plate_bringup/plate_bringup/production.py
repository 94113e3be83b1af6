"""Simulated production: a feeder and a robot that picks, in simulated time and without ROS.

The plate's loop is that of `loop`, the feeder's rules are those of its node, hopper and robot are
the simulator's. The plate is almost empty at first, so it begins with a heap out of the hopper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np

from plate_core import MOST_PARTS, PlateError, Rig, load_rig
from plate_core.tasks import FeedOrder, FeedTask, Scenario
from plate_feeder import Feeder, FeedStatus, ReadyPart, Reply
from plate_planner.tasks import FeedReport
from plate_sim import Grip, Move, Simulation

from .loop import Setup, run

__all__ = [
    "ASKS", "COMES", "LEAVES", "Act", "FeederCell", "Production", "Robot", "Tally", "check_robot",
    "filled", "percentiles", "produce",
]  # fmt: skip

LEAVES, ASKS, COMES = 0.15, 0.6, 0.85
"""When a robot has left the view after its grip, asks for the next part, and comes into view again
[its cycle]."""

AGAIN = 0.1
"""A robot that is refused a part asks again so much later [its cycle]."""

SHORT_S = 1e-9
"""Times are sums of rounded ones [s]."""

CLIENT = "robot"


class Act(Enum):
    """What a robot does next."""

    LEAVE = "leave"
    ASK = "ask"
    COME = "come"
    GRIP = "grip"


@dataclass(frozen=True)
class Robot:
    """A robot that picks parts, one each cycle of C s.

    It grips at time 0, and at once knows whether it has the part. It hides part of the image until
    0.15 C, and tells then. At 0.6 C it asks for the next part. If it has the answer it comes into
    view at 0.85 C, and grips at C; else it waits outside the view for the answer, and grips 0.15 C
    after it. This waiting is what counts. A grip that fails takes as long as any other.

    Attributes
    ----------
    cycle_s : float
        C [s].
    since : float
        When it has gripped last [s].
    next : Act
    place : (x, y, angle) or None
        Where it is to grip [m, m, rad, plate_home]; None: it does not know.
    answered : float
        When it got to know [s].
    refused : float
        When it was refused a part [s].
    """

    cycle_s: float
    since: float
    next: Act = Act.LEAVE
    place: tuple[float, float, float] | None = None
    answered: float = -np.inf
    refused: float = -np.inf

    @classmethod
    def ready(cls, cycle_s: float) -> Robot:
        """Return one that asks for its first part at time 0."""
        return cls(cycle_s, -ASKS * cycle_s, Act.ASK)

    def told(self, place: tuple[float, float, float] | None, now: float) -> Robot:
        """Take the answer [m, m, rad, plate_home] at a time [s]; None: there is no part."""
        if place is None:
            return replace(self, next=Act.ASK, refused=now)
        return replace(self, place=place, answered=now)

    @property
    def due(self) -> float:
        """When the next act is [s]; infinite while it waits."""
        if self.next is Act.LEAVE:
            return self.since + LEAVES * self.cycle_s
        if self.next is Act.ASK:
            return max(self.since + ASKS * self.cycle_s, self.refused + AGAIN * self.cycle_s)
        if self.place is None:
            return np.inf
        comes = max(self.since + COMES * self.cycle_s, self.answered)
        return comes if self.next is Act.COME else comes + (1 - COMES) * self.cycle_s

    def step(self, now: float) -> tuple[Robot, Act | None]:
        """Return it after the first act that is due by now [s], and that act; None: none is."""
        if self.due > now + SHORT_S:
            return self, None
        act = self.next
        if act is Act.GRIP:
            return Robot(self.cycle_s, self.due), act
        follows = {Act.LEAVE: Act.ASK, Act.ASK: Act.COME, Act.COME: Act.GRIP}
        return replace(self, next=follows[act]), act

    def waited(self, now: float) -> float:
        """Return how long it has waited for its next part until now [s]."""
        until = now if self.place is None else self.answered
        return max(0.0, until - self.since - COMES * self.cycle_s)


@dataclass
class Tally:
    """What is counted in a production.

    Attributes
    ----------
    time_s : float
        How long it has been going on [s].
    first_s : float
        When the first part was picked [s]; not a number: none was.
    picks, failed : int
        Grips that had a part; that had none.
    waited_s : float
        How long the robot waited for parts after the first [s].
    error_m, error_rad : list of float
        How far parts lay from where they were said, and turned otherwise, when they were gripped.
    refused : list of str
        Answers to the robot's questions other than a part.
    cpu_s : float
        Time of the cores for vision, planner, solver and driver [s].
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
        """Count a grip that was due."""
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
    """What came of a production.

    Attributes
    ----------
    parts_per_min : float
        Parts that were picked, after the first one, by the time since then; if there was but one,
        by all the time.
    waiting : float
        Share of the time since the first pick in which the robot waited for a part [-]; 1 if no
        second one followed.
    first_s : float
        Until the first pick [s].
    picks, failed : int
        Grips that had a part, and that had none.
    lost, discharged : int
        Parts that left the plate otherwise: over an edge, or wanted ones over the chute's; and
        others over the chute's.
    error_mm, error_deg : (median, 95 %, worst)
        Of parts' places and angles when they were gripped.
    cpu : float
        Time of a core for each second, without that of the simulator [-].
    refused : tuple of str
        Answers to the robot's questions other than a part.
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
        """Sum up what was counted until now."""
        astray = sum(simulation.chuted_classes[pick.label] for pick in task.picks)
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
            discharged=simulation.chuted - astray,
            error_mm=percentiles(tally.error_m, 1e3),
            error_deg=percentiles(tally.error_rad, 180 / np.pi),
            cpu=tally.cpu_s / max(tally.time_s, SHORT_S),
            refused=tuple(tally.refused),
        )

    @property
    def row(self) -> dict[str, Any]:
        """The same as JSON has it."""
        return asdict(self)


def percentiles(values: Sequence[float], unit: float) -> tuple[float, float, float]:
    """Return median, 95 % and greatest of values that are finite, in a unit."""
    there = unit * np.array([value for value in values if np.isfinite(value)])
    if not len(there):
        return (np.nan, np.nan, np.nan)
    return (float(np.median(there)), float(np.percentile(there, 95)), float(np.max(there)))


class FeederCell:
    """What is around the plate: the feeder's rules, the hopper and a robot.

    Attributes
    ----------
    feeder : Feeder
    robot : Robot
    tally : Tally
    simulation : Simulation or None
        None: nothing has happened so far.
    """

    def __init__(self, task: FeedTask, rig: Rig, cycle_s: float) -> None:
        self.feeder, self.robot, self.tally = Feeder(task, rig), Robot.ready(cycle_s), Tally()
        self.simulation: Simulation | None = None
        self._id, self._has = "", False  # of the part that it was told; whether it has it

    def act(self, simulation: Simulation, now: float) -> None:
        """Have the robot do what is due by now [s]."""
        self.simulation, self.tally.time_s = simulation, now
        while True:
            before = self.robot
            self.robot, act = before.step(now)
            if act is None:
                return
            if act is Act.ASK:
                self._hear(self.feeder.get_part(CLIENT, now=now), now)
            elif act is Act.LEAVE:
                simulation.move_robot(Move.AWAY)
                self.feeder.part_taken(CLIENT, self._id, self._has)
            elif act is Act.COME and before.place is not None:
                simulation.move_robot(Move.OVER, *before.place)
            elif before.place is not None:
                result = simulation.move_robot(Move.GRIP, *before.place)
                self.tally.gripped(before, result)
                self._has = result.success

    def order(self, report: FeedReport, now: float) -> FeedOrder:
        """Hand the planner's report to the feeder, and return what it orders."""
        self.feeder.hear(status_of(report), now)
        output = self.feeder.step(now)
        if output.open_s is not None and self.simulation is not None:
            with suppress(PlateError):  # of a full plate: the node is refused, too
                self.simulation.open_hopper(output.open_s)
        for _, reply in output.replies:
            self._hear(reply, now)
        return output.order

    def _hear(self, reply: Reply | None, now: float) -> None:
        """Take the feeder's answer to the robot; None: it comes later."""
        if reply is None:
            return
        part = reply.part
        if part is None:
            self.tally.refused.append(f"{int(reply.code)} {reply.text}")
            self.robot = self.robot.told(None, now)
            return
        self._id = part.id
        self.robot = self.robot.told((part.x, part.y, part.angle), now)


def status_of(report: FeedReport) -> FeedStatus:
    """Return what the feeder gets to know of an image."""
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
    """Refuse a robot whose cycle [s] is so long that its part is no longer reserved while it stands
    over the plate.

    Raises
    ------
    PlateError
        If it is.
    """
    least = (1 + LEAVES - ASKS) * cycle_s
    if task.valid_s < least:
        raise PlateError(
            f"valid_s is {task.valid_s:g} s, allowed: {least:g} and above, which a robot of "
            f"{cycle_s:g} s takes from the answer until it has left the plate"
        )


def filled(recipe: Scenario, fill: int) -> Scenario:
    """Return a recipe whose hopper keeps so many parts on the plate, and that begins with one of
    those that are wanted, and the others that it has.

    Raises
    ------
    PlateError
        If it is no recipe of a feeder with a hopper, or there cannot be so many parts.
    """
    task = recipe.task
    if not isinstance(task, FeedTask) or task.hopper is None:
        raise PlateError(f"recipe is {recipe.name!r}, allowed: one of the kind feed, with a hopper")
    hopper, ready = task.hopper, sum(pick.ready for pick in task.picks)
    if not ready <= fill <= MOST_PARTS:
        raise PlateError(
            f"fill is {fill}, allowed: {ready}, which are to be ready, to {MOST_PARTS}"
        )
    least = max(1, round(fill * hopper.least / hopper.fill))
    wanted = [pick.label for pick in task.picks]
    groups = tuple(
        replace(group, count=int(group.label == wanted[0]), position=None)
        if group.label in wanted
        else group
        for group in recipe.parts
    )
    return replace(
        recipe,
        parts=groups,
        task=replace(task, hopper=replace(hopper, fill=fill, least=least)),
    )


def produce(
    setup: Setup,
    cycle_s: float,
    time_s: float,
    rig: Rig | None = None,
    note: Callable[[FeederCell], None] = lambda _: None,
) -> Production:
    """Run the feeder with a robot of a cycle [s] for a time [s].

    Parameters
    ----------
    setup : Setup
        Its scenario is a recipe.
    cycle_s, time_s : float
    rig : Rig, optional
        In place of the recipe's.
    note : callable
        Called after each image.

    Raises
    ------
    PlateError
        If the task ends, which it should not, or the robot is too slow for the recipe.
    """
    recipe = setup.recipe
    rig = rig or load_rig(recipe.rig)
    if not isinstance(recipe.task, FeedTask):
        raise PlateError(f"recipe is {recipe.name!r}, allowed: one of the kind feed")
    check_robot(recipe.task, cycle_s)
    cell = FeederCell(recipe.task, rig, cycle_s)
    for moment in run(setup, rig, cell=cell):
        cell.tally.cpu_s += moment.step_s
        note(cell)
        if moment.progress.ended:
            raise PlateError(
                f"{recipe.name} ended after {moment.time:.1f} s: {moment.progress.text}"
            )
        if cell.tally.time_s >= time_s:
            break
    if cell.simulation is None:
        raise PlateError(f"time is {time_s:g} s, allowed: above 0")
    return Production.of(cell.tally, cell.robot, cell.simulation, recipe.task)
