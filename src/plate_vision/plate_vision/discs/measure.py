"""Centres, radii and darkness of round parts that stand alone, to a hundredth of a pixel.

Darkness is 1 - grey / bare plate: 0 on the plate, the same all over a part whatever the shading.
"""

from __future__ import annotations

import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel

from ..plate.light import LitPlate, bare

RIM_PX = 3.0
"""Reach [px] beyond a part's radius that is looked at: 0.7 px from rounding the window, 1 px of
seed error, and the blurred edge."""

RIM_CLEAR_PX = 2.2
"""Distance [px] from a part's radius to the rim of its window that must be bright."""

RIM_DIRT_PX2 = 0.5
"""Dark area [px2] in that rim from which on there is something beside the part; twice as
much would shift the moments of a part of 8 px radius by 0.05 px."""

CORE = 0.6
"""Inner part of a disc, in radii, whose mean darkness, or median if it may have a mark, is the
part's: away from the blurred edge."""

NOISE = 0.04
"""Darkness below which moments leave a pixel out: 4 standard deviations of a noise of 2 in 200
levels. Otherwise the empty rim of the window would make the centre's error half as large again."""

MIN_DARKNESS = 0.05
"""Darkness below which a fitted disc is a shadow, no part; keeps the division by it harmless."""

DISC = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("darkness", "f8"),
        ("misfit", "f8"),
    ]
)
"""A measured disc: centre; radius, that of a disc of the same darkness and area; mean darkness of
its inner part; how far it is from an evenly dark disc: 0 for a perfect one, about 1 for something
else."""


def measure_alone(
    plate: LitPlate, seeds: np.ndarray, radius_px: float, alone: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measure discs that have their surroundings to themselves, by moments of darkness.

    With m the darkness and d the distance from the centre, a disc of radius r has
    sum(m d2) / sum(m) = r2 / 2; the misfit is how far that is from the radius by area.

    Parameters
    ----------
    plate : LitPlate
    seeds, radius_px : (n, 2), float
        First guesses of the centres and the radius [px].
    alone : (n,) bool
        Which to measure: those with no other near.

    Returns
    -------
    (n,) DISC
    (n,) bool
        Which of them are right: there is nothing else beside them, nor the image's border.
    """
    discs, dirt = np.zeros(len(seeds), DISC), np.full(len(seeds), np.inf)
    _moments(plate, np.rint(seeds).astype(np.int64), radius_px, alone, discs, dirt)
    return discs, dirt <= RIM_DIRT_PX2 * discs["darkness"]


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _moments(
    plate: LitPlate,
    seeds: np.ndarray,
    radius: float,
    alone: np.ndarray,
    discs: np.ndarray,
    dirt: np.ndarray,
) -> None:
    """Fill discs (n,) that are alone from round windows at seeds (n, 2), and the dark area (n,)
    [px2] in the rims of the windows; leave those at the image's border as they are."""
    grey, light, _ = plate
    height, width = grey.shape
    reach = int(radius + RIM_PX)
    side = np.arange(-reach, reach + 1)
    size = len(side) ** 2
    x, y, square = (
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
    )
    for i in range(size):
        x[i], y[i] = side[i % len(side)], side[i // len(side)]
        square[i] = x[i] ** 2 + y[i] ** 2
    outer, clear = np.float32((radius + RIM_PX) ** 2), np.float32((radius + RIM_CLEAR_PX) ** 2)
    core, noise, zero = np.float32((CORE * radius) ** 2), np.float32(NOISE), np.float32(0)
    level = np.empty(size, np.float32)
    for k in range(len(seeds)):
        x0, y0 = seeds[k]
        if not alone[k] or min(x0, y0) < reach or x0 + reach >= width or y0 + reach >= height:
            continue
        i = 0
        for row in range(y0 - reach, y0 + reach + 1):
            for column in range(x0 - reach, x0 + reach + 1):
                level[i] = grey[row, column]
                i += 1
        left, top = np.float32(x0), np.float32(y0)
        # Flat and without branches, so that it runs on eight pixels at a time.
        mass, right, down, wide, rim, inner, pixels = zero, zero, zero, zero, zero, zero, zero
        for i in range(size):
            dark = np.float32(1) - level[i] / bare(light, left + x[i], top + y[i])
            inner += dark if square[i] <= core else zero
            pixels += np.float32(1) if square[i] <= core else zero
            dark = dark if dark > noise and square[i] <= outer else zero
            mass += dark
            right += dark * x[i]
            down += dark * y[i]
            wide += dark * square[i]
            rim += dark if square[i] > clear else zero
        mass = max(mass, np.float32(1e-6))
        right, down = right / mass, down / mass
        # The mean over the inner part; the seed is near enough for that to be all inside.
        darkness = max(inner / pixels, np.float32(MIN_DARKNESS))
        area = mass / (np.pi * darkness)
        misfit = abs(2 * (wide / mass - right**2 - down**2) / area - 1)
        disc = discs[k]
        disc.x_px, disc.y_px, disc.radius_px = x0 + right, y0 + down, np.sqrt(area)
        disc.darkness, disc.misfit, dirt[k] = darkness, misfit, rim


@kernel(error_model="numpy")
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
