"""ArUco markers in an image, and the corners of dark squares to hundredths of a pixel.

Each corner is the intersection of two lines fitted to the square's edges, because blur does not
displace the edges. The corner itself is rounded by blur. With a blur of 1 px, OpenCV's corner
refinement finds the corner a quarter of a pixel too far inside. OpenCV 4.7 replaced the functions
for markers by classes. This file supports both."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from ..errors import CalibrationError

DICTIONARIES = tuple(
    name.removeprefix("DICT_")
    for name in sorted(dir(getattr(cv2, "aruco", None)))
    if name.startswith("DICT_") and name == name.upper()
)
"""Dictionaries of markers in the installed OpenCV, such as 4X4_50. Empty if OpenCV was built
without markers."""

SETTINGS = {
    "perspectiveRemovePixelPerCell": 8,
    "perspectiveRemoveIgnoredMarginPerCell": 0.3,
    "maxErroneousBitsInBorderRate": 0.5,
}
"""Parameters of OpenCV's marker detector that differ from its defaults. Only the centre of each
module (small square of a marker) is evaluated, so that markers of 30 px are read at a blur of 1.5
px."""


SAMPLES = 24
"""Number of grey-level profiles across each edge of a marker."""

SPAN = (0.15, 0.85)
"""Range of an edge that is sampled, relative to its length [-]. The ends of an edge are not
sampled, because blur rounds them."""

REACH_PX = 4.0
"""Maximum distance of a marker's edge from its expected place, on either side [px]."""

STEP_PX = 0.5
"""Distance between two samples across an edge [px]."""

MIN_CONTRAST = 25.0
"""Minimum difference between the grey levels on both sides of a marker's edge."""

OUTLIER_PX = 0.5
"""Maximum distance of a crossing from the fitted line [px]. A crossing is the point where a
grey-level profile crosses an edge. Crossings that are farther away are excluded, because dirt or a
part may have caused them."""

MIN_CROSSINGS = 6
"""Minimum number of profiles in which a marker's edge is found."""

