"""Samples of a part's motion between the ends of integration steps.

`grid` is the samples' distance [s] and their number per cycle, `done` the cycles already behind,
and j the next sample; times t count from the start of the present cycle, and so does the fall of
the frame by `pull` (2,) [m/s2] that is added (see `motion`).
"""

from __future__ import annotations

from numba import njit

from .motion import riding


@njit(cache=True, error_model="numpy")
def emit_held(table, t, until, k, qx, qy, done, grid, pull, j, path, speed):
    """Write the samples of a part stuck at q from t to `until`; return the next sample."""
    while j < len(path) - 1:
        at = (j - done * grid[1]) * grid[0]
        if at > until:
            break
        k, path[j, 0], path[j, 1], speed[j, 0], speed[j, 1], _, _ = riding(table, at, k, qx, qy)
        fall(at, pull, path[j], speed[j])
        j += 1
    return j


@njit(cache=True, error_model="numpy")
def fall(t, pull, place, speed):
    """Add to a place and velocity (2,) what a freely falling frame has gained after t [s]."""
    for d in range(2):
        place[d] += 0.5 * t * t * pull[d]
        speed[d] += t * pull[d]


@njit(cache=True, error_model="numpy")
def emit(
    t, h, px, py, vx, vy, fx, fy, x, y, ux, uy, gx, gy, done, grid, pull, j, path, speed
):  # fmt: skip
    """Write the samples of a sliding step: the quintic through both ends' p, v and v'."""
    if j >= len(path) - 1 or (j - done * grid[1]) * grid[0] > t + h:
        return j
    hh = h * h
    dx, dy = x - px - h * vx - 0.5 * hh * fx, y - py - h * vy - 0.5 * hh * fy
    sx, sy = h * (ux - vx - h * fx), h * (uy - vy - h * fy)
    bx, by = hh * (gx - fx), hh * (gy - fy)
    x3, x4, x5 = 10 * dx - 4 * sx + 0.5 * bx, -15 * dx + 7 * sx - bx, 6 * dx - 3 * sx + 0.5 * bx
    y3, y4, y5 = 10 * dy - 4 * sy + 0.5 * by, -15 * dy + 7 * sy - by, 6 * dy - 3 * sy + 0.5 * by
    while j < len(path) - 1:
        tau = (j - done * grid[1]) * grid[0] - t
        if tau > h:
            break
        u = tau / h
        cube = u * u / h
        path[j, 0] = px + tau * (vx + 0.5 * tau * fx) + u * u * u * (x3 + u * (x4 + u * x5))
        path[j, 1] = py + tau * (vy + 0.5 * tau * fy) + u * u * u * (y3 + u * (y4 + u * y5))
        speed[j, 0] = vx + tau * fx + cube * (3 * x3 + u * (4 * x4 + u * 5 * x5))
        speed[j, 1] = vy + tau * fy + cube * (3 * y3 + u * (4 * y4 + u * 5 * y5))
        fall(t + tau, pull, path[j], speed[j])
        j += 1
    return j
