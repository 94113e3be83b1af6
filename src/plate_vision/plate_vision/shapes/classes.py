"""The type, position and angle of each patch.

The outline of a patch is compared with the outline of every type. Candidate angles are determined
by the correlation of the two spectra. Then the type's polygon is fitted to the outline by least
squares. The score of a type is a sum of four squares: the residual distance of the outlines, and
the differences in size, colour and holes, each in standard deviations. If the mirror image of a
type fits better, the part is turned over and does not count as this type.

A nearest-neighbour search on Hu moments, size and colour would be faster and would recognise known
parts equally well. But such a search does not determine the angle, and it also assigns types to
unknown objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from plate_core import GROUP, UNKNOWN
from plate_core.rig import PartType, to_home

from .. import _kernels
from ..camera.lens import Calibration
from .background import Background
from .catalogue import Catalogue, Template, fit_template
from .heights import apparent_shift, footprint, magnification
from .holes import HoleCheck
from .outlines import POINTS, THREE, Outline, PoseFit, make_outline, patch_rings
from .patch import Patch
from .shadows import MIN_PX, Lamp

ASTRAY = 2.0
"""Maximum distance between the outlines of a patch and a type after two steps of the fit, relative
to the maximum distance at the end of the fit [-]. If the distance exceeds this maximum, the fit of
the type is stopped."""

FIT_PX = 0.35
"""RMS (root mean square) distance between outlines of one type that pixels and noise cause [px]."""

FIT_REACH = 0.025
"""RMS distance between outlines of one type that perspective, light and manufacture cause, relative
to the part's reach (largest radius) [-]."""

SIZE_PX = 0.6
"""Standard deviation of the apparent size of an outline [px]. Blur, shadows and the threshold cause
this deviation."""

SIZE_REACH = 0.025
"""Further standard deviation of the apparent size of an outline, relative to the part's reach
(largest radius) [-]."""

COLOUR_LAB = 12.0
"""Standard deviation of the colours of one type [Lab]."""

LIGHTNESS = 0.5
"""Weight of differences in lightness. The weight is below 1, because lightness depends on the light
and on highlights."""

HOLES = 0.06
"""Standard deviation of the fraction of a part's area that its outline shows as holes [-]. The
standard deviation is large because highlights may look like holes, and dark holes may look like the
part."""

LIMIT = 3.0
"""Maximum difference between a patch and its type, in standard deviations of parts of one type. If
the difference to every type exceeds this maximum, the patch is unknown."""

OTHER_SIZE = 0.45
"""Maximum natural logarithm of the ratio between the sizes of a patch and its type. Unlike `LIMIT`,
this maximum does not depend on the differences between parts of the type."""

OTHER_SIZE_PX = 1.0
"""Minimum distance between the outlines of a patch and a type that is caused by their different
sizes [px]. Below this distance, `OTHER_SIZE` is not applied."""

UNLIKE = 0.4
"""Maximum distance between the forms (see `Outline.form`) of a patch and a type that is tried. For
parts of 20 px, the distance to the correct type is up to 0.07, or 0.14 with a blur of 1.5 px. The
distance to other types is 0.1 (nut and washer) to 1.3."""

SLACK_PX = 0.5
"""Error of the growth of an outline that is estimated from the difference of two areas [px]."""

OTHER_FACE = 1.0
"""Minimum reduction of the squared distance of the outlines if the type is replaced by its mirror
image, in variances of an outline. With this reduction, the part counts as turned over. The minimum
is above 0 because for a round part with an irregular edge, either face may fit slightly better."""

HOPELESS = 12.0
"""Maximum difference between a type's minimum score, which is computed only from size and colour,
and the best score so far. If the difference exceeds this maximum, the type is not tried, because
its likelihood is less than 0.3 % of the likelihood of the best type."""

FILLED_COLOUR = 0.5
"""Weight of the colour of a part whose hole is visible in the image, but missing in its outline
[-]."""

