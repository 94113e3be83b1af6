"""Estimates the exposure times of a free-running camera from the stamps of its images.

The frames have regular intervals, but their stamps are noisy. A Kalman filter estimates the time of
the last frame and the frame interval. If two consecutive stamps differ by several intervals, images
between them were lost (dropped). The inputs are the stamps. The outputs are the time of the last
frame, its standard deviation and the image rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median

import numpy as np

WANDER_S = 0.05e-3
"""Standard deviation of the random change of the frame time per frame [s] (process noise)."""

DRIFT_S = 1e-6
"""Standard deviation of the random change of the frame interval per frame [s] (process noise)."""

FIRST_S = 5e-3
"""Initial value of the standard deviation of the stamp noise [s]."""

MIN_S = 0.05e-3
"""Minimum value of the standard deviation of the stamp noise [s]."""

FIRST_INTERVAL_S = 1.5e-3
"""Standard deviation of the initial interval [s]. The initial interval is the median interval of
the stamps."""

NOISE_FRAMES = 30
"""Number of frames over which the standard deviation of the stamp noise is averaged."""

DROPPED = 0.005
"""Assumed probability of a dropped image."""

GIVEN_UP = 12.0
"""Each hypothesis assumes a number of dropped images. A hypothesis is discarded if its
log-likelihood is below that of the best hypothesis by more than this value."""

ACQUIRE = 12
"""Number of stamps from which the initial frame interval is computed. Until this number is reached,
the stamp of an image is used as its frame time."""

IRREGULAR = 6.0
"""If a stamp deviates from its prediction by more than this number of standard deviations, the
frames have become irregular. In this case, the estimation restarts."""

OTHER = 0.3
"""Maximum difference between the median interval of the last stamps and the estimated frame
interval, as a fraction of the estimated interval. Two standard deviations of the stamp noise are
added to this maximum. If the difference is larger, the estimation restarts."""

WIDEST = 2.0
"""If the standard deviation of the stamp noise exceeds this number of frame intervals, the
estimation restarts."""

MAX_S = 1.0
"""If no image arrives for this time [s], the estimation restarts."""


@dataclass(frozen=True)
class FrameClock:
    """Estimate of the exposure times of a camera's images (frames).

    Attributes
    ----------
    stamps : tuple of float
        Stamps of the last images [s], at most `ACQUIRE`.
    frame : (H,)
        Number of the last image according to each hypothesis, minus its number according to the
        best hypothesis.
    log_likelihood : (H,)
        Log-likelihood of each hypothesis minus the maximum log-likelihood.
    time : (H, 2)
        Time of the last frame and the frame interval, for each hypothesis [s].
    covariance : (2, 2)
        Covariance matrix of the frame time and the frame interval [s2]. Infinite until both are
        known.
    noise_s : float
        Standard deviation of the stamps [s].
    """

    stamps: tuple[float, ...] = ()
    frame: np.ndarray = field(default_factory=lambda: np.zeros(1, int))
    log_likelihood: np.ndarray = field(default_factory=lambda: np.zeros(1))
    time: np.ndarray = field(default_factory=lambda: np.array([[-np.inf, np.nan]]))
    covariance: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.inf))
    noise_s: float = FIRST_S

    @classmethod
    def at(cls, stamp: float) -> FrameClock:
        """Return a clock that has received one image with the stamp `stamp` [s]."""
        return cls((stamp,), time=np.array([[stamp, np.nan]]))

    @property
    def instant(self) -> float:
        """Time at which the last image was taken [s]."""
        return float(self.time[np.argmax(self.log_likelihood), 0])

    @property
    def interval(self) -> float:
        """Frame interval [s]. NaN until the interval is known."""
        return float(self.time[np.argmax(self.log_likelihood), 1])

    @property
    def deviation(self) -> float:
        """Standard deviation of `instant` [s]. Until the frame interval is known, it is equal to
        `noise_s`."""
        if not np.isfinite(self.interval):
            return self.noise_s
        likely = np.exp(self.log_likelihood)
        ambiguity = likely @ (self.time[:, 0] - self.instant) ** 2 / np.sum(likely)
        return float(np.sqrt(self.covariance[0, 0] + ambiguity))

    @property
    def rate(self) -> float:
        """Number of images per second. 0 until two stamps are known."""
        if len(self.stamps) < 2:
            return 0.0
        known = np.isfinite(self.interval)
        return 1 / (self.interval if known else float(np.median(np.diff(self.stamps))))

    def tick(self, stamp: float) -> FrameClock:
        """Return the clock updated with the stamp of the next image [s]."""
        if not self.stamps or not 0 < stamp - self.stamps[-1] < MAX_S:
            return FrameClock.at(stamp)
        stamps = (*self.stamps, stamp)[-ACQUIRE:]
        if len(stamps) < ACQUIRE:
            return replace(FrameClock.at(stamp), stamps=stamps)
        interval = median(after - before for before, after in pairwise(stamps))
        if math.isfinite(known := self.interval):
            if abs(interval - known) > OTHER * known + 2 * self.noise_s:
                return FrameClock.at(stamp)
            clock = self._update(stamp)
        else:
            covariance = np.diag([FIRST_S**2, FIRST_INTERVAL_S**2])
            clock = replace(self, time=np.array([[stamps[0], interval]]), covariance=covariance)
            for image_stamp in stamps[1:]:
                clock = clock._update(image_stamp)
        # If the standard deviation of the stamps is larger, the stamps contain no information about
        # the frame times. Then restart the clock.
        if not clock.noise_s <= WIDEST * clock.interval:
            return FrameClock.at(stamp)
        return replace(clock, stamps=stamps)

    def _update(self, stamp: float) -> FrameClock:
        """Return the clock updated with the stamp of the next image [s], when the frame interval is
        already known. If the stamp contradicts all hypotheses, the estimation restarts.

        The image is the next frame or, if images were dropped, a later frame. A single late stamp
        is ambiguous, because the image may be late or a frame may have been dropped. Therefore,
        each hypothesis about the frame number has a separate filter.

        Let t be the time of the last frame, h the frame interval, and n the number of frames since
        the last frame. The innovation of the stamp is e = stamp - t - n h. Let q be the variance of
        e. The log-likelihood of the hypothesis changes by (n - 1) log(DROPPED) - (e^2/q + log q)/2.
        If two hypotheses reach the same frame number, only the likelier hypothesis is kept
        (Viterbi).
        """
        if not math.isfinite(self.interval):
            return FrameClock.at(stamp)
        max_frames = int(np.ceil(np.max((stamp - self.time[:, 0]) / self.time[:, 1]))) + 1
        count = np.arange(1, max(max_frames, 1) + 1)
        late = stamp - self.time[:, :1] - self.time[:, 1:] * count
        (of_time, of_both), (_, of_interval) = self.covariance
        spread = of_time + 2 * count * of_both + count**2 * of_interval + self.noise_s**2
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
        variance = covariance[0, 0] + self.noise_s**2
        square = late[best] ** 2 / variance
        if square > IRREGULAR**2:
            return FrameClock.at(stamp)
        gain = covariance[:, 0] / variance
        time = self.time[before].copy()
        time[:, 0] += count[after] * time[:, 1]
        time += late[:, None] * gain
        noise_s = self.noise_s * np.sqrt(1 + (square - 1) / NOISE_FRAMES)
        return FrameClock(
            (stamp,), numbers - numbers[best], likely - likely[best], time,
            covariance - np.outer(gain, covariance[0]), max(float(noise_s), MIN_S),
        )  # fmt: skip
