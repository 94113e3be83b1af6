"""Which part follows which path: vision numbers the parts in no particular order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from plate_core import Parts, part_class

UNMATCHED = ""
"""Stands for the id of a path without a part."""

WRONG_CLASS_M = 1e3
"""Cost of a part of the wrong class [m]: more than any sum of distances on a plate."""


def match_paths(
    labels: Sequence[str], target: np.ndarray, parts: Parts, reach_m: float = np.inf
) -> tuple[str, ...]:
    """Match parts to paths of their class so that the sum of squared distances is least.

    Parameters
    ----------
    labels : P class names
        Class of the part that each path wants.
    target : (P, 2)
        Where the part of each path should be [m, plate_home].
    parts : Parts
        The parts on offer.
    reach_m : float
        Pairs further apart than this are not matched [m].

    Returns
    -------
    tuple of P ids
        Id of the part of each path, UNMATCHED where there is none.
    """
    match = [UNMATCHED] * len(labels)
    if not len(parts) or not labels:
        return tuple(match)
    distance = np.hypot(*(target[:, None] - parts.position[None]).transpose(2, 0, 1))
    same = np.array([[part_class(i) == label for i in parts.ids] for label in labels])
    cost = np.where(same, distance**2, WRONG_CLASS_M**2)
    for path, part in zip(*linear_sum_assignment(cost), strict=True):
        if same[path, part] and distance[path, part] <= reach_m:
            match[path] = parts.ids[part]
    return tuple(match)


def rematch_paths(
    match: tuple[str, ...],
    labels: Sequence[str],
    target: np.ndarray,
    parts: Parts,
    reach_m: float,
) -> tuple[str, ...]:
    """Give paths whose part is not seen a new part, if an unknown one of its class is near.

    A part that was hidden for long comes back from vision under a new number.
    """
    open_paths = [k for k, part_id in enumerate(match) if part_id not in parts.ids]
    spare = [i for i, part_id in enumerate(parts.ids) if part_id not in match]
    if not open_paths or not spare:
        return match
    offer = parts.take(spare)
    found = match_paths([labels[k] for k in open_paths], target[open_paths], offer, reach_m)
    result = list(match)
    for k, part_id in zip(open_paths, found, strict=True):
        if part_id != UNMATCHED:
            result[k] = part_id
    return tuple(result)
