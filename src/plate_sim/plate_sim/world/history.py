"""Where parts and plate were a little while ago: what a camera with latency shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    def take(self, rows: np.ndarray) -> History:
        """Return the past of the parts in these rows (M,), bool."""
        return History(
            tuple(
                Passage(
                    each.motion,
                    replace(
                        each.run, position=each.run.position[:, rows],
                        velocity=each.run.velocity[:, rows], angle=each.run.angle[:, rows],
                        spin=each.run.spin[:, rows], on_plate=each.run.on_plate[rows],
                    ),
                    each.on_plate[rows],
                )
                for each in self.passages
            )
        )  # fmt: skip

    def joined(self, position: np.ndarray) -> History:
        """Return the same past with a part more at a place (2,) [m]: it was not there yet."""

        def beside(values: np.ndarray, value: np.ndarray | float) -> np.ndarray:
            new = np.broadcast_to(value, (len(values), 1, *values.shape[2:]))
            return np.concatenate([values, new], axis=1)

        return History(
            tuple(
                Passage(
                    each.motion,
                    replace(
                        each.run, position=beside(each.run.position, position),
                        velocity=beside(each.run.velocity, 0.0), angle=beside(each.run.angle, 0.0),
                        spin=beside(each.run.spin, 0.0),
                        on_plate=np.append(each.run.on_plate, False),
                    ),
                    np.append(each.on_plate, False),
                )
                for each in self.passages
            )
        )  # fmt: skip

    def shows(self, count: int) -> np.ndarray:
        """Whether each of M parts was there at the end of a cycle that is kept (M,)."""
        return np.any([np.zeros(count, bool), *(each.on_plate for each in self.passages)], axis=0)

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
