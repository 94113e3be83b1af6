"""What the camera over the plate sees: parts of two greys, lens, shading, blur and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from plate_core import PlateError, Rig
from plate_core.colours import lab_to_srgb
from plate_core.rig import PartType, homography, project, to_home

from .raster import Outlines, Sprites, draw_parts, draw_plate, expose, outlines_of

BACKGROUND, PLATE = 60.0, 220.0
"""Grey values of the room and the plate at full light."""

GREY_OF_CLASS = {"black": 40.0, "grey": 130.0}
"""Grey values of the parts at full light, by class."""

UNKNOWN_GREY = 80.0
"""Of parts of a type whose colour is not known."""

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

SHADOW_M, SHADOW_WAY, PENUMBRA = 2.5e-3, (0.8, -0.6), (0.4, 0.7, 1.0)
"""A shadow reaches so far out from under a part [m], in this direction (plate_home); what it is
made of: the part's outline at these fractions of that."""

HIGHLIGHT_OPACITY, HIGHLIGHT_WIDEST = 0.9, 0.8
"""How much of a part's own colour the lamp's image hides: a disc of white; and its greatest radius,
as a fraction of the distance from the rim."""

WHITE = 255.0

ARM_M, HEAD_M, ARM_END_M = 0.06, 0.04, 1.0
"""Width of a robot's arm, diameter of the gripper under it, and how far the arm reaches along +y,
out of the image [m]. Perspective is left out: they are drawn as if they lay on the plate."""

ROBOT = (
    PartType(
        "arm",
        outline=((-ARM_M / 2, 0), (ARM_M / 2, 0), (ARM_M / 2, ARM_END_M), (-ARM_M / 2, ARM_END_M)),
    ),
    PartType("wrist", radius_m=ARM_M / 2),
    PartType("gripper", radius_m=HEAD_M / 2),
)
ROBOT_GREY = (150.0, 150.0, 100.0)
"""What is drawn of a robot, from its gripper on, and its grey values at full light: metal."""

MARGIN_PX = 2.0
"""Pixels looked at around a part, beyond where its edge should be."""


@dataclass(frozen=True)
class Lighting:
    """What a lamp does to parts: it is mirrored in a share of each part's area, and makes shadows
    in which the plate is darker by a share."""

    highlights: float = 0.0
    shadows: float = 0.0


EVEN = Lighting()
"""From all sides."""


