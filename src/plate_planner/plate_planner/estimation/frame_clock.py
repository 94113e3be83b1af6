"""When a camera that runs free took its images: its frames are regular, only their stamps scatter.

A Kalman filter on the last frame's instant and the frames' interval. A stamp that comes several
intervals later says that images were dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

WANDER_S, DRIFT_S = 0.05e-3, 1e-6
"""Standard deviation from frame to frame of their instants, and of their interval [s]."""

FIRST_S, LEAST_S = 5e-3, 0.05e-3
"""Scatter of the stamps that is assumed at first, and at least [s]."""

FIRST_INTERVAL_S = 1.5e-3
"""Standard deviation of the first interval, the median of the distances of stamps [s]."""

SCATTER_FRAMES = 30
"""Frames over which the scatter is found."""

DROPPED = 0.002
"""Probability of a dropped image that is assumed."""

ACQUIRE = 12
"""Stamps from which the first interval is found; until then a stamp is believed."""

SURE = 4.0
"""A mean this many standard deviations off tells that a dropped image was overlooked."""

IRREGULAR = 6.0
"""Stamps this many standard deviations off are not of a regular camera: the clock begins anew."""

OTHER = 0.3
"""It does so too where the last stamps are this fraction further apart than expected, or nearer;
what the median of so few may be off by chance comes on top."""

LONGEST_S = 1.0
"""Time without images after which it begins anew [s]."""


@dataclass(frozen=True)
class FrameClock:
    """What is known of the frames' times.

    Attributes
    ----------
    stamps : tuple of float
        The last images' [s], as many as are needed to begin.
    instant, interval : float
        When the last image was taken, by the regular clock of the camera; distance of frames [s].
    covariance : (2, 2)
        Of both [s2]; infinite as long as they are not known.
    scatter : float
        Standard deviation of the stamps [s].
    late, count : float, int
        By how much the last stamps were later than expected, on average [s]; how many they were.
    """

    stamps: tuple[float, ...] = ()
    instant: float = -np.inf
    interval: float = np.nan
    covariance: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.inf))
    scatter: float = FIRST_S
    late: float = 0.0
    count: int = 0

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
            return FrameClock((stamp,), stamp)
        stamps = (*self.stamps, stamp)[-ACQUIRE:]
        if len(stamps) < ACQUIRE:
            return replace(self, stamps=stamps, instant=stamp)
        interval = float(np.median(np.diff(stamps)))
        if np.isfinite(self.interval):
            if abs(interval - self.interval) > OTHER * self.interval + 2 * self.scatter:
                return FrameClock((stamp,), stamp)
            clock = self._next(stamp)
            return replace(clock, stamps=stamps) if np.isfinite(clock.interval) else clock
        covariance = np.diag([FIRST_S**2, FIRST_INTERVAL_S**2])
        clock = FrameClock(stamps, stamps[0], interval, covariance)
        for each in stamps[1:]:
            clock = clock._next(each)
            if not np.isfinite(clock.interval):
                return clock
        return replace(clock, stamps=stamps)

    def _next(self, stamp: float) -> FrameClock:
        """Take in a stamp when the interval is known; it is unknown again if that does not fit."""
        count = self._frames_since(stamp)
        move = np.array([[1.0, count], [0.0, 1.0]])
        noise = count * np.diag([WANDER_S**2, DRIFT_S**2])
        covariance = move @ self.covariance @ move.T + noise
        expected = self.instant + count * self.interval
        late, variance = stamp - expected, covariance[0, 0] + self.scatter**2
        if late**2 > IRREGULAR**2 * variance:
            return FrameClock((stamp,), stamp)
        gain = covariance[:, 0] / variance
        covariance = covariance - np.outer(gain, covariance[0])
        instant, interval = np.array([expected, self.interval]) + gain * late
        square = self.scatter**2 * (1 + (late**2 / variance - 1) / SCATTER_FRAMES)
        number = self.count + 1
        mean = self.late + (late - self.late) / number
        # As many as tell half an interval from the scatter: then their mean begins anew.
        enough = number >= max(4, (2 * SURE * self.scatter / interval) ** 2)
        if enough:
            if abs(mean) > interval / 2:  # a drop was overlooked, or one seen that was none
                instant += interval * np.sign(mean)
            number, mean = 0, 0.0
        return FrameClock(
            (stamp,), float(instant), float(interval), (covariance + covariance.T) / 2,
            max(float(np.sqrt(square)), LEAST_S), mean, number,
        )  # fmt: skip

    def _frames_since(self, stamp: float) -> int:
        """Return the likeliest number of frames since the last image: dropped ones are rare."""
        step = stamp - self.instant
        most = max(int(np.ceil(step / self.interval)), 1)
        count = np.arange(max(most - 2, 1), most + 1)
        spread = self.covariance[0, 0] + count**2 * self.covariance[1, 1] + self.scatter**2
        doubt = (step - count * self.interval) ** 2 / (2 * spread)
        return int(count[np.argmin(doubt - count * np.log(DROPPED))])
