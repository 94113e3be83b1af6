"""Estimates the image latency by parallel hypotheses. The latency is the time from the exposure of
an image to the time in its stamp.

The latency of a camera is rarely known, and parts move by millimetres in 10 ms. Each hypothesis
assumes a different latency and has separate Kalman filters. The hypothesis whose predictions have
the highest likelihood is accepted. The latencies of the hypotheses form a grid. The grid is refined
around the accepted latency, to a spacing of 0.5 ms. If the latency changes, the grid moves with it.
The standard deviation of the stamps (jitter) is estimated from the remaining timing errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts

from .cycle_log import CycleLog
from .filter import Coast, Innovations, StateEstimate

STEPS = np.arange(-2, 3)
"""Latency of each hypothesis minus the latency of the middle hypothesis, divided by the spacing of
the grid."""

COARSE_S = 0.025
"""Initial spacing of the latencies [s]. The first hypotheses cover 0 to 0.1 s."""

FINE_S = 0.5e-3
"""Final spacing of the latencies [s]. A latency error of this size has about the same effect as the
noise of the camera."""

MAX_S = 0.5
"""Maximum latency [s]."""

MIN_IMAGES = 4
"""Minimum number of images before the grid of latencies may change."""

CLEAR = 12.0
"""Latencies are discarded if their log-likelihood is below that of the best latency by more than
this value. The value is large because the model of the motion and of the noise is not exact."""

BETTER = 4.0
"""Another latency is accepted if its log-likelihood exceeds that of the accepted latency by at
least this value. The value is smaller than `CLEAR`, so that a wrong latency is replaced soon."""

SOON_IMAGES = 4
"""If images are taken at cycle starts, a difference of `BETTER` is sufficient to accept another
latency only up to this number of images. With more images, the required difference increases in
proportion to their number."""

MISFIT = 6.0
"""Maximum mean square of the normalised innovations, whose expected value is 1. If this maximum is
exceeded, all hypotheses are assumed to be wrong, and the estimation restarts."""

MISFIT_IMAGES = 8
"""Number of images over which the mean square of the normalised innovations is averaged."""

FADING_S = 3.0
"""Time constant [s] with which the weight of old images in the likelihood decreases."""

JITTER_S = (0.5e-3, 1e-3, 20e-3)
"""Minimum, initial and maximum value of the standard deviation of the stamps [s]."""

JITTER_IMAGES = 50
"""Number of images over which the variance of the stamps is averaged."""


@dataclass(frozen=True)
class Jitter:
    """Estimate of the variance of the stamps from a weighted mean of squared timing errors.

    Let e be the timing error that is measured in an image, r = 1 / information the variance of this
    measurement, and s the standard deviation of the stamps. Then e^2 has the mean s^2 + r. The
    estimate is

        s^2 = sum of weight (e^2 - r) / sum of weight, weight = (s^2 + r)^-2,

    with exponential forgetting over `JITTER_IMAGES` images.

    Attributes
    ----------
    total, weight : float
        `total` is the weighted sum of e^2 - r [1/s2]. `weight` is the sum of the weights [1/s4].
    """

    total: float = 1 / JITTER_S[1] ** 2
    weight: float = 1 / JITTER_S[1] ** 4

    @property
    def deviation(self) -> float:
        """The standard deviation of the stamps [s]."""
        return float(np.clip(np.sqrt(max(self.total / self.weight, 0.0)), *JITTER_S[::2]))

    def update(self, lateness: float, information: float) -> Jitter:
        """Return the estimate updated with one image. `lateness` [s] and `information` [1/s2] are
        defined in `Innovations`."""
        if information <= 0:
            return self
        noise, keep = 1 / information, 1 - 1 / JITTER_IMAGES
        weight = 1 / (self.deviation**2 + noise) ** 2
        square = min(lateness**2, JITTER_S[2] ** 2) - noise
        return Jitter(keep * self.total + weight * square, keep * self.weight + weight)


@dataclass(frozen=True)
class LatencyHypotheses:
    """State estimates of the parts for A hypotheses of the image latency.

    Attributes
    ----------
    latencies : (A,)
        Latencies of the hypotheses in increasing order [s].
    estimate : StateEstimate
        Estimates for all latencies.
    best : int
        Index of the accepted latency.
    log_likelihood : (A,)
        Log-likelihood of the measured positions under each hypothesis, with exponential forgetting.
    images : int
        Number of images with a moving plate since the grid of latencies was last changed.
    misfit : float
        Mean square of the normalised innovations of the accepted hypothesis; the expected value is
        1.
    jitter : Jitter
    trusting : bool
        Whether `none_old` accepts zero latency if the stamps coincide with cycle starts. The value
        becomes False if the motion of the parts contradicts zero latency.
    """

    latencies: np.ndarray
    estimate: StateEstimate
    best: int = 0
    log_likelihood: np.ndarray = field(default_factory=lambda: np.zeros(len(STEPS)))
    images: int = 0
    misfit: float = 1.0
    jitter: Jitter = field(default_factory=Jitter)
    trusting: bool = False

    @classmethod
    def of(cls, latency: float | None) -> LatencyHypotheses:
        """Return the initial hypotheses. If the latency [s] is given, there is only one hypothesis.
        If the latency is None (unknown), there are several."""
        tried = COARSE_S * (STEPS - STEPS[0]) if latency is None else np.array([latency])
        nothing = StateEstimate.nothing(len(tried))
        blank = np.zeros(len(tried))
        return cls(tried, nothing, log_likelihood=blank, trusting=latency is None)

    @property
    def latency(self) -> float:
        """Accepted latency [s]."""
        return float(self.latencies[self.best])

    @property
    def estimated(self) -> bool:
        """Whether the hypotheses have been narrowed down, so that the latency is known to within a
        few milliseconds."""
        return bool(np.ptp(self.latencies) < COARSE_S)

    def update(
        self,
        log: CycleLog,
        parts: Parts,
        t: float,
        unsure: float,
        delay: np.ndarray,
        friction_accel: float,
        coast: Coast,
        friction: np.ndarray,
    ) -> LatencyHypotheses:
        """Return the hypotheses updated with the parts of an image with the stamp t [s].

        If the plate moves, the log-likelihood L of each hypothesis becomes exp(-dt/FADING_S) L +
        log p(parts). dt is the time since the last image, and p is the likelihood of the measured
        positions.

        `unsure` is a lower bound of the standard deviation of the stamp [s]. `delay` (P,) is the
        time from the exposure of the middle of the image to the exposure of each part [s]. The
        other parameters are the same as in `StateEstimate.update`.
        """
        time = t - self.latencies[:, None] + delay
        last = np.max(self.estimate.time[self.best], initial=-np.inf)
        fading = np.exp(-max(t - self.latency - last, 0.0) / FADING_S)
        jitter = max(self.jitter.deviation, unsure)
        estimate, innovations = self.estimate.update(
            log, parts, time, friction_accel, coast, jitter, friction
        )
        moved = any(np.any(cycle.knot_pose) for _, cycle in log.runs[-2:])
        if not moved:
            return replace(self, estimate=estimate)
        seen = replace(
            self,
            estimate=estimate,
            log_likelihood=fading * self.log_likelihood + innovations.log_likelihood,
            images=self.images + 1,
            misfit=self.misfit
            + (float(innovations.square[self.best]) - self.misfit) / MISFIT_IMAGES,
            jitter=self._updated_jitter(innovations),
        )
        if len(self.latencies) == 1 and not self.trusting:
            return seen
        if self.estimated and seen.misfit > MISFIT:
            restarted = replace(LatencyHypotheses.of(None), jitter=self.jitter, trusting=False)
            return restarted.update(log, parts, t, unsure, delay, friction_accel, coast, friction)
        if len(self.latencies) == 1:
            return seen
        likely = seen.log_likelihood
        # Images at cycle starts contain little information about the latency. Therefore the
        # required difference in likelihood increases with the number of images for which the
        # present latency has been accepted.
        better = BETTER if log.free_running else BETTER * max(seen.images / SOON_IMAGES, 1.0)
        best, middle = int(np.argmax(likely)), len(STEPS) // 2
        if likely[best] - likely[self.best] < better:
            best = self.best
        step = self.latencies[1] - self.latencies[0]
        at_end = best == len(STEPS) - 1 or (best == 0 and self.latencies[0] > 0)
        given_up = middle if at_end else np.abs(STEPS - STEPS[best]) > 1
        other = at_end or step > FINE_S or best != middle
        enough = seen.images >= MIN_IMAGES
        if enough and other and likely[best] - np.max(likely[given_up]) > CLEAR:
            step = min(2 * step, COARSE_S) if at_end else max(step / 2, FINE_S)
            return seen._hypotheses_around(best, step, log, friction_accel)
        return replace(seen, best=best)

    def none_old(self, log: CycleLog, friction_accel: float) -> LatencyHypotheses:
        """Return a single hypothesis with zero latency. Call this method if the stamps coincide
        with cycle starts.

        If the latency is known or `trusting` is False, the hypotheses are not changed.
        """
        if len(self.latencies) == 1 or not self.trusting:
            return self
        estimate = self.estimate.of([0]).moved(log, self.latencies[:1], friction_accel)
        return replace(self.of(0.0), estimate=estimate, jitter=self.jitter, trusting=True)

    def _updated_jitter(self, innovations: Innovations) -> Jitter:
        """Return the value of `jitter` after an image. Until the latency is known, the value does
        not change."""
        if not self.estimated:
            return self.jitter
        return self.jitter.update(
            float(innovations.lateness[self.best]), float(innovations.information[self.best])
        )

    def _hypotheses_around(
        self, best: int, step: float, log: CycleLog, friction_accel: float
    ) -> LatencyHypotheses:
        """Return hypotheses whose latencies surround the latency of the hypothesis `best`, with the
        spacing `step` [s]."""
        middle = np.clip(self.latencies[best], -STEPS[0] * step, MAX_S - STEPS[-1] * step)
        latencies = middle + step * STEPS
        older = np.minimum(np.searchsorted(self.latencies, latencies - 1e-9), len(STEPS) - 1)
        estimate = self.estimate.of(older)
        estimate = estimate.moved(log, self.latencies[older] - latencies, friction_accel)
        nearest = int(np.argmin(np.abs(latencies - self.latencies[best])))
        return replace(
            self.of(None), latencies=latencies, estimate=estimate, best=nearest,
            jitter=self.jitter, trusting=self.trusting,
        )  # fmt: skip
