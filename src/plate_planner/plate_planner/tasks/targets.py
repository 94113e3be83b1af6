"""Assignment of parts to targets, and the weights of the distances.

The assignment minimises the sum of squared distances (scipy's linear_sum_assignment). Only parts of
the correct class are assigned. The function `distance_weight` scales the longest distance to a
fixed length, so that this distance dominates the sum of squared errors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from plate_core import Parts, part_class

from ..estimation import rows_of

UNMATCHED = ""
"""Value that is returned in place of an id for a target without a part."""

WRONG_CLASS_M = 1e3
"""Cost of the assignment of a part to a target of another class [m]. The cost exceeds any sum of
distances on a plate, so such an assignment is never chosen."""

FULL_DISTANCE_M = 0.006
"""Value of the longest distance of a part from its target after weighting [m]. With this value, the
weighted distances are larger than the violations of the distance from the edges. The parts with the
longest distances move first."""

MIN_DISTANCE_M = 0.005
"""Lower limit of the longest distance from which the weights are computed [m]. If the longest
distance is shorter than this limit, the weights do not increase further."""

CROWD = 40
"""If there are more parts than this number, the plate rests between cycles and lanes have more
weight. The value was tuned in simulations of `sort_50`. With rest between cycles, 8 runs take 46 to
69 s, median 54 s. Without rest and with the weight `LANE`, 13 runs take 32 to 92 s, median 56 s.
Without rest and with the weight `CROWDED_LANE`, 9 runs take 40 to 75 s, median 52 s. Rest between
cycles thus does not change the median much, but without rest some runs take longer."""

GAP = 0.5
"""Minimum gap between the edges of two moving parts [radii of the rig's parts]."""


def match_targets(
    labels: Sequence[str], target: np.ndarray, parts: Parts, reach_m: float = np.inf
) -> tuple[str, ...]:
    """Assign parts to targets of their class. The assignment has the minimum sum of squared
    distances.

    Parameters
    ----------
    labels : P class names
        Class that each target requires.
    target : (P, 2)
        Target positions [m, plate_home].
    parts : Parts
        Parts that can be assigned to the targets.
    reach_m : float
        Maximum distance of a part from its assigned target [m].

    Returns
    -------
    tuple of P ids
        Id of the part that is assigned to each target. UNMATCHED if the target has no part.
    """
    target = np.reshape(target, (-1, 2))
    square = np.sum((target[:, None] - parts.position[None]) ** 2, axis=2)
    return match_by_cost(labels, square, parts, reach_m**2)


def match_by_cost(
    labels: Sequence[str], cost: np.ndarray, parts: Parts, max_cost: float = np.inf
) -> tuple[str, ...]:
    """Assign parts to P targets of their class. The assignment has the minimum sum of the costs
    `cost` (P, M) [m2]. If an assignment costs more than `max_cost` [m2], the part is not assigned.
    The result has the same form as in `match_targets`."""
    match = [UNMATCHED] * len(labels)
    if not len(parts) or not labels:
        return tuple(match)
    same = np.array([[part_class(i) == label for i in parts.ids] for label in labels])
    every = np.where(same, cost, WRONG_CLASS_M**2)
    for k, part in zip(*linear_sum_assignment(every), strict=True):
        if same[k, part] and cost[k, part] <= max_cost:
            match[k] = parts.ids[part]
    return tuple(match)


def rematch_targets(
    match: tuple[str, ...],
    labels: Sequence[str],
    target: np.ndarray,
    parts: Parts,
    reach_m: float,
) -> tuple[str, ...]:
    """If the part of a target is not detected, assign an unassigned part of the same class that is
    close to the target. The reason is that the detector gives a new id to a part that was hidden
    for a long time.
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
    """Return two arrays (K,): the indices of the targets whose parts are detected, and the indices
    of these parts."""
    row = rows_of(match, parts.ids)
    target = np.flatnonzero(row >= 0)
    return target, row[target]


def assign(labels: tuple[str, ...], position: np.ndarray, parts: Parts) -> np.ndarray:
    """Assign parts to places (P, 2) [m] that are intended for their class. The assignment minimises
    the sum of squared distances.

    Returns
    -------
    (M,) int
        Index of the place that is assigned to each part. The index is -1 for a part without a
        place.
    """
    return rows_of(parts.ids, match_targets(labels, position, parts))


def distance_weight(offset: np.ndarray) -> float:
    """Return the common weight [-] of the distances of parts from their targets. `offset` (M, 2)
    [m] contains these distances along x and y.

    If d is the longest distance, the weight is FULL_DISTANCE_M / max(d, MIN_DISTANCE_M).
    """
    return FULL_DISTANCE_M / max(float(np.max(np.hypot(*offset.T), initial=0.0)), MIN_DISTANCE_M)


def stay_within(
    coordinate: np.ndarray, half: float, inner: float, outer: float, speed: float, wander: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return intervals of drift along one coordinate that keep parts away from the plate's edges.

    Let e be the proximity of a part to the edges (`nearness`), and s the sign of its coordinate.
    The interval is

        -speed e s +- wander (1 - e).

    In the middle of the plate, any drift within +-wander is accepted. Beyond `outer`, only the
    drift `speed` inwards is accepted.

    Parameters
    ----------
    coordinate : (M,)
        Coordinate x or y of the parts [m, plate_home].
    half : float
        Half side length of the plate along this coordinate [m].
    inner, outer : float
        Start and end of the transition [fraction of `half`].
    speed : float
        Requested drift towards the middle at the edge [m/s].
    wander : float
        Maximum accepted drift in the middle of the plate [m/s].

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
    """Return the proximity of parts to an edge. The proximity is 0 up to `inner`, 1 from `outer`
    on, and linear in between. `inner` and `outer` are fractions of `half`."""
    return np.clip((np.abs(coordinate) / half - inner) / (outer - inner), 0, 1)
