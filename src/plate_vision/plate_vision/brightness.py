"""The brightness of the bare plate: a smooth surface fitted to the pixels that show no part."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from .region import SEAM_PX, Region

SAMPLES = 1200
"""Pixels looked at, on a regular grid: the fitted surface is then good to 0.15 grey levels at
2 levels of noise, and the fit takes a tenth of the detection of a hundred parts."""

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


@njit(cache=True, fastmath=True, error_model="numpy")
def bare(light: np.ndarray, x_px: float, y_px: float) -> float:
    """Brightness of the bare plate [grey levels] at a pixel; `light` is of `fit_brightness`."""
    u = (np.float32(x_px) - light[6]) * light[8]
    v = (np.float32(y_px) - light[7]) * light[8]
    return (
        (u * (light[1] + light[3] * u))
        + (light[0] + v * (light[2] + light[5] * v))
        + u * (light[4] * v)
    )


def fit_brightness(grey: np.ndarray, region: Region, min_grey: float) -> np.ndarray | None:
    """Fit the bare plate's brightness: a + b u + c v + d u2 + e u v + f v2.

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
    (9,) float32 or None
        What `bare` takes: a to f [grey levels]; the image point [px] where u = v = 0; one over the
        length [px] of one unit of u and v. None if there is no bright plate.
    """
    rows, columns, design, place = _samples(region)
    if rows.size == 0:
        return None
    coefficients = _fit(grey, rows, columns, design, float(min_grey))
    return np.concatenate([coefficients, place]) if len(coefficients) else None


@njit(cache=True, fastmath=True, error_model="numpy")
def _fit(
    grey: np.ndarray, rows: np.ndarray, columns: np.ndarray, design: np.ndarray, min_grey: float
) -> np.ndarray:
    """Return the coefficients (6,) of the surface through the plate's pixels among those looked at
    (K,), `design` is (6, K); empty if there is no bright plate."""
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
        if kept < max(2 * len(design), MIN_SHARE * count):
            return nothing
        for a in range(len(design)):
            normal[a, a] += RIDGE * count
        solve(normal, right)
        fitted[:] = 0
        for a in range(len(design)):
            fitted += np.float32(right[a]) * design[a]
    return right.astype(np.float32) if fitted.min() >= 0.5 * min_grey else nothing


@njit(cache=True, fastmath=True, error_model="numpy")
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


@njit(cache=True, fastmath=True, error_model="numpy")
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Return the scalar product of vectors (K,) of float32."""
    total = np.float32(0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return float(total)


@njit(cache=True, error_model="numpy")
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


def quadratic(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the terms (n, 6) of a quadratic surface at places u, v (n,)."""
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


@lru_cache(maxsize=16)
def _samples(region: Region) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rows (K,), columns (K,) and design (6, K) of the pixels looked at; then the last three
    numbers of `fit_brightness`."""
    x0, y0, x1, y1 = region.box
    step = max(1, int(np.sqrt((x1 - x0) * (y1 - y0) / SAMPLES)))
    rows, columns = np.mgrid[y0 + step // 2 : y1 : step, x0 + step // 2 : x1 : step]
    inside = region.depth(columns, rows) >= SEAM_PX
    rows, columns = rows[inside], columns[inside]
    place = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 2 / max(x1 - x0, y1 - y0)
    u, v = (columns - place[0]) * place[2], (rows - place[1]) * place[2]
    design = np.ascontiguousarray(quadratic(u, v).T.astype(np.float32))
    return rows, columns, design, np.array(place, np.float32)
