"""Synthetic images of the plate and its parts. An image depends on the poses of the parts and the
plate, on the light, and on the lens. It also depends on the types, heights and grey values of the
parts. Images contain shadows, motion blur and noise. They are grey or in colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from plate_core import PlateError, Rig
from plate_core.colours import lab_to_srgb
from plate_core.rig import PartType, camera_position, homography, project, to_home

from .raster import (
    Outlines,
    Sprites,
    concatenate_outlines,
    draw_parts,
    draw_plate,
    expose,
    make_outlines,
)
from .sweeps import scale_outlines, sweep_outlines

SURROUNDINGS = 60.0
"""Grey value of the surroundings of the plate at full brightness."""

PLATE = 220.0
"""Grey value of the plate at full brightness."""

GREY_OF_CLASS = {"black": 40.0, "grey": 130.0}
"""Grey values of the parts at full brightness, by class."""

UNKNOWN_GREY = 80.0
"""Grey value of a part whose type has no known colour."""

SHADING = 0.10
"""Fraction by which the corners of the image are darker than its centre."""

NOISE = 2.0
"""Default standard deviation of the noise of a pixel [grey values]."""

NOISE_BANK = 1 << 20
"""Number of precomputed random numbers for the noise of images. The numbers are precomputed because
it takes 3 ms to generate 307200 random numbers for one image."""

BLUR_STEP_PX = 0.1
"""Distance between two successive positions of a moving part that are averaged to draw motion blur
[px]. A smaller distance makes no visible difference."""

EDGE_STEP_PX = 0.25
"""Distance between two successive positions of the plate that are averaged to draw motion blur
[px]. The distance is a quarter of the width of an edge in the image. It is larger than
`BLUR_STEP_PX`, because the plate's edges have many pixels and each position takes computing
time."""

MAX_BLUR = 16
"""Maximum number of positions that are averaged to draw the motion blur of one exposure."""

MARK_PLACE = 0.5
"""Distance between the centre of a disc and its mark, divided by the radius of the disc. The mark
shows the angle of the disc."""

MARK_RADIUS = 0.3
"""Radius of the mark on a disc, divided by the radius of the disc."""

MARK_OF_DARK = 130.0
"""Grey value of the mark on a part that is darker than `LIGHT`. The mark is brighter than the part,
so that the mark is visible. The mark is darker than the plate, so that a detector still detects the
disc as one dark disc."""

MARK_OF_LIGHT = 40.0
"""Grey value of the mark on a part that is not darker than `LIGHT`."""

LIGHT = 85.0
"""Grey value below which a part counts as dark."""

STRIP_STEP = 0.002
"""If the plate has moved, a strip along its edge is repainted in the image. The width of this strip
is a multiple of this value [m]. The pixels of the strip are cached for each width."""

NO_POINT = 1e6
"""Coordinate that is assigned to pixels that show no point of the plate's plane [m]. The coordinate
is far outside the plate."""

SHADOW_M = 2.5e-3
"""Default length by which a shadow extends beyond its part [m]."""

SHADOW_DEG = -36.9
"""Default direction of a shadow, as an angle from the x axis [degrees, plate_home]."""

PENUMBRA_M = 1.5e-3
"""Default width of the soft edge of a shadow, at the end that is farthest from the part [m]."""

PENUMBRA_STEPS = 5
"""Number of sharp shadows of equal opacity that are drawn over each other to make a shadow with a
soft edge. With 5 shadows, an edge of 3 mm looks smooth at 1 px/mm."""

SIDE_SHADE = 0.7
"""Default brightness of the side face of a part, divided by the brightness of its top face."""

EDGE_PX = 0.7
"""A side face ends inside the edge of its top face by this distance in the image [px]. If both
edges coincided, the plate would be visible through the common edge, because each edge covers its
pixels only partly."""

GLOSS_PLACE = 0.35
"""Place of the lamp's reflection on a glossy part. Let P be the point of the part that is farthest
from its outline. The reflection is displaced from P towards the lamp by this value, multiplied by
the distance of P from the outline."""

HIGHLIGHT_OPACITY = 0.9
"""Opacity of a highlight, which is a white disc."""

HIGHLIGHT_WIDEST = 0.8
"""Maximum radius of a highlight, divided by the distance of its centre from the outline of the
part."""

WHITE = 255.0

ARM_M = 0.06
"""Width of a robot's arm [m]. The robot is drawn without perspective, as if it were flat on the
plate."""

HEAD_M = 0.04
"""Diameter of the robot's gripper [m]."""

