"""The tracker: all tracks, which are updated with the detections of each image.

`update` assigns detections to tracks, gives ids to confirmed new parts, and removes parts that were
missed for too long. The input consists of positions, classes and angles. The output is a new
`Tracker`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from plate_core import NAMELESS, Parts

from ..discs.shadow import Shadow
from ..errors import TrackError, check_ranges
from ..overlooked import NONE_OVERLOOKED, OVERLOOKED, REASONS
from ..shapes.shadows import Lamp
from .assignment import assign
from .track import UNKNOWN, Detection, Prediction, Track

UNKNOWN_MISSED = 30
"""Number of consecutive images without a detection for which an object of the class `unknown` keeps
its track. The number is larger than for parts, because such an object is often detected in some
images only. With a smaller number, the object would have to be confirmed again after each gap."""


@dataclass(frozen=True)
class TrackerOptions:
    """Options of the tracking.

    Attributes
    ----------
    gate_m : float
        Maximum distance between a part and its expected position [m], per image since the part was
        last detected, 0.001 to 1. If a part with a velocity of 100 mm/s reverses its direction, the
        part is 40 mm from its expected position after a cycle of 0.2 s.
    max_missed : int
        Maximum number of consecutive images without a detection for which a part keeps its id, 0 to
        1000.
    confirm : int
        Number of consecutive images in which a new part must be detected before it gets an id, 1 to
        100. Parts in the first image get their ids at once. If `confirm` is 2 or more, a single
        false detection gets no id.
    velocity_frames : int
        Number of images over which the drift is measured, 1 to 100. With 1, the drift is measured
        from the last two images without delay. The planner needs the drift without delay. The noise
        of this drift is the noise of two positions, 0.014 mm per cycle. If the number is larger
        than 1, the drift is smoother but delayed.
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


@dataclass(frozen=True, eq=False)
class Tracker:
    """The state of all tracks.

    Attributes
    ----------
    options : TrackerOptions
    stamp : float or None
        Stamp of the last image [s]. None before the first image.
    tracks : tuple of Track
        Tracks, sorted by class and number. Tracks of parts that were missed in the last image are
        included.
    last_number : mapping of str to int
        Largest number that was given so far in each class. Numbers are not reused.
    given_up : tuple of str
        Ids that were removed with the last image.
    renamed : tuple of (id before, id now)
        Parts whose class changed with the last image.
    overlooked : (n,) OVERLOOKED
        Objects in the last image that are rejected as parts.
    shadow : Shadow, optional
        Shadow that every part casts in the last image.
    lamp : Lamp, optional
        Lamp that casts the shadows of parts with types.
    uncertain : int
        Number of consecutive images in which many objects have a large misfit and no shadow was
        found.
    """

    options: TrackerOptions = field(default_factory=TrackerOptions)
    stamp: float | None = None
    tracks: tuple[Track, ...] = ()
    last_number: Mapping[str, int] = field(default_factory=dict)
    given_up: tuple[str, ...] = ()
    renamed: tuple[tuple[str, str], ...] = ()
    overlooked: np.ndarray = field(default_factory=lambda: NONE_OVERLOOKED)
    shadow: Shadow | None = None
    lamp: Lamp | None = None
    uncertain: int = 0

    @property
    def found(self) -> tuple[Track, ...]:
        """Tracks with a detection in the last image, including unconfirmed ones."""
        return tuple(track for track in self.tracks if track.missed == 0)

    @property
    def parts(self) -> Parts:
        """The confirmed parts that were detected in the last image."""
        seen = self._detected_tracks
        return Parts.make(
            tuple(track.id for track in seen),
            position=np.array([track.position for track in seen]),
            velocity=np.array([track.velocity for track in seen]),
            angle=np.array([track.angle for track in seen]),
            spin=np.array([track.spin for track in seen]),
        )

    @property
    def quality(self) -> np.ndarray:
        """Quality of each of `parts` (M, 3): standard deviation of the position along each axis
        [m], standard deviation of the angle [rad], and confidence, 0 to 1. Unknown values are
        NaN."""
        return np.array([track.quality for track in self._detected_tracks]).reshape(-1, 3)

    @property
    def _detected_tracks(self) -> list[Track]:
        return [track for track in self.found if track.number]


