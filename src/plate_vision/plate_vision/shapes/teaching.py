"""Learning of part types from pictures of parts.

The outline of each part is measured. The outlines are fitted to each other and averaged. The mean
outline is simplified to a polygon. The symmetry is the number of rotations that transform the mean
outline into itself. `check_distinguishable` raises an error if two types cannot be distinguished.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from plate_core.rig import MAX_HOLES, PartType, read_part_types
from plate_core.yaml_fields import Fields

from ..camera.lens import Calibration
from ..errors import TeachError
from ..plate.region import Region
from .background import Background, model_background
from .catalogue import Template, fit_template, make_template
from .classes import (
    COLOUR_LAB,
    FIT_PX,
    FIT_REACH,
    SIZE_PX,
    SIZE_REACH,
    colour_distance,
    footprints,
    measure_patches,
)
from .outlines import Outline, distances, make_outline
from .patch import Patch
from .polygons import simplify_polygon
from .segmentation import find_patches

MAX_PICTURES = 5
"""Maximum number of pictures of one type. With more pictures than this number, the result would
hardly change."""

CONTOUR_POINTS = 256
"""Number of points on the outline of an example."""

DIFFER, DIFFER_SIZE = 0.1, 0.35
"""Maximum difference between the outlines (`DIFFER`) and between the sizes (`DIFFER_SIZE`) of
examples of one type, relative to the parts' reach (largest radius) [-]. Sizes may differ more,
because seeds or coins of the same kind differ in size."""

DIFFER_PX = 1.5
"""Difference between the outlines or sizes of examples that is always allowed [px]. For small
parts, this difference is larger than `DIFFER` times the reach."""

MIN_ALIKE_FRACTION = 0.66
"""Minimum fraction of the parts that must agree with each other. Parts that do not agree are not
used."""

ROUND = 0.018
"""Maximum RMS (root mean square) deviation of a disc's outline from a circle, relative to its
radius. For a regular octagon, the deviation is 0.024."""

ROUND_PX = 0.12
"""RMS deviation of a disc's outline from a circle that is always allowed [px]. This deviation
allows for the noise of small parts."""

UNEVEN = 2.0
"""Minimum deviation of the mean outline from a circle, relative to the deviation of the examples
from the mean outline. Below this ratio, the part is a disc without an angle. For random outlines
that are fitted to each other, the ratio is 1.5."""

ALIKE = 2.0
"""Minimum distance between two types that can be distinguished, in standard deviations of parts of
one type."""

TURNED = 0.015
"""Maximum RMS deviation between a ring and its rotated copy with which they count as equal,
relative to the reach (largest radius) [-]."""

TURNED_PX = 0.25
"""Lower bound of the limit that `TURNED` describes [px]. This bound applies to small parts."""

MAX_SYMMETRY = 12
"""Maximum symmetry of a part that is not round."""

PICTURE_PX = 320
"""Side of a type's picture [px]."""

BLUR_PX, BLUR_RADIUS = 2.0, 0.1
"""Maximum blur (standard deviation) of a part's contour: the larger one of `BLUR_PX` [px] and
`BLUR_RADIUS`, relative to the part's radius [-]."""

HEIGHTS = (0.25, 0.5, 0.75, 1.0, 1.5)
"""Heights that are tried for a part that is assumed to be flat, relative to its reach [-]."""

HIGHEST = 0.5
"""Maximum height that is tried for a part, relative to the height of the camera [-]."""

BETTER, BETTER_PX = 2.0, 0.05
"""Conditions for the warning that a part may not be flat. `BETTER`: minimum factor by which a
height must reduce the difference between the examples, after their sizes are made equal.
`BETTER_PX`: minimum of this difference for height 0 [px].

The warning was tried in synthetic images. With the camera at a height of 0.43 m, none of 48 sets of
flat parts caused a warning. The warning was caused by 6 of 12 sets with parts of 4 mm height, by 9
of 12 sets with 6 mm, and by 11 of 12 sets with 8 mm. With the camera at 0.91 m, half of the sets
with parts of 8 mm height caused the warning. Each set had four examples."""

BESIDE_PX, BESIDE_RADIUS = 9.0, 0.6
"""Range on both sides of a contour for the measurement of blur. The range is the smaller one of
`BESIDE_PX` [px] and `BESIDE_RADIUS` times the radius."""