ARM_END_M = 1.0
"""Length of the robot's arm along +y [m]. The arm extends beyond the edge of the image."""

ROBOT = (
    PartType(
        "arm",
        outline=((-ARM_M / 2, 0), (ARM_M / 2, 0), (ARM_M / 2, ARM_END_M), (-ARM_M / 2, ARM_END_M)),
    ),
    PartType("wrist", radius_m=ARM_M / 2),
    PartType("gripper", radius_m=HEAD_M / 2),
)
ROBOT_GREY = (150.0, 150.0, 100.0)
"""Grey values of the shapes in `ROBOT` at full brightness."""

MARGIN_PX = 2.0
"""Distance by which the image window of a part extends beyond the part's expected edge [px]."""


@dataclass(frozen=True)
class Lighting:
    """Properties of the light in an image: shadows, highlights, gloss and brightness.

    Attributes
    ----------
    highlights : float
        Fraction of each part's area that a highlight covers. The centre of the highlight is the
        point of the part that is farthest from the part's outline.
    shadows : float
        Fraction by which the plate is darker in shadows. 0 disables shadows.
    shadow_m : float
        Length of the shadows on the plate [m].
    shadow_deg : float
        Direction of the shadows, as an angle from the x axis [degrees, plate_home]. The lamp is on
        the opposite side.
    penumbra_m : float
        Width of the soft edge of a shadow at the end that is farthest from the part [m]. Next to
        the part, the edge is sharp.
    gloss : float
        Radius of the lamp's reflection on each part, divided by the maximum distance of a point of
        the part from the part's outline. For a disc, this maximum distance is the radius. 0
        disables reflections.
    side_shade : float
        Brightness of the side faces, divided by the brightness of the top faces.
    level : float
        Factor by which the brightness of the whole image is multiplied.
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
    def shadow_direction(self) -> np.ndarray:
        """Unit vector (2,) in the direction of the shadows, in plate_home."""
        angle = np.radians(self.shadow_deg)
        return np.array([np.cos(angle), np.sin(angle)])


EVEN = Lighting()
"""Light from all sides, without shadows and highlights."""


def part_colours(
    types: Sequence[PartType], colour: bool, greys: Mapping[str, float] = GREY_OF_CLASS
) -> np.ndarray:
    """Return the grey values (M,) of parts of the types `types` at full brightness. If `colour` is
    True, return the values of blue, green and red (M, 3) instead. A type without a colour has the
    grey value that `greys` contains for its name, or else `UNKNOWN_GREY`.
    """
    known = [greys.get(part.name, UNKNOWN_GREY) for part in types]
    result = np.tile(np.array(known)[:, None], (1, 3))
    for row, part in zip(result, types, strict=True):
        if part.colour_lab is not None:
            lab = np.array(part.colour_lab) * (1.0 if colour else [1.0, 0.0, 0.0])
            row[:] = lab_to_srgb(lab)[::-1]
    return result if colour else result[:, 0]


def part_greys(classes: list[str]) -> np.ndarray:
    """Return the grey values (M,) of parts of the classes `classes`.

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
    """Positions and outlines of the M parts of an image, projected onto the plane of the plate.

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
        Size of each part divided by the size of its type. None means 1 for all parts.
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

    @property
    def sizes(self) -> np.ndarray:
        """Size of each part (M,) divided by the size of its type."""
        return np.ones(self.seen.shape[1]) if self.size is None else self.size

    @property
    def reach(self) -> np.ndarray:
        """Distance of the farthest point of each part from its centre (M,) [m]."""
        return np.asarray(self.sizes * [part.reach_m for part in self.types])


class _Layer(NamedTuple):
    """Layer of the drawing with one shape for each of M parts. For example, a layer contains all
    side faces. `path` contains the positions (s, M, 2) [m], and `cos_sin` the cosine and sine of
    the angles, (M, 2) or (2,). `kind` is the row of the shapes' grey values in the array that
    `Camera._make_sprites` describes."""

    kind: int
    path: np.ndarray
    outlines: Outlines
    opacity: float
    cos_sin: np.ndarray


UNROTATED = np.array([1.0, 0.0])
"""Cosine and sine of the angle of shapes whose outlines already include the angle of the part."""


def _shadow_layers(scene: _Solids, cos_sin: np.ndarray, lighting: Lighting) -> list[_Layer]:
    """Return the layers of the parts' shadows. All layers have the same opacity. Where all layers
    overlap, their total opacity is the opacity of the shadow."""
    opacity = 1 - (1 - lighting.shadows) ** (1 / PENUMBRA_STEPS)
    shift = np.tile(lighting.shadow_m * lighting.shadow_direction, (len(cos_sin), 1))
    layers = []
    for step in np.linspace(-1, 1, PENUMBRA_STEPS):
        growth = np.maximum(1 + step * lighting.penumbra_m / (2 * scene.reach), 0.0)
        outlines = sweep_outlines(scene.types, cos_sin, scene.sizes, growth, shift)
        layers.append(_Layer(0, scene.path + shift / 2, outlines, opacity, UNROTATED))
    return layers


def _highlight_layers(
    path: np.ndarray, top: Outlines, cos_sin: np.ndarray, lighting: Lighting
) -> list[_Layer]:
    """Return the layers of the highlights and of the gloss on top faces at positions `path` (s, M,
    2) [m], if the lighting has any."""
    x, y, depth, area = top.spot.T
    (c, s), layers = cos_sin.T, []
    spot = np.stack([c * x - s * y, s * x + c * y], axis=1)
    if lighting.highlights:
        radius = np.minimum(np.sqrt(lighting.highlights * area / np.pi), HIGHLIGHT_WIDEST * depth)
        layers.append(_Layer(3, path + spot, top.discs(radius), HIGHLIGHT_OPACITY, cos_sin))
    if lighting.gloss:
        spot = spot - GLOSS_PLACE * depth[:, None] * lighting.shadow_direction
        gloss = top.discs(lighting.gloss * depth)
        layers.append(_Layer(3, path + spot, gloss, 1.0, cos_sin))
    return layers


class Camera:
    """Renderer of images for one rig. The camera draws the background with the plate at home only
    once, and uses this drawing for all images.

    An instance is not thread-safe. Use one instance per thread.

    Parameters
    ----------
    rig : Rig
    noise : float
        Standard deviation of the noise of a pixel [grey values].
    plate, room : float
        Grey values of the plate and of its surroundings at full brightness.
    defocus_px : float
        Standard deviation of the Gaussian blur that simulates defocus [px]. 0 disables the blur.
    """

    def __init__(
        self,
        rig: Rig,
        noise: float = NOISE,
        *,
        plate: float = PLATE,
        room: float = SURROUNDINGS,
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
        self._light = _light_profile(width, height)
        self._places = _pixel_positions(rig)
        corners = np.array(rig.camera.corners_px)
        self._scale = float(np.linalg.norm(corners[1] - corners[0]) / rig.plate.length_m)
        inside = rig.plate.half - np.abs(self._places)
        self._edge_distance = np.abs(np.minimum(inside[..., 0], inside[..., 1])).ravel()
        self._edge: dict[int, np.ndarray] = {}
        self._empty = np.empty((height, width), np.float32)
        self._paint_plate(self._empty, np.zeros((1, 3)), np.arange(width * height), 0.0)
        self._canvas = np.empty_like(self._empty)
        self._types = [PartType("", radius_m=rig.parts.radius_m, symmetry=0)]
        self._outlines = make_outlines(self._types)

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
        """Return the image of parts on the plate, uint8. The shape is (height, width), or (height,
        width, 3) for an image in colour.

        Parameters
        ----------
        position : (M, 2) or (s, M, 2)
            Positions of the parts [m, plate_home]. An array (M, 2) contains the positions at the
            start of the exposure. An array (s, M, 2) contains s samples at equal intervals from the
            start to the end of the exposure.
        grey : (M,) or (M, 3)
            Grey values of the parts at full brightness (M,), or blue, green and red (M, 3) for an
            image in colour.
        rng : numpy.random.Generator
            Random number generator for the noise. For each image, it generates one number, namely
            the index of the first precomputed noise value.
        velocity : (M, 2), optional
            Velocities of the parts, from which motion blur is computed [m/s]. Velocities are
            allowed only if `position` has the shape (M, 2). Default: 0.
        pose : (3,), (s, 3) or (b, s, 3), optional
            Pose of the plate [m, m, rad], plate_home. An array (3,) is a constant pose. An array
            (s, 3) contains s samples over the exposure. An array (b, s, 3) contains s samples for
            each of b equal bands of image rows. Default: home, because a rigid plate is at home at
            the start of each cycle.
        angle : (M,), optional
            Angles of the parts [rad], counter-clockwise. If `types` is not given, each part has a
            mark in this direction. The mark is grey on a black part and black on a grey part.
        types : sequence of M, optional
            Types of the parts. Default: discs with the rig's part radius.
        lighting : Lighting
            Light of the image.
        gripper : (2,), optional
            Position of a robot's gripper above the plate [m, plate_home]. The gripper and the arm
            hide everything below them. The arm extends from the gripper along +y.
        height : (M,), optional
            Heights of the parts' top faces above the plate [m]. Default: flat. If a part has a
            height, the image shows its top face enlarged and displaced outwards, and it also shows
            the side face.
        size : (M,), optional
            Size of each part divided by the size of its type. Default: 1.

        Raises
        ------
        PlateError
            If a value is not finite, if the arguments disagree about the number of parts, or if a
            part is as high as the camera. Also if heights are given but the rig file does not
            contain the position of the camera (`camera_position`).
        """
        path = self._exposure_path(position, velocity)
        count = path.shape[1]
        colour = np.ndim(grey) == 2
        values = _check_array("grey", grey, (count, 3) if colour else (count,))
        angles = np.zeros(count) if angle is None else _check_array("angle", angle, (count,))
        scene = self._project_parts(path, types, height, size)
        sprites, outlines, kind = self._make_sprites(
            scene, angles, angle is not None and types is None, lighting
        )
        robot = (
            None
            if gripper is None
            else self._make_robot_sprites(_check_array("gripper", gripper, (2,)))
        )
        channels = []
        for value in values.T if colour else [values]:
            canvas = self._canvas
            np.copyto(canvas, self._empty)
            if pose is not None and np.any(pose):
                bands = pose if np.ndim(pose) == 3 else [pose]
                ends = len(canvas) * np.arange(len(bands) + 1) // len(bands)
                for k, poses in enumerate(bands):
                    self._move_plate(canvas, _check_samples("pose", poses, (3,)), ends[k : k + 2])
            marks = np.where(value < LIGHT, MARK_OF_DARK, MARK_OF_LIGHT)
            black, white = np.zeros(count), np.full(count, WHITE)
            shades = np.concatenate([black, value, marks, white, lighting.side_shade * value])[kind]
            draw_parts(canvas, self._light, self._places, sprites._replace(grey=shades), outlines)
            if robot is not None:
                draw_parts(canvas, self._light, self._places, robot, _robot_outlines())
            if self._defocus_px:
                # scipy.ndimage is imported only for images with defocus, because the import takes
                # 0.2 s.
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

    def _exposure_path(self, position: np.ndarray, velocity: np.ndarray | None) -> np.ndarray:
        """Return samples of the positions of each part over the exposure (s, M, 2) [m]. There are
        at least two samples."""
        position = np.asarray(position, dtype=float)
        if position.ndim == 3 and velocity is not None:
            raise PlateError(
                "velocity is given with positions over the exposure, allowed: shape (M, 2)"
            )
        if position.ndim != 3:
            position = position.reshape(1, -1, 2)
        path = _check_samples("position", position, position.shape[1:])
        if len(path) > 1:
            return path
        if velocity is None:
            return np.concatenate([path, path])
        velocity = _check_array("velocity", velocity, path.shape[1:])
        return np.concatenate([path, path + self._rig.camera.exposure_s * velocity])

    def _make_outlines(self, types: Sequence[PartType] | None, count: int) -> Outlines:
        """Return the outlines of `count` parts. If several parts have the same type, their outline
        is computed only once."""
        if types is not None and len(types) != count:
            raise PlateError(f"types: {len(types)} for {count} parts, allowed: {count}")
        new = [part for part in dict.fromkeys(types or ()) if part not in self._types]
        if new:
            self._types += new
            self._outlines = make_outlines(self._types)
        row = [0] * count if types is None else [self._types.index(part) for part in types]
        return self._outlines.take(np.array(row, int))

    def _project_parts(
        self,
        path: np.ndarray,
        types: Sequence[PartType] | None,
        height: np.ndarray | None,
        size: np.ndarray | None,
    ) -> _Solids:
        """Project parts at positions (s, M, 2) [m] onto the plane of the plate.

        Let H be the height of the camera above the plate and `low` the point of the plate's plane
        below the camera. A point p at the height h appears in the image at the same place as the
        point low + (p - low) H/(H - h) of the plate's plane.
        """
        count = path.shape[1]
        kinds = [self._types[0]] * count if types is None else types
        top = self._make_outlines(types, count)
        if size is not None:
            size = _check_array("size", size, (count,))
            top = scale_outlines(top, size)
        if height is None:
            return _Solids(kinds, path, top, path, size)
        high = _check_array("height", height, (count,))
        if self._camera_position is None:
            if not high.any():
                return _Solids(kinds, path, top, path, size)
            raise PlateError(
                f"height is {high.tolist()} m and the camera's position is unknown, allowed: 0; "
                "for other heights, give focal_px or camera: height_m in the rig file"
            )
        low, above = self._camera_position[:2], float(self._camera_position[2])
        if np.any((high < 0) | (high >= above)):
            raise PlateError(f"height: {high.tolist()} m, allowed: 0 to less than {above:g}")
        growth = above / (above - high)
        seen = low + growth[:, None] * (path - low)
        return _Solids(kinds, path, scale_outlines(top, growth), seen, size, growth, low)

    @cached_property
    def _camera_position(self) -> np.ndarray | None:
        return camera_position(self._rig)

    def _make_sprites(
        self, scene: _Solids, angle: np.ndarray, marked: bool, lighting: Lighting
    ) -> tuple[Sprites, Outlines, np.ndarray]:
        """Return the shapes in the order in which they are drawn: shadows, side faces, top faces,
        marks on discs, and highlights. The grey value of all shapes is `WHITE`, which the caller
        replaces.

        The third result (n,) contains, for each shape, the index of its grey value in a flattened
        array (5, M). The five rows of this array contain black, the grey values of the parts, those
        of the marks, white, and those of the side faces. If parts have heights, all shapes except
        shadows are drawn part by part instead of layer by layer. The part that is farthest from the
        point below the camera is drawn first.
        """
        top_outlines, path, count = scene.top, scene.seen, scene.seen.shape[1]
        cos_sin = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        layers = _shadow_layers(scene, cos_sin, lighting) if lighting.shadows else []
        first = len(layers)
        if scene.growth is not None:
            layers.append(self._side_layer(scene, scene.growth, cos_sin))
        layers.append(_Layer(1, path, top_outlines, 1.0, cos_sin))
        if marked:
            marks = top_outlines.discs(MARK_RADIUS * top_outlines.reach)
            mark_path = path + MARK_PLACE * top_outlines.reach[:, None] * cos_sin
            layers.append(_Layer(2, mark_path, marks, 1.0, cos_sin))
        layers += _highlight_layers(path, top_outlines, cos_sin, lighting)
        paths = np.concatenate([layer.path for layer in layers], axis=1)
        outlines = concatenate_outlines([layer.outlines for layer in layers])
        sprites = Sprites(
            *self._motion_windows(paths, outlines.reach), paths, outlines.reach,
            np.concatenate([np.broadcast_to(layer.cos_sin, (count, 2)) for layer in layers]),
            np.full(paths.shape[1], WHITE),
            np.repeat([layer.opacity for layer in layers], count),
        )  # fmt: skip
        kind = np.concatenate([layer.kind * count + np.arange(count) for layer in layers])
        if scene.growth is not None:
            # A part hides parts that are farther from the point below the camera. Therefore the
            # farthest part is drawn first.
            distance = np.hypot(*(scene.path.mean(axis=0) - scene.low).T)
            rank = np.empty(count, int)
            rank[np.argsort(-distance, kind="stable")] = np.arange(count)
            layer = np.repeat(np.arange(len(layers)), count)
            part = np.tile(rank, len(layers))
            order = np.lexsort((layer, np.where(layer < first, -1, part)))
            sprites, outlines, kind = sprites.take(order), outlines.take(order), kind[order]
        return sprites, outlines, kind

    def _side_layer(self, scene: _Solids, growth: np.ndarray, cos_sin: np.ndarray) -> _Layer:
        """Return the side faces of the parts. The drawn side face of a part ends slightly inside
        its top face (see EDGE_PX)."""
        rise = scene.seen.mean(axis=0) - scene.path.mean(axis=0)
        swell = (growth - 1)[:, None]
        extent = self._scale * (np.hypot(*rise.T) + swell[:, 0] * scene.reach)
        part = np.maximum(1 - EDGE_PX / np.maximum(extent, EDGE_PX), 0)[:, None]
        outlines = sweep_outlines(
            scene.types, cos_sin, scene.sizes, 1 + (part * swell)[:, 0], part * rise
        )
        return _Layer(4, scene.path + part * rise / 2, outlines, 1.0, UNROTATED)

    def _make_robot_sprites(self, gripper: np.ndarray) -> Sprites:
        """Return the shapes of a robot whose gripper is at the position `gripper` (2,) [m,
        plate_home]."""
        outlines, count = _robot_outlines(), len(ROBOT)
        path = np.tile(gripper, (2, count, 1))
        window, scale, copies = self._motion_windows(path, outlines.reach)
        offset = self._places - gripper
        covered = (np.abs(offset[..., 0]) < ARM_M) & (offset[..., 1] > -ARM_M)
        for axis in (0, 1):
            lines = np.flatnonzero(covered.any(axis=1 - axis))
            window[0, 2 * axis : 2 * axis + 2] = (lines[0], lines[-1] + 1) if len(lines) else (0, 0)
        cos_sin = np.tile([1.0, 0.0], (count, 1))
        return Sprites(
            window,
            scale,
            copies,
            path,
            outlines.reach,
            cos_sin,
            np.array(ROBOT_GREY),
            np.ones(count),
        )

    def _motion_windows(
        self, path: np.ndarray, radius: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the values `window`, `scale` and `copies` of n shapes, as described in `Sprites`.

        The window of a shape is a square around the middle of the shape's path, clipped to the
        image. The square contains the shape at all positions of the path. Let J be the Jacobian of
        the map from the plate to the image at the middle of the path. The scale is sqrt(|det J|).
        The size of the square is computed with the largest singular value of J.
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
        stretch = np.sqrt(0.5 * (square + np.sqrt(np.maximum(square**2 - 4 * area**2, 0))))
        spread = np.linalg.norm(path - middle, axis=2).max(axis=0)
        # The window of pixels around a part is 10 % larger than computed, because the image scale
        # varies across the part.
        reach = 1.1 * stretch * (radius + spread) + MARGIN_PX
        size = np.array([self._rig.camera.width_px, self._rig.camera.height_px])
        low = np.clip(seen - reach[:, None], 0, size).astype(int)
        high = np.clip(seen + reach[:, None] + 1, 0, size).astype(int)
        window = np.stack([low[:, 1], high[:, 1], low[:, 0], high[:, 0]], axis=1)
        scale = np.sqrt(area)
        length = np.linalg.norm(np.diff(path, axis=0), axis=2).sum(axis=0)
        return window, scale, _copy_counts(length * scale)

    def _move_plate(self, canvas: np.ndarray, poses: np.ndarray, rows: np.ndarray) -> None:
        """Repaint the pixels that differ between a plate at home and a plate that moves through the
        poses `poses` (s, 3). Only the image rows from rows[0] to rows[1] - 1 are repainted."""
        corners = np.array([to_home(pose, self._rig.plate.corners) for pose in poses])
        shift_px = np.linalg.norm(corners - self._rig.plate.corners, axis=2).max()
        travel = np.linalg.norm(np.diff(corners, axis=0), axis=2).sum(axis=0).max()
        steps = int(np.ceil((shift_px + 1 / self._scale) / STRIP_STEP))
        if steps not in self._edge:
            self._edge[steps] = np.flatnonzero(self._edge_distance <= steps * STRIP_STEP)
        first, end = np.searchsorted(self._edge[steps], rows * canvas.shape[1])
        self._paint_plate(canvas, poses, self._edge[steps][first:end], float(travel))

    def _paint_plate(
        self, canvas: np.ndarray, poses: np.ndarray, pixels: np.ndarray, travel: float
    ) -> None:
        copies = int(_copy_counts(np.array(travel * self._scale), EDGE_STEP_PX))
        draw_plate(
            canvas.ravel(), self._light.ravel(), self._places.reshape(-1, 2), pixels, poses, copies,
            travel, self._rig.plate.half, self._scale, self._greys,
        )  # fmt: skip


def _copy_counts(length_px: np.ndarray, step_px: float = BLUR_STEP_PX) -> np.ndarray:
    """Return the numbers of positions that are averaged to draw the motion blur of paths with the
    lengths (n,) [px]."""
    return np.minimum(MAX_BLUR, 1 + length_px / step_px).astype(int)


def _check_array(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Convert `value`, whose rows belong to parts, to an array. Raise an error if the shape is
    wrong, or if a number is not finite."""
    array = np.ascontiguousarray(value, dtype=float)
    if array.shape != shape:
        raise PlateError(f"{name}: shape is {array.shape}, allowed: {shape}")
    if not np.all(np.isfinite(array)):
        part = int(np.argwhere(~np.isfinite(array))[0][0])
        raise PlateError(f"{name}: value of part {part} is {array[part]}, allowed: finite numbers")
    return array


