"""The light on the plate: its brightness where no part lies, a smooth surface; and what is wrong
with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from .region import Region

DARK_PERCENTILE, BURNT_PERCENTILE = 95, 50
"""Percentage of an image: below its brightness there is too little light, a twentieth may be lamps
and glare; too much, a plate that is burnt out fills more than half of the image."""

BURNT_GREY = 254
"""Grey level from which a pixel may have been any brighter."""

EVERY = 8
"""Of the image every eighth row and column is looked at for these."""


class LitPlate(NamedTuple):
    """An image, and by what parts are told from the plate in it: what the kernels take.

    Attributes
    ----------
    grey : (H, W) uint8
        Grey levels.
    light : (9,) float32
        The bare plate's brightness: a to f [grey levels] of
        a + b u + c v + d u2 + e u v + f v2; the image point [px] where u = v = 0; one over the
        length [px] of one unit of u and v.
    usable : (H, W) bool
        Pixels that show the plate, clear of its edge.
    noise : float
        Standard deviation of the bare plate's pixels, relative to its brightness [-].
    """

    grey: np.ndarray
    light: np.ndarray
    usable: np.ndarray
    noise: float

    @property
    def pixels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All but the noise, as the kernels take it."""
        return self.grey, self.light, self.usable


def fit_light(grey: np.ndarray, region: Region, min_grey: float) -> LitPlate | None:
    """Fit the bare plate's brightness to the pixels of an image (H, W) uint8 that show no part.

    None if there is no plate as bright as `min_grey` [grey levels].
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
    """Return what is wrong with the light of an image (H, W) or (H, W, 3) uint8, or None.

    `min_grey` is the darkest plate that is believed [grey levels].
    """
    sample = image[::EVERY, ::EVERY]
    grey = sample if sample.ndim == 2 else sample[:, :, 1]
    bright, middle = np.percentile(grey, (DARK_PERCENTILE, BURNT_PERCENTILE))
    if bright < min_grey:
        return (
            f"{DARK_PERCENTILE} % of the image is darker than {bright:.0f} grey levels, allowed: "
            f"a plate of {min_grey:g} at least (is the light on, the lens open?)"
        )
    if middle >= BURNT_GREY:
        return (
            f"half of the image is burnt out ({middle:.0f} grey levels), allowed: less than "
            f"{BURNT_GREY} (expose for a shorter time)"
        )
    return None
