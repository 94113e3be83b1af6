"""Decision which pieces of patches are parts. A piece is a part if it is similar to other pieces in
the image. A piece is also a part if a narrow neck separates it from the rest of the patch.

Some patches alone do not show whether they are one part or several parts. An example is two
brackets that touch along a whole side. But most images show several parts of the same kind.
Therefore, the decision uses similar pieces elsewhere in the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from .background import steepness
from .splitting import split_patch

Traits = tuple[float, float, float]
"""Traits of a piece: its area [px2], its spread (second moment divided by the squared area), and
its solidity (filled fraction of its convex hull)."""

Solid = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A patch: its pixels (h, w) bool, the fraction of each pixel that the part covers (h, w) float32,
and the colours (h, w, C) uint8."""

CONVEX = 0.93
"""Solidity (filled fraction of the convex hull) above which a patch is not split at its necks
(narrow places)."""

CLEAR = 0.45
"""Maximum width of a neck whose two sides are always two parts, relative to the width of the
narrower side [-]. Above this width, it is unclear whether the two sides are two parts."""

ALIKE = (0.12, 0.12, 0.06)
"""Maximum differences between similar pieces: the relative differences of area and spread, and the
difference of solidity."""

UNEQUAL = 0.5
"""Minimum area of the smaller side of an unclear neck, relative to the larger side. If the area is
below this minimum, both sides are one part."""

COMPACT = 0.85
"""Minimum solidity (filled fraction of the convex hull) of a compact piece. If both sides of an
unclear neck are compact, the sides count as two parts."""

MIN_GOOD = 0.35
"""Minimum fraction of a patch's area that must be compact or similar to other pieces after the
patch was split."""

RATHER_ALIKE = (0.4, 0.3, 0.1)
"""Maximum differences, like `ALIKE`, for pieces that are separated along inner edges. These maximum
differences are larger because the contours of such pieces are irregular."""

MEMBERS = 3
"""Minimum number of similar pieces in the image. A straight cut is allowed only if each of its
sides is similar to this number of pieces."""

MIN_DENT_PX = 1.2
"""Minimum depth of a concave corner [px]. A straight cut can begin only at such a corner."""

MAX_DENTS = 6
"""Maximum number of concave corners that are used. If a piece has more concave corners, the deepest
corners are used."""

LARGER = 1.5
"""Minimum area of a piece that may be several parts, relative to the area of a kind in the image.
A kind is a set of similar pieces."""

DENTED = 0.9
"""Minimum solidity (filled fraction of the convex hull) of a large piece that is not similar to
others. Below this solidity, the piece counts as a group."""

EDGES_PERCENT = (70, 80, 90)
"""Percentages of the inner pixels of a piece that are not edges. All percentages are tried, and the
one that splits the piece best is used."""

SMALLER = 0.5
"""Minimum area of a kind, relative to the typical kind. Pieces are not split along inner edges into
smaller kinds."""

COLOURS = (4, 8)
"""Numbers of colour clusters in a piece. Parts may touch where two clusters meet."""

COLOUR_WEIGHTS = (0.5, 2.0, 2.0)
"""Weights of L, a and b in the clusters of a piece's colours. The weight of L is smaller because
light and shadows change the lightness."""

STEEP = 4.0
"""Minimum gradient of an inner edge (Sobel filter), relative to the background's noise limit. An
edge whose step is twice the noise limit has this gradient."""

MIN_INNER = 40
"""Minimum number of inner pixels of a piece. In a piece with fewer inner pixels, no edges are
searched."""

MIN_SEPARATED = 0.3
"""Minimum total area of the compact or known pieces into which edges split a piece, relative to the
area of the original piece. Below this fraction, the split is rejected."""

MIN_FRACTION = 0.5
"""Minimum area of a connected rest that counts as a group after a piece was split, relative to the
smallest piece of the split."""

MOSTLY = 0.5
"""Minimum fraction of pieces that must be similar to others. Below this fraction, a piece that is
not similar to others does not count as a group."""


