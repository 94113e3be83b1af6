"""Proof that no motion of N harmonics meets a request.

N + 1 equal time steps integrate harmonics up to the N-th exactly. Therefore the N + 1 twists
s_0..s_N of a closed motion, at times that are T/(N + 1) apart, add up to zero. If the first of
these times varies over the period, the forces of any such motion are a mean of

    (n(s_0) + ... + n(s_N)) / (N + 1)   with   s_0 + ... + s_N = 0,

where the vector n(s) contains the unit vectors of all parts' slips. These forces form a convex set.
A request is infeasible if a vector lambda separates it from this set: lambda . force > h(lambda),
where h is the support function. Let g(s) = lambda . n(s). g is an odd function, and it does not
depend on the magnitude of s. Consider two twists s_1 and s_2, and a twist m between them on a great
circle. Let T be the maximum of g(s_1) + g(s_2) - g(m) over all such twists. T is the value of three
twists that add up to zero. By Caratheodory's theorem, zero is a mean of at most four of the twists.
Four twists are equivalent to two triples with a common m, so

    h(lambda) <= (N - 1)/(N + 1) T(lambda).

For one part T is 1, which gives the known bound (N - 1)/(N + 1). The search for lambda uses a
coarse grid of twists. The proof does not rely on these samples: it bounds T over cells, which are
sets of great circles. Cells are subdivided until the bound is below the request. If there is no
proof, the request may still be infeasible, because the convex set is larger than the set of forces
of N harmonics.
"""

from __future__ import annotations

from functools import lru_cache
from math import pi

import numpy as np
from scipy.optimize import nnls

from .. import _kernels

SAME = 1e-6
"""Forces that differ by less than this value count as equal [mu m g]."""

ROUNDS = 10
"""Maximum number of directions lambda that are tried. Most feasible requests are recognised
earlier."""

SPACING = 0.12
"""Spacing [rad] of the great circles' normals."""

WITHIN = 1e-2
"""A request counts as feasible if it differs from a mean of forces in the convex set by less than
this fraction of the request."""

PENALTY = 30.0
"""Weight of the equation that requires the sum of the fractions of a mean to be one."""


def is_out_of_reach(position: np.ndarray, force: np.ndarray, number: int, arm_m: float) -> bool:
    """Return whether it is proven that no motion of `number` harmonics exerts these forces on parts
    at rest.

    Parameters
    ----------
    position, force : (M, 2)
        Positions of the parts [m], plate_home; average forces [mu m g].
    number : int
        Number of harmonics N, at least 1.
    arm_m : float
        Length that converts rotations to translations [m]. Any positive value is valid.
    """
    sizes = np.hypot(force[:, 0], force[:, 1])
    if np.max(sizes) > (number - 1) / (number + 1) + 1e-9:
        return True
    requested = force.ravel()
    if not np.any(requested) or len(position) == 1:
        return False
    if number < 2 or _apart(position, force):
        return True
    most = (number - 1) / (number + 1)
    cells = _cells()
    vectors = _vectors(_circles(cells), position, arm_m)
    found: list[np.ndarray] = []
    separating = requested / np.linalg.norm(requested)
    for _ in range(ROUNDS):
        bound, three = _best(vectors @ separating)
        if separating @ requested > most * bound:
            return _proves(cells, position, arm_m, separating, separating @ requested / most)
        force = most * sum(vectors[three[0], k] for k in three[1:])
        found += [force, -force]
        # Compute the weighted mean of the vectors in `found` that is nearest to the request. The
        # additional zero vector permits weights with a sum below 1.
        columns = np.column_stack([*found, np.zeros(len(requested))])
        fractions, _ = nnls(
            np.vstack([columns, np.full(columns.shape[1], PENALTY)]), np.append(requested, PENALTY)
        )
        missing = requested - columns @ fractions
        size = float(np.linalg.norm(missing))
        if size < WITHIN * float(np.linalg.norm(requested)):
            return False
        separating = missing / size
    return False


def _apart(position: np.ndarray, force: np.ndarray) -> bool:
    """Whether different forces are requested at the same position."""
    i, j = np.triu_indices(len(position), 1)
    one_place = np.all(position[i] == position[j], axis=1)
    return bool(np.any(np.abs(force[i] - force[j])[one_place] > SAME))


@lru_cache(maxsize=1)
def _cells() -> np.ndarray:
    """Return cells (Q, 4) that cover half the sphere of normals. The columns are the lowest and
    highest tilt and the lowest and highest rotation [rad]."""
    bands = int(np.ceil(pi / 2 / SPACING))
    cells = []
    for band in range(bands):
        low, high = pi / 2 * band / bands, pi / 2 * (band + 1) / bands
        count = int(np.ceil(2 * pi * np.sin(high) / SPACING))
        turn = 2 * pi * np.arange(count + 1) / count
        cells += [(low, high, turn[i], turn[i + 1]) for i in range(count)]
    return np.array(cells)


def _circles(cells: np.ndarray) -> np.ndarray:
    """Return the great circle (C, 3) in the middle of each cell (Q, 4). The result is (Q, C, 3)."""
    return _kernels.circles(cells)


def _vectors(twists: np.ndarray, position: np.ndarray, arm_m: float) -> np.ndarray:
    """Return unit slip vectors (Q, C, 2 M) of twists (Q, C, 3) in units of (1, 1, 1/arm_m)."""
    return _kernels.unit_slips(twists, position, arm_m)


def _best(value: np.ndarray) -> tuple[float, tuple[int, int, int, int]]:
    """Return the maximum of T over great circles with values (Q, C), the index of the circle, and
    the indices of its three points."""
    return _kernels.best_triple(value)


def _proves(
    cells: np.ndarray, position: np.ndarray, arm_m: float, separating: np.ndarray, limit: float
) -> bool:
    """Return whether T is proven to be below a limit on all great circles. Each cell is checked."""
    return _kernels.proves(cells, position, arm_m, separating, limit)
