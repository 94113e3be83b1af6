"""One part: where and as what it was seen, and where it should be next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

UNKNOWN = (math.nan, math.nan, math.nan)
"""The quality of what was seen nobody knows how well."""

MISREAD_RATE = 0.03
"""Fraction of sightings in which a part is taken for one of another class."""

VOTES, MAJORITY = 11, 2
"""A part's class is that of most of its last sightings; it changes when so many more sightings say
another than the one it had. Of a part long known that takes seven sightings of eleven."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where the planner's filter expects parts.

    Attributes
    ----------
    ids : tuple of str
        M parts, by their ids here.
    stamp : float
        When they are there: at the end of the cycle of the plate that runs [s].
    position : (M, 2)
        Centres [m, plate_home].
    """

    ids: tuple[str, ...]
    stamp: float
    position: np.ndarray


@dataclass(frozen=True)
class Sighting:
    """What was seen at one place: see `update`."""

    label: str
    position: tuple[float, float]
    angle: float
    quality: tuple[float, ...]
    symmetry: int


@dataclass(frozen=True)
class Track:
    """One part.

    Attributes
    ----------
    label : str
        Class: that of most of the last sightings.
    number : int
        Running number within the class, from 1; 0 while it is not confirmed.
    history : tuple of (stamp [s], x [m], y [m])
        When and where in plate_home it was seen, oldest first; at most `velocity_frames` + 1.
        Plain numbers: for so few of them they are ten times faster than arrays.
    missed : int
        Images since it was last seen.
    hits : int
        Images in which it was seen.
    turns : tuple of (stamp [s], angle [rad])
        The same for its angle, which does not jump by whole turns, nor by those that its symmetry
        hides.
    quality : tuple of 3 float
        How well it was seen last, see `Tracker.quality`.
    votes : tuple of str
        Classes as which it was seen, oldest first; at most `VOTES`.
    """

    label: str
    number: int
    history: tuple[tuple[float, float, float], ...]
    missed: int = 0
    hits: int = 0
    turns: tuple[tuple[float, float], ...] = ()
    quality: tuple[float, ...] = UNKNOWN
    votes: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Such as `black_3`."""
        return f"{self.label}_{self.number}"

    @property
    def position(self) -> tuple[float, float]:
        """Where it was last seen: x, y [m]."""
        return self.history[-1][1:]

    @property
    def velocity(self) -> tuple[float, float]:
        """Drift along x, y [m/s]: zero until it has been seen twice."""
        (t0, x0, y0), (t1, x1, y1) = self.history[0], self.history[-1]
        if t1 == t0:
            return 0.0, 0.0
        return (x1 - x0) / (t1 - t0), (y1 - y0) / (t1 - t0)

    @property
    def angle(self) -> float:
        """Angle in which it was last seen [rad]."""
        return self.turns[-1][1] if self.turns else 0.0

    @property
    def spin(self) -> float:
        """Turning [rad/s]: zero until it has been seen twice."""
        if len(self.turns) < 2:
            return 0.0
        (t0, angle0), (t1, angle1) = self.turns[0], self.turns[-1]
        return (angle1 - angle0) / (t1 - t0)

    def predicted(self, stamp: float, reach: float) -> tuple[float, float]:
        """Where it should be: x, y [m] at `stamp` [s], if it drifts on by at most `reach` [m].

        Stamps of a camera that runs free scatter, and two may be next to each other: since then it
        has moved no further than its last way in each image, and once more.
        """
        (_, x0, y0), (_, x, y) = self.history[0], self.history[-1]
        ways = self._ways(stamp, self.history[0][0], self.history[-1][0])
        ways = min(ways, reach / max(math.hypot(x - x0, y - y0), 1e-12))
        return x + (x - x0) * ways, y + (y - y0) * ways

    def turned(self, stamp: float) -> float:
        """Angle in which it should be [rad] at `stamp` [s], if it turns on."""
        if not self.turns:
            return 0.0
        (first, angle0), (last, angle) = self.turns[0], self.turns[-1]
        return angle + (angle - angle0) * self._ways(stamp, first, last)

    def _ways(self, stamp: float, first: float, last: float) -> float:
        """How often it has gone on since `last` [s] by its way since `first`."""
        return 0.0 if last == first else min((stamp - last) / (last - first), self.missed + 2)

    def extended(self, stamp: float, seen: Sighting, keep: int) -> Track:
        """Return the track with one more sighting; of places and angles the last `keep` are kept.

        A part that changes its class loses its number.
        """
        turn = math.remainder(seen.angle - self.angle, math.tau / max(seen.symmetry, 1))
        votes = (*self.votes, seen.label)[-VOTES:]
        label = _majority(self.label, votes)
        return Track(
            label,
            self.number if label == self.label else 0,
            (*self.history, (stamp, *seen.position))[-keep:],
            hits=self.hits + 1,
            turns=(*self.turns, (stamp, self.angle + turn))[-keep:],
            quality=seen.quality,
            votes=votes,
        )

    def likely(self, label: str) -> float:
        """How likely it is to be seen as of a class [-]."""
        share = self.votes.count(label) / len(self.votes)
        return (1 - MISREAD_RATE) * share + MISREAD_RATE * (1 - share)


def _majority(label: str, votes: Sequence[str]) -> str:
    """Return the class of a part that was of class `label` until the last of its sightings."""
    if votes[-1] == label:
        return label
    most = max(dict.fromkeys(votes), key=votes.count)
    return most if votes.count(most) >= votes.count(label) + MAJORITY else label
