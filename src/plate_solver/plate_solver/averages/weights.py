"""Weights of rotations by a singular value decomposition (section 3.1 of the paper)."""

from __future__ import annotations

import numpy as np


def solve_weights(
    matrix: np.ndarray, right_side: np.ndarray, max_gain: float = np.inf
) -> tuple[np.ndarray, float]:
    """Solve the linear system for the weights. Return the solution of minimum norm, and the
    condition number of the matrix.

    Parameters
    ----------
    matrix : (R, N)
        Matrix of the system, for example `library.rotation_matrix`. Rows of curls can follow.
    right_side : (R,)
        Right-hand side: N / (mu m g) times the requested forces.
    max_gain : float
        Upper bound of the reciprocal singular values (section 3.1.5). Singular directions with a
        larger reciprocal are omitted. Otherwise, two parts close to each other would cause very
        large weights.
    """
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    keep = values * max_gain >= 1 if np.isfinite(max_gain) else values > 1e-12 * values[0]
    inverse = np.where(keep, 1 / np.where(values > 0, values, 1.0), 0.0)
    weights = right.T @ (inverse * (left.T @ right_side))
    condition = float(values[0] / values[-1]) if values[-1] > 0 else float("inf")
    return weights, condition
