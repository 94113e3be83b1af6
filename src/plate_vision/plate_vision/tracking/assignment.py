"""Assignment of the detections in an image to tracks by maximum likelihood.

A pair consists of a track and a detection. The gain of a pair is the logarithm of the ratio of two
likelihoods. The first likelihood assumes that the detection shows the track's part. The second
likelihood assumes that the part is missed and the detection is new or false. The gain depends on
position, class and angle. The sum of the gains is maximised (linear_sum_assignment of scipy). The
expected position of a part is the prediction of the planner's filter, which uses the plate's
motion. Without such a prediction, the position is extrapolated from the drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from .track import Detection, Prediction, Track

MISSED_RATE, FALSE_RATE = 0.05, 0.02
"""`MISSED_RATE`: fraction of parts that are not detected in an image. `FALSE_RATE`: number of false
detections per part. A factor of three has little effect, because only the logarithms of both values
are used."""

CROWD = 200.0
"""Number of parts per square metre of a full plate. The product of this number and `FALSE_RATE` is
the density of false detections."""

NEW_RATE = 0.02
"""Fraction of the detections without a track that show a part and are not false."""

PREDICTED_M, POOR_M = 0.4e-3, 3e-3
"""Standard deviation of the error of a predicted position along each axis [m], for usual and for
poor predictions. In tasks with 30 parts, the standard deviation is 0.1 to 0.2 mm. While the age of
images is not known, the standard deviation is several millimetres for all parts."""

PUSHED_M, PUSHED_RATE = 5e-3, 1e-4
"""`PUSHED_M`: standard deviation of the position of a part that another part has pushed [m].
`PUSHED_RATE`: fraction of such parts [-]."""

SWING_M = 2e-3
"""Additional standard deviation of a predicted position half-way between the last detection and the
time of the prediction [m]. This value is needed because parts oscillate during a cycle."""

MAX_FRACTION = 2.0
"""Maximum fraction of a predicted displacement that is applied [-]. If an image is later than the
time of the prediction, the displacement is extrapolated and the fraction is above 1."""

GATES, DRIFT, TURNED_RATE = 3.0, 0.3, 0.2
"""`GATES`: gate, relative to the standard deviation of the positions of parts without a prediction.
`DRIFT`: factor by which this standard deviation is multiplied for parts whose drift continues.
`TURNED_RATE`: fraction of parts whose drift does not continue."""

PREDICTIONS_FAIL = 1e-3
"""Fraction of images in which predictions are poor or wrong, for example because the plate executed
another cycle than the predicted one."""

ANGLE_SD_RAD = 0.15
"""Standard deviation of a part's angle from the angle that is extrapolated with its last spin, per
image [rad]."""

ANY_ANGLE_FRACTION = 0.05
"""Fraction of detections whose angle can have any value, for example because a mark was misread or
a part was hit."""

VAGUE_RAD = 1.0
"""Maximum standard deviation of an angle that is used [rad]."""


def assign(
    tracks: Sequence[Track],
    stamp: float,
    seen: Sequence[Detection],
    gate: float,
    expected: Prediction | None = None,
) -> np.ndarray:
    """Return the index (T,) of the detection for each track, or -1 if the track has no detection.

    A pair is chosen only if it is more likely than the combination of a missed part and a new or
    false detection.

    Parameters
    ----------
    tracks : sequence of Track
        The T parts.
    stamp : float
        Stamp of the image [s].
    seen : sequence of Detection
        The M detections.
    gate : float
        Maximum distance between a part and its expected position [m], per image since the part was
        last detected.
    expected : Prediction, optional
        Prediction for a time after the last image.
    """
    found = np.full(len(tracks), -1)
    if not len(found) or not seen:
        return found
    other = _class_gain(tracks, seen) + _angle_gain(tracks, stamp, seen)
    drift = _drift_gain(tracks, stamp, seen, gate)
    choices = [_solve_assignment(drift + other)]
    if expected is not None:
        expected_gain, poor = _prediction_gains(tracks, stamp, seen, gate, expected, drift)
        rows, columns, gain = _solve_assignment(expected_gain + other)
        # The gain of the assignment with usual prediction errors is increased, because large errors
        # of the predictions are rare.
        choices = [
            (rows, columns, gain - math.log(PREDICTIONS_FAIL)),
            _solve_assignment(poor + other),
            *choices,
        ]
    rows, columns, _ = max(choices, key=lambda choice: choice[2])
    found[rows] = columns
    return found


def _solve_assignment(gain: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the rows, the columns and the sum of the assignment with the largest sum of gains.
    Pairs with a gain of 0 or less are omitted."""
    rows, columns = linear_sum_assignment(np.maximum(gain, 0.0), maximize=True)
    value = gain[rows, columns]
    kept = value > 0
    return rows[kept], columns[kept], float(np.sum(value[kept]))


def _class_gain(tracks: Sequence[Track], seen: Sequence[Detection]) -> np.ndarray:
    """Return the log likelihood gain of each pair (T, M), without the contribution of the position.

    The gain is log(P(class)) + log(shown / (1 - shown)) - log(density of false detections), where
    `shown` is the probability that the part exists and is detected.
    """
    labels = [detection.label for detection in seen]
    among = [*dict.fromkeys(labels)]
    likely = np.log([[track.likely(label) for label in among] for track in tracks])
    exists = np.array([1.0 if track.number else NEW_RATE for track in tracks])
    shown = np.log(exists * (1 - MISSED_RATE) / (1 - exists * (1 - MISSED_RATE)))
    gain = likely[:, [among.index(label) for label in labels]] + shown[:, None]
    return gain - math.log(CROWD * FALSE_RATE)


