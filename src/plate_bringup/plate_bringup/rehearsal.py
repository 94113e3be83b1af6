"""Rehearsal of a task by prediction, to find out whether a rig can perform it.

A rehearsal runs the loop with the real planner and solver and the rig's limits. The solver's cycle
map replaces plate and camera: parts are observed without error, the friction coefficient differs
from part to part, and parts never collide. The results are the predicted time and speed, and the
used fractions of the rig's limits.
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
"""Number of rehearsals of a task, each with other random start positions."""

MAX_CYCLES = 150
"""Maximum number of cycles per rehearsal. The time for the rest is extrapolated from the speed in
the second half."""

UNEVEN = 0.1
"""Standard deviation of the parts' friction, relative to that of the rig [-]."""

STILL = 0.5e-3
"""Speed of approach below which parts count as not approaching their targets [m/s]."""

REHEARSED = SortTask, FollowTask, AssembleTask
"""Kinds of tasks in which parts can be modelled as points."""

ENDLESS_S = 1e5
"""Time limit of a rehearsal [s]. It is long, because the rehearsal determines the required time."""

NOTHING_SEEN = np.zeros((0, 0))
"""Image of a scene without a camera."""


class Share(NamedTuple):
    """Used fractions of the rig's limits, as medians over the cycles [-]."""

    stroke: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    force: float = 0.0
    heat: float = 0.0

    @property
    def binds(self) -> str:
        """Name of the limit with the largest used fraction."""
        return self._fields[int(np.argmax(self))]


@dataclass(frozen=True)
class Rehearsal:
    """Result of one rehearsal.

    Attributes
    ----------
    time_s : float
        Time until the task succeeded, extrapolated if it was not finished after `MAX_CYCLES` [s].
        Infinite if it failed or if the parts did not approach their targets.
    speed : float
        Mean speed of the parts until the remaining distance was halved [m/s].
    lost : bool
        Whether a part left the plate.
    share : Share
        Used fractions of the rig's limits.
    """

    time_s: float
    speed: float
    lost: bool
    share: Share


class Verdict(NamedTuple):
    """Rehearsals of a task from several starts, and its time limit [s]."""

    rehearsals: tuple[Rehearsal, ...]
    time_limit_s: float

    @property
    def in_time(self) -> int:
        """Number of rehearsals that succeeded within the time limit without losing a part."""
        return sum(one.time_s <= self.time_limit_s and not one.lost for one in self.rehearsals)

    @property
    def likely(self) -> bool:
        """Whether more than half of the rehearsals succeeded in time."""
        return 2 * self.in_time > len(self.rehearsals)

    @property
    def time_s(self) -> float:
        """Median of the times [s]."""
        return float(np.median([one.time_s for one in self.rehearsals]))

    @property
    def speed(self) -> float:
        """Median of the parts' speeds, at least 0 [m/s]."""
        return max(float(np.median([one.speed for one in self.rehearsals])), 0.0)

    @property
    def share(self) -> Share:
        """Medians of the used fractions of the limits."""
        return Share(*np.median([one.share for one in self.rehearsals], axis=0))


def judge_task(rig: Rig, scenario: Scenario, rehearsals: int = REHEARSALS) -> Verdict:
    """Rehearse a task from several starts.

    Raises
    ------
    PlateError
        If the scenario is impossible on this rig.
    """
    done = tuple(rehearse(rig, scenario, seed) for seed in range(rehearsals))
    return Verdict(done, scenario.time_limit_s)


class Predicted:
    """A `Scene` that moves parts by the solver's cycle map. Parts start at rest and are observed
    without error.

    Parameters
    ----------
    scenario : Scenario
    rig : Rig
    seed : int
        Random seed of the start positions and of the parts' friction.

    Raises
    ------
    PlateError
        If the scenario is impossible on this rig.
    """

    def __init__(self, scenario: Scenario, rig: Rig, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.state = WorldState.of_scenario(scenario, rig, rng)
        spread = np.clip(rng.standard_normal(len(self.state.ids)), -2, 2)
        self._friction = (1 + UNEVEN * spread) * rig.friction.accel
        self._half = rig.plate.half

    def shots(self, begin: float) -> Iterator[Shot]:
        """Return no images, since there is no free-running camera."""
        return iter(())

    def capture(self, age: float | None = None) -> np.ndarray:
        """Return an empty image."""
        return NOTHING_SEEN

    def see(self, image: np.ndarray, stamp: float, expected: Prediction | None) -> Parts:
        """Return the true parts on the plate."""
        state = self.state.take(self.state.on_plate)
        return Parts.make(state.ids, state.position, angle=state.angle)

    def run(self, motion: PlateCycle | PlateMotion) -> None:
        """Move the parts by the cycle map. Parts are points and do not collide."""
        state = self.state
        position, velocity = after(motion, state.position, state.velocity, self._friction)
        on_plate = state.on_plate & np.all(np.abs(position) <= self._half, axis=1)
        self.state = replace(state, position=position, velocity=velocity, on_plate=on_plate)


def rehearse(rig: Rig, scenario: Scenario, seed: int) -> Rehearsal:
    """Rehearse a task once by Method B. The seed determines start positions and friction.

    Raises
    ------
    PlateError
        If the scenario is impossible on this rig, or its kind of task (pose, move, feed) cannot be
        rehearsed.
    """
    if not isinstance(scenario.task, REHEARSED):
        raise PlateError("tasks of kind pose, move and feed are not rehearsed")
    setup = Setup(replace(scenario, time_limit_s=ENDLESS_S), seed, image_age_s=0.0)
    moments = list(islice(run(setup, rig, scene=Predicted(scenario, rig, seed)), MAX_CYCLES))
    progresses = [moment.progress for moment in moments]
    last = progresses[-1]
    left = np.array([progress.to_go_m for progress in progresses])
    times = np.array([progress.time_s for progress in progresses])
    begin = int(np.argmax(left))
    left, times, first = left[begin:], times[begin:], progresses[begin]
    # A follow task reports the largest remaining distance, other tasks the sum over all parts.
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
    """Return the fractions of the rig's limits that a motion uses."""
    used, limits = usage(rig, cycle), rig.limits
    return Share(
        used.stroke_m / limits.stroke_m,
        used.speed / limits.speed,
        used.accel / limits.accel,
        used.force / limits.force,
        float(np.sqrt(np.max(used.thermal_load))),
    )
