"""A disturbance observer: what parts do otherwise than was foretold, cycle after cycle.

Motors that give less than they should, a surface that is more slippery than assumed, a solver's
model that is not quite true: what one cycle does differently the next one will do too, nearly. On
a path it is the same along and across it, so it is kept so, and turns with the path at corners.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Disturbance:
    """Drift that parts have beyond what was foretold, and what is foretold now.

    Attributes
    ----------
    drift : (P, 2)
        Along and across each path [m/s].
    place : (P, 2)
        Where each path's part will be [m, plate_home]; NaN where it was not seen.
    at : float
        At which stamp [s].
    age : float or None
        Age that the images were taken to have [s]; None: it was not known.
    """

    drift: np.ndarray
    place: np.ndarray
    at: float = 0.0
    age: float | None = None

    @classmethod
    def none(cls, count: int) -> Disturbance:
        """Return what is known of `count` parts before the first cycle."""
        return cls(np.zeros((count, 2)), np.full((count, 2), np.nan))

    def foretell(self, place: np.ndarray, at: float, age: float | None) -> Disturbance:
        """Return it with where parts will be (P, 2) [m], NaN if unseen, at a stamp [s]."""
        return replace(self, place=place, at=at, age=age)

    def see(
        self,
        place: np.ndarray,
        t: float,
        age: float | None,
        period: float,
        axes: np.ndarray,
        gain: float,
        most: np.ndarray,
    ) -> Disturbance:
        """Take in where parts are.

        Parameters
        ----------
        place : (P, 2)
            As seen [m, plate_home]; NaN if unseen.
        t : float
            Stamp of the image [s]; nothing is learnt if nothing was foretold for it.
        age : float or None
            Age that the image is taken to have [s]; nothing is learnt if it is another, or unknown.
        period : float
            Length of the cycle that has ended [s].
        axes : (P, 2, 2)
            Unit vectors along and across each path, in rows.
        gain : float
            Share of what is new that counts [-].
        most : (P,)
            Greatest drift to be believed [m/s].
        """
        if age is None or age != self.age or abs(t - self.at) > 0.01 * period:
            return self
        new = np.einsum("pij,pj->pi", axes, place - self.place) / period
        new = np.clip(new, -most[:, None], most[:, None])
        known = np.isfinite(new)
        drift = self.drift + gain * np.where(known, new - self.drift, 0.0)
        return replace(self, drift=drift)

    def along(self, axes: np.ndarray) -> np.ndarray:
        """Return the drift (P, 2) [m/s, plate_home] on paths with these axes."""
        return np.einsum("pi,pij->pj", self.drift, axes)
