"""Synthetic images of the plate and its parts. The images show the parts' heights, lens distortion,
light, shadows, motion blur and noise. The inputs are the poses of the parts and the plate, and the
types or grey values of the parts. The output is a grey or colour image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from plate_core import PlateError, Rig
from plate_core.colours import lab_to_srgb
from plate_core.rig import PartType, camera_place, homography, project, to_home

from .raster import Outlines, Sprites, draw_parts, draw_plate, expose, joined, outlines_of
from .sweeps import scaled, swept

ROOM = 60.0
"""Grey value of the surroundings of the plate at full light."""

PLATE = 220.0
"""Grey value of the plate at full light."""

GREY_OF_CLASS = {"black": 40.0, "grey": 130.0}
"""Grey values of the parts at full light, by class."""

UNKNOWN_GREY = 80.0
"""Grey value of a part whose type has no known colour."""

SHADING = 0.10
"""Fraction of the light that is missing in the corners of the image."""

NOISE = 2.0
"""Default standard deviation of the noise of a pixel [grey values]."""

NOISE_BANK = 1 << 20
"""Number of precomputed noise values. The values are precomputed because drawing 307200 new values
takes 3 ms per image."""

BLUR_STEP_PX = 0.1
"""Distance between two positions whose images are averaged over the exposure [px]. A smaller
distance makes no visible difference."""

EDGE_STEP_PX = 0.25
"""Distance between two positions of the plate's edges whose images are averaged [px]. This distance
is a quarter of the width of an edge. This distance is larger than `BLUR_PX`, because the plate's
edges have many pixels."""

BLUR_MOST = 16
"""Maximum number of positions whose images are averaged over one exposure."""

MARK_PLACE = 0.5
"""Distance of the mark from a disc's centre [disc radii]. The mark shows the angle of the disc."""

MARK_RADIUS = 0.3
"""Radius of the mark on a disc [disc radii]."""

MARK_OF_DARK = 130.0
"""Grey value of the mark on a part that is darker than `LIGHT`. The mark contrasts with the part.
The mark is darker than the plate, so that the part remains one dark disc."""

MARK_OF_LIGHT = 40.0
"""Grey value of the mark on a part that is not darker than `LIGHT`."""

LIGHT = 85.0
"""Grey value below which a part counts as dark."""

STRIP_STEP = 0.002
"""Step of the width of the repainted strip along the plate's edge [m]. The list of pixels of each
width is cached."""

FAR = 1e6
"""Coordinate for pixels that show no point of the plate's plane [m]. The coordinate is far off the
plate."""

SHADOW_M = 2.5e-3
"""Default length of a shadow beyond the part [m]."""

SHADOW_DEG = -36.9
"""Default direction of a shadow from x [degrees, plate_home]."""

PENUMBRA_M = 1.5e-3
"""Default width of the soft edge of a shadow at its far end [m]."""

PENUMBRA_STEPS = 5
"""Number of shadows of equal weight that are superposed to a shadow with a soft edge. With 5
shadows, an edge of 3 mm looks smooth at 1 px/mm."""

SIDE_SHADE = 0.7
"""Default brightness of the side face of a part, relative to its top face."""

EDGE_PX = 0.7
"""Distance between the edge of a top face and the edge of its side face in the image [px]. Edges
are one pixel wide. Edges that coincide would be drawn twice."""

GLOSS_PLACE = 0.35
"""Displacement of the lamp's image on a glossy part, towards the lamp. The displacement starts at
the point farthest from the outline, and it is relative to the distance of this point from the
outline."""

HIGHLIGHT_OPACITY = 0.9
"""Opacity of a highlight, which is a white disc."""

HIGHLIGHT_WIDEST = 0.8
"""Maximum radius of a highlight, relative to the distance of its centre from the outline."""

WHITE = 255.0

ARM_M = 0.06
"""Width of a robot's arm [m]. The robot is drawn without perspective, as if it were flat on the
plate."""

