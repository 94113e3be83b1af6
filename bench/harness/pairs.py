"""What a detector has found, paired with what is true."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

OUT_OF_REACH = 1e3
"""Cost of a pair that is none [its reach]."""


def paired(
    found: np.ndarray, true: np.ndarray, reach: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pair places found (n, 2) with true ones (m, 2), one to one, as many as can be.

    Parameters
    ----------
    reach : float or (m,)
        How near to a true place a pair must be.

    Returns
    -------
    i, j, gap : (k,) each
        Indices of both, and how far apart they are.
    """
    gap = np.linalg.norm(found[:, None] - true, axis=2)
    cost = np.where(gap <= reach, gap / reach, OUT_OF_REACH)
    i, j = linear_sum_assignment(cost)
    near = cost[i, j] <= 1
    return i[near], j[near], gap[i, j][near]


def places(rows: np.ndarray) -> np.ndarray:
    """Return the columns `x_px`, `y_px` of a structured array (n,) as places (n, 2) [px]."""
    return np.column_stack([rows["x_px"], rows["y_px"]])
