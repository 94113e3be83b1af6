"""The light of one image on a known bare plate.

If the light or the exposure changes, all colours are multiplied by a factor. In Lab, such a change
multiplies L + 41, a - 128 and b - 128 by one factor, because each of these values is a difference
of cube roots. If the colour of the light changes, a and b are shifted. The factor and both shifts
are smooth surfaces. These surfaces are fitted only to those pixels of the plate's region that agree
with the surfaces, so that parts have no effect.

Parts may cover more than half of the plate. Therefore, the factor is a mode (frequent value) of the
ratios between image and plate. The ratios may have several frequent values (modes). Pixels that
showed the plate in the previous image have more weight in the choice, and a mode near the previous
factor is preferred.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from .. import _kernels
from ..errors import ImageError
from ..plate.region import Region

LIGHTNESS_0: float = _kernels.LIGHTNESS_0
"""Offset of L (0 to 255). L plus this offset is proportional to the cube root of the light. The
offset corresponds to 16 for CIE's L (0 to 100)."""

FACTORS = (0.2, 5.0)
"""Range of the light, relative to the light on the known plate. With less light than this range,
the plate would be as dark as parts. With more light, the image would be overexposed."""

MIN_SHOWN = 0.15
"""Minimum visible fraction of the plate. Parts may cover 60 %, and shadows may cover some of the
rest."""

COVERED_WEIGHT = 0.25
"""Weight of pixels that did not show the plate in the previous image."""

BIN = 0.02
"""Width of the bins in the histogram of the ratios. The width is a difference of natural
logarithms."""

SMOOTH = np.array([1, 2, 3, 2, 1]) / 9
"""Weights of the average over neighbouring bins."""

MODES = 4
"""Maximum number of modes of the histogram of the ratios that are tried as the light."""

MIN_MODE = 0.1
"""Minimum height of a mode of the histogram of the ratios, relative to the highest mode."""

APART = 3
"""Minimum distance between two modes of the histogram of the ratios [bins]."""

PASSES = ((1, 25.0), (3, 25.0), (6, 15.0), (6, 0.0), (6, 0.0))
"""Number of terms of the surfaces and tolerance [L] in each pass of the fit of a light. A pixel is
used if its deviation from the plate in the fitted light is at most the larger one of two limits:
this tolerance and the limit of the plate's noise. The first passes have larger tolerances, so that
a light from one side can be fitted."""

STEADY = 0.6
"""Minimum fraction of the plate that must agree with the last light so that no other light is
searched. With this fraction, no other light can agree with a larger fraction of the plate."""

STEADY_LIMIT = 0.6
"""Maximum deviation of a pixel that agrees with the last light, relative to the noise limit of the
plate. The value is below 1, so that a slight change of the light is noticed before it is as large
as the noise."""

EVEN = np.zeros((6, 3), np.float32)
"""Coefficients of the surfaces if the light is the same as in the image of the background."""
EVEN[0, 0] = 1
EVEN.setflags(write=False)

RIDGE = 0.002
"""Weight of the assumption that the surface is constant, relative to the weight of all pixels. The
assumption is necessary if the plate is visible in only one corner."""


AMBIGUOUS = 0.3
"""Minimum score of another light, relative to the score of the best light. The score is the
weighted number of pixels that agree with the light. The score decreases with the difference from
the previous light. Above this score, the areas that agree with each light are also compared. Pixels
of the plate are connected, but pixels of parts are many separate areas."""

EVERY = 2
"""Step between the rows and columns that are used to compare two lights."""

UNSEEN_L = 0.5
"""Maximum change of colours that is ignored [L]. This change is half of the colours' resolution,
which is 1."""

LIGHT_POWER = 3 / 2.2
"""Exponent that converts a factor in Lab to a factor of grey levels. Lab is proportional to the
cube root of the light, and grey levels are proportional to the light to the power of 1 / 2.2."""


@dataclass(frozen=True, eq=False)
class Light:
    """The light of an image on the plate, relative to the light of a background.

    Attributes
    ----------
    surface : (6, C) float32
        Coefficients (`region.quadratic`) of the factor and of the shifts of a and b [L]. C is 1 for
        grey levels and 3 for colours.
    shown : (K,) bool
        Whether each of `Region.samples` shows the plate.
    """

    surface: np.ndarray
    shown: np.ndarray

    @property
    def factor(self) -> float:
        """Light in the middle of the plate, relative to the background's light [-]."""
        middle = float(self.surface[0, 0])
        return middle if self.surface.shape[1] == 1 else middle**LIGHT_POWER