def found_text(tracker: Tracker) -> str:
    """Return a text with the number of parts in the last image, such as `24 parts: 14 black, 10
    grey`. The number of objects without a class follows, such as `; 2 unknown`."""
    labels = [track.label for track in tracker.found]
    named = [label for label in labels if label not in NAMELESS]
    counts = [f"{labels.count(label)} {label}" for label in sorted(set(named))]
    parts = f"{len(named)} part{'s' if len(named) > 1 else ''}: {', '.join(counts)}"
    others = [f"{labels.count(label)} {label}" for label in NAMELESS if label in labels]
    return "; ".join([parts if named else "no parts", *others])


def update(
    tracker: Tracker,
    stamp: float,
    position: np.ndarray,
    label: Sequence[str] | np.ndarray,
    angle: np.ndarray | None = None,
    quality: np.ndarray | None = None,
    symmetry: np.ndarray | None = None,
    expected: Prediction | None = None,
    overlooked: np.ndarray | None = None,
) -> Tracker:
    """Update the tracks with the detections of one image.

    If the stamp is equal to the last stamp, the image is the same, and nothing changes. If the
    stamp is earlier, the clock was set back, for example because a simulator was restarted. If the
    clock was set back, all parts are new.

    Parameters
    ----------
    tracker : Tracker
        State after the previous image.
    stamp : float
        Time when the image was taken [s].
    position : (M, 2)
        Centres [m, plate_home].
    label : (M,) str
        Classes.
    angle : (M,), optional
        Angles [rad, plate_home]. Default: zero.
    quality : (M, 3), optional
        Quality of the detections (see `Tracker.quality`). Default: unknown.
    symmetry : (M,) int, optional
        Number of directions in which the parts look the same; 0 for all directions. Default: 1.
    expected : Prediction, optional
        Positions of parts, predicted from the plate's motion. The prediction is used if its time is
        after the last image. The positions of other parts are extrapolated from their drift.
    overlooked : (n,) OVERLOOKED, optional
        Objects in the image that are rejected as parts. Default: none.

    Returns
    -------
    Tracker

    Raises
    ------
    TrackError
        If shapes do not fit each other, a value is not finite, or a reason is not one of `REASONS`.
    """
    position, labels = _check_detections(stamp, position, label)
    overlooked = _check_overlooked(overlooked)
    count, stamp = len(labels), float(stamp)
    if tracker.stamp is not None and stamp == tracker.stamp:
        return tracker
    if tracker.stamp is not None and stamp < tracker.stamp:
        tracker = Tracker(tracker.options)
    angles = _check_column("angle", np.zeros(count) if angle is None else angle, (count,))
    if not np.all(np.isfinite(angles)):
        raise TrackError(f"angle is {angles.tolist()}, allowed: finite numbers")
    how_well = [UNKNOWN] * count if quality is None else quality
    how_well = _check_column("quality", how_well, (count, 3)).tolist()
    alike = _check_column("symmetry", np.ones(count) if symmetry is None else symmetry, (count,))
    places = map(tuple, position.tolist())
    seen = [*map(Detection, labels, places, angles.tolist(), map(tuple, how_well), map(int, alike))]
    options = tracker.options
    keep = options.velocity_frames + 1
    tracks, before, given_up = [], [], []
    is_new = np.ones(count, dtype=bool)
    fresh = expected is not None and tracker.stamp is not None and tracker.stamp < expected.stamp
    chosen = assign(tracker.tracks, stamp, seen, options.gate_m, expected if fresh else None)
    for track, found in zip(tracker.tracks, chosen, strict=True):
        if found >= 0:
            is_new[found] = False
            tracks.append(track.extended(stamp, seen[found], keep))
            before.append(track)
        elif track.number and track.missed < _max_missed(track, options):
            tracks.append(replace(track, missed=track.missed + 1))
            before.append(track)
        elif track.number:
            given_up.append(track.id)
    for i in np.flatnonzero(is_new):
        tracks.append(Track(labels[i], 0, ()).extended(stamp, seen[i], keep))
    confirm = options.confirm if tracker.last_number else 1
    numbers = _assign_ids(tracks, tracker.last_number, confirm)
    renamed = tuple(
        (old.id, new.id) for old, new in zip(before, tracks, strict=False)
        if old.number and old.id != new.id
    )  # fmt: skip
    tracks.sort(key=lambda track: (track.label, track.number))
    return Tracker(options, stamp, tuple(tracks), numbers, tuple(given_up), renamed, overlooked)


