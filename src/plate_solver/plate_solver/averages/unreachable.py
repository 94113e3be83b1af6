"""Proof that no motion of N harmonics meets a request.

Let s_0..s_N be the twists of a closed motion at N + 1 times that are T_p/(N + 1) apart, where T_p
is the period. N + 1 equal time steps integrate harmonics up to the N-th exactly. Therefore,
s_0..s_N add up to zero. The first of these times can have any value in the period. By averaging
over this time, the average forces of the motion are a mean of

    (n(s_0) + ... + n(s_N)) / (N + 1)   with   s_0 + ... + s_N = 0,

where the vector n(s) contains the unit vectors of the slips of all parts. All such means together
form a convex set of forces. A request is infeasible if a vector lambda separates it from this set,
lambda . force > h(lambda). h is the support function of the set, that is, the maximum of lambda .
force over the set.

Let g(s) = lambda . n(s). g is an odd function, and it does not depend on the magnitude of s.
Consider two twists s_1 and s_2, and a twist m between them on a great circle. Let T be the maximum
of g(s_1) + g(s_2) - g(m) over all such twists. T is also the maximum of g(s_1) + g(s_2) + g(s_3)
over three twists that add up to zero. By Caratheodory's theorem, zero is a weighted mean of at most
four of the N + 1 twists. Four twists are equivalent to two groups of three twists with a common m.
This gives

    h(lambda) <= (N - 1)/(N + 1) T(lambda).

For one part, T is 1, which gives the known bound (N - 1)/(N + 1).

The search for lambda evaluates only a coarse grid of twists. The proof does not depend on this
grid. The proof computes an upper bound of T over cells, which are sets of great circles. Cells are
subdivided until this bound is below the request. If no proof is found, the request may still be
infeasible, because the convex set is larger than the set of forces of N harmonics.
"""

from __future__ import annotations

from functools import lru_cache
from math import pi

import numpy as np
from scipy.optimize import nnls

from .. import _kernels

SAME = 1e-6
"""Two requested forces that differ by less than this value count as equal [mu m g]."""

ROUNDS = 10
"""Maximum number of vectors lambda that are tried. Most feasible requests are recognised with fewer
vectors."""

SPACING = 0.12
"""Angle between neighbouring normals of the great circles [rad]."""

WITHIN = 1e-2
"""A request counts as feasible if its distance from the convex set is less than this fraction of
the request."""

PENALTY = 30.0
"""The weights of a weighted mean must have the sum 1. This value is the weight with which a
least-squares problem enforces the sum 1."""


def is_out_of_reach(position: np.ndarray, force: np.ndarray, number: int, arm_m: float) -> bool:
    """Return whether it is proven that no motion with `number` harmonics exerts the forces `force`
    on parts at rest.

    Parameters
    ----------
    position, force : (M, 2)
        Positions of the parts [m, plate_home], and average forces [mu m g].
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
    factor = (number - 1) / (number + 1)
    cells = _cells()
    vectors = _vectors(_circles(cells), position, arm_m)
    found: list[np.ndarray] = []
    separating = requested / np.linalg.norm(requested)
    for _ in range(ROUNDS):
        bound, three = _best(vectors @ separating)
        if separating @ requested > factor * bound:
            return _proves(cells, position, arm_m, separating, separating @ requested / factor)
        force = factor * sum(vectors[three[0], k] for k in three[1:])
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
    """Whether different forces are requested on parts at the same position."""
    i, j = np.triu_indices(len(position), 1)
    one_place = np.all(position[i] == position[j], axis=1)
    return bool(np.any(np.abs(force[i] - force[j])[one_place] > SAME))


@lru_cache(maxsize=1)
def _cells() -> np.ndarray:
    """Return cells (Q, 4) of normals of great circles. Together, they cover half a sphere. The
    columns are the minimum and maximum tilt, and the minimum and maximum rotation [rad]."""
    bands = int(np.ceil(pi / 2 / SPACING))
    cells = []
    for band in range(bands):
        low, high = pi / 2 * band / bands, pi / 2 * (band + 1) / bands
        count = int(np.ceil(2 * pi * np.sin(high) / SPACING))
        angle = 2 * pi * np.arange(count + 1) / count
        cells += [(low, high, angle[i], angle[i + 1]) for i in range(count)]
    return np.array(cells)


def _circles(cells: np.ndarray) -> np.ndarray:
    """Return C points on the great circle whose normal is in the middle of each cell (Q, 4). The
    result has the shape (Q, C, 3)."""
    return _kernels.circles(cells)


def _vectors(twists: np.ndarray, position: np.ndarray, arm_m: float) -> np.ndarray:
    """Return the unit vectors of the slips of M parts (Q, C, 2 M) for the twists `twists` (Q, C,
    3). The components of the twists have the units (1, 1, 1/arm_m)."""
    return _kernels.unit_slips(twists, position, arm_m)


def _best(value: np.ndarray) -> tuple[float, tuple[int, int, int, int]]:
    """Return the maximum of T over Q great circles, the index of the circle with this maximum, and
    the indices of its three points. `value` (Q, C) contains g at C points of each circle."""
    return _kernels.best_triple(value)


def _proves(
    cells: np.ndarray, position: np.ndarray, arm_m: float, separating: np.ndarray, limit: float
) -> bool:
    """Check all cells. Return whether T is proven to be below `limit` on all great circles."""
    return _kernels.proves(cells, position, arm_m, separating, limit)
