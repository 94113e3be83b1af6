"""Rotation centres and the linear problem of section 3.1 of the paper.

Rows are parts' forces (10), and curls (12) where asked; columns are centres; the unknowns are the
weights K. With N rotations of weight k_j the average force is mu m g / N times the sum of k_j times
the unit tangents about the centres.
"""

from __future__ import annotations

import numpy as np


def rotation_matrix(position: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return A of equation (10): unit forces of rotations about centres.

    Parameters
    ----------
    position : (M, 2)
        Parts [m], plate_home.
    centre : (N, 2)
        Centres of rotation [m], plate_home. A part on a centre feels no force from it.

    Returns
    -------
    (2 M, N)
        x of all parts, then y of all parts.
    """
    arm = position[:, None] - centre
    distance = np.hypot(arm[..., 0], arm[..., 1])
    unit = arm / np.where(distance > 0, distance, np.inf)[..., None]
    return np.vstack([-unit[..., 1], unit[..., 0]])


def curl_matrix(position: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the rows (M, N) of equation (12): 1 / distance, the curl (11) of a rotation."""
    arm = position[:, None] - centre
    distance = np.hypot(arm[..., 0], arm[..., 1])
    return 1 / np.where(distance > 0, distance, np.inf)


def solve_weights(
    matrix: np.ndarray, wanted: np.ndarray, most_gain: float = np.inf
) -> tuple[np.ndarray, float]:
    """Return the smallest weights that solve the system, and its condition number.

    Parameters
    ----------
    matrix : (R, N)
        Such as `rotation_matrix`, with rows of `curl_matrix` below.
    wanted : (R,)
        Right-hand side: N / (mu m g) times the wanted forces.
    most_gain : float
        Bound on inverse singular values (section 3.1.5): directions that would need more are left
        out, so two close parts cannot call for wild motions.
    """
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    keep = values * most_gain >= 1 if np.isfinite(most_gain) else values > 1e-12 * values[0]
    inverse = np.where(keep, 1 / np.where(values > 0, values, 1.0), 0.0)
    weights = right.T @ (inverse * (left.T @ wanted))
    condition = float(values[0] / values[-1]) if values[-1] > 0 else float("inf")
    return weights, condition


def priority_order(weights: np.ndarray, position: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the order of section 3.1.4: falling |k_j| / distance to the nearest part.

    (The paper prints other numbers for its own example than this formula gives.)
    """
    arm = position[:, None] - centre
    nearest = np.hypot(arm[..., 0], arm[..., 1]).min(axis=0)
    return np.argsort(-np.abs(weights) / np.where(nearest > 0, nearest, 1e-9), kind="stable")


def unit_twists(centre: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return twists (N, 3) of counter-clockwise rotations whose fastest corner moves at 1 m/s."""
    reach = np.hypot(np.abs(centre[:, 0]) + half[0], np.abs(centre[:, 1]) + half[1])
    spin = 1 / reach
    return np.column_stack([centre[:, 1] * spin, -centre[:, 0] * spin, spin])


def ring(half: np.ndarray, count: int = 24) -> np.ndarray:
    """Return centres (count, 2) [m] on an ellipse a little larger than the plate."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack([1.1 * half[0] * np.cos(angle), 1.2 * half[1] * np.sin(angle)])


def grid(half: np.ndarray, columns: int = 6, rows: int = 4) -> np.ndarray:
    """Return centres (columns * rows, 2) [m] spread evenly over the plate."""
    x, y = np.meshgrid(
        np.linspace(-half[0], half[0], columns), np.linspace(-half[1], half[1], rows)
    )
    return np.column_stack([x.ravel(), y.ravel()])
