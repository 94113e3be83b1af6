"""Where parts and plate were a little while ago: what a camera with latency shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..friction import Trajectory
from ..plate import PlateMotion
from .bodies import BodyTrajectory


@dataclass(frozen=True)
class Passage:
    """One cycle gone by.

    Attributes
    ----------
    motion : PlateMotion
        Of the plate.
    run : Trajectory or BodyTrajectory
        Of the parts, from the cycle's start to its end.
    on_plate : (M,)
        Which parts were there when it ended.
    """

    motion: PlateMotion
    run: Trajectory | BodyTrajectory
    on_plate: np.ndarray


@dataclass(frozen=True)
class View:
    """Parts and plate at one instant, in plate_home.

    Attributes
    ----------
    position : (M, 2)
        [m].
    on_plate : (M,)
        Which parts were there.
    pose : (3,)
        Of the plate [m, m, rad].
    """

    position: np.ndarray
    on_plate: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class History:
    """The last cycles, oldest first; at least as much as was asked to be kept."""

    passages: tuple[Passage, ...] = ()

    def after(self, passage: Passage, keep: float) -> History:
        """Return the past one cycle later; what is more than `keep` [s] ago is forgotten."""
        kept: tuple[Passage, ...] = (passage,)
        age = passage.motion.period
        for older in reversed(self.passages):
            if age >= keep:
                break
            kept, age = (older, *kept), age + older.motion.period
        return History(kept)

    def ago(self, age: float) -> View:
        """Return what there was `age` [s] before the end of the last cycle.

        Before the first cycle that is kept all stood still; after the end of the last (age below
        0) all goes on as it then did. There must be one cycle at least.
        """
        first = self.passages[0]
        for passage in reversed(self.passages):
            if age <= passage.motion.period or passage is first:
                break
            age -= passage.motion.period
        t = passage.motion.period - age
        inside, beyond = min(max(t, 0.0), passage.motion.period), max(0.0, -age)
        position, velocity = _between(passage.run, inside)
        pose, twist = passage.motion.pose(inside)[0], passage.motion.twist(inside)[0]
        # A part that falls off stays where it did: from then on it is at its last place.
        left = ~passage.on_plate & np.all(position == passage.run.position[-1], axis=1)
        return View(position + beyond * velocity, ~left, pose + beyond * twist)


def _between(run: Trajectory | BodyTrajectory, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities (M, 2) at t [s]: between two samples velocity is linear."""
    k = int(np.clip(np.searchsorted(run.time, t, "right") - 1, 0, len(run.time) - 2))
    h = run.time[k + 1] - run.time[k]
    share = (t - run.time[k]) / h
    start, end = run.velocity[k], run.velocity[k + 1]
    # The line between both places, and the bow that the change of velocity gives
    line = run.position[k] + share * (run.position[k + 1] - run.position[k])
    return line - 0.5 * h * share * (1 - share) * (end - start), start + share * (end - start)
