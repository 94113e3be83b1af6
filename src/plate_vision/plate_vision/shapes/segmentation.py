"""Segmentation of an image into patches that differ from its background. The patches may have any
outline and colour.

There are five steps. The deviation from the background is computed in Lab. Shadows are removed, or
the lamp that casts all shadows is detected. The contour of each patch is determined at half of the
patch's contrast. Holes are distinguished from highlights. Patches are split where parts touch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from .. import _kernels
from ..plate.region import Region
from .background import Background, colours_like, deviation
from .grouping import CONVEX, Piece, split_into_pieces, traits
from .patch import HALF, Patch
from .shadows import Lamp, find_faces, find_lamp, find_sides, remove_shadows

MIN_AREA_PX2: float = _kernels.MIN_AREA_PX2
"""Minimum area of a part [px2]. A disc with a radius of 3 px has this area."""

MAX_PATCHES = 250
"""Maximum number of patches that are evaluated. The largest patches are used. Further patches are
noise, or texture of a plate that has moved."""

MIN_DEPTH_PX = 1.8
"""Minimum distance of a part's innermost point from its contour [px]. In scratches, this distance
is smaller."""

MIN_HOLE_PX2 = 6
"""Minimum area of a hole [px2]. An area below this minimum is a speck on the part."""

NEAR_PX = 12
"""Radius of the neighbourhood of a pixel [px]. The maximum deviation in this neighbourhood is used
as the deviation of the part around the pixel."""

HOLE = 0.35
"""Maximum deviation of a hole from the plate, relative to the part's contrast. A highlight has a
larger deviation than this maximum."""

NOISE_STEP = 16
"""Step between the rows and columns that are evaluated for the typical noise."""

REMNANT = 0.35
"""Maximum area of a patch that is the rest of a shadow, relative to a typical part's area. Such a
patch must also satisfy `MIN_REMOVED`."""

MIN_REMOVED = 0.25
"""Minimum area of the shadow that was removed around a patch, relative to the patch's area. With
this area, a small patch (`REMNANT`) is the rest of a shadow."""

FILLED = 0.3
"""Minimum fraction of the area enclosed by a ring that objects inside must fill, so that the
objects and the ring count as one part."""

DUST = 0.04
"""Maximum area of dust, relative to the area of a typical part."""

MIN_SIDE_PX = 8
"""Minimum side of an image [px]. Smaller images cannot show a complete part."""

MIN_CONTOUR_PX = 12
"""Minimum length of a part's contour [px]."""

ROUND = 0.8
"""Minimum of 4 pi area / length^2 for a hole. An enclosed area below this value may be a gap
between parts."""

CONVEX_HOLE = 0.75
"""Minimum fraction of the convex hull that a hole fills. A gap between parts fills a smaller
fraction, because a gap has thin corners."""

LARGE_HOLE_PX2 = 40.0
"""Size of an enclosed area above which `CONVEX_HOLE` applies [px2]. In areas below this size, thin
corners are not visible."""


def find_patches(
    image: np.ndarray, background: Background, region: Region | None = None
) -> list[Patch]:
    """Find the patches of an image that differ from a background.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    background : Background
        A background of the same image size, from `learn_plate` or `model_background`.
    region : Region, optional
        Region of the plate; None: the whole image.

    Returns
    -------
    list of Patch
        One patch for each part, or for a group of parts that were not separated.

    Raises
    ------
    ImageError
        If the image has another size than the background.
    """
    return segment(image, background, region, lamps=False).patches


class Segments(NamedTuple):
    """Segmentation of an image: the objects on a background.

    Attributes
    ----------
    patches : list of Patch
    lamp : Lamp, optional
        The lamp that casts the shadows of all parts. If there is such a lamp, patches include the
        shadows.
    labels : (H, W) int32
        Number of the connected region that differs from the background at each pixel, 0 elsewhere.
    cut : (count,) bool
        Whether a part of each region was removed as its shadow.
    """

    patches: list[Patch]
    lamp: Lamp | None
    labels: np.ndarray
    cut: np.ndarray

    def uncertain(self, named: np.ndarray) -> np.ndarray | None:
        """Return the pixels (H, W) bool of those regions from which shadows were removed and whose
        patches have no type. Return None if there are no such regions. `named` (n,) is whether each
        patch has a type."""
        cut = self.cut.copy()
        for patch, known in zip(self.patches, named, strict=True):
            if known:
                cut[self.labels[patch.window][patch.mask]] = False
        return cut[self.labels] if np.any(cut) else None