WORK = 12.0
"""Maximum number of pixels that all cuts within pieces are allowed to visit, relative to the number
of the plate's pixels. Cuts that visit this number of pixels take half a second. Heaps of 80 parts
need this number."""

PLATE_SIZED = 0.5
"""Maximum area of a piece that is split, relative to the area of the plate. A piece above this area
shows that the assumed light or bare plate is wrong."""


LABEL_WORK = 0.1
"""Work per pixel of a piece's window, relative to the work per pixel of a cut."""


@dataclass
class Work:
    """Number of pixels that cuts are still allowed to visit. Pixels are counted instead of time, so
    that results do not depend on the computer's speed."""

    left: float

    def take(self, pixels: float) -> bool:
        """Reserve a number of pixels if at least this number is left. Return whether the pixels
        were reserved."""
        enough = pixels <= self.left
        if enough:
            self.left -= pixels
        return enough


@dataclass
class Piece:
    """The area within one outer contour, or a part of it.

    Attributes
    ----------
    inside : (h, w) bool
        Pixels of the piece, with the holes filled.
    rank : int
        Number of the outer contour.
    alone : bool
        Whether the piece is the whole area, without cuts.
    group : bool
        Whether the piece seems to be several parts.
    """

    inside: np.ndarray
    rank: int
    alone: bool
    group: bool = False

    @cached_property
    def traits(self) -> Traits:
        """Area, spread and solidity of the piece."""
        return traits(self.inside)

    @property
    def area(self) -> float:
        """Area [px2]."""
        return self.traits[0]

    @property
    def solidity(self) -> float:
        """Fraction of the convex hull that the piece fills [-]."""
        return self.traits[2]


def traits(inside: np.ndarray) -> Traits:
    """Return area [px2], spread (second moment divided by the squared area) and solidity of pixels
    (h, w)."""
    pixels = inside.astype(np.uint8)
    moments = cv2.moments(pixels, binaryImage=True)
    area = moments["m00"]
    if area < 1:
        return 0.0, 0.0, 0.0
    contours = cv2.findContours(pixels, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[-2]
    contour = max(contours, key=len)
    hull = cv2.convexHull(contour)
    # OpenCV's contour connects the centres of the outermost pixels, which are half a pixel inside
    # the edge. The computed area is corrected for this half pixel.
    hull_area = cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True) + 1
    return area, (moments["mu20"] + moments["mu02"]) / area**2, min(area / hull_area, 1.0)


def is_similar(a: Traits, b: Traits, spread: Traits = ALIKE) -> bool:
    """Whether two pieces have similar traits."""
    return (
        abs(a[0] - b[0]) <= spread[0] * max(a[0], b[0])
        and abs(a[1] - b[1]) <= spread[1] * max(a[1], b[1])
        and abs(a[2] - b[2]) <= spread[2]
    )


def split_into_pieces(
    solids: list[Solid], min_area: float, limit: float, pixels: int
) -> list[Piece]:
    """Return the parts and groups of parts of which patches consist. If the analysis of a patch
    would visit too many pixels, the patch is returned as a group.

    Parameters
    ----------
    solids : list of Solid
        The patches.
    min_area : float
        Minimum area of a part [px2].
    limit : float
        Maximum deviation of colours that is noise or texture [L].
    pixels : int
        Number of pixels of the plate in the image.
    """
    work = Work(WORK * pixels)
    sure: list[Piece] = []
    unsure: list[tuple[int, np.ndarray, np.ndarray]] = []
    for rank, (inside, amount, _) in enumerate(solids):
        whole = Piece(inside, rank, True)
        if whole.area > PLATE_SIZED * pixels:
            whole.group = True
        if whole.solidity > CONVEX or whole.group:
            sure.append(whole)
            continue
        labels, count, necks = split_patch(amount, inside)
        if count < 2:
            sure.append(whole)
        elif not work.take(LABEL_WORK * count * inside.size):
            sure.append(Piece(inside, rank, True, group=True))
        elif np.all(necks[:, 2] < CLEAR):
            sure += [Piece(labels == k, rank, False) for k in range(1, count + 1)]
        else:
            unsure.append((rank, labels, necks))
    known = [piece.traits for piece in sure if piece.area >= min_area]
    for rank, labels, necks in unsure:
        found = _resolve_unclear_necks(labels, necks, rank, known)
        sure += found
        known += [piece.traits for piece in found if not piece.group]
    sure = [piece for piece in sure if piece.area >= min_area]
    return _cut_by_similarity(_rejoin_fragments(sure, solids), solids, limit, pixels, work)


