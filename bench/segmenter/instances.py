"""From the network's maps to parts: pixels that point to one middle are one part."""

from __future__ import annotations

import cv2
import numpy as np

from segmenter.targets import REACH_PX, STEP

THERE = 0.5
"""From this probability on a pixel shows a part."""

CORE, SURE_CORE = 0.55, 0.62
"""Depth from which on a pixel is of a core, and which its deepest pixel must have."""

ONE_MIDDLE = 0.5
"""Cores whose middles are nearer than this fraction of the nearer one's distance to the rim, twice
over, are of one part."""

LEAST_PX2 = 6
"""Of a part, in the network's pixels."""

MULTIPLE = 64
"""Sides of what the network sees are multiples of it."""


def read_network(path: str) -> cv2.dnn.Net:
    """Read the network's file."""
    return cv2.dnn.readNetFromONNX(path)


def make_maps(network: cv2.dnn.Net, image: np.ndarray) -> np.ndarray:
    """Return what the network says of an image (H, W, 3) uint8: (4, ceil(H / 2), ceil(W / 2))."""
    height, width = image.shape[:2]
    below, beside = -height % MULTIPLE, -width % MULTIPLE
    wide = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REFLECT_101)
    network.setInput(cv2.dnn.blobFromImage(wide, 1 / 64.0, mean=(127.5,) * 3))
    maps = network.forward()[0][:, : -(-height // STEP), : -(-width // STEP)]
    maps[:2] = 1 / (1 + np.exp(-maps[:2]))
    return np.asarray(maps)


def find_instances(maps: np.ndarray) -> np.ndarray:
    """Return the number of the part of each pixel (h, w) int32 of maps (4, h, w); 0: ground."""
    there, depth = maps[0] > THERE, maps[1]
    count, cores = cv2.connectedComponents(((depth > CORE) & there).astype(np.uint8))
    row, column = np.mgrid[: there.shape[0], : there.shape[1]].astype(np.float32)
    x, y = column + REACH_PX * maps[2], row + REACH_PX * maps[3]
    middles, reaches = [], []
    for number in range(1, count):
        core = cores == number
        if depth[core].max() > SURE_CORE:
            middles.append((np.median(x[core]), np.median(y[core])))
            reaches.append(np.sqrt(np.count_nonzero(core) / np.pi))
    if not middles:
        return np.zeros(there.shape, np.int32)
    centres = _joined(np.array(middles), np.array(reaches))
    votes = np.stack([x[there], y[there]], axis=1)
    nearest = np.empty(len(votes), np.int32)
    for begin in range(0, len(votes), 65_536):
        some = votes[begin : begin + 65_536]
        away = ((some[:, None] - centres) ** 2).sum(axis=2)
        nearest[begin : begin + 65_536] = away.argmin(axis=1)
    parts = np.zeros(there.shape, np.int32)
    parts[there] = nearest + 1
    return parts


def _joined(middles: np.ndarray, reaches: np.ndarray) -> np.ndarray:
    """Return the middles (m, 2) of parts, of those of cores (n, 2) and their radii (n,)."""
    order = np.argsort(-reaches)
    kept: list[int] = []
    for k in order:
        gap = np.hypot(*(middles[kept] - middles[k]).T) if kept else np.array([np.inf])
        if np.all(gap > 2 * ONE_MIDDLE * np.maximum(reaches[k], 1.0)):
            kept.append(int(k))
    return middles[kept]
