"""Parts to targets: which part goes to which, and which drift leads it there, round the others.

Far from its place a part may wander and may be faster than asked; the nearer it is the less, down
to a band in which it may stay anywhere. So the solver is left the freedom that the task can spare.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from plate_core import Parts, part_class

from ..estimation import rows_of
from .task import DriftRequest

UNMATCHED = ""
"""Stands for the id of a target without a part."""

WRONG_CLASS_M = 1e3
"""Cost of a part of the wrong class [m]: more than any sum of distances on a plate."""

LOOSE = 0.3
"""How far beside its place a part may be asked to aim [fraction of the distance to go]."""

PASS_REACH, PASS_CLEAR = 4.5, 2.2
"""Distance of centres at which a part begins to turn aside, and does so fully [part radii]."""

LEAST, OVER = 0.3, 2.0
"""Least drift asked of a part with a shorter way, and greatest welcome drift [drift_max]."""

APPROACH = 1.5
"""Rate at which the asked drift falls with the distance still to go [1/s]."""

NEARLY_THERE_M = 0.02
"""Ways that differ by much less than this count as equal [m]: a part that arrives is not slowed by
arriving."""

EDGE = 0.93
"""Parts are held back from the edges beyond this [fraction of the half side], unless their place is
nearer to them."""


RESCUE = (0.88, 0.95)
"""Where a part is so near an edge that it goes before the others, and alone [fraction of the half
side]."""

SAFE = (0.70, 0.85)
"""Meanwhile the others may go towards an edge up to the first, and from the second on not at all
[fraction of the half side]."""


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
    match = [UNMATCHED] * len(labels)
    if not len(parts) or not labels:
        return tuple(match)
    distance = np.hypot(*(target[:, None] - parts.position[None]).transpose(2, 0, 1))
    same = np.array([[part_class(i) == label for i in parts.ids] for label in labels])
    cost = np.where(same, distance**2, WRONG_CLASS_M**2)
    for k, part in zip(*linear_sum_assignment(cost), strict=True):
        if same[k, part] and distance[k, part] <= reach_m:
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


def speed_scaling(to_go: np.ndarray) -> np.ndarray:
    """How fast each part should go, so that all arrive together: 1 for the longest way.

    What is not asked of the parts with shorter ways is left to those with longer ones.

    Parameters
    ----------
    to_go : (M,)
        Ways [m]; NaN for a part that belongs nowhere.

    Returns
    -------
    (M,)
        From `LEAST` to 1.
    """
    way = np.nan_to_num(to_go) + NEARLY_THERE_M
    return np.maximum(way / way.max(initial=NEARLY_THERE_M), LEAST)


def approach_drift(
    position: np.ndarray,
    aim: np.ndarray,
    band: float,
    speed: np.ndarray,
    fastest: float,
) -> DriftRequest:
    """Interval of drift that leads parts into the squares of half side `band` round their aims.

    Parameters
    ----------
    position, aim : (M, 2)
        Where the parts are, and where they are to be [m, plate_home].
    band : float
        [m].
    speed : (M,)
        Drift asked of the parts on their ways [m/s].
    fastest : float
        Greatest welcome drift [m/s].
    """
    gap = aim - position
    distance = np.hypot(*gap.T)[:, None]
    cosine = np.maximum(np.abs(gap) / np.maximum(distance, 1e-12), LOOSE)
    beside = band + LOOSE * distance
    slow, fast = speed[:, None] * cosine, fastest * cosine
    low = np.maximum(np.minimum(APPROACH * (gap - beside), slow), -fast)
    high = np.minimum(np.maximum(APPROACH * (gap + beside), -slow), fast)
    return DriftRequest(low, high)


def pass_by(position: np.ndarray, request: DriftRequest, radius: float) -> DriftRequest:
    """Turn parts that are asked towards another to their right, so that they go round it.

    What leads part i towards a near part j is taken from its drift, and asked of it across the
    line of centres in its place. Two that meet both turn right; one at rest stays where it is.
    """
    gap = position[None] - position[:, None]  # [i, j]: from i to j
    distance = np.hypot(*gap.transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    ahead = gap / np.maximum(distance, 1e-12)[..., None]
    near = np.clip((PASS_REACH - distance / radius) / (PASS_REACH - PASS_CLEAR), 0, 1)
    closing = np.maximum(np.sum(request.centre[:, None] * ahead, axis=2), 0)
    right = np.stack([ahead[..., 1], -ahead[..., 0]], axis=-1)
    turn = np.sum((near * closing)[..., None] * (right - ahead), axis=1)
    return DriftRequest(request.low + turn, request.high + turn)


def hold_back(
    position: np.ndarray, aim: np.ndarray, half: np.ndarray, request: DriftRequest
) -> DriftRequest:
    """Cut off drift that would lead parts to an edge within 1/APPROACH [s]."""
    limit = np.maximum(EDGE * half, np.abs(aim))
    least, most = APPROACH * (-limit - position), APPROACH * (limit - position)
    low, high = np.clip(request.low, least, most), np.clip(request.high, least, most)
    return DriftRequest(low, high)


def edges_first(
    position: np.ndarray,
    aim: np.ndarray,
    half: np.ndarray,
    request: DriftRequest,
    wander: float,
    fastest: float,
) -> DriftRequest:
    """Let parts that are nearly off the plate go first: little else is asked until they are safe.

    A cycle that cannot give all that is asked of it misses something of everything, and a part near
    an edge then creeps over it. The nearer the nearest part is to an edge, the less is asked of the
    others: in the end only not to go nearer to one. Of itself is asked what was asked before, only
    faster inwards is welcome.

    Parameters
    ----------
    position, aim : (M, 2)
        Where the parts are, and the places they are to have; 0 where they have none
        [m, plate_home]. A part is in danger nearer to an edge than its place only.
    half : (2,)
        Half sides of the plate [m].
    request : DriftRequest
        What is asked of the parts.
    wander, fastest : float
        Drift allowed of the others [m/s], and greatest welcome drift inwards [m/s].
    """
    begins = np.maximum(RESCUE[0] * half, np.abs(aim))
    edge = np.clip((np.abs(position) - begins) / ((RESCUE[1] - RESCUE[0]) * half), 0, 1)
    danger = float(np.max(edge, initial=0.0))
    if danger == 0:
        return request
    outwards = wander * (1 - nearness(position, half, *SAFE))
    upper = position > 0  # inwards is down
    others = danger * (1 - np.clip(4 * edge, 0, 1))
    low_share, high_share = np.where(upper, danger, others), np.where(upper, others, danger)
    low = np.where(upper, -fastest, -outwards)
    high = np.where(upper, outwards, fastest)
    return DriftRequest(
        (1 - low_share) * request.low + low_share * low,
        (1 - high_share) * request.high + high_share * high,
    )


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
