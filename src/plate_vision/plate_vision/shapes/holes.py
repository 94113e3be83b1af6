"""Holes of parts that are missing in a measured outline, because they are dark or in a shadow.

If a type with holes is fitted to a patch without holes, the image inside the type's holes must look
like the plate with less light. The image there must not be brighter than the plate, and it must
have the plate's chroma.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plate_core.rig import to_home

from .. import _kernels
from ..camera.lens import Calibration
from .background import Background, to_channels
from .catalogue import Template
from .heights import magnification

DARKEST = 0.4
"""Minimum of L + 41 in a hole, relative to the same value of the plate [-]. L is 0 to 255."""

CHROMA_LIMIT = 1.5
"""Maximum deviation of a hole's chroma from the plate's chroma, relative to the maximum deviation
of plate pixels."""

SEEN = 0.3
"""Penalty for a hole that is missing in the outline, if the image in the hole looks like the plate
and not like the part [standard deviations]."""

UNSEEN = 2.0
"""Penalty for a hole that is missing in the outline, if the image in the hole looks both like the
plate and like the part [standard deviations]."""

SPARSE = 16
"""Step between the rows and columns that are evaluated for the typical noise."""


@dataclass(frozen=True, eq=False)
class HoleCheck:
    """An image, and the bare plate in the light of this image."""

    image: np.ndarray
    background: Background
    calibration: Calibration

    @cached_property
    def _median_limit(self) -> float:
        """Median of the maximum deviations of plate pixels [L]."""
        return float(np.median(self.background.limit[::SPARSE, ::SPARSE]))

    def penalty(self, template: Template, pose: np.ndarray) -> float | None:
        """Return the penalty for a type with holes that is fitted to a patch without these holes.
        `pose` (3,) is x, y [m], angle [rad]. Return None if the image in the holes does not
        look like the plate, or if the type has no holes."""
        if not template.part.holes:
            return None
        holes, plate = self._sample_colours(to_home(pose, template.hole_points), 0.0)
        body, _ = self._sample_colours(to_home(pose, template.inner), template.part.height_m)
        if not len(holes) or not len(body):
            return None
        inside_hole, bare, part = (np.median(colours, axis=0) for colours in (holes, plate, body))
        origin = _kernels.LIGHTNESS_0 if len(inside_hole) == 3 else 0.0
        light = (inside_hole[0] + origin) / (bare[0] + origin)
        limit, chroma = self._median_limit, self.background.chroma
        tint = chroma * (inside_hole[1:] - 128 - light * (bare[1:] - 128))
        noise = limit / max(bare[0], 1)
        if (
            not DARKEST < light < 1 + noise
            or np.hypot.reduce(tint, initial=0) > CHROMA_LIMIT * limit
        ):
            return None
        gap = inside_hole - part
        gap[1:] *= chroma
        return SEEN if float(np.sqrt(gap @ gap)) > limit else UNSEEN

    def _sample_colours(self, point: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the colours (n, C) of the image and of the bare plate at those n of the points (m,
        2) [m] that are in the image. The points are at a height [m]."""
        place = self.calibration.camera_position
        if height and place is not None:
            point = place[:2] + (point - place[:2]) * magnification(place, height)
        column, row = np.rint(self.calibration.to_image(point)).astype(int).T
        rows, columns = self.image.shape[:2]
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        row, column = row[inside], column[inside]
        bare = self.background.lab[row, column].astype(float)
        if not len(row):
            return bare, bare
        pixels = self.image[row, column][:, None]
        return to_channels(pixels, bare.shape[1])[:, 0].astype(float), bare
