"""Condition number of a set of part positions. The number measures how independently the parts can
be pushed.

The columns of A are the library's unit forces. The second moment A A' describes the forces of
random motions. The condition number is the square root of the ratio of its maximum and minimum
eigenvalues. The eigenvector of the minimum eigenvalue is the direction in which a force is the most
difficult to produce (section 3.3).
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateError, Rig

from .library import Library

SAME = 1e-9
"""Eigenvalues below this fraction of the largest one count as zero."""


def condition_number(rig: Rig, position: np.ndarray, library: Library | None = None) -> float:
    """Return the ratio of the forces in the easiest and in the most difficult direction. The ratio
    is at least 1.

    The ratio is infinite if no force is possible in some direction.

    Parameters
    ----------
    rig : Rig
    position : (M, 2)
        Parts at rest [m], plate_home.
    library : Library, optional
        Rotations that the plate may use. Default: a grid of centres over the plate.

    Raises
    ------
    PlateError
        If the shape is not (M, 2), or a value is not finite.
    """
    return second_moment(columns_of(rig, position, library))[0]


def columns_of(rig: Rig, position: np.ndarray, library: Library | None) -> np.ndarray:
    """Return the library's unit forces (2 M, K), in the row order x, y of each part."""
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
    """Return the condition number of columns (2 M, K), and the most difficult direction (2 M,)."""
    values, vectors = np.linalg.eigh(columns @ columns.T)
    lost = values[0] <= SAME * values[-1]
    condition = float("inf") if lost else float(np.sqrt(values[-1] / values[0]))
    return condition, unit(vectors[:, 0])


def unit(force: np.ndarray) -> np.ndarray:
    """Return a force (2 M,) whose mean square over the parts is one."""
    return np.asarray(force / np.linalg.norm(force) * np.sqrt(len(force) / 2))
