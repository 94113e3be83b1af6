"""Bins: slots in a polygon, one for each part that is sorted into it."""

from __future__ import annotations

import numpy as np

from plate_core import Rig, ScenarioError
from plate_core.tasks import Bin, Scenario, SortTask

SLOT_SPACING, SLOT_CLEAR = 3.5, 1.25
"""Distance of neighbouring slots, and of slots from the bin's sides [part radii]."""

GRID_TRIES = 4
"""Shifts of the grid of slots that are tried along each axis: the one with most slots is taken."""


def inside(point: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Whether points (..., 2) are in a polygon (n, 2): a ray from each crosses it an odd number."""
    after = np.roll(corner, -1, axis=0)
    x, y = point[..., 0, None], point[..., 1, None]
    crosses = (corner[:, 1] > y) != (after[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (y - corner[:, 1]) / (after[:, 1] - corner[:, 1])
        right = x < corner[:, 0] + share * (after[:, 0] - corner[:, 0])
    return np.asarray(np.sum(crosses & right, axis=-1) % 2 == 1)


def outline_distance(point: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Distance (...) [m] of points (..., 2) from the sides of a polygon (n, 2) [m]."""
    edge = np.roll(corner, -1, axis=0) - corner
    offset = point[..., None, :] - corner
    share = np.clip(np.sum(offset * edge, axis=-1) / np.sum(edge**2, axis=-1), 0, 1)
    nearest = offset - share[..., None] * edge
    return np.asarray(np.min(np.hypot(nearest[..., 0], nearest[..., 1]), axis=-1))


def slots(region: Bin, rig: Rig) -> np.ndarray:
    """Return places (n, 2) [m] in a bin, on a square grid, apart from each other and its sides."""
    corner = np.array(region.corner)
    spacing, clear = SLOT_SPACING * rig.parts.radius_m, SLOT_CLEAR * rig.parts.radius_m
    low, high = np.min(corner, axis=0), np.max(corner, axis=0)
    best = np.zeros((0, 2))
    for shift in np.ndindex(GRID_TRIES, GRID_TRIES):
        start = low + clear + spacing * np.array(shift) / GRID_TRIES
        axes = [np.arange(a, b - clear + 1e-9, spacing) for a, b in zip(start, high, strict=True)]
        point = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        fits = inside(point, corner) & (outline_distance(point, corner) >= clear - 1e-9)
        if np.sum(fits) > len(best):
            best = point[fits]
    return best


def check_bins(scenario: Scenario, rig: Rig) -> None:
    """Refuse a scenario with a bin that has no room for the parts of its class.

    Raises
    ------
    ScenarioError
        Names the class, how many parts it has and how many there is room for.
    """
    if not isinstance(scenario.task, SortTask):
        return
    for group in scenario.parts:
        region = scenario.task.regions[group.label]
        room = len(slots(region, rig)) if isinstance(region, Bin) else group.count
        if group.count > room:
            raise ScenarioError(
                f"scenario {scenario.name}: bin of {group.label} is for {group.count} parts, "
                f"allowed: at most {room}, {SLOT_SPACING:g} part radii apart"
            )