CLEAN = 1.5
"""Maximum score of a type with holes that fits well. If the score of a type exceeds this maximum,
the type is also tried without its holes."""

OUTLINE_ERROR, USUAL_FIT_PX = 0.3, 0.15
"""Constants of the position error that occurs if an outline differs from its type's outline. The
error is `OUTLINE_ERROR` times the excess of the RMS distance between the two outlines over
`USUAL_FIT_PX` [px]. `USUAL_FIT_PX` is this distance for flat parts in a sharp image with even
light."""

SWELL_ERROR, USUAL_SWELL_PX = 0.5, 0.2
"""Constants of the position error that occurs if an outline has grown. The error is `SWELL_ERROR`
times the excess of the growth over the typical growth `USUAL_SWELL_PX` [px]. A cause that acts on
one side only, such as an unknown height, shifts the outline."""

HEIGHT_ERROR_PX = 0.1
"""Standard deviation of a position on the plate along each axis after the correction for height
[px]. The error occurs because side faces are darker or brighter than the top."""

MIN_NAMED = 3
"""Minimum number of parts with a type from which the shadow length and the growth are measured."""

MIN_SWELL_PX, MAX_SWELL_PX = 0.3, 1.5
"""Range of the median growth of outlines that is corrected [px]."""

DETECTED_OBJECT = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("label", "U32"),
        ("confidence", "f8"),
        ("x", "f8"),
        ("y", "f8"),
        ("angle", "f8"),
        ("angle_sd", "f8"),
        ("whole", "?"),
        ("fit_px", "f8"),
        ("swell_px", "f8"),
        ("colour", "f8"),
        ("place_sd", "f8"),
        ("blurred", "?"),
    ]
)
"""One detected object in an image, with these fields:

`x_px`, `y_px`: centre [px].
`radius_px`: radius of the disc of the same area [px].
`label`: type of the part, `UNKNOWN` or `GROUP`.
`confidence`: confidence in the type, 0 to 1.
`x`, `y`: centre [m, plate_home].
`angle`: angle [rad, plate_home].
`angle_sd`: standard deviation of the angle [rad].
`whole`: whether the part is completely in the image.
`fit_px`: RMS distance between the part's outline and the grown outline of its type [px].
`swell_px`: growth of the outline [px].
`colour`: distance between the colours of the part and its type.
`place_sd`: standard deviation of the position along each axis [m].
`blurred`: whether the type is unknown because the image is blurred.
"""


def is_named(seen: np.ndarray) -> np.ndarray:
    """Return which detections (n,) `DETECTED_OBJECT` have a type, (n,) bool."""
    return np.asarray((seen["label"] != UNKNOWN) & (seen["label"] != GROUP))


@dataclass(frozen=True, eq=False)
class Conditions:
    """Imaging conditions of the parts in an image.

    Attributes
    ----------
    lamp : Lamp, optional
        The lamp that casts all shadows. If a lamp is given, patches include the shadows (see
        `segment`).
    background : Background, optional
        The bare plate. If a type has a hole that is missing in an outline, the image in this hole
        is compared with the bare plate.
    swell_px : float
        Distance by which outlines are larger than the parts [px], because of blur, soft shadows or
        light.
    final : bool
        Whether lamp and growth were measured with parts of known types.
    """

    lamp: Lamp | None = None
    background: Background | None = None
    swell_px: float = 0.0
    final: bool = False


def recognise(
    image: np.ndarray,
    patches: Sequence[Patch],
    catalogue: Catalogue,
    calibration: Calibration,
    conditions: Conditions | None = None,
) -> np.ndarray:
    """Return the type, position and angle of each patch.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    patches : sequence of Patch
    catalogue : Catalogue
        The types.
    calibration : Calibration
        Transformation between the image and plate_home.
    conditions : Conditions, optional
        Imaging conditions; None: unknown.

    Returns
    -------
    (n,) DETECTED_OBJECT
    """
    return recognise_in_conditions(
        image, patches, catalogue, calibration, conditions or Conditions()
    )[0]


