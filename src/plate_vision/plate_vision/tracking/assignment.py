"""Which sighting is of which part: the most likely choice, all together.

How near is a sighting to where the part should be, is it of its class, at its angle; and how likely
is it, instead, that the part is missed and the sighting false? Where a part should be says the
planner's filter, which knows how the plate moves; of other parts their last drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from .track import Prediction, Sighting, Track

MISSED_RATE, FALSE_RATE = 0.05, 0.02
"""Fraction of parts that an image does not show, and false sightings in an image for each part.
They count by their logarithms: three times as many change little."""

CROWD = 200.0
"""Parts on a square metre of a full plate: false sightings are as dense, times their rate."""

NEW_RATE = 0.02
"""Fraction of sightings without a part that are of a part, and not false."""

PREDICTED_M, POOR_M = 0.4e-3, 3e-3
"""How far along each axis parts are found from where they were predicted to be a cycle ahead, and
the same of poor predictions, in images in which all are poor (standard deviations). In loops of 30
parts it is 0.1 to 0.2 mm; where it is not yet known how old images are, millimetres."""

PUSHED_M, PUSHED_RATE = 5e-3, 1e-4
"""The same of a part that was pushed by another, and the fraction of those."""

SWING_M = 2e-3
"""The same half way to where it was predicted to be, for parts swing to and fro in a cycle."""

MOST_WAYS = 2.0
"""Beyond the instant of a prediction a part goes on, at most by the same way again."""

GATES, DRIFT, TURNED_RATE = 3.0, 0.3, 0.2
"""The gate is so many standard deviations of where parts without a prediction are found; those that
go on as they did come so much nearer to it; and the fraction of others."""

PREDICTIONS_FAIL = 1e-3
"""Fraction of images in which predictions are poor, or wrong altogether: the plate has run another
cycle, say."""

TURN_RAD = 0.15
"""Standard deviation of a turn in an image beside the spin before [rad]."""

ANY_TURN = 0.05
"""Fraction of turns that are of any size: a mark misread, a part that was hit."""

VAGUE_RAD = 1.0
"""An angle with a greater standard deviation says nothing [rad]."""


def assign(
    tracks: Sequence[Track],
    stamp: float,
    seen: Sequence[Sighting],
    gate: float,
    expected: Prediction | None = None,
) -> np.ndarray:
    """Return for each track the index of its sighting (T,), or -1.

    A pair is chosen if it makes the image more likely than a part that was missed and a sighting
    that is new or false.

    Parameters
    ----------
    tracks : sequence of Track
        T parts.
    stamp : float
        Of the image [s].
    seen : sequence of Sighting
        M of them.
    gate : float
        Greatest distance from where a part should be, per image [m].
    expected : Prediction, optional
        Of an instant after the last image.
    """
    found = np.full(len(tracks), -1)
    if not len(found) or not seen:
        return found
    other = _other_gain(tracks, seen) + _angle_gain(tracks, stamp, seen)
    drift = _drift_gain(tracks, stamp, seen, gate)
    choices = [_best(drift + other)]
    if expected is not None:
        usual, poor = _known_gains(tracks, stamp, seen, gate, expected, drift)
        rows, columns, gain = _best(usual + other)
        # Where predictions hold, they explain the image better than anything else does.
        choices = [
            (rows, columns, gain - math.log(PREDICTIONS_FAIL)),
            _best(poor + other),
            *choices,
        ]
    rows, columns, _ = max(choices, key=lambda choice: choice[2])
    found[rows] = columns
    return found


def _best(gain: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return rows, columns and the sum of the pairs with the greatest sum; none of them below 0."""
    rows, columns = linear_sum_assignment(np.maximum(gain, 0.0), maximize=True)
    value = gain[rows, columns]
    kept = value > 0
    return rows[kept], columns[kept], float(np.sum(value[kept]))


def _other_gain(tracks: Sequence[Track], seen: Sequence[Sighting]) -> np.ndarray:
    """Return by how much each pair (T, M) makes the image more likely [log], but for the place."""
    labels = [one.label for one in seen]
    among = [*dict.fromkeys(labels)]
    likely = np.log([[track.likely(label) for label in among] for track in tracks])
    exists = np.array([1.0 if track.number else NEW_RATE for track in tracks])
    shown = np.log(exists * (1 - MISSED_RATE) / (1 - exists * (1 - MISSED_RATE)))
    gain = likely[:, [among.index(label) for label in labels]] + shown[:, None]
    return gain - math.log(CROWD * FALSE_RATE)


