"""The background behind the parts. A background is either a bare plate that was learned from
images, or a model of a photograph's background.

`learn_plate` computes the median and the noise of several images. `model_background` fits a smooth
surface in Lab to the most frequent colour of one image. Both functions return the colour of each
pixel, and the deviation up to which a pixel counts as background. Colours are in the colour space
Lab, which OpenCV scales to 8 bits (L 0 to 255, a and b about 128). An image in grey levels has one
channel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from .. import _kernels
from ..errors import ImageError, check_image, check_size
from ..plate.region import Region, make_region, quadratic_terms
from .lighting import Light, Lit, apply_light, fit_light

CHROMA = (0.5, 2.0)
"""Range of the weight of a and b relative to L in a deviation. The weight is chosen so that the
noise of a and b equals the noise of L. The colour difference of the CIE (International Commission
on Illumination) has the weight 2.55, because the CIE's L is 0 to 100 and not 0 to 255."""

SIGMAS = 3.5
"""Maximum deviation of a background pixel from the background, in standard deviations of the
background's noise."""

MIN_NOISE = 2.5
"""Minimum assumed standard deviation of a background [L]. Rounding and JPEG compression cause this
noise."""

NEAR_PX = 16
"""Half the side of the window in which the noise of the bare plate is averaged [px]."""

SHIFT_PX = 0.2
"""Error with which the plate returns home [px]. This error displaces the plate's texture in the
image."""

MAX_PIXELS = 30_000
"""Maximum number of pixels of a photograph that are evaluated for its background."""

MODES = 5
"""Number of frequent colours of a photograph that are tried as its background."""

NEAR_MODE = 18.0
"""Initial maximum deviation of the background's pixels from a frequent colour of a photograph
[L]."""

TERMS = (1, 3, 6, 6, 6)
"""Numbers of terms of the surface in successive fits. The surface is constant with 1, linear with
3, and quadratic with 6 terms."""

BORDER = 0.03
"""Width of the border of a photograph, relative to its shorter side."""

BORDER_WEIGHT = 0.5
"""Weight of the border in the score of a background."""

LOCAL = 0.12
"""Standard deviation of the Gaussian filter that averages the background's colour, relative to the
shorter side of the image [-]. This standard deviation is larger than a part."""

LOCAL_PASSES = 3
"""Number of successive averages of the background's colour. Each average uses the pixels that agree
with the previous average."""

MIN_FRACTION = 0.05
"""Minimum fraction of background pixels around a pixel. Below this fraction, the background is
adapted less at the pixel."""

TEXTURE_PERCENT = 98
"""Percentile of the deviations of a photograph's background pixels from the mean background.
Deviations up to this percentile are texture."""

TEXTURE = 1.25
"""Maximum deviation of a photograph's background pixel, relative to the percentile of the
deviations (`TEXTURE_PERCENT`). Pixels of parts have larger deviations than this maximum."""

SOFTER_PX = (1.0, 1.5, 2.0, 2.5, 3.0)
"""Blurs that are tried as the additional blur of an image, compared with the images of the bare
plate [px]."""

EDGE_PX = 4
"""Width of the border along the plate's edge in which the additional blur of an image is measured
[px]."""

SOFTER = 0.2
"""Minimum fraction of the pixels at the plate's edge that differ from the bare plate. Below this
fraction, no additional blur of the image is assumed."""

EXPLAINED = 0.1
"""Maximum fraction of the pixels at the plate's edge that differ from the bare plate after the best
additional blur was applied to it. Above this fraction, the plate has probably moved."""

SPECK = 100.0
"""Minimum deviation of a speck from its neighbours [L]. A speck is a single pixel, for example
dust."""

SPECKS = 0.004
"""Maximum fraction of the pixels that may be specks. Above this fraction of pixels, specks are
filtered out."""

MIN_SCORE = 0.4
"""Minimum score of a background. The score is the fraction of the image that agrees with the
background, plus BORDER_WEIGHT times the fraction of the border that agrees."""

BLOCK = 12.0
"""Side of the bins in which frequent colours are counted [L]."""


