"""The state of the parts on the plate, which the stages exchange, and the special part classes.

`Parts` contains ids, positions, velocities and angles at one instant, in plate_home. The id of a
part consists of its class and a number (`part_class`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from .errors import PlateError

MAX_PARTS = 100
"""Maximum number of parts in a scenario and in one request. For comparison, the solver needs three
seconds for one request with a thousand parts."""

UNKNOWN = "unknown"
"""Class of an object that may be a part but matches no part type."""

GROUP = "group"
"""Class of touching parts that vision cannot separate."""

NAMELESS = (UNKNOWN, GROUP)
"""Reserved class names. No part type is allowed to have one of these names."""

PLAUSIBLE_AREA = 0.3, 3.0
"""Factors that determine the range of plausible areas of a part [-]. The minimum is the first
factor times the area of the smallest part. The maximum is the second factor times the area of the
largest part. Smaller objects are dust or reflections, larger objects are tools or hands."""


class OverlookedThing(NamedTuple):
    """An object that vision detects but does not accept as a part. The fields are its centre x, y
    [m, plate_home], the radius of a disc of equal area [m], and the reason as text."""

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
        Class and number, such as `black_3`.
    position : (M, 2)
        Centres [m].
    velocity : (M, 2)
        Mean drift over the last cycles [m/s].
    angle : (M,)
        Orientation [rad], counter-clockwise.
    spin : (M,)
        Mean angular velocity over the last cycles [rad/s].
    friction_limit : (M,)
        Maximum friction force on the part, mu m g [N]. 0 if it was not estimated, so that the value
        of the rig file applies.
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
        """Build the parts. Omitted arrays are zero.

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
    """Return the class of a part id, for example `black` for `black_3`."""
    return part_id.rsplit("_", 1)[0]


def filled(name: str, array: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array with this shape, which has one row per part. If `array` is None, the result
    contains zeros.

    Raises
    ------
    PlateError
        If the array has another shape.
    """
    if array is None:
        return np.zeros(shape)
    values = np.array(array, float)
    if values.shape[:1] != shape[:1] or values.size != np.prod(shape):
        raise PlateError(f"{name} has shape {values.shape}, allowed: {shape} (a row per part)")
    return values.reshape(shape)
