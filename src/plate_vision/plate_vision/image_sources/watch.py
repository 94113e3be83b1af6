"""Detection of faults in a stream of images: lost, late, black or frozen images.

Lost images are counted by gaps between stamps, late ones by their age at arrival. Black and frozen
images are detected on a coarse grid of pixels. The output are findings for diagnostics.
"""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

from plate_core.status import Finding, Level

LATE_S = 0.1
"""Age at arrival above which an image counts as late [s]. The planner estimates ages of images only
up to this value."""

INTERVALS = 15
"""Number of intervals between stamps whose median is the image interval."""

REGULAR, NEAR = 0.8, 0.2
"""Lost images are counted only if this fraction of the last intervals differs from the median by
less than this fraction of the median. A triggered camera may be irregular."""

GAP = 1.5
"""Time between two stamps above which images between them count as lost [image intervals]."""

MAX_LOST = 0.02
"""Fraction of lost or late images above which diagnostics warn. The planner tolerates more."""

BLACK = 12
"""Maximum grey level of a black image (8 bits). The noise of a covered sensor stays below it."""

ALIKE = 15
"""Number of consecutive black or equal images from which diagnostics report them: half a second at
30 images a second."""

GRID = 7
"""Step between compared rows and columns. It is odd, so that both kinds of columns of Bayer and YUV
images are compared."""


class Watch:
    """Counts of lost and late images since the last report, and the present state of the stream."""

    def __init__(self) -> None:
        self._last: tuple[float, np.ndarray] | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._black = self._equal = 0
        self.total = 0
        self.begin_report()

    def begin_report(self) -> None:
        """Reset the counts of a report."""
        self.images = self.lost = self.late = 0

    def add(self, pixels: np.ndarray, instant: float, arrival: float) -> None:
        """Record an image: its pixels, the start of its exposure, and its arrival [s]."""
        self.total += 1
        self.images += 1
        if arrival - instant > LATE_S:
            self.late += 1
        few = np.ascontiguousarray(pixels[::GRID, ::GRID])
        bright = few[..., 0] if few.ndim == 3 and few.shape[2] == 2 else few  # use only Y of YUYV
        level = BLACK << 8 if few.dtype == np.uint16 else BLACK
        self._black = self._black + 1 if int(bright.max(initial=0)) <= level else 0
        if self._last is not None:
            before, seen = self._last
            interval = instant - before
            if len(self._intervals) == INTERVALS:
                usual = median(self._intervals)
                near = sum(abs(each - usual) < NEAR * usual for each in self._intervals)
                if near >= REGULAR * INTERVALS and interval > GAP * usual:
                    self.lost += round(interval / usual) - 1
            self._intervals.append(interval)
            same = few.shape == seen.shape and np.array_equal(few, seen)
            self._equal = self._equal + 1 if same else 0
        self._last = (instant, few)

    def findings(self, live: bool) -> list[Finding]:
        """Return the faults. Equal images are a fault only if the source is live, not a film."""
        found = []
        if self._black >= ALIKE:
            found.append(
                Finding(
                    Level.ERROR,
                    "the image is black: remove the lens cap, switch the light on, or increase "
                    "exposure_us or gain",
                )
            )
        elif live and self._equal >= ALIKE:
            found.append(
                Finding(
                    Level.ERROR,
                    f"the image is frozen: the last {self._equal + 1} images are equal in every "
                    "pixel. Plug the camera in again",
                )
            )
        every = self.images + self.lost
        if self.lost > MAX_LOST * every:
            found.append(
                Finding(
                    Level.WARN,
                    f"{self.lost} of {every} images are lost: choose a lower rate or a smaller "
                    "format, or connect the camera to a separate USB controller",
                )
            )
        if self.late > MAX_LOST * self.images:
            found.append(
                Finding(
                    Level.WARN,
                    f"{self.late} of {self.images} images arrive more than {LATE_S:g} s after "
                    "their exposure: is the computer too busy, or exposure_us too long?",
                )
            )
        return found
