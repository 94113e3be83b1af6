"""PartSet: the parts on the plate, as they travel from stage to stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PartSet:
    """Parts in plate_home at one instant, and what is asked of them.

    Attributes
    ----------
    ids : tuple of str
        Such as `black_3`: class and number.
    position : (M, 2)
        Centres [m].
    angle : (M,)
        Orientation [rad], counter-clockwise.
    velocity : (M, 2)
        Drift over the last cycles [m/s].
    force : (M, 2)
        Wanted mean force over a cycle [N]; zero where nothing is asked.
    tolerance : (M, 2)
        Any force within +-tolerance [N] of `force` is as good.
    torque : (M,)
        Wanted mean torque over a cycle [N m]; zero where any turning will do.
    spin : (M,)
        Turning over the last cycles [rad/s].
    grip : (M,)
        Greatest friction on it [N], mu m g; 0 where no more is known than the rig's facts.
    """

    ids: tuple[str, ...]
    position: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    tolerance: np.ndarray
    torque: np.ndarray
    grip: np.ndarray
    spin: np.ndarray

    @classmethod
    def make(
        cls,
        ids: tuple[str, ...],
        position: np.ndarray,
        velocity: np.ndarray | None = None,
        force: np.ndarray | None = None,
        tolerance: np.ndarray | None = None,
        torque: np.ndarray | None = None,
        angle: np.ndarray | None = None,
        grip: np.ndarray | None = None,
        spin: np.ndarray | None = None,
    ) -> PartSet:
        """Build a set; what is missing is zero."""
        count = len(ids)

        def pairs(array: np.ndarray | None) -> np.ndarray:
            return np.zeros((count, 2)) if array is None else np.array(array, float).reshape(-1, 2)

        def column(array: np.ndarray | None) -> np.ndarray:
            return np.zeros(count) if array is None else np.array(array, float).reshape(-1)

        return cls(
            tuple(ids),
            pairs(position),
            column(angle),
            pairs(velocity),
            pairs(force),
            pairs(tolerance),
            column(torque),
            column(grip),
            column(spin),
        )

    def __len__(self) -> int:
        return len(self.ids)


def part_class(part_id: str) -> str:
    """Return the class of a part id: `black` of `black_3`."""
    return part_id.rsplit("_", 1)[0]
