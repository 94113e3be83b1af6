"""Measurement of parts that are clearly darker than the plate.

Each part is measured by the fastest method that is suitable. A part without neighbours is measured
by the moments of its darkness, with an error of about a hundredth of a pixel. For the
pixels of an evenly dark disc, this equation is valid:

    sum(m d^2) / sum(m) = r^2 / 2

m is the darkness of a pixel, d its distance from the centre, and r the radius of the disc.

The misfit is the larger one of two deviations. The first deviation is the relative difference
between the two sides of the equation, with r computed from the dark area. The second deviation is
the difference between the second moments of the disc and of the silhouette. Parts with neighbours
are measured by `fit`, which models the neighbours.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.light import LitPlate
from ..plate.region import Region
from . import silhouette
from .measure import DISC, disc_rows


def measure_dark(
    plate: LitPlate, region: Region, seeds: np.ndarray, parts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measure dark discs.

    Parameters
    ----------
    plate : LitPlate
    region : Region
        Region of the plate in the image.
    seeds : (n, 2)
        First guesses of the places [px], n >= 1.
    parts : (n,) SILHOUETTE
        Silhouettes of parts at the seeds.

    Returns
    -------
    (n,) DISC
        The measured discs.
    (n, 2)
        Centres of marks [px], NaN for a part without a mark.
    (n,) bool
        Whether a disc was measured by moments.
    """
    discs, marks = np.zeros(len(seeds), DISC), np.empty((len(seeds), 2))
    alone = np.empty(len(seeds), np.bool_)
    _kernels.measure_dark(
        *plate, region.edges, region.bows, seeds, silhouette.silhouette_rows(parts),
        disc_rows(discs), marks, alone,
    )  # fmt: skip
    return discs, marks, alone
