"""The contrast of an image to the bare plate: the same for darker, brighter and coloured parts.

The deviation of a pixel from the bare plate is, in each channel, (plate - pixel) / plate if it is
darker, and (pixel - plate) / max(plate, white - plate) if it is brighter. The contrast is the
largest of all channels. As an image it is 255 (1 - contrast): parts are dark on a white plate,
whatever they are in the camera's image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from .light import LitPlate, fit_light
from .region import Region

LEAST_CHANNEL = 20.0
"""Darkest plate in a channel of which the contrast is used [grey levels]: below, noise and dark
current are too large a part of it."""

INNER = 0.6
"""Inner part of a disc, in radii, whose brightness is taken: away from the blurred edge."""


class Channels(NamedTuple):
    """An image and the light on the plate in each of its channels.

    Attributes
    ----------
    image : (H, W, c) uint8
        The channels with enough light.
    lights : (c, 9) float32
        As `LitPlate.light`.
    noise : float
        The largest of their noises, as `LitPlate.noise`.
    """

    image: np.ndarray
    lights: np.ndarray
    noise: float


def channels_of(image: np.ndarray, plate: LitPlate, region: Region) -> Channels:
    """Fit the light in all channels of an image (H, W) or (H, W, 3), of which `plate` is the grey
    levels."""
    if image.ndim == 2:
        return Channels(plate.grey[:, :, None], plate.light[None], plate.noise)
    used, lights, noises = [], [], []
    for k in range(image.shape[2]):
        lit = fit_light(np.ascontiguousarray(image[:, :, k]), region, LEAST_CHANNEL)
        if lit is not None:
            used.append(k)
            lights.append(lit.light)
            noises.append(lit.noise)
    if not used:
        return Channels(plate.grey[:, :, None], plate.light[None], plate.noise)
    chosen = image if len(used) == image.shape[2] else image[:, :, used]
    return Channels(np.ascontiguousarray(chosen), np.array(lights), max(noises))


def contrast_image(channels: Channels, region: Region) -> LitPlate | None:
    """Return the contrast as an image of dark parts on a lit plate; None if there is no plate."""
    out = np.full(channels.image.shape[:2], 255, np.uint8)
    _kernels.write_contrast(channels.image, channels.lights, region.box, out)
    return fit_light(out, region, 1.0)


def find_odd(
    channels: Channels, limit: float, grid: tuple[int, int, int], shape: tuple[int, int]
) -> np.ndarray:
    """Return which pixels (h, w) uint8, 0 or 1, deviate from the plate by more than a limit, on a
    grid (first x, first y, step [px])."""
    odd = np.empty(shape, np.uint8)
    _kernels.find_odd(channels.image, channels.lights, limit, grid, odd)
    return odd


def brightness(channels: Channels, places: np.ndarray, radii_px: np.ndarray) -> np.ndarray:
    """Return the median brightness (n,) of discs at places (n, 2) [px] of radii (n,) [px], relative
    to the bare plate: the mean of all channels."""
    return np.asarray(
        _kernels.find_brightness(channels.image, channels.lights, places, radii_px, INNER)
    )
