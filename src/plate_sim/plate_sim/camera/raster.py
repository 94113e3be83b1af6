"""Draws plate and parts into an image: compiled loops over the pixels that matter.

Every pixel knows the place of the plate's plane that it looks at, so that whatever lens and
perspective there are is in that table. An edge is drawn as the fraction of the pixel it covers,
taken as linear in the distance between the pixel's centre and the edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plate_core import PlateError
from plate_core.kernels import inner_kernel, kernel

Outline = Sequence[np.ndarray]
"""Convex polygons (k, 2) that a part consists of [m, part's frame], corners counter-clockwise."""

MIN_SIDE = 1e-6
"""Shortest side of a polygon [m]: far below a pixel."""


class Outlines(NamedTuple):
    """Outlines of M parts.

    Attributes
    ----------
    edges : (e, 3)
        Outward normal, and distance from the part's centre [m], of all polygons' edges.
    pieces : (p + 1,)
        The first edge of every polygon; the end.
    first : (M + 1,)
        The first polygon of every part; the end.
    reach : (M,)
        How far the part reaches from its centre [m]; 0 for a disc.
    """

    edges: np.ndarray
    pieces: np.ndarray
    first: np.ndarray
    reach: np.ndarray


class Sprites(NamedTuple):
    """What is drawn of n parts and marks, in this order.

    Attributes
    ----------
    window : (n, 4)
        Rows and columns in the image, half open.
    scale : (n,)
        Pixels per metre there.
    copies : (n,)
        Positions averaged over the exposure.
    path : (s, n, 2)
        Positions [m], equally spaced over the exposure.
    radius : (n,)
        Of the disc [m], or of a circle about the polygons.
    turn : (n, 2)
        Cosine and sine of the angle.
    grey : (n,)
        Grey values at full light.
    """

    window: np.ndarray
    scale: np.ndarray
    copies: np.ndarray
    path: np.ndarray
    radius: np.ndarray
    turn: np.ndarray
    grey: np.ndarray


DISCS = Outlines(
    np.empty((0, 3)), np.zeros(1, np.int64), np.zeros(1, np.int64), np.empty(0)
)  # fmt: skip
"""Of no polygons at all."""


def outlines_of(outlines: Sequence[Outline | None]) -> Outlines:
    """Return what drawing needs of outlines, None for a disc.

    Raises
    ------
    PlateError
        If an outline is not made of convex polygons with their corners counter-clockwise.
    """
    edges, pieces, first, reach = [np.empty((0, 3))], [0], [0], []
    for part, outline in enumerate(outlines):
        far = 0.0
        for polygon in () if outline is None else outline:
            sides = _edges(part, np.asarray(polygon, dtype=float))
            edges.append(sides)
            pieces.append(pieces[-1] + len(sides))
            far = max(far, float(np.linalg.norm(polygon, axis=1).max()))
        first.append(len(pieces) - 1)
        reach.append(far)
    return Outlines(np.concatenate(edges), np.array(pieces), np.array(first), np.array(reach))


def _edges(part: int, corner: np.ndarray) -> np.ndarray:
    """Return the edges (k, 3) of a polygon (k, 2)."""
    allowed = "at least 3 corners [m] counter-clockwise around a convex polygon"
    wrong = PlateError(f"outline: of part {part} is {corner.tolist()}, allowed: {allowed}")
    if corner.ndim != 2 or corner.shape[1:] != (2,) or len(corner) < 3:
        raise wrong
    side = np.roll(corner, -1, axis=0) - corner
    length = np.hypot(side[:, 0], side[:, 1])
    if not np.all(np.isfinite(corner)) or length.min() < MIN_SIDE:
        raise wrong
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1) / length[:, None]
    offset = np.sum(normal * corner, axis=1)
    outside = corner @ normal.T - offset
    if outside.max() > 1e-9:
        raise wrong
    return np.column_stack([normal, offset])


@inner_kernel
def expose(canvas, bank, noise, image):
    """Add noise to the canvas (n,), with deviates `bank` (n,), and round it to the image (n,)."""
    noise = np.float32(noise)
    for i in range(len(canvas)):
        value = canvas[i] + noise * bank[i] + np.float32(0.5)
        image[i] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))


@inner_kernel
def along(fraction, last):
    """Return the piece of a path of `last` pieces, and the fraction of it, at one of the whole."""
    piece = min(int(fraction * last), last - 1)
    return piece, fraction * last - piece