def recognise_in_conditions(
    image: np.ndarray,
    patches: Sequence[Patch],
    catalogue: Catalogue,
    calibration: Calibration,
    conditions: Conditions,
) -> tuple[np.ndarray, Conditions]:
    """Recognise parts as `recognise` does. Return the parts, and the imaging conditions measured
    with these parts.

    All patches are compared a second time if the measured conditions differ from the given ones.
    The conditions differ if the outlines differ from their types in size, or if the length of the
    shadows was measured with the types.
    """
    outlines, colours = measure_patches(image, patches, calibration)
    found = _classify_patches(image, patches, outlines, colours, catalogue, calibration, conditions)
    if conditions.final or not len(found):
        return found, conditions
    final = _measure_conditions(conditions, found, outlines, catalogue, calibration)
    if final.lamp is not conditions.lamp or final.swell_px:
        found = _classify_patches(image, patches, outlines, colours, catalogue, calibration, final)
    return found, final


def _classify_patches(
    image: np.ndarray,
    patches: Sequence[Patch],
    outlines: list[Outline],
    colours: np.ndarray,
    catalogue: Catalogue,
    calibration: Calibration,
    conditions: Conditions,
) -> np.ndarray:
    """Return the detections (n,) DETECTED_OBJECT for patches with these outlines and colours (n,
    3)."""
    lamp, background, swell = conditions.lamp, conditions.background, conditions.swell_px
    found = np.zeros(len(outlines), DETECTED_OBJECT)
    if not len(outlines):
        return found
    found["whole"] = [patch.whole for patch in patches]
    found["label"] = [GROUP if patch.group else UNKNOWN for patch in patches]
    levels, height_index, usual = height_levels(catalogue, calibration)
    on_plate = [footprints(outlines, calibration, h, lamp) for h in levels]
    centre = np.array([outline.centre for outline in on_plate[usual]])
    scale = calibration.scale(centre)
    area = np.array([outline.area for outline in on_plate[usual]])
    found["x"], found["y"] = centre.T
    found["radius_px"] = np.sqrt(np.maximum(area, 0) / np.pi) * scale
    hole_check = None
    if background is not None and background.learned:
        hole_check = HoleCheck(image, background, calibration)
    if catalogue.templates:
        reach_px, outline_rms_px = (
            np.outer(scale, x) for x in (catalogue.reach, catalogue.outline_rms)
        )
        fit = FIT_PX**2 + (FIT_REACH * reach_px) ** 2 + (0.5 * outline_rms_px) ** 2
        size = SIZE_PX**2 + (SIZE_REACH * reach_px) ** 2 + outline_rms_px**2
        filled = np.array([[item.filled.area for item in of_patches] for of_patches in on_plate])[
            height_index
        ].T
        own_area = catalogue.filled_area + swell / scale[:, None] * catalogue.perimeter
        swell_px = scale[:, None] * np.abs(filled - own_area) / catalogue.perimeter
        ratio = np.log(np.maximum(filled, 1e-12) / own_area) / 2
        other = (np.abs(ratio) > OTHER_SIZE) & (swell_px > OTHER_SIZE_PX)
        form = np.array([[item.form for item in of_patches] for of_patches in on_plate])[
            height_index
        ].swapaxes(0, 1)
        other |= np.sum((form - catalogue.form) ** 2, axis=2) > UNLIKE**2
        tints = [
            colours
            if h == 0 and lamp is None
            else top_colours(image, of_patches, calibration, h, colours)
            for h, of_patches in zip(levels, on_plate, strict=True)
        ]
        tint = np.array(tints)[height_index].swapaxes(0, 1)
        tint = np.nan_to_num(colour_distance(tint, catalogue.colour, image.ndim == 3))
        # Blur or a shadow can fill a hole. In such an image, the measured colour of the part
        # includes the colour in the hole. Therefore the colour has less weight.
        holed = np.array([bool(item.part.holes) for item in catalogue.templates])
        weight = np.where(holed & (hole_check is not None), FILLED_COLOUR, 1.0)
        min_score = (weight * tint / COLOUR_LAB) ** 2 + np.maximum(
            swell_px - SLACK_PX, 0
        ) ** 2 / size
        min_score[other] = np.inf
        for i in range(len(outlines)):
            seen = [of_patches[i] for of_patches in on_plate]
            own_outlines = [seen[level] for level in height_index]
            _classify_patch(
                found[i], own_outlines, catalogue, scale[i], min_score[i], fit[i], size[i], tint[i],
                hole_check, swell,
            )  # fmt: skip
    has_height = len(levels) > 1 or levels[0] > 0
    found["place_sd"] = _position_errors_px(found, conditions, has_height) / scale
    fitted = np.column_stack([found["x"], found["y"]])
    found["x_px"], found["y_px"] = calibration.to_image(fitted).T
    return found