ROUNDS = 2
"""Number of refinements. Each refinement searches around the edges that the previous one found."""


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
        Corners [px] of each marker by its number, with sub-pixel accuracy. The order of the corners
        is top left, top right, bottom right, bottom left of the printed marker. A number that is
        found twice is omitted, because one of the two markers is misread.

    Raises
    ------
    CalibrationError
        If OpenCV was built without markers, or the dictionary is unknown.
    """
    known = _load_dictionary(dictionary)
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
    """Return the picture (side_px, side_px) uint8 of a marker, including its black border.

    Raises
    ------
    CalibrationError
        If the dictionary is unknown or has no such number, if OpenCV was built without markers, or
        if a module would be smaller than a pixel.
    """
    known = _load_dictionary(dictionary)
    count = len(known.bytesList)
    if not 0 <= number < count:
        raise CalibrationError(
            f"number of a marker is {number}, allowed in {dictionary}: 0 to {count - 1}"
        )
    if side_px < known.markerSize + 2:
        raise CalibrationError(
            f"side of a marker is {side_px} px, allowed in {dictionary}: at least "
            f"{known.markerSize + 2} px"
        )
    if hasattr(cv2.aruco, "generateImageMarker"):
        return np.asarray(cv2.aruco.generateImageMarker(known, number, side_px))
    old: Any = cv2.aruco
    return np.asarray(old.drawMarker(known, number, side_px))


def _load_dictionary(name: str) -> Any:
    if not hasattr(cv2, "aruco"):
        raise CalibrationError(
            f"OpenCV {cv2.__version__} was built without markers, allowed: OpenCV 4.7 or "
            "newer, or opencv-contrib"
        )
    if name not in DICTIONARIES:
        raise CalibrationError(f"dictionary is {name!r}, allowed: {', '.join(DICTIONARIES)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def square_corners(grey: np.ndarray, corners_px: np.ndarray) -> np.ndarray:
    """Find dark squares on bright ground near their expected places.

    Input: corners (n, 4, 2) [px] in order around each square, with errors of up to `REACH_PX`.
    Output: refined corners. All corners of a square are NaN if one of its edges is not visible.
    """
    corners = np.array(corners_px, dtype=float).reshape(-1, 4, 2)
    for _ in range(ROUNDS):
        corners = _refine_corners(grey, corners)
    return corners


def _refine_corners(grey: np.ndarray, corners: np.ndarray) -> np.ndarray:
    along = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    x, y = np.moveaxis(along / np.maximum(length, 1e-9), 2, 0)
    outward = np.stack([y, -x], axis=2)
    middle = corners.mean(axis=1, keepdims=True)
    outward *= np.sign(np.sum(outward * (corners - middle), axis=2))[..., None]
    distance = np.linspace(*SPAN, SAMPLES)
    across = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    foot = corners[:, :, None] + distance[:, None] * along[:, :, None]
    place = foot[..., None, :] + across[:, None] * outward[:, :, None, None]
    crossing = _find_crossings(_sample_grey_levels(grey, place), across)
    # `line` contains two values for each edge: its offset at the first corner, and the change of
    # this offset up to the last corner.
    line = _fit_edge_lines(distance, crossing)
    first = corners + line[..., :1] * outward
    last = corners + along + line.sum(axis=2, keepdims=True) * outward
    return _intersect_lines(np.roll(first, 1, axis=1), np.roll(last, 1, axis=1), first, last)


def _sample_grey_levels(grey: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the grey levels (n, 4, s, k) at places (n, 4, s, k, 2) [px]; NaN outside the image."""
    rows = (place.shape[0] * place.shape[1], place.shape[2] * place.shape[3])
    x, y = np.moveaxis(np.nan_to_num(place, nan=-9.0).astype(np.float32), -1, 0)
    value = np.asarray(
        cv2.remap(
            grey,
            x.reshape(rows),
            y.reshape(rows),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )
    size = np.array(grey.shape[::-1]) - 1
    inside = np.all((place >= 0) & (place <= size), axis=-1)
    return np.where(inside, value.reshape(place.shape[:-1]).astype(float), np.nan)


def _find_crossings(value: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return the crossings (n, 4, s) [px] of profiles (n, 4, s, k). A crossing is the place where a
    profile rises through the mean of the edge's dark and bright level. If a profile does not rise
    through this level, its crossing is NaN."""
    with np.errstate(all="ignore"):
        dark = np.median(value.min(axis=3), axis=2, keepdims=True)[..., None]
        bright = np.median(value.max(axis=3), axis=2, keepdims=True)[..., None]
        level = 0.5 * (dark + bright)
        rises = (value[..., :-1] < level) & (value[..., 1:] >= level)
        rises &= bright - dark >= MIN_CONTRAST
        fraction = (level - value[..., :-1]) / (value[..., 1:] - value[..., :-1])
    place = np.where(rises, across[:-1] + STEP_PX * np.nan_to_num(fraction), np.inf)
    nearest = np.argmin(np.abs(place), axis=3)[..., None]
    found = np.take_along_axis(place, nearest, axis=3)[..., 0]
    return np.where(np.isfinite(found), found, np.nan)


def _fit_edge_lines(distance: np.ndarray, crossing: np.ndarray) -> np.ndarray:
    """Fit a line a + b t to the crossings (n, 4, s) of each edge at t = `distance`, without
    outliers. Return the coefficients a, b (n, 4, 2). The coefficients are NaN if there are too few
    crossings."""
    middle = np.nanmedian(np.where(np.isnan(crossing).all(axis=2, keepdims=True), 0, crossing), 2)
    weight = np.isfinite(crossing) & (np.abs(crossing - middle[..., None]) < 4 * OUTLIER_PX)
    line = _fit_weighted_lines(distance, crossing, weight)
    weight &= np.abs(crossing - line[..., :1] - line[..., 1:] * distance) < OUTLIER_PX
    line = _fit_weighted_lines(distance, crossing, weight)
    return np.where(weight.sum(axis=2, keepdims=True) >= MIN_CROSSINGS, line, np.nan)


def _fit_weighted_lines(
    distance: np.ndarray, crossing: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    count = np.maximum(weight.sum(axis=2), 1)
    value = np.where(weight, crossing, 0)
    x = np.where(weight, distance, 0)
    mean_x, mean = x.sum(axis=2) / count, value.sum(axis=2) / count
    variance = np.maximum((x * x).sum(axis=2) - count * mean_x**2, 1e-9)
    growth = ((x * value).sum(axis=2) - count * mean_x * mean) / variance
    return np.stack([mean - growth * mean_x, growth], axis=2)


def _intersect_lines(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Intersect lines through a, b with lines through c, d (n, 4, 2). All points of a square are
    NaN if one line is missing."""
    u, v, w = b - a, d - c, c - a
    cross = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    with np.errstate(all="ignore"):
        t = (w[..., 0] * v[..., 1] - w[..., 1] * v[..., 0]) / cross
        point = a + t[..., None] * u
    is_finite = np.all(np.isfinite(point), axis=(1, 2), keepdims=True)
    return np.where(is_finite, point, np.nan)
