"""Kalman filters that estimate position, velocity and friction of each part. Their motion model is
the stick-slip motion of a part on the plate.

A camera measures only positions. The camera may take an image at any time in a cycle, and it
delivers the image with a latency. Between images, the motion model computes how the executed cycles
move each part. The friction of a part is estimated from the differences between the images and the
model. The state of a part has five components: x, y [m], vx, vy [m/s] in plate_home, and log(f). f
is the friction coefficient of the part divided by the friction coefficient in the rig file. Each
part has a separate filter, but an error in the stamp of an image affects all parts.

All computations are done for A hypotheses of the image latency at the same time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from plate_core import UNKNOWN, Parts, PlateCycle, part_class

from .. import _kernels
from .cycle_log import CycleLog

STEP_S = 0.25e-3
"""Time step of the motion model [s]. With this step, the error of the model after one cycle is
below the noise of the camera."""

DIFFERENCE = np.array([1e-4, 1e-4, 5e-3, 5e-3, 0.03])
"""Step sizes of the finite differences of the motion model [m, m, m/s, m/s, -]. The step sizes are
about as large as the uncertainty of the state, because the derivatives of the model jump where
parts begin to stick."""

CAMERA_M = 0.02e-3
"""Standard deviation of a measured position [m]. Camera noise and motion blur cause this
deviation."""

PROCESS_NOISE = np.array([0.02e-3, 0.02e-3, 2e-3, 2e-3, 0.01])
"""Standard deviations of the model error per cycle, with the units of DIFFERENCE. The causes of the
error are uneven friction, finite time steps, and deviations of the plate's motion."""

FIRST_SEEN = np.array([0.02e-3, 0.02e-3, 0.02, 0.02, 0.15])
"""Standard deviations of the state of a part at its first detection, with the units of
DIFFERENCE."""

PUSHED_SIGMA = 6.0
"""If a part is farther from its predicted position than this number of standard deviations, it is
assumed that something else has pushed the part. In this case, the filter of the part is reset to
the measured position, with the initial covariance."""

FRICTION_RANGE = np.log(3.0)
"""Maximum difference between log(friction) of a part and log(friction) of its type. The estimated
friction is thus limited to 1/3 to 3 times the friction of the part's type."""

SAMPLES = np.vstack([np.zeros(5), np.diag(DIFFERENCE)])
"""Offsets (6, 5) that are added to a state to compute the finite differences. The first row is
zero, and each other row changes one component of the state."""


class Coast(NamedTuple):
    """Maximum number of consecutive images without a detection of an object. Up to this number, the
    state of the object is propagated. `parts` is the number for parts, and `unknown` is the number
    for objects of the class `unknown`."""

    parts: int
    unknown: int


