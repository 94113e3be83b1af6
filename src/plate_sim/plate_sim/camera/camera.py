"""What the camera over the plate sees: parts of two greys, lens, shading, blur and noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from plate_core import PlateError, Rig
from plate_core.rig import homography, project, to_home

from .raster import DISCS, Outline, Sprites, draw_parts, draw_plate, expose, outlines_of

BACKGROUND, PLATE = 60.0, 220.0
"""Grey values of the room and the plate at full light."""

GREY_OF_CLASS = {"black": 40.0, "grey": 130.0}
"""Grey values of the parts at full light, by class."""

SHADING = 0.10
"""Fraction of the light that is missing in the image's corners."""

NOISE = 2.0
"""Default standard deviation of a pixel's noise [grey values]."""

NOISE_BANK = 1 << 20
"""Ready-made noise values: drawing 307200 new ones would take 3 ms a frame."""

BLUR_STEP_PX = 0.1
"""Distance between two positions averaged over the exposure; finer is not to be seen."""

EDGE_STEP_PX = 0.25
"""The same for the plate's edges, of which there are many pixels: a quarter of an edge's width."""

BLUR_MOST = 16
"""Most positions averaged over one exposure."""

MARK_PLACE, MARK_RADIUS = 0.5, 0.3
"""Where on a disc the mark of its angle is, and how large [radii]."""

MARK_OF_DARK, MARK_OF_LIGHT, LIGHT = 130.0, 40.0, 85.0
"""Grey of the mark on a part that is darker than `LIGHT`, and on one that is not: stands out from
the part, and is darker than the plate, so that the part remains one dark disc."""

STRIP_STEP = 0.002
"""The strip along the plate's edge that is painted again is a multiple of this wide [m]: lists of
its pixels are kept."""

FAR = 1e6
"""What a pixel looks at that no light reaches through the lens [m]: not the plate."""

