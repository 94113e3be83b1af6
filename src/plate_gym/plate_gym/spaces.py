"""Spaces of actions and observations: shapes, units and bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from plate_core import PlateCycle

from .motions import Motions
from .plates import Plates


class CycleSpace(spaces.Space):
    """Space of all cycles of the plate (`plate_core.PlateCycle`). If a cycle exceeds the rig's
    limits, the environment scales it down to these limits."""

    def __init__(self, motions: Motions) -> None:
        super().__init__()
        self._motions = motions

    def sample(self, mask: Any = None, probability: Any = None) -> PlateCycle:
        """Return a random cycle: the cycle that corresponds to a random action of the kind
        `motion`."""
        return self._motions.cycle(self.np_random.uniform(-1, 1, self._motions.size))[0]

    def contains(self, x: Any) -> bool:
        """Return whether `x` is a cycle of the plate."""
        return isinstance(x, PlateCycle)

    def __eq__(self, other: object) -> bool:
        """Whether the other space is also a CycleSpace. All objects of the class CycleSpace are
        equal."""
        return isinstance(other, CycleSpace)

    def __repr__(self) -> str:
        """Name of the space."""
        return "CycleSpace"

    @property
    def is_np_flattenable(self) -> bool:
        """False, because a cycle cannot be converted to an array of fixed size."""
        return False


def action_space(plates: Plates) -> spaces.Space:
    """Return the space of actions for M parts. The kind of action determines the shape:

    - `motion` (18,): see `Motions`.
    - `forces` (M, 2): mean force on each part over a cycle along x and y, divided by mu m g; -1 to
      1.
    - `progress` (M, 3): the target x, y of each part divided by the plate's half sides, and the
      weight of the part's distance from the target. For comparison, the distance by which parts are
      too close to an edge or to each other has the weight 1. If parts have angles, the action has
      two more columns (M, 5). The two columns contain the target angle divided by pi, and the
      weight of the arc length by which the contour of the part must rotate.
    - `cycle`: a `CycleSpace`.
    """
    count = len(plates.friction_limit)
    if plates.action == "cycle":
        return CycleSpace(plates.motions)
    if plates.action == "motion":
        return spaces.Box(-1.0, 1.0, (plates.motions.size,), np.float64)
    if plates.action == "forces":
        return spaces.Box(-1.0, 1.0, (count, 2), np.float64)
    low = np.tile([-1.0, -1.0, 0.0, -1.0, 0.0][: 5 if plates.turned else 3], (count, 1))
    return spaces.Box(low, np.ones_like(low), dtype=np.float64)


def observation_space(plates: Plates) -> spaces.Space:
    """Return the space of observations for M parts. The kind of observation and of task determines
    the shape:

    - `parts` (M, 6): one row for each part. A row contains x, y [m, plate_home], the drift along x
      and y [m/s], the angle [rad], and the time since the part was last detected [s]. A part that
      was never detected has the position 0.
    - `parts` (M, 10) for paths: four more columns contain the reference x, y of the part at the
      start of the next cycle, and its reference x, y 0.1 s later [m, plate_home].
    - `parts` (M, 7) for feed tasks: the last column is 1 for a part that must be picked, -1 for a
      part that must not be picked, and 0 for an empty row. The other columns of an empty row have
      the values of a part that was never detected.
    - `image`: grey levels (height, width), or colours (height, width, 3), of the rig's camera.
    """
    if plates.observation == "image":
        return spaces.Box(0, 255, plates.image_shape, np.uint8)
    shape = (len(plates.friction_limit), 1)
    low, high = (np.tile(bound, shape) for bound in plates.bounds)
    return spaces.Box(low, high, dtype=np.float64)
