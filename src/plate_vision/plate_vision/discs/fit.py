"""Centres, radii and darkness of round parts that touch others or are cut by the plate's edge.

Damped Gauss-Newton on centre, radius, edge width and darkness of one disc after the other, with
the darkness of its neighbours, as far as they are known, taken off first. Pixels that do not show
the plate have no weight, and those that a neighbour covers the less the more it covers them.
"""

from __future__ import annotations

import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel

from ..plate.light import LitPlate, bare, solve
from .measure import CORE, DISC, MIN_DARKNESS, RIM_PX

EDGE_PX = (0.4, 0.8, 3.0)
"""Least, first and greatest half width [px] of a disc's edge, where its cover rises from 0 to 1 as
a cubic: 0.5 are sharp pixels, 1.1 a lens with a blur of 0.6 px (standard deviation)."""

MAX_STEP_PX = 1.0
"""Largest change of a centre or radius [px] in one iteration: edges are seen only when near."""

SETTLED_PX = 0.01
"""Change [px] of centre and radius after which the fit has converged: the next change would be a
tenth of it, and a tenth of the effect of the image's noise."""

MAX_ITERATIONS = 25

DAMPING = 1e-3
"""Added to the normal equations, also as a fraction of their diagonal: keeps them solvable when
hardly anything of a disc is seen."""

SIZE = 5
"""Unknowns of a disc: x, y, radius, half width of the edge [px], darkness."""