MARGIN_PX = 2.0
"""Pixels looked at around a part, beyond where its edge should be."""


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
    """Renders images of one rig. Room and plate at home are drawn once and kept, through the lens.

    An instance works on one image at a time: threads need one each.

    Parameters
    ----------
    rig : Rig
    noise : float
        Standard deviation of a pixel's noise [grey values].
    """

    def __init__(self, rig: Rig, noise: float = NOISE) -> None:
        self._rig = rig
        self._noise = noise
        self._lens = rig.camera.lens
        if self._lens is not None and not self._lens.bends:
            self._lens = None
        self._to_image = homography(rig)
        height, width = rig.camera.height_px, rig.camera.width_px
        self._light = _light(width, height)
        self._places = self._pixel_places().reshape(height, width, 2)
        corners = np.array(rig.camera.corners_px)
        self._scale = float(np.linalg.norm(corners[1] - corners[0]) / rig.plate.length_m)
        inside = np.min(rig.plate.half - np.abs(self._places), axis=2).ravel()
        self._edge_distance = np.abs(inside)
        self._edge: dict[int, np.ndarray] = {}
        self._empty = np.empty((height, width), np.float32)
        self._paint_plate(self._empty, np.zeros((1, 3)), np.arange(width * height), 0.0)
        self._canvas = np.empty_like(self._empty)
        self._outline: Sequence[Outline | None] | None = None
        self._outlines = DISCS

    def render(
        self,
        position: np.ndarray,
        grey: np.ndarray,
        rng: np.random.Generator,
        velocity: np.ndarray | None = None,
        pose: np.ndarray | None = None,
        *,
        angle: np.ndarray | None = None,
        outline: Sequence[Outline | None] | None = None,
    ) -> np.ndarray:
        """Return the image (height, width), uint8, of parts on the plate.

        Parameters
        ----------
        position : (M, 2) or (s, M, 2)
            Parts when the exposure begins [m], plate_home; or s times, equally spaced from the
            exposure's beginning to its end.
        grey : (M,)
            Their grey values at full light.
        rng : numpy.random.Generator
            Picks the part of the noise bank that is used: one number per image.
        velocity : (M, 2), optional
            Of the parts [m/s], if `position` is (M, 2): blurs them over the exposure. Zero if
            missing.
        pose : (3,), (s, 3) or (b, s, 3), optional
            Of the plate [m, m, rad], once or s times over the exposure, or so in each of b equal
            bands of rows; at home if missing, as at every start of a cycle that a rigid plate
            makes.
        angle : (M,), optional
            Of the parts [rad], counter-clockwise. Discs then carry a mark in the direction of
            their angle: grey on black, black on grey.
        outline : sequence of M, optional
            What a part looks like, such as `Footprint.outline`; None for a disc of the rig's
            radius. Prepared once as long as it is the same object.

        Raises
        ------
        PlateError
            If a value is not finite, or lengths disagree.
        """
        path = self._path(position, velocity)
        count = path.shape[1]
        grey = _checked("grey", grey, (count,))
        canvas = self._canvas
        np.copyto(canvas, self._empty)
        if pose is not None and np.any(pose):
            bands = pose if np.ndim(pose) == 3 else [pose]
            ends = len(canvas) * np.arange(len(bands) + 1) // len(bands)
            for k, poses in enumerate(bands):
                self._move_plate(canvas, _samples("pose", poses, (3,)), ends[k : k + 2])
        if count:
            turns = np.zeros(count) if angle is None else _checked("angle", angle, (count,))
            self._draw(canvas, path, grey, turns, angle is not None, outline)
        image = np.empty(canvas.shape, np.uint8)
        offset = rng.integers(NOISE_BANK)
        bank = _noise_bank(canvas.size)[offset : offset + canvas.size]
        expose(canvas.ravel(), bank, self._noise, image.ravel())
        return image

    def _pixel_places(self) -> np.ndarray:
        """Return the places (n, 2) [m, plate_home] that the pixels look at, row by row."""
        camera = self._rig.camera
        v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
        pixel = np.stack([u.ravel(), v.ravel()], axis=1)
        if self._lens is not None:
            pixel = self._lens.straighten(pixel)
        return np.nan_to_num(project(np.linalg.inv(self._to_image), pixel), nan=FAR)

    def _path(self, position: np.ndarray, velocity: np.ndarray | None) -> np.ndarray:
        """Return positions (s, M, 2) [m], at least two, over the exposure."""
        position = np.asarray(position, dtype=float)
        if position.ndim == 3 and velocity is not None:
            raise PlateError("velocity: allowed only with positions (M, 2), not over the exposure")
        if position.ndim != 3:
            position = position.reshape(1, -1, 2)
        path = _samples("position", position, position.shape[1:])
        if len(path) > 1:
            return path
        if velocity is None:
            return np.concatenate([path, path])
        velocity = _checked("velocity", velocity, path.shape[1:])
        return np.concatenate([path, path + self._rig.camera.exposure_s * velocity])

    def _draw(
        self,
        canvas: np.ndarray,
        path: np.ndarray,
        grey: np.ndarray,
        angle: np.ndarray,
        marked: bool,
        outline: Sequence[Outline | None] | None,
    ) -> None:
        """Draw parts, and then the marks on those that are discs."""
        if outline is not self._outline:
            self._outlines = DISCS if outline is None else outlines_of(outline)
            self._outline = outline
        first, reach = self._outlines.first, self._outlines.reach
        if outline is None:
            first, reach = np.zeros(len(grey) + 1, np.int64), np.zeros(len(grey))
        if len(reach) != len(grey):
            raise PlateError(f"outline: {len(reach)} for {len(grey)} parts, allowed: as many")
        disc = reach == 0
        radius = np.where(disc, self._rig.parts.radius_m, reach)
        turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        if marked and np.any(disc):
            there = path[:, disc] + MARK_PLACE * self._rig.parts.radius_m * turn[disc]
            path = np.concatenate([path, there], axis=1)
            grey = np.append(grey, np.where(grey[disc] < LIGHT, MARK_OF_DARK, MARK_OF_LIGHT))
            radius = np.append(radius, MARK_RADIUS * radius[disc])
            turn = np.concatenate([turn, turn[disc]])
            first = np.append(first, np.full(there.shape[1], first[-1]))
        sprites = Sprites(*self._windows(path, radius), path, radius, turn, grey)
        outlines = self._outlines._replace(first=first)
        draw_parts(canvas, self._light, self._places, sprites, outlines)

    def _windows(
        self, path: np.ndarray, radius: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return where parts are in the image: rows and columns (n, 4), pixels per metre (n,), and
        how many positions are averaged (n,)."""
        middle = 0.5 * (path[0] + path[-1])
        seen = project(self._to_image, middle)
        depth = middle @ self._to_image[2, :2] + self._to_image[2, 2]
        slopes = self._to_image[:2, :2] - seen[:, :, None] * self._to_image[2, :2]
        slopes = slopes / depth[:, None, None]
        if self._lens is not None:
            slopes = self._lens.slopes(seen) @ slopes
            seen = self._lens.bend(seen)
        area = np.abs(slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0])
        square = np.sum(slopes**2, axis=(1, 2))
        longest = np.sqrt(0.5 * (square + np.sqrt(np.maximum(square**2 - 4 * area**2, 0))))
        spread = np.linalg.norm(path - middle, axis=2).max(axis=0)
        # A tenth more, as the scale changes across a part.
        reach = 1.1 * longest * (radius + spread) + MARGIN_PX
        size = np.array([self._rig.camera.width_px, self._rig.camera.height_px])
        low = np.clip(seen - reach[:, None], 0, size).astype(int)
        high = np.clip(seen + reach[:, None] + 1, 0, size).astype(int)
        window = np.stack([low[:, 1], high[:, 1], low[:, 0], high[:, 0]], axis=1)
        scale = np.sqrt(area)
        length = np.linalg.norm(np.diff(path, axis=0), axis=2).sum(axis=0)
        return window, scale, _copies(length * scale)

    def _move_plate(self, canvas: np.ndarray, poses: np.ndarray, rows: np.ndarray) -> None:
        """Paint what changes in rows [rows[0], rows[1]) when the plate is not at home but at poses
        (s, 3)."""
        corners = np.array([to_home(pose, self._rig.plate.corners) for pose in poses])
        away = np.linalg.norm(corners - self._rig.plate.corners, axis=2).max()
        travel = np.linalg.norm(np.diff(corners, axis=0), axis=2).sum(axis=0).max()
        steps = int(np.ceil((away + 1 / self._scale) / STRIP_STEP))
        if steps not in self._edge:
            self._edge[steps] = np.flatnonzero(self._edge_distance <= steps * STRIP_STEP)
        first, end = np.searchsorted(self._edge[steps], rows * canvas.shape[1])
        self._paint_plate(canvas, poses, self._edge[steps][first:end], float(travel))

    def _paint_plate(
        self, canvas: np.ndarray, poses: np.ndarray, pixels: np.ndarray, travel: float
    ) -> None:
        copies = int(_copies(np.array(travel * self._scale), EDGE_STEP_PX))
        draw_plate(
            canvas.ravel(), self._light.ravel(), self._places.reshape(-1, 2), pixels, poses, copies,
            travel, self._rig.plate.half, self._scale, (BACKGROUND, PLATE),
        )  # fmt: skip


def _copies(length_px: np.ndarray, step_px: float = BLUR_STEP_PX) -> np.ndarray:
    """Return how many positions are averaged along ways (n,) [px]."""
    return np.minimum(BLUR_MOST, 1 + length_px / step_px).astype(int)


def _checked(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return finite numbers of a shape, the first axis of which counts parts."""
    array = np.ascontiguousarray(value, dtype=float)
    if array.shape != shape:
        raise PlateError(f"{name}: shape is {array.shape}, allowed: {shape}")
    if not np.all(np.isfinite(array)):
        part = int(np.argwhere(~np.isfinite(array))[0][0])
        raise PlateError(f"{name}: of part {part} is {array[part]}, allowed: finite numbers")
    return array


def _samples(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return finite numbers (s, *shape), at least one sample; a single one may lack its axis."""
    array = np.ascontiguousarray(value, dtype=float)
    if array.shape == shape:
        array = array[None]
    if array.shape[1:] != shape or not len(array):
        size = ", ".join(map(str, shape))
        raise PlateError(f"{name}: shape is {array.shape}, allowed: ({size}) or (s, {size})")
    if not np.all(np.isfinite(array)):
        raise PlateError(f"{name}: not all are finite, allowed: finite numbers")
    return array


def _light(width: int, height: int) -> np.ndarray:
    """Fraction of full light (height, width), float32: less by `SHADING` in the corners."""
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    return 1 - np.float32(SHADING) * (x * x + y * y) / 2


@lru_cache(maxsize=4)
def _noise_bank(pixels: int) -> np.ndarray:
    """Normal deviates (`NOISE_BANK` + pixels,), float32, the bank over and over again; the same
    in every run."""
    bank = np.random.default_rng(0).standard_normal(NOISE_BANK, dtype=np.float32)
    return np.resize(bank, NOISE_BANK + pixels)
