"""Selection of the parts among measured discs, and calculation of their angles, labels, confidences
and standard deviations."""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.region import Region
from . import silhouette
from .measure import disc_rows

GOOD_MISFIT: float = _kernels.GOOD_MISFIT
"""Maximum misfit that light, noise and the edges of pixels cause. If a misfit exceeds this value,
the error of the place is about the excess multiplied by the radius."""

NUMBERS = ("x_px", "y_px", "radius_px", "angle_rad", "confidence", "scatter_px", "misfit")
"""Names of the properties of a part. `detection.DETECTION` explains the properties."""


def judge(
    discs: np.ndarray,
    parts: np.ndarray,
    marks: np.ndarray,
    light: np.ndarray,
    region: Region,
    noise: float,
    tolerance: float,
    class_threshold: float,
    margin_px: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Select the parts among measured discs.

    Parameters
    ----------
    discs, parts : (n,) DISC, (n,) SILHOUETTE
    marks : (n, 2)
        Centres of marks [px], NaN for a part without a mark.
    light : (n,)
        Brightness of the discs, relative to the plate's brightness.
    region : Region
        Region of the plate in the image.
    noise : float
        Noise of the image, relative to the plate's brightness [-].
    tolerance, class_threshold, margin_px : float
        As in `DetectorOptions`.

    Returns
    -------
    (m,) int64
        Indices of the discs that are parts.
    (m,) int64
        Labels of the parts: 0 black, 1 grey, 2 brighter than the plate.
    (m, 7)
        Properties of the parts, in the order of `NUMBERS`.
    """
    return _kernels.judge(
        disc_rows(discs), silhouette.silhouette_rows(parts), marks, light, region.edges,
        region.bows, noise, tolerance, class_threshold, margin_px,
    )  # fmt: skip
