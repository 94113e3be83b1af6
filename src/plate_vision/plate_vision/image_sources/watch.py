"""Detection of faults in a stream of images: lost, late, black or frozen images.

Lost images are detected by the gaps between stamps, and late images by their age at arrival. Black
and frozen images are detected on a coarse grid of pixels. The results are findings for the
diagnostics.
"""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

from plate_core.status import Finding, Level

LATE_S = 0.1
"""Maximum age of an image at arrival [s]. An older image counts as late, because the planner
estimates the ages of images only up to this value."""

INTERVALS = 15
"""Number of intervals between stamps. The median of these intervals is the image interval."""

REGULAR, NEAR = 0.8, 0.2
"""REGULAR: minimum fraction of the last intervals that must be near the median [-]. NEAR: maximum
deviation of such an interval from the median, relative to the median [-]. If the intervals are less
regular, lost images are not counted, because a triggered camera may be irregular."""

GAP = 1.5
"""Maximum time between two stamps [image intervals]. After a longer time, the images that are
missing between the two stamps are counted as lost."""

MAX_LOST = 0.02
"""Maximum fraction of lost or late images without a warning in the diagnostics [-]. The planner
tolerates a larger fraction of lost or late images."""

BLACK = 12
"""Maximum grey level of all pixels in a black image (8 bits). The noise of a covered sensor is
below this value."""

ALIKE = 15
"""Minimum number of consecutive black or equal images that the diagnostics report. At 30 images per
second, this number corresponds to half a second."""

GRID = 7
"""Step of the grid of pixels that are evaluated, in rows and columns. The step is odd, so that both
even and odd columns are evaluated. Even and odd columns differ in Bayer and YUV images."""


class Watch:
    """Numbers of lost and late images since the last report, and the present state of the
    stream."""

    def __init__(self) -> None:
        self._last: tuple[float, np.ndarray] | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._black = self._equal = 0
        self.total = 0
        self.begin_report()

    def begin_report(self) -> None:
        """Reset the counts when a new report begins."""
        self.images = self.lost = self.late = 0

    def add(self, pixels: np.ndarray, instant: float, arrival: float) -> None:
        """Record an image. Input: its pixels, the start of its exposure [s], and the time of its
        arrival [s]."""
        self.total += 1
        self.images += 1
        if arrival - instant > LATE_S:
            self.late += 1
        few = np.ascontiguousarray(pixels[::GRID, ::GRID])
        # of a YUYV image, use only the brightness Y
        bright = few[..., 0] if few.ndim == 3 and few.shape[2] == 2 else few
        level = BLACK << 8 if few.dtype == np.uint16 else BLACK
        self._black = self._black + 1 if int(bright.max(initial=0)) <= level else 0
        if self._last is not None:
            before, seen = self._last
            interval = instant - before
            if len(self._intervals) == INTERVALS:
                usual = median(self._intervals)
                near = sum(abs(earlier - usual) < NEAR * usual for earlier in self._intervals)
                if near >= REGULAR * INTERVALS and interval > GAP * usual:
                    self.lost += round(interval / usual) - 1
            self._intervals.append(interval)
            same = few.shape == seen.shape and np.array_equal(few, seen)
            self._equal = self._equal + 1 if same else 0
        self._last = (instant, few)

    def findings(self, live: bool) -> list[Finding]:
        """Return the faults of the stream as findings. Equal images are a fault only if the source
        is live. In a film, equal images are allowed."""
        found = []
        if self._black >= ALIKE:
            found.append(
                Finding(
                    Level.ERROR,
                    "the image is black; remove the lens cap, switch the light on, or increase "
                    "exposure_us or gain",
                )
            )
        elif live and self._equal >= ALIKE:
            found.append(
                Finding(
                    Level.ERROR,
                    f"the image is frozen: the last {self._equal + 1} images are equal; plug the "
                    "camera in again",
                )
            )
        every = self.images + self.lost
        if self.lost > MAX_LOST * every:
            found.append(
                Finding(
                    Level.WARN,
                    f"{self.lost} of {every} images are lost; choose a lower rate or a smaller "
                    "format, or connect the camera to a separate USB controller",
                )
            )
        if self.late > MAX_LOST * self.images:
            found.append(
                Finding(
                    Level.WARN,
                    f"{self.late} of {self.images} images arrive more than {LATE_S:g} s after "
                    "their exposure; the computer may be too busy, or exposure_us too long",
                )
            )
        return found