def segment(
    image: np.ndarray,
    background: Background,
    region: Region | None = None,
    lamps: bool = True,
    lamp: Lamp | None = None,
    rise: Callable[[np.ndarray], np.ndarray] | None = None,
    whole: np.ndarray | None = None,
) -> Segments:
    """Find patches as `find_patches` does, and the lamp that casts all shadows.

    If there is such a lamp, patches are parts together with their shadows. Without such a lamp,
    shadows are removed if they can be distinguished from parts.

    If `lamps` is False, no lamp is searched. If `lamp` is given, this lamp is used. If parts have a
    height, `rise` returns the shifts (n, 2) of their tops at image points (n, 2) [px]. If `whole`
    (H, W) bool is given, only the pixels where it is true are evaluated, and no shadows are
    removed.
    """
    lab = colours_like(image, background)
    if min(lab.shape[:2]) < MIN_SIDE_PX:
        return Segments([], None, np.zeros(lab.shape[:2], np.int32), np.zeros(1, bool))
    limit = background.limit
    deviations = deviation(lab, background.lab, background.chroma)
    seen = cv2.compare(deviations, limit, cv2.CMP_GT)
    if region is not None:
        seen[~region.usable] = 0
    if whole is not None:
        seen[~whole] = 0
    deviations = cv2.bitwise_and(deviations, seen)
    count, labels = cv2.connectedComponents(seen)
    sides = find_sides(lab, background.lab, background.chroma, limit, labels, count)
    cut = np.zeros(count, bool)
    if lamp is None and whole is None:
        faces = None if rise is None else find_faces(sides, deviations, labels, rise)
        lamp = find_lamp(sides, deviations, labels, faces) if lamps else None
        if lamp is None:
            cut = remove_shadows(sides, deviations, labels, background.learned, faces)
    light = cv2.extractChannel(lab, 0)
    brighter = cv2.compare(light, cv2.extractChannel(background.lab, 0), cv2.CMP_GT)
    cover = _compute_cover(deviations, brighter, limit, labels, count)
    if lamp is not None:
        shade = np.minimum(deviations * np.float32(1 / lamp.level), np.float32(1))
        np.maximum(cover, shade, out=cover, where=sides.lit)
    mask = _bridge_colour_steps(cover, deviations, light)
    noise = float(np.median(limit[::NOISE_STEP, ::NOISE_STEP]))
    patches = _find_patches(mask, cover, deviations, lab, noise, region)
    typical_area = _typical_area(patches)
    kept = [
        patch
        for patch in patches
        if patch.area_px2 >= DUST * typical_area
        and not (
            patch.area_px2 < REMNANT * typical_area and _is_shadow_remnant(patch, seen, deviations)
        )
    ]
    return Segments(kept, lamp, labels, cut)


def _compute_cover(
    deviations: np.ndarray, brighter: np.ndarray, limit: np.ndarray, labels: np.ndarray, count: int
) -> np.ndarray:
    """Return the fraction of each pixel that a part covers, (H, W) float32. The fraction is the
    deviation of the pixel, relative to the deviation of the part around the pixel. The fraction is
    0 outside of parts."""
    slope = cv2.morphologyEx(deviations, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    contrast, steepest = np.empty((2, count), np.float32)
    bright = np.empty(count, np.bool_)
    _kernels.find_contrasts(labels, deviations, brighter, slope, contrast, steepest, bright)
    side = 2 * NEAR_PX + 1
    around = cv2.dilate(deviations, np.ones((side, side), np.uint8))
    cover = np.empty(deviations.shape, np.float32)
    _kernels.find_cover(
        deviations, around, brighter, slope, labels, contrast, steepest, bright, limit, cover
    )
    return cover


def _bridge_colour_steps(
    cover: np.ndarray, deviations: np.ndarray, light: np.ndarray
) -> np.ndarray:
    """Return the pixels (H, W) uint8 of parts.

    Between two colours of a part there may be pixels that look like the plate, for example at the
    edge of a highlight on a dark part. Such pixels are included if the step between the two colours
    is larger than the step from the part to the plate.
    """
    mask = (cover >= HALF).astype(np.uint8)
    narrow, wide = np.ones((3, 3), np.uint8), np.ones((5, 5), np.uint8)
    step = cv2.morphologyEx(light, cv2.MORPH_GRADIENT, narrow)
    near = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, narrow)
    far = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, wide)
    _kernels.bridge(mask, cover, near, far, step, cv2.dilate(deviations, wide))
    return np.asarray(mask)


