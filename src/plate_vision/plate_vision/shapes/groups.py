"""Separation of touching parts of taught types.

Each type is placed at all positions and angles in a group. The whole part must be inside the group,
and a large fraction of its contour must coincide with the group's contour or with edges of colour.
The best part is removed, and the search is repeated until nothing is left. If the removed parts do
not cover the group, the next best parts are tried. If no set of parts covers the group, only the
parts that are certain are removed, and the rest remains a group.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.sparse.csgraph import connected_components

from plate_core.rig import to_home

from .. import _kernels
from ..camera.lens import Calibration
from .background import steepness
from .catalogue import Catalogue, Template
from .classes import (
    COLOUR_LAB,
    DETECTED_OBJECT,
    GROUP,
    LIMIT,
    UNKNOWN,
    Conditions,
    angle_sd,
    colour_distance,
    footprints,
    height_levels,
    is_named,
    measure_patches,
    recognise,
    to_lab,
    write_type,
)
from .grouping import Work
from .heights import apparent_shift
from .outlines import Outline, PoseFit, fit_pose
from .patch import Patch
from .shadows import Lamp

NEAR_PX: float = _kernels.NEAR_PX
"""Maximum distance of a part's contour point from the group's contour at which the point counts as
on this contour [px]."""

OUTSIDE_PX: float = _kernels.OUTSIDE_PX
"""Maximum distance of a part's point from the group [px]. Points below this distance count as
inside the group."""

MAX_OUTSIDE: float = _kernels.MAX_OUTSIDE
"""Maximum fraction of a part that is outside the group."""

CONTOUR_POINTS = 200
"""Number of points on the contour of a group."""

ENOUGH_PX = 10.0
"""Approximate reach of the smallest type in a reduced image [px]. If the smallest type has a larger
reach in the image, the image is reduced before parts are searched."""

TOUCH_PX = 2
"""Maximum distance between patches that may belong to one part, or to one group [px]."""

CONTOUR_STEP_PX = 2.0
"""Displacement of a part's contour between two successive angles that are tried [px]."""

STRIDE = 0.15
"""Step between positions that are tried, relative to the part's reach (largest radius) [-]."""

SEEN = 0.3
"""Minimum fraction of a part's contour that coincides with the group's contour."""

CHOICES = 8
"""Maximum number of positions that are kept for each type. The best positions that are far enough
from each other are kept."""

FIRST, TRIES = 3, 30
"""`FIRST`: maximum number of candidates for each part of a group. `TRIES`: maximum number of
combinations of parts that are tried for a group."""

MAX_PARTS = 12
"""Maximum number of parts in a group."""

MAX_TRIES = 200
"""Maximum number of combinations that are tried in all groups of an image together. The number is
limited because a heap may consist of dozens of groups."""

COVERED = 0.88
"""Minimum area that is covered by both the parts and the group, relative to the area that is
covered by either of them. With this ratio, the parts cover the group."""

SURE = 0.8
"""Minimum fraction of a part's contour that coincides with the group's contour. With this fraction,
the part is certain."""

TWO = 1.6
"""Minimum area of a group, relative to the area of the smallest type. Two blurred parts that touch
have at least this area."""

LARGER = 1.1
"""Maximum area of a single part of a type, relative to the area of the largest type."""

MIN_REST = 0.4
"""Minimum area of the rest of a group that may be a part, relative to the area of the smallest
type."""

EDGE_STEP = 5.0
"""Minimum gradient of an edge of colour inside a group [grey levels/px]."""

EDGE_DEPTH_PX = 3.0
"""Minimum distance of an edge of colour inside a group from the group's contour [px]."""

STEPS = 8
"""Number of Gauss-Newton steps for each part."""


@dataclass(frozen=True, eq=False)
class DetectedPart:
    """A part that was found in a group.

    Attributes
    ----------
    template : Template
        Type of the part.
    pose : (3,)
        x, y [m], angle [rad].
    seen : float
        Fraction of the part's contour that coincides with the group's contour, 0 to 1.
    tint : float
        Distance of the part's colour from the type's colour [Lab].
    """

    template: Template
    pose: np.ndarray
    seen: float
    tint: float


