"""What the network is to say of a scene, at half of its resolution."""

from __future__ import annotations

import cv2
import numpy as np

STEP = 2
"""Pixels of an image to one of the network's maps."""

REACH_PX = 32.0
"""An offset of so many pixels of a map is 1."""


def make_targets(instances: np.ndarray) -> np.ndarray:
    """Return the maps of a scene.

    Parameters
    ----------
    instances : (H, W) int32
        Number of the part of each pixel; 0: ground.

    Returns
    -------
    (4, H / 2, W / 2) float32
        Whether a part is there; how deep in it, relative to its deepest point; the way from there
        to its middle, x and y [REACH_PX], 0 where none is. Where the border cuts a part off it is
        taken to go on.
    """
    small = instances[::STEP, ::STEP]
    maps = np.zeros((4, *small.shape), np.float32)
    maps[0] = small > 0
    for number in np.unique(instances):
        if number == 0:
            continue
        mask = (instances == number).astype(np.uint8)
        y, x = np.nonzero(mask)
        box = np.s_[y.min() : y.max() + 1, x.min() : x.max() + 1]
        rim = _beyond(mask, box)
        depth = np.zeros(mask.shape, np.float32)
        depth[box] = cv2.distanceTransform(rim, cv2.DIST_L2, 5)[1:-1, 1:-1]
        here = small == number
        if not here.any():
            continue
        maps[1][here] = (depth / max(float(depth.max()), 1.0))[::STEP, ::STEP][here]
        row, column = np.nonzero(here)
        maps[2][here] = (x.mean() / STEP - column) / REACH_PX
        maps[3][here] = (y.mean() / STEP - row) / REACH_PX
    return maps


def _beyond(mask: np.ndarray, box: tuple[slice, slice]) -> np.ndarray:
    """Return a part within its box and a pixel around: part there where the image ends."""
    rim = cv2.copyMakeBorder(mask[box], 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    rows, columns = box
    if rows.start == 0:
        rim[0] = rim[1]
    if rows.stop == mask.shape[0]:
        rim[-1] = rim[-2]
    if columns.start == 0:
        rim[:, 0] = rim[:, 1]
    if columns.stop == mask.shape[1]:
        rim[:, -1] = rim[:, -2]
    return np.asarray(rim)
