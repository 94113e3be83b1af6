"""Centres, radii and darkness of round parts to a few hundredths of a pixel.

Darkness is 1 - grey / bare plate: 0 on the plate, the same all over a part whatever the shading.
Parts that stand alone are measured by moments, all at once. Parts that touch or nearly touch each
other, or are cut by the plate's edge, are measured by a least-squares fit of discs to the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .brightness import PlateBrightness
from .region import SEAM_PX, Region

RIM_PX = 3.0
"""Reach [px] beyond a part's radius that is looked at: 0.7 px from rounding the window, 1 px of
seed error, and the blurred edge."""

RIM_CLEAR_PX = 2.2
"""Distance [px] from a part's radius to the rim of its window that must be bright."""

RIM_DIRT_PX2 = 0.5
"""Dark area [px2] in that rim from which on there is something beside the part; twice as
much would shift the moments of a part of 8 px radius by 0.05 px."""

CORE = 0.6
"""Inner part of a disc, in radii, whose mean darkness is the part's: away from the blurred edge."""

EDGE_PX = (0.2, 0.5, 2.0)
"""Least, first and greatest half width [px] of a fitted disc's edge: 0.3 are sharp pixels, 0.7 a
lens with a blur of 0.6 px (standard deviation)."""

NOISE = 0.04
"""Darkness below which moments leave a pixel out: 4 standard deviations of a noise of 2 in 200
levels. Otherwise the empty rim of the window would make the centre's error half as large again."""

MAX_STEP_PX = 1.0
"""Largest change of a centre or radius [px] in one iteration: edges are seen only when near."""

SETTLED_PX = 0.01
"""Change [px] of centre and radius after which the fit has converged: the next change would be a
tenth of it, and a tenth of the effect of the image's noise."""

MAX_ITERATIONS = 25

MIN_DARKNESS = 0.05
"""Darkness below which a fitted disc is a shadow, no part; keeps the division by it harmless."""


@dataclass(frozen=True)
class Discs:
    """Measured discs.

    Attributes
    ----------
    centre : (n, 2)
        x, y [px].
    radius : (n,)
        Of the disc of the same darkness and area [px].
    darkness : (n,)
        1 - grey / bare plate, mean over the inner part.
    misfit : (n,)
        How far from an evenly dark disc: 0 for a perfect one, about 1 for something else.
    """

    centre: np.ndarray
    radius: np.ndarray
    darkness: np.ndarray
    misfit: np.ndarray

    def select(self, index: np.ndarray) -> Discs:
        """Return some of the discs."""
        return Discs(
            self.centre[index], self.radius[index], self.darkness[index], self.misfit[index]
        )

    def join(self, other: Discs) -> Discs:
        """Return these and the others."""
        return Discs(
            np.concatenate([self.centre, other.centre]),
            np.concatenate([self.radius, other.radius]),
            np.concatenate([self.darkness, other.darkness]),
            np.concatenate([self.misfit, other.misfit]),
        )


@dataclass(frozen=True)
class Windows:
    """Square cut-outs around seeds.

    Attributes
    ----------
    x, y : (n, 1, s), (n, s, 1)
        Image coordinates of the pixels [px].
    darkness : (n, s, s)
        1 - grey / bare plate.
    """

    x: np.ndarray
    y: np.ndarray
    darkness: np.ndarray


def cut_windows(
    grey: np.ndarray, brightness: PlateBrightness, seeds: np.ndarray, radius_px: float
) -> Windows:
    """Cut a window out of the image around every seed (n, 2) [px]."""
    reach = window_reach(radius_px)
    offset = np.arange(-reach, reach + 1)
    nearest = np.rint(seeds).astype(int)
    columns, rows = nearest[:, :1] + offset, nearest[:, 1:] + offset
    height, width = grey.shape
    # Windows over the image's border repeat its pixels; the fit gives those no weight.
    inside_rows, inside_columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
    pixels = grey[inside_rows[:, :, None], inside_columns[:, None, :]]
    x, y = columns[:, None, :].astype(np.float32), rows[:, :, None].astype(np.float32)
    return Windows(x, y, 1 - pixels / brightness.at(x, y))