@dataclass(frozen=True, eq=False)
class View:
    """A group in its window of the image.

    Attributes
    ----------
    mask : (h, w) uint8
    pixels : (h, w, 3) or (h, w) uint8
        The image in the window.
    to_px : (2, 3)
        Affine transformation from plate_home [m] to the window [px].
    scale : float
        Scale of the window [px/m].
    outline : Outline
        Outline of the group [m].
    """

    mask: np.ndarray
    pixels: np.ndarray
    to_px: np.ndarray
    scale: float
    outline: Outline

    def seen(self, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the places (n, 2) [px, window] of the points (n, 2) [m] of a part at a pose
        (3,)."""
        return to_home(pose, points) @ self.to_px[:, :2].T + self.to_px[:, 2]

    def drawn(self, part: DetectedPart) -> np.ndarray:
        """Return the mask (h, w) uint8 of a part."""
        image = np.zeros(self.mask.shape, np.uint8)
        kind = part.template.part
        for level, ring in [(1, kind.polygon), *((0, np.array(hole)) for hole in kind.holes)]:
            points = self.seen(part.pose, ring)
            cv2.fillPoly(image, [np.rint(16 * points).astype(np.int32)], level, shift=4)
        return image

    def fitted(self, template: Template, pose: np.ndarray) -> np.ndarray:
        """Fit a part to the nearby points of the group's contour. Return its pose (3,)."""
        fit = fit_pose(
            template.edges,
            self.outline.points,
            pose,
            1 / self.scale,
            template.part.symmetry != 0,
            STEPS,
            gate=2 * NEAR_PX / self.scale,
        )
        return fit.pose


def explain_groups(
    image: np.ndarray,
    patches: Sequence[Patch],
    seen: np.ndarray,
    catalogue: Catalogue,
    calibration: Calibration,
    conditions: Conditions | None = None,
) -> np.ndarray:
    """Replace groups, and patches without a type, by the parts of taught types that were found in
    these patches. Return the new detections (n,) DETECTED_OBJECT.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
    patches : sequence of Patch
    seen : (m,) DETECTED_OBJECT
        The detection of each patch.
    catalogue, calibration, conditions
        As in `recognise`.
    """
    # Patches at the image border are not changed, because they may be incomplete or may show the
    # plate's edge.
    explained = is_named(seen) | ~seen["whole"]
    if explained.all() or not catalogue.templates:
        return seen
    kept, added = np.ones(len(seen), bool), []
    min_area = np.min(catalogue.area)
    area = np.pi * (seen["radius_px"] / calibration.scale(_positions(seen))) ** 2
    tries = Work(MAX_TRIES)
    clusters = _find_clusters(patches, explained, image.shape[:2])
    for members in sorted(clusters, key=lambda recognised: float(np.sum(area[recognised]))):
        if np.sum(area[members]) < TWO * min_area or not tries.left:
            continue
        unexplained = members[~explained[members]]
        for chosen in (members, unexplained) if len(unexplained) < len(members) else (members,):
            union = _merge_patches([patches[i] for i in chosen])
            recognised = recognise(image, [union], catalogue, calibration, conditions)
            if len(chosen) > 1 and recognised["label"][0] != GROUP:
                parts = recognised
            else:
                parts = _explain_group(
                    image, union, recognised, catalogue, calibration, tries, conditions
                )
            if len(parts):
                kept[chosen] = False
                added.append(parts)
                break
    return np.concatenate([seen[kept], *added])


def _positions(seen: np.ndarray) -> np.ndarray:
    return np.column_stack([seen["x"], seen["y"]])


def _find_clusters(
    patches: Sequence[Patch], explained: np.ndarray, shape: tuple[int, int]
) -> list[np.ndarray]:
    """Return the indices of the patches in each cluster. A cluster consists of patches that touch
    each other and are not explained, and of the patches next to them. The array `explained` (n,)
    states whether a patch has a type or is cut by the image's border."""
    owner = np.full(shape, -1, np.int32)
    for i, patch in enumerate(patches):
        owner[patch.window][patch.mask] = i
    touching = np.eye(len(patches), dtype=bool)
    free = np.flatnonzero(~explained)
    element = np.ones((2 * TOUCH_PX + 1,) * 2, np.uint8)
    for index in free.tolist():
        window = owner[patches[index].window_with_margin(TOUCH_PX, shape)]
        near = window[cv2.dilate((window == index).astype(np.uint8), element) > 0]
        touching[index, near[near >= 0]] = True
    _, cluster = connected_components(touching[np.ix_(free, free)])
    return [
        np.flatnonzero(np.any(touching[free[cluster == number]], axis=0))
        for number in dict.fromkeys(cluster.tolist())
    ]


def _merge_patches(patches: Sequence[Patch]) -> Patch:
    """Return several patches as one patch. The gaps between the patches are closed."""
    low = np.min([patch.corner for patch in patches], axis=0)
    high = np.max([np.array(patch.corner) + patch.mask.shape[::-1] for patch in patches], axis=0)
    mask = np.zeros((high - low)[::-1], np.uint8)
    for patch in patches:
        (x, y), (h, w) = np.array(patch.corner) - low, patch.mask.shape
        mask[y : y + h, x : x + w] |= patch.mask
    if len(patches) > 1:
        framed = cv2.copyMakeBorder(mask, 3, 3, 3, 3, cv2.BORDER_CONSTANT)
        mask = cv2.morphologyEx(framed, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))[3:-3, 3:-3]
    is_whole = all(patch.whole for patch in patches)
    group = len(patches) > 1 or patches[0].group
    return Patch(mask > 0, (int(low[0]), int(low[1])), mask.astype(np.float32), is_whole, group)


