"""Where the parts are, how fast, and how slippery: a Kalman filter on the stick-slip motion.

A camera sees places only, at any time, and may show them late. The filter's motion model is what
the plate did: from image to image every part is propagated by the very cycles that ran, so an image
of the middle of a cycle is compared with the middle of a cycle. What a part does unlike the model
tells its friction. State of a part: x, y [m], vx, vy [m/s] in plate_home, and the logarithm of its
friction over the rig's. Parts do not influence each other; but an image whose stamp is off shows
all of them too early or too late.

Everything is done for A hypotheses side by side, of how old an image is at its stamp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from plate_core import UNKNOWN, Parts, PlateCycle, part_class

from .. import _kernels
from .cycle_log import CycleLog

STEP_S = 0.25e-3
"""Step of the motion model [s]: its error over a cycle is below the camera's noise."""

DIFFERENCE = np.array([1e-4, 1e-4, 5e-3, 5e-3, 0.03])
"""Differences by which the motion is differentiated [m, m, m/s, m/s, -]: as large as what is
uncertain, for the motion bends where parts stick."""

CAMERA_M = 0.02e-3
"""Error of a place that is seen [m]: the camera's noise, and what motion blur adds."""

PROCESS_NOISE = np.array([0.02e-3, 0.02e-3, 2e-3, 2e-3, 0.01])
"""What the model misses in a cycle (as DIFFERENCE): friction that is uneven under the part, finite
steps, a plate that does not quite do as asked."""

FIRST_SEEN = np.array([0.02e-3, 0.02e-3, 0.02, 0.02, 0.15])
"""Standard deviations of a part seen for the first time (as DIFFERENCE)."""

PUSHED_SIGMA = 6.0
"""A part this many standard deviations from its prediction was pushed by something that the model
does not know: it is taken to be where it is seen, at any speed."""

FRICTION_RANGE = np.log(3.0)
"""Friction is looked for between a third and three times that of the part's type [log]."""

SAMPLES = np.vstack([np.zeros(5), np.diag(DIFFERENCE)])
"""The state and its neighbours, (6, 5)."""


class Coast(NamedTuple):
    """Images in a row for which what is not seen is propagated: parts, and things of the class
    `unknown`."""

    parts: int
    unknown: int


