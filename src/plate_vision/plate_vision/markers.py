"""ArUco markers in an image: the only file that knows OpenCV's two ways to ask for them.

OpenCV 4.7 made classes of what were functions. All else that a board needs is done by what all
versions have alike.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from .errors import CalibrationError
from .squares import square_corners

DICTIONARIES = tuple(
    name.removeprefix("DICT_")
    for name in sorted(dir(getattr(cv2, "aruco", None)))
    if name.startswith("DICT_") and name == name.upper()
)
"""Names of the sets of markers that OpenCV knows, such as 4X4_50; none if it was built without."""

SETTINGS = {
    "perspectiveRemovePixelPerCell": 8,
    "perspectiveRemoveIgnoredMarginPerCell": 0.3,
    "maxErroneousBitsInBorderRate": 0.5,
}
"""How OpenCV reads a marker, where not by its defaults: only the middle of a module counts, so that
markers of 30 px are read in a blur of 1.5 px."""


def find_markers(grey: np.ndarray, dictionary: str) -> dict[int, np.ndarray]:
    """Find the markers of a dictionary.

    Parameters
    ----------
    grey : (H, W) uint8
        Grey levels.
    dictionary : str
        One of `DICTIONARIES`.

    Returns
    -------
    dict of int to (4, 2)
        By number the corners [px], to sub-pixels: top left, top right, bottom right, bottom left as
        the marker is printed. A number that is seen twice is left out: one of them is none.

    Raises
    ------
    CalibrationError
        If OpenCV was built without markers, or does not know the dictionary.
    """
    known = _dictionary(dictionary)
    grey = np.ascontiguousarray(grey)
    old: Any = cv2.aruco
    is_new = hasattr(cv2.aruco, "ArucoDetector")
    settings = cv2.aruco.DetectorParameters() if is_new else old.DetectorParameters_create()
    for name, value in SETTINGS.items():
        setattr(settings, name, value)
    if is_new:
        corners, numbers, _ = cv2.aruco.ArucoDetector(known, settings).detectMarkers(grey)
    else:
        corners, numbers, _ = old.detectMarkers(grey, known, parameters=settings)
    if numbers is None:
        return {}
    flat = np.ravel(numbers).astype(int).tolist()
    exact = square_corners(grey, np.reshape(corners, (-1, 4, 2)))
    return {
        number: corner
        for number, corner in zip(flat, exact, strict=True)
        if flat.count(number) == 1 and np.all(np.isfinite(corner))
    }


def draw_marker(dictionary: str, number: int, side_px: int) -> np.ndarray:
    """Return the picture (side_px, side_px) uint8 of a marker, its black border included.

    Raises
    ------
    CalibrationError
        As `find_markers`, or if the dictionary has no such number.
    """
    known = _dictionary(dictionary)
    count = len(known.bytesList)
    if not 0 <= number < count:
        raise CalibrationError(f"marker {number} of {dictionary}, allowed: 0 to {count - 1}")
    if hasattr(cv2.aruco, "generateImageMarker"):
        return np.asarray(cv2.aruco.generateImageMarker(known, number, side_px))
    old: Any = cv2.aruco
    return np.asarray(old.drawMarker(known, number, side_px))


def _dictionary(name: str) -> Any:
    if not hasattr(cv2, "aruco"):
        raise CalibrationError(
            f"OpenCV {cv2.__version__} was built without markers, allowed: 4.7 or newer, or "
            "opencv-contrib"
        )
    if name not in DICTIONARIES:
        raise CalibrationError(f"dictionary is {name!r}, allowed: {', '.join(DICTIONARIES)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
