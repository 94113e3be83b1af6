"""Order of rotations for averaged forces: a short tour with small changes between neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import _kernels
from ..rotations.plan import RotationPlan


def filled(plan: RotationPlan) -> RotationPlan:
    """Return the plan with the rest of the time spent on its longest rotation, to and fro.

    On average that does nothing, whereas at rest the slightest motion counts as full friction.
    """
    left, j = 1 - float(np.sum(plan.fraction)), int(np.argmax(plan.fraction))
    fraction = np.append(plan.fraction, left / 2)
    fraction[j] += left / 2
    return replace(
        plan,
        twist=np.vstack([plan.twist, -plan.twist[j]]),
        fraction=fraction,
        priority=np.append(plan.priority, plan.priority[j]),
    )


def nearest_order(twists: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the order (J,) of twists (J, 3) in which little changes from one to the next.

    Changes are those of the plate's fastest corner: they are what ramps cost. From rest the nearest
    neighbour is taken each time, then stretches are turned round as long as that shortens the tour.
    """
    tour = _kernels.short_tour(np.vstack([np.zeros(3), twists]), half)
    return np.array(tour, dtype=int) - 1
