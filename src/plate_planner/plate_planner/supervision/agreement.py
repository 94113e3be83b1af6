"""Agreement of the parts' motion with its prediction. The result explains why parts are lost.

A prediction is wrong in sign if the image is mirrored or rotated, or if a motor moves in the wrong
direction. Other errors of the model, such as wrong friction, change the sign of few displacements.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts

from ..estimation import rows_of

SOON_S = 0.03
"""Maximum time between a prediction and the image that it is compared with [s]. The time is below
the interval of images at 30 images per second."""

SAME_S = 1e-6
"""Maximum error of a stamp by rounding [s]."""

SHORT_M, LONG_M = 0.5e-3, 30e-3
"""Range of displacements that are compared [m]. Shorter displacements are not certain. Longer ones
are caused by a hand."""

LAST, FEW = 60, 15
"""Number of the last displacements that are compared, and minimum number for a result."""

OPPOSITE = 0.3
"""Maximum correlation along an axis if the axis is reversed. In simulated tasks with correct axes,
with friction between 0.6 and 1.3 times the assumed value, the minimum is 0.6."""


@dataclass(frozen=True)
class Agreement:
    """The last displacements of the parts, and their predictions.

    Attributes
    ----------
    moves : (n, 2, 2)
        Predicted and observed displacements [m, plate_home], oldest first, at most `LAST`.
    ids : tuple of M str
        Parts of the current prediction. Empty if there is none.
    position, predicted : (M, 2)
        Their observed and their predicted positions [m, plate_home].
    stamp : float
        Time of the predicted positions [s].
    """

    moves: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    ids: tuple[str, ...] = ()
    position: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    predicted: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    stamp: float = -np.inf

    def expecting(
        self, seen: Parts, ids: tuple[str, ...], predicted: np.ndarray, stamp: float
    ) -> Agreement:
        """Record the positions (M, 2) [m] of the parts `ids` that are predicted for the time
        `stamp` [s]. `seen` are the parts in the last image. An earlier prediction stays until it
        has been compared."""
        if self.ids:
            return self
        row = rows_of(ids, seen.ids)
        detected = np.flatnonzero(row >= 0)
        return replace(
            self,
            ids=tuple(ids[k] for k in detected),
            position=seen.position[row[detected]],
            predicted=predicted[detected],
            stamp=stamp,
        )

    def seeing(self, seen: Parts, t: float) -> Agreement:
        """Compare the parts in an image with the stamp t [s] with their prediction, if the
        prediction is for this time."""
        if not self.ids or t < self.stamp - SAME_S:
            return self
        moves = self.moves
        if t < self.stamp + SOON_S:
            row = rows_of(self.ids, seen.ids)
            known = row >= 0
            pair = np.stack([self.predicted[known], seen.position[row[known]]], axis=1)
            pair -= self.position[known, None]
            length = np.hypot(*pair.transpose(2, 0, 1))
            used = (length[:, 0] > SHORT_M) & np.all(length < LONG_M, axis=1)
            moves = np.concatenate([moves, pair[used]])[-LAST:]
        return Agreement(moves)

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of predicted and observed displacements along x and y (2,) [-]."""
        product = np.einsum("nia,nja->aij", self.moves, self.moves)
        scale = np.sqrt(product[:, 0, 0] * product[:, 1, 1])
        return np.divide(product[:, 0, 1], scale, out=np.ones(2), where=scale > 0)

    @property
    def text(self) -> str:
        """Text about reversed axes. Empty if the parts move as predicted, or too little is
        known."""
        x, y = self.correlation
        if len(self.moves) < FEW or min(x, y) > OPPOSITE:
            return ""
        return (
            f"the parts do not follow the plate (correlation {x:.2f} along x, {y:.2f} along y): "
            "the image is mirrored or rotated (check the camera's driver and the order of "
            "corners_px), or a motor moves in the wrong direction"
        )

    def explained(self, text: str) -> str:
        """Return the reason `text` of a failure. If the axes seem reversed, the text about this
        comes first."""
        return "; ".join(filter(None, (self.text, text)))
