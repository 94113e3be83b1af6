"""The spaces of actions and observations: shapes, units and bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from plate_core import PlateCycle

from .motions import Motions
from .plates import Plates


class CycleSpace(spaces.Space):
    """Any motion of the plate: a `plate_core.PlateCycle`, which the driver scales to the limits."""

    def __init__(self, motions: Motions) -> None:
        super().__init__()
        self._motions = motions

    def sample(self, mask: Any = None, probability: Any = None) -> PlateCycle:
        """Return a random motion of the space `motion`."""
        return self._motions.cycle(self.np_random.uniform(-1, 1, self._motions.size))[0]

    def contains(self, x: Any) -> bool:
        """Whether it is a motion of the plate."""
        return isinstance(x, PlateCycle)

    def __eq__(self, other: object) -> bool:
        """Whether the other space is a CycleSpace: all are equal."""
        return isinstance(other, CycleSpace)

    def __repr__(self) -> str:
        """Name of the space."""
        return "CycleSpace"

    @property
    def is_np_flattenable(self) -> bool:
        """False, because a motion cannot be converted to a row of numbers."""
        return False


def action_space(plates: Plates) -> spaces.Space:
    """Return the space of a kind of action, for M parts.

    `motion` (18,): see `Motions`. `forces` (M, 2): mean force on each part over a cycle along x and
    y, from -1 to 1 times mu m g. `progress` (M, 3): target of each part as a fraction of the
    plate's half sides, and the weight of a metre of its distance, compared with a weight of 1 for
    parts too near to an edge or to each other; (M, 5) if parts have angles: then the angle over pi,
    and the weight of the distance of its contour. `cycle`: a `CycleSpace`.
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
    """Return the space of observations.

    `parts` (M, 6), one fixed row for each part: x, y [m, plate_home], drift along x and y [m/s],
    angle [rad], and time since the part was last seen [s]; a part that was never seen is at 0.
    (M, 10) for paths: then its reference at the start of the next cycle, x and y [m, plate_home],
    and 0.1 s later. (M, 7) if parts come and go: then 1 for a part to be picked, -1 for one that is
    not, 0 for an empty row, which looks like a part that was never seen.
    `image`: grey levels (height, width), or colours (height, width, 3), of the rig's camera.
    """
    if plates.observation == "image":
        return spaces.Box(0, 255, plates.image_shape, np.uint8)
    shape = (len(plates.friction_limit), 1)
    low, high = (np.tile(bound, shape) for bound in plates.bounds)
    return spaces.Box(low, high, dtype=np.float64)
