"""Which type of part a patch is, where it lies and how it is turned.

A patch's outline is compared with that of every type: turns in which the spectra of both agree are
found by correlation, the type's polygon is then laid onto the outline by least squares. Types are
told apart by how far outlines remain from each other, by size and by colour. A part whose mirror
image fits better lies on its other face: that is not its type.

A nearest neighbour on Hu moments, size and colour names known parts as well and faster, but gives
no angle, and names what is of no type.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from plate_core.rig import PartType

from .. import _kernels
from ..camera.lens import Calibration
from .catalogue import Catalogue, Template, lay_on
from .heights import footprint, magnified
from .outlines import POINTS, THREE, Outline, make_outline, patch_rings
from .patch import Patch

UNKNOWN = "unknown"
"""The label of a patch that is like no type."""

GROUP = "group"
"""The label of parts that touch each other and that nothing takes apart."""

ASTRAY = 2.0
"""After two steps a fit is no further from its goal than so many times what it may be."""

FIT_PX = 0.35
"""How far outlines of one type are apart by pixels and noise, RMS [px]."""

FIT_REACH = 0.025
"""The same by the view from the side, light and make, relative to the part's reach."""

SIZE_PX = 0.6
"""How much larger or smaller a part's outline seems than it is: blur, shadow, threshold [px]."""

SIZE_REACH = 0.025
"""The same, relative to its reach."""

COLOUR_LAB = 12.0
"""How far colours of one type are apart."""

LIGHTNESS = 0.5
"""Weight of differences of lightness, which light and highlights change."""

HOLES = 0.06
"""How much of a part may seem to be a hole, or not to be one: a highlight, a dark hole."""

LIMIT = 3.0
"""Of differences, in the standard deviations above: what is further from every type is unknown."""

OTHER_SIZE, OTHER_SIZE_PX = 0.45, 1.0
"""Natural logarithm of the ratio of sizes, and difference of outlines [px], from which on a patch
is not of a type, whatever its scatter."""

UNLIKE = 0.4
"""Distance of forms, see `Outline.form`, from which on a type is not tried: parts of 20 px are up
to 0.07 from their own type, 0.14 if blurred by 1.5 px, and 0.1 (nut, washer) to 1.3 from others."""

SLACK_PX = 0.5
"""How well the difference of two areas says by how much an outline is swollen [px]."""

OTHER_FACE = 1.0
"""By how much a part's mirror image fits better, in the variance of an outline, if it lies on its
other face: of a round, ragged part either may fit a little better."""

HOPELESS = 12.0
"""A type whose size and colour alone give so much more than the best score is not tried: its
likelihood is 0.2 % of the other's."""

SIGHTING = np.dtype(
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
    ]
)
"""One part: its centre and the radius of the disc of the same area [px]; type, `UNKNOWN` or
`GROUP`; confidence, 0 to 1; centre [m] and angle [rad] in plate_home, and the standard deviation of
the angle [rad]; whether all of it is in the image; how far its outline is from the type's, RMS once
that is swollen as much as it is, and by how much that is [px]; distance of the colours."""


def is_named(seen: np.ndarray) -> np.ndarray:
    """Which (n,) of sightings (n,) `SIGHTING` are of a type."""
    return np.asarray((seen["label"] != UNKNOWN) & (seen["label"] != GROUP))