@dataclass(frozen=True, eq=False)
class Lit:
    """An image and the bare plate, whose colours in a region are compared.

    Attributes
    ----------
    image : (H, W) or (H, W, 3) uint8
        The image.
    convert : callable
        Function that converts pixels (h, w) or (h, w, 3) uint8 to colours (h, w, C) uint8 like the
        bare plate's.
    bare : (H, W, C) uint8
        Colours of the bare plate, C = 1 or 3.
    limit : (H, W) uint8
        Maximum deviation of a pixel from the plate for which it counts as plate [L].
    chroma : float
        Weight of a and b relative to L.
    region : Region
        Region of the plate in the image.
    """

    image: np.ndarray
    convert: Callable[[np.ndarray], np.ndarray]
    bare: np.ndarray
    limit: np.ndarray
    chroma: float
    region: Region

    def connected(self, surface: np.ndarray) -> float:
        """Return the area of the largest connected set of pixels that agree with a light (6, C),
        relative to the area of all such pixels."""
        every = np.s_[::EVERY, ::EVERY]
        lab, bare = self.convert(self.image[every]), np.ascontiguousarray(self.bare[every])
        x, y, unit = self.region.samples.place
        place = np.array([x / EVERY, y / EVERY, unit * EVERY], np.float32)
        lit, deviations = bare.copy(), np.empty(lab.shape[:2], np.uint8)
        _kernels.relight(bare, surface, place, (0, 0, *lab.shape[1::-1]), lit)
        _kernels.deviation(lab, lit, self.chroma, deviations)
        agrees = (deviations <= self.limit[every]) & self.region.usable[every]
        stats = cv2.connectedComponentsWithStats(agrees.astype(np.uint8), connectivity=4)[2]
        areas = stats[1:, cv2.CC_STAT_AREA]
        return float(areas.max() / areas.sum()) if len(areas) else 0.0


def fit_light(lit: Lit, before: Light | None = None) -> Light:
    """Fit the light of an image that also shows parts. `before` is the light of the previous image;
    None: unknown.

    Raises
    ------
    ImageError
        If too little of the plate agrees with any light.
    """
    samples = lit.region.samples
    rows, columns, design = samples.rows, samples.columns, samples.design.T
    seen = lit.convert(lit.image[rows, columns][:, None])[:, 0].astype(np.float32)
    known = lit.bare[rows, columns].astype(np.float32)
    limit = lit.limit[rows, columns].astype(np.float32)
    origin = np.array([0.0] if seen.shape[1] == 1 else [-LIGHTNESS_0, 128, 128], np.float32)
    weight = np.ones(len(rows))
    # The last result is used only if the number of pixels is the same. Another number of pixels
    # means that the region of the plate has changed.
    if before is not None and len(before.shown) == len(rows):
        weight[~before.shown] = COVERED_WEIGHT
    last = EVEN[:, : seen.shape[1]] if before is None else before.surface
    colours = seen - origin, known - origin, origin
    near = _colour_deviation(*colours, lit.chroma, design, last) <= STEADY_LIMIT * limit
    if np.mean(near) >= STEADY:
        return Light(*_fit_surfaces(*colours, limit, lit.chroma, design, last, PASSES[-2:]))
    last_value = float(np.log(max(last[0, 0], 1e-3)))
    ratio = np.log(np.maximum(seen[:, 0] - origin[0], 1) / np.maximum(known[:, 0] - origin[0], 1))
    found = []
    modes = _frequent_ratios(ratio, weight, seen.shape[1])
    level = float(np.median(seen[:, 0])) - origin[0]
    for mode in modes:
        # The limits are reduced, so that the fit excludes parts that are nearly as bright as the
        # plate.
        gap = min((abs(mode - other) for other in modes if other != mode), default=np.inf)
        surface, kept = _fit_surfaces(
            *colours,
            limit,
            lit.chroma,
            design,
            float(np.exp(mode)) * EVEN[:, : seen.shape[1]],
            tuple((terms, min(near, 0.5 * gap * level)) for terms, near in PASSES),
        )
        value = float(np.sum(weight[kept])) * np.exp(-abs(mode - last_value))
        found.append((value, surface, kept))
    found.sort(key=lambda candidate: -candidate[0])
    likely = [candidate for candidate in found if candidate[0] > AMBIGUOUS * found[0][0]]
    if len(likely) > 1:
        likely.sort(key=lambda candidate: -candidate[0] * lit.connected(candidate[1]))
    fraction = float(np.mean(likely[0][2])) if likely else 0.0
    if fraction < MIN_SHOWN:
        low, high = FACTORS
        raise ImageError(
            f"light: {100 * fraction:.0f} % of the plate looks like the bare plate, allowed: "
            f"{100 * MIN_SHOWN:.0f} % or more, at {100 * low:.0f} to {100 * high:.0f} % of the "
            "light during learning of the bare plate; check that the light is on and the camera "
            "was not moved; otherwise, call ~/learn_plate with an empty plate"
        )
    return Light(likely[0][1], likely[0][2])


