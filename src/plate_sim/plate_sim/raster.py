"""Draws plate and parts into an image: compiled loops over the pixels that matter.

Every pixel knows the place of the plate's plane that it looks at, so that whatever lens and
perspective there are is in that table. An edge is drawn as the share of the pixel that it covers,
taken as linear in the distance between the pixel's centre and the edge.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def pixel_places(to_home, pixel):
    """Apply a homography (3, 3) to points (n, 2) [px]: (n, 2) [m]."""
    place = np.empty_like(pixel)
    for i in range(len(pixel)):
        u, v = pixel[i]
        w = to_home[2, 0] * u + to_home[2, 1] * v + to_home[2, 2]
        place[i, 0] = (to_home[0, 0] * u + to_home[0, 1] * v + to_home[0, 2]) / w
        place[i, 1] = (to_home[1, 0] * u + to_home[1, 1] * v + to_home[1, 2]) / w
    return place


@njit(cache=True)
def image_slopes(to_image, point, straight, slopes):
    """Fill the images (n, 2) [px] of points (n, 2) [m], and their derivative (n, 2, 2) [px/m]."""
    a = to_image
    for i in range(len(point)):
        x, y = point[i]
        w = a[2, 0] * x + a[2, 1] * y + a[2, 2]
        for k in range(2):
            straight[i, k] = (a[k, 0] * x + a[k, 1] * y + a[k, 2]) / w
            slopes[i, k, 0] = (a[k, 0] - straight[i, k] * a[2, 0]) / w
            slopes[i, k, 1] = (a[k, 1] - straight[i, k] * a[2, 1]) / w


@njit(cache=True)
def expose(canvas, bank, noise, image):
    """Add noise to the canvas (n,), with deviates `bank` (n,), and round it to the image (n,)."""
    noise = np.float32(noise)
    for i in range(len(canvas)):
        value = canvas[i] + noise * bank[i] + np.float32(0.5)
        image[i] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))


@njit(cache=True)
def along(share, last):
    """Return the piece of a way of `last` pieces, and the share of it, at a share of the whole."""
    piece = min(int(share * last), last - 1)
    return piece, share * last - piece


@njit(cache=True)
def draw_plate(canvas, light, places, pixels, poses, copies, sway, half, scale, room, plate):
    """Paint room and plate again where the plate's edge may be.

    Parameters
    ----------
    canvas, light : (n,)
        Grey values to change, share of full light.
    places : (n, 2)
        What pixels look at [m, plate_home].
    pixels : (p,)
        Those to paint.
    poses : (s, 3)
        Of the plate, equally spaced over the exposure; averaged over `copies` of them.
    sway : float
        How far at most a point of the plate moves during the exposure [m].
    half : (2,)
        Half sides [m].
    scale : float
        Pixels per metre.
    room, plate : float
        Grey values at full light.
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
        if depth > 0.5 + sway * scale:
            cover = 1.0
        elif depth < -0.5 - sway * scale:
            cover = 0.0
        else:
            cover = 0.0
            for k in range(copies):
                across, down = depths(pose[k], half, x, y)
                cover += min(max(across * scale + 0.5, 0.0), 1.0) * min(
                    max(down * scale + 0.5, 0.0), 1.0
                )
            cover /= copies
        canvas[i] = (room + (plate - room) * cover) * light[i]


@njit(cache=True)
def depths(pose, half, x, y):
    """Distances of a point [m] from the plate's edges across and along it, positive inside;
    pose: x, y, cosine, sine."""
    dx, dy = x - pose[0], y - pose[1]
    across = half[0] - abs(pose[2] * dx + pose[3] * dy)
    return across, half[1] - abs(pose[2] * dy - pose[3] * dx)


@njit(cache=True)
def draw_parts(
    canvas, light, places, window, scale, copies, path, radius, turn, grey, edges, pieces, first
):
    """Blend parts into the canvas, one after the other.

    Parameters
    ----------
    canvas, light : (height, width)
        Grey values to change, share of full light.
    places : (height, width, 2)
        What pixels look at [m, plate_home].
    window : (n, 4)
        Rows and columns of each part, half open.
    scale : (n,)
        Pixels per metre at each part.
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
    edges : (e, 3)
        Outward normal, and distance from the part's centre [m], of the polygons' edges.
    pieces : (p + 1,)
        The first edge of every polygon; the end.
    first : (n + 1,)
        The first polygon of every part, which has none if it is a disc; the end.
    """
    for i in range(len(grey)):
        centre = np.empty((copies[i], 2))
        middle = 0.5 * (path[0, i] + path[-1, i])
        spread = 0.0
        for k in range(copies[i]):
            j, part = along((k + 0.5) / copies[i], len(path) - 1)
            centre[k] = path[j, i] + part * (path[j + 1, i] - path[j, i])
            far = np.sqrt((centre[k, 0] - middle[0]) ** 2 + (centre[k, 1] - middle[1]) ** 2)
            spread = max(spread, far)
        outer = radius[i] + spread + 1 / scale[i]
        inner = inner_radius(radius[i], edges, pieces, first[i], first[i + 1])
        inner = max(inner - spread - 0.5 / scale[i], 0.0)
        for row in range(window[i, 0], window[i, 1]):
            for col in range(window[i, 2], window[i, 3]):
                x, y = places[row, col]
                square = (x - middle[0]) ** 2 + (y - middle[1]) ** 2
                if square > outer * outer:
                    continue
                if square < inner * inner:
                    canvas[row, col] = grey[i] * light[row, col]
                    continue
                cover = 0.0
                for k in range(copies[i]):
                    dx, dy = x - centre[k, 0], y - centre[k, 1]
                    if first[i] == first[i + 1]:
                        inside = (radius[i] - np.sqrt(dx * dx + dy * dy)) * scale[i]
                        cover += min(max(inside + 0.5, 0.0), 1.0)
                    else:
                        along_x = turn[i, 0] * dx + turn[i, 1] * dy
                        along_y = turn[i, 0] * dy - turn[i, 1] * dx
                        cover += polygons_cover(
                            along_x, along_y, scale[i], edges, pieces, first[i], first[i + 1]
                        )
                share = cover / copies[i]
                canvas[row, col] += share * (grey[i] * light[row, col] - canvas[row, col])


@njit(cache=True)
def polygons_cover(x, y, scale, edges, pieces, begin, end):
    """Share of a pixel at (x, y) [m, part's frame] that convex polygons side by side cover."""
    cover = 0.0
    for piece in range(begin, end):
        inside = np.inf
        for e in range(pieces[piece], pieces[piece + 1]):
            inside = min(inside, edges[e, 2] - edges[e, 0] * x - edges[e, 1] * y)
        cover += min(max(inside * scale + 0.5, 0.0), 1.0)
    return min(cover, 1.0)


@njit(cache=True)
def inner_radius(radius, edges, pieces, begin, end):
    """Radius [m] about a part's centre within which all is part."""
    if begin == end:
        return radius
    inner = 0.0
    for piece in range(begin, end):
        inner = max(inner, np.min(edges[pieces[piece] : pieces[piece + 1], 2]))
    return inner
