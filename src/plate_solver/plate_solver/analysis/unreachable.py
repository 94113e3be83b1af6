"""What no motion of N harmonics can do: a proof that a request is out of reach.

N + 1 equal steps integrate harmonics up to the N-th exactly, so the twists s_0..s_N of a closed
motion at times T/(N + 1) apart add up to zero. Averaged over the first of these times, the forces
of any such motion are a mean of

    (n(s_0) + ... + n(s_N)) / (N + 1)   with   s_0 + ... + s_N = 0,

n(s) the parts' unit vectors of slip, all in one vector. So they lie in a convex set, and a request
is out of reach if some lambda separates it: lambda . force > h(lambda), the support function. Let
g(s) = lambda . n(s), which is odd and free of scale, and T the greatest of g(s_1) + g(s_2) - g(m)
with m between s_1 and s_2 on a great circle: what three twists can do that add up to zero. By
Caratheodory's theorem zero is a mean of two, three or four of the twists. Four are two triples with
a common m, so

    h(lambda) <= (N - 1)/(N + 1) T(lambda).

For one part T is one: the known (N - 1)/(N + 1). Lambda is looked for on a coarse grid of twists;
the proof is not one by samples: T is bounded over whole cells of great circles, which are halved
until they are below what is asked. What is not proven may still be out of reach: the set is larger
than what N harmonics can do.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, hypot, pi, sin, sqrt

import numpy as np
from scipy.optimize import nnls

from plate_core.kernels import kernel

SAME = 1e-6
"""Forces [mu m g] that differ by less are the same."""

ROUNDS = 10
"""Directions lambda that are tried; most requests are found within the set sooner."""

SPACING, POINTS = 0.12, 48
"""Spacing [rad] of the great circles' normals, and points on each."""

HALVINGS = 4
"""Times that a cell of great circles is halved in a proof at most."""

MOST_WORK = 2e8
"""Pairs of points that a proof looks at before it is given up: some tenths of a second."""

WITHIN = 1e-2
"""Fraction of a request that may be missing from a mean of found forces, to be within the set."""

PENALTY = 30.0
"""Weight of the row that keeps the fractions of a mean below one."""


def is_out_of_reach(position: np.ndarray, force: np.ndarray, number: int, arm_m: float) -> bool:
    """Whether it is proven that no motion of `number` harmonics gives parts at rest these forces.

    Parameters
    ----------
    position, force : (M, 2)
        Parts [m], plate_home; average forces [mu m g].
    number : int
        N, at least 1.
    arm_m : float
        Length [m] that makes turns comparable to shifts; any is right.
    """
    sizes = np.hypot(force[:, 0], force[:, 1])
    if np.max(sizes) > (number - 1) / (number + 1) + 1e-9:
        return True
    wanted = force.ravel()
    if not np.any(wanted) or len(position) == 1:
        return False
    if number < 2 or _apart(position, force):
        return True
    most = (number - 1) / (number + 1)
    cells = _cells()
    vectors = _vectors(_circles(cells), position, arm_m)
    found: list[np.ndarray] = []
    separating = wanted / np.linalg.norm(wanted)
    for _ in range(ROUNDS):
        bound, three = _best(vectors @ separating)
        if separating @ wanted > most * bound:
            return bool(_proves(cells, position, arm_m, separating, separating @ wanted / most))
        force = most * sum(vectors[three[0], k] for k in three[1:])
        found += [force, -force]
        # The nearest mean of what is found, with fractions of at most one in all.
        columns = np.column_stack([*found, np.zeros(len(wanted))])
        fractions, _ = nnls(
            np.vstack([columns, np.full(columns.shape[1], PENALTY)]), np.append(wanted, PENALTY)
        )
        missing = wanted - columns @ fractions
        size = float(np.linalg.norm(missing))
        if size < WITHIN * float(np.linalg.norm(wanted)):
            return False
        separating = missing / size
    return False


def _apart(position: np.ndarray, force: np.ndarray) -> bool:
    """Whether parts in one place are asked for different forces."""
    i, j = np.triu_indices(len(position), 1)
    one_place = np.all(position[i] == position[j], axis=1)
    return bool(np.any(np.abs(force[i] - force[j])[one_place] > SAME))


@lru_cache(maxsize=1)
def _cells() -> np.ndarray:
    """Return cells (Q, 4) that cover half the sphere of normals: tilt from, to, turn from, to."""
    bands = int(np.ceil(pi / 2 / SPACING))
    cells = []
    for band in range(bands):
        low, high = pi / 2 * band / bands, pi / 2 * (band + 1) / bands
        count = int(np.ceil(2 * pi * np.sin(high) / SPACING))
        turn = 2 * pi * np.arange(count + 1) / count
        cells += [(low, high, turn[i], turn[i + 1]) for i in range(count)]
    return np.array(cells)


@kernel(error_model="numpy")
def _circle(tilt: float, turn: float, points: np.ndarray) -> None:
    """Write points (C, 3) of the great circle with the given normal, at equal angles."""
    for c in range(len(points)):
        angle = 2 * pi * c / len(points)
        a, b = cos(angle), sin(angle)
        points[c, 0] = a * cos(tilt) * cos(turn) - b * sin(turn)
        points[c, 1] = a * cos(tilt) * sin(turn) + b * cos(turn)
        points[c, 2] = -a * sin(tilt)


