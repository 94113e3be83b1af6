"""Whether a rig can do a task: it is rehearsed on the solver's own map, before it starts.

A rehearsal is the loop with the real planner and solver and the rig's true limits. The solver's
prediction stands in for plate and camera: parts are seen without error, friction differs from part
to part, and parts never touch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from plate_core import Parts, PlateCycle, PlateError, Rig
from plate_core.motion import IDLE_S, usage
from plate_core.tasks import AssembleTask, FollowTask, Scenario, SortTask
from plate_planner import Phase
from plate_sim.plate import PlateMotion
from plate_sim.world import Shot, WorldState
from plate_solver.cycle_map import after
from plate_vision import Prediction

from .loop import Setup, run

__all__ = ["REHEARSALS", "STILL", "Rehearsal", "Share", "Verdict", "judge_task", "rehearse"]

REHEARSALS = 3
"""Starts from which a task is rehearsed."""

MOST_CYCLES = 150
"""Of one rehearsal; what is left of the task then is estimated by the speed of its second half."""

UNEVEN = 0.1
"""Standard deviation of the parts' friction [the rig's]."""

STILL = 0.5e-3
"""Parts that come nearer more slowly do not come nearer [m/s]."""

REHEARSED = SortTask, FollowTask, AssembleTask
"""Kinds of tasks whose parts may be taken for points."""

ENDLESS_S = 1e5
"""A rehearsal has so long [s]: it tells the time that would do."""

NOTHING_SEEN = np.zeros((0, 0))
"""Image of a scene without a camera."""


class Share(NamedTuple):
    """What motions use of the rig's limits, as fractions of them: medians over the cycles."""

    stroke: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    force: float = 0.0
    heat: float = 0.0

    @property
    def binds(self) -> str:
        """The limit of which most is used."""
        return self._fields[int(np.argmax(self))]


@dataclass(frozen=True)
class Rehearsal:
    """How a task went.

    Attributes
    ----------
    time_s : float
        Until it was done, with what was left after `MOST_CYCLES`; infinite where it failed, or
        parts came no nearer.
    speed : float
        Mean over the parts until half of all ways was done [m/s].
    lost : bool
        Whether a part left the plate.
    share : Share
    """

    time_s: float
    speed: float
    lost: bool
    share: Share


class Verdict(NamedTuple):
    """Rehearsals of a task from several starts, and the time that it may take [s]."""

    rehearsals: tuple[Rehearsal, ...]
    time_limit_s: float

    @property
    def in_time(self) -> int:
        """How many ended well."""
        return sum(one.time_s <= self.time_limit_s and not one.lost for one in self.rehearsals)

    @property
    def likely(self) -> bool:
        """Whether most did."""
        return 2 * self.in_time > len(self.rehearsals)

    @property
    def time_s(self) -> float:
        """Median of the times [s]."""
        return float(np.median([one.time_s for one in self.rehearsals]))

    @property
    def speed(self) -> float:
        """Median of the parts' speeds [m/s]; not less than 0."""
        return max(float(np.median([one.speed for one in self.rehearsals])), 0.0)

    @property
    def share(self) -> Share:
        """Median of what is used of the limits."""
        return Share(*np.median([one.share for one in self.rehearsals], axis=0))


def judge_task(rig: Rig, scenario: Scenario, rehearsals: int = REHEARSALS) -> Verdict:
    """Rehearse a task from several starts.

    Raises
    ------
    PlateError
        If the scenario does not fit on the plate.
    """
    done = tuple(rehearse(rig, scenario, seed) for seed in range(rehearsals))
    return Verdict(done, scenario.time_limit_s)


class Predicted:
    """A `Scene` of the solver's cycle map: parts at rest at first, seen as they are.

    Parameters
    ----------
    scenario : Scenario
    rig : Rig
    seed : int
        Scatters parts, and makes friction uneven.

    Raises
    ------
    PlateError
        If the scenario does not fit on the plate.
    """

    def __init__(self, scenario: Scenario, rig: Rig, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.state = WorldState.of_scenario(scenario, rig, rng)
        spread = np.clip(rng.standard_normal(len(self.state.ids)), -2, 2)
        self._friction = (1 + UNEVEN * spread) * rig.friction.accel
        self._half = rig.plate.half

    def shots(self, begin: float) -> Iterator[Shot]:
        """Return no images of a camera that runs free."""
        return iter(())

    def capture(self, age: float | None = None) -> np.ndarray:
        """Return an empty image."""
        return NOTHING_SEEN

    def see(self, image: np.ndarray, stamp: float, expected: Prediction | None) -> Parts:
        """Return the parts that are on the plate."""
        state = self.state.take(self.state.on_plate)
        return Parts.make(state.ids, state.position, angle=state.angle)

    def run(self, motion: PlateCycle | PlateMotion) -> None:
        """Let parts slide; each as if it were a point, and alone."""
        state = self.state
        position, velocity = after(motion, state.position, state.velocity, self._friction)
        on_plate = state.on_plate & np.all(np.abs(position) <= self._half, axis=1)
        self.state = replace(state, position=position, velocity=velocity, on_plate=on_plate)


def rehearse(rig: Rig, scenario: Scenario, seed: int) -> Rehearsal:
    """Rehearse a task once, by Method B; the seed scatters parts and makes friction uneven.

    Raises
    ------
    PlateError
        If the scenario does not fit on the plate, or is not rehearsed: angles, moving, feeding.
    """
    if not isinstance(scenario.task, REHEARSED):
        raise PlateError("tasks of angles, and of targets that may change, are not rehearsed")
    setup = Setup(replace(scenario, time_limit_s=ENDLESS_S), seed, image_age_s=0.0)
    moments = list(islice(run(setup, rig, scene=Predicted(scenario, rig, seed)), MOST_CYCLES))
    told = [moment.progress for moment in moments]
    last = told[-1]
    left = np.array([progress.to_go_m for progress in told])
    times = np.array([progress.time_s for progress in told])
    begin = int(np.argmax(left))
    left, times, first = left[begin:], times[begin:], told[begin]
    # Following, the longest way is told; else the sum of all.
    going = 1 if isinstance(scenario.task, FollowTask) else first.parts_total - first.parts_sorted
    half = int(np.argmax(left <= left[0] / 2)) if np.any(left <= left[0] / 2) else -1
    speed = (left[0] - left[half]) / max(going, 1) / max(times[half] - times[0], IDLE_S)
    time = last.time_s
    if last.phase is not Phase.DONE:
        middle = len(left) // 2
        rate = (left[middle] - left[-1]) / max(time - times[middle], IDLE_S)
        fails = last.phase.is_failure or (left[-1] > 0 and rate <= max(going, 1) * STILL)
        hold_s = 0.0 if isinstance(scenario.task, FollowTask) else scenario.task.hold_s
        time += np.inf if fails else hold_s + left[-1] / max(rate, STILL)
    shares = [share_of(rig, moment.answer.cycle) for moment in moments]
    lost = last.phase is Phase.LOST
    return Rehearsal(float(time), float(speed), lost, Share(*np.median(shares, axis=0)))


def share_of(rig: Rig, cycle: PlateCycle) -> Share:
    """Return what a motion uses of the rig's limits."""
    used, limits = usage(rig, cycle), rig.limits
    return Share(
        used.stroke_m / limits.stroke_m,
        used.speed / limits.speed,
        used.accel / limits.accel,
        used.force / limits.force,
        float(np.sqrt(np.max(used.thermal_load))),
    )
