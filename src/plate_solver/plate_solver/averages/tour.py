"""Determines the order of the rotations of a plan for averaged forces. The order is a short closed
tour through the twists of the rotations, so that the ramps between rotations are short. The tour is
computed by the nearest-neighbour and 2-opt methods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import _kernels
from ..rotations.plan import RotationPlan


def filled(plan: RotationPlan) -> RotationPlan:
    """Return the plan with its remaining time filled, so that the plate never rests. In the
    remaining time of the cycle, the longest rotation is executed additionally, half of the time
    forwards and half of the time backwards.

    The average force of this additional rotation is 0. The plate must not rest, because even the
    slightest motion of a resting plate would cause full friction.
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
    """Return an order (J,) of the twists (J, 3) in which consecutive twists differ little.

    The length of a ramp between two twists is proportional to the velocity change of the plate's
    fastest corner. Therefore, this velocity change is used as the distance between two twists. The
    tour starts with the plate at rest.
    """
    tour = _kernels.short_tour(np.vstack([np.zeros(3), twists]), half)
    return np.array(tour, dtype=int) - 1
