"""A motor table on the device: its quintics, and the checks before it may play.

All in the order and the single precision of firmware/table.c, so that both play the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from plate_core.serial_protocol import Knot, Status, table_crc
from plate_core.serial_protocol.messages import MOTORS, TICK_S

from .limits import SLACK, DeviceLimits

HALVINGS = 12
"""Of a piece until its hull tells whether a limit is kept: it closes in by 4 each time."""

CLOSES_M, CLOSES_SPEED = np.float32(2e-6), np.float32(2e-3)
"""How far a table's end may be from its start [m], [m/s]: rounding, and no jolt."""

PRODUCTS = np.array([[20, 10, 4, 1], [10, 12, 9, 4], [4, 9, 12, 10], [1, 4, 10, 20]]) / 140
"""Integrals over [0, 1] of the products of cubic Bernstein polynomials (Farouki 2012, 4.2)."""


@dataclass(frozen=True)
class Draft:
    """The second buffer: a table that is being filled.

    Attributes
    ----------
    table, count, crc : int
        As in Begin.
    knots : mapping of int to Knot
        Those that have come.
    """

    table: int
    count: int
    crc: int
    knots: Mapping[int, Knot] = field(default_factory=dict)

    def filled(self, first: int, knots: tuple[Knot, ...]) -> Draft:
        """Return the draft with more knots."""
        more = {first + i: knot for i, knot in enumerate(knots)}
        return Draft(self.table, self.count, self.crc, {**self.knots, **more})

    def checked(self, limits: DeviceLimits) -> tuple[Status, Table | None]:
        """Return the table, if it may play, or why not."""
        if len(self.knots) < self.count:
            return Status.INCOMPLETE, None
        knots = [self.knots[k] for k in range(self.count)]
        if table_crc(knots) != self.crc:
            return Status.INCOMPLETE, None
        table = Table(
            self.table,
            np.array([knot.ticks for knot in knots]),
            *(np.array([getattr(knot, name) for knot in knots], np.float32) for name in STATES),
        )
        if table.ticks[0] != 0 or np.any(np.diff(table.ticks) <= 0):
            return Status.WRONG_TIMES, None
        status = table.status(limits)
        return (status, table) if status is Status.DONE else (status, None)


STATES = ("position", "velocity", "acceleration")


