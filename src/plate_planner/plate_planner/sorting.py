"""Sorting: which drift to ask of each part so that every class ends on its side.

Only what the task needs is asked: a part on its way may be faster than asked, a part that has
arrived may stay anywhere in its band, and y is free until an edge or another part is near. What is
not asked leaves the solver freedom, and with many parts it has none to waste.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from plate_core import PartSet, Rig
from plate_core.parts import part_class
from plate_core.scenario import SortTask

from .requests import DriftRequest, nearness, stay_within


@dataclass(frozen=True)
class SortOptions:
    """Speeds [m/s] and places [share of the plate's half side] of the sorting rules.

    Attributes
    ----------
    drift_max : float
        Drift asked of a part on its way; up to `over` times this is welcome [m/s].
    over : float
        Greatest welcome drift, in multiples of drift_max [-].
    approach : float
        Rate at which the asked drift falls with the distance still to go [1/s].
    wander : float
        Drift allowed where nothing is asked, in multiples of drift_max [-].
    margin : float
        How far beyond the goal line parts are asked to go [share of half length].
    edge_inner, edge_outer : float
        Where the edges along y begin to push back, and where they do so fully [share of half].
    end : float
        Where parts are asked back from the ends of the plate [share of half length].
    dodge : float
        Drift along y asked of two parts about to run into each other, in drift_max [-]; 0: none.
    dodge_reach : float
        Distance of centres along x at which they begin to dodge [part radii].
    dodge_clear : float
        Distance of centres along y at which they need not dodge [part radii].
    force_share_max : float
        Greatest component of the force to ask for [mu m g].
    """

    drift_max: float = 0.012
    over: float = 2.0
    approach: float = 1.5
    wander: float = 0.6
    margin: float = 0.06
    edge_inner: float = 0.70
    edge_outer: float = 0.85
    end: float = 0.85
    dodge: float = 0.4
    dodge_reach: float = 5.0
    dodge_clear: float = 3.0
    force_share_max: float = 1.0


def part_sides(ids: tuple[str, ...], sides: Mapping[str, int]) -> np.ndarray:
    """Side of every part (M,): -1 left, +1 right, 0 for a class without a goal."""
    return np.array([sides.get(part_class(i), 0) for i in ids], dtype=float)


def is_sorted(parts: PartSet, task: SortTask, rig: Rig) -> np.ndarray:
    """Whether each part (M,) is beyond the goal line on its own side."""
    side = part_sides(parts.ids, task.sides)
    goal = task.goal_fraction * rig.plate.half[0]
    return (side != 0) & (parts.position[:, 0] * side > goal)


def sort_request(
    parts: PartSet, task: SortTask, rig: Rig, period: float, options: SortOptions
) -> DriftRequest:
    """Return the drift wanted of each part.

    Parameters
    ----------
    parts : PartSet
        Parts as seen, M of them.
    task : SortTask
    rig : Rig
    period : float
        Length of a cycle [s]: the request acts one cycle after `parts` was seen.
    options : SortOptions

    Returns
    -------
    DriftRequest
        Intervals (M, 2) [m/s, plate_home].
    """
    position = parts.position + period * parts.velocity
    side = part_sides(parts.ids, task.sides)
    half = rig.plate.half
    low_x, high_x = _along(position[:, 0], side, task.goal_fraction, half[0], options)
    wander = options.wander * options.drift_max
    low_y, high_y = stay_within(
        position[:, 1], half[1], options.edge_inner, options.edge_outer, options.drift_max, wander
    )
    low_y, high_y = _dodge(position, (low_x + high_x) / 2, low_y, high_y, rig, options)
    return DriftRequest(np.column_stack([low_x, low_y]), np.column_stack([high_x, high_y]))


def _along(
    x: np.ndarray, side: np.ndarray, goal: float, half: float, options: SortOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Interval of drift (M,) along x that leads into the band beyond the goal line.

    Far from the band it is [drift_max, over drift_max] towards the own side; inside it, whatever
    does not lead out soon; beyond it, back.
    """
    speed, wander = options.drift_max, options.wander * options.drift_max
    own = x * side  # grows towards the own side, for either side
    inner = half * (goal + options.margin)
    outer = half * max(options.end, goal + 2 * options.margin)
    low = np.clip(options.approach * (inner - own), -wander, speed)
    high = np.clip(options.approach * (outer - own), -speed, options.over * speed)
    low = np.minimum(low, high)
    free_low, free_high = stay_within(
        x, half, options.edge_inner, options.edge_outer, speed, wander
    )
    return (
        np.where(side > 0, low, np.where(side < 0, -high, free_low)),
        np.where(side > 0, high, np.where(side < 0, -low, free_high)),
    )


def _dodge(
    position: np.ndarray,
    drift_x: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    rig: Rig,
    options: SortOptions,
) -> tuple[np.ndarray, np.ndarray]:
    """Narrow the interval of drift along y of parts about to run into each other along x.

    Of two parts that are asked towards each other, and nearly level in y, the upper one is sent
    up, the lower one down (of two exactly level, the first in the list goes down). The nearer the
    edge, the less they are: the edge comes first.
    """
    radius, half = rig.parts.radius_m, rig.plate.half[1]
    gap = position[None] - position[:, None]  # [i, j]: from i to j
    closing = (drift_x[None] - drift_x[:, None]) * gap[..., 0] < 0
    # Over one radius from "far" to "near", so that a request does not jump.
    near = np.clip(options.dodge_reach - np.abs(gap[..., 0]) / radius, 0, 1)
    level = np.clip(options.dodge_clear - np.abs(gap[..., 1]) / radius, 0, 1)
    index = np.arange(len(position))
    level_order = np.sign(index[:, None] - index[None])
    away = np.where(gap[..., 1] != 0, -np.sign(gap[..., 1]), level_order)
    push = np.clip(np.sum(away * closing * near * level, axis=1), -1, 1)
    push *= 1 - nearness(position[:, 1], half, options.edge_inner, options.edge_outer)
    speed = options.dodge * options.drift_max
    if speed == 0:
        return low, high
    up = low + np.maximum(push, 0) * np.maximum(speed - low, 0)
    down = high - np.maximum(-push, 0) * np.maximum(high + speed, 0)
    return np.where(push > 0, np.minimum(up, high), low), np.where(
        push < 0, np.maximum(down, low), high
    )
