"""Marks that show the angles of parts. A mark is a spot beside the centre of a part, darker or
brighter than the part.

The mark consists of the pixels that differ from the part's grey level. These pixels are painted
over, so that the part is then measured like a part without a mark. Highlights (spots that are about
as bright as the plate, or brighter) are painted over too, but do not count as marks.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.light import LitPlate
from . import silhouette


def find_marks(plate: LitPlate, seeds: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return the centres (n, 2) [px] of marks, NaN for a part without a mark.

    `seeds` (n, 2) are the places of the parts, with errors of one or two pixels. `parts` (n,)
    SILHOUETTE are the silhouettes at these places.
    """
    return np.asarray(_kernels.find_marks(*plate, seeds, silhouette.silhouette_rows(parts)))
