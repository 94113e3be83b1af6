"""The parts on the plate, as they travel from stage to stage."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from .errors import PlateError

MOST_PARTS = 100
"""In a scenario, and in one request: a thousand keep the solver busy for three seconds."""

UNKNOWN = "unknown"
"""Class of a thing that may be a part, but matches no type."""

GROUP = "group"
"""Class of parts that touch and are not told apart."""

NAMELESS = (UNKNOWN, GROUP)
"""Classes that no type of part may have."""

PLAUSIBLE_AREA = 0.3, 3.0
"""Range of a thing's area that may be a part, relative to the smallest and the largest part [-].
Smaller things are dust or reflections, larger ones tools or hands."""


class OverlookedThing(NamedTuple):
    """A thing that vision sees and does not take for a part: centre x, y [m, plate_home], radius
    of the disc of the same area [m], and the reason in words."""

    x: float
    y: float
    radius: float
    reason: str


@dataclass(frozen=True)
class Parts:
    """Parts in plate_home at one instant.

    Attributes
    ----------
    ids : tuple of str
        Such as `black_3`: class and number.
    position : (M, 2)
        Centres [m].
    velocity : (M, 2)
        Drift over the last cycles [m/s].
    angle : (M,)
        Orientation [rad], counter-clockwise.
    spin : (M,)
        Turning over the last cycles [rad/s].
    friction_limit : (M,)
        Greatest friction on it [N], mu m g; 0 where no more is known than the rig's facts.
    """

    ids: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    friction_limit: np.ndarray

    @classmethod
    def make(
        cls,
        ids: tuple[str, ...],
        position: np.ndarray,
        velocity: np.ndarray | None = None,
        angle: np.ndarray | None = None,
        spin: np.ndarray | None = None,
        friction_limit: np.ndarray | None = None,
    ) -> Parts:
        """Build it; what is missing is zero.

        Raises
        ------
        PlateError
            If an array has another shape.
        """
        pair, single = (len(ids), 2), (len(ids),)
        return cls(
            tuple(ids),
            filled("position", position, pair),
            filled("velocity", velocity, pair),
            filled("angle", angle, single),
            filled("spin", spin, single),
            filled("friction_limit", friction_limit, single),
        )

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, rows: np.ndarray | list[int]) -> Parts:
        """Return the parts in these rows (K,)."""
        index = np.array(rows, dtype=int)
        arrays = [getattr(self, field.name)[index] for field in fields(self)[1:]]
        return Parts(tuple(self.ids[i] for i in index), *arrays)


def part_class(part_id: str) -> str:
    """Return the class of a part id: `black` of `black_3`."""
    return part_id.rsplit("_", 1)[0]


def filled(name: str, array: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of this shape, a row for each part; zeros if it is None.

    Raises
    ------
    PlateError
        If the array has another shape.
    """
    if array is None:
        return np.zeros(shape)
    values = np.array(array, float)
    if values.shape[:1] != shape[:1] or values.size != np.prod(shape):
        raise PlateError(f"{name} has shape {values.shape}, allowed: {shape}, a row for each part")
    return values.reshape(shape)
