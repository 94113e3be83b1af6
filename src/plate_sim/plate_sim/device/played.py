"""What the motors really did, cut into stretches: what the simulated plate then follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core.serial_protocol import MOTORS, TICK_S, State

from .motion import Motion
from .stream import Stream
from .table import Table

STRETCH_S = 0.1
"""Length of a stretch while no table plays [s]: one image is taken in each."""

COAST_RATE = 60.0
"""Of a plate without current, which its flexures bring home, critically damped [1/s]."""

EVERY = 4
"""Ticks between two knots of a stretch that is no whole table."""


@dataclass(frozen=True)
class Stretch:
    """What the motors did from one image to the next.

    Attributes
    ----------
    start : float
        On the device's clock [s].
    times : (k + 1,)
        Since then [s].
    motors : (k + 1, 3, 4)
        Travel [m], speed [m/s] and acceleration [m/s2]; quintics between.
    table : int
        Number of the table that was played as a whole; 0 if none was.
    """

    start: float
    times: np.ndarray
    motors: np.ndarray
    table: int = 0

    @property
    def end(self) -> float:
        """On the device's clock [s]."""
        return self.start + float(self.times[-1])


class Recorder:
    """Follows a device tick by tick.

    A stretch ends where a table begins or begins again; while none plays, after `STRETCH_S`.
    Without current the plate glides home on its flexures.
    """

    def __init__(self, now: float = 0.0) -> None:
        self._start = now
        self._ticks: list[tuple[float, np.ndarray]] = [(now, np.zeros((3, MOTORS)))]
        self._whole: Table | None = None  # that has played since the stretch began
        self._play: tuple[int, int] | None = None

    @property
    def plate(self) -> np.ndarray:
        """Position, speed and acceleration of the motors (3, 4) now."""
        return self._ticks[-1][1]

    def glided(self, dt: float) -> np.ndarray:
        """Return the motors' state (3, 4) after `dt` [s] without current."""
        place, speed, _ = self.plate
        push = speed + COAST_RATE * place
        fade = np.exp(-COAST_RATE * dt)
        place, speed = (place + push * dt) * fade, (speed - COAST_RATE * push * dt) * fade
        return np.stack([place, speed, -(COAST_RATE**2) * place - 2 * COAST_RATE * speed])

    def followed(self, now: float, motion: Motion, at: np.ndarray | None) -> list[Stretch]:
        """Return the stretches that have ended by `now` [s], when `at` was commanded."""
        done = []
        table = motion.playing if motion.state is State.PLAYING else None
        if isinstance(table, Stream):
            table = None  # it has no cycles
        play = (id(table), motion.played) if table is not None else None
        if table is not None and play != self._play:
            done = self._cut(now - motion.time * TICK_S, table)
            self._whole = table
        elif table is None:
            self._whole = None
        self._play = play
        state = self.glided(now - self._ticks[-1][0]) if at is None else at.astype(float)
        self._ticks.append((now, state))
        if self._whole is None and now - self._start >= STRETCH_S:
            done += self._cut(now, None)
        return done

    def _cut(self, when: float, following: Table | None) -> list[Stretch]:
        """End the stretch at a time [s], where a table begins, or none."""
        start, ticks, last = self._start, self._ticks, self._whole
        end = ticks[-1][1]
        if following is not None:
            knots = (following.position, following.velocity, following.acceleration)
            end = np.stack([values[0] for values in knots]).astype(float)
        self._start, self._ticks = when, [(when, end)]
        if when <= start:
            return []
        if last is not None and abs(when - start - last.period) < 1e-9:
            states = (last.position, last.velocity, last.acceleration)
            return [Stretch(start, last.times, np.stack(states, axis=1).astype(float), last.table)]
        inner = [tick for tick in ticks[1:] if start + 1e-4 < tick[0] < when - 1e-4]
        kept = [ticks[0], *inner[EVERY - 1 :: EVERY], (when, end)]
        times = np.array([t - start for t, _ in kept])
        return [Stretch(start, times, np.stack([state for _, state in kept]))]
