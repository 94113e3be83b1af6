"""The order of rotations in a sequence.

Sums of forces do not depend on it, real motions do: each change of twist takes time, the plate must
stay within its stroke, and parts move meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
from numba import njit

SWEEPS = 20
"""Most sweeps of 2-opt; four do as a rule."""


def nearest_order(twists: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the order (J,) of twists (J, 3) in which little changes from one to the next.

    Changes are those of the plate's fastest corner: they are what ramps cost. From rest the nearest
    neighbour is taken each time, then stretches are turned round as long as that shortens the tour.
    """
    return _tour(_changes(np.vstack([np.zeros(3), twists]), np.asarray(half, dtype=float))) - 1


def best_order(
    error: Callable[[np.ndarray], float], first: np.ndarray, tries: int, rng: np.random.Generator
) -> np.ndarray:
    """Return an order of small simulated error: random changes, kept where they lessen it.

    Parameters
    ----------
    error : function
        Order (J,) to error.
    first : (J,)
        Where to start.
    tries : int
        Evaluations.
    rng : numpy.random.Generator
    """
    best, least = np.array(first), error(first)
    for _ in range(tries if len(first) > 1 else 0):
        i, j = np.sort(rng.choice(len(first), 2, replace=False))
        other = best.copy()
        if rng.random() < 0.5:
            other[i : j + 1] = other[i : j + 1][::-1]
        else:
            other[[i, j]] = other[[j, i]]
        value = error(other)
        if value < least:
            best, least = other, value
    return best


@njit(cache=True, fastmath=True)
def _changes(twists: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the change (J, J) [m/s] of the fastest corner between any two twists."""
    count = len(twists)
    change = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            d = twists[i] - twists[j]
            most = 0.0
            for x in (-half[0], half[0]):
                for y in (-half[1], half[1]):
                    most = max(most, (d[0] - d[2] * y) ** 2 + (d[1] + d[2] * x) ** 2)
            change[i, j] = change[j, i] = sqrt(most)
    return change


@njit(cache=True)
def _tour(change: np.ndarray) -> np.ndarray:
    """Return a short closed tour that begins at 0, without its beginning."""
    count = len(change)
    tour = np.zeros(count + 1, np.int64)
    free = np.ones(count, np.bool_)
    for k in range(1, count):
        free[tour[k - 1]] = False
        best = np.inf
        for j in range(count):
            if free[j] and change[tour[k - 1], j] < best:
                best, tour[k] = change[tour[k - 1], j], j
    for _ in range(SWEEPS):
        improved = False
        for i in range(1, count - 1):
            for j in range(i + 1, count):
                a, b, c, d = tour[i - 1], tour[i], tour[j], tour[j + 1]
                if change[a, c] + change[b, d] < change[a, b] + change[c, d] - 1e-12:
                    tour[i : j + 1] = tour[i : j + 1][::-1].copy()
                    improved = True
        if not improved:
            break
    return tour[1:count]