def _rejoin_fragments(pieces: list[Piece], solids: list[Solid]) -> list[Piece]:
    """Rejoin the pieces of a patch if too little of the patch is compact or similar to other
    pieces, for example in a part with a jagged outline. If more than two pieces are rejoined, the
    result is a group."""
    kept: list[Piece] = []
    for rank in sorted({piece.rank for piece in pieces}):
        of_rank = [piece for piece in pieces if piece.rank == rank]
        good = [
            piece
            for piece in of_rank
            if piece.solidity > COMPACT
            or any(is_similar(piece.traits, other.traits) for other in pieces if other is not piece)
        ]
        good_fraction = sum(piece.area for piece in good) / sum(piece.area for piece in of_rank)
        if len(of_rank) > 1 and good_fraction < MIN_GOOD:
            of_rank = [Piece(solids[rank][0], rank, True, group=len(of_rank) > 2)]
        kept += of_rank
    return kept


def _resolve_unclear_necks(
    labels: np.ndarray, necks: np.ndarray, rank: int, known: list[Traits]
) -> list[Piece]:
    """Return the pieces of a patch that has unclear necks.

    The two sides of such a neck are one part if both together are similar to a known piece. Without
    a similar piece, the two sides are one part if one side is much smaller than the other or is not
    compact. A side that is small or not compact is, for example, a head, a knob or an irregular
    end.
    """
    sides = {k: traits(labels == k) for k in range(1, int(labels.max()) + 1)}
    parent = np.arange(len(sides) + 1)
    for a, b, neck in necks[np.argsort(-necks[:, 2])]:
        one, other = int(a), int(b)
        if neck < CLEAR or parent[one] == parent[other]:
            continue
        both = traits((labels == one) | (labels == other))
        twins = [any(is_similar(sides[k], like) for like in known) for k in (one, other)]
        if any(is_similar(both, like) for like in known):
            joined = not all(twins)
        else:
            small, large = sorted((sides[one][0], sides[other][0]))
            compact = min(sides[one][2], sides[other][2]) > COMPACT
            joined = not all(twins) and (small < UNEQUAL * large or not compact)
        # Each side of a cut is joined only once, so that a chain of small sides does not join large
        # sides.
        lesser = one if sides[one][0] < sides[other][0] else other
        if joined and np.count_nonzero(parent == parent[lesser]) == 1:
            parent[lesser] = parent[one + other - lesser]
    return [
        Piece(np.isin(labels, np.flatnonzero(parent == k)), rank, False)
        for k in np.unique(parent[1:])
    ]