def _angle_gain(
    tracks: Sequence[Track], stamp: float, seen: Sequence[Detection]
) -> np.ndarray | float:
    """Return the log likelihood gain from the angles (T, M). The angles of false detections are
    assumed to be uniformly distributed."""
    unsure = np.array([track.quality[1] for track in tracks])
    angle_sd = np.array(
        [detection.quality[1] if detection.symmetry else math.nan for detection in seen]
    )
    known = (unsure < VAGUE_RAD)[:, None] & (angle_sd < VAGUE_RAD)
    if not np.any(known):
        return 0.0
    angle = np.array([track.angle_at(stamp) for track in tracks])
    images = np.array([1 + track.missed for track in tracks])
    deviation = np.sqrt(((ANGLE_SD_RAD * images) ** 2 + unsure**2)[:, None] + angle_sd**2)
    period = math.tau / np.array([max(detection.symmetry, 1) for detection in seen])
    gap = np.array([detection.angle for detection in seen]) - angle[:, None]
    gap -= period * np.round(gap / period)
    normal = period / (math.sqrt(math.tau) * deviation) * np.exp(-0.5 * (gap / deviation) ** 2)
    return np.where(known, np.log((1 - ANY_ANGLE_FRACTION) * normal + ANY_ANGLE_FRACTION), 0.0)


def _drift_gain(
    tracks: Sequence[Track], stamp: float, seen: Sequence[Detection], gate: float
) -> np.ndarray:
    """Return the log density [1/m2] of detections (T, M) if the drift of the parts continues. The
    log density is minus infinity outside the gate."""
    reach = gate * np.array([1 + track.missed for track in tracks])
    place = [
        track.predicted(stamp, max_distance)
        for track, max_distance in zip(tracks, reach, strict=True)
    ]
    square = _squared_distances(np.array(place), seen)
    wide = reach[:, None] / GATES
    first = np.array([len(track.history) == 1 for track in tracks])[:, None]
    gain = _log_density(square, np.where(first, 1, DRIFT) * wide, wide, TURNED_RATE)
    return np.where(square <= reach[:, None] ** 2, gain, -np.inf)


def _prediction_gains(
    tracks: Sequence[Track],
    stamp: float,
    seen: Sequence[Detection],
    gate: float,
    expected: Prediction,
    drift: np.ndarray,
) -> list[np.ndarray]:
    """Return two arrays of log densities (T, M) like `_drift_gain`, in which parts with a
    prediction have their predicted positions. The first array assumes usual predictions, the second
    array assumes poor predictions."""
    row = {name: i for i, name in enumerate(expected.ids)}
    rows = [i for i, track in enumerate(tracks) if track.id in row]
    if not rows:
        return [drift, drift]
    known = [tracks[i] for i in rows]
    last = np.array([track.history[-1][0] for track in known])
    images = np.array([1.0 + track.missed for track in known])[:, None]
    fraction = np.minimum((stamp - last) / (expected.stamp - last), MAX_FRACTION)[:, None]
    begin = np.array([track.position for track in known])
    end = expected.position[[row[track.id] for track in known]]
    square = _squared_distances(begin + fraction * (end - begin), seen)
    beyond = np.maximum(stamp - expected.stamp, 0) / (stamp - last)[:, None]
    wide = gate / GATES * images * beyond
    more = (4 * SWING_M * np.maximum(fraction * (1 - fraction), 0)) ** 2 + (DRIFT * wide) ** 2
    pushed, rate = np.hypot(PUSHED_M * images, wide), PUSHED_RATE + TURNED_RATE * beyond
    gains = []
    for deviation in (PREDICTED_M, POOR_M):
        deviation_usual = np.sqrt((deviation * images) ** 2 + more)
        near = _log_density(square, deviation_usual, pushed, rate)
        gain = drift.copy()
        gain[rows] = np.where(square <= (gate * images) ** 2, near, -np.inf)
        gains.append(gain)
    return gains


def _squared_distances(place: np.ndarray, seen: Sequence[Detection]) -> np.ndarray:
    """Return the squared distances (T, M) [m2] between places (T, 2) [m] and detections."""
    gap = place[:, None] - np.array([detection.position for detection in seen])
    return np.asarray(np.sum(gap**2, axis=2))


def _log_density(
    square: np.ndarray, usual: np.ndarray, wide: np.ndarray, rate: np.ndarray | float
) -> np.ndarray:
    """Return the log density [1/m2] of a mixture of two planar normal distributions at squared
    distances (T, M) [m2] from their mean. One distribution has the weight `rate` and the standard
    deviation `wide`, the other one has the weight 1 - `rate` and the standard deviation `usual`."""
    parts = [
        np.log(weight) - 0.5 * square / deviation**2 - np.log(math.tau * deviation**2)
        for weight, deviation in ((1 - rate, usual), (rate, wide))
    ]
    return np.logaddexp(*parts)
