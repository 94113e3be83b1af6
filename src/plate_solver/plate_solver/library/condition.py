"""Computes the condition number of a set of part positions. The condition number measures how
independently the parts can be pushed.

Each column of the matrix A contains the unit forces that one rotation of the library exerts on the
parts. The second moment A A' describes the forces of random motions. The condition number is the
square root of the ratio of the maximum to the minimum eigenvalue of A A'. In the direction of the
eigenvector of the minimum eigenvalue, a force is the most difficult to produce (section 3.3).
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateError, Rig

from .library import Library

SAME = 1e-9
"""Eigenvalues below this fraction of the largest eigenvalue count as zero."""


def condition_number(rig: Rig, position: np.ndarray) -> float:
    """Return the condition number of part positions. The condition number is the ratio of the force
    in the easiest direction to the force in the most difficult direction, at least 1.

    The condition number is infinite if no force is possible in some direction.

    Parameters
    ----------
    rig : Rig
    position : (M, 2)
        Positions of the parts, which are at rest [m, plate_home].

    Raises
    ------
    PlateError
        If the shape is not (M, 2), or a value is not finite.
    """
    return second_moment(columns_of(rig, position))[0]


def columns_of(rig: Rig, position: np.ndarray, library: Library | None = None) -> np.ndarray:
    """Return the unit forces of the library's K rotations (2 M, K). The rows are x and y of part 1,
    then of part 2, and so on."""
    position = np.asarray(position, dtype=float)
    if position.ndim != 2 or position.shape[1] != 2 or not len(position):
        raise PlateError(f"position has shape {position.shape}, allowed: (M, 2), M at least 1")
    if not np.all(np.isfinite(position)):
        raise PlateError("position has values that are not finite")
    forces = (library or Library.around(rig.plate.half)).forces(position)
    return np.ascontiguousarray(
        forces.reshape(2, len(position), -1).transpose(1, 0, 2).reshape(2 * len(position), -1)
    )


def second_moment(columns: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the condition number of a matrix of unit forces (2 M, K), and the direction (2 M,) in
    which a force is the most difficult to produce."""
    values, vectors = np.linalg.eigh(columns @ columns.T)
    lost = values[0] <= SAME * values[-1]
    condition = float("inf") if lost else float(np.sqrt(values[-1] / values[0]))
    return condition, unit(vectors[:, 0])


def unit(force: np.ndarray) -> np.ndarray:
    """Scale a force vector (2 M,) so that its mean square over the parts is 1."""
    return np.asarray(force / np.linalg.norm(force) * np.sqrt(len(force) / 2))