def window_reach(radius_px: float) -> int:
    """Half width [px] of the windows around parts of a radius [px]."""
    return int(np.ceil(radius_px + RIM_PX))


def measure_alone(windows: Windows, radius_px: float) -> tuple[Discs, np.ndarray]:
    """Measure discs that have their window to themselves, by moments of darkness.

    With m the darkness and d the distance from the centre, a disc of radius r has
    sum(m d2) / sum(m) = r2 / 2; the misfit is how far that is from the radius by area.

    Returns
    -------
    Discs
    (n,) bool
        Whether there is something else in the window: the measurement is then wrong.
    """
    basis, core = _moment_basis(radius_px)
    darkness = np.where(windows.darkness > NOISE, windows.darkness, np.float32(0))
    flat = darkness.reshape(len(darkness), -1)
    sums = flat @ basis
    mass = np.maximum(sums[:, 0], 1e-6)
    shift = sums[:, 1:3] / mass[:, None]
    # The mean over the inner part; the seed is near enough for that to be all inside.
    darkness = np.maximum(sums[:, 4] / core, MIN_DARKNESS)
    radius = np.sqrt(mass / (np.pi * darkness))
    spread = sums[:, 3] / mass - np.sum(shift**2, axis=1)
    reach = (windows.x.shape[2] - 1) // 2
    centre = np.stack([windows.x[:, 0, reach], windows.y[:, reach, 0]], axis=1) + shift
    misfit = np.abs(2 * spread / radius**2 - 1)
    return Discs(centre, radius, darkness, misfit), sums[:, 5] > RIM_DIRT_PX2 * darkness


@lru_cache(maxsize=16)
def _moment_basis(radius_px: float) -> tuple[np.ndarray, int]:
    """Return weights (s * s, 6) of 1, dx, dy, d2 in a round window, of its inner part and of its
    rim; the number of pixels of the inner part."""
    reach = window_reach(radius_px)
    offset = np.arange(-reach, reach + 1)
    dx, dy = np.meshgrid(offset, offset)
    square = dx**2 + dy**2
    disc = square <= (radius_px + RIM_PX) ** 2
    core = square <= (CORE * radius_px) ** 2
    rim = disc & (square > (radius_px + RIM_CLEAR_PX) ** 2)
    columns = [disc, dx * disc, dy * disc, square * disc, core, rim]
    basis = np.stack(columns, axis=-1).astype(np.float32).reshape(-1, len(columns))
    return basis, int(np.count_nonzero(core))


def neighbour_pairs(centre: np.ndarray, distance_px: float) -> np.ndarray:
    """Return index pairs (p, 2), both orders, of centres nearer to each other than a distance."""
    gap = np.abs(centre[:, None] - centre[None, :])
    near = np.hypot(gap[..., 0], gap[..., 1]) < distance_px
    np.fill_diagonal(near, False)
    return np.argwhere(near)


def fit_discs(
    windows: Windows,
    seeds: np.ndarray,
    radius_px: float,
    region: Region,
    image_shape: tuple[int, int],
) -> Discs:
    """Measure discs that touch others or are cut by the plate's edge.

    Damped Gauss-Newton on centre, radius, edge width and darkness of every disc, with the darkness
    of its neighbours, as far as they are known, taken off first. Pixels outside the plate or the
    image have no weight, and those that a neighbour covers the less the more it covers them.

    Parameters
    ----------
    windows : Windows
        Around the seeds.
    seeds : (n, 2)
        First guesses of the centres [px].
    radius_px : float
        First guess of the radius [px].
    region : Region
        Where the plate is.
    image_shape : (int, int)
        Height and width of the image [px].
    """
    x, y = windows.x, windows.y
    height, width = image_shape
    weight = (region.depth(x, y) >= SEAM_PX) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    weight = weight.astype(np.float32)
    pairs = neighbour_pairs(seeds, 2 * radius_px + 2 * RIM_PX)
    state = np.empty((len(seeds), 5))  # x, y, radius, edge width [px], darkness
    state[:, :2], state[:, 2], state[:, 3] = seeds, radius_px, EDGE_PX[1]
    state[:, 4] = _first_darkness(windows, weight, seeds, radius_px)
    for _ in range(MAX_ITERATIONS):
        error, slopes = _residual(windows, weight, pairs, state)
        step = _step(error, slopes)
        state += step
        state[:, 2] = state[:, 2].clip(0.5 * radius_px, 1.5 * radius_px)
        state[:, 3] = state[:, 3].clip(EDGE_PX[0], EDGE_PX[2])
        if np.all(np.abs(step[:, :3]) < SETTLED_PX):
            break
    covered = slopes[:, 4]
    square = np.sum(error**2 * covered, axis=(1, 2)) / np.maximum(covered.sum(axis=(1, 2)), 1)
    misfit = np.sqrt(square) / np.maximum(state[:, 4], MIN_DARKNESS)
    return Discs(state[:, :2], state[:, 2], state[:, 4], misfit)


