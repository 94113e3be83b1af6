"""The brightness of the bare plate: a smooth surface fitted to the pixels that show no part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit

from .region import SEAM_PX, Region

SAMPLES = 1200
"""Pixels looked at, on a regular grid: the fitted surface is then good to 0.15 grey levels at
2 levels of noise, and the fit takes less than a tenth of the detection."""

BRIGHT_PERCENTILE = 75.0
"""First guess of the plate's brightness: right as long as parts cover less than 3/4 of it."""

ROUGH_RANGE = (0.72, 1.3)
"""Brightness relative to the first guess that counts as plate: wider than a shading of +-15 %,
narrow enough to leave out a part as bright as 2/3 of the plate."""

FINE_RANGE = (0.92, 1.08)
"""The same relative to the fitted surface, for the second fit: leaves out the parts' edges."""

RIDGE = 1e-9
"""Keeps the fit solvable for images one pixel high or wide; elsewhere without effect."""

MIN_SHARE = 0.1
"""Least share of the pixels looked at that must be plate."""


@dataclass(frozen=True)
class PlateBrightness:
    """Quadratic surface a + b u + c v + d u2 + e u v + f v2 in scaled image coordinates.

    Attributes
    ----------
    coefficients : (6,)
        a to f [grey levels].
    centre : (2,)
        Image point [px] where u = v = 0.
    scale : float
        Length [px] of one unit of u and v.
    """

    coefficients: np.ndarray
    centre: tuple[float, float]
    scale: float

    def light(self, share: float = 1.0) -> np.ndarray:
        """Return the numbers (9,) by which `bare` gives a share of the brightness at a pixel."""
        return np.array([*share * self.coefficients, *self.centre, 1 / self.scale], np.float32)

    def at(self, x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
        """Brightness of the bare plate [grey levels] at image points [px]; they broadcast."""
        a, b, c, d, e, f = self.coefficients.astype(np.float32)
        u = (np.asarray(x_px, np.float32) - np.float32(self.centre[0])) / np.float32(self.scale)
        v = (np.asarray(y_px, np.float32) - np.float32(self.centre[1])) / np.float32(self.scale)
        return (u * (b + d * u)) + (a + v * (c + f * v)) + u * (e * v)


@njit(cache=True, fastmath=True)
def bare(light: np.ndarray, x_px: float, y_px: float) -> float:
    """Brightness of the bare plate [grey levels] at a pixel, of `PlateBrightness.light`."""
    u = (np.float32(x_px) - light[6]) * light[8]
    v = (np.float32(y_px) - light[7]) * light[8]
    return (
        (u * (light[1] + light[3] * u))
        + (light[0] + v * (light[2] + light[5] * v))
        + u * (light[4] * v)
    )


def fit_brightness(grey: np.ndarray, region: Region, min_grey: float) -> PlateBrightness | None:
    """Fit the bare plate's brightness.

    Parameters
    ----------
    grey : (H, W) uint8
        Image [grey levels].
    region : Region
        Where the plate is.
    min_grey : float
        Darkest plate that is believed [grey levels].

    Returns
    -------
    PlateBrightness or None
        None if there is no bright plate.
    """
    rows, columns, design, centre, scale = _samples(region)
    if rows.size == 0:
        return None
    value = grey[rows, columns].astype(np.float32)
    middle = int(value.size * BRIGHT_PERCENTILE / 100)
    guess = float(np.partition(value, middle)[middle])
    if guess < min_grey:
        return None
    fitted = np.full_like(value, guess)
    coefficients = np.zeros(len(design))
    for low, high in (ROUGH_RANGE, FINE_RANGE):
        normal, right, kept = _normal_equations(value, fitted, design, low, high)
        if kept < max(2 * len(design), MIN_SHARE * value.size):
            return None
        normal += RIDGE * value.size * np.eye(len(design))
        coefficients = np.linalg.solve(normal, right)
        fitted = coefficients.astype(np.float32) @ design
    if fitted.min() < 0.5 * min_grey:
        return None
    return PlateBrightness(coefficients, centre, scale)


@njit(cache=True, fastmath=True)
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
        right[a] = np.sum(row * value)
        for b in range(a + 1):
            normal[a, b] = normal[b, a] = np.sum(row * design[b])
    return normal, right, kept


def quadratic(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the terms (n, 6) of a quadratic surface at places u, v (n,)."""
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


@lru_cache(maxsize=16)
def _samples(
    region: Region,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float], float]:
    """Return rows (K,), columns (K,) and design (6, K) of the pixels looked at; centre; scale."""
    x0, y0, x1, y1 = region.box
    step = max(1, int(np.sqrt((x1 - x0) * (y1 - y0) / SAMPLES)))
    rows, columns = np.mgrid[y0 + step // 2 : y1 : step, x0 + step // 2 : x1 : step]
    inside = region.depth(columns, rows) >= SEAM_PX
    rows, columns = rows[inside], columns[inside]
    centre = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
    scale = 0.5 * max(x1 - x0, y1 - y0)
    u, v = (columns - centre[0]) / scale, (rows - centre[1]) / scale
    design = np.ascontiguousarray(quadratic(u, v).T.astype(np.float32))
    return rows, columns, design, centre, scale