def _position_errors_px(found: np.ndarray, conditions: Conditions, has_height: bool) -> np.ndarray:
    """Return the standard deviations (n,) [px] of the positions of detections (n,)
    DETECTED_OBJECT."""
    error_px = np.hypot(
        OUTLINE_ERROR * np.maximum(found["fit_px"] - USUAL_FIT_PX, 0),
        SWELL_ERROR * np.maximum(np.abs(found["swell_px"]) - USUAL_SWELL_PX, 0),
    )
    if conditions.lamp is not None:
        # Errors of the shadow's length and edge cause a position error that is half as large.
        swell_px = max(conditions.swell_px, MIN_SWELL_PX)
        shadow_px = np.hypot(conditions.lamp.length_sd_px, swell_px)
        error_px = np.hypot(error_px, 0.5 * shadow_px)
    return np.hypot(error_px, HEIGHT_ERROR_PX) if has_height else error_px


def height_levels(
    catalogue: Catalogue, calibration: Calibration
) -> tuple[list[float], np.ndarray, int]:
    """Return the distinct heights of types [m], the index of each type's height (T,), and the index
    of the most frequent height. All heights are 0 if the camera's place is unknown."""
    known = calibration.camera_position is not None
    height = catalogue.height if known else np.zeros(len(catalogue.area))
    if not np.any(height):
        return [0.0], np.zeros(len(height), int), 0
    levels, level_index, count = np.unique(height, return_inverse=True, return_counts=True)
    return levels.tolist(), level_index.ravel(), int(np.argmax(count))


def footprints(
    outlines: Sequence[Outline], calibration: Calibration, height: float, lamp: Lamp | None = None
) -> list[Outline]:
    """Return the footprints of parts with a height [m]. The given outlines enclose the tops, the
    visible side faces, and the shadows from a lamp. If an object is lower than this height, its
    outline is returned unchanged."""
    if height == 0 and lamp is None:
        return list(outlines)
    centre = np.array([outline.centre for outline in outlines]).reshape(-1, 2)
    scale = calibration.scale(centre)
    shadows: list[np.ndarray | None] = [None] * len(outlines)
    if lamp is not None:
        ends = calibration.to_home(calibration.to_image(centre) + lamp.shift_px)
        shadows = list(ends - centre)
    return [
        footprint(visible, calibration.camera_position, height, float(part_scale), shadow)
        or visible
        for visible, part_scale, shadow in zip(outlines, scale, shadows, strict=True)
    ]


