"""Rehearsal of a task, which predicts whether a rig can perform it.

A rehearsal runs the loop with planner, solver and the limits of the rig. The cycle map of the
solver replaces the plate and the camera. The positions of the parts are known without error, the
parts never collide, and their friction coefficients differ. The result contains the predicted time
and speed, and the used fractions of the limits of the rig.
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

__all__ = ["REHEARSALS", "STILL", "LimitUse", "Rehearsal", "Verdict", "rehearse", "rehearse_task"]

REHEARSALS = 3
"""Number of rehearsals of a task. Each rehearsal has different random start positions."""

MAX_CYCLES = 150
"""Maximum number of cycles of a rehearsal. If the task is not done after this number, the remaining
time is extrapolated from the speed in the second half of the rehearsal."""

UNEVEN = 0.1
"""Relative standard deviation of the parts' friction."""

STILL = 0.5e-3
"""Mean speed at which the parts must approach their targets [m/s]. A rehearsal counts as failed if
the task is not done at its end and the parts were slower in its second half."""

REHEARSED = SortTask, FollowTask, AssembleTask
"""Kinds of tasks in which parts can be modelled as points."""

ENDLESS_S = 1e5
"""Time limit of the task in a rehearsal [s]. This limit is long, because the rehearsal measures the
time that the task needs."""

NOTHING_SEEN = np.zeros((0, 0))
"""Empty image, which `Predicted` returns because it has no camera."""


class LimitUse(NamedTuple):
    """Used fractions of the limits of the rig (medians over the cycles)."""

    stroke: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    force: float = 0.0
    heat: float = 0.0

    @property
    def binding_limit(self) -> str:
        """Name of the limit with the largest used fraction."""
        return self._fields[int(np.argmax(self))]


@dataclass(frozen=True)
class Rehearsal:
    """Result of one rehearsal.

    Attributes
    ----------
    time_s : float
        Time until the task succeeded [s]. If the task was not done after `MAX_CYCLES`, the time is
        extrapolated. If the task failed, or if the parts did not approach their targets, the time
        is infinite.
    speed : float
        Mean speed of the parts until half of the distance remained [m/s].
    lost : bool
        Whether a part left the plate.
    limit_use : LimitUse
        Used fractions of the limits of the rig.
    """

    time_s: float
    speed: float
    lost: bool
    limit_use: LimitUse


class Verdict(NamedTuple):
    """Rehearsals of a task from several start positions, and the time limit of the task [s]."""

    rehearsals: tuple[Rehearsal, ...]
    time_limit_s: float

    @property
    def in_time(self) -> int:
        """Number of rehearsals that succeeded within the time limit and lost no part."""
        return sum(
            rehearsal.time_s <= self.time_limit_s and not rehearsal.lost
            for rehearsal in self.rehearsals
        )

    @property
    def likely(self) -> bool:
        """Whether more than half of the rehearsals succeeded in time."""
        return 2 * self.in_time > len(self.rehearsals)

    @property
    def time_s(self) -> float:
        """Median of the times [s]."""
        return float(np.median([rehearsal.time_s for rehearsal in self.rehearsals]))

    @property
    def speed(self) -> float:
        """Median of the parts' speeds, at least 0 [m/s]."""
        return max(float(np.median([rehearsal.speed for rehearsal in self.rehearsals])), 0.0)

    @property
    def limit_use(self) -> LimitUse:
        """Medians of the used fractions of the limits."""
        return LimitUse(*np.median([rehearsal.limit_use for rehearsal in self.rehearsals], axis=0))


def rehearse_task(rig: Rig, scenario: Scenario, rehearsals: int = REHEARSALS) -> Verdict:
    """Rehearse a task from several start positions.

    Raises
    ------
    PlateError
        If the scenario is impossible on this rig.
    """
    done = tuple(rehearse(rig, scenario, seed) for seed in range(rehearsals))
    return Verdict(done, scenario.time_limit_s)


class Predicted:
    """Simplified `Scene`. The cycle map of the solver computes the motion of the parts. The parts
    start at rest. The planner gets the exact positions of the parts.

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
        """Return no images, because there is no free-running camera."""
        return iter(())

    def capture(self, age: float | None = None) -> np.ndarray:
        """Return an empty image."""
        return NOTHING_SEEN

    def see(self, image: np.ndarray, stamp: float, expected: Prediction | None) -> Parts:
        """Return the true parts on the plate."""
        state = self.state.take(self.state.on_plate)
        return Parts.make(state.ids, state.position, angle=state.angle)

    def run(self, motion: PlateCycle | PlateMotion) -> None:
        """Compute the new positions and velocities of the parts with the cycle map. The parts are
        points that do not collide."""
        state = self.state
        position, velocity = after(motion, state.position, state.velocity, self._friction)
        on_plate = state.on_plate & np.all(np.abs(position) <= self._half, axis=1)
        self.state = replace(state, position=position, velocity=velocity, on_plate=on_plate)


def rehearse(rig: Rig, scenario: Scenario, seed: int) -> Rehearsal:
    """Rehearse a task once with Method B. The seed determines the start positions and the friction
    of the parts.

    Raises
    ------
    PlateError
        If the scenario is impossible on this rig, or if its kind of task cannot be rehearsed (pose,
        move, feed).
    """
    if not isinstance(scenario.task, REHEARSED):
        raise PlateError("tasks of kind pose, move and feed cannot be rehearsed")
    setup = Setup(replace(scenario, time_limit_s=ENDLESS_S), seed, image_age_s=0.0)
    moments = list(islice(run(setup, rig, scene=Predicted(scenario, rig, seed)), MAX_CYCLES))
    progresses = [moment.progress for moment in moments]
    last = progresses[-1]
    left = np.array([progress.to_go_m for progress in progresses])
    times = np.array([progress.time_s for progress in progresses])
    begin = int(np.argmax(left))
    left, times, first = left[begin:], times[begin:], progresses[begin]
    # A follow task reports only the longest remaining path length. Other tasks report the sum of
    # the remaining distances of all parts.
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
    uses = [limit_use_of(rig, moment.result.cycle) for moment in moments]
    lost = last.phase is Phase.LOST
    return Rehearsal(float(time), float(speed), lost, LimitUse(*np.median(uses, axis=0)))


def limit_use_of(rig: Rig, cycle: PlateCycle) -> LimitUse:
    """Return the fractions of the rig's limits that a cycle uses."""
    used, limits = usage(rig, cycle), rig.limits
    return LimitUse(
        used.stroke_m / limits.stroke_m,
        used.speed / limits.speed,
        used.accel / limits.accel,
        used.force / limits.force,
        float(np.sqrt(np.max(used.thermal_load))),
    )