def recognise(
    image: np.ndarray,
    patches: Sequence[Patch],
    catalogue: Catalogue,
    calibration: Calibration,
) -> np.ndarray:
    """Say of patches which type of part they are.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    patches : sequence of Patch
    catalogue : Catalogue
        Of the types.
    calibration : Calibration
        Between the image and plate_home, where the types' outlines are.

    Returns
    -------
    (n,) SIGHTING
    """
    outlines, colours = measure_patches(image, patches, calibration)
    found = np.zeros(len(outlines), SIGHTING)
    if not len(outlines):
        return found
    found["whole"] = [patch.whole for patch in patches]
    found["label"] = [GROUP if patch.group else UNKNOWN for patch in patches]
    levels, which, usual = height_levels(catalogue, calibration)
    on_plate = [outlines if h == 0 else footprints(outlines, calibration, h) for h in levels]
    centre = np.array([outline.centre for outline in on_plate[usual]])
    scale = calibration.scale(centre)
    area = np.array([outline.area for outline in on_plate[usual]])
    found["x"], found["y"] = centre.T
    found["radius_px"] = np.sqrt(np.maximum(area, 0) / np.pi) * scale
    if catalogue.templates:
        reach_px, scatter_px = (np.outer(scale, x) for x in (catalogue.reach, catalogue.scatter))
        fit = FIT_PX**2 + (FIT_REACH * reach_px) ** 2 + (0.5 * scatter_px) ** 2
        size = SIZE_PX**2 + (SIZE_REACH * reach_px) ** 2 + scatter_px**2
        filled = np.array([[one.filled.area for one in own] for own in on_plate])[which].T
        swell_px = scale[:, None] * np.abs(filled - catalogue.filled_area) / catalogue.rim
        ratio = np.log(np.maximum(filled, 1e-12) / catalogue.filled_area) / 2
        other = (np.abs(ratio) > OTHER_SIZE) & (swell_px > OTHER_SIZE_PX)
        form = np.array([[one.form for one in own] for own in on_plate])[which].swapaxes(0, 1)
        other |= np.sum((form - catalogue.form) ** 2, axis=2) > UNLIKE**2
        tints = [
            colours if h == 0 else top_colours(image, own, calibration, h, colours)
            for h, own in zip(levels, on_plate, strict=True)
        ]
        tint = np.array(tints)[which].swapaxes(0, 1)
        tint = np.nan_to_num(colour_distance(tint, catalogue.colour, image.ndim == 3))
        least = (tint / COLOUR_LAB) ** 2 + np.maximum(swell_px - SLACK_PX, 0) ** 2 / size
        least[other] = np.inf
        for i in range(len(outlines)):
            seen = [own[i] for own in on_plate]
            own_outlines = [seen[level] for level in which]
            _judge_one(
                found[i], own_outlines, catalogue, scale[i], least[i], fit[i], size[i], tint[i]
            )
    fitted = np.column_stack([found["x"], found["y"]])
    found["x_px"], found["y_px"] = calibration.to_image(fitted).T
    return found


def height_levels(
    catalogue: Catalogue, calibration: Calibration
) -> tuple[list[float], np.ndarray, int]:
    """Return the different heights of types [m], which of them each type (T,) has, and which most
    of them have. All are 0 if the camera's place is not known."""
    height = catalogue.height if calibration.place is not None else np.zeros(len(catalogue.area))
    if not np.any(height):
        return [0.0], np.zeros(len(height), int), 0
    levels, which, count = np.unique(height, return_inverse=True, return_counts=True)
    return levels.tolist(), which.ravel(), int(np.argmax(count))


def footprints(
    outlines: Sequence[Outline], calibration: Calibration, height: float
) -> list[Outline]:
    """Return where parts of a height [m] touch the plate, of which all that is seen has these
    outlines; those of what is not so high as they are."""
    if calibration.place is None:
        return list(outlines)
    scale = calibration.scale(np.array([outline.centre for outline in outlines]).reshape(-1, 2))
    return [
        footprint(one, calibration.place, height, float(own)) or one
        for one, own in zip(outlines, scale, strict=True)
    ]


def top_colours(
    image: np.ndarray,
    outlines: Sequence[Outline],
    calibration: Calibration,
    height: float,
    otherwise: np.ndarray,
) -> np.ndarray:
    """Return the colours CIE L, a, b (n, 3) of the tops of parts of a height [m] with these
    outlines on the plate; `otherwise` (n, 3) where they are too small."""
    found = otherwise.copy()
    below = calibration.place[:2] if calibration.place is not None else np.zeros(2)
    factor = 1.0 if calibration.place is None else magnified(calibration.place, height)
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
    """Return the outlines of patches [m, plate_home], with `count` points around each, and their
    colours CIE L, a, b (n, 3)."""
    rings, colours = [], []
    for patch in patches:
        here, mask = patch.windowed(image.shape)
        framed = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
        found, colour = patch_rings(framed, image[here], count)
        rings.append([ring + (here[1].start, here[0].start) for ring in found])
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
    """Return CIE L, a, b (n, 3) of blue, green, red (n, 3), 0 to 255."""
    scaled = np.asarray(colour, np.float32).reshape(1, -1, 3) / 255
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_BGR2Lab)[0], dtype=float)