@dataclass(frozen=True)
class StateEstimate:
    """State estimate of M parts for A latency hypotheses.

    Attributes
    ----------
    ids : tuple of str
    time : (A, M)
        Time at which each state is valid [s, in the time of the image stamps]. A state is valid at
        the time of the part's last detection.
    mean : (A, M, 5)
        Mean of each state. The top of the module describes the five components.
    covariance : (A, M, 5, 5)
        Covariance of each state.
    drift : (M, 2)
        Last drift that the detector measured [m/s].
    unseen : (M,)
        Number of consecutive last images without a detection of each part.
    start : float
        Start of the last cycle that the method `update` recorded [s]. NaN if it has recorded no
        cycle.
    start_mean : (A, M, 5)
        State of the parts, predicted for the time `start`.
    usual : (M,)
        log(f) of the parts' types. f is the friction coefficient of the type divided by the
        friction coefficient in the rig file.
    """

    ids: tuple[str, ...]
    time: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    drift: np.ndarray
    unseen: np.ndarray
    start: float
    start_mean: np.ndarray
    usual: np.ndarray

    @classmethod
    def nothing(cls, count: int) -> StateEstimate:
        """Return an estimate that contains no parts, for `count` hypotheses of the latency."""
        return cls(
            (), np.zeros((count, 0)), np.zeros((count, 0, 5)), np.zeros((count, 0, 5, 5)),
            np.zeros((0, 2)), np.zeros(0, int), np.nan, np.zeros((count, 0, 5)),
            np.zeros(0),
        )  # fmt: skip

    def of(self, hypotheses: np.ndarray | list[int]) -> StateEstimate:
        """Return the estimate for some of the hypotheses, which are selected by their indices."""
        return replace(
            self, time=self.time[hypotheses], mean=self.mean[hypotheses],
            covariance=self.covariance[hypotheses], start_mean=self.start_mean[hypotheses],
        )  # fmt: skip

    def at(self, hypothesis: int, log: CycleLog, t: float, friction_accel: float) -> np.ndarray:
        """Return the state of the parts (M, 5) at the time t [s], for one hypothesis of the
        latency.

        If a part was last detected after t, its state cannot be propagated back to t. In this case,
        the result for this part is `start_mean` if t is equal to `start`. Otherwise, it is the
        state at the last detection.
        """
        mean, time = self.mean[hypothesis], self.time[hypothesis]
        ahead = propagate(log, mean, time, np.maximum(time, t), friction_accel)
        before = self.start_mean[hypothesis] if t == self.start else mean
        return np.where((time > t)[:, None], before, ahead)

    def update(
        self,
        log: CycleLog,
        parts: Parts,
        time: np.ndarray,
        friction_accel: float,
        coast: Coast,
        jitter: float,
        friction: np.ndarray,
    ) -> tuple[StateEstimate, Innovations]:
        """Return the filters updated with the detected parts of an image.

        Parameters
        ----------
        log : CycleLog
        parts : Parts
            P parts that were detected in the image.
        time : (A, P)
            Time at which each part was exposed, for each hypothesis of the latency [s].
        friction_accel : float
            Friction coefficient of the rig multiplied by gravity, mu g [m/s2].
        coast : Coast
            Maximum numbers of consecutive images without a detection. If this number is reached for
            a part, the part is removed.
        jitter : float
            Standard deviation of the noise of the image stamps [s].
        friction : (P,)
            Initial friction coefficient of newly detected parts, divided by the friction
            coefficient in the rig file.

        Returns
        -------
        estimate : StateEstimate
        innovations : Innovations
            Prediction quality of each hypothesis for this image.
        """
        now = self._remove_unseen(coast)
        if log.known and log.begin != now.start:
            now = now._restart_at_cycle(log, friction_accel)
        row = {name: i for i, name in enumerate(now.ids)}
        old = [i for i, name in enumerate(parts.ids) if name in row]
        new = [i for i, name in enumerate(parts.ids) if name not in row]
        rows = np.array([row[parts.ids[i]] for i in old], int)
        position = parts.position
        mean, covariance = now._propagate(rows, log, time[:, old], friction_accel)
        mean, covariance, innovations = kalman_update(
            mean, covariance, position[old], jitter, now.usual[rows]
        )
        after = [now.mean.copy(), now.covariance.copy(), now.time.copy()]
        for values, piece in zip(after, (mean, covariance, time[:, old]), strict=True):
            values[:, rows] = piece
        drift, unseen = now.drift.copy(), now.unseen + 1
        drift[rows], unseen[rows] = parts.velocity[old], 0
        count = len(time)
        still = np.zeros((len(new), 2))
        first = np.hstack([position[new], still, np.log(friction[new, None])])
        first = np.tile(first, (count, 1, 1))
        wide = np.tile(np.diag(FIRST_SEEN**2), (count, len(new), 1, 1))
        estimate = StateEstimate(
            (*now.ids, *(parts.ids[i] for i in new)),
            np.hstack([after[2], time[:, new]]),
            np.concatenate([after[0], first], axis=1),
            np.concatenate([after[1], wide], axis=1),
            np.vstack([drift, parts.velocity[new]]),
            np.append(unseen, np.zeros(len(new), int)),
            now.start,
            np.concatenate([now.start_mean, first], axis=1),
            np.append(now.usual, np.log(friction[new])),
        )
        return estimate, innovations

    def moved(self, log: CycleLog, later: np.ndarray, friction_accel: float) -> StateEstimate:
        """Return the estimate with the times of all states increased by `later` (A,) [s].

        The positions stay the same, because they were measured. The velocities and the friction are
        propagated to the new times.
        """
        time = self.time + later[:, None]
        end = propagate(
            log, self.mean.reshape(-1, 5), self.time.ravel(), time.ravel(), friction_accel
        )
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[..., 2:] = end.reshape(mean.shape)[..., 2:]
        unsure = (friction_accel * later) ** 2
        covariance[..., 2, 2] += unsure[:, None]
        covariance[..., 3, 3] += unsure[:, None]
        return replace(self, time=time, mean=mean, covariance=covariance)

    def _restart_at_cycle(self, log: CycleLog, friction_accel: float) -> StateEstimate:
        """Return the estimate with `start` and `start_mean` set to the start of the last cycle and
        to the predicted state at this time."""
        begin = np.maximum(self.time, log.begin).ravel()
        mean = propagate(log, self.mean.reshape(-1, 5), self.time.ravel(), begin, friction_accel)
        return replace(self, start=log.begin, start_mean=mean.reshape(self.mean.shape))

    def _propagate(
        self, rows: np.ndarray, log: CycleLog, time: np.ndarray, friction_accel: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Propagate the states of the K parts `rows` to the times `time` (A, K) [s]. Return their
        means (A, K, 5) and covariances (A, K, 5, 5)."""
        mean, begin = self.mean[:, rows], self.time[:, rows]
        shape = (*begin.shape, 6, 5)
        cloud = (mean[:, :, None] + SAMPLES).reshape(-1, 5)
        end = np.maximum(begin, time)
        cloud = propagate(
            log, cloud, np.repeat(begin.ravel(), 6), np.repeat(end.ravel(), 6), friction_accel
        ).reshape(shape)
        slope = ((cloud[:, :, 1:] - cloud[:, :, :1]) / DIFFERENCE[:, None]).transpose(0, 1, 3, 2)
        covariance = slope @ self.covariance[:, rows] @ slope.transpose(0, 1, 3, 2)
        cycles = (end - begin) / log.period if log.known else np.ones_like(begin)
        covariance += cycles[:, :, None, None] * np.diag(PROCESS_NOISE**2)
        return cloud[:, :, 0], covariance

    def _remove_unseen(self, coast: Coast) -> StateEstimate:
        """Return the estimate without the parts that were not detected for at least `coast`
        consecutive images."""
        unknown = np.array([part_class(name) == UNKNOWN for name in self.ids], bool)
        keep = self.unseen < np.where(unknown, coast.unknown, coast.parts)
        if np.all(keep):
            return self
        return StateEstimate(
            tuple(name for name, k in zip(self.ids, keep, strict=True) if k),
            self.time[:, keep], self.mean[:, keep], self.covariance[:, keep], self.drift[keep],
            self.unseen[keep], self.start, self.start_mean[:, keep], self.usual[keep],
        )  # fmt: skip


@dataclass(frozen=True)
class Innovations:
    """Comparison of the predictions of A hypotheses with one image.

    Attributes
    ----------
    log_likelihood : (A,)
    lateness : (A,)
        Error of the assumed exposure time, estimated from this image only [s]. The error is
        positive if the exposure was later than assumed.
    square : (A,)
        Mean square of the normalised innovations. The expected value is 1.
    information : (A,)
        Reciprocal of the variance of `lateness` [1/s2]. 0 if the image contains no information
        about the exposure time.
    """

    log_likelihood: np.ndarray
    square: np.ndarray
    lateness: np.ndarray
    information: np.ndarray


def kalman_update(
    mean: np.ndarray,
    covariance: np.ndarray,
    seen: np.ndarray,
    jitter: float,
    of_type: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray, Innovations]:
    """Update the states of K parts with their measured positions `seen` (K, 2) [m]. Return the
    means (A, K, 5), the covariances (A, K, 5, 5), and the innovations of the predictions.

    `of_type` (K,) is log(f) of the parts' types, see `StateEstimate.usual`.

    The stamp of the image has an error T, which is the same for all parts. T is normally
    distributed with the standard deviation s = `jitter` [s]. Let v_i be the velocity of part i, P_i
    the covariance of its position, and r the standard deviation `CAMERA_M`. Let z_i be the
    innovation, that is, the measured position minus the predicted position. Then z_i = T v_i +
    noise. The noise has the covariance S_i = P_i + r^2 1, where 1 is the unit matrix. After the
    measurement, T has a normal distribution with

        variance q = s^2 / (1 + s^2 sum v_i' S_i^-1 v_i),    mean T = q sum v_i' S_i^-1 z_i,

    The update of the state of part i is gain_i (z_i - mean T v_i). The gain is C_i S_i^-1, where
    C_i contains the covariances of the state with the position. If a part is farther than
    `PUSHED_SIGMA` standard deviations from its prediction, it is not used to estimate T. Such a
    part is reset to its measured position.
    """
    innovation, velocity = seen - mean[..., :2], mean[..., 2:4]
    spread = covariance[..., :2, :2] + CAMERA_M**2 * np.eye(2)
    inverse = np.linalg.inv(spread)
    square = np.einsum("aki,akij,akj->ak", innovation, inverse, innovation)
    weighted = np.einsum("aki,akij->akj", velocity, inverse)
    information = np.einsum("aki,aki->ak", weighted, velocity)
    lateness = np.einsum("aki,aki->ak", weighted, innovation)
    # Parts that were pushed are not used to estimate the error of the stamp. For each part, z' (S +
    # s^2 v v')^-1 z follows from S^-1 by the formula of Sherman and Morrison (1950). Here, z is the
    # innovation, S its covariance, v the velocity, and s the standard deviation of the stamp.
    usual = np.maximum(square - jitter**2 * lateness**2 / (1 + jitter**2 * information), 0)
    known = usual <= PUSHED_SIGMA**2
    information, lateness = (np.sum(x * known, axis=1) for x in (information, lateness))
    variance = jitter**2 / (1 + jitter**2 * information)
    late = variance * lateness
    left = innovation - late[:, None, None] * velocity
    square = np.einsum("aki,akij,akj->ak", left, inverse, left)
    gain = covariance[..., :2] @ inverse
    after = mean + np.einsum("akij,akj->aki", gain, left)
    after[..., 4] = np.clip(after[..., 4], of_type - FRICTION_RANGE, of_type + FRICTION_RANGE)
    shift = np.einsum("akij,akj->aki", gain, velocity)
    rest = covariance - gain @ covariance[..., :2, :]
    rest += variance[:, None, None, None] * shift[..., :, None] * shift[..., None, :]
    pushed = square > PUSHED_SIGMA**2
    row, part = np.nonzero(pushed)
    after[row, part, 2:] = mean[row, part, 2:]
    after[row, part, :2] = seen[part]
    rest[row, part] = np.diag(FIRST_SEEN**2)
    rest[row, part, 4, 4] = covariance[row, part, 4, 4]
    square = np.minimum(square, PUSHED_SIGMA**2)
    # For all parts together, the same formula gives sum left' S^-1 left + late^2/s^2. `late` is the
    # estimated error of the stamp, and `left` is the remaining innovation. The determinant of the
    # covariance has the additional factor 1 + s^2 sum v' S^-1 v.
    likelihood = -0.5 * (
        np.sum(square + np.log(np.linalg.det(spread)), axis=1)
        + (late / jitter) ** 2
        + np.log(1 + jitter**2 * information)
    )
    alone = np.divide(lateness, information, out=np.zeros_like(late), where=information > 0)
    axes = 2 * max(len(seen), 1)
    innovations = Innovations(likelihood, np.sum(square, axis=1) / axes, alone, information)
    return after, (rest + rest.swapaxes(-1, -2)) / 2, innovations


def propagate(
    log: CycleLog,
    state: np.ndarray,
    begin: np.ndarray | float,
    end: np.ndarray | float,
    friction_accel: float,
) -> np.ndarray:
    """Propagate the states of K parts (K, 5) from the times `begin` to the times `end` through the
    executed cycles.

    `begin` and `end` are arrays (K,) or scalars [s].
    """
    state = state.copy()
    if not len(state):
        return state
    begin = np.ascontiguousarray(np.broadcast_to(begin, len(state)), dtype=float)
    end = np.ascontiguousarray(np.broadcast_to(end, len(state)), dtype=float)
    bound = friction_accel * np.exp(state[:, 4])
    for cycle, start, a, b in log.between(float(begin.min()), float(end.max())):
        pose, twist, dt = _sample_cycle(cycle, a, b)
        _kernels.stick_slip(state, bound, pose, twist, begin - start - a, end - start - a, dt)
    return state


def _sample_cycle(cycle: PlateCycle, a: float, b: float) -> tuple[np.ndarray, np.ndarray, float]:
    steps = max(1, round((b - a) / STEP_S))
    dt = (b - a) / steps
    t = a + (np.arange(steps) + 0.5) * dt
    return cycle.pose(t), cycle.twist(t), dt
