"""The light on the plate: the brightness of the bare plate as a quadratic surface, and defects of
the light.

`fit_light` fits the surface to sampled pixels in two steps. Each step uses only pixels with about
the brightness of the previous estimate, so that parts have no effect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from .region import Region

DARK_PERCENTILE = 95
"""Percentile of an image's brightness that shows too little light. If this percentile is below the
plate's minimum brightness, there is too little light. The brightest twentieth of the image is
ignored, because it may show lamps and reflections."""

BURNT_PERCENTILE = 50
"""Percentile of an image's brightness that shows too much light. If this percentile is at least
`BURNT_GREY`, there is too much light, because half of the image is overexposed."""

BURNT_GREY = 254
"""Minimum grey level of an overexposed pixel."""

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


def light_problem(image: np.ndarray, min_grey: float) -> str | None:
    """Return a message about a defect of the light in an image (H, W) or (H, W, 3) uint8, or None.

    `min_grey` is the minimum brightness of the plate [grey levels].
    """
    sample = image[::EVERY, ::EVERY]
    grey = sample if sample.ndim == 2 else sample[:, :, 1]
    bright, middle = np.percentile(grey, (DARK_PERCENTILE, BURNT_PERCENTILE))
    if bright < min_grey:
        return (
            f"{DARK_PERCENTILE} % of the image is darker than {bright:.0f} grey levels, allowed: "
            f"a plate of at least {min_grey:g}; check that the light is on and the lens is open"
        )
    if middle >= BURNT_GREY:
        return (
            f"half of the image is overexposed ({middle:.0f} grey levels), allowed: below "
            f"{BURNT_GREY}; reduce the exposure time"
        )
    return None
