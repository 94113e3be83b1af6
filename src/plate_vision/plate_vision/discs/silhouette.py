"""The silhouette of a round part at a place of the image: its size, its shape, and its lean, which
is the displacement of its top.

Near one place the mapping from the image to the plate is linear, so a part of radius r appears as
an ellipse. A part of height h at the place p also shows its side faces. The top of the part appears
at p + l, enlarged by the factor H / (H - h). The lean l is

    l = (p - c) h / (H - h),

c is the point of the plate below the camera. H is the height of the camera above the plate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..camera.lens import Calibration

SILHOUETTE = np.dtype(
    [("across", "f8", (2, 2)), ("radius_px", "f8"), ("lean_px", "f8", (2,)), ("growth", "f8")]
)
"""The silhouette of a part at one place of the image. `across` transforms image offsets [px] to the
disc's frame. In this frame, the contour at the plate is a circle with the radius `radius_px`. A
disc with the radius `radius_px` has the same area in the image as the contour. The top is a circle
with `growth` times this radius around `lean_px` [px, disc's frame]."""

RING = 8
"""Number of points of a disc's contour that are mapped to the plate."""

Silhouettes = Callable[[np.ndarray], np.ndarray]
"""Returns the silhouettes (n,) SILHOUETTE of a part at image points (n, 2) [px]."""


@dataclass(frozen=True)
class EvenDiscs:
    """Silhouettes of a flat disc that has the same radius [px] at all places."""

    radius_px: float

    def __call__(self, point_px: np.ndarray) -> np.ndarray:
        """Return the silhouettes (n,) SILHOUETTE at image points (n, 2) [px]."""
        found = np.zeros(len(point_px), SILHOUETTE)
        found["across"] = np.eye(2)
        found["radius_px"] = self.radius_px
        found["growth"] = 1
        return found


@dataclass(frozen=True, eq=False)
class SeenDiscs:
    """Silhouettes of a part with a radius and a height [m] in a camera's images.

    J is the derivative of plate_home with respect to the image. J is decomposed as J = Q S with Q
    orthogonal and S symmetric. Then `across` is S / sqrt(det S). The height is ignored if the
    camera's place is unknown.
    """

    calibration: Calibration
    radius: float
    height: float

    def __call__(self, point_px: np.ndarray) -> np.ndarray:
        """Return the silhouettes (n,) SILHOUETTE at image points (n, 2) [px]."""
        place = self.calibration.camera_position if self.height else None
        slopes = self.calibration.slopes(point_px)
        a, b, c, d = slopes.reshape(-1, 4).T
        area = np.abs(a * d - b * c)  # sqrt(det J'J) [m2/px2]
        found = np.zeros(len(slopes), SILHOUETTE)
        xx, xy, yy = a * a + c * c + area, a * b + c * d, b * b + d * d + area
        # S = N / sqrt(trace N), with N = J'J + sqrt(det(J'J)) I
        across = np.array([xx, xy, xy, yy]) / np.sqrt((xx + yy) * area)
        found["across"] = across.T.reshape(-1, 2, 2)
        found["radius_px"] = self.radius / np.sqrt(area)
        found["growth"] = 1
        if place is not None:
            x, y = (
                (self.calibration.to_home(point_px) - place[:2]).T
                * self.height
                / (place[2] - self.height)
            )
            # Let l be the vector (x, y) on the plate. In the disc's frame, this vector is Q' l =
            # S^-1 J' l. Here, it is divided by the pixel size.
            right, down = (a * x + c * y) / area, (b * x + d * y) / area
            p, q, r, s = across
            found["lean_px"][:, 0] = s * right - q * down
            found["lean_px"][:, 1] = p * down - r * right
            found["growth"] = place[2] / (place[2] - self.height)
        return found


def silhouette_rows(parts: np.ndarray) -> np.ndarray:
    """Return silhouettes (n,) `SILHOUETTE` as rows of numbers (n, 8)."""
    return parts.view(float).reshape(-1, 8)


def to_image(parts: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Transform offsets (n, 2) or (n, k, 2) [px] from the frames of n discs to the image [px]."""
    p, q, r, s = parts["across"].reshape(-1, 4).T
    x, y = offset.T  # (n,) or (k, n)
    seen = np.empty(offset.shape)
    seen.T[0], seen.T[1] = s * x - q * y, p * y - r * x  # det(across) is 1
    return seen


def outlines(parts: np.ndarray, radius_px: np.ndarray) -> np.ndarray:
    """Return image offsets (n, RING, 2) [px] of points on the contours at the plate, for radii (n,)
    [px]."""
    angle = 2 * np.pi * np.arange(RING) / RING
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return to_image(parts, radius_px[:, None, None] * ring)


def tops(places_px: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return the centres (n, 2) [px] of the tops of parts at places (n, 2) [px]."""
    lean = parts["lean_px"]
    return places_px + to_image(parts, lean) if np.any(lean) else places_px


def reach_limits(parts: np.ndarray) -> np.ndarray:
    """Return upper limits (n,) for the distance between each part's place and any point of its
    silhouette in the image [px]."""
    half = 0.5 * np.einsum("nij,nij->n", parts["across"], parts["across"])
    stretch = np.sqrt(half + np.sqrt(np.maximum(half * half - 1, 0)))
    reach = parts["growth"] * parts["radius_px"]
    if np.any(parts["lean_px"]):
        reach = reach + np.hypot(*parts["lean_px"].T)
    return np.asarray(reach * stretch)