def _first_darkness(
    windows: Windows, weight: np.ndarray, seeds: np.ndarray, radius_px: float
) -> np.ndarray:
    distance = _distance(windows.x, windows.y, seeds)[0]
    inner = weight * (distance < CORE * radius_px)
    share = np.sum(inner * windows.darkness, axis=(1, 2)) / np.maximum(inner.sum(axis=(1, 2)), 1)
    return np.maximum(share, MIN_DARKNESS)


def _residual(
    windows: Windows, weight: np.ndarray, pairs: np.ndarray, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return darkness not explained (n, s, s) and its slopes (n, 5, s, s) in the state; both
    weighted."""
    x, y = windows.x, windows.y
    distance, dx, dy = _distance(x, y, state[:, :2])
    cover, rim, depth = _disc_cover(distance, state[:, 2:4])
    darkness = state[:, 4, None, None].astype(np.float32)
    error = windows.darkness - darkness * cover
    if len(pairs):
        here, there = pairs.T
        far = _distance(x[here], y[here], state[there, :2])[0]
        other = _disc_cover(far, state[there, 2:4])[0]
        first = np.flatnonzero(np.diff(here, prepend=-1))  # pairs are sorted by `here`
        error[here[first]] -= np.add.reduceat(other * darkness[there], first)
        weight = weight.copy()
        weight[here[first]] *= np.multiply.reduceat(1 - other, first)
    pull = darkness * rim
    slopes = np.stack([pull * dx / distance, pull * dy / distance, pull, -pull * depth, cover], 1)
    slopes *= weight[:, None]
    return error * weight, slopes


def _distance(
    x: np.ndarray, y: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return distance (n, s, s) of the pixels from centres (n, 2), and its parts along x and y."""
    dx = x - centre[:, 0, None, None].astype(np.float32)
    dy = y - centre[:, 1, None, None].astype(np.float32)
    return np.sqrt(dx * dx + dy * dy + np.float32(1e-6)), dx, dy


def _disc_cover(
    distance: np.ndarray, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how much of each pixel (n, s, s) a disc of shape (n, 2) = radius, edge width [px]
    covers; the slope of that in the radius [1/px]; the depth inside the disc in edge widths."""
    radius, edge = shape.astype(np.float32).T[:, :, None, None]
    depth = (radius - distance) / edge
    swing = np.tanh(depth)
    return 0.5 * (1 + swing), 0.5 * (1 - swing * swing) / edge, depth


def _step(error: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Return the change (n, 5) of the discs' state: least squares, damped and bounded."""
    count, size = slopes.shape[:2]
    rows = slopes.reshape(count, size, -1)
    normal = (rows @ rows.transpose(0, 2, 1)).astype(float)
    right = (rows @ error.reshape(count, -1, 1)).astype(float)
    index = np.arange(size)
    normal[:, index, index] = normal[:, index, index] * 1.001 + 1e-3
    step = np.linalg.solve(normal, right)[..., 0]
    largest = np.abs(step[:, :3]).max(axis=1, keepdims=True)
    return step * np.minimum(1, MAX_STEP_PX / np.maximum(largest, 1e-9))
