"""Where parts and plate were a little while ago: what a camera with latency shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..plate import PlateMotion
from .bodies import BodyTrajectory


@dataclass(frozen=True)
class Passage:
    """One cycle gone by.

    Attributes
    ----------
    motion : PlateMotion
        Of the plate.
    run : BodyTrajectory
        Of the parts, from the cycle's start to its end.
    on_plate : (M,)
        Which parts were there when it ended.
    """

    motion: PlateMotion
    run: BodyTrajectory
    on_plate: np.ndarray


@dataclass(frozen=True)
class View:
    """Parts and plate at one instant, in plate_home.

    Attributes
    ----------
    position : (M, 2)
        [m].
    angle : (M,)
        [rad].
    on_plate : (M,)
        Which parts were there.
    pose : (3,)
        Of the plate [m, m, rad].
    """

    position: np.ndarray
    angle: np.ndarray
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
        run = passage.run
        position, velocity = _between(run.time, run.position, run.velocity, inside)
        angle, spin = _between(run.time, run.angle, run.spin, inside)
        pose, twist = passage.motion.pose(inside)[0], passage.motion.twist(inside)[0]
        # A part that falls off stays where it did: from then on it is at its last place.
        left = ~passage.on_plate & np.all(position == run.position[-1], axis=1)
        return View(
            position + beyond * velocity, angle + beyond * spin, ~left, pose + beyond * twist
        )


def _between(
    time: np.ndarray, place: np.ndarray, rate: np.ndarray, t: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return places and rates (M, ...) at t [s]: between two samples the rate is linear."""
    k = int(np.clip(np.searchsorted(time, t, "right") - 1, 0, len(time) - 2))
    h = time[k + 1] - time[k]
    share = (t - time[k]) / h
    start, end = rate[k], rate[k + 1]
    # The line between both places, and the bow that the change of the rate gives
    line = place[k] + share * (place[k + 1] - place[k])
    return line - 0.5 * h * share * (1 - share) * (end - start), start + share * (end - start)
