"""What the camera over the plate sees: two greys of round parts, shading, blur and noise."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from plate_core import PlateError, Rig
from plate_core.frames import homography, to_plate

BACKGROUND, PLATE = 60.0, 220.0
"""Grey values of the room and the plate at full light."""

GREY_OF_CLASS = {"black": 40.0, "grey": 130.0}
"""Grey values of the parts at full light, by class."""

SHADING = 0.10
"""Share of the light that is missing in the image's corners."""

NOISE = 2.0
"""Default standard deviation of a pixel's noise [grey values]."""

NOISE_BANK = 1 << 20
"""Ready-made noise values: drawing 307200 new ones would take 3 ms a frame."""

BLUR_STEP_PX = 0.1
"""Distance between two positions averaged over the exposure; finer is not to be seen."""

BLUR_MOST = 16
"""Most positions averaged over one exposure."""


def part_greys(classes: list[str]) -> np.ndarray:
    """Return the grey values (M,) of parts by their classes.

    Raises
    ------
    PlateError
        If the camera knows no grey for a class.
    """
    for name in classes:
        if name not in GREY_OF_CLASS:
            raise PlateError(f"part class is {name!r}, allowed: {', '.join(GREY_OF_CLASS)}")
    return np.array([GREY_OF_CLASS[name] for name in classes], dtype=float)


class Camera:
    """Renders images of one rig. Room and plate are drawn once and kept.

    Parameters
    ----------
    rig : Rig
    noise : float
        Standard deviation of a pixel's noise [grey values].
    """

    def __init__(self, rig: Rig, noise: float = NOISE) -> None:
        self._rig = rig
        self._noise = noise
        self._to_image = homography(rig)
        self._to_home = np.linalg.inv(self._to_image)
        self._light = _light(rig.camera.width_px, rig.camera.height_px)
        self._empty = self._draw_plate(np.zeros(3))

    def render(
        self,
        position: np.ndarray,
        grey: np.ndarray,
        rng: np.random.Generator,
        velocity: np.ndarray | None = None,
        pose: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the image (height, width), uint8, of parts on the plate.

        Parameters
        ----------
        position : (M, 2)
            Parts when the exposure begins [m], plate_home.
        grey : (M,)
            Their grey values at full light.
        rng : numpy.random.Generator
            Picks the part of the noise bank that is used: one number per image.
        velocity : (M, 2), optional
            Of the parts [m/s]: blurs them over the exposure. Zero if missing.
        pose : (3,), optional
            Of the plate [m, m, rad]; at home if missing, as at every start of a cycle.
        """
        canvas = self._empty.copy() if pose is None else self._draw_plate(np.asarray(pose, float))
        position = np.array(position, float).reshape(-1, 2)
        velocity = np.zeros_like(position) if velocity is None else np.asarray(velocity, float)
        travel = velocity * self._rig.camera.exposure_s
        if len(position):
            _draw_discs(
                canvas, self._light, self._to_image, self._to_home, position, travel,
                np.asarray(grey, float), self._rig.parts.radius_m,
            )  # fmt: skip
        image = np.empty(canvas.shape, np.uint8)
        offset = rng.integers(NOISE_BANK)
        _expose(canvas.ravel(), _noise_bank(), self._noise, offset, image.ravel())
        return image

    def _draw_plate(self, pose: np.ndarray) -> np.ndarray:
        """Return room and plate without parts (height, width), float32."""
        camera = self._rig.camera
        v, u = np.mgrid[: camera.height_px, : camera.width_px]
        pixels = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
        home = self._to_home @ pixels
        inside = self._rig.plate.half - np.abs(to_plate(pose, (home[:2] / home[2]).T))
        scale = self._pixels_per_metre()
        cover = np.prod(np.clip(inside * scale + 0.5, 0, 1), axis=1).reshape(u.shape)
        return ((BACKGROUND + (PLATE - BACKGROUND) * cover) * self._light).astype(np.float32)

    def _pixels_per_metre(self) -> float:
        corners = np.array(self._rig.camera.corners_px)
        return float(np.linalg.norm(corners[1] - corners[0]) / self._rig.plate.length_m)


def _light(width: int, height: int) -> np.ndarray:
    """Share of full light (height, width), float32: less by `SHADING` in the corners."""
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    return 1 - np.float32(SHADING) * (x * x + y * y) / 2


@lru_cache(maxsize=1)
def _noise_bank() -> np.ndarray:
    """Normal deviates (`NOISE_BANK`,), float32; the same in every run."""
    return np.random.default_rng(0).standard_normal(NOISE_BANK, dtype=np.float32)


@njit(cache=True)
def _expose(canvas, bank, noise, offset, image):
    """Add noise to the canvas (n,) and round it to the image (n,)."""
    noise = np.float32(noise)
    for i in range(len(canvas)):
        value = canvas[i] + noise * bank[(i + offset) & (NOISE_BANK - 1)] + np.float32(0.5)
        image[i] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))


@njit(cache=True)
def _draw_discs(canvas, light, to_image, to_home, position, travel, grey, radius):
    """Blend discs into the canvas; each is averaged along its travel (2,) [m]."""
    height, width = canvas.shape
    for i in range(len(position)):
        middle = position[i] + 0.5 * travel[i]
        scale, u, v = _scale(to_image, middle)
        length = np.sqrt(travel[i, 0] ** 2 + travel[i, 1] ** 2)
        copies = int(min(BLUR_MOST, 1 + length * scale / BLUR_STEP_PX))
        reach = scale * (radius + 0.5 * length) * 1.1 + 2
        for row in range(max(0, int(v - reach)), min(height, int(v + reach) + 2)):
            for col in range(max(0, int(u - reach)), min(width, int(u + reach) + 2)):
                w = to_home[2, 0] * col + to_home[2, 1] * row + to_home[2, 2]
                x = (to_home[0, 0] * col + to_home[0, 1] * row + to_home[0, 2]) / w
                y = (to_home[1, 0] * col + to_home[1, 1] * row + to_home[1, 2]) / w
                cover = 0.0
                for k in range(copies):
                    share = (k + 0.5) / copies
                    dx = x - position[i, 0] - share * travel[i, 0]
                    dy = y - position[i, 1] - share * travel[i, 1]
                    inside = (radius - np.sqrt(dx * dx + dy * dy)) * scale
                    cover += min(max(inside + 0.5, 0.0), 1.0) / copies
                canvas[row, col] += cover * (grey[i] * light[row, col] - canvas[row, col])


@njit(cache=True)
def _scale(to_image, point):
    """Pixels per metre at a point [m], from the area of its image, and the image (u, v)."""
    a = to_image
    w = a[2, 0] * point[0] + a[2, 1] * point[1] + a[2, 2]
    u = (a[0, 0] * point[0] + a[0, 1] * point[1] + a[0, 2]) / w
    v = (a[1, 0] * point[0] + a[1, 1] * point[1] + a[1, 2]) / w
    ux, uy = (a[0, 0] - u * a[2, 0]) / w, (a[0, 1] - u * a[2, 1]) / w
    vx, vy = (a[1, 0] - v * a[2, 0]) / w, (a[1, 1] - v * a[2, 1]) / w
    return np.sqrt(abs(ux * vy - uy * vx)), u, v
