"""Marks: a spot off the middle of a part, darker or lighter than it, tells its angle.

A spot is what stands out from the part's grey round the place where it does most. It is painted
over, so that the part is then measured as one without a mark.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.light import LitPlate


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
    found, level = _kernels.find_marks(*plate, seeds, radius_px)
    marked = np.isfinite(found[:, 0])
    if np.any(marked):
        plate = plate._replace(grey=plate.grey.copy())
        _kernels.paint_marks(plate.grey, found[marked], level[marked], radius_px)
    return plate, found