@kernel()
def draw_plate(canvas, light, places, pixels, poses, copies, travel, half, scale, grey):
    """Paint background and plate anew where the plate's edge may be.

    Parameters
    ----------
    canvas, light : (n,)
        Grey values to change, fraction of full light.
    places : (n, 2)
        What pixels look at [m, plate_home].
    pixels : (p,)
        Those to paint.
    poses : (s, 3)
        Of the plate, equally spaced over the exposure; averaged over `copies` of them.
    travel : float
        How far at most a point of the plate moves during the exposure [m].
    half : (2,)
        Half sides [m].
    scale : float
        Pixels per metre.
    grey : (2,)
        Of background and plate, at full light.
    """
    pose = np.empty((copies, 4))
    for k in range(copies):
        middle = poses[0]
        if len(poses) > 1:
            j, part = along((k + 0.5) / copies, len(poses) - 1)
            middle = poses[j] + part * (poses[j + 1] - poses[j])
        pose[k, :2] = middle[:2]
        pose[k, 2], pose[k, 3] = np.cos(middle[2]), np.sin(middle[2])
    for i in pixels:
        x, y = places[i]
        across, down = depths(pose[0], half, x, y)
        depth = min(across, down) * scale
        if depth > 0.5 + travel * scale:
            cover = 1.0
        elif depth < -0.5 - travel * scale:
            cover = 0.0
        else:
            cover = 0.0
            for k in range(copies):
                across, down = depths(pose[k], half, x, y)
                cover += min(max(across * scale + 0.5, 0.0), 1.0) * min(
                    max(down * scale + 0.5, 0.0), 1.0
                )
            cover /= copies
        canvas[i] = (grey[0] + (grey[1] - grey[0]) * cover) * light[i]


@inner_kernel
def depths(pose, half, x, y):
    """Distances of a point [m] from the plate's edges across and along it, positive inside;
    pose: x, y, cosine, sine."""
    dx, dy = x - pose[0], y - pose[1]
    across = half[0] - abs(pose[2] * dx + pose[3] * dy)
    return across, half[1] - abs(pose[2] * dy - pose[3] * dx)


@kernel()
def draw_parts(canvas, light, places, sprites, outlines):
    """Blend parts into the canvas (height, width), one after the other.

    Parameters
    ----------
    canvas, light : (height, width)
        Grey values to change, fraction of full light.
    places : (height, width, 2)
        What pixels look at [m, plate_home].
    sprites : Sprites
    outlines : Outlines
        Of as many; one without polygons is a disc.
    """
    for i in range(len(sprites.grey)):
        scale, radius, copies = sprites.scale[i], sprites.radius[i], sprites.copies[i]
        grey, cos, sin = sprites.grey[i], sprites.turn[i, 0], sprites.turn[i, 1]
        begin, end = outlines.first[i], outlines.first[i + 1]
        centre, middle, spread = positions(sprites.path[:, i], copies)
        outer = radius + spread + 1 / scale
        inner = max(inner_radius(radius, outlines, begin, end) - spread - 0.5 / scale, 0.0)
        top, bottom, left, right = sprites.window[i]
        for row in range(top, bottom):
            for col in range(left, right):
                x, y = places[row, col]
                square = (x - middle[0]) ** 2 + (y - middle[1]) ** 2
                if square > outer * outer:
                    continue
                if square < inner * inner:
                    canvas[row, col] = grey * light[row, col]
                    continue
                cover = 0.0
                for k in range(copies):
                    dx, dy = x - centre[k, 0], y - centre[k, 1]
                    if begin == end:
                        inside = (radius - np.sqrt(dx * dx + dy * dy)) * scale
                        cover += min(max(inside + 0.5, 0.0), 1.0)
                    else:
                        along_x, along_y = cos * dx + sin * dy, cos * dy - sin * dx
                        cover += polygons_cover(along_x, along_y, scale, outlines, begin, end)
                fraction = cover / copies
                canvas[row, col] += fraction * (grey * light[row, col] - canvas[row, col])


@kernel()
def positions(path, copies):
    """Return positions (copies, 2) averaged along a path (s, 2), its middle, and the farthest of
    them from that."""
    centre = np.empty((copies, 2))
    middle = 0.5 * (path[0] + path[-1])
    spread = 0.0
    for k in range(copies):
        j, part = along((k + 0.5) / copies, len(path) - 1)
        centre[k] = path[j] + part * (path[j + 1] - path[j])
        far = np.sqrt((centre[k, 0] - middle[0]) ** 2 + (centre[k, 1] - middle[1]) ** 2)
        spread = max(spread, far)
    return centre, middle, spread


@inner_kernel
def polygons_cover(x, y, scale, outlines, begin, end):
    """Fraction of a pixel at (x, y) [m, part's frame] that convex polygons side by side cover."""
    edges, pieces, cover = outlines.edges, outlines.pieces, 0.0
    for piece in range(begin, end):
        inside = np.inf
        for e in range(pieces[piece], pieces[piece + 1]):
            inside = min(inside, edges[e, 2] - edges[e, 0] * x - edges[e, 1] * y)
        cover += min(max(inside * scale + 0.5, 0.0), 1.0)
    return min(cover, 1.0)


@kernel()
def inner_radius(radius, outlines, begin, end):
    """Radius [m] about a part's centre within which all is part."""
    if begin == end:
        return radius
    inner = 0.0
    for piece in range(begin, end):
        first, last = outlines.pieces[piece], outlines.pieces[piece + 1]
        inner = max(inner, np.min(outlines.edges[first:last, 2]))
    return inner