@kernel()
def _circles(cells: np.ndarray) -> np.ndarray:
    """Return the great circles (Q, C, 3) of the middles of cells."""
    circles = np.empty((len(cells), POINTS, 3))
    for q in range(len(cells)):
        low, high, left, right = cells[q]
        _circle((low + high) / 2, (left + right) / 2, circles[q])
    return circles


@kernel(error_model="numpy")
def _vectors(twists: np.ndarray, position: np.ndarray, arm_m: float) -> np.ndarray:
    """Return unit slips (Q, C, 2 M) of twists (Q, C, 3) in units of (1, 1, 1/arm_m)."""
    vectors = np.zeros((twists.shape[0], twists.shape[1], 2 * len(position)))
    for q in range(twists.shape[0]):
        for c in range(twists.shape[1]):
            spin = twists[q, c, 2] / arm_m
            for i in range(len(position)):
                wx = twists[q, c, 0] - spin * position[i, 1]
                wy = twists[q, c, 1] + spin * position[i, 0]
                size = hypot(wx, wy)
                if size > 0:
                    vectors[q, c, 2 * i], vectors[q, c, 2 * i + 1] = wx / size, wy / size
    return vectors


@kernel(error_model="numpy")
def _upper(
    points: np.ndarray,
    position: np.ndarray,
    arm_m: float,
    separating: np.ndarray,
    radius: float,
    most: np.ndarray,
) -> None:
    """Write bounds (C,) of lambda . n over all twists within `radius` [rad] of points (C, 3)."""
    most[:] = 0.0
    for i in range(len(position)):
        lx, ly = separating[2 * i], separating[2 * i + 1]
        weight = hypot(lx, ly)
        if weight == 0:
            continue
        reach = radius * sqrt(1 + (position[i, 0] ** 2 + position[i, 1] ** 2) / arm_m**2)
        for c in range(len(points)):
            spin = points[c, 2] / arm_m
            wx = points[c, 0] - spin * position[i, 1]
            wy = points[c, 1] + spin * position[i, 0]
            square = wx * wx + wy * wy
            if square <= reach * reach:
                most[c] += weight
                continue
            # The angle to lambda, less the most that the slip may turn within the radius.
            along, across = lx * wx + ly * wy, abs(lx * wy - ly * wx)
            free = sqrt(square - reach * reach)
            if along > 0 and across * free <= along * reach:
                most[c] += weight
            else:
                most[c] += (along * free + across * reach) / square


@kernel(error_model="numpy")
def _triple(v: np.ndarray, running: np.ndarray, where: np.ndarray) -> tuple[float, int, int, int]:
    """Return T of values (C,) around a great circle, and the three places.

    The value opposite to the middle one stands for minus it, so that bounds remain bounds; the
    angle between the outer two may be half a turn and a step, for points between those given.
    """
    points = len(v)
    half = points // 2
    triple, one, two, three = -np.inf, 0, 0, 0
    for m in range(points):
        against = v[(m + half) % points]
        for a in range(half + 2):
            k = m - a if m >= a else m - a + points
            if a == 0 or v[k] > running[a - 1]:
                running[a], where[a] = v[k], k
            else:
                running[a], where[a] = running[a - 1], where[a - 1]
        for a in range(half + 2):
            k = m + a if m + a < points else m + a - points
            total = v[k] + running[half + 1 - a] + against
            if total > triple:
                triple, one, two, three = total, k, where[half + 1 - a], (m + half) % points
    return triple, one, two, three


@kernel(error_model="numpy")
def _best(value: np.ndarray) -> tuple[float, tuple[int, int, int, int]]:
    """Return T of values (Q, C) on great circles: circle, and three points on it."""
    triple, places = -np.inf, (0, 0, 0, 0)
    running, where = np.empty(value.shape[1]), np.empty(value.shape[1], np.int64)
    for q in range(len(value)):
        most, one, two, three = _triple(value[q], running, where)
        if most > triple:
            triple, places = most, (q, one, two, three)
    return triple, places


@kernel(error_model="numpy")
def _proves(
    cells: np.ndarray, position: np.ndarray, arm_m: float, separating: np.ndarray, limit: float
) -> bool:
    """Whether T is less than a limit on all great circles, cell by cell."""
    finest = POINTS * 2**HALVINGS
    points, most = np.empty((finest, 3)), np.empty(finest)
    running, where = np.empty(finest), np.empty(finest, np.int64)
    waiting = np.empty((4 * HALVINGS + 4, 5))
    work = 0.0
    for q in range(len(cells)):
        waiting[0, :4] = cells[q]
        waiting[0, 4] = 0
        count = 1
        while count:
            count -= 1
            low, high, left, right, level = waiting[count]
            n = POINTS * 2 ** int(level)
            work += n * n
            _circle((low + high) / 2, (left + right) / 2, points[:n])
            # Farthest normal of the cell from its middle, and half a step along the circle.
            widest = max(sin(low), sin(high)) if high < pi / 2 else 1.0
            radius = hypot(high - low, widest * (right - left)) / 2 + pi / n
            _upper(points[:n], position, arm_m, separating, radius, most[:n])
            if _triple(most[:n], running, where)[0] < limit:
                continue
            if level == HALVINGS or work > MOST_WORK:
                return False
            tilt, turn = (low + high) / 2, (left + right) / 2
            for a, b in ((low, tilt), (tilt, high)):
                for c, d in ((left, turn), (turn, right)):
                    waiting[count] = (a, b, c, d, level + 1)
                    count += 1
    return True
