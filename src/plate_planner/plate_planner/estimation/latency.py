"""How old an image is at its stamp: hypotheses side by side, and which the motion bears out.

A camera's latency is seldom known, and parts on the plate move by millimetres in 10 ms. Hypotheses
take the images to be of different ages; the likelihood of what they predicted says which one is
believed. They draw closer around it until half a millisecond is between two, and move on with a
latency that changes. How far stamps scatter (their jitter) is found on the way: what an image shows
too late or too early, beyond what its parts can tell.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts

from .cycle_log import CycleLog
from .filter import Coast, Fit, StateEstimate

STEPS = np.arange(-2, 3)
"""Latencies tried, in steps from the middle one."""

COARSE_S, FINE_S = 0.025, 0.5e-3
"""First and last distance of neighbouring latencies [s]: from 0 to 0.1 s is tried first; what
0.5 ms makes is hardly above the camera's noise."""

LONGEST_S = 0.5
"""No image is taken to be older [s]."""

FEWEST_IMAGES, CLEAR, BETTER = 4, 12.0, 4.0
"""Latencies are given up after so many images at the least, once they are less likely than the best
by so much [log]: model and noise are not quite as assumed. It takes less to believe another one,
and the first image of a plate in motion may tell it."""

SOON_IMAGES = 4
"""Of images at the starts of cycles, after which believing another latency takes more and more."""

MISFIT, MISFIT_IMAGES = 6.0, 8
"""Where the mean square of normalised innovations, over so many images, is above this (1 is usual),
nothing that is assumed can be right: the latency is looked for anew."""

MEMORY_S = 3.0
"""What an image tells of the latency counts for about so long [s]."""

JITTER_S = (0.5e-3, 1e-3, 20e-3)
"""Least, first and greatest standard deviation of stamps to be believed [s]."""

JITTER_IMAGES = 50
"""Images over which that is found."""


@dataclass(frozen=True)
class Jitter:
    """The variance of the stamps: a mean of squares, each counting as much as its image can tell.

    Attributes
    ----------
    total, weight : float
        Weighted sum of squares [1/s2], and of weights [1/s4].
    """

    total: float = 1 / JITTER_S[1] ** 2
    weight: float = 1 / JITTER_S[1] ** 4

    @property
    def deviation(self) -> float:
        """The standard deviation [s]."""
        return float(np.clip(np.sqrt(max(self.total / self.weight, 0.0)), *JITTER_S[::2]))

    def update(self, lateness: float, information: float) -> Jitter:
        """Take in by how much an image was late by itself [s], and what it tells of it [1/s2]."""
        if information <= 0:
            return self
        noise, keep = 1 / information, 1 - 1 / JITTER_IMAGES
        weight = 1 / (self.deviation**2 + noise) ** 2
        square = min(lateness**2, JITTER_S[2] ** 2) - noise
        return Jitter(keep * self.total + weight * square, keep * self.weight + weight)