def top_colours(
    image: np.ndarray,
    outlines: Sequence[Outline],
    calibration: Calibration,
    height: float,
    otherwise: np.ndarray,
) -> np.ndarray:
    """Return the colours CIE L, a, b (n, 3) of the tops of parts with these footprints and this
    height [m]. If a top is too small to measure its colour, return the colour of `otherwise` (n, 3)
    instead."""
    found = otherwise.copy()
    camera = calibration.camera_position
    below = np.zeros(2) if camera is None else camera[:2]
    factor = 1.0 if camera is None else magnification(camera, height)
    for i, outline in enumerate(outlines):
        rings = [calibration.to_image(below + (ring - below) * factor) for ring in outline.rings]
        low = np.maximum(np.floor(rings[0].min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(rings[0].max(axis=0)).astype(int) + 1, image.shape[1::-1])
        if np.any(high <= low):
            continue
        mask = np.zeros((high - low)[::-1], np.uint8)
        for number, ring in enumerate(rings):
            cv2.fillPoly(mask, [np.rint(16 * (ring - low)).astype(np.int32)], not number, shift=4)
        pixels = image[low[1] : high[1], low[0] : high[0]][cv2.erode(mask, THREE) > 0]
        if len(pixels) > 8:
            found[i] = to_lab(np.broadcast_to(np.median(pixels, axis=0), (1, 3)))[0]
    return found


def measure_patches(
    image: np.ndarray,
    patches: Sequence[Patch],
    calibration: Calibration,
    count: int = POINTS,
) -> tuple[list[Outline], np.ndarray]:
    """Return the outlines of patches [m, plate_home], each with `count` points around it, and the
    colours of the patches, CIE L, a, b (n, 3)."""
    rings, colours = [], []
    for patch in patches:
        window, mask = patch.windowed(image.shape)
        framed = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
        found, colour = patch_rings(framed, image[window], count)
        rings.append([ring + (window[1].start, window[0].start) for ring in found])
        colours.append(colour)
    if not rings:
        return [], np.empty((0, 3))
    flat = [ring for found in rings for ring in found]
    home = np.split(
        calibration.to_home(np.concatenate(flat)), np.cumsum([len(ring) for ring in flat])[:-1]
    )
    mapped = iter(home)
    outlines = [make_outline([next(mapped) for _ in found]) for found in rings]
    return outlines, to_lab(np.array(colours))


def to_lab(colour: np.ndarray) -> np.ndarray:
    """Convert colours from blue, green, red (n, 3), 0 to 255, to CIE L, a, b (n, 3)."""
    scaled = np.asarray(colour, np.float32).reshape(1, -1, 3) / 255
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_BGR2Lab)[0], dtype=float)


def colour_distance(a: np.ndarray, b: np.ndarray, coloured: bool) -> np.ndarray:
    """Return the distances (...) between colours (..., 3) CIE L, a, b. Lightness has less weight
    than a and b. In an image without colours, only the lightness is compared."""
    gap = (np.asarray(a) - np.asarray(b)) * (LIGHTNESS, 1.0 if coloured else 0, coloured)
    return np.asarray(np.sqrt(np.sum(gap**2, axis=-1)))


