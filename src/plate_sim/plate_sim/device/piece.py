"""The pieces between knots: their quintics, and whether they keep the limits (firmware/piece.c).

All in the order and the single precision of the firmware, so that both play the same bits and come
to the same answer in the same tick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core.serial_protocol import Knot

from .limits import DeviceLimits

TICK_S = np.float32(1e-8)
"""Unit of a knot's time [s]."""

HALVINGS = 12
"""Most halvings of a curve until its hull decides about a limit: it closes in by 4 each time."""

MOST_HALVINGS = 64
"""Most halvings of all curves of a piece."""

PIECE_WORK = 8
"""Work of checking a piece, beside its halvings, which are 1 each."""


@dataclass(frozen=True)
class PieceCheck:
    """What checking a piece gives.

    Attributes
    ----------
    halvings : int
        Of its curves, until the answer is certain.
    keeps : bool
        Whether the limits of motion and force are kept.
    heat : (4,)
        Integral of each motor's force squared [N2 s], float32.
    """

    halvings: int
    keeps: bool
    heat: np.ndarray


def states_of(knots: list[Knot]) -> np.ndarray:
    """Return position, speed and acceleration of k knots (3, k, 4), float32."""
    states = [(knot.position, knot.velocity, knot.acceleration) for knot in knots]
    return np.array(states, np.float32).transpose(1, 0, 2)


def lengths(ticks: np.ndarray) -> np.ndarray:
    """Return the lengths of pieces (k,) [s], float32, from the times of their ends [TICK_S]."""
    return np.asarray(np.diff(ticks).astype(np.float32) * TICK_S)


def check_pieces(ticks: np.ndarray, states: np.ndarray, limits: DeviceLimits) -> list[PieceCheck]:
    """Check the pieces between k + 1 knots against the limits.

    Parameters
    ----------
    ticks : (k + 1,)
        Rising [TICK_S].
    states : (3, k + 1, 4)
        Position, speed and acceleration of the motors, float32.
    """
    h = lengths(ticks)[:, None]
    with np.errstate(all="ignore"):  # wild tables overflow, and are refused for it
        curves = _hulls(h, *states)
        force = limits.forces(curves[2])
        curves.append(force)
        heat = _mean_square(force) * h
        count = np.zeros(len(h), int)
        certain = np.ones(len(h), bool)
        for points, bound in zip(curves, limits.bounds, strict=True):
            _count(points, bound, count, certain)
        found = []
        for k in range(len(h)):
            halvings, keeps = int(count[k]), bool(certain[k]) and count[k] <= MOST_HALVINGS
            if not keeps:
                halvings = _halvings_to_refusal([points[:, k] for points in curves], limits.bounds)
            found.append(PieceCheck(halvings, keeps, heat[k]))
    return found


