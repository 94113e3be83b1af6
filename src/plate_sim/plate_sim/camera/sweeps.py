"""Computes the outlines of enlarged parts, and the outlines of side faces and shadows as swept
areas.

All points of an image are projected onto the plane of the plate. Let H be the height of the camera,
and h the height of a part. The projection enlarges the top face of the part by the factor H/(H - h)
about the point below the camera. The horizontal sections of the part between bottom and top are
displaced and scaled, approximately linearly with their height. Together, the projected sections of
a convex piece cover the convex hull of the bottom and the top section. Inside a hole, the plate is
visible at the points that no section hides. A shadow is the area that the outline of a part sweeps
in the direction of the light. The outline at the end of the shadow can be larger or smaller than
the outline of the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from plate_core.rig import PartType

from ..friction.outline import convex_pieces
from .raster import Outlines, polygon_edges

ROUND = 96
"""Number of edges of the polygon that replaces a disc in a swept area. The edges of the polygon
touch the disc. The corners of the polygon are 0.05 % of the radius outside the disc."""

STRAIGHT = 1e-9
"""Displacements shorter than this value are treated as 0 [m]."""


class _Contour(NamedTuple):
    """Convex piece of a part or of a hole, in the frame of the part. `corners` (m, 2) [m] contains
    its corners, and `edges` (m, 3) its edges as in `Outlines.edges`. `radius` is the radius of a
    disc [m], or 0 for a polygon."""

    corners: np.ndarray
    edges: np.ndarray
    radius: float = 0.0


def scale_outlines(outlines: Outlines, factor: np.ndarray) -> Outlines:
    """Return the outlines of M parts after they were enlarged about their centres by the factors
    (M,)."""
    edges: list[np.ndarray] = [np.empty((0, 3))]
    pieces, first = [0], []
    for begin, end, size in zip(outlines.first, outlines.end, factor, strict=True):
        first.append(len(pieces) - 1)
        for piece in range(begin, end):
            piece_edges = outlines.edges[outlines.pieces[piece] : outlines.pieces[piece + 1]]
            edges.append(piece_edges * [1.0, 1.0, size])
            pieces.append(pieces[-1] + len(piece_edges))
    start = np.array(first, np.int64)
    return Outlines(
        np.concatenate(edges), np.array(pieces),
        start, start + outlines.hole - outlines.first, start + outlines.end - outlines.first,
        outlines.reach * factor, outlines.spot * np.stack([factor] * 3 + [factor**2], axis=1),
    )  # fmt: skip


def sweep_outlines(
    types: Sequence[PartType],
    cos_sin: np.ndarray,
    size: np.ndarray,
    growth: np.ndarray,
    shift: np.ndarray,
) -> Outlines:
    """Return the outlines of the areas that M parts sweep if their outlines are moved and enlarged
    continuously.

    Parameters
    ----------
    types : sequence of M
    cos_sin : (M, 2)
        Cosine and sine of the angles of the parts.
    size : (M,)
        Initial size of each part divided by the size of its type.
    growth : (M,)
        Final size of each part divided by its initial size.
    shift : (M, 2)
        Displacement of the centre from the initial to the final section [m, plate_home].

    Returns
    -------
    Outlines
        Outlines of the swept areas. The frame of each outline has the axes of plate_home. The
        origin of the frame is in the middle between the initial and the final centre of the part.
    """
    count = len(types)
    edges: list[np.ndarray] = [np.empty((0, 3))]
    sizes: list[np.ndarray] = [np.zeros(1, np.int64)]
    first, hole, end = (np.zeros(count, np.int64) for _ in range(3))
    begin = 0
    for part in dict.fromkeys(types):
        rows = np.array([k for k, other in enumerate(types) if other == part])
        solid, holes = _convex_contours(part)
        c, s = cos_sin[rows].T
        rotation = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
        tangents = [
            _sweep_piece(piece, rotation, size[rows], growth[rows], shift[rows], kind)
            for kind, group in ((True, solid), (False, holes))
            for piece in group
        ]
        edges.append(np.concatenate(tangents, axis=1).reshape(-1, 3))
        sizes.append(np.tile([edge_group.shape[1] for edge_group in tangents], len(rows)))
        first[rows] = begin + len(tangents) * np.arange(len(rows))
        hole[rows], end[rows] = first[rows] + len(solid), first[rows] + len(tangents)
        begin += len(tangents) * len(rows)
    reach = np.array([part.reach_m for part in types]) * size
    reach = np.maximum(reach, growth * reach) + 0.5 * np.hypot(*shift.T)
    pieces = np.cumsum(np.concatenate(sizes))
    return Outlines(np.concatenate(edges), pieces, first, hole, end, reach, np.zeros((count, 4)))


def _sweep_piece(
    piece: _Contour,
    rotation: np.ndarray,
    size: np.ndarray,
    growth: np.ndarray,
    shift: np.ndarray,
    solid: bool,
) -> np.ndarray:
    """Return the edges (P, e, 3) of the area that the same convex piece of P parts sweeps. If the
    piece is a hole (`solid` is False), return the edges of the intersection of all sections.

    An edge of the piece has one distance from the origin at the beginning of the sweep, and another
    one at its end. For a solid piece, the swept area has an edge at the larger distance. For a
    hole, the intersection has an edge at the smaller distance. The swept area of a solid piece has
    two further edges, which are the common tangents of the first and the last section.
    """
    normal = piece.edges[:, :2] @ np.swapaxes(rotation, 1, 2)
    near = size[:, None] * piece.edges[:, 2]
    far = growth[:, None] * near + np.einsum("pmi,pi->pm", normal, shift)
    distance = np.maximum(near, far) if solid else np.minimum(near, far)
    if solid:
        tangent, touch = (
            _disc_tangents(piece.radius * size, growth, shift)
            if piece.radius
            else _polygon_tangents(piece.corners, rotation, size, growth, shift)
        )
        # If the section of a piece at one end is inside the section at the other end, the two
        # sections have no common tangents. In this case, the first edge of the piece is repeated,
        # so that the array has the same shape.
        lacking = np.isnan(touch)
        tangent[lacking] = np.broadcast_to(normal[:, :1], tangent.shape)[lacking]
        touch = np.where(lacking, distance[:, :1], touch)
        normal = np.concatenate([normal, tangent], axis=1)
        distance = np.concatenate([distance, touch], axis=1)
    distance -= 0.5 * np.einsum("pmi,pi->pm", normal, shift)
    return np.concatenate([normal, distance[..., None]], axis=2)


def _disc_tangents(
    radius: np.ndarray, growth: np.ndarray, shift: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the two outer common tangents of two discs. Each tangent is described by its normal
    (P, 2, 2) and its distance from the origin (P, 2) [m]. The first disc has its centre at the
    origin and the radius `radius`. The second disc has its centre at `shift` and the radius
    `growth` times `radius`. If one disc is inside the other, the values are NaN."""
    distance = np.hypot(*shift.T)
    with np.errstate(all="ignore"):
        cosine = (1 - growth) * radius / distance
        half = np.where((distance > STRAIGHT) & (np.abs(cosine) < 1), np.arccos(cosine), np.nan)
    along = np.arctan2(shift[:, 1], shift[:, 0])
    angle = along[:, None] + half[:, None] * np.array([1.0, -1.0])
    touch = np.where(np.isnan(angle), np.nan, radius[:, None])
    return np.stack([np.cos(angle), np.sin(angle)], axis=2), touch


