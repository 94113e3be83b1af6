"""Marks: a spot off the middle of a part, darker or lighter than it, tells its angle.

A spot is what stands out from the part's grey round the place where it does most. It is painted
over, so that the part is then measured as one without a mark.
"""

from __future__ import annotations

from math import pi

import numpy as np

from plate_core.kernels import kernel

from ..plate.light import LitPlate, bare
from .measure import CORE

RADIUS = 0.3
"""Of a mark [part radii]."""

PLACE = (0.25, 0.75)
"""Where its centre may be, from that of a seed [part radii]: half way out, give or take the seed's
error."""

AREA = (0.5, 1.6)
"""What stands out, over the area of a mark: less is noise, more is something else."""

REACH = 1.5
"""Round the mark's centre, what stands out belongs to it [mark radii]: with its blurred edge, and
short of the part's."""

CONTRAST = 0.3
"""Least contrast of a mark, over the part's darkness: a black part's grey mark has 0.5, a grey
part's black mark 1."""

NOISE = 0.25
"""Fraction of the contrast that may be noise: five deviations of a noise of 2 levels."""

ROUNDS = 4
"""Times that the centre is taken again, in the window round the last one."""


def mark_angles(mark: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the directions (n,) [rad, counter-clockwise as seen] of marks (n, 2) [px] from the
    centres (n, 2) [px] of their parts; 0 where the mark is NaN."""
    dx, dy = (mark - centre).T
    return np.nan_to_num(np.arctan2(-dy, dx))


def paint_over(plate: LitPlate, seeds: np.ndarray, radius_px: float) -> tuple[LitPlate, np.ndarray]:
    """Find marks, and paint them over.

    `seeds` (n, 2) are within a pixel or two of the parts' centres [px]. Returns the image as if the
    parts had no marks, the same one if they have none; and the centres (n, 2) [px] of the marks,
    NaN for a part without one.
    """
    found, level = np.full((len(seeds), 2), np.nan), np.zeros((len(seeds), 2))
    _find(plate, seeds, float(radius_px), found, level)
    marked = np.isfinite(found[:, 0])
    if np.any(marked):
        plate = plate._replace(grey=plate.grey.copy())
        _paint(plate.grey, found[marked], level[marked], REACH * RADIUS * radius_px)
    return plate, found


@kernel(error_model="numpy")
def _find(plate, seeds, radius, found, level):
    """Fill the places of marks (n, 2) [px], and the grey of their parts and their contrasts."""
    grey, light, _ = plate
    height, width = grey.shape
    mark = RADIUS * radius
    reach = REACH * mark
    size = int(CORE * radius) + 1
    core = np.empty((2 * size + 1) ** 2)
    for i in range(len(seeds)):
        u, v = seeds[i]
        count = 0
        for r in range(max(0, int(v) - size), min(height, int(v) + size + 2)):
            for c in range(max(0, int(u) - size), min(width, int(u) + size + 2)):
                if (c - u) ** 2 + (r - v) ** 2 <= (CORE * radius) ** 2 and count < len(core):
                    core[count] = grey[r, c]
                    count += 1
        if count == 0:
            continue
        empty, darkest, lightest = bare(light, u, v), np.min(core[:count]), np.max(core[:count])
        if lightest - darkest < CONTRAST * (empty - lightest):
            continue  # whatever the median is
        part = np.median(core[:count])
        darkest, lightest = darkest - part, lightest - part
        contrast = lightest if lightest > -darkest else darkest
        if abs(contrast) < CONTRAST * (empty - part):
            continue
        x, y, mass = 0.0, 0.0, 0.0
        for turn in range(ROUNDS):
            # First what stands out in the inner part; then round the last centre.
            far = CORE * radius if turn == 0 else reach
            at_x, at_y = (u, v) if turn == 0 else (x, y)
            x, y, mass = 0.0, 0.0, 1e-9
            for r in range(max(0, int(at_y - far)), min(height, int(at_y + far) + 2)):
                for c in range(max(0, int(at_x - far)), min(width, int(at_x + far) + 2)):
                    excess = (grey[r, c] - part) / contrast
                    if excess > NOISE and (c - at_x) ** 2 + (r - at_y) ** 2 <= far**2:
                        mass += excess
                        x += excess * c
                        y += excess * r
            x, y = x / mass, y / mass
        place = ((x - u) ** 2 + (y - v) ** 2) ** 0.5
        if not (PLACE[0] * radius <= place <= PLACE[1] * radius):
            continue
        if AREA[0] <= mass / (pi * mark**2) <= AREA[1]:
            found[i, 0], found[i, 1] = x, y
            level[i, 0], level[i, 1] = part, contrast


@kernel(error_model="numpy")
def _paint(grey, centre, level, reach):
    """Give what stands out round the marks (n, 2) [px] the grey of their parts."""
    height, width = grey.shape
    for i in range(len(centre)):
        x, y = centre[i]
        part, contrast = level[i]
        for r in range(max(0, int(y - reach)), min(height, int(y + reach) + 2)):
            for c in range(max(0, int(x - reach)), min(width, int(x + reach) + 2)):
                beside = (c - x) ** 2 + (r - y) ** 2 > reach**2
                if not beside and (grey[r, c] - part) / contrast > 0:
                    grey[r, c] = np.uint8(part)