HEAD_M = 0.04
"""Diameter of the robot's gripper [m]."""

ARM_END_M = 1.0
"""Length of the robot's arm along +y beyond the edge of the image [m]."""

ROBOT = (
    PartType(
        "arm",
        outline=((-ARM_M / 2, 0), (ARM_M / 2, 0), (ARM_M / 2, ARM_END_M), (-ARM_M / 2, ARM_END_M)),
    ),
    PartType("wrist", radius_m=ARM_M / 2),
    PartType("gripper", radius_m=HEAD_M / 2),
)
ROBOT_GREY = (150.0, 150.0, 100.0)
"""Grey values of the shapes in `ROBOT` at full light."""

MARGIN_PX = 2.0
"""Margin of the image window of a part beyond its expected edge [px]."""


@dataclass(frozen=True)
class Lighting:
    """Light of an image, and its effects on the parts.

    Attributes
    ----------
    highlights : float
        Fraction of each part's area that is covered by a highlight. The highlight is centred on the
        point farthest from the outline.
    shadows : float
        Fraction of the light that is missing in shadows. 0 disables shadows.
    shadow_m : float
        Length of the shadows on the plate [m].
    shadow_deg : float
        Direction of the shadows from x [degrees, plate_home]. The lamp is on the opposite side.
    penumbra_m : float
        Width of the shadows' soft edge at the far end [m]. At the part they are sharp.
    gloss : float
        Radius of the lamp's image on each part. The radius is relative to the radius of a disc or,
        for other parts, to the maximum distance of a point from the outline. 0 means no image of
        the lamp.
    side_shade : float
        Brightness of side faces relative to top faces.
    level : float
        Factor by which all light in this image is multiplied.
    """

    highlights: float = 0.0
    shadows: float = 0.0
    shadow_m: float = SHADOW_M
    shadow_deg: float = SHADOW_DEG
    penumbra_m: float = PENUMBRA_M
    gloss: float = 0.0
    side_shade: float = SIDE_SHADE
    level: float = 1.0

    @property
    def shadow_way(self) -> np.ndarray:
        """Unit vector (2,) in the direction of shadows, plate_home."""
        angle = np.radians(self.shadow_deg)
        return np.array([np.cos(angle), np.sin(angle)])


EVEN = Lighting()
"""Light from all sides, without shadows and highlights."""


def part_colours(
    types: Sequence[PartType], colour: bool, greys: Mapping[str, float] = GREY_OF_CLASS
) -> np.ndarray:
    """Return the grey values (M,) of parts at full light, or blue, green and red (M, 3). `types`
    are the types of the parts. If a type has no colour, the grey value for its name in `greys` is
    used. If there is none, `UNKNOWN_GREY` is used.
    """
    known = [greys.get(part.name, UNKNOWN_GREY) for part in types]
    result = np.tile(np.array(known)[:, None], (1, 3))
    for row, part in zip(result, types, strict=True):
        if part.colour_lab is not None:
            lab = np.array(part.colour_lab) * (1.0 if colour else [1.0, 0.0, 0.0])
            row[:] = lab_to_srgb(lab)[::-1]
    return result if colour else result[:, 0]


def part_greys(classes: list[str]) -> np.ndarray:
    """Return the grey values (M,) of parts of these classes.

    Raises
    ------
    PlateError
        If a class is not in `GREY_OF_CLASS`.
    """
    for name in classes:
        if name not in GREY_OF_CLASS:
            raise PlateError(f"part class is {name!r}, allowed: {', '.join(GREY_OF_CLASS)}")
    return np.array([GREY_OF_CLASS[name] for name in classes], dtype=float)