@dataclass(frozen=True, eq=False)
class Example:
    """A picture with parts of one type.

    Attributes
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    box_px : (4,), optional
        x0, y0, x1, y1 of a box: only the largest part in this box is used. None: all parts are
        used.
    name : str
        Name of the example in messages.
    """

    image: np.ndarray
    box_px: tuple[float, float, float, float] | None = None
    name: str = "picture"


@dataclass(frozen=True, eq=False)
class Lesson:
    """Result of learning a type.

    Attributes
    ----------
    part : PartType
    count : int
        Number of parts from which the type was learned.
    size_m : (2,)
        Diameter of the disc of the same area: mean and standard deviation [m].
    picture : (H, W, 3) uint8
        The first example, with the type's outline and the direction of the angle 0 drawn into it.
    unused : tuple of str
        Reasons why examples were not used.
    warnings : tuple of str
        Warnings about reasons why the type may be difficult to recognise.
    """

    part: PartType
    count: int
    size_m: np.ndarray
    picture: np.ndarray
    unused: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Shown:
    """A part in an example: its outline, its colour (3,) CIE L, a, b, and the blur of its contour,
    relative to the maximum blur."""

    example: Example
    outline: Outline
    colour: np.ndarray
    blur: float


def teach(
    examples: Mapping[str, Sequence[Example]],
    calibration: Calibration,
    background: Background | None = None,
    region: Region | None = None,
) -> dict[str, PartType]:
    """Learn part types from examples of each type.

    Parameters
    ----------
    examples : mapping of str to sequence of Example
        Examples by the names of types.
    calibration : Calibration
        Transformation between the pictures and plate_home; see `calibrate_by_scale`.
    background : Background, optional
        The bare plate; None: a model of it is made from each picture.
    region : Region, optional
        Region of the plate; None: the whole picture.

    Raises
    ------
    TeachError
        If a type cannot be learned (see `learn_type`), or if two types look alike.
    """
    types: dict[str, PartType] = {}
    for name, pictures in examples.items():
        lesson = learn_type(name, pictures, calibration, background, region)
        check_distinguishable(lesson.part, types, calibration)
        types[name] = lesson.part
    return types


def learn_type(
    name: str,
    examples: Sequence[Example],
    calibration: Calibration,
    background: Background | None = None,
    region: Region | None = None,
    height: float = 0.0,
) -> Lesson:
    """Learn one part type with a height [m]. The other parameters are as in `teach`.

    If the camera's position is known, the learned outline is the outline of the part's base. The
    side faces and the shift of the top are removed.

    Raises
    ------
    TeachError
        If there are no examples or too many; if no example shows complete parts that do not touch;
        if the examples differ too much; or if the outline needs more corners than are allowed.
    """
    if not 1 <= len(examples) <= MAX_PICTURES:
        count = len(examples) or "no"
        raise TeachError(f"type {name}: there are {count} examples, allowed: 1 to {MAX_PICTURES}")
    shown: list[_Shown] = []
    unused: list[str] = []
    for example in examples:
        try:
            shown += _measure_example(name, example, calibration, background, region)
        except TeachError as error:
            unused.append(str(error))
    if not shown:
        raise TeachError(unused[0])
    if height > 0:
        bases = footprints([shown_example.outline for shown_example in shown], calibration, height)
        shown = [
            replace(shown_example, outline=base)
            for shown_example, base in zip(shown, bases, strict=True)
        ]
    scale = float(
        np.median(
            calibration.scale(np.array([shown_example.outline.centre for shown_example in shown]))
        )
    )
    shown = _select_agreeing(name, shown, scale, unused)
    outlines = [shown_example.outline for shown_example in shown]
    mean, pose, deviation, unlike = _mean_outline(outlines, scale)
    coloured = any(example.image.ndim == 3 for example in examples)
    part = _simplify_type(name, mean, scale, unlike)
    colour = np.mean([shown_example.colour for shown_example in shown], axis=0) * (
        1.0,
        coloured,
        coloured,
    )
    part = replace(
        part,
        colour_lab=(float(colour[0]), float(colour[1]), float(colour[2])),
        scatter_m=deviation,
        height_m=height,
        picture=drawing_file_name(name),
    )
    size = 2 * np.sqrt(np.array([o.area for o in outlines]) / np.pi)
    picture = _draw_example(part, shown[0].example, pose, calibration)
    warnings = _recognition_warnings(name, shown, colour, coloured)
    if height == 0:
        warnings += _height_warning(name, outlines, calibration, scale, unlike)
    size_m = np.array([size.mean(), size.std()])
    return Lesson(part, len(outlines), size_m, picture, tuple(unused), warnings)


