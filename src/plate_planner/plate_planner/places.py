"""Parts to places: which drift leads each to its own, round the others.

Far from its place a part may wander and may be faster than asked; the nearer it is the less, down
to a band in which it may stay anywhere. So the solver is left the freedom that the task can spare.
"""

from __future__ import annotations

import numpy as np

from plate_core import Parts

from .assignment import UNMATCHED, match_paths
from .requests import DriftRequest

LOOSE = 0.3
"""How far beside its place a part may be asked to aim [share of the distance to go]."""

PASS_REACH, PASS_CLEAR = 4.5, 2.2
"""Distance of centres at which a part begins to turn aside, and does so fully [part radii]."""

NEARLY_THERE = 0.02
"""Ways that differ by much less than this count as equal [m]: a part that arrives is not slowed by
arriving."""

EDGE = 0.93
"""Parts are held back from the edges beyond this [share of the half side], unless their place is
nearer to them."""


def assign(labels: tuple[str, ...], place: np.ndarray, parts: Parts) -> np.ndarray:
    """Assign parts to places (P, 2) [m] of their class: least sum of squared distances.

    Returns
    -------
    (M,) int
        Row of each part's place; -1 for a part without one.
    """
    row = {part_id: i for i, part_id in enumerate(parts.ids)}
    result = np.full(len(parts), -1)
    for k, part_id in enumerate(match_paths(labels, place, parts)):
        if part_id != UNMATCHED:
            result[row[part_id]] = k
    return result


def paces(to_go: np.ndarray, least: float) -> np.ndarray:
    """How fast each part should go, so that all arrive together: 1 for the longest way.

    What is not asked of the parts with shorter ways is left to those with longer ones.

    Parameters
    ----------
    to_go : (M,)
        Ways [m]; NaN for a part that belongs nowhere.
    least : float
        Of the parts with the shortest ways [-].

    Returns
    -------
    (M,)
        From `least` to 1.
    """
    way = np.nan_to_num(to_go) + NEARLY_THERE
    return np.maximum(way / way.max(initial=NEARLY_THERE), least)


def approach_drift(
    position: np.ndarray,
    aim: np.ndarray,
    band: float,
    pace: np.ndarray,
    fastest: float,
    rate: float,
) -> DriftRequest:
    """Interval of drift that leads parts into the squares of half side `band` round their aims.

    Parameters
    ----------
    position, aim : (M, 2)
        Where the parts are, and where they are to be [m, plate_home].
    band : float
        [m].
    pace : (M,)
        Drift asked of the parts on their ways [m/s].
    fastest : float
        Greatest welcome drift [m/s].
    rate : float
        Rate at which the asked drift falls with the distance still to go [1/s].
    """
    gap = aim - position
    distance = np.hypot(*gap.T)[:, None]
    share = np.maximum(np.abs(gap) / np.maximum(distance, 1e-12), LOOSE)
    beside = band + LOOSE * distance
    slow, fast = pace[:, None] * share, fastest * share
    low = np.maximum(np.minimum(rate * (gap - beside), slow), -fast)
    high = np.minimum(np.maximum(rate * (gap + beside), -slow), fast)
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
    position: np.ndarray, aim: np.ndarray, half: np.ndarray, request: DriftRequest, rate: float
) -> DriftRequest:
    """Cut off drift that would lead parts to an edge within 1/rate [s]."""
    limit = np.maximum(EDGE * half, np.abs(aim))
    least, most = rate * (-limit - position), rate * (limit - position)
    low, high = np.clip(request.low, least, most), np.clip(request.high, least, most)
    return DriftRequest(low, high)