def _polygon_tangents(
    corners: np.ndarray,
    rotation: np.ndarray,
    size: np.ndarray,
    growth: np.ndarray,
    shift: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the two outer common tangents of two convex polygons, in the same form as
    `_disc_tangents`. The first polygon has the corners (m, 2) [m], rotated by `rotation` and
    enlarged by `size`. The second polygon is the first polygon, enlarged by `growth` and displaced
    by `shift`.

    The line from a corner of the first polygon to the same corner of the second polygon is a common
    tangent if both polygons are on one side of this line.
    """
    point = size[:, None, None] * (corners @ np.swapaxes(rotation, 1, 2))
    displacement = (growth[:, None, None] - 1) * point + shift[:, None]
    length = np.hypot(displacement[..., 0], displacement[..., 1])
    with np.errstate(all="ignore"):
        normal = np.stack([displacement[..., 1], -displacement[..., 0]], axis=2) / length[..., None]
    found, touch = [], []
    for side in (1.0, -1.0):
        across = side * np.einsum("pmi,pni->pmn", normal, point)
        own_offset = np.einsum("pmm->pm", across)
        beyond = np.max(across, axis=2) - own_offset
        beyond = np.where(length > STRAIGHT, beyond, np.inf)
        best = np.argmin(beyond, axis=1)
        rows = np.arange(len(best))
        good = beyond[rows, best] < STRAIGHT
        found.append(side * normal[rows, best])
        touch.append(np.where(good, own_offset[rows, best], np.nan))
    return np.stack(found, axis=1), np.stack(touch, axis=1)


@lru_cache(maxsize=64)
def _convex_contours(part: PartType) -> tuple[list[_Contour], list[_Contour]]:
    """Return the convex pieces of a part type, and the convex pieces of its holes."""
    if part.radius_m:
        angle = 2 * np.pi * np.arange(ROUND) / ROUND
        normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        edges = np.column_stack([normal, np.full(ROUND, part.radius_m)])
        solid = [_Contour(part.radius_m * normal, edges, part.radius_m)]
    else:
        solid = [_make_contour(piece) for piece in convex_pieces(part.polygon)]
    holes = [_make_contour(piece) for hole in part.holes for piece in convex_pieces(np.array(hole))]
    return solid, holes


def _make_contour(polygon: np.ndarray) -> _Contour:
    return _Contour(np.asarray(polygon), polygon_edges(polygon))
