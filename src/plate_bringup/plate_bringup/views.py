"""Variants of a rig with a different camera, for example tilted, nearer, or with another lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from plate_core import PlateError, Rig
from plate_core.rig import Lens

__all__ = ["MARGIN_PX", "view_from", "with_height"]

MARGIN_PX = 12.0
"""If no distance of the camera is given, the corners of the plate are at least this far inside the
image [px]."""

NEAREST_M = 0.05
"""Minimum camera distance in the search [m]."""

FARTHEST_M = 100.0
"""Maximum camera distance in the search [m]."""

HALVINGS = 60
"""Number of bisections in the search for the camera's distance. This number is large enough to find
the distance up to rounding."""


def view_from(
    rig: Rig,
    *,
    tilt_deg: float = 0.0,
    towards_deg: float = 0.0,
    focal_px: float = 900.0,
    distance_m: float = 0.0,
    distortion: Sequence[float] = (),
) -> Rig:
    """Return a rig whose camera points to the middle of the plate. The top of the image is towards
    +y.

    Parameters
    ----------
    rig : Rig
        Rig that supplies all other data, for example the size of the image.
    tilt_deg, towards_deg : float
        `tilt_deg` is the angle between the camera's axis and the vertical [degrees]. `towards_deg`
        is the horizontal direction from the middle of the plate to the camera, counter-clockwise
        from x [degrees].
    focal_px : float
        Focal length of the lens [px]. The principal point is the middle of the image.
    distance_m : float
        Distance between the camera and the middle of the plate [m]. 0 selects the smallest distance
        at which all corners of the plate are at least `MARGIN_PX` inside the image.
    distortion : sequence of float
        Distortion coefficients k1, k2, p1, p2, k3 of the lens. Empty if there is no distortion.

    Raises
    ------
    PlateError
        If a corner of the plate is not in front of the camera.
    """
    size = np.array([rig.camera.width_px, rig.camera.height_px])
    middle = (float(size[0] - 1) / 2, float(size[1] - 1) / 2)
    k1, k2, p1, p2, k3 = distortion or (0.0,) * 5
    lens = Lens((focal_px, focal_px), middle, (k1, k2, p1, p2, k3))
    rotation = _camera_rotation(tilt_deg, towards_deg)

    def project_corners(distance: float) -> np.ndarray | None:
        ray = rig.plate.corners @ rotation[:, :2].T + [0.0, 0.0, distance]
        if np.any(ray[:, 2] <= 0):
            return None
        return lens.bend(ray[:, :2] / ray[:, 2:] * focal_px + middle)

    near, far = NEAREST_M, FARTHEST_M
    for _ in range(HALVINGS if distance_m == 0 else 0):
        half = (near + far) / 2
        seen_px = project_corners(half)
        low, high = MARGIN_PX, size - 1 - MARGIN_PX
        inside = seen_px is not None and np.all((seen_px >= low) & (seen_px <= high))
        near, far = (near, half) if inside else (half, far)
    seen = project_corners(distance_m or far)
    if seen is None:
        raise PlateError(
            f"camera: at a distance of {distance_m:g} m and a tilt of {tilt_deg:g} degrees, a "
            "corner of the plate is behind the camera, allowed: a larger distance or a smaller "
            "tilt"
        )
    corners_px = tuple((float(u), float(v)) for u, v in seen)
    return replace(rig, camera=replace(rig.camera, corners_px=corners_px, lens=lens))


def with_height(rig: Rig, height_m: float) -> Rig:
    """Return a rig in which all parts have the height `height_m` [m], including parts with a
    type."""
    types = {name: replace(part, height_m=height_m) for name, part in rig.types.items()}
    return replace(rig, parts=replace(rig.parts, height_m=height_m), types=types)


def _camera_rotation(tilt_deg: float, towards_deg: float) -> np.ndarray:
    """Return the axes of plate_home in the frame of the camera, as columns (3, 3)."""
    tilt, towards = np.radians([tilt_deg, towards_deg])
    beside = np.array([np.cos(towards), np.sin(towards), 0.0])
    ahead = -np.sin(tilt) * beside - np.array([0.0, 0.0, np.cos(tilt)])
    right = np.array([1.0, 0.0, 0.0]) - ahead[0] * ahead
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])
