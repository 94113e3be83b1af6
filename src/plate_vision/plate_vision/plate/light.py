"""The light on the plate: its brightness where no part lies, a smooth surface; and what is wrong
with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel

from .region import Region, Samples

BRIGHT_PERCENTILE = 75.0
"""First guess of the plate's brightness: right as long as parts cover less than 3/4 of it."""

ROUGH_RANGE = (0.72, 1.3)
"""Brightness relative to the first guess that counts as plate: wider than a shading of +-15 %,
narrow enough to leave out a part as bright as 2/3 of the plate."""

FINE_RANGE = (0.92, 1.08)
"""The same relative to the fitted surface, for the second fit: leaves out the parts' edges."""

RIDGE = 1e-9
"""Keeps the fit solvable for images one pixel high or wide; elsewhere without effect."""

MIN_FRACTION = 0.1
"""Least fraction of the pixels looked at that must be plate."""

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
        The bare plate's brightness, as `bare` takes it: a to f [grey levels] of
        a + b u + c v + d u2 + e u v + f v2; the image point [px] where u = v = 0; one over the
        length [px] of one unit of u and v.
    usable : (H, W) bool
        Pixels that show the plate, clear of its edge.
    """

    grey: np.ndarray
    light: np.ndarray
    usable: np.ndarray


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def bare(light: np.ndarray, x_px: float, y_px: float) -> float:
    """Brightness of the bare plate [grey levels] at a pixel; `light` is that of `LitPlate`."""
    u = (np.float32(x_px) - light[6]) * light[8]
    v = (np.float32(y_px) - light[7]) * light[8]
    return (
        (u * (light[1] + light[3] * u))
        + (light[0] + v * (light[2] + light[5] * v))
        + u * (light[4] * v)
    )


def fit_light(grey: np.ndarray, region: Region, min_grey: float) -> LitPlate | None:
    """Fit the bare plate's brightness to the pixels of an image (H, W) uint8 that show no part.

    None if there is no plate as bright as `min_grey` [grey levels].
    """
    samples = region.samples
    surface = _fit(grey, samples, float(min_grey)) if len(samples.rows) else ()
    if not len(surface):
        return None
    return LitPlate(grey, np.concatenate([surface, samples.place]), region.usable)


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


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _fit(grey: np.ndarray, samples: Samples, min_grey: float) -> np.ndarray:
    """Return the coefficients (6,) of the surface through those of the samples that show the bare
    plate; empty if there is no bright plate."""
    rows, columns, design = samples.rows, samples.columns, samples.design
    count, nothing = len(rows), np.empty(0, np.float32)
    value, levels = np.empty(count, np.float32), np.zeros(256, np.int64)
    for i in range(count):
        level = grey[rows[i], columns[i]]
        value[i] = level
        levels[level] += 1
    guess, darker = 0, levels[0]
    while darker <= int(count * BRIGHT_PERCENTILE / 100):
        guess += 1
        darker += levels[guess]
    if guess < min_grey:
        return nothing
    fitted = np.full(count, np.float32(guess))
    for low, high in (ROUGH_RANGE, FINE_RANGE):
        normal, right, kept = _normal_equations(value, fitted, design, low, high)
        if kept < max(2 * len(design), MIN_FRACTION * count):
            return nothing
        for a in range(len(design)):
            normal[a, a] += RIDGE * count
        solve(normal, right)
        fitted[:] = 0
        for a in range(len(design)):
            fitted += np.float32(right[a]) * design[a]
    return right.astype(np.float32) if fitted.min() >= 0.5 * min_grey else nothing


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _normal_equations(
    value: np.ndarray, fitted: np.ndarray, design: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return matrix and right side of the least squares over values (K,) that are `low` to `high`
    times the fitted ones, and how many these are; `design` is (6, K)."""
    size = len(design)
    normal, right = np.zeros((size, size)), np.zeros(size)
    weight = np.empty(len(value), np.float32)
    kept = 0
    for i in range(len(value)):
        plate = low * fitted[i] < value[i] < high * fitted[i]
        weight[i] = plate
        kept += plate
    for a in range(size):
        row = design[a] * weight
        right[a] = _dot(row, value)
        for b in range(a + 1):
            normal[a, b] = normal[b, a] = _dot(row, design[b])
    return normal, right, kept


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Return the scalar product of vectors (K,) of float32."""
    total = np.float32(0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return float(total)


@kernel(error_model="numpy")
def solve(normal: np.ndarray, right: np.ndarray) -> None:
    """Solve positive definite equations in place: `right` becomes the solution."""
    size = len(right)
    for i in range(size):
        for j in range(i + 1, size):
            factor = normal[j, i] / normal[i, i]
            for k in range(i, size):
                normal[j, k] -= factor * normal[i, k]
            right[j] -= factor * right[i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= normal[i, k] * right[k]
        right[i] /= normal[i, i]
