"""What actions and observations look like: units and bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from plate_core import PlateCycle

from .motions import Motions
from .plates import Plates


class CycleSpace(spaces.Space):
    """Any motion of the plate: a `plate_core.PlateCycle`, which the driver fits into the limits."""

    def __init__(self, motions: Motions) -> None:
        super().__init__()
        self._motions = motions

    def sample(self, mask: Any = None, probability: Any = None) -> PlateCycle:
        """Return a motion as `motion` has them."""
        return self._motions.cycle(self.np_random.uniform(-1, 1, self._motions.size))[0]

    def contains(self, x: Any) -> bool:
        """Whether it is a motion."""
        return isinstance(x, PlateCycle)

    def __eq__(self, other: object) -> bool:
        """Whether it is one too: all have the same."""
        return isinstance(other, CycleSpace)

    def __repr__(self) -> str:
        """Its name."""
        return "CycleSpace"

    @property
    def is_np_flattenable(self) -> bool:
        """It cannot be made a row of numbers."""
        return False


def action_space(plates: Plates) -> spaces.Space:
    """Return the space of a level of action, for M parts.

    `motion` (18,): see `Motions`. `forces` (M, 2): mean force on each part over a cycle, from -1 to
    1 times mu m g, along x and y. `progress` (M, 3): where each part is to come, as a share of the
    plate's half sides, and what a metre of its way there counts, beside one by which a part is too
    near to an edge or to another part; (M, 5) where parts have angles: then the angle over pi, and
    what the way of its rim counts. `cycle`: a `CycleSpace`.
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
    """Return the space of what is seen.

    `parts` (M, 6), a row for each part, always the same: x, y [m, plate_home], drift along x and y
    [m/s], angle [rad], and how long ago the part was seen [s]; a part that was never seen is at 0.
    (M, 10) where paths are followed: then where it is to be when the next cycle begins, x and y
    [m, plate_home], and 0.1 s later. (M, 7) where parts come and go: then 1 for one that is wanted,
    -1 for one that is not, 0 for an empty row, which is as of a part that was never seen.
    `image`: grey levels (height, width), or colours (height, width, 3), of the rig's camera.
    """
    if plates.observation == "image":
        return spaces.Box(0, 255, plates.image_shape, np.uint8)
    shape = (len(plates.friction_limit), 1)
    low, high = (np.tile(bound, shape) for bound in plates.bounds)
    return spaces.Box(low, high, dtype=np.float64)
