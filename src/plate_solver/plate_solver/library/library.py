"""A library of rotations: unit twists about many centres on and around the plate.

The average force on a part at rest is a mean of unit vectors, one for each twist the plate goes
through, whatever its speed. So the library is all there is to know of what a plate can do, and any
motion's forces are a mean of its columns (equations (5), (9)); what twists it leaves out lie near
ones that it has.

Rows are parts' forces (10), and curls (12) where asked; columns are centres; the unknowns are the
weights K (3.1). With N rotations of weight k_j the average force is mu m g / N times the sum of k_j
times the unit tangents about the centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .simplex import least_time

COLUMNS, ROWS = 30, 16
"""Centres along and across the plate. Twice as many in each direction gain 6 % of force."""

REACH = (1.1, 1.2)
"""Half sides of the grid of centres, in half sides of the plate: from farther away, and between
here and there, rotations differ little from each other and from translations."""

TRANSLATIONS = 8
"""Directions of translation."""

CURL_LENGTH_M = 0.05
"""Turns a curl error [mu m g / m] into a force error: as it would act over this distance."""

OUT_OF_REACH = 1e4
"""Price of a unit of force that is missed [cycles / (mu m g)]: none is to be."""


@dataclass(frozen=True)
class Library:
    """Rotations and translations, each of which may be run either way.

    Attributes
    ----------
    centre : (C, 2)
        Centres of rotation [m], plate_home.
    direction : (D, 2)
        Unit vectors of the translations.
    twist : (C + D, 3)
        Unit twists: the plate's fastest corner moves at 1 m/s.
    """

    centre: np.ndarray
    direction: np.ndarray
    twist: np.ndarray

    @classmethod
    def about(cls, centre: np.ndarray, half: np.ndarray, translations: int = 0) -> Library:
        """Build from centres (C, 2) and evenly spread directions; `half` (2,): half sides [m]."""
        angle = np.pi * np.arange(translations) / max(translations, 1)
        direction = np.column_stack([np.cos(angle), np.sin(angle)])
        shifts = np.column_stack([direction, np.zeros(translations)])
        return cls(centre, direction, np.vstack([unit_twists(centre, half), shifts]))

    @classmethod
    def around(cls, half: np.ndarray, columns: int = COLUMNS, rows: int = ROWS) -> Library:
        """Build from a grid of centres that covers the plate and a little more."""
        centre = grid(np.multiply(REACH, half), columns, rows)
        return cls.about(centre, half, TRANSLATIONS)

    def forces(self, position: np.ndarray) -> np.ndarray:
        """Return unit forces (2 M, C + D) on parts at rest: x of all, then y of all."""
        shifts = np.repeat(self.direction.T, len(position), axis=0)
        return np.hstack([rotation_matrix(position, self.centre), shifts])

    def curls(self, position: np.ndarray) -> np.ndarray:
        """Return curls (M, C + D) [1/m], equation (12)."""
        none = np.zeros((len(position), len(self.direction)))
        return np.hstack([curl_matrix(position, self.centre), none])

    def clearance(self, position: np.ndarray) -> np.ndarray:
        """Return how far (C + D,) [m] each centre is from the nearest part; shifts have none."""
        arm = position[:, None] - self.centre
        nearest = np.hypot(arm[..., 0], arm[..., 1]).min(axis=0)
        return np.concatenate([nearest, np.full(len(self.direction), np.inf)])

    def reachable_fraction(self, position: np.ndarray, force: np.ndarray) -> float:
        """Return the greatest multiple of the forces (M, 2) [mu m g] that any motion can give.

        Up to what the library leaves out (some per cent): a motion's forces are a mean of its
        columns, so the least time for them, 1 over this, is a linear programme without closure.
        """
        rows, wanted = self.forces(position), force.T.ravel()
        if not np.any(wanted):
            return float("inf")
        dear = np.full(len(rows), OUT_OF_REACH)
        return 1 / least_time(rows, wanted, np.ones(rows.shape[1]), dear, dear).cost


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
