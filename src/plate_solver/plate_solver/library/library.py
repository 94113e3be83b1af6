"""A library of rotations: unit twists about many centres on and around the plate.

The average force on a part at rest is the mean of unit vectors. Each twist of the plate's motion
contributes one unit vector. The force does not depend on the plate's speed. Therefore the forces of
any motion are a mean of the library's columns (equations (5), (9)), if the library's twists are
dense enough. Let rotation j of N rotations have the weight k_j and the unit tangent t_j at a part.
The average force on the part is

    F = mu m g / N  sum_j k_j t_j.

The rows of the matrices are the forces (10) and curls (12) of the parts, the columns are the
centres, and the unknowns are the weights (section 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .simplex import least_time

COLUMNS, ROWS = 30, 16
"""Number of centres along x and y. If both numbers are doubled, the maximum force increases by 6
%."""

REACH = (1.1, 1.2)
"""Half side lengths of the grid of centres, in half side lengths of the plate. Rotations about more
distant centres differ little from each other and from translations."""

TRANSLATIONS = 8
"""Number of directions of translation."""

CURL_LENGTH_M = 0.05
"""Length that converts a curl error [mu m g / m] to a force error [mu m g]."""

OUT_OF_REACH = 1e4
"""Price of a unit of force error [cycles / (mu m g)]. This price is so high that force errors are 0
if they can be 0."""


@dataclass(frozen=True)
class Library:
    """Rotations and translations. Each can be used in both directions.

    Attributes
    ----------
    centre : (C, 2)
        Centres of rotation [m], plate_home.
    direction : (D, 2)
        Unit vectors of the translations.
    twist : (C + D, 3)
        Unit twists, with a speed of 1 m/s at the plate's fastest corner.
    """

    centre: np.ndarray
    direction: np.ndarray
    twist: np.ndarray

    @classmethod
    def about(cls, centre: np.ndarray, half: np.ndarray, translations: int = 0) -> Library:
        """Build a library from centres (C, 2) and equally spaced directions of translation.

        `half` (2,) are the half side lengths of the plate [m].
        """
        angle = np.pi * np.arange(translations) / max(translations, 1)
        direction = np.column_stack([np.cos(angle), np.sin(angle)])
        shifts = np.column_stack([direction, np.zeros(translations)])
        return cls(centre, direction, np.vstack([unit_twists(centre, half), shifts]))

    @classmethod
    def around(cls, half: np.ndarray, columns: int = COLUMNS, rows: int = ROWS) -> Library:
        """Build a library from a grid of centres slightly larger than the plate."""
        centre = grid(np.multiply(REACH, half), columns, rows)
        return cls.about(centre, half, TRANSLATIONS)

    def forces(self, position: np.ndarray) -> np.ndarray:
        """Return unit forces (2 M, C + D) on parts at rest: x of all parts, then y of all parts."""
        shifts = np.repeat(self.direction.T, len(position), axis=0)
        return np.hstack([rotation_matrix(position, self.centre), shifts])

    def curls(self, position: np.ndarray) -> np.ndarray:
        """Return curls (M, C + D) [1/m], equation (12)."""
        none = np.zeros((len(position), len(self.direction)))
        return np.hstack([curl_matrix(position, self.centre), none])

    def clearance(self, position: np.ndarray) -> np.ndarray:
        """Return the distance (C + D,) [m] of each centre from the nearest part.

        The distance is infinite for translations.
        """
        arm = position[:, None] - self.centre
        nearest = np.hypot(arm[..., 0], arm[..., 1]).min(axis=0)
        return np.concatenate([nearest, np.full(len(self.direction), np.inf)])

    def reachable_fraction(self, position: np.ndarray, force: np.ndarray) -> float:
        """Return the maximum multiple of the forces (M, 2) [mu m g] that any motion can produce.

        The reciprocal of the result is the minimum time for the forces. A linear programme without
        closure computes this time. The result bounds all motions, because the forces of a motion
        are a mean of the library's columns. The finite number of rotations causes an error of a few
        per cent.
        """
        rows, right_side = self.forces(position), force.T.ravel()
        if not np.any(right_side):
            return float("inf")
        dear = np.full(len(rows), OUT_OF_REACH)
        return 1 / least_time(rows, right_side, np.ones(rows.shape[1]), dear, dear).cost


def rotation_matrix(position: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return A of equation (10): unit forces of rotations about centres.

    Parameters
    ----------
    position : (M, 2)
        Parts [m], plate_home.
    centre : (N, 2)
        Centres of rotation [m], plate_home. The force on a part at the centre is 0.

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
    matrix: np.ndarray, right_side: np.ndarray, max_gain: float = np.inf
) -> tuple[np.ndarray, float]:
    """Return the minimum-norm weights that solve the system, and the condition number of the
    matrix.

    Parameters
    ----------
    matrix : (R, N)
        For example `rotation_matrix`, with rows of `curl_matrix` below.
    right_side : (R,)
        Right-hand side: N / (mu m g) times the requested forces.
    max_gain : float
        Upper bound of the reciprocal singular values (section 3.1.5). Singular directions with a
        larger reciprocal are omitted, because two close parts would otherwise cause very large
        weights.
    """
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    keep = values * max_gain >= 1 if np.isfinite(max_gain) else values > 1e-12 * values[0]
    inverse = np.where(keep, 1 / np.where(values > 0, values, 1.0), 0.0)
    weights = right.T @ (inverse * (left.T @ right_side))
    condition = float(values[0] / values[-1]) if values[-1] > 0 else float("inf")
    return weights, condition


def unit_twists(centre: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return twists (N, 3) of counter-clockwise rotations with 1 m/s at the fastest corner."""
    reach = np.hypot(np.abs(centre[:, 0]) + half[0], np.abs(centre[:, 1]) + half[1])
    spin = 1 / reach
    return np.column_stack([centre[:, 1] * spin, -centre[:, 0] * spin, spin])


def grid(half: np.ndarray, columns: int = 6, rows: int = 4) -> np.ndarray:
    """Return centres (columns * rows, 2) [m] on a regular grid with half side lengths `half`."""
    x, y = np.meshgrid(
        np.linspace(-half[0], half[0], columns), np.linspace(-half[1], half[1], rows)
    )
    return np.column_stack([x.ravel(), y.ravel()])
