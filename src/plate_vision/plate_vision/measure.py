"""Centres, radii and darkness of round parts that stand alone, to a hundredth of a pixel.

Darkness is 1 - grey / bare plate: 0 on the plate, the same all over a part whatever the shading.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numba import njit

from .brightness import PlateBrightness, bare

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

NOISE = 0.04
"""Darkness below which moments leave a pixel out: 4 standard deviations of a noise of 2 in 200
levels. Otherwise the empty rim of the window would make the centre's error half as large again."""

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
    fitted : (n,) bool
        Whether measured by a fit, not by moments.
    angle : (n,)
        Of its mark [rad], counter-clockwise as seen; 0 without one.
    """

    centre: np.ndarray
    radius: np.ndarray
    darkness: np.ndarray
    misfit: np.ndarray
    fitted: np.ndarray
    angle: np.ndarray

    def select(self, index: np.ndarray) -> Discs:
        """Return some of the discs."""
        return Discs(*(getattr(self, f.name)[index] for f in fields(self)))

    def join(self, other: Discs) -> Discs:
        """Return these and the others."""
        return Discs(
            *(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self))
        )


def measure_alone(
    grey: np.ndarray, brightness: PlateBrightness, seeds: np.ndarray, radius_px: float
) -> tuple[Discs, np.ndarray]:
    """Measure discs that have their surroundings to themselves, by moments of darkness.

    With m the darkness and d the distance from the centre, a disc of radius r has
    sum(m d2) / sum(m) = r2 / 2; the misfit is how far that is from the radius by area.

    Parameters
    ----------
    grey : (H, W) uint8
        Image [grey levels].
    brightness : PlateBrightness
        The bare plate.
    seeds : (n, 2)
        First guesses of the centres [px].
    radius_px : float
        First guess of the radius [px].

    Returns
    -------
    Discs
    (n,) bool
        Whether there is something else beside it, or the image's border: the measurement is then
        wrong.
    """
    sums = np.zeros((len(seeds), 7))
    _add_moments(grey, brightness.light(), np.rint(seeds).astype(np.int64), radius_px, sums)
    mass = np.maximum(sums[:, 0], 1e-6)
    shift = sums[:, 1:3] / mass[:, None]
    # The mean over the inner part; the seed is near enough for that to be all inside.
    darkness = np.maximum(sums[:, 4] / np.maximum(sums[:, 5], 1), MIN_DARKNESS)
    radius = np.sqrt(mass / (np.pi * darkness))
    spread = sums[:, 3] / mass - np.sum(shift**2, axis=1)
    misfit = np.abs(2 * spread / radius**2 - 1)
    beside = sums[:, 6] > RIM_DIRT_PX2 * darkness
    fitted, angle = np.zeros(len(seeds), bool), np.zeros(len(seeds))
    return Discs(np.rint(seeds) + shift, radius, darkness, misfit, fitted, angle), beside


@njit(cache=True, fastmath=True)
def _add_moments(
    grey: np.ndarray, light: np.ndarray, seeds: np.ndarray, radius: float, sums: np.ndarray
) -> None:
    """Sum darkness times 1, dx, dy, d2 in a round window; darkness and pixels of its inner part;
    darkness of its rim, infinite at the image's border. `sums` is (n, 7)."""
    height, width = grey.shape
    outer, clear = np.float32((radius + RIM_PX) ** 2), np.float32((radius + RIM_CLEAR_PX) ** 2)
    core = np.float32((CORE * radius) ** 2)
    reach = int(radius + RIM_PX)
    zero, one = np.float32(0), np.float32(1)
    for k in range(len(seeds)):
        x0, y0 = seeds[k]
        if min(x0, y0) < reach or x0 + reach >= width or y0 + reach >= height:
            sums[k, 6] = np.inf
            continue
        for dy in range(-reach, reach + 1):
            chord = int(np.sqrt(outer - dy * dy))
            mass, across, square, inner, rim = zero, zero, zero, zero, zero
            pixels = 0
            for dx in range(-chord, chord + 1):
                x, y = x0 + dx, y0 + dy
                dark = one - np.float32(grey[y, x]) / bare(light, x, y)
                d2 = np.float32(dx * dx + dy * dy)
                inner += dark if d2 <= core else zero
                pixels += 1 if d2 <= core else 0
                dark = dark if dark > np.float32(NOISE) else zero
                mass += dark
                across += dark * np.float32(dx)
                square += dark * d2
                rim += dark if d2 > clear else zero
            sums[k, 0] += mass
            sums[k, 1] += across
            sums[k, 2] += mass * dy
            sums[k, 3] += square
            sums[k, 4] += inner
            sums[k, 5] += pixels
            sums[k, 6] += rim


@njit(cache=True)
def crowded(centre: np.ndarray, distance_px: float) -> np.ndarray:
    """Tell which centres (n, 2) [px] have another nearer than a distance: (n,) bool."""
    count = len(centre)
    near = np.zeros(count, np.bool_)
    for i in range(count):
        for j in range(i):
            dx, dy = centre[i, 0] - centre[j, 0], centre[i, 1] - centre[j, 1]
            if dx * dx + dy * dy < distance_px**2:
                near[i] = near[j] = True
    return near