@dataclass(frozen=True)
class StateEstimate:
    """What is known of M parts, by A hypotheses.

    Attributes
    ----------
    ids : tuple of str
    time : (A, M)
        When that was: when each part was seen last, or propagated to [s, the time of the stamps].
    mean : (A, M, 5)
    covariance : (A, M, 5, 5)
    drift : (M, 2)
        As it was seen last [m/s].
    unseen : (M,)
        Images in a row that do not show the part.
    start : float
        When the last cycle began before parts were seen in it [s]; NaN: none did.
    start_mean : (A, M, 5)
        What was expected of the parts then.
    usual : (M,)
        Friction of the parts' types, over the rig's [log].
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
        """Return `count` hypotheses about no parts."""
        return cls(
            (), np.zeros((count, 0)), np.zeros((count, 0, 5)), np.zeros((count, 0, 5, 5)),
            np.zeros((0, 2)), np.zeros(0, int), np.nan, np.zeros((count, 0, 5)),
            np.zeros(0),
        )  # fmt: skip

    def of(self, hypotheses: np.ndarray | list[int]) -> StateEstimate:
        """Return some of the hypotheses."""
        return replace(
            self, time=self.time[hypotheses], mean=self.mean[hypotheses],
            covariance=self.covariance[hypotheses], start_mean=self.start_mean[hypotheses],
        )  # fmt: skip

    def at(self, hypothesis: int, log: CycleLog, t: float, friction_accel: float) -> np.ndarray:
        """Return what is known of the parts (M, 5) at a time t [s], by one hypothesis.

        Earlier than they were seen they were where that was expected, if a cycle began then.
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
        most: Coast,
        jitter: float,
        friction: np.ndarray,
    ) -> tuple[StateEstimate, Fit]:
        """Take in the parts of an image.

        Parameters
        ----------
        log : CycleLog
        parts : Parts
            P parts that the image shows.
        time : (A, P)
            When it shows each of them, by each hypothesis [s].
        friction_accel : float
            mu g of the rig [m/s2].
        most : Coast
            Images in a row for which a part that is not seen is kept.
        jitter : float
            Standard deviation of the images' stamps [s].
        friction : (P,)
            Of a part that is seen for the first time, over the rig's.

        Returns
        -------
        estimate : StateEstimate
        fit : Fit
            How well the hypotheses have predicted the image.
        """
        now = self._without(most)
        if log.known and log.begin != now.start:
            now = now._begun(log, friction_accel)
        row = {name: i for i, name in enumerate(now.ids)}
        old = [i for i, name in enumerate(parts.ids) if name in row]
        new = [i for i, name in enumerate(parts.ids) if name not in row]
        rows = np.array([row[parts.ids[i]] for i in old], int)
        place = parts.position
        mean, covariance = now._propagated(rows, log, time[:, old], friction_accel)
        mean, covariance, fit = kalman_update(mean, covariance, place[old], jitter, now.usual[rows])
        after = [now.mean.copy(), now.covariance.copy(), now.time.copy()]
        for whole, piece in zip(after, (mean, covariance, time[:, old]), strict=True):
            whole[:, rows] = piece
        drift, unseen = now.drift.copy(), now.unseen + 1
        drift[rows], unseen[rows] = parts.velocity[old], 0
        count = len(time)
        still = np.zeros((len(new), 2))
        first = np.hstack([place[new], still, np.log(friction[new, None])])
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
        return estimate, fit

    def moved(self, log: CycleLog, later: np.ndarray, friction_accel: float) -> StateEstimate:
        """Return the same places `later` (A,) [s], with the velocities of that time."""
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

    def _begun(self, log: CycleLog, friction_accel: float) -> StateEstimate:
        """Note where parts are expected to be when the last cycle began, if that was since."""
        begin = np.maximum(self.time, log.begin).ravel()
        mean = propagate(log, self.mean.reshape(-1, 5), self.time.ravel(), begin, friction_accel)
        return replace(self, start=log.begin, start_mean=mean.reshape(self.mean.shape))

    def _propagated(
        self, rows: np.ndarray, log: CycleLog, time: np.ndarray, friction_accel: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (A, K, 5) and covariance (A, K, 5, 5) of some parts at times (A, K) [s]."""
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

    def _without(self, most: Coast) -> StateEstimate:
        """Leave out parts that the last `most` images did not show."""
        unknown = np.array([part_class(name) == UNKNOWN for name in self.ids], bool)
        keep = self.unseen < np.where(unknown, most.unknown, most.parts)
        if np.all(keep):
            return self
        return StateEstimate(
            tuple(name for name, k in zip(self.ids, keep, strict=True) if k),
            self.time[:, keep], self.mean[:, keep], self.covariance[:, keep], self.drift[keep],
            self.unseen[keep], self.start, self.start_mean[:, keep], self.usual[keep],
        )  # fmt: skip


@dataclass(frozen=True)
class Fit:
    """How well each of A hypotheses has predicted an image.

    Attributes
    ----------
    log_likelihood : (A,)
    lateness : (A,)
        By how much later than assumed the image shows the parts, by itself alone [s].
    square : (A,)
        Mean square of innovations over their variance: 1 is usual.
    information : (A,)
        One over the variance of that [1/s2]; 0: it tells nothing.
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
) -> tuple[np.ndarray, np.ndarray, Fit]:
    """Return mean (A, K, 5) and covariance (A, K, 5, 5) after places (K, 2) [m] were seen of parts
    whose types have the friction `of_type` (K,), over the rig's [log].

    The stamp is off by a normal deviate of `jitter` [s], the same for all parts: with v_i their
    velocities it adds v_i v_j^T jitter^2 to the innovations' covariance. The deviate's posterior is
    normal too (a rank-one update), and is taken out of the innovations.
    """
    innovation, velocity = seen - mean[..., :2], mean[..., 2:4]
    spread = covariance[..., :2, :2] + CAMERA_M**2 * np.eye(2)
    inverse = np.linalg.inv(spread)
    square = np.einsum("aki,akij,akj->ak", innovation, inverse, innovation)
    weighted = np.einsum("aki,akij->akj", velocity, inverse)
    information = np.einsum("aki,aki->ak", weighted, velocity)
    lateness = np.einsum("aki,aki->ak", weighted, innovation)
    # A part that was pushed tells nothing of the stamp.
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
    likelihood = -0.5 * (
        np.sum(square + np.log(np.linalg.det(spread)), axis=1)
        + (late / jitter) ** 2
        + np.log(1 + jitter**2 * information)
    )
    alone = np.divide(lateness, information, out=np.zeros_like(late), where=information > 0)
    axes = 2 * max(len(seen), 1)
    fit = Fit(likelihood, np.sum(square, axis=1) / axes, alone, information)
    return after, (rest + rest.swapaxes(-1, -2)) / 2, fit


def propagate(
    log: CycleLog,
    state: np.ndarray,
    begin: np.ndarray | float,
    end: np.ndarray | float,
    friction_accel: float,
) -> np.ndarray:
    """Return states (K, 5) at `end` that were such at `begin`, (K,) or all alike [s], by the cycles
    that ran."""
    state = state.copy()
    if not len(state):
        return state
    begin = np.ascontiguousarray(np.broadcast_to(begin, len(state)), dtype=float)
    end = np.ascontiguousarray(np.broadcast_to(end, len(state)), dtype=float)
    bound = friction_accel * np.exp(state[:, 4])
    for cycle, start, a, b in log.between(float(begin.min()), float(end.max())):
        pose, twist, dt = _sampled(cycle, a, b)
        _kernels.stick_slip(state, bound, pose, twist, begin - start - a, end - start - a, dt)
    return state


def _sampled(cycle: PlateCycle, a: float, b: float) -> tuple[np.ndarray, np.ndarray, float]:
    steps = max(1, round((b - a) / STEP_S))
    dt = (b - a) / steps
    t = a + (np.arange(steps) + 0.5) * dt
    return cycle.pose(t), cycle.twist(t), dt
