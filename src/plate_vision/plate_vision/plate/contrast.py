"""The contrast of an image to the bare plate. The definition is the same for darker, brighter and
coloured parts.

In each channel the deviation of a pixel from the bare plate is

    (plate - pixel) / plate                         if the pixel is darker,
    (pixel - plate) / max(plate, white - plate)     if it is brighter.

The contrast is the maximum over the channels. The grey levels of the contrast image are 255 (1 -
contrast). In this image, parts are dark on a white plate, independent of their colours in the
camera's image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from .light import LitPlate, fit_light
from .region import Region

MIN_CHANNEL = 20.0
"""Minimum brightness of the plate in a channel whose contrast is used [grey levels]. In a darker
channel, the noise and the dark current of the sensor are too large relative to the plate's
brightness."""

INNER = 0.6
"""Radius of the inner area of a disc [radii]. The disc's brightness is measured in this area, which
does not contain the blurred edge."""


class Channels(NamedTuple):
    """An image and the light on the plate in each of its channels.

    Attributes
    ----------
    image : (H, W, c) uint8
        The channels with enough light.
    lights : (c, 9) float32
        Light of each channel, as `LitPlate.light`.
    noise : float
        Maximum noise of these channels, as `LitPlate.noise`.
    """

    image: np.ndarray
    lights: np.ndarray
    noise: float


def channels_of(image: np.ndarray, plate: LitPlate, region: Region) -> Channels:
    """Fit the light in all channels of an image (H, W) or (H, W, 3). `plate` contains the grey
    levels of this image."""
    if image.ndim == 2:
        return Channels(plate.grey[:, :, None], plate.light[None], plate.noise)
    used, lights, noises = [], [], []
    for k in range(image.shape[2]):
        lit = fit_light(np.ascontiguousarray(image[:, :, k]), region, MIN_CHANNEL)
        if lit is not None:
            used.append(k)
            lights.append(lit.light)
            noises.append(lit.noise)
    if not used:
        return Channels(plate.grey[:, :, None], plate.light[None], plate.noise)
    chosen = image if len(used) == image.shape[2] else image[:, :, used]
    return Channels(np.ascontiguousarray(chosen), np.array(lights), max(noises))


def contrast_image(channels: Channels, region: Region) -> LitPlate | None:
    """Return the contrast as an image of dark parts on a lit plate. Return None if the image shows
    no plate."""
    out = np.full(channels.image.shape[:2], 255, np.uint8)
    _kernels.write_contrast(channels.image, channels.lights, region.box, out)
    return fit_light(out, region, 1.0)


def find_deviating_pixels(
    channels: Channels, limit: float, grid: tuple[int, int, int], shape: tuple[int, int]
) -> np.ndarray:
    """Return (h, w) uint8, which is 1 where a pixel of a grid deviates from the plate by more than
    a limit, and 0 elsewhere. `grid` is the first x, the first y and the step [px]. `shape` is
    (h, w)."""
    deviating = np.empty(shape, np.uint8)
    _kernels.find_deviating(channels.image, channels.lights, limit, grid, deviating)
    return deviating


def brightness(channels: Channels, places: np.ndarray, radii_px: np.ndarray) -> np.ndarray:
    """Return the median brightness (n,) of discs at places (n, 2) [px] with radii (n,) [px],
    relative to the bare plate, averaged over the channels."""
    return np.asarray(
        _kernels.find_brightness(channels.image, channels.lights, places, radii_px, INNER)
    )
