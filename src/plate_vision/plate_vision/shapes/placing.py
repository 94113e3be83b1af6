"""Where a part may lie in a group: all places and turns are tried."""

from __future__ import annotations

import numpy as np

from .. import _kernels

NEAR_PX: float = _kernels.NEAR_PX
"""How near the group's rim is to a part's where it is the same [px]."""

OUTSIDE_PX: float = _kernels.OUTSIDE_PX
"""How far outside a part may seem to be [px]."""

MOST_OUTSIDE: float = _kernels.MOST_OUTSIDE
"""Largest fraction of a part outside the group."""


def support(
    free: np.ndarray,
    border: np.ndarray,
    to_px: np.ndarray,
    rim: np.ndarray,
    inner: np.ndarray,
    pose: np.ndarray,
) -> tuple[float, float]:
    """Return which fraction of a part's rim is on the group's, less that which is outside, and
    which of its inner points is not where it is free."""
    seen, outside = _kernels.support(free, border, to_px, rim, inner, pose)
    return seen, outside


def search(
    free: np.ndarray,
    border: np.ndarray,
    to_px: np.ndarray,
    rim: np.ndarray,
    inner: np.ndarray,
    pole: np.ndarray,
    depth: float,
    turns: np.ndarray,
    stride: int,
) -> np.ndarray:
    """Return for each place (n, 4) where a part's widest place may be: x, y [m], the angle [rad]
    at which most of its rim is seen, and how much.
    """
    found: np.ndarray = _kernels.search(free, border, to_px, rim, inner, pole, depth, turns, stride)
    return found
