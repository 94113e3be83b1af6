"""From the network's maps to parts."""

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
    """Return the number of the part of each pixel (h, w) int32 of maps (4, h, w); 0: ground.

    What hangs together is one part, unless cores of several lie in it: then its pixels are of the
    middle that they point nearest to.
    """
    there, depth = _filled(maps[0] > THERE), maps[1]
    count, patches, boxes, _ = cv2.connectedComponentsWithStats(there, connectivity=4)
    core_count, cores = cv2.connectedComponents(((depth > CORE) & (there > 0)).astype(np.uint8))
    row, column = np.mgrid[: there.shape[0], : there.shape[1]].astype(np.float32)
    x, y = column + REACH_PX * maps[2], row + REACH_PX * maps[3]
    middles: dict[int, list[tuple[float, float, float]]] = {}
    for number in range(1, core_count):
        core = cores == number
        if depth[core].max() > SURE_CORE:
            reach = np.sqrt(np.count_nonzero(core) / np.pi)
            middle = np.median(x[core]), np.median(y[core]), reach
            middles.setdefault(int(patches[core][0]), []).append(middle)
    parts = np.zeros(there.shape, np.int32)
    for number in range(1, count):
        if boxes[number, cv2.CC_STAT_AREA] < LEAST_PX2:
            continue
        patch = patches == number
        centres = _joined(np.array(middles.get(number, [(0.0, 0.0, 1.0)])))
        votes = np.stack([x[patch], y[patch]], axis=1)
        nearest = ((votes[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
        parts[patch] = parts.max() + 1 + nearest
    return parts


def _filled(there: np.ndarray) -> np.ndarray:
    """Return pixels (h, w) uint8 with the holes among them."""
    framed = np.pad(there.astype(np.uint8), 1)
    ground = framed.copy()
    cv2.floodFill(ground, None, (0, 0), 1)
    return np.asarray(framed | (1 - ground))[1:-1, 1:-1].copy()


def _joined(middles: np.ndarray) -> np.ndarray:
    """Return the middles (m, 2) of parts, of those of cores and their radii (n, 3)."""
    kept: list[int] = []
    for k in np.argsort(-middles[:, 2]):
        gap = np.hypot(*(middles[kept] - middles[k])[:, :2].T) if kept else np.array([np.inf])
        if np.all(gap > 2 * ONE_MIDDLE * max(middles[k, 2], 1.0)):
            kept.append(int(k))
    return np.asarray(middles[kept, :2])
