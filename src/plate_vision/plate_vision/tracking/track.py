"""The track of one part. A track consists of the part's last detections, and of the class,
position, drift and angle that are computed from these detections. A `Track` is never modified;
`extended` returns a new `Track`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

UNKNOWN = (math.nan, math.nan, math.nan)
"""Quality values of a detection whose quality is unknown."""

MISREAD_RATE = 0.03
"""Fraction of detections whose class is wrong."""

VOTES, MAJORITY = 11, 2
"""`VOTES`: number of the last detections that determine the class of a part. Each detection is one
vote. `MAJORITY`: minimum number of votes by which another class must exceed the present class. If
only two classes get votes, the class changes with seven of eleven votes."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Positions of parts predicted by the planner's filter.

    Attributes
    ----------
    ids : tuple of str
        Ids of the M parts.
    stamp : float
        Time for which the prediction is made: the end of the running cycle [s].
    position : (M, 2)
        Centres [m, plate_home].
    """

    ids: tuple[str, ...]
    stamp: float
    position: np.ndarray


@dataclass(frozen=True)
class Detection:
    """One detection in an image; see `update`."""

    label: str
    position: tuple[float, float]
    angle: float
    quality: tuple[float, ...]
    symmetry: int


@dataclass(frozen=True)
class Track:
    """The track of one part.

    Attributes
    ----------
    label : str
        Class of the part, determined by the votes of the last detections.
    number : int
        Number of the part within its class, from 1; 0 until the part is confirmed.
    history : tuple of (stamp [s], x [m], y [m])
        Detections in plate_home, oldest first, at most `velocity_frames` + 1. The detections are
        stored as tuples, because tuples are ten times faster than arrays for a few numbers.
    missed : int
        Number of images since the last detection.
    hits : int
        Number of images with a detection.
    angles : tuple of (stamp [s], angle [rad])
        Angles in the same images. The angles are unwrapped, so that they do not jump by 2 pi or by
        the angle of the part's symmetry.
    quality : tuple of 3 float
        Quality of the last detection, see `Tracker.quality`.
    votes : tuple of str
        Classes of the last detections, oldest first; at most `VOTES`.
    """

    label: str
    number: int
    history: tuple[tuple[float, float, float], ...]
    missed: int = 0
    hits: int = 0
    angles: tuple[tuple[float, float], ...] = ()
    quality: tuple[float, ...] = UNKNOWN
    votes: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Class and number, such as `black_3`."""
        return f"{self.label}_{self.number}"

    @property
    def position(self) -> tuple[float, float]:
        """Place of the last detection: x, y [m]."""
        return self.history[-1][1:]

    @property
    def velocity(self) -> tuple[float, float]:
        """Drift along x and y [m/s]. Zero before the second detection."""
        (t0, x0, y0), (t1, x1, y1) = self.history[0], self.history[-1]
        if t1 == t0:
            return 0.0, 0.0
        return (x1 - x0) / (t1 - t0), (y1 - y0) / (t1 - t0)

    @property
    def angle(self) -> float:
        """Angle of the last detection [rad]."""
        return self.angles[-1][1] if self.angles else 0.0

    @property
    def spin(self) -> float:
        """Angular velocity [rad/s]. Zero before the second detection."""
        if len(self.angles) < 2:
            return 0.0
        (t0, angle0), (t1, angle1) = self.angles[0], self.angles[-1]
        return (angle1 - angle0) / (t1 - t0)

    def predicted(self, stamp: float, reach: float) -> tuple[float, float]:
        """Return the extrapolated position x, y [m] at `stamp` [s]. The extrapolated position is at
        most `reach` [m] from the last position.

        The stamps of a camera without trigger are noisy, and two stamps may be close together. The
        velocity is then wrong. Therefore, the extrapolation is also limited to a multiple of the
        displacement over the history. The factor is the number of missed images plus two.
        """
        (_, x0, y0), (_, x, y) = self.history[0], self.history[-1]
        factor = self._extrapolation_ratio(stamp, self.history[0][0], self.history[-1][0])
        factor = min(factor, reach / max(math.hypot(x - x0, y - y0), 1e-12))
        return x + (x - x0) * factor, y + (y - y0) * factor

    def angle_at(self, stamp: float) -> float:
        """Return the extrapolated angle [rad] at `stamp` [s]."""
        if not self.angles:
            return 0.0
        (first, angle0), (last, angle) = self.angles[0], self.angles[-1]
        return angle + (angle - angle0) * self._extrapolation_ratio(stamp, first, last)

    def _extrapolation_ratio(self, stamp: float, first: float, last: float) -> float:
        """Return the time from `last` to `stamp`, relative to the time from `first` to `last` [-].
        The result is at most the number of missed images plus two."""
        return 0.0 if last == first else min((stamp - last) / (last - first), self.missed + 2)

    def extended(self, stamp: float, seen: Detection, keep: int) -> Track:
        """Return the track with one more detection. Only the last `keep` places and angles are
        kept.

        If a part changes its class, its number becomes 0.
        """
        rotation = math.remainder(seen.angle - self.angle, math.tau / max(seen.symmetry, 1))
        votes = (*self.votes, seen.label)[-VOTES:]
        label = _vote_label(self.label, votes)
        return Track(
            label,
            self.number if label == self.label else 0,
            (*self.history, (stamp, *seen.position))[-keep:],
            hits=self.hits + 1,
            angles=(*self.angles, (stamp, self.angle + rotation))[-keep:],
            quality=seen.quality,
            votes=votes,
        )

    def likely(self, label: str) -> float:
        """Return the probability that the next detection of this part has a class [-]."""
        fraction = self.votes.count(label) / len(self.votes)
        return (1 - MISREAD_RATE) * fraction + MISREAD_RATE * (1 - fraction)


def _vote_label(label: str, votes: Sequence[str]) -> str:
    """Return the class after the last vote. `label` is the class before this vote."""
    if votes[-1] == label:
        return label
    winner = max(dict.fromkeys(votes), key=votes.count)
    return winner if votes.count(winner) >= votes.count(label) + MAJORITY else label
