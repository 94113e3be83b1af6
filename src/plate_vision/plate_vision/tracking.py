"""Names for the parts that stay with them from image to image, and their drift."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from plate_core import Parts

from .errors import TrackError, check_ranges

UNKNOWN = (math.nan, math.nan, math.nan)
"""The quality of what was seen nobody knows how well."""


@dataclass(frozen=True)
class TrackerOptions:
    """How parts are followed.

    Attributes
    ----------
    gate_m : float
        Greatest distance [m] between where a part is expected and where it is found, per image,
        0.001 to 1. At 100 mm/s that turn round within a cycle of 0.2 s a part is 40 mm from where
        it was expected.
    max_missed : int
        Images in a row that a part may be missed before its id is given up, 0 to 1000.
    confirm : int
        Images in a row in which a new part must be seen before it gets an id, 1 to 100; those of
        the first image are believed at once. With 2 a speck that is seen once is no part.
    velocity_frames : int
        Images over which the drift is taken, 1 to 100. With 1 it is the drift of the last cycle,
        which is what the planner controls and without delay; its noise is that of two positions,
        0.014 mm over the cycle. More images smooth and delay it.
    """

    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "gate_m": (0.001, 1.0),
        "max_missed": (0, 1000),
        "confirm": (1, 100),
        "velocity_frames": (1, 100),
    }
    gate_m: float = 0.04
    max_missed: int = 5
    confirm: int = 2
    velocity_frames: int = 1

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES)


@dataclass(frozen=True)
class Track:
    """One part.

    Attributes
    ----------
    label : str
        Class.
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
        The same for its angle, which does not jump by whole turns.
    quality : tuple of 3 float
        How well it was seen last, see `Tracker.quality`.
    """

    label: str
    number: int
    history: tuple[tuple[float, float, float], ...]
    missed: int = 0
    hits: int = 0
    turns: tuple[tuple[float, float], ...] = ()
    quality: tuple[float, ...] = UNKNOWN

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
        (first, x0, y0), (last, x, y) = self.history[0], self.history[-1]
        if last == first:
            return x, y
        ways = min((stamp - last) / (last - first), self.missed + 2)
        ways = min(ways, reach / max(math.hypot(x - x0, y - y0), 1e-12))
        return x + (x - x0) * ways, y + (y - y0) * ways

    def extended(
        self, stamp: float, position: np.ndarray, angle: float, keep: int,
        quality: tuple[float, ...] = UNKNOWN,
    ) -> Track:  # fmt: skip
        """Return the track with one more position (2,) [m] and angle [rad]; the last `keep` are
        kept."""
        point = (stamp, float(position[0]), float(position[1]))
        turn = (stamp, self.angle + math.remainder(angle - self.angle, math.tau))
        return Track(
            self.label,
            self.number,
            (*self.history, point)[-keep:],
            hits=self.hits + 1,
            turns=(*self.turns, turn)[-keep:],
            quality=quality,
        )


@dataclass(frozen=True, eq=False)
class Tracker:
    """The parts followed so far.

    Attributes
    ----------
    options : TrackerOptions
    stamp : float or None
        Of the last image [s].
    tracks : tuple of Track
        By class and number; also those that were missed in the last image.
    last_number : mapping of str to int
        Greatest number given so far, by class; no number is given twice.
    """

    options: TrackerOptions = field(default_factory=TrackerOptions)
    stamp: float | None = None
    tracks: tuple[Track, ...] = ()
    last_number: Mapping[str, int] = field(default_factory=dict)

    @property
    def found(self) -> tuple[Track, ...]:
        """All that was seen in the last image."""
        return tuple(track for track in self.tracks if track.missed == 0)

    @property
    def parts(self) -> Parts:
        """The parts seen in the last image that are confirmed."""
        seen = self._seen
        return Parts.make(
            tuple(track.id for track in seen),
            position=np.array([track.position for track in seen]),
            velocity=np.array([track.velocity for track in seen]),
            angle=np.array([track.angle for track in seen]),
            spin=np.array([track.spin for track in seen]),
        )

    @property
    def quality(self) -> np.ndarray:
        """How well each of `parts` was seen (M, 3): standard deviations of its place along each
        axis [m] and of its angle [rad], and how much it looks like a part, 0 to 1; NaN: not
        known."""
        return np.array([track.quality for track in self._seen]).reshape(-1, 3)

    @property
    def _seen(self) -> list[Track]:
        return [track for track in self.found if track.number]


def found_text(tracker: Tracker) -> str:
    """Say how many parts were found in the last image, such as `24 parts: 14 black, 10 grey`."""
    labels = [track.label for track in tracker.found]
    if not labels:
        return "no parts"
    counts = ", ".join(f"{labels.count(label)} {label}" for label in sorted(set(labels)))
    return f"{len(labels)} part{'s' if len(labels) > 1 else ''}: {counts}"


def update(
    tracker: Tracker,
    stamp: float,
    position: np.ndarray,
    label: Sequence[str] | np.ndarray,
    angle: np.ndarray | None = None,
    quality: np.ndarray | None = None,
) -> Tracker:
    """Take in what was found in one image.

    The same stamp again changes nothing: the same image gives the same answer. An earlier stamp
    means that time began anew (a simulator was restarted): all parts are new.

    Parameters
    ----------
    tracker : Tracker
        The parts so far.
    stamp : float
        When the image was taken [s].
    position : (M, 2)
        Centres [m, plate_home].
    label : (M,) str
        Classes.
    angle : (M,), optional
        Angles [rad, plate_home]; zero if left out.
    quality : (M, 3), optional
        How well they were seen, see `Tracker.quality`; not known if left out.

    Returns
    -------
    Tracker

    Raises
    ------
    TrackError
        If shapes disagree or a value is not finite.
    """
    position, labels = _checked(stamp, position, label)
    angles = np.zeros(len(labels)) if angle is None else np.asarray(angle, dtype=float)
    how_well = [UNKNOWN] * len(labels) if quality is None else [*map(tuple, quality.tolist())]
    stamp = float(stamp)
    if tracker.stamp is not None and stamp == tracker.stamp:
        return tracker
    if tracker.stamp is not None and stamp < tracker.stamp:
        tracker = Tracker(tracker.options)
    options = tracker.options
    keep = options.velocity_frames + 1
    tracks = []
    is_new = np.ones(len(labels), dtype=bool)
    for track, found in zip(tracker.tracks, _assign(tracker, stamp, position, labels), strict=True):
        if found >= 0:
            is_new[found] = False
            turn, well = float(angles[found]), how_well[found]
            tracks.append(track.extended(stamp, position[found], turn, keep, well))
        elif track.number and track.missed < options.max_missed:
            tracks.append(replace(track, missed=track.missed + 1))
    for i in np.flatnonzero(is_new):
        new = Track(labels[i], 0, ())
        tracks.append(new.extended(stamp, position[i], float(angles[i]), keep, how_well[i]))
    confirm = options.confirm if tracker.last_number else 1
    tracks, numbers = _number(tracks, tracker.last_number, confirm)
    return Tracker(options, stamp, tuple(tracks), numbers)


def _number(
    tracks: list[Track], numbers: Mapping[str, int], confirm: int
) -> tuple[list[Track], dict[str, int]]:
    """Number tracks that have been seen `confirm` times; all by class and number."""
    numbers = dict(numbers)
    # From left to right, so that the first names do not depend on the order of detection.
    for i in sorted(range(len(tracks)), key=lambda i: (*tracks[i].position, tracks[i].label)):
        track = tracks[i]
        if track.number == 0 and track.hits >= confirm:
            numbers[track.label] = numbers.get(track.label, 0) + 1
            tracks[i] = replace(track, number=numbers[track.label])
    return sorted(tracks, key=lambda track: (track.label, track.number)), numbers


def _checked(
    stamp: float, position: np.ndarray, label: Sequence[str] | np.ndarray
) -> tuple[np.ndarray, list[str]]:
    position = np.asarray(position, dtype=float).reshape(-1, 2)
    labels = [str(name) for name in label]
    if len(labels) != len(position):
        raise TrackError(f"{len(labels)} labels for {len(position)} positions, allowed: as many")
    if not np.isfinite(stamp):
        raise TrackError(f"stamp is {stamp}, allowed: a finite number of seconds")
    bad = np.flatnonzero(~np.all(np.isfinite(position), axis=1))
    if bad.size:
        raise TrackError(
            f"position {bad[0]} is {position[bad[0]].tolist()}, allowed: finite numbers"
        )
    return position, labels


def _assign(
    tracker: Tracker, stamp: float, position: np.ndarray, labels: Sequence[str]
) -> np.ndarray:
    """Return for each track the index of its position (T,), or -1.

    As many pairs as possible of one class and within the gate, and of all such choices the one
    with the least sum of squared distances.
    """
    found = np.full(len(tracker.tracks), -1)
    if not len(found) or not len(labels):
        return found
    reach = tracker.options.gate_m * np.array([1 + track.missed for track in tracker.tracks])
    expected = [
        track.predicted(stamp, gate) for track, gate in zip(tracker.tracks, reach, strict=True)
    ]
    gap = np.array(expected)[:, None] - position[None, :]
    square = np.sum(gap**2, axis=2)
    same = np.array([track.label for track in tracker.tracks])[:, None] == np.array(labels)[None, :]
    allowed = same & (square <= reach[:, None] ** 2)
    # One forbidden pair costs more than all allowed pairs together.
    forbidden = 1.0 + np.sum(reach**2)
    rows, columns = linear_sum_assignment(np.where(allowed, square, forbidden))
    kept = allowed[rows, columns]
    found[rows[kept]] = columns[kept]
    return found
