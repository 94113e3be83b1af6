"""A library of rotations. The library contains unit twists of the plate about many centres on and
around the plate.

The friction on a part at rest has the direction of the plate's velocity at the part, and its
magnitude does not depend on the speed. The average force of a motion on the part is therefore a
mean of unit vectors, one for each twist during the motion. If the library contains enough twists,
the average forces of any motion are approximately a weighted mean of the forces of the library's
twists (equations (5), (9)).

Let rotation j of N rotations have the weight k_j, and let t_j be the unit vector of its velocity at
a part. The average force on the part is

    F = mu m g / N  sum_j k_j t_j.

The requested forces thus give a linear system for the weights (section 3.1). The rows of its matrix
belong to the forces (10) and curls (12) of the parts, and the columns belong to the centres of
rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

COLUMNS, ROWS = 30, 16
"""Numbers of centres of rotation along x and y. If both numbers were doubled, the maximum force of
the library would increase by 6 %."""

REACH = (1.1, 1.2)
"""Half side lengths of the grid of centres, divided by the half side lengths of the plate.
Rotations about more distant centres differ little from each other and from translations."""

TRANSLATIONS = 8
"""Number of translations with different directions in the library."""

CURL_LENGTH_M = 0.05
"""A curl error [mu m g / m] is multiplied by this length to compare it with a force error [mu m
g]."""


@dataclass(frozen=True)
class Library:
    """Rotations and translations of the plate. Each of them can also be used in the opposite
    direction.

    Attributes
    ----------
    centre : (C, 2)
        Centres of rotation [m], plate_home.
    direction : (D, 2)
        Unit vectors of the translations.
    twist : (C + D, 3)
        Twists of the rotations, then of the translations [m/s, m/s, rad/s]. The plate's fastest
        corner has the speed 1 m/s.
    """

    centre: np.ndarray
    direction: np.ndarray
    twist: np.ndarray

    @classmethod
    def about(cls, centre: np.ndarray, half: np.ndarray, translations: int = 0) -> Library:
        """Create a library from centres of rotation (C, 2) and from translations whose directions
        are equally spaced.

        `half` (2,) are the half side lengths of the plate [m].
        """
        angle = np.pi * np.arange(translations) / max(translations, 1)
        direction = np.column_stack([np.cos(angle), np.sin(angle)])
        shifts = np.column_stack([direction, np.zeros(translations)])
        return cls(centre, direction, np.vstack([unit_twists(centre, half), shifts]))

    @classmethod
    def around(cls, half: np.ndarray, columns: int = COLUMNS, rows: int = ROWS) -> Library:
        """Create a library from a grid of centres of rotation. The grid is slightly larger than the
        plate."""
        centre = grid(np.multiply(REACH, half), columns, rows)
        return cls.about(centre, half, TRANSLATIONS)

    def forces(self, position: np.ndarray) -> np.ndarray:
        """Return the unit forces (2 M, C + D) on parts at rest. The rows are x of all parts, then y
        of all parts."""
        shifts = np.repeat(self.direction.T, len(position), axis=0)
        return np.hstack([rotation_matrix(position, self.centre), shifts])

    def curls(self, position: np.ndarray) -> np.ndarray:
        """Return the curls of the rotations and translations at parts (M, C + D) [1/m], equation
        (12)."""
        zero = np.zeros((len(position), len(self.direction)))
        return np.hstack([curl_matrix(position, self.centre), zero])

    def clearance(self, position: np.ndarray) -> np.ndarray:
        """Return the distance of each centre of rotation from the nearest part (C + D,) [m].

        The distance is infinite for translations.
        """
        arm = position[:, None] - self.centre
        nearest = np.hypot(arm[..., 0], arm[..., 1]).min(axis=0)
        return np.concatenate([nearest, np.full(len(self.direction), np.inf)])


def rotation_matrix(position: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the matrix A of equation (10). The matrix contains the unit forces of rotations about
    the centres `centre`.

    Parameters
    ----------
    position : (M, 2)
        Positions of the parts [m, plate_home].
    centre : (N, 2)
        Centres of rotation [m], plate_home. The force on a part at the centre is 0.

    Returns
    -------
    (2 M, N)
        Unit forces. The rows are x of all parts, then y of all parts.
    """
    arm = position[:, None] - centre
    distance = np.hypot(arm[..., 0], arm[..., 1])
    unit = arm / np.where(distance > 0, distance, np.inf)[..., None]
    return np.vstack([-unit[..., 1], unit[..., 0]])


def curl_matrix(position: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the rows (M, N) of equation (12). The rows contain the curl (11) of each rotation at
    each part, which is 1 / distance from the centre."""
    arm = position[:, None] - centre
    distance = np.hypot(arm[..., 0], arm[..., 1])
    return 1 / np.where(distance > 0, distance, np.inf)


def unit_twists(centre: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the twists (N, 3) of counter-clockwise rotations about the centres `centre`. The
    plate's fastest corner has the speed 1 m/s."""
    reach = np.hypot(np.abs(centre[:, 0]) + half[0], np.abs(centre[:, 1]) + half[1])
    spin = 1 / reach
    return np.column_stack([centre[:, 1] * spin, -centre[:, 0] * spin, spin])


def grid(half: np.ndarray, columns: int = 6, rows: int = 4) -> np.ndarray:
    """Return centres (columns * rows, 2) [m] on a regular grid with half side lengths `half`."""
    x, y = np.meshgrid(
        np.linspace(-half[0], half[0], columns), np.linspace(-half[1], half[1], rows)
    )
    return np.column_stack([x.ravel(), y.ravel()])