@dataclass(frozen=True)
class LatencyHypotheses:
    """Estimates by latency.

    Attributes
    ----------
    latencies : (A,)
        Rising [s].
    estimate : StateEstimate
        By each of them.
    best : int
        Which one is believed.
    log_likelihood : (A,)
        Of what each one predicted, fading.
    images : int
        Images of a plate in motion since the latencies were set.
    misfit : float
        Mean square of what the best one has predicted wrongly, over its variance; 1 is usual.
    jitter : Jitter
    trusting : bool
        Whether an image that is stamped when a cycle starts is taken to be not old (`none_old`):
        until the motion shows that it is.
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
        """Return the hypotheses at the start: one latency [s], or several if it is unknown."""
        tried = COARSE_S * (STEPS - STEPS[0]) if latency is None else np.array([latency])
        nothing = StateEstimate.nothing(len(tried))
        blank = np.zeros(len(tried))
        return cls(tried, nothing, log_likelihood=blank, trusting=latency is None)

    @property
    def latency(self) -> float:
        """The latency that is believed [s]."""
        return float(self.latencies[self.best])

    @property
    def found(self) -> bool:
        """Whether the latency is known, but for a few milliseconds."""
        return bool(np.ptp(self.latencies) < COARSE_S)

    def update(
        self,
        log: CycleLog,
        parts: Parts,
        t: float,
        unsure: float,
        delay: np.ndarray,
        friction_accel: float,
        most: Coast,
        friction: np.ndarray,
    ) -> LatencyHypotheses:
        """Take in the parts of an image with stamp t [s], which is off by `unsure` [s] or more
        (standard deviation); each part is seen `delay` (P,) [s] later than the middle of the image;
        the rest as in `StateEstimate.update`."""
        time = t - self.latencies[:, None] + delay
        last = np.max(self.estimate.time[self.best], initial=-np.inf)
        fading = np.exp(-max(t - self.latency - last, 0.0) / MEMORY_S)
        jitter = max(self.jitter.deviation, unsure)
        estimate, fit = self.estimate.update(
            log, parts, time, friction_accel, most, jitter, friction
        )
        moved = any(np.any(cycle.knot_pose) for _, cycle in log.runs[-2:])
        if not moved:
            return replace(self, estimate=estimate)
        seen = replace(
            self,
            estimate=estimate,
            log_likelihood=fading * self.log_likelihood + fit.log_likelihood,
            images=self.images + 1,
            misfit=self.misfit + (float(fit.square[self.best]) - self.misfit) / MISFIT_IMAGES,
            jitter=self._jitter(fit),
        )
        if len(self.latencies) == 1 and not self.trusting:
            return seen
        if self.found and seen.misfit > MISFIT:
            anew = replace(LatencyHypotheses.of(None), jitter=self.jitter, trusting=False)
            return anew.update(log, parts, t, unsure, delay, friction_accel, most, friction)
        if len(self.latencies) == 1:
            return seen
        likely = seen.log_likelihood
        # Images at the starts of cycles tell little of it: what was believed for long is kept.
        better = BETTER if log.reported else BETTER * max(seen.images / SOON_IMAGES, 1.0)
        best, middle = int(np.argmax(likely)), len(STEPS) // 2
        if likely[best] - likely[self.best] < better:
            best = self.best
        step = self.latencies[1] - self.latencies[0]
        at_end = best == len(STEPS) - 1 or (best == 0 and self.latencies[0] > 0)
        given_up = middle if at_end else np.abs(STEPS - STEPS[best]) > 1
        other = at_end or step > FINE_S or best != middle
        enough = seen.images >= FEWEST_IMAGES
        if enough and other and likely[best] - np.max(likely[given_up]) > CLEAR:
            step = min(2 * step, COARSE_S) if at_end else max(step / 2, FINE_S)
            return seen._around(best, step, log, friction_accel)
        return replace(seen, best=best)

    def none_old(self, log: CycleLog, friction_accel: float) -> LatencyHypotheses:
        """Return what is known if images are taken at their stamps, as it seems."""
        if len(self.latencies) == 1 or not self.trusting:
            return self
        estimate = self.estimate.of([0]).moved(log, self.latencies[:1], friction_accel)
        return replace(self.of(0.0), estimate=estimate, jitter=self.jitter, trusting=True)

    def _jitter(self, fit: Fit) -> Jitter:
        """Return the jitter after an image; as long as the latency is wrong it tells nothing."""
        if not self.found:
            return self.jitter
        return self.jitter.update(float(fit.lateness[self.best]), float(fit.information[self.best]))

    def _around(
        self, best: int, step: float, log: CycleLog, friction_accel: float
    ) -> LatencyHypotheses:
        """Set the latencies anew around the best, at steps [s]."""
        middle = np.clip(self.latencies[best], -STEPS[0] * step, LONGEST_S - STEPS[-1] * step)
        latencies = middle + step * STEPS
        older = np.minimum(np.searchsorted(self.latencies, latencies - 1e-9), len(STEPS) - 1)
        estimate = self.estimate.of(older)
        estimate = estimate.moved(log, self.latencies[older] - latencies, friction_accel)
        nearest = int(np.argmin(np.abs(latencies - self.latencies[best])))
        return replace(
            self.of(None), latencies=latencies, estimate=estimate, best=nearest,
            jitter=self.jitter, trusting=self.trusting,
        )  # fmt: skip
