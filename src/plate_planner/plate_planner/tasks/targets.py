"""Parts to targets: which part goes to which, and what its way there counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from plate_core import Parts, part_class

from ..estimation import rows_of

UNMATCHED = ""
"""Stands for the id of a target without a part."""

WRONG_CLASS_M = 1e3
"""Cost of a part of the wrong class [m]: more than any sum of distances on a plate."""

FULL_WAY_M, LEAST_WAY_M = 0.006, 0.005
"""The longest way of all counts as if it were so long beside ways over an edge, so that those with
the longest ways come first; ways below the second are no longer stretched so [m]."""

CROWD = 40
"""With more parts than this each moves a little in a cycle: a plate that rests between cycles, and
lanes that count more, are sooner done with them, by trial (`sort_50`)."""

GAP = 0.5
"""Least distance of the rims of two parts on their ways [radii of the rig's parts]."""


def match_targets(
    labels: Sequence[str], target: np.ndarray, parts: Parts, reach_m: float = np.inf
) -> tuple[str, ...]:
    """Match parts to targets of their class so that the sum of squared distances is least.

    Parameters
    ----------
    labels : P class names
        Class of the part that each target wants.
    target : (P, 2)
        Where the part of each target should be [m, plate_home].
    parts : Parts
        The parts on offer.
    reach_m : float
        Pairs further apart than this are not matched [m].

    Returns
    -------
    tuple of P ids
        Id of the part of each target, UNMATCHED where there is none.
    """
    target = np.reshape(target, (-1, 2))
    square = np.sum((target[:, None] - parts.position[None]) ** 2, axis=2)
    return match_by_cost(labels, square, parts, reach_m**2)


def match_by_cost(
    labels: Sequence[str], cost: np.ndarray, parts: Parts, most: float = np.inf
) -> tuple[str, ...]:
    """Match parts to P targets of their class so that the sum of costs (P, M) [m2] is least; pairs
    that cost more than `most` are not matched. Returns as `match_targets`."""
    match = [UNMATCHED] * len(labels)
    if not len(parts) or not labels:
        return tuple(match)
    same = np.array([[part_class(i) == label for i in parts.ids] for label in labels])
    every = np.where(same, cost, WRONG_CLASS_M**2)
    for k, part in zip(*linear_sum_assignment(every), strict=True):
        if same[k, part] and cost[k, part] <= most:
            match[k] = parts.ids[part]
    return tuple(match)


def rematch_targets(
    match: tuple[str, ...],
    labels: Sequence[str],
    target: np.ndarray,
    parts: Parts,
    reach_m: float,
) -> tuple[str, ...]:
    """Give targets whose part is not seen a new part, if an unknown one of its class is near.

    A part that was hidden for long comes back from vision under a new number.
    """
    vacant = [k for k, part_id in enumerate(match) if part_id not in parts.ids]
    spare = [i for i, part_id in enumerate(parts.ids) if part_id not in match]
    if not vacant or not spare:
        return match
    offer = parts.take(spare)
    found = match_targets([labels[k] for k in vacant], target[vacant], offer, reach_m)
    result = list(match)
    for k, part_id in zip(vacant, found, strict=True):
        if part_id != UNMATCHED:
            result[k] = part_id
    return tuple(result)


def matched_rows(match: tuple[str, ...], parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """Rows of targets, and of the parts that are seen and have them: two index arrays (K,)."""
    row = rows_of(match, parts.ids)
    target = np.flatnonzero(row >= 0)
    return target, row[target]


def assign(labels: tuple[str, ...], place: np.ndarray, parts: Parts) -> np.ndarray:
    """Assign parts to places (P, 2) [m] of their class: least sum of squared distances.

    Returns
    -------
    (M,) int
        Row of each part's place; -1 for a part without one.
    """
    return rows_of(parts.ids, match_targets(labels, place, parts))


def way_weight(way: np.ndarray) -> float:
    """Return what a metre of way counts where parts have ways (M, 2) [m] to go."""
    return FULL_WAY_M / max(float(np.max(np.hypot(*way.T), initial=0.0)), LEAST_WAY_M)


def stay_within(
    coordinate: np.ndarray, half: float, inner: float, outer: float, speed: float, wander: float
) -> tuple[np.ndarray, np.ndarray]:
    """Leave a coordinate free in the middle, and ask it back near the plate's edges.

    Up to `inner` (fraction of the half side) any drift within +-wander will do; from there to
    `outer` the interval narrows to one value, and its middle goes from 0 to `speed` inwards.

    Parameters
    ----------
    coordinate : (M,)
        x or y [m, plate_home].
    half : float
        Half side of the plate along it [m].
    inner, outer : float
        Where the edge begins to count, and where it counts fully [fraction of half].
    speed : float
        Drift asked for at the edge [m/s].
    wander : float
        Drift allowed in the middle [m/s].

    Returns
    -------
    low, high : (M,)
        Interval of drift [m/s].
    """
    edge = nearness(coordinate, half, inner, outer)
    middle = -speed * edge * np.sign(coordinate)
    width = wander * (1 - edge)
    return middle - width, middle + width


def nearness(
    coordinate: np.ndarray, half: float | np.ndarray, inner: float, outer: float
) -> np.ndarray:
    """How near an edge is: 0 up to `inner`, 1 from `outer` (fractions of half), linear between."""
    return np.clip((np.abs(coordinate) / half - inner) / (outer - inner), 0, 1)
