"""Assignment of a detector's results to the true parts."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

OUT_OF_REACH = 1e3
"""Cost of a pair whose distance exceeds the maximum `reach`. The cost of other pairs is distance /
`reach`."""


def paired(
    found: np.ndarray, true: np.ndarray, reach: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Assign detected positions (n, 2) to true positions (m, 2), one to one, with as many pairs as
    possible.

    Parameters
    ----------
    reach : float or (m,)
        Maximum distance of a pair.

    Returns
    -------
    i, j, gap : (k,) each
        Index of the detected position, index of the true position, and distance of each pair.
    """
    gap = np.linalg.norm(found[:, None] - true, axis=2)
    cost = np.where(gap <= reach, gap / reach, OUT_OF_REACH)
    i, j = linear_sum_assignment(cost)
    near = cost[i, j] <= 1
    return i[near], j[near], gap[i, j][near]


def places(rows: np.ndarray) -> np.ndarray:
    """Return the columns `x_px`, `y_px` of a structured array (n,) as positions (n, 2) [px]."""
    return np.column_stack([rows["x_px"], rows["y_px"]])
