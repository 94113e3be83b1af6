"""How old an image is at its stamp: estimates at several latencies, and which the motion bears out.

A camera's latency is seldom known, and parts on the plate move by millimetres in 10 ms. Estimates
side by side take the images to be of different ages; the one that best predicts the next image is
believed, and the latencies draw closer around it until one is left.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts

from .cycle_log import CycleLog
from .filter import StateEstimate

STEPS = np.arange(-2, 3)
"""Latencies tried, in steps from the middle one."""

COARSE_S, FINE_S = 0.025, 0.5e-3
"""First and last distance of neighbouring latencies [s]: from 0 to 0.1 s is tried first; what
0.5 ms makes is hardly above the camera's noise."""

LONGEST_S = 0.5
"""No image is taken to be older [s]."""

FEWEST_IMAGES, CLEAR, FORGET = 4, 4.0, 0.9
"""A latency is chosen after so many images at the least, once the worst one predicts them so many
times worse than the best; what older images tell fades by this factor an image."""

MOST_IMAGES = 40
"""Latencies that so many images do not tell apart are equally good, and one is kept."""


@dataclass(frozen=True)
class LatencyHypotheses:
    """Estimates by latency.

    Attributes
    ----------
    latencies : (A,)
        Rising [s].
    estimates : tuple of StateEstimate
        One for each latency.
    best : int
        Which one is believed.
    square_error : (A,)
        Squared distances of parts from each estimate's predictions [m2], fading.
    images : int
        Images of a plate in motion since the latencies were set.
    """

    latencies: np.ndarray
    estimates: tuple[StateEstimate, ...]
    best: int = 0
    square_error: np.ndarray = field(default_factory=lambda: np.zeros(len(STEPS)))
    images: int = 0

    @classmethod
    def of(cls, latency: float | None) -> LatencyHypotheses:
        """Return the hypotheses at the start: one latency [s], or several if it is unknown."""
        tried = COARSE_S * (STEPS - STEPS[0]) if latency is None else np.array([latency])
        return cls(tried, (StateEstimate(),) * len(tried), square_error=np.zeros(len(tried)))

    @property
    def latency(self) -> float:
        """The latency that is believed [s]."""
        return float(self.latencies[self.best])

    @property
    def found(self) -> bool:
        """Whether the latency is known, but for a few milliseconds."""
        return bool(np.ptp(self.latencies) < COARSE_S * np.ptp(STEPS))

    @property
    def estimate(self) -> StateEstimate:
        """The estimate at that latency."""
        return self.estimates[self.best]

    def update(
        self, log: CycleLog, parts: Parts, t: float, friction_accel: float, most: int
    ) -> LatencyHypotheses:
        """Take in the parts of an image with stamp t [s]; see `StateEstimate.update`."""
        estimates = tuple(
            estimate.update(log, parts, t - latency, friction_accel, most)
            for estimate, latency in zip(self.estimates, self.latencies, strict=True)
        )
        error = FORGET * self.square_error + [estimate.square_error for estimate in estimates]
        moved = any(np.any(cycle.knot_pose) for _, cycle in log.runs[-2:])
        seen = replace(self, estimates=estimates, square_error=error, images=self.images + moved)
        step = np.ptp(self.latencies) / len(STEPS[1:])
        if seen.images >= FEWEST_IMAGES and np.max(error) > CLEAR * np.min(error):
            best = int(np.argmin(error))
            return seen._closer(best, log, t, friction_accel) if step > FINE_S else seen._one(best)
        return seen._one(self.best) if seen.images >= MOST_IMAGES and 0 < step < COARSE_S else seen

    def _one(self, k: int) -> LatencyHypotheses:
        """Keep one latency."""
        return LatencyHypotheses(
            self.latencies[k : k + 1], self.estimates[k : k + 1], square_error=np.zeros(1)
        )

    def _closer(
        self, best: int, log: CycleLog, t: float, friction_accel: float
    ) -> LatencyHypotheses:
        """Set the latencies anew around the best."""
        step = self.latencies[1] - self.latencies[0]
        at_end = best == len(STEPS) - 1 or (best == 0 and self.latencies[0] > 0)
        step = min(2 * step, COARSE_S) if at_end else max(step / 2, FINE_S)
        middle = np.clip(self.latencies[best], -STEPS[0] * step, LONGEST_S - STEPS[-1] * step)
        latencies = middle + step * STEPS
        estimates = []
        for latency in latencies:
            older = min(int(np.searchsorted(self.latencies, latency - 1e-9)), len(STEPS) - 1)
            estimates.append(self.estimates[older].moved_to(log, t - latency, friction_accel))
        nearest = int(np.argmin(np.abs(latencies - self.latencies[best])))
        return LatencyHypotheses(latencies, tuple(estimates), nearest)