def apply_light(bare: np.ndarray, light: Light, region: Region) -> np.ndarray:
    """Return the colours (H, W, C) uint8 of the bare plate in a light. The colours are unchanged if
    the light is the same."""
    change = region.samples.design.T @ light.surface
    if (
        np.max(np.abs(255 * (change[:, 0] - 1))) + np.max(np.abs(change[:, 1:]), initial=0)
        < UNSEEN_L
    ):
        return bare
    out = bare.copy()
    _kernels.relight(bare, light.surface, region.samples.place, region.box, out)
    return out


def _frequent_ratios(ratio: np.ndarray, weight: np.ndarray, channels: int) -> list[float]:
    """Return the most frequent values of the logarithms of ratios (K,) in the allowed range."""
    power = 1.0 if channels == 1 else LIGHT_POWER
    low, high = np.log(FACTORS) / power
    count = int((high - low) / BIN) + 1
    inside = (ratio > low) & (ratio < high)
    bins = ((ratio[inside] - low) / BIN).astype(int)
    found = np.convolve(np.bincount(bins, weight[inside], count), SMOOTH, "same")
    framed = np.concatenate([[0], found, [0]])
    peaks = np.flatnonzero((found >= framed[:-2]) & (found > framed[2:]))
    peaks = peaks[np.argsort(-found[peaks], kind="stable")]
    kept: list[int] = []
    for peak in peaks.tolist():
        apart = all(abs(peak - other) >= APART for other in kept)
        if apart and found[peak] > MIN_MODE * found[peaks[0]]:
            kept.append(peak)
    return [float(low + BIN * (peak + 0.5)) for peak in kept[:MODES]]


def _fit_surfaces(
    seen: np.ndarray,
    known: np.ndarray,
    origin: np.ndarray,
    limit: np.ndarray,
    chroma: float,
    design: np.ndarray,
    start: np.ndarray,
    passes: tuple[tuple[int, float], ...],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the surfaces (6, C) that transform the known colours to the seen colours (K, C). Also
    return an array (K,) that states which pixels agree with these surfaces.

    `origin` (C,) was subtracted from all colours. The iteration starts from `start` (6, C).
    `passes` has the same form as `PASSES`."""
    channels = seen.shape[1]
    surface = start.copy()
    mean = max(float(np.mean(known[:, 0])), 1.0)
    steep = design * (known[:, :1] / mean)
    ridge = RIDGE * len(seen) * np.diag([0.0, 1, 1, 1, 1, 1])
    kept = np.ones(len(seen), bool)
    for terms, near in passes:
        kept = _colour_deviation(seen, known, origin, chroma, design, surface) <= np.maximum(
            limit, near
        )
        if np.count_nonzero(kept) < 2 * design.shape[1]:
            return surface, np.zeros(len(seen), bool)
        part = steep[kept][:, :terms]
        square = part.T @ part + ridge[:terms, :terms]
        surface[:terms, 0] = np.linalg.solve(square, part.T @ (seen[kept, 0] / mean))
        if channels == 3:
            part = design[kept][:, :terms]
            square = part.T @ part + ridge[:terms, :terms]
            lit = known[kept, 1:] * (part @ surface[:terms, :1])
            surface[:terms, 1:] = np.linalg.solve(square, part.T @ (seen[kept, 1:] - lit))
    return surface, _colour_deviation(seen, known, origin, chroma, design, surface) <= limit


def _colour_deviation(
    seen: np.ndarray,
    known: np.ndarray,
    origin: np.ndarray,
    chroma: float,
    design: np.ndarray,
    surface: np.ndarray,
) -> np.ndarray:
    """Return the deviation (K,) [L] of the seen colours from the known colours in a light."""
    change = design @ surface
    lit = known * change[:, :1]
    lit[:, 1:] += change[:, 1:]
    gap = seen - np.clip(lit, -origin, 255 - origin)
    gap[:, 1:] *= chroma
    return np.asarray(np.sqrt(np.sum(gap**2, axis=1)))