def drawing_file_name(name: str) -> str:
    """Return the file name of a type's drawn picture. For a type `nut`, the name is not `nut.png`,
    because a photograph may have this name."""
    return f"{name}_taught.png"


def check_distinguishable(
    part: PartType, types: Mapping[str, PartType], calibration: Calibration
) -> None:
    """Raise an error if a type cannot be distinguished from another type.

    Raises
    ------
    TeachError
        If the types are too similar. The message contains the other type and the distance between
        the types.
    """
    scale = float(calibration.scale(np.zeros((1, 2)))[0])
    for other in types.values():
        gap = gap_between(part, other, scale)
        if other.name != part.name and gap.far < ALIKE:
            raise TeachError(f"{gap.text}; merge them, or use a camera with a higher resolution")


class Gap(NamedTuple):
    """Distance between two types.

    Attributes
    ----------
    far : float
        Total distance [standard deviations].
    size : float
        Distance in size [standard deviations].
    size_px : float
        Difference in size [px].
    text : str
        Message that the types look alike, with the distance.
    """

    far: float
    size: float
    size_px: float
    text: str


def gap_between(a: PartType, b: PartType, scale: float) -> Gap:
    """Return the distance between two types in an image with a scale [px/m]."""
    rest_px, swell_px, colour = type_differences(a, b, scale)
    reach_px = scale * max(a.reach_m, b.reach_m)
    size = swell_px / math.hypot(SIZE_PX, SIZE_REACH * reach_px)
    rest = rest_px / math.hypot(FIT_PX, FIT_REACH * reach_px)
    far = math.hypot(rest, size, colour / COLOUR_LAB)
    return Gap(
        far,
        size,
        swell_px,
        f"types {a.name} and {b.name} look alike: their outlines differ by {rest_px:.1f} px, their "
        f"sizes by {abs(swell_px):.1f} px and their colours by {colour:.0f} Lab, {far:.1f} in "
        f"total, allowed: at least {ALIKE:g}",
    )


def type_differences(a: PartType, b: PartType, scale: float) -> tuple[float, float, float]:
    """Return three differences between two types. The first difference is the RMS distance between
    the outlines after one outline has grown evenly [px at `scale` px/m]. The second difference is
    the growth of this outline [px]. The third difference is the distance between the colours in
    Lab, or 0 if a colour is unknown."""
    first, second = make_template(a), make_template(b)
    fit = fit_template(first, second.outline, scale)
    gap = 0.0
    if a.colour_lab is not None and b.colour_lab is not None:
        gap = float(colour_distance(np.array(a.colour_lab), np.array(b.colour_lab), True))
    return scale * float(fit.residual), scale * float(fit.swell), gap


def merge_types(a: PartType, b: PartType) -> PartType:
    """Return the mean of two types that are one type in reality. The mean has the name, mass and
    friction of the first type."""
    first, second = make_template(a), make_template(b)
    scale = 1 / (0.02 * a.reach_m)
    mean, _, deviation, _ = _mean_outline([first.outline, second.outline], scale)
    part = _simplify_type(a.name, mean, scale)
    colour = a.colour_lab or b.colour_lab
    if a.colour_lab is not None and b.colour_lab is not None:
        light, red, yellow = np.mean([a.colour_lab, b.colour_lab], axis=0)
        colour = (float(light), float(red), float(yellow))
    return replace(
        part,
        mass_kg=a.mass_kg,
        mu=a.mu,
        colour_lab=colour,
        symmetry=a.symmetry if a.symmetry == b.symmetry else part.symmetry,
        scatter_m=math.hypot(deviation, a.scatter_m, b.scatter_m),
        picture=a.picture,
    )