def _cut_by_similarity(
    pieces: list[Piece],
    solids: list[Solid],
    limit: float,
    pixels: int,
    work: Work,
) -> list[Piece]:
    """Cut pieces into pieces that are similar to others, or along inner edges. A piece is a group
    if it is much larger than the others, has concave corners, and is not similar to any other
    piece."""
    kinds = [
        piece.traits
        for i, piece in enumerate(pieces)
        if any(is_similar(piece.traits, other.traits) for k, other in enumerate(pieces) if k != i)
    ]
    typical_area = float(np.median([kind[0] for kind in kinds])) if kinds else np.inf
    common = [kind for kind in kinds if kind[0] > SMALLER * typical_area]
    done: list[Piece] = []
    # The list is sorted so that `pop` returns the smallest piece first.
    todo = sorted(pieces, key=lambda piece: -piece.inside.size)
    while todo:
        piece = todo.pop()
        if piece.area > PLATE_SIZED * pixels or any(
            is_similar(piece.traits, kind) for kind in kinds
        ):
            done.append(piece)
            continue
        smaller = [kind for kind in kinds if LARGER * kind[0] < piece.area]
        halves = _cut_straight(piece, smaller, work) if smaller else None
        if halves is not None:
            todo += halves
            continue
        several = len(kinds) >= MOSTLY * len(pieces) and piece.area > LARGER * typical_area
        piece.group = piece.group or (several and piece.solidity < DENTED)
        if piece.group or (not piece.alone and piece.solidity < CONVEX):
            done += _split_along_edges(piece, *solids[piece.rank][1:], common, limit, work)
        else:
            done.append(piece)
    return done


def _split_along_edges(
    piece: Piece,
    amount: np.ndarray,
    colours: np.ndarray,
    kinds: list[Traits],
    limit: float,
    work: Work,
) -> list[Piece]:
    """Split a piece along inner edges, for example where parts of different colours touch. Return
    the new pieces and the rest. If the edges do not separate compact pieces, return the piece
    itself."""
    if not work.take((len(EDGES_PERCENT) + len(COLOURS)) * piece.inside.size):
        piece.group = True
        return [piece]
    steep = steepness(colours)
    inner = cv2.erode(piece.inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if np.count_nonzero(inner) < MIN_INNER:
        return [piece]
    best: list[Piece] = [piece]
    areas = [kind[0] for kind in kinds]
    min_area = SMALLER * min(np.median(areas) if areas else np.inf, piece.area)
    max_parted = MIN_SEPARATED * piece.area
    borders = [
        inner & (steep > max(np.percentile(steep[inner], percent), STEEP * limit))
        for percent in EDGES_PERCENT
    ]
    if colours.shape[2] == 3:
        borders += [inner & _colour_borders(colours, piece.inside, count) for count in COLOURS]
    for edge in borders:
        open_ = np.where(edge | ~piece.inside, np.float32(0), amount)
        labels, count, _ = split_patch(open_, piece.inside)
        found = [Piece(labels == k, piece.rank, False) for k in range(1, count + 1)]
        good = [
            fragment
            for fragment in found
            if any(is_similar(fragment.traits, kind, RATHER_ALIKE) for kind in kinds)
            or (fragment.solidity > CONVEX and fragment.area > min_area)
        ]
        parted = sum(fragment.area for fragment in good)
        if len(good) > 1 and parted > max_parted:
            max_parted = parted
            best = _assign_rest(good, piece)
    # The remaining pieces are split along their inner edges.
    return [
        part
        for fragment in best
        for part in (
            _split_along_edges(fragment, amount, colours, kinds, limit, work)
            if fragment.group and fragment is not piece
            else [fragment]
        )
    ]


def _colour_borders(colours: np.ndarray, inside: np.ndarray, count: int) -> np.ndarray:
    """Return the pixels (h, w) bool where the `count` main colours of a piece meet."""
    lab = cv2.medianBlur(colours, 5)[inside].astype(np.float32)
    hue = np.arctan2(lab[:, 2] - 128, lab[:, 1] - 128)
    start = (count * (0.5 + hue / (2 * np.pi))).astype(np.int32) % count
    _, cluster, _ = cv2.kmeans(
        lab * np.array(COLOUR_WEIGHTS, np.float32), count, start[:, None],
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 10, 1.0), 1,
        cv2.KMEANS_USE_INITIAL_LABELS,
    )  # fmt: skip
    cluster_image = np.zeros(inside.shape, np.uint8)
    cluster_image[inside] = 1 + cluster.ravel()
    main = cv2.medianBlur(cluster_image, 5)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    return np.asarray(cv2.dilate(main, cross) != main)


