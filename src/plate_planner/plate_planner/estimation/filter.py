"""Where the parts are, how fast, and how slippery: a Kalman filter on the stick-slip motion.

A camera that fires once per cycle sees places only, and may show them late. The filter's motion
model is what the plate did: from image to image every part is propagated by the very cycles that
ran, so an image of the middle of a cycle is compared with the middle of a cycle. What a part does
unlike the model tells its friction. State of a part: x, y [m], vx, vy [m/s] in plate_home, and the
logarithm of its friction over the rig's. Parts do not influence each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np

from plate_core import Parts, PlateCycle
from plate_core.kernels import kernel

from .cycle_log import CycleLog

STEP_S = 0.25e-3
"""Step of the motion model [s]: its error over a cycle is below the camera's noise."""

DIFFERENCE = np.array([1e-4, 1e-4, 5e-3, 5e-3, 0.03])
"""Differences by which the motion is differentiated [m, m, m/s, m/s, -]: as large as what is
uncertain, for the motion bends where parts stick."""

CAMERA_M = 0.02e-3
"""Error of a place that is seen [m]: the camera's noise, and what motion blur adds."""

PROCESS_NOISE = np.array([0.02e-3, 0.02e-3, 5e-3, 5e-3, 0.01])
"""What the model misses in a cycle (as DIFFERENCE): friction that is uneven under the part, finite
steps, a plate that does not quite do as asked."""

FIRST_SEEN = np.array([0.02e-3, 0.02e-3, 0.02, 0.02, 0.15])
"""Standard deviations of a part seen for the first time (as DIFFERENCE)."""

PUSHED_SIGMA = 6.0
"""A part this many standard deviations from its prediction was pushed by something that the model
does not know: it is taken to be where it is seen, at any speed."""

OUTLIER_M = 5e-3
"""A larger distance of a part from its prediction counts as this [m]."""

FRICTION_RANGE = np.log(3.0)
"""Friction is looked for between a third and three times the rig's [log]."""

SAMPLES = np.vstack([np.zeros(5), np.diag(DIFFERENCE)])
"""The state and its neighbours, (6, 5)."""


@dataclass(frozen=True)
class StateEstimate:
    """What is known of the parts when the last image was taken.

    Attributes
    ----------
    ids : tuple of str
    time : float
        When that was [s, the time of the stamps].
    mean : (M, 5)
    covariance : (M, 5, 5)
    drift : (M, 2)
        As it was seen last [m/s].
    unseen : (M,)
        Images in a row that do not show the part.
    square_error : float
        Squared distances of parts from their predictions in the last image, summed [m2].
    """

    ids: tuple[str, ...] = ()
    time: float = -np.inf
    mean: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 5, 5)))
    drift: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    unseen: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    square_error: float = 0.0

    @property
    def friction(self) -> np.ndarray:
        """Friction of each part (M,) over the rig's."""
        return np.exp(self.mean[:, 4])

    def predict(self, log: CycleLog, t: float, friction_accel: float) -> np.ndarray:
        """Return where the parts are (M, 2) [m] at a later time t [s]."""
        return propagate(log, self.mean, self.time, t, friction_accel)[:, :2]

    def update(
        self, log: CycleLog, parts: Parts, time: float, friction_accel: float, most: int
    ) -> StateEstimate:
        """Take in the parts of an image taken at `time` [s].

        A part that is not seen is propagated for `most` images.
        """
        if time < self.time:
            return StateEstimate().update(log, parts, time, friction_accel, most)
        now = self._propagated(log, time, friction_accel)._without(most)
        row = {name: i for i, name in enumerate(now.ids)}
        old = [i for i, name in enumerate(parts.ids) if name in row]
        new = [i for i, name in enumerate(parts.ids) if name not in row]
        rows = np.array([row[parts.ids[i]] for i in old], int)
        mean, covariance, drift = now.mean.copy(), now.covariance.copy(), now.drift.copy()
        unseen = now.unseen + 1
        gap = parts.position[old] - mean[rows, :2]
        mean[rows], covariance[rows] = kalman_update(
            mean[rows], covariance[rows], parts.position[old]
        )
        drift[rows], unseen[rows] = parts.velocity[old], 0
        first = np.hstack([parts.position[new], np.zeros((len(new), 3))])
        return StateEstimate(
            (*now.ids, *(parts.ids[i] for i in new)),
            time,
            np.vstack([mean, first]),
            np.concatenate([covariance, np.tile(np.diag(FIRST_SEEN**2), (len(new), 1, 1))]),
            np.vstack([drift, parts.velocity[new]]),
            np.append(unseen, np.zeros(len(new), int)),
            float(np.sum(np.minimum(np.sum(gap**2, axis=1), OUTLIER_M**2))),
        )

    def moved_to(self, log: CycleLog, time: float, friction_accel: float) -> StateEstimate:
        """Return the same places at another time [s], with the velocities of that time."""
        mean = self.mean.copy()
        mean[:, 2:] = propagate(log, mean, self.time, time, friction_accel)[:, 2:]
        return replace(self, time=time, mean=mean)

    def _propagated(self, log: CycleLog, time: float, friction_accel: float) -> StateEstimate:
        """Return the estimate at a later time [s], before the image of that time."""
        if not len(self.ids):
            return replace(self, time=time)
        cloud = (self.mean[:, None] + SAMPLES).reshape(-1, 5)
        cloud = propagate(log, cloud, self.time, time, friction_accel).reshape(-1, 6, 5)
        slope = ((cloud[:, 1:] - cloud[:, :1]) / DIFFERENCE[:, None]).transpose(0, 2, 1)
        covariance = slope @ self.covariance @ slope.transpose(0, 2, 1)
        covariance += np.diag(PROCESS_NOISE**2)
        return replace(self, time=time, mean=cloud[:, 0], covariance=covariance)

    def _without(self, most: int) -> StateEstimate:
        """Leave out parts that the last `most` images did not show."""
        keep = self.unseen < most
        if np.all(keep):
            return self
        return StateEstimate(
            tuple(name for name, k in zip(self.ids, keep, strict=True) if k), self.time,
            self.mean[keep], self.covariance[keep], self.drift[keep], self.unseen[keep],
        )  # fmt: skip