def _measure_example(
    name: str,
    example: Example,
    calibration: Calibration,
    background: Background | None,
    region: Region | None,
) -> list[_Shown]:
    """Return the parts of an example with their outlines, colours and blurs, from left to right.
    Otherwise the user cannot know which part defines the angle 0."""
    bare = model_background(example.image) if background is None else background
    patches = find_patches(example.image, bare, region)
    if example.box_px is not None:
        patches = [patch for patch in patches if _is_in_box(patch, example.box_px)]
        patches = sorted(patches, key=lambda patch: -patch.area_px2)[:1]
    kept = sorted((patch for patch in patches if patch.whole), key=lambda patch: patch.corner)
    if not kept:
        seen = "no part is visible" if not patches else "no part is completely visible"
        raise TeachError(
            f"type {name}: {example.name}: {seen}, allowed: complete parts, well apart; a picture "
            "of the bare plate (--bare) makes detection more reliable"
        )
    if any(patch.group for patch in kept):
        raise TeachError(f"type {name}: {example.name}: parts touch, allowed: parts apart")
    outlines, colours = measure_patches(example.image, kept, calibration, CONTOUR_POINTS)
    blurs = [
        _blur_px(example.image, patch) / max(BLUR_PX, BLUR_RADIUS * patch.radius_px)
        for patch in kept
    ]
    return [_Shown(example, *those) for those in zip(outlines, colours, blurs, strict=True)]


