"""When a camera that runs free took its images: its frames are regular, only their stamps scatter.

A Kalman filter on the last frame's instant and the frames' interval. A stamp that comes several
intervals later says that images were dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median

import numpy as np

WANDER_S, DRIFT_S = 0.05e-3, 1e-6
"""Standard deviation from frame to frame of their instants, and of their interval [s]."""

FIRST_S, LEAST_S = 5e-3, 0.05e-3
"""Scatter of the stamps that is assumed at first, and at least [s]."""

FIRST_INTERVAL_S = 1.5e-3
"""Standard deviation of the first interval, the median of the distances of stamps [s]."""

SCATTER_FRAMES = 30
"""Frames over which the scatter is found."""

DROPPED = 0.005
"""Probability of a dropped image that is assumed."""

GIVEN_UP = 12.0
"""Hypotheses about dropped images this much less likely than the best are given up [log]."""

ACQUIRE = 12
"""Stamps from which the first interval is found; until then a stamp is believed."""

IRREGULAR = 6.0
"""Stamps this many standard deviations off are not of a regular camera: the clock begins anew."""

OTHER = 0.3
"""It does so too where the last stamps are this fraction further apart than expected, or nearer;
what the median of so few may be off by chance comes on top."""

WIDEST = 2.0
"""Scatter of the stamps [intervals] from which on the clock begins anew, too."""

LONGEST_S = 1.0
"""Time without images after which it begins anew [s]."""


@dataclass(frozen=True)
class FrameClock:
    """What is known of the frames' times.

    Attributes
    ----------
    stamps : tuple of float
        The last images' [s], as many as are needed to begin.
    frame : (H,)
        Hypotheses: by how many frames the last image is a later one than is believed.
    log_likelihood : (H,)
        Of each, less the greatest.
    time : (H, 2)
        When the last image was taken, by the regular clock of the camera, and the distance of
        frames [s].
    covariance : (2, 2)
        Of both [s2]; infinite as long as they are not known.
    scatter : float
        Standard deviation of the stamps [s].
    """

    stamps: tuple[float, ...] = ()
    frame: np.ndarray = field(default_factory=lambda: np.zeros(1, int))
    log_likelihood: np.ndarray = field(default_factory=lambda: np.zeros(1))
    time: np.ndarray = field(default_factory=lambda: np.array([[-np.inf, np.nan]]))
    covariance: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.inf))
    scatter: float = FIRST_S

    @classmethod
    def at(cls, stamp: float) -> FrameClock:
        """Return a clock that has seen one image."""
        return cls((stamp,), time=np.array([[stamp, np.nan]]))

    @property
    def instant(self) -> float:
        """When the last image was taken [s]."""
        return float(self.time[np.argmax(self.log_likelihood), 0])

    @property
    def interval(self) -> float:
        """Distance of frames [s]; NaN as long as it is not known."""
        return float(self.time[np.argmax(self.log_likelihood), 1])

    @property
    def deviation(self) -> float:
        """Standard deviation of `instant` [s]: that of a stamp as long as frames are not known."""
        if not np.isfinite(self.interval):
            return self.scatter
        likely = np.exp(self.log_likelihood)
        doubt = likely @ (self.time[:, 0] - self.instant) ** 2 / np.sum(likely)
        return float(np.sqrt(self.covariance[0, 0] + doubt))

    @property
    def rate(self) -> float:
        """Images a second; 0 as long as it is not known."""
        if len(self.stamps) < 2:
            return 0.0
        known = np.isfinite(self.interval)
        return 1 / (self.interval if known else float(np.median(np.diff(self.stamps))))

    def tick(self, stamp: float) -> FrameClock:
        """Take in the next stamp [s]."""
        if not self.stamps or not 0 < stamp - self.stamps[-1] < LONGEST_S:
            return FrameClock.at(stamp)
        stamps = (*self.stamps, stamp)[-ACQUIRE:]
        if len(stamps) < ACQUIRE:
            return replace(FrameClock.at(stamp), stamps=stamps)
        interval = median(after - before for before, after in pairwise(stamps))
        if math.isfinite(known := self.interval):
            if abs(interval - known) > OTHER * known + 2 * self.scatter:
                return FrameClock.at(stamp)
            clock = self._next(stamp)
        else:
            covariance = np.diag([FIRST_S**2, FIRST_INTERVAL_S**2])
            clock = replace(self, time=np.array([[stamps[0], interval]]), covariance=covariance)
            for each in stamps[1:]:
                clock = clock._next(each)
        # Stamps that scatter more tell nothing of when frames were.
        if not clock.scatter <= WIDEST * clock.interval:
            return FrameClock.at(stamp)
        return replace(clock, stamps=stamps)

    def _next(self, stamp: float) -> FrameClock:
        """Take in a stamp when the interval is known; it is unknown again if that does not fit.

        An image is of the frame after the last image's, or of a later one if some were dropped. One
        late stamp does not tell, but the next ones do: hypotheses about the frame's number each
        have a filter of their own. Of two that agree on the number the likelier remains (Viterbi).
        """
        if not math.isfinite(self.interval):
            return FrameClock.at(stamp)
        most = int(np.ceil(np.max((stamp - self.time[:, 0]) / self.time[:, 1]))) + 1
        count = np.arange(1, max(most, 1) + 1)
        late = stamp - self.time[:, :1] - self.time[:, 1:] * count
        (one, both), (_, interval) = self.covariance
        spread = one + 2 * count * both + count**2 * interval + self.scatter**2
        likely = self.log_likelihood[:, None] + (count - 1) * np.log(DROPPED)
        likely = likely - (late**2 / spread + np.log(spread)) / 2
        frame = self.frame[:, None] + count
        numbers = np.unique(frame[likely > np.max(likely) - GIVEN_UP])
        picked = [int(np.argmax(np.where(frame == number, likely, -np.inf))) for number in numbers]
        before, after = np.unravel_index(picked, likely.shape)
        likely, late = likely[before, after], late[before, after]
        best = int(np.argmax(likely))
        step = int(count[after[best]])
        move = np.array([[1.0, step], [0.0, 1.0]])
        covariance = move @ self.covariance @ move.T
        covariance += step * np.diag([WANDER_S**2, DRIFT_S**2])
        variance = covariance[0, 0] + self.scatter**2
        square = late[best] ** 2 / variance
        if square > IRREGULAR**2:
            return FrameClock.at(stamp)
        gain = covariance[:, 0] / variance
        time = self.time[before].copy()
        time[:, 0] += count[after] * time[:, 1]
        time += late[:, None] * gain
        scatter = self.scatter * np.sqrt(1 + (square - 1) / SCATTER_FRAMES)
        return FrameClock(
            (stamp,), numbers - numbers[best], likely - likely[best], time,
            covariance - np.outer(gain, covariance[0]), max(float(scatter), LEAST_S),
        )  # fmt: skip