def coefficients(ticks: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return the pieces' quintics and their first two derivatives by s = t/h, highest power first.

    Returns
    -------
    (6, k, 3, 4)
        Float32 [m].
    """
    h = lengths(ticks)[:, None]
    half = np.float32(0.5)
    q, v, a = states
    c0, c1, c2 = q[:-1], h * v[:-1], half * h * h * a[:-1]
    # What the left end's Taylor polynomial misses at the right end
    dp = q[1:] - c0 - c1 - c2
    dv = h * v[1:] - c1 - 2 * c2
    da = h * h * a[1:] - 2 * c2
    c3 = 10 * dp - 4 * dv + half * da
    c4 = -15 * dp + 7 * dv - da
    c5 = 6 * dp - 3 * dv + half * da
    no = np.zeros_like(c0)
    powers = [
        [c5, c4, c3, c2, c1, c0],
        [no, 5 * c5, 4 * c4, 3 * c3, 2 * c2, c1],
        [no, no, 20 * c5, 12 * c4, 6 * c3, 2 * c2],
    ]
    return np.array(powers).transpose(1, 2, 0, 3)


def _hulls(h: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> list[np.ndarray]:
    """Bezier points of position, speed, acceleration: (6, k, 4), (5, k, 4), (4, k, 4)."""
    va, vb = h * v[:-1] / 5, h * v[1:] / 5
    aa, ab = h * h * a[:-1] / 20, h * h * a[1:] / 20
    pa, pb = q[:-1], q[1:]
    step = pb - pa
    position = [pa, pa + va, pa + 2 * va + aa, pb - 2 * vb + ab, pb - vb, pb]
    speed = [
        v[:-1],
        5 * (va + aa) / h,
        5 * (step - 2 * (va + vb) + (ab - aa)) / h,
        5 * (vb - ab) / h,
        v[1:],
    ]
    accel = [
        a[:-1],
        20 * (step - 2 * vb + ab - 3 * va - 2 * aa) / (h * h),
        20 * (3 * vb - 2 * ab + 2 * va + aa - step) / (h * h),
        a[1:],
    ]
    return [np.array(points) for points in (position, speed, accel)]


def _mean_square(p: np.ndarray) -> np.ndarray:
    """Integral of the square of a cubic over [0, 1], from its Bezier points (4, ...).

    Farouki 2012, 4.2.
    """
    return np.asarray(
        (
            p[0] * (20 * p[0] + 20 * p[1] + 8 * p[2] + 2 * p[3])
            + p[1] * (12 * p[1] + 18 * p[2] + 8 * p[3])
            + p[2] * (12 * p[2] + 20 * p[3])
            + 20 * p[3] * p[3]
        )
        / 140
    )


def _halved(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve Bezier curves (n, ...), by de Casteljau."""
    left, right = np.empty_like(points), np.empty_like(points)
    for k in range(len(points)):
        left[k], right[-1 - k] = points[0], points[-1]
        points = np.float32(0.5) * (points[:-1] + points[1:])
    return left, right


def _count(points: np.ndarray, bound: np.float32, count: np.ndarray, certain: np.ndarray) -> None:
    """Add to `count` the halvings of curves (n, k, 4) of k pieces; clear `certain` where a piece
    passes the bound, or may."""
    opened = ~(np.abs(points) <= bound).all(axis=0)  # also what is not finite
    if not opened.any():
        return
    piece, rest = np.nonzero(opened)[0], points[:, opened]
    for level in range(HALVINGS + 1):
        np.add.at(count, piece, 1)
        sure = (np.abs(rest[[0, -1]]) <= bound).all(axis=0)
        certain[piece[~sure] if level < HALVINGS else piece] = False
        goes_on = certain[piece] & (count[piece] <= MOST_HALVINGS)
        halves = np.concatenate(_halved(rest[:, goes_on]), axis=1)
        opened = ~(np.abs(halves) <= bound).all(axis=0)
        piece, rest = np.tile(piece[goes_on], 2)[opened], halves[:, opened]
        if not len(piece):
            return


def _halvings_to_refusal(curves: list[np.ndarray], bounds: tuple[np.float32, ...]) -> int:
    """Halvings after which a piece that breaks a limit is refused, in the firmware's order."""
    opened: list[tuple[np.ndarray, np.float32, int]] = []

    def open_curve(points: np.ndarray, bound: np.float32, halvings: int) -> None:
        if not (np.abs(points) <= bound).all():
            opened.append((points, bound, halvings))

    for motor in range(curves[0].shape[1]):
        for points, bound in zip(curves[:3], bounds[:3], strict=True):
            open_curve(points[:, motor], bound, HALVINGS)
    for motor in range(curves[0].shape[1]):
        open_curve(curves[3][:, motor], bounds[3], HALVINGS)
    halvings = 0
    while True:
        points, bound, left = opened.pop()
        halvings += 1
        inside = (np.abs(points[[0, -1]]) <= bound).all()
        if halvings > MOST_HALVINGS or left == 0 or not inside:
            return halvings
        first, second = _halved(points)
        open_curve(second, bound, left - 1)
        open_curve(first, bound, left - 1)