def _explain_group(
    image: np.ndarray,
    union: Patch,
    recognised: np.ndarray,
    catalogue: Catalogue,
    calibration: Calibration,
    tries: Work,
    conditions: Conditions | None,
) -> np.ndarray:
    """Return the detections (n,) DETECTED_OBJECT of the parts of a group and of its rest. The
    result is empty if no parts are found. `recognised` (1,) is the detection of the whole group."""
    outlines, _ = measure_patches(image, [union], calibration, CONTOUR_POINTS)
    window, mask = union.windowed(image.shape)
    corner = window[1].start, window[0].start
    place = _positions(recognised)
    scale = float(calibration.scale(place)[0])
    steps = np.array([[0.0, 0], [1, 0], [0, 1]]) / scale
    origin, right, up = calibration.to_image(place + steps)
    linear = np.column_stack([right - origin, up - origin]) * scale
    to_px = np.column_stack([linear, origin - corner - linear @ place[0]])
    view = View(mask, image[window], to_px, scale, outlines[0])
    lamp = None if conditions is None else conditions.lamp
    levels, _, typical_level = height_levels(catalogue, calibration)
    if levels[typical_level] or lamp is not None:
        view = _footprint_view(view, calibration, levels[typical_level], lamp)
    max_area = LARGER * float(np.max(catalogue.filled_area))
    uncertain = recognised["label"][0] == UNKNOWN and outlines[0].filled.area < max_area
    found = find_parts_in_group(_reduce_resolution(view, catalogue), catalogue, uncertain, tries)
    # The search used a reduced resolution. Fit the parts again to the contour at full resolution.
    found = [replace(part, pose=view.fitted(part.template, part.pose)) for part in found]
    left = view.mask
    for part in found:
        left = _remove_part(view, left, part)
    rest = _remaining_patches(left, corner, MIN_REST * float(np.min(catalogue.area)) * scale**2)
    if len(found) + len(rest) < 2 or not found:
        return np.empty(0, DETECTED_OBJECT)
    parts = np.zeros(len(found), DETECTED_OBJECT)
    for row, part in zip(parts, found, strict=True):
        fit, gate = PoseFit(part.pose, 0.0, 0.0), 2 * NEAR_PX / scale
        deviation = angle_sd(part.template, view.outline.points, fit, scale, gate)
        write_type(row, part.template.part, part.pose, deviation, scale)
        row["confidence"], row["colour"], row["whole"] = part.seen, part.tint, union.whole
    parts["x_px"], parts["y_px"] = calibration.to_image(_positions(parts)).T
    return np.concatenate([parts, recognise(image, rest, catalogue, calibration)])


