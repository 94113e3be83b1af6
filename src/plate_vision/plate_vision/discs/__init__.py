"""Round parts of a known radius, the fast path: seeds, marks, then measurement by moments or a fit.

`detection` calls them in this order; nothing else does.
"""

from .fit import fit_discs
from .marks import mark_angles, paint_over
from .measure import RIM_PX, crowded, measure_alone
from .seeds import find_seeds

__all__ = [
    "RIM_PX",
    "crowded",
    "find_seeds",
    "fit_discs",
    "mark_angles",
    "measure_alone",
    "paint_over",
]
