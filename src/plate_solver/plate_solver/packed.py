"""What the compiled search needs to know of motions and limits, in one array."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from .harmonic_fit import Motions, Waves
from .harmonic_force import Rules


class Finish(NamedTuple):
    """What makes a motion a spline within the limits; as in `Harmonics` and `Bounds`.

    Attributes
    ----------
    times : (k + 1,)
        Knots [s].
    pose, twist, accel : (k + 1, h)
        The family there.
    spline : (6 k, h)
        Powers of the time since the knot.
    hull : (3 c, h)
        Control points of pose, twist and acceleration.
    points, directions : (4, 2)
        Motors [m].
    limits : (3,)
        Stroke [m], speed [m/s], acceleration [m/s2].
    """

    times: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    accel: np.ndarray
    spline: np.ndarray
    hull: np.ndarray
    points: np.ndarray
    directions: np.ndarray
    limits: np.ndarray


class Packed(NamedTuple):
    """`Motions` and `Finish` in one array: a compiled call takes some 2 us for every array it is
    given, when other work has come between.

    Attributes
    ----------
    numbers : (L,)
        All arrays one after the other; at the end, room for the samples of the finest grid.
    shapes : (20, 3)
        Where each begins, rows, columns; the last row has the first level of panels, and the nodes
        of the finest grid.
    """

    numbers: np.ndarray
    shapes: np.ndarray


def packed(motions: Motions, finish: Finish) -> Packed:
    """Pack what `meet` needs to know."""
    rule, *waves = motions.waves
    arrays = [*rule[:3], *waves, *motions[1:], *finish]
    rows = [np.atleast_2d(array) for array in arrays]
    starts = np.cumsum([0, *(row.size for row in rows)])
    shapes = [(a, *row.shape) for a, row in zip(starts[:-1], rows, strict=True)]
    room = np.zeros(5 * rule.most)
    return Packed(
        np.concatenate([*(row.ravel() for row in rows), room]),
        np.array([*shapes, (starts[-1], rule.first, rule.most)]),
    )


@njit(cache=True)
def _array(numbers: np.ndarray, shapes: np.ndarray, which: int) -> np.ndarray:
    start, rows, columns = shapes[which]
    return numbers[start : start + rows * columns].reshape(rows, columns)


@njit(cache=True)
def unpacked(numbers: np.ndarray, shapes: np.ndarray) -> tuple[Motions, Finish, np.ndarray]:
    """Return what `packed` was given, as views, and the room (5, n)."""

    def of(which: int) -> np.ndarray:
        return _array(numbers, shapes, which)

    room, first, most = shapes[-1]
    rule = Rules(of(0), of(1)[0], of(2)[0].astype(np.int64), first, most)
    motions = Motions(Waves(rule, of(3), of(4)[0]), of(5), of(6), of(7), of(8), of(9)[0], of(10)[0])
    finish = Finish(of(11)[0], of(12), of(13), of(14), of(15), of(16), of(17), of(18), of(19)[0])
    return motions, finish, numbers[room:].reshape(5, most)
