"""Centres, radii and darkness of round parts that touch others or are cut by the plate's edge.

Damped Gauss-Newton on centre, radius, edge width and darkness of one disc after the other, with
the darkness of its neighbours, as far as they are known, taken off first. Pixels that do not show
the plate have no weight, and those that a neighbour covers the less the more it covers them.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.light import LitPlate
from .measure import DISC, numbers


def fit_discs(plate: LitPlate, seeds: np.ndarray, radius_px: float) -> np.ndarray:
    """Measure discs (n,) DISC, neighbours among them, from first guesses of their centres (n, 2)
    [px] and of the radius [px]."""
    discs = np.zeros(len(seeds), DISC)
    _kernels.fit_discs(*plate, seeds, radius_px, numbers(discs))
    return discs
