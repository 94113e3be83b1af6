"""Round parts on the moving plate: friction, collisions, and the plate's edge.

Parts are discs of equal mass and radius. Two that touch lose the speed with which they close in
(an inelastic impulse along the line of centres), and are moved apart where they overlap; both
keep the pair's centre of mass, and neither adds kinetic energy. Rims do not rub. A part whose
centre passes the plate's edge is gone: it moves no more and touches nothing.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from .friction import friction_step  # numba does not see changes there: delete the cache then

SWEEPS = 8
"""Gauss-Seidel passes over the touching pairs of one step, at most."""

OVERLAP = 1e-6
"""Overlap [m] that ends the passes: a thousandth of a pixel."""

SKIN = 4e-3
"""Pairs closer than this [m] are watched; while none has moved so far, all others are safe."""


@njit(cache=True)
def run_discs(pose, twist, step, limit, radius, half, position, velocity, on_plate, path, speed):
    """Advance discs through one cycle, in place.

    Parameters
    ----------
    pose, twist : (n + 1, 3)
        Plate at the ends of n equal steps.
    step : float
        Length of a step [s].
    limit : (M,)
        mu g of each part [m/s2].
    radius : float
        Of all parts [m]; 0 means that they never touch.
    half : (2,)
        Half sides of the plate [m].
    position, velocity : (M, 2)
        Parts in plate_home; changed.
    on_plate : (M,)
        Which parts are there; changed.
    path, speed : (n + 1, M, 2) or (0, M, 2)
        Filled with the motion, unless empty.
    """
    count = len(position)
    pairs = np.empty((count * (count - 1) // 2, 2), np.int64)
    found = 0
    slack = 0.0  # what is left of SKIN until a pair not in the list may touch
    for k in range(len(pose) - 1):
        if len(path):
            path[k], speed[k] = position, velocity
        fastest2 = 0.0
        for i in range(count):
            if not on_plate[i]:
                continue
            px, py, vx, vy = friction_step(
                position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1],
                pose, twist, k, step, limit[i],
            )  # fmt: skip
            before2 = velocity[i, 0] ** 2 + velocity[i, 1] ** 2
            fastest2 = max(fastest2, before2, vx * vx + vy * vy)
            position[i, 0], position[i, 1] = px, py
            velocity[i, 0], velocity[i, 1] = vx, vy
        if radius > 0:
            slack -= 2 * step * sqrt(fastest2)
            if slack <= 0:
                found = _near_pairs(position, on_plate, 2 * radius + SKIN, pairs)
                slack = SKIN
            slack -= 2 * _separate(position, velocity, on_plate, pairs, found, radius)
        _drop(pose[k + 1], half, position, velocity, on_plate)
    if len(path):
        path[-1], speed[-1] = position, velocity


@njit(cache=True)
def _near_pairs(position, on_plate, reach, pairs):
    """List the pairs whose centres are closer than `reach` [m]; return how many."""
    found = 0
    for i in range(len(position)):
        for j in range(i):
            dx = position[i, 0] - position[j, 0]
            dy = position[i, 1] - position[j, 1]
            if on_plate[i] and on_plate[j] and dx * dx + dy * dy < reach * reach:
                pairs[found, 0], pairs[found, 1] = i, j
                found += 1
    return found


@njit(cache=True)
def _separate(position, velocity, on_plate, pairs, found, radius):
    """End closing speeds and overlaps of touching pairs; return the summed displacement [m]."""
    moved = 0.0
    for _ in range(SWEEPS):
        deepest = 0.0
        for k in range(found):
            i, j = pairs[k, 0], pairs[k, 1]
            dx = position[i, 0] - position[j, 0]
            dy = position[i, 1] - position[j, 1]
            distance2 = dx * dx + dy * dy
            if distance2 >= 4 * radius * radius or not (on_plate[i] and on_plate[j]):
                continue
            distance = sqrt(distance2)
            # Two centres in one point have no line; any direction will do.
            nx, ny = (dx / distance, dy / distance) if distance > 0 else (1.0, 0.0)
            overlap = 2 * radius - distance
            deepest = max(deepest, overlap)
            closing = (velocity[i, 0] - velocity[j, 0]) * nx
            closing += (velocity[i, 1] - velocity[j, 1]) * ny
            impulse = max(0.0, -0.5 * closing)
            _exchange(velocity, i, j, impulse * nx, impulse * ny)
            _exchange(position, i, j, 0.5 * overlap * nx, 0.5 * overlap * ny)
            moved += 0.5 * overlap
        if deepest <= OVERLAP:
            break
    return moved


@njit(cache=True)
def _exchange(array, i, j, x, y):
    array[i, 0] += x
    array[i, 1] += y
    array[j, 0] -= x
    array[j, 1] -= y


@njit(cache=True)
def _drop(pose, half, position, velocity, on_plate):
    """Take parts whose centre is beyond the edge off the plate."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    for i in range(len(position)):
        if not on_plate[i]:
            continue
        x, y = position[i, 0] - pose[0], position[i, 1] - pose[1]
        if abs(cos * x + sin * y) > half[0] or abs(cos * y - sin * x) > half[1]:
            on_plate[i] = False
            velocity[i] = 0.0