def _max_missed(track: Track, options: TrackerOptions) -> int:
    """Return the maximum number of consecutive images without a detection for which a track is
    kept."""
    unknown = track.label == NAMELESS[0]
    return max(options.max_missed, UNKNOWN_MISSED) if unknown else options.max_missed


def _assign_ids(tracks: list[Track], numbers: Mapping[str, int], confirm: int) -> dict[str, int]:
    """Give numbers to the new tracks in the list that were detected at least `confirm` times.
    Return the last number of each class."""
    numbers = dict(numbers)
    # New tracks are numbered in the order of their x coordinates. Therefore the first ids do not
    # depend on the order of detection.
    for i in sorted(range(len(tracks)), key=lambda i: (*tracks[i].position, tracks[i].label)):
        track = tracks[i]
        if track.number == 0 and track.hits >= confirm:
            numbers[track.label] = numbers.get(track.label, 0) + 1
            tracks[i] = replace(track, number=numbers[track.label])
    return numbers


def _check_overlooked(overlooked: np.ndarray | None) -> np.ndarray:
    """Return the overlooked objects (n,) OVERLOOKED. Raise an error if the type of the array or a
    reason is wrong."""
    if overlooked is None:
        return NONE_OVERLOOKED
    if overlooked.dtype != OVERLOOKED or overlooked.ndim != 1:
        raise TrackError(
            f"overlooked is {overlooked.dtype} of shape {overlooked.shape}, allowed: (n,) of "
            "OVERLOOKED"
        )
    wrong = sorted(set(overlooked["reason"].tolist()) - set(REASONS))
    if wrong:
        raise TrackError(f"reason is {wrong[0]!r}, allowed: {', '.join(REASONS)}")
    return overlooked


def _check_column(
    name: str, values: Sequence[Any] | np.ndarray, shape: tuple[int, ...]
) -> np.ndarray:
    """Return the values of all detections as an array of the given shape. Raise an error if the
    values have another shape."""
    array = np.asarray(values, dtype=float)
    if array.size == 0:
        array = array.reshape(-1, *shape[1:])
    if array.shape != shape:
        raise TrackError(
            f"shape of {name} is {array.shape}, allowed: {shape}, with one row for each position"
        )
    return array


def _check_detections(
    stamp: float, position: np.ndarray, label: Sequence[str] | np.ndarray
) -> tuple[np.ndarray, list[str]]:
    position = np.asarray(position, dtype=float).reshape(-1, 2)
    labels = [str(name) for name in label]
    if len(labels) != len(position):
        raise TrackError(
            f"number of labels is {len(labels)}, allowed: {len(position)}, one for each position"
        )
    if not np.isfinite(stamp):
        raise TrackError(f"stamp is {stamp}, allowed: a finite number of seconds")
    bad = np.flatnonzero(~np.all(np.isfinite(position), axis=1))
    if bad.size:
        raise TrackError(
            f"position {bad[0]} is {position[bad[0]].tolist()}, allowed: finite numbers"
        )
    return position, labels