def _classify_patch(
    row: np.void,
    outlines: Sequence[Outline],
    catalogue: Catalogue,
    scale: float,
    min_score: np.ndarray,
    fit_square: np.ndarray,
    size_square: np.ndarray,
    tint: np.ndarray,
    hole_check: HoleCheck | None,
    swell: float,
) -> None:
    """Find the type of one patch, and write it to its record `row` () DETECTED_OBJECT.

    Each of the following arguments contains one value per type (T,). `outlines` are the patch's
    outlines for the types' heights. `min_score` are the minimum scores. `fit_square` and
    `size_square` are the variances of the outline and of the size [px2]. `tint` are the distances
    of the colours. `swell` is the growth of all outlines [px]."""
    best_score, second_score = np.inf, np.inf
    best_type, best_fit = -1, PoseFit(np.empty(0), np.inf, np.inf)
    best_template, best_points = catalogue.templates[0], outlines[0].points
    for j in np.argsort(min_score).tolist():
        max_score = min(LIMIT**2, best_score + HOPELESS)
        if min_score[j] > max_score:
            break
        outline = outlines[j]
        for template, seen, holes in _hole_combinations(
            catalogue.templates[j], outline, hole_check
        ):
            hopeless = ASTRAY * np.sqrt(max_score * fit_square[j]) / scale
            fit = fit_template(template, seen, scale, hopeless)
            score = (scale * fit.residual) ** 2 / fit_square[j] + (
                scale * fit.swell - swell
            ) ** 2 / size_square[j]
            weight = 1.0
            if holes is None:
                hole_fraction = max(
                    outline.hole_fraction, catalogue.templates[j].outline.hole_fraction
                )
                holes = hole_fraction / HOLES
                if hole_check is not None and score < min(LIMIT**2, best_score):
                    penalty = hole_check.penalty(catalogue.templates[j], fit.pose)
                    if penalty is not None:
                        holes, weight = min(penalty, holes), FILLED_COLOUR
            score += (weight * tint[j] / COLOUR_LAB) ** 2 + holes**2
            if score < best_score:
                if best_type != j:
                    second_score = best_score
                best_score, best_type, best_fit = score, j, fit
                best_template, best_points = template, seen.points
            elif best_type != j:
                second_score = min(second_score, score)
            if score < CLEAN:
                break
    if best_score > LIMIT**2:
        return
    over = catalogue.templates[best_type].mirrored
    if over is not None:
        gain = best_fit.residual**2 - fit_template(over, outlines[best_type], scale).residual ** 2
        if scale**2 * gain > OTHER_FACE * fit_square[best_type]:
            return
    write_type(
        row,
        catalogue.templates[best_type].part,
        best_fit.pose,
        angle_sd(best_template, best_points, best_fit, scale),
        scale,
    )
    row["fit_px"], row["swell_px"] = scale * best_fit.residual, scale * best_fit.swell
    row["colour"] = tint[best_type]
    row["confidence"] = (1 - best_score / LIMIT**2) * (
        1 - np.exp(-0.5 * (second_score - best_score))
    )


def _hole_combinations(
    template: Template, outline: Outline, hole_check: HoleCheck | None
) -> list[tuple[Template, Outline, float | None]]:
    """Return the combinations of a type and an outline that `_classify_patch` fits. Each
    combination consists of a template, an outline, and the penalty for the holes in standard
    deviations. The penalty is None if it depends on the image in the holes."""
    has_holes, seen = bool(template.part.holes), len(outline.ends) > 1
    plain = template, outline, 0.0
    filled = template.filled, outline.filled, None
    if has_holes and seen and hole_check is not None:
        # If half of a hole is in shadow, the outline contains only a part of the hole. Therefore
        # the type is fitted both with and without its holes.
        return [plain, filled]
    return [plain] if has_holes == seen else [filled]


def _measure_conditions(
    conditions: Conditions,
    found: np.ndarray,
    outlines: Sequence[Outline],
    catalogue: Catalogue,
    calibration: Calibration,
) -> Conditions:
    """Return the conditions, measured with those detections (n,) DETECTED_OBJECT that have a
    type."""
    named = np.flatnonzero(is_named(found) & found["whole"])
    if len(named) < MIN_NAMED:
        return replace(conditions, final=True)
    swell = float(np.median(found["swell_px"][named]))
    if abs(swell) < MIN_SWELL_PX:
        swell = 0.0
    lamp = conditions.lamp
    if lamp is not None:
        lamp = _measure_lamp(lamp, found, named, outlines, catalogue, calibration)
    return replace(
        conditions, lamp=lamp, final=True, swell_px=min(max(swell, -MAX_SWELL_PX), MAX_SWELL_PX)
    )


