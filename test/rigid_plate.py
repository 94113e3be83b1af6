"""A rigid plate that four motors move, and tables that it can follow."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from device_orders import wave

from plate_core import Rig
from plate_core.serial_protocol import Knot

Enabled = tuple[bool, ...]


class Plate:
    """Rigid plate that also moves the motors without current.

    `homes` are the positions that the drives report at home, and `counts` their signed change per
    metre.
    """

    def __init__(self, rig: Rig, homes: Sequence[float], counts: Sequence[float]) -> None:
        (x, y), (ex, ey) = np.array([[m.point, m.direction] for m in rig.motors]).transpose(1, 2, 0)
        self.levers = np.column_stack([ex, ey, x * ey - y * ex])
        self.homes, self.counts = np.array(homes), np.array(counts)
        self.known: dict[Enabled, np.ndarray] = {}

    def nearest(self, enabled: Enabled) -> np.ndarray:
        """Return the matrix (4, 4) from the travel of each motor alone to the travel on the
        plate."""
        weight = np.where(enabled, 1, 1e-3)
        return self.levers @ np.linalg.pinv(weight[:, None] * self.levers) * weight

    def wave(self, size: float, turns: bool = False) -> tuple[Knot, ...]:
        """Return a closed table that the plate can follow, with motor travel up to `size` [m]. With
        `turns` the plate only rotates."""
        knots, taken = wave(size), self.nearest((True,) * 4)
        if turns:
            taken = np.outer(self.levers[:, 2] / np.max(np.abs(self.levers[:, 2])), [1, 0, 0, 0])
        states = np.array([[k.position, k.velocity, k.acceleration] for k in knots]) @ taken.T
        return tuple(
            Knot(k.ticks, *(tuple(map(float, row)) for row in state))
            for k, state in zip(knots, states.astype(np.float32), strict=True)
        )

    def hold(self, drives: Sequence[Any]) -> None:
        """Set the positions of all motors to those on the plate."""
        enabled = tuple(drive.enabled for drive in drives)
        if enabled not in self.known:
            self.known[enabled] = self.nearest(enabled)
        travel = (np.array([drive.position for drive in drives]) - self.homes) / self.counts
        places = self.homes + self.known[enabled] @ travel * self.counts
        for drive, place in zip(drives, places.tolist(), strict=True):
            drive.position = place