@dataclass(frozen=True, eq=False)
class Background:
    """The background of an image: the colours that it shows where there are no parts.

    Attributes
    ----------
    lab : (H, W, C) uint8
        Colours: C = 3, L, a, b; or C = 1, grey levels.
    limit : (H, W) uint8
        Maximum deviation of a pixel from these colours for which it counts as background [L]. The
        function `deviation` computes such deviations.
    chroma : float
        Weight of a and b relative to L in a deviation.
    cleaned : bool
        Whether specks are filtered out of images before they are compared. This filter is necessary
        because photographs may show dust and dead pixels.
    learned : bool
        Whether the background was learned from images of the bare plate. If False, the background
        is modelled.
    """

    lab: np.ndarray
    limit: np.ndarray
    chroma: float = CHROMA[1]
    cleaned: bool = False
    learned: bool = False

    @property
    def grey(self) -> np.ndarray:
        """Grey levels (H, W) uint8. For a background in colours, the grey levels are the green
        channel."""
        if self.lab.shape[2] == 1:
            return self.lab[:, :, 0]
        return np.asarray(cv2.cvtColor(self.lab, cv2.COLOR_LAB2BGR)[:, :, 1])

    def light_of(
        self, image: np.ndarray, region: Region | None = None, before: Light | None = None
    ) -> Light:
        """Return the light of an image (H, W) or (H, W, 3) uint8, relative to the light of the
        background. The image may show parts. Only pixels within the region are used; None: the
        whole image. `before` is the light of the previous image.

        Raises
        ------
        ImageError
            If the image has another size than the background, or if too little of the background is
            visible.
        """
        if self.cleaned:
            image, convert = colours_like(image, self), _unchanged
        else:
            image = np.asarray(image)
            check_image(image)
            _check_size(image, self)
            convert = partial(to_channels, channels=self.lab.shape[2])
        region = region or make_region(self.lab.shape[1::-1])
        return fit_light(Lit(image, convert, self.lab, self.limit, self.chroma, region), before)

    def under(self, light: Light, region: Region | None = None) -> Background:
        """Return a copy of the background whose colours within a region are those in another light.
        Without a region, the whole image is changed."""
        region = region or make_region(self.lab.shape[1::-1])
        return replace(self, lab=apply_light(self.lab, light, region))

    def softened(self, image: np.ndarray, region: Region) -> Background:
        """Return the background with the blur of an image (H, W) or (H, W, 3) uint8 in the same
        light. The image has additional blur if the camera went out of focus after the bare plate
        was learned. The plate's edge is then wider in the image."""
        usable = region.usable.astype(np.uint8)
        inner = cv2.erode(usable, np.ones((2 * EDGE_PX + 1,) * 2, np.uint8), borderValue=0)
        rows, columns = np.nonzero(usable > inner)
        if not len(rows):
            return self
        pixels = np.asarray(image)[rows, columns][:, None]
        now = to_channels(pixels, self.lab.shape[2])[:, 0, 0].astype(np.float32)
        limit = self.limit[rows, columns]

        def differing_fraction(light: np.ndarray) -> float:
            return float(np.mean(np.abs(light[rows, columns] - now) > limit))

        light = self.lab[:, :, 0].astype(np.float32)
        if differing_fraction(light) < SOFTER:
            return self
        left, blur = min(
            (differing_fraction(cv2.GaussianBlur(light, (0, 0), b)), b) for b in SOFTER_PX
        )
        if left > EXPLAINED:
            return self
        return replace(self, lab=cv2.GaussianBlur(self.lab, (0, 0), blur).reshape(self.lab.shape))

    def followed(self, image: np.ndarray, region: Region | None = None) -> Background:
        """Return the background in the light of an image: see `light_of`."""
        return self.under(self.light_of(image, region), region)


def learn_plate(images: np.ndarray) -> Background:
    """Learn the bare plate from its images (n, H, W) or (n, H, W, 3) uint8, n >= 1.

    Raises
    ------
    ImageError
        If the images are not uint8, or if they have another shape.
    """
    images = np.asarray(images)
    if images.ndim not in (3, 4) or not len(images):
        raise ImageError(f"images: shape is {images.shape}, allowed: (n, H, W) or (n, H, W, 3)")
    labs = np.stack([colours(image) for image in images])
    mean = np.median(labs, axis=0).astype(np.uint8) if len(labs) > 2 else labs[0]
    # If there is only one image, its noise is the deviation from the median of neighbouring pixels.
    bare = mean if len(labs) > 1 else cv2.medianBlur(mean, 5).reshape(mean.shape)
    chroma = _chroma_weight(labs, bare)
    square = np.mean([deviation(lab, bare, chroma).astype(np.float32) ** 2 for lab in labs], axis=0)
    side = 2 * NEAR_PX + 1
    square = cv2.blur(square, (side, side))
    noise = np.sqrt(square + (SHIFT_PX / 8 * steepness(mean[:, :, 0])) ** 2)
    return Background(mean, _deviation_limit(noise), chroma, learned=True)


