"""Recent motion of parts and plate. A camera with latency needs these data, because its images show
an earlier time.

`History` stores the motions of the last cycles. `History.ago` interpolates the positions and angles
of the parts and the pose of the plate at an earlier time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..plate import PlateMotion
from .bodies import BodyTrajectory


@dataclass(frozen=True)
class Passage:
    """A past cycle.

    Attributes
    ----------
    motion : PlateMotion
        Motion of the plate.
    run : BodyTrajectory
        Motion of the parts during the cycle.
    on_plate : (M,)
        Whether each part was on the plate at the end of the cycle.
    """

    motion: PlateMotion
    run: BodyTrajectory
    on_plate: np.ndarray


@dataclass(frozen=True)
class View:
    """States of the parts and of the plate at one time, in plate_home.

    Attributes
    ----------
    position : (M, 2)
        Positions of the parts [m].
    angle : (M,)
        Angles of the parts [rad].
    on_plate : (M,)
        Whether each part was on the plate.
    pose : (3,)
        Pose of the plate [m, m, rad].
    """

    position: np.ndarray
    angle: np.ndarray
    on_plate: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class History:
    """Motions of the last cycles, oldest first."""

    passages: tuple[Passage, ...] = ()

    def after(self, passage: Passage, keep: float) -> History:
        """Return the history after one more cycle. Cycles that ended more than `keep` [s] before
        are removed."""
        kept: tuple[Passage, ...] = (passage,)
        age = passage.motion.period
        for older in reversed(self.passages):
            if age >= keep:
                break
            kept, age = (older, *kept), age + older.motion.period
        return History(kept)

    def take(self, rows: np.ndarray) -> History:
        """Return the history of those parts for which the mask `rows` (M,) is True."""
        return History(
            tuple(
                Passage(
                    passage.motion,
                    replace(
                        passage.run, position=passage.run.position[:, rows],
                        velocity=passage.run.velocity[:, rows], angle=passage.run.angle[:, rows],
                        spin=passage.run.spin[:, rows], on_plate=passage.run.on_plate[rows],
                    ),
                    passage.on_plate[rows],
                )
                for passage in self.passages
            )
        )  # fmt: skip

    def joined(self, position: np.ndarray) -> History:
        """Return the history with one more part at the position `position` (2,) [m]. In all past
        cycles, this part was not on the plate."""

        def append_part(values: np.ndarray, value: np.ndarray | float) -> np.ndarray:
            new = np.broadcast_to(value, (len(values), 1, *values.shape[2:]))
            return np.concatenate([values, new], axis=1)

        return History(
            tuple(
                Passage(
                    passage.motion,
                    replace(
                        passage.run, position=append_part(passage.run.position, position),
                        velocity=append_part(passage.run.velocity, 0.0),
                        angle=append_part(passage.run.angle, 0.0),
                        spin=append_part(passage.run.spin, 0.0),
                        on_plate=np.append(passage.run.on_plate, False),
                    ),
                    np.append(passage.on_plate, False),
                )
                for passage in self.passages
            )
        )  # fmt: skip

    def shows(self, count: int) -> np.ndarray:
        """Return for each of the `count` parts whether it was on the plate at the end of any cycle
        in the history."""
        return np.any(
            [np.zeros(count, bool), *(passage.on_plate for passage in self.passages)], axis=0
        )

    def ago(self, age: float) -> View:
        """Return the states of parts and plate at the time `age` [s] before the end of the last
        cycle.

        Before the first cycle in the history, parts and plate are assumed to be at rest. If `age`
        is below 0, parts and plate are assumed to continue with their last velocities. The history
        must contain at least one cycle.
        """
        first = self.passages[0]
        for passage in reversed(self.passages):
            if age <= passage.motion.period or passage is first:
                break
            age -= passage.motion.period
        t = passage.motion.period - age
        inside, beyond = min(max(t, 0.0), passage.motion.period), max(0.0, -age)
        run = passage.run
        position, velocity = _interpolate(run.time, run.position, run.velocity, inside)
        angle, spin = _interpolate(run.time, run.angle, run.spin, inside)
        pose, twist = passage.motion.pose(inside)[0], passage.motion.twist(inside)[0]
        # In the samples, a part that left the plate stays at the position where it left the plate.
        # The part left at the time of the first sample with this position.
        left = ~passage.on_plate & np.all(position == run.position[-1], axis=1)
        return View(
            position + beyond * velocity, angle + beyond * spin, ~left, pose + beyond * twist
        )


def _interpolate(
    time: np.ndarray, position: np.ndarray, rate: np.ndarray, t: float
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate positions and velocities of samples. Return both (M, ...) at the time t [s].

    Between two samples 0 and 1, the velocity v is a linear function of time: v = v_0 + u (v_1 -
    v_0), with u from 0 to 1. Let h be the interval between the samples. The position is x = x_0 + u
    (x_1 - x_0) - h u (1 - u) (v_1 - v_0)/2.
    """
    k = int(np.clip(np.searchsorted(time, t, "right") - 1, 0, len(time) - 2))
    h = time[k + 1] - time[k]
    fraction = (t - time[k]) / h
    start, end = rate[k], rate[k + 1]
    line = position[k] + fraction * (position[k + 1] - position[k])
    return line - 0.5 * h * fraction * (1 - fraction) * (end - start), start + fraction * (
        end - start
    )
