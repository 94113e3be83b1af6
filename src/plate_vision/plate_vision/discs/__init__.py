"""Round parts of a known radius, the fast path: seeds, marks, then measurement by moments or a fit.

`detection` calls them in this order; nothing else does, but for the size of marks.
"""

from .fit import fit_discs
from .marks import RADIUS as MARK_RADII
from .marks import mark_angles, paint_over
from .measure import DISC, RIM_PX, crowded, measure_alone
from .seeds import find_seeds

__all__ = [
    "DISC",
    "MARK_RADII",
    "RIM_PX",
    "crowded",
    "find_seeds",
    "fit_discs",
    "mark_angles",
    "measure_alone",
    "paint_over",
]
