"""Common functions of the tests of footprints."""

from dataclasses import replace

import numpy as np

from plate_sim.friction import Footprint


def on_feet(footprint: Footprint, feet: np.ndarray) -> Footprint:
    """A part that touches the plate only in points (n, 2) about its centre of mass [m]."""
    count = len(feet)
    return replace(
        footprint, points=np.array(feet), weights=np.full(count, 1 / count), blur=np.zeros(count)
    )


def friction_gap(one: Footprint, other: Footprint, slips: int = 4000) -> float:
    """Greatest difference of friction between two footprints, such as one and a finer one.

    Over seeded slips: half of them of any direction, half turns about points of the footprint.
    In mu m g, the torque by radius of gyration.
    """
    rng = np.random.default_rng(0)
    arm = np.sqrt(other.gyration2)
    slip = rng.normal(size=(slips, 3)) / [1, 1, arm]
    pivot = other.points[rng.integers(len(other.points), size=slips // 2)]
    slip[: slips // 2] = np.column_stack([pivot[:, 1], -pivot[:, 0], np.ones(len(pivot))])
    gap = 0.0
    for part in np.array_split(slip, 1 + slips * len(other.points) // 10**7):
        unlike = (one.friction(part) - other.friction(part)) / [1, 1, arm]
        gap = max(gap, float(np.linalg.norm(unlike, axis=1).max()))
    return gap
