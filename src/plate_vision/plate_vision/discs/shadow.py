"""The shadows from one lamp. All parts have shadows of the same direction, length and darkness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera.lens import Calibration


@dataclass(frozen=True, eq=False)
class Shadow:
    """The shadow of a part. If the part's base is moved by `offset_m`, the base passes over the
    area of the shadow.

    Attributes
    ----------
    calibration : Calibration
    offset_m : (2,)
        Displacement from the part's place to the end of its shadow [m, plate_home].
    darkness : float
        Fraction of the light that is missing in the shadow.
    edge_px : float
        Half the width of the shadow's edge [px].
    """

    calibration: Calibration
    offset_m: np.ndarray
    darkness: float
    edge_px: float

    def cast(self, places_px: np.ndarray, parts: np.ndarray) -> np.ndarray:
        """Return the displacements (n, 2) [px, disc's frame] of the shadows of parts (n,)
        SILHOUETTE at places (n, 2) [px]."""
        slopes = self.calibration.slopes(places_px)
        offset = np.linalg.solve(
            slopes, np.broadcast_to(self.offset_m[:, None], (len(slopes), 2, 1))
        )
        return np.ascontiguousarray((parts["across"] @ offset)[:, :, 0])

    def drawn(self, places_px: np.ndarray, parts: np.ndarray) -> np.ndarray:
        """Return the silhouettes (n,) SILHOUETTE of parts at places (n, 2) [px] together with their
        shadows."""
        drawn = parts.copy()
        cast = self.cast(places_px, parts)
        # A silhouette can extend in only one direction. `lean_px` is the vector from the image of
        # the part's base to the image of its top. If the shadow is longer than this vector, the
        # shadow replaces it. In this case, the shadow covers almost all of the side faces.
        longer = np.hypot(*cast.T) > np.hypot(*parts["lean_px"].T)
        drawn["lean_px"][longer] = cast[longer]
        drawn["growth"][longer] = 1
        return drawn