def _assign_rest(good: list[Piece], piece: Piece) -> list[Piece]:
    """Return the good pieces of a piece. The rest of the piece is assigned to the nearest good
    pieces. If a connected rest is large compared with the good pieces, this rest is returned as a
    group."""
    nearest = _nearest_area([part.inside for part in good])
    rest = piece.inside & ~np.any([part.inside for part in good], axis=0)
    count, left = cv2.connectedComponents(rest.astype(np.uint8), connectivity=4)
    area = np.bincount(left.ravel(), minlength=count)
    large = area > MIN_FRACTION * min(part.area for part in good)
    large[0] = False
    shared = piece.inside & ~large[left]
    return [
        *(Piece(shared & (nearest == k), piece.rank, False) for k in range(len(good))),
        *(Piece(left == k, piece.rank, False, True) for k in np.flatnonzero(large)),
    ]


def _nearest_area(places: list[np.ndarray]) -> np.ndarray:
    """Return the index (h, w) of the area (h, w) bool that is nearest to each pixel. If several
    areas are equally near, the first one is returned."""
    gaps = [cv2.distanceTransform((~area).astype(np.uint8), cv2.DIST_L2, 3) for area in places]
    return np.argmin(gaps, axis=0)


def _cut_straight(piece: Piece, kinds: list[Traits], work: Work) -> list[Piece] | None:
    """Return the two pieces of a straight cut that starts at a concave corner, if both pieces are
    similar to known kinds. Otherwise, return None."""
    if piece.area * (1 - ALIKE[0]) > 2 * max(kind[0] for kind in kinds):
        return None
    pixels = piece.inside.astype(np.uint8)
    contours = cv2.findContours(pixels, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[-2]
    contour = max(contours, key=len)
    hull = cv2.convexHull(contour, returnPoints=False)
    try:
        dents = cv2.convexityDefects(contour, hull)
    except cv2.error:
        return None
    if dents is None:
        return None
    dents = np.reshape(dents, (-1, 4))
    dents = dents[dents[:, 3] > MIN_DENT_PX * 256]
    dents = dents[np.argsort(-dents[:, 3])][:MAX_DENTS]
    best: tuple[float, list[Piece]] | None = None
    points = contour[:, 0]
    for number, dent in enumerate(dents):
        start = points[dent[2]]
        ends = [points[other[2]] for other in dents[number + 1 :]]
        ends += list(_find_cut_ends(points, int(dent[2])))
        for end in ends:
            if not work.take(pixels.size):
                break
            parted = pixels.copy()
            cv2.line(parted, start.tolist(), end.tolist(), 0, 1)
            count, labels = cv2.connectedComponents(parted, connectivity=4)
            sizes = np.bincount(labels.ravel(), minlength=3)[1:]
            if count < 3 or np.partition(sizes, -2)[-2] < 0.1 * piece.area:
                continue
            # Each pixel on the cut is assigned to the nearer side.
            nearest = _nearest_area([labels == k for k in 1 + np.argsort(-sizes)[1::-1]])
            halves = [Piece(piece.inside & (nearest == k), piece.rank, False) for k in (1, 0)]
            if all(
                sum(is_similar(half.traits, kind) for kind in kinds) >= MEMBERS for half in halves
            ):
                length = float(np.hypot(*(end - start)))
                if best is None or length < best[0]:
                    best = length, halves
    return None if best is None else best[1]


def _find_cut_ends(points: np.ndarray, start: int) -> np.ndarray:
    """Return the points (k, 2) of a contour at which a cut from point `start` may end. These points
    are local minima of the distance from `start`. Their straight-line distance from
    `start` is short, but their distance along the contour is long."""
    gap = np.hypot(*(points - points[start]).T)
    around = np.arange(len(points))
    along = np.minimum((around - start) % len(points), (start - around) % len(points))
    low = (gap <= np.roll(gap, 3)) & (gap <= np.roll(gap, -3)) & (along > 1.5 * gap)
    order = np.flatnonzero(low)[np.argsort(gap[low])]
    return np.asarray(points[order[:MAX_DENTS]])