@dataclass(frozen=True)
class Table:
    """A whole table.

    Attributes
    ----------
    table : int
        Its number.
    ticks : (k + 1,)
        Times of the knots, from 0 [TICK_S].
    position, velocity, acceleration : (k + 1, 4)
        Of the motors [m], [m/s], [m/s2], float32.
    """

    table: int
    ticks: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the knots (k + 1,) [s]."""
        return self.ticks * TICK_S

    @property
    def period(self) -> float:
        """Its length [s]."""
        return float(self.times[-1])

    @cached_property
    def lengths(self) -> np.ndarray:
        """Lengths of the pieces (k, 1), float32 [s]."""
        return (np.diff(self.ticks) * TICK_S).astype(np.float32)[:, None]

    @cached_property
    def pieces(self) -> np.ndarray:
        """Coefficients (k, 6, 4) of a piece's quintic by powers of s = t/h [m]."""
        h, a, b = self.lengths, slice(None, -1), slice(1, None)
        half = np.float32(0.5)
        c0, c1 = self.position[a], h * self.velocity[a]
        c2 = half * h * h * self.acceleration[a]
        # What the left end's Taylor polynomial misses at the right end
        dp = self.position[b] - c0 - c1 - c2
        dv = h * self.velocity[b] - c1 - 2 * c2
        da = h * h * self.acceleration[b] - 2 * c2
        c3 = 10 * dp - 4 * dv + half * da
        c4 = -15 * dp + 7 * dv - da
        c5 = 6 * dp - 3 * dv + half * da
        return np.stack([c0, c1, c2, c3, c4, c5], axis=1)

    def piece_at(self, time: float) -> int:
        """Return the number of the piece that is played at a time [s]."""
        return int(np.clip(np.searchsorted(self.times, time, "right") - 1, 0, len(self.times) - 2))

    def at(self, time: float) -> np.ndarray:
        """Return position, speed and acceleration (3, 4) at a time [s] within the period."""
        k = self.piece_at(time)
        h = self.lengths[k]
        s = np.array([time - self.times[k]], np.float32) / h
        c0, c1, c2, c3, c4, c5 = self.pieces[k]
        return np.stack(
            [
                c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5)))),
                (c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h,
                (2 * c2 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / (h * h),
            ]
        )

    @cached_property
    def hulls(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bezier points of position, speed, acceleration: (6, k, 4), (5, k, 4), (4, k, 4)."""
        h, a, b = self.lengths, slice(None, -1), slice(1, None)
        va, vb = h * self.velocity[a] / 5, h * self.velocity[b] / 5
        aa, ab = h * h * self.acceleration[a] / 20, h * h * self.acceleration[b] / 20
        pa, pb = self.position[a], self.position[b]
        step = pb - pa
        position = [pa, pa + va, pa + 2 * va + aa, pb - 2 * vb + ab, pb - vb, pb]
        speed = [
            self.velocity[a],
            5 * (va + aa) / h,
            5 * (step - 2 * (va + vb) + (ab - aa)) / h,
            5 * (vb - ab) / h,
            self.velocity[b],
        ]
        accel = [
            self.acceleration[a],
            20 * (step - 2 * vb + ab - 3 * va - 2 * aa) / (h * h),
            20 * (3 * vb - 2 * ab + 2 * va + aa - step) / (h * h),
            self.acceleration[b],
        ]
        return np.array(position), np.array(speed), np.array(accel)

    def keeps(self, limits: DeviceLimits) -> bool:
        """Tell whether motion and force keep their limits, on the spline itself, not on samples."""
        with np.errstate(all="ignore"):  # wild tables overflow, and are refused for it
            bounds = (limits.stroke_m, limits.speed, limits.accel, limits.force)
            curves = (*self.hulls, self._forces(limits))
            return not any(
                exceeds(points, np.float32(bound) * SLACK)
                for points, bound in zip(curves, bounds, strict=True)
            )

    def _forces(self, limits: DeviceLimits) -> np.ndarray:
        """Bezier points (4, k, 4) of the motors' forces [N]."""
        return limits.forces(self.hulls[2]).astype(np.float32)

    def status(self, limits: DeviceLimits) -> Status:
        """Return DONE, LIMIT or JUMP."""
        if not self.keeps(limits):
            return Status.LIMIT
        wide = self._forces(limits).astype(float)
        squares = np.einsum("ij,ikm,jkm->km", PRODUCTS, wide, wide)
        heat = np.sum(squares * np.diff(self.ticks)[:, None] * TICK_S, axis=0)
        off = np.abs(self.position[0] - self.position[-1])
        kick = np.abs(self.velocity[0] - self.velocity[-1])
        bearable = limits.bearable * self.period
        for m in range(MOTORS):
            if not heat[m] <= bearable:
                return Status.LIMIT
            if not (off[m] <= CLOSES_M and kick[m] <= CLOSES_SPEED):
                return Status.JUMP
        return Status.DONE


def exceeds(points: np.ndarray, limit: np.float32, halvings: int = HALVINGS) -> bool:
    """Tell whether any of the Bezier curves (n, ...) passes a limit anywhere."""
    inside = np.all(np.abs(points) <= limit, axis=0)  # false for what is not finite, too
    rest = points[:, ~inside]
    if not rest.size:
        return False
    if halvings == 0 or not np.all(np.abs(rest[[0, -1]]) <= limit):
        return True
    left, right = np.empty_like(rest), np.empty_like(rest)
    for k in range(len(rest)):  # de Casteljau's halving
        left[k], right[-1 - k] = rest[0], rest[-1]
        rest = np.float32(0.5) * (rest[:-1] + rest[1:])
    return exceeds(left, limit, halvings - 1) or exceeds(right, limit, halvings - 1)
