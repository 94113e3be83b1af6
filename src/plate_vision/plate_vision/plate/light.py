"""The light on the plate: the brightness of the bare plate as a quadratic surface, and defects of
the light.

`fit_light` fits the surface to sampled pixels in two steps. Each step uses only pixels with about
the brightness of the previous estimate, so that parts have no effect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..camera.encodings import grey_levels
from ..errors import ImageError
from .region import Region

DARK_PERCENTILE = 95
"""Percentile of an image's brightness that shows too little light. If this percentile is below the
plate's minimum brightness, there is too little light. The brightest twentieth of the image is
ignored, because it may show lamps and reflections."""

BURNT_FRACTION, BURNT_PLATE_FRACTION = 0.5, 0.2
"""Fraction of an image, or of the plate in it, that shows too much light. If at least this fraction
of the pixels is overexposed, there is too much light. White parts usually cover less of the
plate."""

BURNT_GREY = 254
"""Minimum grey level of an overexposed pixel."""

BLACK_GREY = 8
"""Maximum grey level of a pixel that the camera did not transmit."""

MISSING = 0.1
"""Minimum fraction of the plate's rows that are missing in an incomplete image."""

SHARP_ROWS, SHARP = 4, 0.7
"""An image ends between two rows if the brightness of the last row is at least the fraction `SHARP`
of the brightness `SHARP_ROWS` rows above. The last row of a blurred edge is darker."""

EVERY = 8
"""Step between the rows and columns that are evaluated for the percentiles of the brightness."""


class LitPlate(NamedTuple):
    """An image with the brightness of the bare plate: the input of the kernels.

    Attributes
    ----------
    grey : (H, W) uint8
        Grey levels.
    light : (9,) float32
        Brightness of the bare plate. The first six numbers are the coefficients a to f [grey
        levels] of a + b u + c v + d u^2 + e u v + f v^2. The next two numbers are the image point
        [px] where u = v = 0. The last number is the reciprocal of the length [px] of one unit of u
        and v.
    usable : (H, W) bool
        Whether a pixel shows the plate and is not near the plate's edge.
    noise : float
        Standard deviation of the bare plate's pixels, relative to its brightness [-].
    """

    grey: np.ndarray
    light: np.ndarray
    usable: np.ndarray
    noise: float

    @property
    def pixels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The arrays without the noise, for the kernels."""
        return self.grey, self.light, self.usable


def fit_light(grey: np.ndarray, region: Region, min_grey: float) -> LitPlate | None:
    """Fit the brightness of the bare plate to an image (H, W) uint8. Parts in the image have no
    effect.

    Return None if there is no plate with at least the brightness `min_grey` [grey levels].
    """
    samples = region.samples
    if not len(samples.rows):
        return None
    surface = _kernels.fit_light(grey, samples.rows, samples.columns, samples.design, min_grey)
    if not len(surface):
        return None
    light = np.concatenate([surface[:-1], samples.place])
    return LitPlate(grey, light, region.usable, float(surface[-1]))


def check_complete(image: np.ndarray, region: Region) -> None:
    """Refuse an image (H, W) or (H, W, 3) uint8 whose last rows are black, although the plate is
    there.

    A driver delivers such images if it loses the end of a transmitted image. The image then changes
    from the plate to black between two rows. The edge of a plate that lies elsewhere is blurred
    over several rows.

    Raises
    ------
    ImageError
        If at least the fraction `MISSING` of the plate's rows is missing.
    """
    x0, y0, x1, y1 = region.box
    plate = image[:, x0:x1:EVERY] if image.ndim == 2 else image[:, x0:x1:EVERY, 1]
    if not plate.size or plate[-1].max() > BLACK_GREY:
        return
    lit = np.flatnonzero(plate.max(axis=1) > BLACK_GREY)
    last = int(lit[-1]) if len(lit) else -1
    if last < y0 + SHARP_ROWS or y1 - 1 - last < MISSING * (y1 - y0):
        return
    # only the left side, because the last transmitted row can end anywhere
    left = max(1, plate.shape[1] // 4)
    edge, before = (np.median(plate[row, :left]) for row in (last, last - SHARP_ROWS))
    if edge >= SHARP * before and before > BLACK_GREY:
        raise ImageError(
            f"image: the last {len(image) - 1 - last} rows are black, allowed: complete images; "
            "the camera or its driver loses the end of the image: check the cable, and the "
            "driver's messages about lost data"
        )


def light_problem(
    image: np.ndarray, min_grey: float, region: Region | None = None, plate_found: bool = False
) -> str | None:
    """Return a message about a defect of the light in an image (H, W) or (H, W, 3) uint8, or None.

    `min_grey` is the minimum brightness of the plate [grey levels]. If there is a `region`, the
    plate in this region must be bright enough for `fit_light`. If `plate_found` is true,
    `fit_light` has already found the plate in this image, and is not called again.
    """
    sample = image[::EVERY, ::EVERY]
    grey = sample if sample.ndim == 2 else sample[:, :, 1]
    bright = np.percentile(grey, DARK_PERCENTILE)
    if bright < min_grey:
        return (
            f"{DARK_PERCENTILE} % of the image has at most {bright:.0f} grey levels, allowed: "
            f"a plate of at least {min_grey:g}; check that the light is on and the lens is open"
        )
    what, limit = "image", BURNT_FRACTION
    if region is not None:
        grey = grey[region.usable[::EVERY, ::EVERY]]
        what, limit = "plate", BURNT_PLATE_FRACTION
    burnt = np.count_nonzero(grey >= BURNT_GREY) / max(grey.size, 1)
    if burnt >= limit:
        return (
            f"{burnt:.0%} of the {what} is overexposed (at least {BURNT_GREY} grey levels), "
            f"allowed: less than {limit:.0%}; reduce exposure time, light or reflections"
        )
    if region is None or plate_found:
        return None
    if fit_light(grey_levels(image), region, min_grey) is None:
        return (
            f"no plate of at least {min_grey:g} grey levels is visible at corners_px, allowed: an "
            "evenly lit plate; check light, camera cable and corners_px, and remove what covers "
            "the plate"
        )
    return None