def _footprint_view(view: View, calibration: Calibration, height: float, lamp: Lamp | None) -> View:
    """Return a view of the footprint of a group of parts with a height [m]. The image of the parts'
    tops is shifted to the footprint."""
    (outline,) = footprints([view.outline], calibration, height, lamp)
    mask = np.zeros_like(view.mask)
    for number, ring in enumerate(outline.rings):
        points = view.seen(np.zeros(3), ring)
        cv2.fillPoly(mask, [np.rint(16 * points).astype(np.int32)], not number, shift=4)
    view = replace(view, mask=mask & view.mask, outline=outline)
    if calibration.camera_position is None or height == 0:
        return view
    moved = apparent_shift(calibration.camera_position, outline.centre[None], height)[0]
    shift = moved @ view.to_px[:, :2].T
    pixels = cv2.warpAffine(
        view.pixels, np.column_stack([np.eye(2), -shift]), mask.shape[::-1],
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    return replace(view, pixels=pixels)


def _remaining_patches(left: np.ndarray, corner: tuple[int, int], min_area: float) -> list[Patch]:
    """Return the connected pieces of the rest (h, w) uint8 of a group. Each piece has at least
    `min_area` pixels. `corner` is the first pixel of the window in the image [px]."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(left, connectivity=4)
    pieces = []
    for label in range(1, len(stats)):
        x, y, w, h, area = stats[label].tolist()
        if area >= min_area:
            mask = labels[y : y + h, x : x + w] == label
            place = corner[0] + x, corner[1] + y
            pieces.append(Patch(mask, place, mask.astype(np.float32), group=True))
    return pieces


def _reduce_resolution(view: View, catalogue: Catalogue) -> View:
    """Return a view with fewer pixels if the parts have more pixels than necessary."""
    factor = ENOUGH_PX / (view.scale * float(np.min(catalogue.reach)))
    height, width = view.mask.shape
    if factor > 0.7:
        return view
    size = (max(round(factor * width), 8), max(round(factor * height), 8))
    zoom = np.array(size) / (width, height)
    to_px = view.to_px * zoom[:, None]
    to_px[:, 2] += 0.5 * zoom - 0.5
    mask = cv2.resize(255 * view.mask, size, interpolation=cv2.INTER_AREA) > 127
    pixels = cv2.resize(view.pixels, size, interpolation=cv2.INTER_AREA)
    scale = view.scale * float(np.sqrt(np.prod(zoom)))
    return View(mask.astype(np.uint8), pixels, to_px, scale, view.outline)


def find_parts_in_group(
    view: View, catalogue: Catalogue, uncertain: bool = False, tries: Work | None = None
) -> list[DetectedPart]:
    """Return the parts of a group, with poses in plate_home. The result is empty if no parts are
    found. If `uncertain`, the group may be a single part, so parts are returned only if they cover
    the group completely. `tries` is the number of combinations that may still be tried for this
    group and other groups."""
    tries = tries or Work(TRIES)
    border = _edge_distances(view)
    min_area, max_area = np.array([np.min(catalogue.area), np.max(catalogue.area)]) * view.scale**2
    if np.count_nonzero(view.mask) > MAX_PARTS * max_area:
        return []
    choices = _find_candidates(view, catalogue, border, border)
    # Best-first search: the next tried combination of parts is the one with the smallest sum of
    # ranks. The best candidate has the rank 0, the second best candidate has the rank 1, and so on.
    open_: list[tuple[int, int, int, tuple[DetectedPart, ...], np.ndarray, list[DetectedPart]]] = []
    number = itertools.count()
    heapq.heappush(open_, (0, 0, 0, (), view.mask, choices))
    for _ in range(TRIES):
        if not open_ or not tries.take(1):
            break
        passed, depth, _, parts, left, fitting = heapq.heappop(open_)
        if parts:
            left = _remove_part(view, left, parts[-1])
        if np.count_nonzero(left) <= MIN_REST * min_area:
            if _is_covered(view, parts):
                return list(parts)
            continue
        if parts:
            free = _signed_distance(left)
            fitting = [part for part in fitting if _is_in_free_area(view, part, free, border)]
            fitting = fitting or _find_candidates(view, catalogue, free, border)
        if len(parts) < MAX_PARTS:
            for rank, part in enumerate(fitting[:FIRST]):
                more = (passed + rank, depth - 1, next(number), (*parts, part), left, fitting)
                heapq.heappush(open_, more)
    if uncertain:
        return []
    # No combination of parts covers the group completely. Return only the parts that are certain.
    sure, free = [], border
    for part in choices:
        if part.seen > SURE and _is_in_free_area(view, part, free, border):
            sure.append(part)
            free = _signed_distance(_remove_part(view, (free > 0).astype(np.uint8), part))
    return sure


def _is_covered(view: View, parts: Sequence[DetectedPart]) -> bool:
    """Whether parts cover a group."""
    union = np.zeros_like(view.mask)
    for part in parts:
        union |= view.drawn(part)
    both = np.count_nonzero(union & view.mask)
    return bool(both >= COVERED * np.count_nonzero(union | view.mask))


def _edge_distances(view: View) -> np.ndarray:
    """Return the signed distance (h, w) [px] from the group's contour, positive inside. Inside the
    group, the distance is measured from the contour or from edges of colour, depending on which is
    nearer."""
    smooth = cv2.GaussianBlur(view.pixels, (0, 0), 0.8)
    step = steepness(smooth) / 8
    border = _signed_distance(view.mask)
    edge = (step > EDGE_STEP) & (border > EDGE_DEPTH_PX)
    if not edge.any():
        return border
    from_edge = cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(np.minimum(border, np.where(border > 0, from_edge + 0.5, border)))


def _signed_distance(mask: np.ndarray) -> np.ndarray:
    """Return the distance of pixels from the edge of a mask (h, w) [px], negative outside."""
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5)
    return np.asarray(np.where(mask > 0, inside - 0.5, 0.5 - outside), np.float32)


def _remove_part(view: View, left: np.ndarray, part: DetectedPart) -> np.ndarray:
    """Return the rest (h, w) uint8 of a group after a part was removed."""
    drawn = view.drawn(part)
    rest = np.where(cv2.dilate(drawn, np.ones((3, 3), np.uint8)) > 0, 0, left).astype(np.uint8)
    small = np.ones((3, 3), np.uint8)
    # The dilation of the part also removed pixels of its neighbours along the contour. Restore
    # these pixels.
    grown = cv2.dilate(cv2.morphologyEx(rest, cv2.MORPH_OPEN, small), small)
    return np.asarray(grown & left & (1 - drawn))


def _find_candidates(
    view: View, catalogue: Catalogue, free: np.ndarray, border: np.ndarray
) -> list[DetectedPart]:
    """Return parts that fit into the free area (h, w). The best part comes first. `border` (h, w)
    is the signed distance from the group's contour [px]."""
    free_area = np.count_nonzero(free > 0) / view.scale**2
    ranked = []
    for template, area, perimeter in zip(
        catalogue.templates, catalogue.area, catalogue.perimeter, strict=True
    ):
        if area > 1.2 * free_area:
            continue
        for pose in _find_start_poses(view, template, free, border):
            fit = view.fitted(template, pose)
            seen, outside = _contour_support(view, template, fit, free, border)
            if seen < SEEN or outside > MAX_OUTSIDE:
                continue
            tint = _colour_difference(view, template, fit)
            if tint > LIMIT * COLOUR_LAB:
                continue
            value = seen**2 * perimeter * np.exp(-0.5 * (tint / COLOUR_LAB) ** 2)
            ranked.append((value, DetectedPart(template, fit, seen, tint)))
    ranked.sort(key=lambda pair: -pair[0])
    return [found for _, found in ranked]


def _is_in_free_area(view: View, part: DetectedPart, free: np.ndarray, border: np.ndarray) -> bool:
    """Whether a part is inside the free area (h, w)."""
    return _contour_support(view, part.template, part.pose, free, border)[1] <= MAX_OUTSIDE


def _colour_difference(view: View, template: Template, pose: np.ndarray) -> float:
    """Return the distance of the image's colour at a part from the type's colour."""
    if template.part.colour_lab is None:
        return 0.0
    last = np.array(view.mask.shape[::-1]) - 1
    column, row = np.clip(np.rint(view.seen(pose, template.inner)).astype(int), 0, last).T
    colour = np.median(view.pixels[row, column], axis=0)
    lab = to_lab(np.broadcast_to(colour, 3))
    coloured = view.pixels.ndim == 3
    return float(colour_distance(lab[0], np.array(template.part.colour_lab), coloured))


def _find_start_poses(
    view: View, template: Template, free: np.ndarray, border: np.ndarray
) -> list[np.ndarray]:
    """Return starting poses (3,) for the fit of a type to the group. The most likely pose comes
    first."""
    part = template.part
    pole, depth = template.pole
    angles = np.zeros(1)
    if part.symmetry:
        count = int(
            np.ceil(2 * np.pi * part.reach_m * view.scale / CONTOUR_STEP_PX / part.symmetry)
        )
        angles = 2 * np.pi / part.symmetry * np.arange(count) / count
    stride = max(1, int(STRIDE * part.reach_m * view.scale))
    found = _kernels.search(
        free,
        border,
        view.to_px,
        template.samples,
        template.inner,
        pole,
        depth * view.scale - OUTSIDE_PX,
        angles,
        stride,
    )
    kept: list[np.ndarray] = []
    while len(found) and len(kept) < CHOICES:
        best = found[np.argmax(found[:, 3])]
        kept.append(best[:3])
        found = found[np.hypot(*(found[:, :2] - best[:2]).T) > 0.3 * part.reach_m]
    return kept


def _contour_support(
    view: View, template: Template, pose: np.ndarray, free: np.ndarray, border: np.ndarray
) -> tuple[float, float]:
    """Return two numbers. The first number is the fraction of a part's contour that is on the
    group's contour, minus the fraction that is outside the group. The second number is the fraction
    of the part's inner points that are outside the free area."""
    found: tuple[float, float] = _kernels.support(
        free, border, view.to_px, template.samples, template.inner, pose
    )
    return found