def part_colours(types: Sequence[PartType], colour: bool) -> np.ndarray:
    """Return the grey values (M,) at full light of parts of these types, or blue, green and red
    (M, 3); a type whose colour is not known is black or grey by its name, or else dark grey.
    """
    greys = [GREY_OF_CLASS.get(part.name, UNKNOWN_GREY) for part in types]
    result = np.tile(np.array(greys)[:, None], (1, 3))
    for row, part in zip(result, types, strict=True):
        if part.colour_lab is not None:
            lab = np.array(part.colour_lab) * (1.0 if colour else [1.0, 0.0, 0.0])
            row[:] = lab_to_srgb(lab)[::-1]
    return result if colour else result[:, 0]


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
        self.noise = noise
        self._lens = rig.camera.lens
        if self._lens is not None and not self._lens.bends:
            self._lens = None
        self._to_image = homography(rig)
        height, width = rig.camera.height_px, rig.camera.width_px
        self._light = _light(width, height)
        self._places = _pixel_places(rig)
        corners = np.array(rig.camera.corners_px)
        self._scale = float(np.linalg.norm(corners[1] - corners[0]) / rig.plate.length_m)
        inside = rig.plate.half - np.abs(self._places)
        self._edge_distance = np.abs(np.minimum(inside[..., 0], inside[..., 1])).ravel()
        self._edge: dict[int, np.ndarray] = {}
        self._empty = np.empty((height, width), np.float32)
        self._paint_plate(self._empty, np.zeros((1, 3)), np.arange(width * height), 0.0)
        self._canvas = np.empty_like(self._empty)
        self._types = [PartType("", radius_m=rig.parts.radius_m, symmetry=0)]
        self._outlines = outlines_of(self._types)

    def render(
        self,
        position: np.ndarray,
        grey: np.ndarray,
        rng: np.random.Generator,
        velocity: np.ndarray | None = None,
        pose: np.ndarray | None = None,
        *,
        angle: np.ndarray | None = None,
        types: Sequence[PartType] | None = None,
        lighting: Lighting = EVEN,
        gripper: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the image (height, width) or (height, width, 3), uint8, of parts on the plate.

        Parameters
        ----------
        position : (M, 2) or (s, M, 2)
            Parts when the exposure begins [m], plate_home; or s times, equally spaced from the
            exposure's beginning to its end.
        grey : (M,) or (M, 3)
            Their grey values at full light; or blue, green and red: the image then has colours.
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
            Of the parts [rad], counter-clockwise. Without types they then carry a mark in that
            direction: grey on black, black on grey.
        types : sequence of M, optional
            What the parts look like; if missing, discs of the rig's radius.
        lighting : Lighting
            Highlights and shadows.
        gripper : (2,), optional
            Of a robot over the plate [m, plate_home]: it hides what is below it, and its arm does
            from there on along +y.

        Raises
        ------
        PlateError
            If a value is not finite, or lengths disagree.
        """
        path = self._path(position, velocity)
        count = path.shape[1]
        colour = np.ndim(grey) == 2
        values = _checked("grey", grey, (count, 3) if colour else (count,))
        turns = np.zeros(count) if angle is None else _checked("angle", angle, (count,))
        sprites, outlines, layer = self._sprites(path, turns, angle is not None, types, lighting)
        robot = None if gripper is None else self._robot(_checked("gripper", gripper, (2,)))
        channels = []
        for value in values.T if colour else [values]:
            canvas = self._canvas
            np.copyto(canvas, self._empty)
            if pose is not None and np.any(pose):
                bands = pose if np.ndim(pose) == 3 else [pose]
                ends = len(canvas) * np.arange(len(bands) + 1) // len(bands)
                for k, poses in enumerate(bands):
                    self._move_plate(canvas, _samples("pose", poses, (3,)), ends[k : k + 2])
            marks = np.where(value < LIGHT, MARK_OF_DARK, MARK_OF_LIGHT)
            black, white = np.zeros(count), np.full(count, WHITE)
            shades = np.concatenate([[black, value, marks, white][kind] for kind in layer])
            draw_parts(canvas, self._light, self._places, sprites._replace(grey=shades), outlines)
            if robot is not None:
                draw_parts(canvas, self._light, self._places, robot, _robot_outlines())
            image = np.empty(canvas.shape, np.uint8)
            offset = rng.integers(NOISE_BANK)
            bank = _noise_bank(canvas.size)[offset : offset + canvas.size]
            expose(canvas.ravel(), bank, self.noise, image.ravel())
            channels.append(image)
        return np.stack(channels, axis=2) if colour else channels[0]

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

    def _outlines_of(self, types: Sequence[PartType] | None, count: int) -> Outlines:
        """Return the outlines of M parts; those of a type are made once."""
        if types is not None and len(types) != count:
            raise PlateError(f"types: {len(types)} for {count} parts, allowed: as many")
        new = [part for part in dict.fromkeys(types or ()) if part not in self._types]
        if new:
            self._types += new
            self._outlines = outlines_of(self._types)
        row = [0] * count if types is None else [self._types.index(part) for part in types]
        return self._outlines.take(np.array(row, int))

    def _sprites(
        self,
        path: np.ndarray,
        angle: np.ndarray,
        marked: bool,
        types: Sequence[PartType] | None,
        lighting: Lighting,
    ) -> tuple[Sprites, Outlines, list[int]]:
        """Return what is drawn, all white, in layers of M: shadows, parts, the marks on discs of no
        type, and highlights; and of what kind each layer is: 0 to 3."""
        count = path.shape[1]
        own = self._outlines_of(types, count)
        turn, lamp = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.array(SHADOW_WAY)
        layers = [(1, path, own, 1.0)]
        if lighting.shadows:
            # Each layer hides as much, and all of them the whole.
            opacity = 1 - (1 - lighting.shadows) ** (1 / len(PENUMBRA))
            offsets = [SHADOW_M * part * lamp for part in PENUMBRA]
            layers = [*((0, path + offset, own, opacity) for offset in offsets), *layers]
        if marked and types is None:
            marks = own.discs(MARK_RADIUS * own.reach)
            layers.append((2, path + MARK_PLACE * own.reach[:, None] * turn, marks, 1.0))
        if lighting.highlights:
            x, y, depth, area = own.spot.T
            radius = np.minimum(
                np.sqrt(lighting.highlights * area / np.pi), HIGHLIGHT_WIDEST * depth
            )
            (c, s), there = turn.T, np.empty((count, 2))
            there[:, 0], there[:, 1] = c * x - s * y, s * x + c * y
            layers.append((3, path + there, own.discs(radius), HIGHLIGHT_OPACITY))
        kinds, paths, every, opacities = zip(*layers, strict=True)
        there, outlines = np.concatenate(paths, axis=1), every[0].joined(every[1:])
        sprites = Sprites(
            *self._windows(there, outlines.reach), there, outlines.reach,
            np.tile(turn, (len(layers), 1)), np.full(there.shape[1], WHITE),
            np.repeat(opacities, count),
        )  # fmt: skip
        return sprites, outlines, list(kinds)

    def _robot(self, gripper: np.ndarray) -> Sprites:
        """Return what is drawn of a robot whose gripper is at a place (2,) [m, plate_home]."""
        outlines, count = _robot_outlines(), len(ROBOT)
        path = np.tile(gripper, (2, count, 1))
        window, scale, copies = self._windows(path, outlines.reach)
        offset = self._places - gripper
        covered = (np.abs(offset[..., 0]) < ARM_M) & (offset[..., 1] > -ARM_M)
        for axis in (0, 1):
            lines = np.flatnonzero(covered.any(axis=1 - axis))
            window[0, 2 * axis : 2 * axis + 2] = (lines[0], lines[-1] + 1) if len(lines) else (0, 0)
        turn = np.tile([1.0, 0.0], (count, 1))
        return Sprites(
            window, scale, copies, path, outlines.reach, turn, np.array(ROBOT_GREY), np.ones(count)
        )

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


@lru_cache(maxsize=2)
def _pixel_places(rig: Rig) -> np.ndarray:
    """Return the places (height, width, 2) [m, plate_home] that the pixels look at."""
    camera = rig.camera
    v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    if camera.lens is not None and camera.lens.bends:
        pixel = camera.lens.straighten(pixel)
    places = np.nan_to_num(project(np.linalg.inv(homography(rig)), pixel), nan=FAR)
    places.flags.writeable = False
    return places.reshape(*u.shape, 2)


def _light(width: int, height: int) -> np.ndarray:
    """Fraction of full light (height, width), float32: less by `SHADING` in the corners."""
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    return 1 - np.float32(SHADING) * (x * x + y * y) / 2


@lru_cache(maxsize=1)
def _robot_outlines() -> Outlines:
    return outlines_of(ROBOT)


@lru_cache(maxsize=4)
def _noise_bank(pixels: int) -> np.ndarray:
    """Normal deviates (`NOISE_BANK` + pixels,), float32, the bank over and over again; the same
    in every run."""
    bank = np.random.default_rng(0).standard_normal(NOISE_BANK, dtype=np.float32)
    return np.resize(bank, NOISE_BANK + pixels)