def fit_discs(plate: LitPlate, seeds: np.ndarray, radius_px: float) -> np.ndarray:
    """Measure discs (n,) DISC, neighbours among them, from first guesses of their centres (n, 2)
    [px] and of the radius [px]."""
    state = np.empty((len(seeds), SIZE))
    state[:, :2], state[:, 2], state[:, 3] = seeds, radius_px, EDGE_PX[1]
    discs = np.zeros(len(seeds), DISC)
    discs["misfit"] = _fit_all(plate, state, radius_px)
    discs["x_px"], discs["y_px"], discs["radius_px"], _, discs["darkness"] = state.T
    return discs


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _fit_all(plate: LitPlate, state: np.ndarray, radius: float) -> np.ndarray:
    """Fit `state` (n, SIZE), a first guess but for the darkness; return misfits (n,)."""
    count = len(state)
    reach = int(np.ceil(radius + RIM_PX))
    pixels = np.empty((count, 3, (2 * reach + 1) ** 2), np.float32)  # x, y, darkness
    length = np.zeros(count, np.int64)
    for k in range(count):
        length[k] = _gather(plate, state[k, :2], radius, pixels[k])
        state[k, 4] = _first_darkness(pixels[k], length[k], state[k], radius)
    seeds = state[:, :2].copy()
    near = (2 * radius + 2 * RIM_PX) ** 2
    misfit = np.ones(count)
    moved = np.ones(count, np.bool_)
    work = np.empty((2, pixels.shape[2]), np.float32)
    neighbours = np.empty(count, np.int64)
    normal, right = np.empty((SIZE, SIZE)), np.empty(SIZE)
    for _ in range(MAX_ITERATIONS):
        still = True
        moves = np.zeros(count, np.bool_)
        for k in range(count):
            others, stale = 0, moved[k]
            for j in range(count):
                gap = (seeds[k, 0] - seeds[j, 0]) ** 2 + (seeds[k, 1] - seeds[j, 1]) ** 2
                if j != k and gap < near:
                    neighbours[others] = j
                    others += 1
                    stale |= moved[j]
            if not stale:
                continue
            _without_others(pixels[k], length[k], state, neighbours[:others], work)
            misfit[k] = _sum_up(pixels[k], length[k], work, state[k], normal, right)
            change = _improve(state[k], normal, right, radius)
            if change >= SETTLED_PX:
                moves[k] = True
                still = False
        moved = moves
        if still:
            break
    return misfit


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _gather(plate: LitPlate, seed: np.ndarray, radius: float, pixels: np.ndarray) -> int:
    """List the usable pixels around a seed: x, y [px], darkness; return how many."""
    grey, light, usable = plate
    height, width = grey.shape
    x0, y0 = int(np.rint(seed[0])), int(np.rint(seed[1]))
    reach = int(np.ceil(radius + RIM_PX))
    far = (radius + RIM_PX) ** 2
    count = 0
    for y in range(max(y0 - reach, 0), min(y0 + reach + 1, height)):
        for x in range(max(x0 - reach, 0), min(x0 + reach + 1, width)):
            if usable[y, x] and (x - x0) ** 2 + (y - y0) ** 2 <= far:
                pixels[0, count], pixels[1, count] = x, y
                pixels[2, count] = np.float32(1) - np.float32(grey[y, x]) / bare(light, x, y)
                count += 1
    return count


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _first_darkness(pixels: np.ndarray, size: int, seed: np.ndarray, radius: float) -> float:
    total, count = 0.0, 0
    for i in range(size):
        d2 = (pixels[0, i] - seed[0]) ** 2 + (pixels[1, i] - seed[1]) ** 2
        if d2 < (CORE * radius) ** 2:
            total += pixels[2, i]
            count += 1
    return max(total / max(count, 1), MIN_DARKNESS)


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _without_others(
    pixels: np.ndarray, size: int, state: np.ndarray, neighbours: np.ndarray, work: np.ndarray
) -> None:
    """Write darkness less that of the neighbours, and how little they cover, into `work`."""
    half, one = np.float32(0.5), np.float32(1)
    for i in range(size):
        work[0, i] = pixels[2, i]
        work[1, i] = one
    for j in neighbours:
        cx, cy = np.float32(state[j, 0]), np.float32(state[j, 1])
        square, scale = np.float32(state[j, 2] ** 2), np.float32(0.5 / (state[j, 2] * state[j, 3]))
        darkness = np.float32(state[j, 4])
        for i in range(size):
            dx, dy = pixels[0, i] - cx, pixels[1, i] - cy
            u = min(max((square - dx * dx - dy * dy) * scale, -one), one)
            cover = half + u * (np.float32(0.75) - np.float32(0.25) * u * u)
            work[0, i] -= darkness * cover
            work[1, i] *= one - cover


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _improve(disc: np.ndarray, normal: np.ndarray, right: np.ndarray, first_radius: float) -> float:
    """Make one step of a disc (SIZE,) by its normal equations; return the change [px]."""
    for i in range(SIZE):
        normal[i, i] = normal[i, i] * (1 + DAMPING) + DAMPING
        for j in range(i):
            normal[j, i] = normal[i, j]
    solve(normal, right)
    largest = max(abs(right[0]), abs(right[1]), abs(right[2]))
    step = min(1.0, MAX_STEP_PX / max(largest, 1e-9))
    for i in range(SIZE):
        disc[i] += step * right[i]
    disc[2] = min(max(disc[2], 0.5 * first_radius), 1.5 * first_radius)
    disc[3] = min(max(disc[3], EDGE_PX[0]), EDGE_PX[2])
    return largest


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _sum_up(
    pixels: np.ndarray,
    size: int,
    work: np.ndarray,
    disc: np.ndarray,
    normal: np.ndarray,
    right: np.ndarray,
) -> float:
    """Add up the normal equations, lower half, of one disc; return its misfit.

    How deep a pixel is inside is taken from the square of its distance, (r2 - d2) / 2r, which is
    r - d at the edge: no root, so that the loop runs on eight pixels at a time.
    """
    one, zero, quarter = np.float32(1), np.float32(0), np.float32(0.25)
    cx, cy, darkness = np.float32(disc[0]), np.float32(disc[1]), np.float32(disc[4])
    squared, scale = np.float32(disc[2] ** 2), np.float32(0.5 / (disc[2] * disc[3]))
    inverse, steep = np.float32(1 / disc[2]), np.float32(0.75 * disc[4] / disc[3])
    xx = xy = xr = xe = xd = yy = yr = ye = yd = rr = re = rd = ee = ed = dd = zero
    x0 = y0 = r0 = e0 = d0 = square = seen = zero
    for i in range(size):
        dx, dy, weight = pixels[0, i] - cx, pixels[1, i] - cy, work[1, i]
        u = min(max((squared - dx * dx - dy * dy) * scale, -one), one)
        cover = np.float32(0.5) + u * (np.float32(0.75) - quarter * u * u)
        error = (work[0, i] - darkness * cover) * weight
        # Slopes of the disc's darkness in centre, radius, edge width and darkness.
        gr, gd = steep * (one - u * u) * weight, cover * weight
        gx, gy, ge = gr * dx * inverse, gr * dy * inverse, -gr * u
        xx, xy, xr, xe, xd = xx + gx * gx, xy + gx * gy, xr + gx * gr, xe + gx * ge, xd + gx * gd
        yy, yr, ye, yd = yy + gy * gy, yr + gy * gr, ye + gy * ge, yd + gy * gd
        rr, re, rd = rr + gr * gr, re + gr * ge, rd + gr * gd
        ee, ed, dd = ee + ge * ge, ed + ge * gd, dd + gd * gd
        x0, y0, r0 = x0 + gx * error, y0 + gy * error, r0 + gr * error
        e0, d0 = e0 + ge * error, d0 + gd * error
        square, seen = square + error * error * gd, seen + gd
    normal[0, 0], normal[1, 0], normal[1, 1] = xx, xy, yy
    normal[2, 0], normal[2, 1], normal[2, 2] = xr, yr, rr
    normal[3, 0], normal[3, 1], normal[3, 2], normal[3, 3] = xe, ye, re, ee
    normal[4, 0], normal[4, 1], normal[4, 2], normal[4, 3] = xd, yd, rd, ed
    normal[4, 4] = dd
    right[0], right[1], right[2], right[3], right[4] = x0, y0, r0, e0, d0
    return np.sqrt(square / max(seen, one)) / max(disc[4], MIN_DARKNESS)