def colour_distance(a: np.ndarray, b: np.ndarray, coloured: bool) -> np.ndarray:
    """Return how far colours (..., 3) CIE L, a, b are apart (...): lightness counts less; it alone
    counts if the image has no colours."""
    gap = (np.asarray(a) - np.asarray(b)) * (LIGHTNESS, 1.0 if coloured else 0, coloured)
    return np.asarray(np.sqrt(np.sum(gap**2, axis=-1)))


def _judge_one(
    row: np.void,
    outlines: Sequence[Outline],
    catalogue: Catalogue,
    scale: float,
    least: np.ndarray,
    fit_square: np.ndarray,
    size_square: np.ndarray,
    tint: np.ndarray,
) -> None:
    """Fill in a sighting () SIGHTING. Of each type (T,): the outline if it is as high as that; its
    least score; variances of outline and size [px2]; how far its colour is."""
    best, second, chosen, kept = np.inf, np.inf, 0, np.empty(0)
    laid, points = catalogue.templates[0], outlines[0].points
    for j in np.argsort(least).tolist():
        most = min(LIMIT**2, best + HOPELESS)
        if least[j] > most:
            break
        template, seen, holes = catalogue.templates[j], outlines[j], 0.0
        outline = seen
        if bool(template.part.holes) != (len(outline.ends) > 1):
            holes = max(outline.hole_share, template.outline.hole_share) / HOLES
            template, seen = template.filled, outline.filled
        fit = lay_on(template, seen, scale, ASTRAY * np.sqrt(most * fit_square[j]) / scale)
        score = (
            (scale * fit[4]) ** 2 / fit_square[j]
            + (scale * fit[3]) ** 2 / size_square[j]
            + (tint[j] / COLOUR_LAB) ** 2
            + holes**2
        )
        if score < best:
            best, second, chosen, kept = score, best, j, fit
            laid, points = template, seen.points
        else:
            second = min(second, score)
    if best > LIMIT**2:
        return
    over = catalogue.templates[chosen].mirrored
    if over is not None:
        gain = kept[4] ** 2 - lay_on(over, outlines[chosen], scale)[4] ** 2
        if scale**2 * gain > OTHER_FACE * fit_square[chosen]:
            return
    note_type(
        row,
        catalogue.templates[chosen].part,
        kept,
        angle_sd(laid, points, kept, scale),
        scale,
    )
    row["fit_px"], row["swell_px"] = scale * kept[4], scale * kept[3]
    row["colour"] = tint[chosen]
    row["confidence"] = (1 - best / LIMIT**2) * (1 - np.exp(-0.5 * (second - best)))


def note_type(row: np.void, part: PartType, fit: np.ndarray, scatter: float, scale: float) -> None:
    """Write into a sighting () SIGHTING which type it is, where that was laid: `fit` (3,) x, y [m],
    angle [rad], with a standard deviation `scatter` [rad]."""
    row["label"] = part.name
    row["x"], row["y"] = fit[:2]
    row["angle"], row["angle_sd"] = wrapped(fit[2], part.symmetry), scatter
    row["radius_px"] = np.sqrt(part.area_m2 / np.pi) * scale


def angle_sd(
    template: Template, points: np.ndarray, fit: np.ndarray, scale: float, gate: float = np.inf
) -> float:
    """Return the standard deviation [rad] of the angle of a type that was laid onto points (n, 2):
    at most that of an angle of which nothing is known.

    It follows from how much worse the type lies on them when it is turned by a pixel. If they show
    less of a turn than its own rim does, corners are blurred or hidden, and noise looks like them.
    """
    period = 2 * np.pi / max(template.part.symmetry, 1)
    most = period / np.sqrt(12)
    if template.part.symmetry == 0:
        return float(most)
    scatter = _kernels.turn_scatter(template.edges, points, fit, template.lever2, 1 / scale, gate)
    return float(min(scatter, most))


def wrapped(angle: float, symmetry: int) -> float:
    """Return an angle [rad] of a part that looks the same in so many directions: from 0 to the
    angle between two of these, 0 for a disc; of a part without symmetry from -pi to pi."""
    if symmetry == 0:
        return 0.0
    if symmetry == 1:
        return float(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
    return float(np.remainder(angle, 2 * np.pi / symmetry))
