"""Marks: a spot off the middle of a part, darker or lighter than it, tells its angle.

A spot is what stands out from the part's grey round the place where it does most. It is painted
over, so that the part is then measured as one without a mark.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.light import LitPlate

SHINE = 0.85
"""Brightness relative to the bare plate from which on a spot is a highlight: marks are darker."""


def mark_angles(mark: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the directions (n,) [rad, counter-clockwise as seen] of marks (n, 2) [px] from the
    centres (n, 2) [px] of their parts; 0 where the mark is NaN."""
    dx, dy = (mark - centre).T
    return np.nan_to_num(np.arctan2(-dy, dx))


def paint_over(
    plate: LitPlate, tops: np.ndarray, radii_px: np.ndarray
) -> tuple[LitPlate, np.ndarray]:
    """Find marks, and paint them over; highlights, which are as bright as the plate or brighter,
    are painted over too.

    `tops` (n, 2) are within a pixel or two of the centres of the parts' tops [px], whose radii are
    (n,) [px]. Returns the image as if the parts had no marks, the same one if they have none; and
    the centres (n, 2) [px] of the marks, NaN for a part without one.
    """
    found, level = _kernels.find_marks(*plate.pixels, tops, radii_px, plate.noise)
    spot = np.isfinite(found[:, 0])
    if np.any(spot):
        plate = plate._replace(grey=plate.grey.copy())
        _kernels.paint_marks(plate.grey, found[spot], level[spot], radii_px[spot])
        bare = np.array([_kernels.bare(plate.light, x, y) for x, y in found[spot]])
        shines = np.sum(level[spot], axis=1) > SHINE * bare
        found[np.flatnonzero(spot)[shines]] = np.nan
    return plate, found