def _blur_px(image: np.ndarray, patch: Patch) -> float:
    """Return the blur of a patch's contour, which is a standard deviation [px]. The blur is the
    median of contrast / (sqrt(2 pi) slope) over the points of the contour."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    outline = patch.outline
    along = np.roll(outline, -3, axis=0) - np.roll(outline, 3, axis=0)
    across = np.column_stack([along[:, 1], -along[:, 0]])
    across /= np.maximum(np.hypot(*across.T), 1e-9)[:, None]
    steps = np.linspace(-1, 1, 13) * min(BESIDE_PX, BESIDE_RADIUS * patch.radius_px)
    where = (outline[:, None] + steps[:, None] * across[:, None]).astype(np.float32)
    x, y = cv2.split(where)
    levels = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    contrast = np.abs(levels[:, -1] - levels[:, 0])
    slope = np.abs(np.diff(levels, axis=1)).max(axis=1) / (steps[1] - steps[0])
    return float(np.median(contrast / (np.sqrt(2 * np.pi) * np.maximum(slope, 1e-9))))


def _recognition_warnings(
    name: str, shown: Sequence[_Shown], colour: np.ndarray, coloured: bool
) -> tuple[str, ...]:
    """Return warnings about reasons why a type may be difficult to recognise: blurred examples, or
    examples with different colours."""
    blurs: dict[str, float] = {}
    for shown_example in shown:
        blurs[shown_example.example.name] = max(
            shown_example.blur, blurs.get(shown_example.example.name, 0.0)
        )
    warnings = [
        f"type {name}: {picture}: blur of the contours is {blur:.1f} times the maximum, so sizes "
        "and angles are less accurate; focus the camera, and keep it and the parts at rest"
        for picture, blur in blurs.items()
        if blur > 1
    ]
    colours = np.array([shown_example.colour for shown_example in shown])
    furthest = float(colour_distance(colours, colour, coloured).max())
    if furthest > COLOUR_LAB:
        warnings.append(
            f"type {name}: distance of colours from their mean is up to {furthest:.0f} Lab, "
            f"allowed: {COLOUR_LAB:g} Lab. Many parts will be unknown; teach each colour as a "
            "separate type"
        )
    return tuple(warnings)


def _height_warning(
    name: str, outlines: Sequence[Outline], calibration: Calibration, scale: float, unlike: float
) -> tuple[str, ...]:
    """Return a warning if the outlines of a type agree much better with a height than without it.

    `unlike` is the RMS difference between the outlines if the parts are assumed to be flat and
    their sizes are made equal [m]. If parts have a height, their side faces are visible. At places
    farther from the camera, the side faces are longer, so the outlines differ."""
    if calibration.camera_position is None or unlike * scale < BETTER_PX:
        return ()
    reach = float(np.median([outline.reach for outline in outlines]))
    heights = reach * np.array(HEIGHTS)
    rest, height = min(
        (
            (_mean_outline(footprints(outlines, calibration, height), scale)[3], height)
            for height in heights[heights < HIGHEST * calibration.camera_position[2]]
        ),
        default=(math.inf, 0.0),
    )
    if unlike < BETTER * rest:
        return ()
    return (
        f"type {name}: the outlines of its examples agree best with a height of about "
        f"{1e3 * height:.0f} mm: they differ by {scale * rest:.2f} px, but by "
        f"{scale * unlike:.2f} px with height 0. If the part is not flat, teach it again with "
        "--height, or with height_m in the file of types; otherwise its positions are wrong",
    )


def _is_in_box(patch: Patch, box_px: tuple[float, float, float, float]) -> bool:
    """Whether the centre of a patch is in a box, or the patch covers the centre of the box."""
    x0, y0, x1, y1 = box_px
    x, y = patch.centre_px
    column, row = round(0.5 * (x0 + x1)) - patch.corner[0], round(0.5 * (y0 + y1)) - patch.corner[1]
    height, width = patch.mask.shape
    if 0 <= column < width and 0 <= row < height and patch.mask[row, column]:
        return True
    return bool(x0 <= x <= x1 and y0 <= y <= y1)


def _select_agreeing(
    name: str, shown: Sequence[_Shown], scale: float, unused: list[str]
) -> list[_Shown]:
    """Return the parts that agree with each other. Add the reasons why other parts are not used to
    `unused`.

    Raises
    ------
    TeachError
        If less than the fraction `MIN_ALIKE_FRACTION` of the parts agree.
    """
    # The part with the median size is the reference.
    middle = sorted(shown, key=lambda shown_example: shown_example.outline.filled.area)[
        len(shown) // 2
    ].outline
    template = _as_template(_shift_outline(middle, middle.centre))
    kept, problems = [], []
    for shown_example in shown:
        start = f"type {name}: examples differ: in {shown_example.example.name}"
        if len(shown_example.outline.rings) != len(middle.rings):
            problems.append(
                f"{start} there are {len(shown_example.outline.rings) - 1} holes, but "
                f"{len(middle.rings) - 1} in another example, allowed: the same number in all"
            )
            continue
        fit = fit_template(template, shown_example.outline, scale)
        for property_name, error, fraction in (
            ("outline", fit.residual, DIFFER),
            ("size", fit.swell, DIFFER_SIZE),
        ):
            max_error = max(fraction * middle.reach, DIFFER_PX / scale)
            if abs(error) > max_error:
                problems.append(
                    f"{start} the {property_name} differs by {scale * abs(error):.1f} px, allowed: "
                    f"{scale * max_error:.1f} px"
                )
                break
        else:
            kept.append(shown_example)
    if len(kept) < MIN_ALIKE_FRACTION * len(shown):
        raise TeachError(problems[0])
    unused += problems
    return kept


def _mean_outline(
    outlines: Sequence[Outline], scale: float
) -> tuple[Outline, np.ndarray, float, float]:
    """Return the mean of outlines, and three properties of it.

    The mean outline is rotated like the first outline. The first property is the pose (3,) [m, m,
    rad] of the mean outline in the first example. The second property is the RMS distance of the
    outlines from the mean outline [m]. The third property is the same RMS distance after the sizes
    of the outlines were made equal [m]."""
    # The first mean outline is the outline of median size. The other outlines are fitted to the
    # mean outline.
    first = int(np.argsort([outline.area for outline in outlines])[len(outlines) // 2])
    mean = _shift_outline(outlines[first], outlines[first].centre)
    deviation = unlike = 0.0
    for _ in range(2 if len(outlines) > 1 else 0):
        fits = [fit_template(_as_template(mean), outline, scale) for outline in outlines]
        deviation = math.sqrt(float(np.mean([fit.swell**2 + fit.residual**2 for fit in fits])))
        unlike = math.sqrt(float(np.mean([fit.residual**2 for fit in fits])))
        laid = [
            _transform_outline(outline, fit.pose)
            for outline, fit in zip(outlines, fits, strict=True)
        ]
        mean = _average_outlines(mean, laid)
    symmetry = _symmetry_order(mean, scale)
    if symmetry > 1:
        angles = 2 * np.pi * np.arange(symmetry) / symmetry
        mean = _average_outlines(
            mean, [_transform_outline(mean, np.array([0, 0, angle])) for angle in angles]
        )
    pose = fit_template(_as_template(mean), outlines[0], scale).pose
    # Rotate the mean outline so that it has the angle of the first outline.
    mean = _transform_outline(mean, np.array([0, 0, -pose[2]]))
    return mean, np.array([pose[0], pose[1], 0.0]), deviation, unlike


def _as_template(outline: Outline) -> Template:
    return Template(PartType("mean"), outline.edges, outline)


def _shift_outline(outline: Outline, centre: np.ndarray) -> Outline:
    return make_outline([ring - centre for ring in outline.rings])


def _transform_outline(outline: Outline, pose: np.ndarray) -> Outline:
    """Transform an outline to the frame of a pose (3,) [m, m, rad]."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    rotation = np.array([[c, -s], [s, c]])
    return make_outline([(ring - pose[:2]) @ rotation for ring in outline.rings])