def model_background(image: np.ndarray) -> Background:
    """Return a model of the background of one image (H, W) or (H, W, 3) uint8 that contains parts.

    The background is the smooth surface in Lab that agrees with the largest fraction of the image
    and of its border. The surface follows gradual changes across the image. Pixels that are
    brighter or darker than the background may be parts.

    Raises
    ------
    ImageError
        If the image is not uint8, or has another shape.
    """
    lab = colours(image)
    clean = _remove_specks(lab)
    dirty = bool(
        np.count_nonzero(deviation(lab, clean, CHROMA[1]) > SPECK) > SPECKS * lab[:, :, 0].size
    )
    if dirty:
        lab = clean
    height, width, channels = lab.shape
    step = int(np.ceil(np.sqrt(height * width / MAX_PIXELS)))
    size = max(width // step, 1), max(height // step, 1)
    small = cv2.resize(lab, size, interpolation=cv2.INTER_AREA).reshape(size[1], size[0], channels)
    values = small.reshape(-1, channels).astype(np.float32)
    rows, columns = np.mgrid[: size[1], : size[0]]
    design = _surface_terms(columns.ravel(), rows.ravel(), size)
    edge = np.min([rows, columns, size[1] - 1 - rows, size[0] - 1 - columns], axis=0).ravel()
    border = edge <= BORDER * min(size)
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for mode in _most_frequent_colours(values):
        if best is not None and best[2][mode]:
            continue  # the best surface so far already includes this colour
        fit = np.zeros((design.shape[1], channels), np.float32)
        fit[0] = values[mode]
        near = NEAR_MODE
        kept = np.ones(len(values), bool)
        for terms in TERMS:
            kept = _colour_magnitudes(values - design @ fit, CHROMA[1]) <= near
            if np.count_nonzero(kept) < 50:
                break
            part = design[kept][:, :terms]
            fit[:terms] = np.linalg.lstsq(part.T @ part, part.T @ values[kept], rcond=None)[0]
            rest = _colour_magnitudes(values[kept] - part @ fit[:terms], CHROMA[1])
            near = SIGMAS * max(float(np.sqrt(np.median(rest**2))), MIN_NOISE)
        score = float(np.mean(kept)) + BORDER_WEIGHT * float(np.mean(kept[border]))
        if best is None or score > best[0]:
            best = score, design @ fit, kept
    nothing = Background(lab, np.full((height, width), 255, np.uint8))
    if best is None or best[0] < MIN_SCORE:
        return nothing
    surface, kept = _adapt_locally(values, best[1], best[2], size)
    grown = cv2.resize(surface.reshape(size[1], size[0], channels), (width, height))
    bare = _round_colours(grown).reshape(lab.shape)
    inner = cv2.erode(kept.reshape(size[1], size[0]).astype(np.uint8), np.ones((3, 3), np.uint8))
    shown = cv2.resize(inner, (width, height), interpolation=cv2.INTER_NEAREST) > 0
    deviations = deviation(lab, bare, CHROMA[1])[shown]
    if not len(deviations):
        return nothing
    noise = float(np.percentile(deviations, TEXTURE_PERCENT)) * TEXTURE / SIGMAS
    limit = _deviation_limit(np.full((height, width), noise, np.float32))
    return Background(bare, limit, cleaned=dirty)


def _adapt_locally(
    values: np.ndarray, surface: np.ndarray, kept: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Adapt a background (n, C) to gradual changes of the colours (n, C) at the pixels that agree
    with it (`kept` (n,)). Return the changed background, and the pixels that agree with it."""
    width = LOCAL * min(size)
    for _ in range(LOCAL_PASSES):
        rest = np.where(kept[:, None], values - surface, 0).reshape(size[1], size[0], -1)
        weight = kept.astype(np.float32).reshape(size[1], size[0])
        total = cv2.GaussianBlur(weight, (0, 0), width).reshape(-1, 1)
        change = cv2.GaussianBlur(rest, (0, 0), width).reshape(values.shape)
        surface = surface + change / np.maximum(total, MIN_FRACTION)
        magnitude = _colour_magnitudes(values - surface, CHROMA[1])
        kept = magnitude <= SIGMAS * max(1.2 * float(np.median(magnitude[kept])), MIN_NOISE)
    return surface.astype(np.float32), kept


def colours(image: np.ndarray) -> np.ndarray:
    """Return an image in Lab, (H, W, 3) uint8. An image in grey levels is returned as (H, W, 1)."""
    image = np.asarray(image)
    check_image(image)
    if image.ndim == 2:
        return np.ascontiguousarray(image)[:, :, None]
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2LAB))


def colours_like(image: np.ndarray, background: Background) -> np.ndarray:
    """Return an image's colours (H, W, C) with the channels of a background. If necessary, grey
    levels are converted to colours, or colours to grey levels."""
    image = np.asarray(image)
    check_image(image)
    _check_size(image, background)
    lab = to_channels(image, background.lab.shape[2])
    return _remove_specks(lab) if background.cleaned else lab


def to_channels(image: np.ndarray, channels: int) -> np.ndarray:
    """Return the colours (H, W, C) of pixels (H, W) or (H, W, 3) uint8 with `channels` channels."""
    if (image.ndim == 2) != (channels == 1):
        code = cv2.COLOR_GRAY2BGR if image.ndim == 2 else cv2.COLOR_BGR2GRAY
        image = cv2.cvtColor(np.ascontiguousarray(image), code)
    return colours(image)


def _unchanged(lab: np.ndarray) -> np.ndarray:
    return lab


def _check_size(image: np.ndarray, background: Background) -> None:
    why = ", the size of the background"
    check_size("image:", image.shape[1::-1], background.lab.shape[1::-1], why=why)


def _remove_specks(lab: np.ndarray) -> np.ndarray:
    """Return colours (H, W, C) without single pixels that differ from their neighbours."""
    return np.asarray(cv2.medianBlur(lab, 3)).reshape(lab.shape)


def steepness(
    image: np.ndarray, weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> np.ndarray:
    """Return the gradient (H, W) of an image (H, W) or (H, W, C), computed by the Sobel filter. The
    gradient of each channel is multiplied by the weight of this channel. The result is the maximum
    over the channels."""
    slopes = [
        weight
        * np.hypot(cv2.Sobel(channel, cv2.CV_32F, 1, 0), cv2.Sobel(channel, cv2.CV_32F, 0, 1))
        for channel, weight in zip(cv2.split(image), weights, strict=False)
    ]
    return np.asarray(np.max(slopes, axis=0))


def deviation(lab: np.ndarray, bare: np.ndarray, chroma: float) -> np.ndarray:
    """Return the deviation (H, W) uint8 [L] between colours `lab` and `bare` (H, W, C) uint8:
    sqrt(dL^2 + chroma^2 (da^2 + db^2)), clipped to 255.
    """
    out = np.empty(lab.shape[:2], np.uint8)
    _kernels.deviation(lab, bare, chroma, out)
    return out


def _chroma_weight(labs: np.ndarray, bare: np.ndarray) -> float:
    """Return the weight of a and b with which their noise equals the noise of L."""
    if bare.shape[2] == 1:
        return CHROMA[1]
    noise = np.mean((labs.astype(np.float32) - bare) ** 2, axis=(0, 1, 2))
    light, chroma = np.sqrt(np.maximum([noise[0], 0.5 * (noise[1] + noise[2])], 0.5))
    return float(np.clip(light / chroma, *CHROMA))


def _colour_magnitudes(change: np.ndarray, chroma: float) -> np.ndarray:
    """Return the magnitudes (n,) of colour differences (n, C). `chroma` is the weight of a and b
    relative to L."""
    weights = np.array([1, chroma, chroma][: change.shape[1]], np.float32)
    return np.asarray(np.sqrt(np.sum((change * weights) ** 2, axis=1)))


def _deviation_limit(noise: np.ndarray) -> np.ndarray:
    return np.asarray(np.clip(SIGMAS * np.maximum(noise, MIN_NOISE), 0, 255).astype(np.uint8))


def _surface_terms(x: np.ndarray, y: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Return the terms (..., 6) of a quadratic surface at pixels (...) of an image."""
    scale = 0.5 * max(size_px)
    u, v = (x - 0.5 * size_px[0]) / scale, (y - 0.5 * size_px[1]) / scale
    return quadratic_terms(u.astype(np.float32), v.astype(np.float32))


def _round_colours(lab: np.ndarray) -> np.ndarray:
    """Round values (..., C) to the nearest colours uint8."""
    return np.clip(np.rint(lab), 0, 255).astype(np.uint8)


def _most_frequent_colours(values: np.ndarray) -> np.ndarray:
    """Return the indices (m,) of those values (n, C) that represent the most frequent colours."""
    bins = np.floor(values / BLOCK).astype(np.int64)
    keys = bins @ (1000 ** np.arange(values.shape[1]))
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    chosen = np.argsort(-counts)[:MODES]
    inverse = inverse.ravel()
    found = []
    for k in chosen:
        members = np.flatnonzero(inverse == k)
        gap = _colour_magnitudes(values[members] - np.median(values[members], axis=0), CHROMA[1])
        found.append(members[np.argmin(gap)])
    return np.array(found)