def _angle_gain(
    tracks: Sequence[Track], stamp: float, seen: Sequence[Sighting]
) -> np.ndarray | float:
    """Return what the angles add to that (T, M), beside those of false sightings: any."""
    unsure = np.array([track.quality[1] for track in tracks])
    scatter = np.array([one.quality[1] if one.symmetry else math.nan for one in seen])
    tells = (unsure < VAGUE_RAD)[:, None] & (scatter < VAGUE_RAD)
    if not np.any(tells):
        return 0.0
    angle = np.array([track.turned(stamp) for track in tracks])
    images = np.array([1 + track.missed for track in tracks])
    deviation = np.sqrt(((TURN_RAD * images) ** 2 + unsure**2)[:, None] + scatter**2)
    period = math.tau / np.array([max(one.symmetry, 1) for one in seen])
    gap = np.array([one.angle for one in seen]) - angle[:, None]
    gap -= period * np.round(gap / period)
    normal = period / (math.sqrt(math.tau) * deviation) * np.exp(-0.5 * (gap / deviation) ** 2)
    return np.where(tells, np.log((1 - ANY_TURN) * normal + ANY_TURN), 0.0)


def _drift_gain(
    tracks: Sequence[Track], stamp: float, seen: Sequence[Sighting], gate: float
) -> np.ndarray:
    """Return the logarithm of the density [1/m2] of sightings (T, M) of parts that drift on;
    beyond the gate minus infinity."""
    reach = gate * np.array([1 + track.missed for track in tracks])
    place = [track.predicted(stamp, most) for track, most in zip(tracks, reach, strict=True)]
    square = _square(np.array(place), seen)
    wide = reach[:, None] / GATES
    first = np.array([len(track.history) == 1 for track in tracks])[:, None]
    gain = _log_density(square, np.where(first, 1, DRIFT) * wide, wide, TURNED_RATE)
    return np.where(square <= reach[:, None] ** 2, gain, -np.inf)


def _known_gains(
    tracks: Sequence[Track],
    stamp: float,
    seen: Sequence[Sighting],
    gate: float,
    expected: Prediction,
    drift: np.ndarray,
) -> list[np.ndarray]:
    """Return the same with the predicted places of those parts that have one, (T, M) each: if the
    predictions are as usual, and if they are poor."""
    row = {name: i for i, name in enumerate(expected.ids)}
    rows = [i for i, track in enumerate(tracks) if track.id in row]
    if not rows:
        return [drift, drift]
    known = [tracks[i] for i in rows]
    last = np.array([track.history[-1][0] for track in known])
    images = np.array([1.0 + track.missed for track in known])[:, None]
    way = np.minimum((stamp - last) / (expected.stamp - last), MOST_WAYS)[:, None]
    begin = np.array([track.position for track in known])
    end = expected.position[[row[track.id] for track in known]]
    square = _square(begin + way * (end - begin), seen)
    beyond = np.maximum(stamp - expected.stamp, 0) / (stamp - last)[:, None]
    wide = gate / GATES * images * beyond
    more = (4 * SWING_M * np.maximum(way * (1 - way), 0)) ** 2 + (DRIFT * wide) ** 2
    pushed, rate = np.hypot(PUSHED_M * images, wide), PUSHED_RATE + TURNED_RATE * beyond
    gains = []
    for deviation in (PREDICTED_M, POOR_M):
        usual = np.sqrt((deviation * images) ** 2 + more)
        near = _log_density(square, usual, pushed, rate)
        gain = drift.copy()
        gain[rows] = np.where(square <= (gate * images) ** 2, near, -np.inf)
        gains.append(gain)
    return gains


def _square(place: np.ndarray, seen: Sequence[Sighting]) -> np.ndarray:
    """Return the squared distances (T, M) [m2] of places (T, 2) [m] from sightings."""
    gap = place[:, None] - np.array([one.position for one in seen])
    return np.asarray(np.sum(gap**2, axis=2))


def _log_density(
    square: np.ndarray, usual: np.ndarray, wide: np.ndarray, rate: np.ndarray | float
) -> np.ndarray:
    """Return the logarithm of the density [1/m2] at squared distances (T, M) [m2] from the middle
    of a normal distribution in the plane, with another one for a fraction `rate` of all."""
    parts = [
        np.log(share) - 0.5 * square / deviation**2 - np.log(math.tau * deviation**2)
        for share, deviation in ((1 - rate, usual), (rate, wide))
    ]
    return np.logaddexp(*parts)
