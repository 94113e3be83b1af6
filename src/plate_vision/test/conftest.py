"""Frames with known truth, drawn by counting sub-pixels: no code is shared with the simulator."""

from functools import lru_cache

import numpy as np
import pytest

WIDTH_PX, HEIGHT_PX = 640, 480
CORNERS_PX = np.array([[21.01, 387.25], [617.82, 389.5], [614.33, 93.94], [26.86, 91.35]])
PLATE, ROOM = 220.0, 70.0
GREY_OF = {"black": 40.0, "grey": 130.0}
SUB = 10
"""Sub-pixels along each side of a pixel: areas are then right to a thousandth."""


def flat(u, v):
    return np.ones_like(u)


def slope(u, v):
    return 1 + 0.05 * u - 0.03 * v


def vignette(u, v):
    """Light falls by 15 % towards the corners, as the fourth power of a cosine: no quadratic."""
    return (1 + 0.042 * (u * u + v * v)) ** -2


SHADINGS = {"flat": flat, "slope": slope, "vignette": vignette}


@lru_cache
def plate_share(corners):
    """Share of every pixel that shows the plate."""
    share = np.zeros((HEIGHT_PX, WIDTH_PX))
    y, x = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    for dx in (-0.375, -0.125, 0.125, 0.375):
        for dy in (-0.375, -0.125, 0.125, 0.375):
            inside = np.ones_like(share, dtype=bool)
            for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
                inside &= (bx - ax) * (y + dy - ay) - (by - ay) * (x + dx - ax) <= 0
            share += inside
    return share / 16


def draw_frame(
    centre,
    label,
    rng,
    radius=8.0,
    noise=2.0,
    shading="slope",
    blur=0.0,
    corners=CORNERS_PX,
    extra=None,
    light=1.0,
):
    """Return a frame (H, W) uint8 with discs at `centre` (M, 2) [px] of classes `label`.

    `extra(image)` may draw more, before light and noise.
    """
    import cv2

    share = plate_share(tuple(map(tuple, np.asarray(corners).tolist())))
    image = ROOM + (PLATE - ROOM) * share
    offset = (np.arange(SUB) + 0.5) / SUB - 0.5
    reach = int(radius) + 3
    for (cx, cy), name in zip(np.asarray(centre).reshape(-1, 2), label, strict=True):
        xs = np.arange(max(round(cx) - reach, 0), min(round(cx) + reach + 1, WIDTH_PX))
        ys = np.arange(max(round(cy) - reach, 0), min(round(cy) + reach + 1, HEIGHT_PX))
        x = (xs[:, None] + offset).ravel()
        y = (ys[:, None] + offset).ravel()
        inside = (x - cx) ** 2 + (y[:, None] - cy) ** 2 <= radius**2
        cover = inside.reshape(len(ys), SUB, len(xs), SUB).mean(axis=(1, 3))
        window = image[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1]
        window += cover * (GREY_OF[name] - window)
    if extra is not None:
        extra(image)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    v, u = np.mgrid[-1 : 1 : HEIGHT_PX * 1j, -1 : 1 : WIDTH_PX * 1j]
    image = image * SHADINGS[shading](u, v) * light + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture
def draw():
    return draw_frame


@pytest.fixture
def corners_px():
    return CORNERS_PX.copy()


@pytest.fixture
def rng():
    return np.random.default_rng(20261121)