class _Solids(NamedTuple):
    """M parts as they appear to the camera.

    Attributes
    ----------
    types : sequence of M
    path : (s, M, 2)
        Positions on the plate [m].
    top : Outlines
        Outlines of the top faces, projected onto the plane of the plate.
    seen : (s, M, 2)
        Positions of the projected top faces [m].
    size : (M,) or None
        Size of each part relative to its type. None means 1 for all.
    growth : (M,) or None
        Factor by which the projection enlarges each top face. None if all parts are flat.
    low : (2,) or None
        Point of the plate's plane vertically below the camera [m]. None if all parts are flat.
    """

    types: Sequence[PartType]
    path: np.ndarray
    top: Outlines
    seen: np.ndarray
    size: np.ndarray | None = None
    growth: np.ndarray | None = None
    low: np.ndarray | None = None


class _Layer(NamedTuple):
    """Layer of the drawing. The layer has one shape for each of M parts, for example all side
    faces. The fields are the kind of grey (see `Camera._sprites`), positions (s, M, 2) [m],
    outlines, opacity, and cosine and sine of the angles (M, 2) or (2,)."""

    kind: int
    path: np.ndarray
    outlines: Outlines
    opacity: float
    turn: np.ndarray


class Camera:
    """Renderer of images for one rig. The background with the plate at home is drawn once and
    cached.

    An instance is not thread-safe. Use one instance per thread.

    Parameters
    ----------
    rig : Rig
    noise : float
        Standard deviation of the noise of a pixel [grey values].
    plate, room : float
        Grey values of the plate and the surroundings at full light.
    defocus_px : float
        Standard deviation of the Gaussian blur by defocus [px]. 0 disables it.
    """

    def __init__(
        self,
        rig: Rig,
        noise: float = NOISE,
        *,
        plate: float = PLATE,
        room: float = ROOM,
        defocus_px: float = 0.0,
    ) -> None:
        self._rig = rig
        self.noise = noise
        self._greys, self._defocus_px = (room, plate), defocus_px
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
        height: np.ndarray | None = None,
        size: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the image of parts on the plate: (height, width) or (height, width, 3), uint8.

        Parameters
        ----------
        position : (M, 2) or (s, M, 2)
            Positions of the parts [m], plate_home. These are positions at the start of the
            exposure, or s samples at equal intervals from the start to the end of the exposure.
        grey : (M,) or (M, 3)
            Grey values of the parts at full light, or blue, green and red for a colour image.
        rng : numpy.random.Generator
            Generator for the noise. The generator draws one number per image: the offset in the
            bank of noise values.
        velocity : (M, 2), optional
            Velocities of the parts for motion blur [m/s]. Velocities require positions (M, 2).
            Default: 0.
        pose : (3,), (s, 3) or (b, s, 3), optional
            Pose of the plate [m, m, rad], plate_home. The pose is constant, or it has s samples
            over the exposure, or s samples for each of b equal bands of image rows. Default: home,
            which is correct at each start of a cycle if the plate is rigid.
        angle : (M,), optional
            Angles of the parts [rad], counter-clockwise. Without `types`, each part has a mark in
            this direction. The mark is grey on a black part and black on a grey part.
        types : sequence of M, optional
            Types of the parts. Default: discs with the rig's part radius.
        lighting : Lighting
            Light of the image.
        gripper : (2,), optional
            Position of a robot's gripper above the plate [m, plate_home]. The gripper and the arm
            hide everything below them. The arm extends from the gripper along +y.
        height : (M,), optional
            Heights of the parts' top faces above the plate [m]. Default: flat. The camera sees the
            top face of a high part displaced outwards and enlarged. The camera also sees the side
            face of this part.
        size : (M,), optional
            Sizes of the parts relative to their types. Default: 1.

        Raises
        ------
        PlateError
            If a value is not finite, if lengths disagree, if a part is as high as the camera, or if
            heights are given but the rig does not contain the camera's position (`camera_place`).
        """
        path = self._path(position, velocity)
        count = path.shape[1]
        colour = np.ndim(grey) == 2
        values = _checked("grey", grey, (count, 3) if colour else (count,))
        turns = np.zeros(count) if angle is None else _checked("angle", angle, (count,))
        scene = self._solids(path, types, height, size)
        sprites, outlines, kind = self._sprites(
            scene, turns, angle is not None and types is None, lighting
        )
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
            shades = np.concatenate([black, value, marks, white, lighting.side_shade * value])[kind]
            draw_parts(canvas, self._light, self._places, sprites._replace(grey=shades), outlines)
            if robot is not None:
                draw_parts(canvas, self._light, self._places, robot, _robot_outlines())
            if self._defocus_px:
                # Import only if needed, because the import takes 0.2 s and most images are sharp.
                from scipy.ndimage import gaussian_filter

                gaussian_filter(canvas, self._defocus_px, output=canvas)
            if lighting.level != 1:
                canvas *= np.float32(lighting.level)
            image = np.empty(canvas.shape, np.uint8)
            offset = rng.integers(NOISE_BANK)
            bank = _noise_bank(canvas.size)[offset : offset + canvas.size]
            expose(canvas.ravel(), bank, self.noise, image.ravel())
            channels.append(image)
        return np.stack(channels, axis=2) if colour else channels[0]

    def _path(self, position: np.ndarray, velocity: np.ndarray | None) -> np.ndarray:
        """Return s positions of each part over the exposure, (s, M, 2) [m], s at least 2."""
        position = np.asarray(position, dtype=float)
        if position.ndim == 3 and velocity is not None:
            raise PlateError("velocity requires positions of shape (M, 2), not over the exposure")
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
        """Return the outlines of M parts. The outlines of each type are computed only once."""
        if types is not None and len(types) != count:
            raise PlateError(f"types: {len(types)} for {count} parts, allowed: {count}")
        new = [part for part in dict.fromkeys(types or ()) if part not in self._types]
        if new:
            self._types += new
            self._outlines = outlines_of(self._types)
        row = [0] * count if types is None else [self._types.index(part) for part in types]
        return self._outlines.take(np.array(row, int))

    def _solids(
        self,
        path: np.ndarray,
        types: Sequence[PartType] | None,
        height: np.ndarray | None,
        size: np.ndarray | None,
    ) -> _Solids:
        """Project parts at positions (s, M, 2) [m] on the plate, see `_Solids`.

        Let H be the height of the camera and `low` the point below it. A point p at height h
        appears on the plate's plane at low + (p - low) H/(H - h).
        """
        count = path.shape[1]
        kinds = [self._types[0]] * count if types is None else types
        top = self._outlines_of(types, count)
        if size is not None:
            size = _checked("size", size, (count,))
            top = scaled(top, size)
        if height is None:
            return _Solids(kinds, path, top, path, size)
        high = _checked("height", height, (count,))
        if self._place is None:
            raise PlateError(
                "height: the camera's position is unknown, allowed: 0, or a rig file with focal_px "
                "or camera: height_m"
            )
        low, above = self._place[:2], float(self._place[2])
        if np.any((high < 0) | (high >= above)):
            raise PlateError(f"height: {high.tolist()} m, allowed: 0 to less than {above:g}")
        growth = above / (above - high)
        seen = low + growth[:, None] * (path - low)
        return _Solids(kinds, path, scaled(top, growth), seen, size, growth, low)

    @cached_property
    def _place(self) -> np.ndarray | None:
        return camera_place(self._rig)

    def _sprites(
        self, scene: _Solids, angle: np.ndarray, marked: bool, lighting: Lighting
    ) -> tuple[Sprites, Outlines, np.ndarray]:
        """Return the shapes to draw in this order: shadows, side faces, top faces, marks on discs,
        and highlights. Their grey value is still `WHITE`.

        The third result is the index (n,) of each shape's grey value. The index refers to an array
        with five rows of M parts: black, the grey value of the part, the grey value of its mark,
        white, and the grey value of its side face. If parts have heights, all shapes except shadows
        are drawn part by part instead of layer by layer. The part farthest from the point below the
        camera is first.
        """
        own, path, count = scene.top, scene.seen, scene.seen.shape[1]
        turn, level = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.array([1.0, 0.0])
        layers = [_Layer(1, path, own, 1.0, turn)]
        size = np.ones(count) if scene.size is None else scene.size
        if lighting.shadows:
            # All layers have the same opacity. Together they have the opacity of the shadow.
            opacity = 1 - (1 - lighting.shadows) ** (1 / PENUMBRA_STEPS)
            shift = np.tile(lighting.shadow_m * lighting.shadow_way, (count, 1))
            reach = size * [part.reach_m for part in scene.types]
            shadows = []
            for step in np.linspace(-1, 1, PENUMBRA_STEPS):
                growth = np.maximum(1 + step * lighting.penumbra_m / (2 * reach), 0.0)
                outlines = swept(scene.types, turn, size, growth, shift)
                shadows.append(_Layer(0, scene.path + shift / 2, outlines, opacity, level))
            layers = [*shadows, *layers]
        first = len(layers) - 1
        if scene.growth is not None:
            # The side face ends slightly inside the top face, see EDGE_PX.
            rise = path.mean(axis=0) - scene.path.mean(axis=0)
            swell = (scene.growth - 1)[:, None]
            reach = size * [part.reach_m for part in scene.types]
            extent = self._scale * (np.hypot(*rise.T) + swell[:, 0] * reach)
            part = np.maximum(1 - EDGE_PX / np.maximum(extent, EDGE_PX), 0)[:, None]
            outlines = swept(scene.types, turn, size, 1 + (part * swell)[:, 0], part * rise)
            layers.insert(first, _Layer(4, scene.path + part * rise / 2, outlines, 1.0, level))
        if marked:
            marks = own.discs(MARK_RADIUS * own.reach)
            there = path + MARK_PLACE * own.reach[:, None] * turn
            layers.append(_Layer(2, there, marks, 1.0, turn))
        if lighting.highlights or lighting.gloss:
            x, y, depth, area = own.spot.T
            (c, s), there = turn.T, np.empty((count, 2))
            there[:, 0], there[:, 1] = c * x - s * y, s * x + c * y
        if lighting.highlights:
            radius = np.minimum(
                np.sqrt(lighting.highlights * area / np.pi), HIGHLIGHT_WIDEST * depth
            )
            layers.append(_Layer(3, path + there, own.discs(radius), HIGHLIGHT_OPACITY, turn))
        if lighting.gloss:
            there = there - GLOSS_PLACE * depth[:, None] * lighting.shadow_way
            layers.append(_Layer(3, path + there, own.discs(lighting.gloss * depth), 1.0, turn))
        every = [layer.outlines for layer in layers]
        there, outlines = np.concatenate([layer.path for layer in layers], axis=1), joined(every)
        sprites = Sprites(
            *self._windows(there, outlines.reach), there, outlines.reach,
            np.concatenate([np.broadcast_to(layer.turn, (count, 2)) for layer in layers]),
            np.full(there.shape[1], WHITE),
            np.repeat([layer.opacity for layer in layers], count),
        )  # fmt: skip
        kind = np.concatenate([layer.kind * count + np.arange(count) for layer in layers])
        if scene.growth is not None:
            # A part hides the parts that are farther from the point below the camera.
            away = np.hypot(*(scene.path.mean(axis=0) - scene.low).T)
            rank = np.empty(count, int)
            rank[np.argsort(-away, kind="stable")] = np.arange(count)
            layer = np.repeat(np.arange(len(layers)), count)
            part = np.tile(rank, len(layers))
            order = np.lexsort((layer, np.where(layer < first, -1, part)))
            sprites, outlines, kind = sprites.take(order), outlines.take(order), kind[order]
        return sprites, outlines, kind

    def _robot(self, gripper: np.ndarray) -> Sprites:
        """Return the shapes of a robot whose gripper is at (2,) [m, plate_home]."""
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
        """Return three values for each shape: its window in the image (rows and columns, (n, 4)),
        its scale [px/m] (n,), and the number of positions that are averaged (n,).

        The half size of a window covers the shape and its path. The half size is multiplied by the
        largest singular value of the image's Jacobian at the middle of the path, and margins are
        added.
        """
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
        # Add a margin of 10 %, because the scale varies across a part.
        reach = 1.1 * longest * (radius + spread) + MARGIN_PX
        size = np.array([self._rig.camera.width_px, self._rig.camera.height_px])
        low = np.clip(seen - reach[:, None], 0, size).astype(int)
        high = np.clip(seen + reach[:, None] + 1, 0, size).astype(int)
        window = np.stack([low[:, 1], high[:, 1], low[:, 0], high[:, 0]], axis=1)
        scale = np.sqrt(area)
        length = np.linalg.norm(np.diff(path, axis=0), axis=2).sum(axis=0)
        return window, scale, _copies(length * scale)

    def _move_plate(self, canvas: np.ndarray, poses: np.ndarray, rows: np.ndarray) -> None:
        """Repaint pixels in the rows from rows[0] to rows[1] (exclusive). These are the pixels that
        differ between a plate at home and a plate at the poses (s, 3)."""
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
            travel, self._rig.plate.half, self._scale, self._greys,
        )  # fmt: skip


def _copies(length_px: np.ndarray, step_px: float = BLUR_STEP_PX) -> np.ndarray:
    """Return the number of positions that are averaged along paths of length (n,) [px]."""
    return np.minimum(BLUR_MOST, 1 + length_px / step_px).astype(int)


def _checked(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return `value` as an array, after a check of its shape and for finite numbers. The first axis
    counts the parts."""
    array = np.ascontiguousarray(value, dtype=float)
    if array.shape != shape:
        raise PlateError(f"{name}: shape is {array.shape}, allowed: {shape}")
    if not np.all(np.isfinite(array)):
        part = int(np.argwhere(~np.isfinite(array))[0][0])
        raise PlateError(f"{name}: value of part {part} is {array[part]}, allowed: finite numbers")
    return array


