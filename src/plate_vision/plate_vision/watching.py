"""Keeps an eye on a plate with markers: finds plate_home once, then the plate in every image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plate_core import Rig
from plate_core.rig import Fiducials, to_home

from .calibration import Calibration, Lens, rig_lens
from .errors import CalibrationError
from .fiducials import PlatePose, find_home, find_pose, hide
from .options import DetectorOptions
from .vision import Vision, make_vision

MOVED_M = 5e-4
"""Way of a corner of the plate [m] from which parts are looked for in another region: half a pixel
of the default rig. Regions are kept, so a plate that comes home costs nothing."""

AWAY_M = 2e-3
"""A plate this far from home [m] when an image is taken is worth a warning."""


@dataclass(frozen=True, eq=False)
class Watch:
    """What is known of a plate with markers.

    Attributes
    ----------
    rig : Rig
        With fiducials.
    lens : Lens, optional
        That of camera_info; the rig's if None.
    home : Calibration or None
        Found in the first image that showed all markers; until then None.
    plate : PlatePose or None
        In the last image; None if too few markers were seen.
    used : (3,)
        Pose [m, m, rad] for which the region was made in which parts are looked for.
    """

    rig: Rig
    lens: Lens | None = None
    home: Calibration | None = None
    plate: PlatePose | None = None
    used: np.ndarray | None = None

    @property
    def fiducials(self) -> Fiducials:
        """The rig's markers."""
        if self.rig.fiducials is None:
            raise CalibrationError("rig: has no fiducials, allowed: a rig file with that section")
        return self.rig.fiducials

    @property
    def problem(self) -> str | None:
        """What a user should know, or None."""
        if self.plate is None:
            return "the plate's markers are not seen, it is taken to be where it was"
        away = float(np.hypot(*self.plate.pose[:2]))
        if away > AWAY_M:
            return (
                f"the plate is {1e3 * away:.1f} mm from home when the image is taken, allowed: "
                f"{1e3 * AWAY_M:g} mm (is the camera triggered at the cycle's start; was it moved? "
                "then call the service reset)"
            )
        return None


def watch(
    state: Watch, image: np.ndarray, vision: Vision, options: DetectorOptions
) -> tuple[Watch, Vision, np.ndarray]:
    """Look for the plate in an image, before parts are looked for.

    Parameters
    ----------
    state : Watch
        What is known so far.
    image : (H, W) or (H, W, 3) uint8
    vision : Vision
        With which parts were looked for in the last image.
    options : DetectorOptions
        What a part looks like.

    Returns
    -------
    Watch
    Vision
        With which parts are to be looked for in this image: where the plate is now.
    image
        The image without the markers, which could be taken for parts.

    Raises
    ------
    CalibrationError
        If plate_home is not known yet, and the image does not show it.
    """
    fiducials = state.fiducials
    home = state.home
    if home is None:
        home, _ = find_home(image, fiducials, state.lens or rig_lens(state.rig))
        state = replace(state, home=home)
    last = None if state.plate is None else state.plate.pose
    plate = find_pose(image, fiducials, home, last)
    used = np.zeros(3) if state.used is None else state.used
    pose = used if plate is None else plate.pose
    if state.used is None or _way(state.rig, pose, used) > MOVED_M:
        used = pose if _way(state.rig, pose, np.zeros(3)) > MOVED_M else np.zeros(3)
        vision = make_vision(state.rig, options, calibration=home, pose=used)
    state = replace(state, plate=plate, used=used)
    return state, vision, hide(image, fiducials, home, pose)


def _way(rig: Rig, pose: np.ndarray, other: np.ndarray) -> float:
    """Return how far the plate's corners are apart at two poses [m]."""
    corners = rig.plate.corners
    return float(np.abs(to_home(pose, corners) - to_home(other, corners)).max())
