"""The shadows that one lamp casts: the same direction, length and darkness for all parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera.lens import Calibration


@dataclass(frozen=True, eq=False)
class Shadow:
    """The shadow of a part: the plate is darker where the part's base, moved along `way`, passes.

    Attributes
    ----------
    calibration : Calibration
    way : (2,)
        From the part's place to the end of its shadow [m, plate_home].
    darkness : float
        Fraction of the light that is missing in it.
    edge_px : float
        Half the width of its edge [px].
    """

    calibration: Calibration
    way: np.ndarray
    darkness: float
    edge_px: float

    def cast(self, places_px: np.ndarray, parts: np.ndarray) -> np.ndarray:
        """Return the ways (n, 2) [px, disc's frame] of the shadows of parts (n,) SILHOUETTE at
        places (n, 2) [px]."""
        slopes = self.calibration.slopes(places_px)
        offset = np.linalg.solve(slopes, np.broadcast_to(self.way[:, None], (len(slopes), 2, 1)))
        return np.ascontiguousarray((parts["across"] @ offset)[:, :, 0])

    def drawn(self, places_px: np.ndarray, parts: np.ndarray) -> np.ndarray:
        """Return silhouettes (n,) SILHOUETTE of parts at places (n, 2) [px], with their shadows."""
        drawn = parts.copy()
        cast = self.cast(places_px, parts)
        # Of a part with a height the side faces are mostly within the longer of both.
        longer = np.hypot(*cast.T) > np.hypot(*parts["lean_px"].T)
        drawn["lean_px"][longer] = cast[longer]
        drawn["growth"][longer] = 1
        return drawn