def _samples(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return `value` as an array (s, *shape), s at least 1, after a check for finite numbers. An
    array of shape `shape` becomes one sample."""
    array = np.ascontiguousarray(value, dtype=float)
    if array.shape == shape:
        array = array[None]
    if array.shape[1:] != shape or not len(array):
        size = ", ".join(map(str, shape))
        raise PlateError(f"{name}: shape is {array.shape}, allowed: ({size}) or (s, {size})")
    if not np.all(np.isfinite(array)):
        raise PlateError(f"{name}: some values are not finite, allowed: finite numbers")
    return array


@lru_cache(maxsize=2)
def _pixel_places(rig: Rig) -> np.ndarray:
    """Return the point of the plate's plane that each pixel shows, (height, width, 2) [m,
    plate_home]."""
    camera = rig.camera
    v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    if camera.lens is not None and camera.lens.bends:
        pixel = camera.lens.straighten(pixel)
    places = np.nan_to_num(project(np.linalg.inv(homography(rig)), pixel), nan=FAR)
    places.flags.writeable = False
    return places.reshape(*u.shape, 2)


def _light(width: int, height: int) -> np.ndarray:
    """Return the fraction of full light in each pixel, (height, width), float32.

    With coordinates x and y from -1 to 1 over the image, it is 1 - SHADING (x^2 + y^2)/2.
    """
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    return 1 - np.float32(SHADING) * (x * x + y * y) / 2


@lru_cache(maxsize=1)
def _robot_outlines() -> Outlines:
    return outlines_of(ROBOT)


@lru_cache(maxsize=4)
def _noise_bank(pixels: int) -> np.ndarray:
    """Return standard normal numbers (`NOISE_BANK` + pixels,), float32. These are the numbers
    of the bank, repeated cyclically. They are the same in every run."""
    bank = np.random.default_rng(0).standard_normal(NOISE_BANK, dtype=np.float32)
    return np.resize(bank, NOISE_BANK + pixels)