def _measure_lamp(
    lamp: Lamp,
    found: np.ndarray,
    named: np.ndarray,
    outlines: Sequence[Outline],
    catalogue: Catalogue,
    calibration: Calibration,
) -> Lamp:
    """Return the lamp with the measured length of the shadows. The outline of a part includes the
    shadow. The length of the shadow is the distance by which this outline extends beyond the part,
    whose size is known.

    `named` (m,) are the indices of the detections `found` (n,) DETECTED_OBJECT that have a type.
    Blur enlarges outlines on all sides. The growth by blur is measured across the shadows and
    subtracted.
    """
    numbers = {template.part.name: j for j, template in enumerate(catalogue.templates)}
    centre = np.column_stack([found["x"], found["y"]])[named]
    scale = calibration.scale(centre)
    shift = calibration.to_home(calibration.to_image(centre) + lamp.shift_px) - centre
    lengths = []
    for i, shadow in zip(named.tolist(), shift, strict=True):
        u = shadow / np.hypot(*shadow)
        axes = np.array([[u[0], -u[1]], [u[1], u[0]]])
        part = catalogue.templates[numbers[found["label"][i]]].part
        base = to_home(np.array([found["x"][i], found["y"][i], found["angle"][i]]), part.polygon)
        top = base
        if calibration.camera_position is not None:
            top = base + apparent_shift(calibration.camera_position, base, part.height_m)
        seen, body = np.ptp(outlines[i].rings[0] @ axes, axis=0), np.vstack([base, top]) @ axes
        swell = seen[1] - np.ptp(body[:, 1])
        end = np.min(body[:, 0]) + seen[0] - swell
        if end > np.max(body[:, 0]):  # a shadow that ends within the part is not visible
            lengths.append(end - np.max((base @ axes)[:, 0]))
    if len(lengths) < MIN_NAMED:
        return lamp
    length_px = np.array(lengths) * float(np.median(scale))
    usual = max(float(np.median(length_px)), MIN_PX)
    spread = float(np.median(np.abs(length_px - usual)))
    unit = lamp.shift_px / np.hypot(*lamp.shift_px)
    return replace(lamp, shift_px=usual * unit, length_sd_px=1.5 * spread)


def write_type(
    row: np.void, part: PartType, pose: np.ndarray, deviation: float, scale: float
) -> None:
    """Write a type to the record `row` () DETECTED_OBJECT. `pose` (3,) is the part's x, y [m] and
    angle [rad], and `deviation` is the standard deviation of the angle [rad]."""
    row["label"] = part.name
    row["x"], row["y"] = pose[:2]
    row["angle"], row["angle_sd"] = wrap_angle(pose[2], part.symmetry), deviation
    row["radius_px"] = np.sqrt(part.area_m2 / np.pi) * scale


def angle_sd(
    template: Template, points: np.ndarray, fit: PoseFit, scale: float, gate: float = np.inf
) -> float:
    """Return the standard deviation [rad] of the angle of a type that is fitted to points (n, 2).
    The result is at most the standard deviation of an unknown angle.

    The standard deviation is computed from the increase of the squared distances when the type is
    rotated by about a pixel. If this increase is smaller than for the type's own contour, the
    corners are blurred or hidden, and noise may look like corners. The standard deviation is then
    increased.
    """
    period = 2 * np.pi / max(template.part.symmetry, 1)
    max_sd = period / np.sqrt(12)
    if template.part.symmetry == 0:
        return float(max_sd)
    pose = np.append(fit.pose, fit.swell)
    sd = _kernels.turn_scatter(template.edges, points, pose, template.lever2, 1 / scale, gate)
    return float(min(sd, max_sd))


def wrap_angle(angle: float, symmetry: int) -> float:
    """Return an angle [rad] in the range of a part that looks the same in `symmetry` directions.
    The range is 0 to 2 pi / symmetry, or -pi to pi without symmetry (1). For a disc (0), the angle
    is 0."""
    if symmetry == 0:
        return 0.0
    if symmetry == 1:
        return float(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
    return float(np.remainder(angle, 2 * np.pi / symmetry))
