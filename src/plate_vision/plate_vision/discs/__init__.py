"""The fast method for round parts of a known radius. The method finds seeds (first guesses of the
places) and measures a disc at each seed by moments or by a fit of the contour. Then the method
selects the discs that are parts.

Only `detection` calls these functions, in this order.
"""

from .dark import measure_dark
from .fit import fit_discs
from .judge import GOOD_MISFIT, NUMBERS, judge
from .marks import find_marks
from .measure import crowded
from .seeds import COARSE_RADIUS_PX, find_seeds, seeds_of
from .silhouette import (
    SILHOUETTE,
    EvenDiscs,
    SeenDiscs,
    Silhouettes,
    outlines,
    to_image,
    tops,
)

__all__ = [
    "COARSE_RADIUS_PX",
    "GOOD_MISFIT",
    "NUMBERS",
    "SILHOUETTE",
    "EvenDiscs",
    "SeenDiscs",
    "Silhouettes",
    "crowded",
    "find_marks",
    "find_seeds",
    "fit_discs",
    "judge",
    "measure_dark",
    "outlines",
    "seeds_of",
    "to_image",
    "tops",
]
