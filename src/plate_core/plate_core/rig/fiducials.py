"""Markers on the plate, from which vision computes the pose of the plate. This module reads and
checks the section `fiducials` of a rig file and computes the corners of the markers."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ..errors import RigError
from ..yaml_fields import Fields
from .keys import FIDUCIALS, MAX_XY

LOW, HIGH = 4, 16
"""Minimum and maximum number of markers. With fewer than four markers, vision could not check the
consistency of their positions."""

NAME = re.compile(r"marker_(0|[1-9]\d{0,3})")
"""Keys of the markers in a rig file. The values of these keys are the numbers of the markers in the
dictionary."""


@dataclass(frozen=True)
class Fiducials:
    """ArUco markers flat on the plate, with their upper sides towards +y of the plate.

    Attributes
    ----------
    dictionary : str
        OpenCV's name of the set of markers, without `DICT_`, such as 4X4_50.
    side_m : float
        Side of the black square [m].
    numbers : (n,) tuple of int
        Numbers of the markers in the dictionary.
    centres : (n,) tuple of (x, y)
        Centres of the markers [m, plate frame].
    """

    dictionary: str
    side_m: float
    numbers: tuple[int, ...]
    centres: tuple[tuple[float, float], ...]

    @property
    def corners(self) -> np.ndarray:
        """Corners (n, 4, 2) [m, plate frame] in the order top left, top right, bottom right, bottom
        left."""
        square = 0.5 * self.side_m * np.array([[-1.0, 1], [1, 1], [1, -1], [-1, -1]])
        return np.array(self.centres)[:, None] + square


def read_fiducials(fields: Fields) -> Fiducials:
    """Read the section `fiducials` of a rig file.

    Raises
    ------
    RigError
        If a key is missing or unknown, or its value is not allowed.
    """
    dictionary = fields.value(FIDUCIALS["dictionary"])
    side = fields.value(FIDUCIALS["side_m"])
    centres = fields.child("centre_m")
    names = centres.keys()
    if not LOW <= len(names) <= HIGH:
        raise RigError(
            f"{centres.where}: number of markers is {len(names)}, allowed: {LOW} to {HIGH}"
        )
    if not all(NAME.fullmatch(name) for name in names):
        raise RigError(
            f"{centres.where}: keys are {', '.join(names)}, allowed: marker_0, marker_1, ..."
        )
    places = [centres.array(name, (2,), -MAX_XY, MAX_XY) for name in names]
    gap = np.linalg.norm(np.array(places)[:, None] - places, axis=2)
    if np.any(gap[~np.eye(len(places), dtype=bool)] < 1.2 * side):
        raise RigError(
            f"{centres.where}: two centres are {gap[gap > 0].min(initial=0):g} m apart, allowed: "
            f"more than {1.2 * side:g} m (1.2 times the side of a marker)"
        )
    spread = np.linalg.svd(places - np.mean(places, axis=0), compute_uv=False)
    if spread[1] < side:
        raise RigError(
            f"{centres.where}: all centres are on one line, allowed: centres that span an area"
        )
    fields.finish()
    return Fiducials(
        dictionary,
        side,
        tuple(int(name.removeprefix("marker_")) for name in names),
        tuple((float(x), float(y)) for x, y in places),
    )