def kalman_update(
    mean: np.ndarray, covariance: np.ndarray, seen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (K, 5) and covariance (K, 5, 5) after places (K, 2) [m] were seen."""
    innovation = seen - mean[:, :2]
    inverse = np.linalg.inv(covariance[:, :2, :2] + CAMERA_M**2 * np.eye(2))
    gain = covariance[:, :, :2] @ inverse
    square = np.einsum("ki,kij,kj->k", innovation, inverse, innovation)
    after = mean + np.einsum("kij,kj->ki", gain, innovation)
    after[:, 4] = np.clip(after[:, 4], -FRICTION_RANGE, FRICTION_RANGE)
    left = covariance - gain @ covariance[:, :2]
    pushed = square > PUSHED_SIGMA**2
    after[pushed, 2:] = mean[pushed, 2:]
    after[pushed, :2] = seen[pushed]
    left[pushed] = np.diag(FIRST_SEEN**2)
    left[pushed, 4, 4] = covariance[pushed, 4, 4]
    return after, (left + left.transpose(0, 2, 1)) / 2


def propagate(
    log: CycleLog, state: np.ndarray, begin: float, end: float, friction_accel: float
) -> np.ndarray:
    """Return states (K, 5) at `end` that were such at `begin` [s], by the cycles that ran."""
    state = state.copy()
    bound = friction_accel * np.exp(state[:, 4])
    for cycle, a, b in log.between(begin, end):
        pose, twist, dt = _sampled(cycle, a, b)
        _stick_slip(state, bound, pose, twist, dt)
    return state


def _sampled(cycle: PlateCycle, a: float, b: float) -> tuple[np.ndarray, np.ndarray, float]:
    steps = max(1, round((b - a) / STEP_S))
    dt = (b - a) / steps
    t = a + (np.arange(steps) + 0.5) * dt
    return cycle.pose(t), cycle.twist(t), dt


@kernel(error_model="numpy")
def _stick_slip(
    state: np.ndarray, bound: np.ndarray, pose: np.ndarray, twist: np.ndarray, dt: float
) -> None:
    """Propagate states (K, 5), in place, through a sampled motion: the implicit Coulomb step.

    `bound` (K,) is mu g [m/s2], not 0; pose and twist (n, 3) are the plate's at the middles of n
    steps. States side by side within a step: the processor takes several at once, 10 to 20 times
    as fast as one after the other.
    """
    x, y, vx, vy = state[:, 0].copy(), state[:, 1].copy(), state[:, 2].copy(), state[:, 3].copy()
    most = bound * dt
    for k in range(len(twist)):
        along, across, turn = twist[k, 0], twist[k, 1], twist[k, 2]
        centre_x, centre_y = pose[k, 0], pose[k, 1]
        for i in range(len(x)):
            dx = along - turn * (y[i] - centre_y) - vx[i]
            dy = across + turn * (x[i] - centre_x) - vy[i]
            fraction = most[i] / max(sqrt(dx * dx + dy * dy), most[i])
            vx[i] += fraction * dx
            vy[i] += fraction * dy
            x[i] += dt * vx[i]
            y[i] += dt * vy[i]
    state[:, 0], state[:, 1], state[:, 2], state[:, 3] = x, y, vx, vy