def _average_outlines(mean: Outline, outlines: Sequence[Outline]) -> Outline:
    """Move the points of a mean outline to the average of outlines that are fitted to it. Return
    the new mean outline, relative to its centre."""
    shift = np.zeros_like(mean.points)
    for outline in outlines:
        distance = distances(outline.edges, mean.points)
        shift -= distance[:, :1] * distance[:, 1:]
    moved = mean.points + shift / len(outlines)
    middle = make_outline(np.split(moved, mean.ends[:-1]))
    return _shift_outline(middle, middle.centre)


def _symmetry_order(mean: Outline, scale: float) -> int:
    """Return the number of directions in which a mean outline looks the same, up to
    `MAX_SYMMETRY`."""
    edges = mean.edges
    for count in range(MAX_SYMMETRY, 1, -1):
        turned = _transform_outline(mean, np.array([0, 0, 2 * np.pi / count]))
        square = distances(edges, turned.points)[:, 0] ** 2
        rest = math.sqrt(max(float(np.mean(ring)) for ring in np.split(square, mean.ends[:-1])))
        if rest < max(TURNED * mean.reach, TURNED_PX / scale):
            return count
    return 1


def _simplify_type(name: str, mean: Outline, scale: float, unlike: float = 0.0) -> PartType:
    """Return a type whose outline is the mean outline as a polygon. The type is a disc if the
    outline is round, or if the difference between the examples (`unlike`, RMS [m]) is so large that
    no angle can be measured.

    Raises
    ------
    TeachError
        If the type would need too many corners or holes.
    """
    rings = mean.rings
    if len(rings) > MAX_HOLES + 1:
        raise TeachError(
            f"type {name}: number of holes is {len(rings) - 1}, allowed: at most {MAX_HOLES}"
        )
    outer = make_outline(rings[:1])
    radius = math.sqrt(outer.area / math.pi)
    around = np.hypot(*(outer.points - outer.centre).T)
    rough = float(np.std(around))
    data: dict[str, Any] = {"symmetry": _symmetry_order(mean, scale)}
    round_enough = max(ROUND * radius, ROUND_PX / scale, UNEVEN * unlike)
    if rough < round_enough and np.hypot(*outer.centre) < ROUND * radius:
        data = {"symmetry": 0, "radius_m": radius}
    else:
        data["outline_m"] = simplify_polygon(name, "outline", rings[0], mean.reach, scale).tolist()
    if len(rings) > 1:
        holes = [simplify_polygon(name, "hole", ring, mean.reach, scale) for ring in rings[1:]]
        data["holes_m"] = [hole.tolist() for hole in holes]
    return read_part_types(Fields({name: data}, "teach", TeachError))[name]


def _draw_example(
    part: PartType, example: Example, pose: np.ndarray, calibration: Calibration
) -> np.ndarray:
    """Return a picture (H, W, 3) of an example. The type's outline and the direction of the angle 0
    are drawn into it."""
    colour = example.image
    if colour.ndim == 2:
        colour = cv2.cvtColor(colour, cv2.COLOR_GRAY2BGR)
    place_px = calibration.to_image(pose[None, :2])[0]
    reach_px = 1.4 * part.reach_m * float(calibration.scale(pose[None, :2])[0])
    zoom = PICTURE_PX / (2 * reach_px)
    to_picture = np.array(
        [[zoom, 0, zoom * (reach_px - place_px[0])], [0, zoom, zoom * (reach_px - place_px[1])]]
    )
    size = (PICTURE_PX, PICTURE_PX)
    picture = cv2.warpAffine(colour, to_picture, size, borderMode=cv2.BORDER_REPLICATE)

    def picture_points(ring: np.ndarray) -> np.ndarray:
        points = calibration.to_image(ring + pose[:2]) @ to_picture[:, :2].T + to_picture[:, 2]
        return np.rint(16 * points).astype(np.int32)

    rings = [part.polygon, *(np.array(hole) for hole in part.holes)]
    cv2.polylines(
        picture, [picture_points(ring) for ring in rings], True, (0, 160, 255), 1, cv2.LINE_AA, 4
    )
    front = picture_points(np.array([[0, 0], [part.reach_m, 0]]))
    cv2.arrowedLine(
        picture, front[0].tolist(), front[1].tolist(), (60, 60, 230), 1, cv2.LINE_AA, 4, 0.12
    )
    return np.asarray(picture)