def _check_samples(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Convert `value` to an array of samples (s, *shape). If `value` has the shape `shape`, it
    becomes one sample. Raise an error if the shape is wrong, or if a number is not finite."""
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
def _pixel_positions(rig: Rig) -> np.ndarray:
    """Return the point of the plate's plane that each pixel shows, (height, width, 2) [m,
    plate_home]."""
    camera = rig.camera
    v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    if camera.lens is not None and camera.lens.bends:
        pixel = camera.lens.straighten(pixel)
    places = np.nan_to_num(project(np.linalg.inv(homography(rig)), pixel), nan=NO_POINT)
    places.flags.writeable = False
    return places.reshape(*u.shape, 2)


def _light_profile(width: int, height: int) -> np.ndarray:
    """Return the brightness of each pixel as a fraction of full brightness, (height, width),
    float32.

    With the image coordinates x and y from -1 to 1, the fraction is 1 - SHADING (x^2 + y^2)/2.
    """
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    return 1 - np.float32(SHADING) * (x * x + y * y) / 2


@lru_cache(maxsize=1)
def _robot_outlines() -> Outlines:
    return make_outlines(ROBOT)


@lru_cache(maxsize=4)
def _noise_bank(pixels: int) -> np.ndarray:
    """Return an array of (`NOISE_BANK` + pixels) normally distributed random numbers with standard
    deviation 1, float32. The numbers repeat after `NOISE_BANK` numbers, and are the same in every
    run."""
    bank = np.random.default_rng(0).standard_normal(NOISE_BANK, dtype=np.float32)
    return np.resize(bank, NOISE_BANK + pixels)