def _find_patches(
    mask: np.ndarray,
    cover: np.ndarray,
    deviations: np.ndarray,
    lab: np.ndarray,
    noise: float,
    region: Region | None,
) -> list[Patch]:
    """Return the patches of a cover (H, W). `mask` (H, W) is 1 at the pixels of parts."""
    contours, family = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    windows = [
        _make_window(number, contours, family[0], cover, deviations)
        for number, contour in enumerate(contours)
        if family[0][number][3] < 0 and len(contour) >= MIN_CONTOUR_PX
    ]
    windows = _merge_enclosed(_largest_windows(windows))
    pixels = cover.size if region is None else int(np.count_nonzero(region.usable))
    solids = [(window.solid, window.amount, lab[window.place]) for window in windows]
    return [
        patch
        for piece in split_into_pieces(solids, MIN_AREA_PX2, noise, pixels)
        if (patch := _make_patch(piece, windows[piece.rank], region)) is not None
    ]


def _is_shadow_remnant(patch: Patch, seen: np.ndarray, deviations: np.ndarray) -> bool:
    """Whether a patch is the rest of a shadow. If so, a shadow was removed around the patch."""
    window = patch.window_with_margin(2, seen.shape)
    taken = np.count_nonzero((seen[window] > 0) & (deviations[window] == 0))
    return bool(taken > MIN_REMOVED * patch.area_px2)


def _largest_windows(windows: list[Window]) -> list[Window]:
    """Return the `MAX_PATCHES` largest windows."""
    if len(windows) <= MAX_PATCHES:
        return windows
    size = [-np.count_nonzero(window.solid) for window in windows]
    kept = np.sort(np.argsort(size, kind="stable")[:MAX_PATCHES])
    return [windows[k] for k in kept.tolist()]


def _merge_enclosed(windows: list[Window]) -> list[Window]:
    """Merge each ring with the objects inside it if the objects fill enough of the ring. The ring
    is then the contour of a part, and the objects are inside this part. Between the ring and the
    objects, the part looks like the plate."""
    kept = []
    inner: set[int] = set()
    low = np.array([window.corner for window in windows]).reshape(-1, 2)
    high = low + np.array([window.solid.shape[::-1] for window in windows]).reshape(-1, 2)
    for outer, window in enumerate(windows):
        enclosed = window.enclosed
        if np.any(enclosed):
            total = 0
            inside = []
            within = np.all((low >= low[outer]) & (high <= high[outer]), axis=1)
            within[outer] = False
            for k in np.flatnonzero(within).tolist():
                other = windows[k]
                (x, y), (h, w) = low[k] - low[outer], other.solid.shape
                if np.all(enclosed[y : y + h, x : x + w][other.solid]):
                    inside.append(k)
                    total += int(np.count_nonzero(other.solid))
            if total > FILLED * np.count_nonzero(enclosed):
                inner.update(inside)
                window = window.filled()
        kept.append(window)
    return [window for k, window in enumerate(kept) if k not in inner]


def _typical_area(patches: list[Patch]) -> float:
    """Return the typical area of a part [px2]. The result is the weighted median of the parts'
    areas. Half of the pixels of all parts belong to parts above this area."""
    area = np.sort([patch.area_px2 for patch in patches if patch.whole and not patch.group])
    if not len(area):
        return 0.0
    return float(area[np.searchsorted(np.cumsum(area), 0.5 * np.sum(area))])


class Window(NamedTuple):
    """The area within one outer contour.

    Attributes
    ----------
    corner : (int, int)
        First column and row in the image.
    solid : (h, w) bool
        Pixels of parts. The parts' holes are included, but not the gaps between parts.
    holes : (h, w) bool
        Pixels of the parts' holes.
    amount : (h, w) float32
        Fraction of each pixel that parts cover. Holes count as covered.
    cover : (h, w) float32
        Fraction of each pixel that parts cover. Holes do not count as covered.
    enclosed : (h, w) bool
        Pixels of holes and gaps, and of objects inside them.
    """

    corner: tuple[int, int]
    solid: np.ndarray
    holes: np.ndarray
    amount: np.ndarray
    cover: np.ndarray
    enclosed: np.ndarray

    @property
    def place(self) -> tuple[slice, slice]:
        """Rows and columns of the window in the image."""
        (x0, y0), (height, width) = self.corner, self.solid.shape
        return np.s_[y0 : y0 + height, x0 : x0 + width]

    def filled(self) -> Window:
        """Return the window with its holes and gaps filled."""
        solid = self.solid | self.enclosed
        amount = np.where(self.enclosed, np.float32(1), self.amount)
        return Window(self.corner, solid, np.zeros_like(solid), amount, amount, self.enclosed)


def _make_window(
    number: int,
    contours: Sequence[np.ndarray],
    family: np.ndarray,
    cover: np.ndarray,
    deviations: np.ndarray,
) -> Window:
    """Return the window of one outer contour. Each area that the contour encloses is classified as
    a hole, a gap or a highlight."""
    x, y, w, h = cv2.boundingRect(contours[number])
    x0, y0 = max(x - 1, 0), max(y - 1, 0)
    window = np.s_[y0 : y + h + 1, x0 : x + w + 1]
    cover_here, deviation_here = cover[window], deviations[window]
    offset = (-x0, -y0)
    inside = np.zeros(cover_here.shape, np.uint8)
    cv2.drawContours(inside, contours[number : number + 1], 0, 1, cv2.FILLED, offset=offset)
    holes, gaps, enclosed = (np.zeros_like(inside) for _ in range(3))
    child = family[number][2]
    full = np.mean(deviation_here[inside > 0]) if child >= 0 else 0
    alone: bool | None = None
    while child >= 0:
        contour = contours[child]
        left, top, wide, high = cv2.boundingRect(contour)
        # Small contours are skipped immediately, because noise causes thousands of such contours.
        if (wide - 2) * (high - 2) < MIN_HOLE_PX2:
            child = family[child][0]
            continue
        part = np.s_[top - y0 : top - y0 + high, left - x0 : left - x0 + wide]
        inner = np.zeros((high, wide), np.uint8)
        cv2.drawContours(inner, [contour], 0, 1, cv2.FILLED, offset=(-left, -top))
        cv2.drawContours(inner, [contour], 0, 0, 1, offset=(-left, -top))
        enclosed[part] |= inner
        level = deviation_here[part][(inner > 0) & (cover_here[part] < HALF)]
        if len(level) >= MIN_HOLE_PX2 and np.median(level) < HOLE * full:
            area, hull = cv2.contourArea(contour), cv2.contourArea(cv2.convexHull(contour))
            around = 4 * np.pi * area / max(cv2.arcLength(contour, True), 1) ** 2
            convex = area > max(CONVEX_HOLE * hull, LARGE_HOLE_PX2)
            # The area may be a gap between touching parts. Around a gap, the outer contour of the
            # parts has concave corners. If the outer contour has no concave corners, the area is a
            # hole. The hole looks narrow because the camera sees a high part obliquely.
            if not convex and around <= ROUND and alone is None:
                alone = traits(inside)[2] > CONVEX
            (holes if convex or around > ROUND or alone else gaps)[part][inner > 0] = 1
        child = family[child][0]
    solid = inside > gaps
    # Inside its contour, a part covers each pixel completely, even if the part has several colours.
    amount = np.where(solid, np.maximum(cover_here, np.float32(HALF)), cover_here)
    amount[cv2.erode(inside, np.ones((3, 3), np.uint8), borderValue=1) > gaps] = 1
    true = np.where(holes, cover_here, amount) if np.any(holes) else amount
    return Window((x0, y0), solid, holes > 0, amount, true, enclosed > 0)


def _make_patch(piece: Piece, window: Window, region: Region | None) -> Patch | None:
    """Return one patch in its own window. Return None if the patch is thinner than a part."""
    left, top, width, height = cv2.boundingRect(piece.inside.astype(np.uint8))
    x0, y0 = max(left - 1, 0), max(top - 1, 0)
    box = np.s_[y0 : top + height + 1, x0 : left + width + 1]
    inside = piece.inside[box].astype(np.uint8)
    mask = (inside > 0) & ~window.holes[box]
    # If a piece was cut from a patch, it may be only a thin ring around a hole. A thin ring around
    # a hole is not a part. Therefore the thickness of such a piece is measured without the pixels
    # of holes.
    body = inside if piece.alone else mask.astype(np.uint8)
    framed = cv2.copyMakeBorder(body, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    if np.max(cv2.distanceTransform(framed, cv2.DIST_L2, 3)) < MIN_DEPTH_PX:
        return None
    # The mask excludes edge pixels of which the part covers less than half. `cover` contains these
    # pixels, unless they belong to other pieces.
    near = cv2.dilate(inside, np.ones((3, 3), np.uint8)) > 0
    others = window.solid[box] & (inside == 0)
    cover = np.where(near & ~others, window.cover[box], np.float32(0))
    # A patch is complete if its window has a margin of free pixels on each side.
    is_whole = not any(np.any(line) for line in (mask[0], mask[:, 0], mask[-1], mask[:, -1]))
    corner = window.corner[0] + x0, window.corner[1] + y0
    patch = Patch(mask, corner, cover, is_whole, piece.group)
    if region is not None and not np.all(region.usable[patch.window][near]):
        return replace(patch, whole=False)
    return patch
