"""Mapping between image points [px] and points of the plate [m, plate_home], with lens distortion.

`calibrate` fits a homography to four pairs of points. `Calibration` applies the homography and the
lens (`plate_core.rig.Lens`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import PlateError, Rig, RigError
from plate_core.rig import Lens as Formula
from plate_core.rig import camera_position, fit_homography, home_pose, lens_of_matrix, project

from ..errors import CalibrationError

MAX_CONDITION = 1e10
"""Maximum condition number of a homography. Above this condition number, points cannot be mapped
back. The homographies of real cameras have condition numbers of 1e3 to 1e7, depending on the
units."""

MIN_AREA_PX2 = 100.0
"""Minimum area of the plate in an image [px2]. If the area of the plate is below this minimum, the
parts are too small to be detected."""

SLENDER = 1e-4
"""Minimum area of the quadrilateral of four plate points, relative to the square of the
quadrilateral's size [-]. Below this relative area, the quadrilateral is almost a line."""

SLOPE_STEP = 1e-4
"""Step of the finite differences for the image scale [m]. The differences are used if the
calibration has a lens."""


@dataclass(frozen=True, eq=False)
class Lens:
    """A distorting lens: K, D and distortion_model of sensor_msgs/CameraInfo.

    The formulas are those of `plate_core.rig.Lens`.

    Attributes
    ----------
    matrix : (3, 3)
        Focal lengths and image centre [px].
    distortion : (n,)
        OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, tau_x, tau_y]]]]. An
        equidistant lens has k1, k2, k3, k4.
    model : str, optional
        A key of `plate_core.rig.LENS_MODELS`. None: plumb_bob if there are up to five values,
        otherwise rational_polynomial.
    source : str
        Origin of the lens, such as the name of a file. Messages about the lens begin with this
        text. The text may be empty.

    Raises
    ------
    CalibrationError
        If K, D or the model is not supported.
    """

    matrix: np.ndarray
    distortion: np.ndarray
    model: str | None = None
    source: str = ""
    _formula: Formula = field(init=False, repr=False)

    def __post_init__(self) -> None:
        count = np.size(self.distortion)
        model = self.model
        if model is None:
            model = "plumb_bob" if count <= 5 else "rational_polynomial"
        try:
            lens = lens_of_matrix(self.matrix, np.ravel(self.distortion).tolist(), model)
        except RigError as error:
            raise CalibrationError(f"{self._message_prefix}{error}") from None
        object.__setattr__(self, "matrix", lens.matrix)
        object.__setattr__(self, "distortion", np.array(lens.distortion))
        object.__setattr__(self, "model", lens.model)
        object.__setattr__(self, "_formula", lens)

    @property
    def bends(self) -> bool:
        """Whether the lens has distortion."""
        return self._formula.bends

    def straighten(self, point_px: np.ndarray) -> np.ndarray:
        """Remove the distortion from points (M, 2) [px]. The result (M, 2) [px] is NaN outside of
        the lens's field of view."""
        point_px = _to_points(point_px)
        return self._formula.straighten(point_px) if len(point_px) and self.bends else point_px

    def bend(self, point_px: np.ndarray) -> np.ndarray:
        """Apply the distortion to points (M, 2) [px] of the undistorted image."""
        return self._formula.bend(_to_points(point_px))

    def check_folding(self, corners_px: np.ndarray, straight: bool = False) -> None:
        """Refuse a lens that folds the image of a plate.

        Parameters
        ----------
        corners_px : (4, 2)
            Corners of the plate in the image [px].
        straight : bool
            Whether `corners_px` are positions in the undistorted image.

        Raises
        ------
        CalibrationError
            If the lens folds the image, so that parts would appear at wrong places.
        """
        if folded := self._formula.folds(corners_px, straight):
            raise CalibrationError(f"{self._message_prefix}{folded}")

    @property
    def _message_prefix(self) -> str:
        return f"{self.source}: " if self.source else ""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Mapping between the image and the plane of the parts.

    Attributes
    ----------
    image_from_home : (3, 3)
        Homography from plate_home [m] to the image [px].
    home_from_image : (3, 3)
        Inverse of `image_from_home`.
    lens : Lens, optional
        A distorting lens. With a lens, the homographies refer to the undistorted image.
    camera_position : (3,), optional
        Centre of projection of the camera [m, plate_home]. None if unknown.
    """

    image_from_home: np.ndarray
    home_from_image: np.ndarray
    lens: Lens | None = None
    camera_position: np.ndarray | None = None

    def to_home(self, point_px: np.ndarray) -> np.ndarray:
        """Map image points (M, 2) [px] to plate_home (M, 2) [m]."""
        if self.lens is not None:
            point_px = self.lens.straighten(point_px)
        return project(self.home_from_image, point_px)

    def to_image(self, point: np.ndarray) -> np.ndarray:
        """Map points of plate_home (M, 2) [m] to the image (M, 2) [px]."""
        straight = project(self.image_from_home, point)
        return straight if self.lens is None else self.lens.bend(straight)

    def slopes(self, point_px: np.ndarray) -> np.ndarray:
        """Derivative (M, 2, 2) [m/px] of `to_home` at image points (M, 2) [px]. Without a lens, the
        derivative is computed analytically. With a lens, the derivative is computed by central
        differences."""
        point_px = _to_points(point_px)
        if self.lens is None:
            rows = point_px @ self.home_from_image[:, :2].T + self.home_from_image[:, 2]
            point, third = rows[:, :2] / rows[:, 2:], rows[:, 2, None, None]
            first, last = self.home_from_image[:2, :2], self.home_from_image[2, :2]
            return np.asarray((first - point[:, :, None] * last) / third)
        steps = 0.5 * np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
        seen = self.to_home((steps[:, None] + point_px).reshape(-1, 2)).reshape(4, -1, 2)
        return np.stack([seen[0] - seen[1], seen[2] - seen[3]], axis=2)

    def disc_centres(self, ring_px: np.ndarray) -> np.ndarray:
        """Return the centres (M, 2) [m, plate_home] of discs. The images of the discs are ellipses,
        given by points (M, k, 2) [px] at equal angles.

        The centre of a disc's image is not the image of its centre, because perspective and a
        strong lens shift it by some hundredths of a pixel. Therefore the points are mapped to the
        plate, and the centroid of their polygon is returned.
        """
        count, corners = ring_px.shape[:2]
        outline = self.to_home(ring_px.reshape(-1, 2)).reshape(count, corners, 2)
        middle = outline.mean(axis=1)
        a = outline - middle[:, None]
        b = np.roll(a, -1, axis=1)
        area = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        shift = np.sum((a + b) * area[..., None], axis=1) / (3 * area.sum(axis=1)[:, None])
        return np.asarray(middle + shift)

    def scale(self, point: np.ndarray) -> np.ndarray:
        """Pixels per metre (M,) at points of plate_home (M, 2) [m]. The scale is the square root of
        the ratio of a small area in the image to the same area on the plate.

        A homography H scales a small area by det(H) / w^3, where w is the third homogeneous
        coordinate of the image point. With a lens, the ratio is computed from central differences.
        """
        point = _to_points(point)
        if self.lens is not None:
            steps = SLOPE_STEP * np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
            seen = self.to_image((steps[:, None] + point).reshape(-1, 2)).reshape(4, -1, 2)
            (ax, ay), (bx, by) = (seen[0] - seen[1]).T, (seen[2] - seen[3]).T
            return np.asarray(np.sqrt(np.abs(ax * by - ay * bx)) / (2 * SLOPE_STEP))
        third = point @ self.image_from_home[2, :2] + self.image_from_home[2, 2]
        return np.sqrt(np.abs(np.linalg.det(self.image_from_home) / third**3))


def calibrate(
    corners_px: np.ndarray,
    corners: np.ndarray,
    lens: Lens | None = None,
    camera_position: np.ndarray | None = None,
) -> Calibration:
    """Calibrate a camera by the homography from four pairs of points.

    Parameters
    ----------
    corners_px : (4, 2)
        Image points [px], with distortion.
    corners : (4, 2)
        The same points in plate_home [m].
    lens : Lens, optional
        Lens of the camera. None: no distortion.
    camera_position : (3,), optional
        The camera's centre of projection [m, plate_home]. This argument is only used if `lens` is
        None.

    Raises
    ------
    CalibrationError
        If `corners_px` or `corners` are not the corners of a convex quadrilateral, or if the lens
        folds the image of the plate.
    """
    corners_px = check_quadrilateral(corners_px, "corners_px", CalibrationError)
    corners = np.asarray(corners, dtype=float)
    min_area = SLENDER * float(np.max(np.ptp(corners, axis=0), initial=0)) ** 2
    corners = check_quadrilateral(corners, "corners", CalibrationError, "m", min_area)
    if lens is not None:
        lens.check_folding(corners_px)
        straight, name = lens.straighten(corners_px), "corners_px without the lens's distortion"
        corners_px = check_quadrilateral(straight, name, CalibrationError)
    return calibrate_by_matrix(fit_homography(corners, corners_px), lens, camera_position)


def check_quadrilateral(
    polygon: np.ndarray,
    name: str,
    error: type[PlateError],
    unit: str = "px",
    min_area: float = MIN_AREA_PX2,
) -> np.ndarray:
    """Return a polygon (4, 2) if it is convex and has at least the area `min_area` [unit2].

    Raises
    ------
    error
        If the polygon has another form. The message states the defect.
    """
    polygon = np.asarray(polygon, dtype=float)
    if polygon.shape != (4, 2) or not np.all(np.isfinite(polygon)):
        raise error(f"{name}: got {polygon.tolist()}, allowed: four finite pairs (x, y) in {unit}")
    sides = np.roll(polygon, -1, axis=0) - polygon
    crosses = cross_products(sides, np.roll(sides, -1, axis=0))
    if not (np.all(crosses > 0) or np.all(crosses < 0)):
        raise error(
            f"{name}: got {polygon.tolist()} {unit}, allowed: four corners in order around a "
            "convex quadrilateral, no three of them on one line"
        )
    area = 0.5 * abs(float(np.sum(cross_products(polygon, np.roll(polygon, -1, axis=0)))))
    if area < min_area:
        raise error(f"{name}: area is {area:.3g} {unit}2, allowed: at least {min_area:.3g} {unit}2")
    return polygon


def cross_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the z components (n,) of the cross products of planar vectors (n, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def calibrate_by_matrix(
    image_from_home: np.ndarray, lens: Lens | None = None, camera_position: np.ndarray | None = None
) -> Calibration:
    """Return the calibration for a known homography (3, 3) from plate_home [m] to the image [px].
    If there is a lens, the homography maps to the undistorted image.

    `camera_position` (3,) is the camera's centre of projection [m, plate_home]. This argument is
    only used if `lens` is None. With a lens, the centre of projection is computed from the
    homography and the lens.

    Raises
    ------
    CalibrationError
        If the homography is not (3, 3), not finite, or has no inverse.
    """
    matrix = _check_finite(image_from_home, (3, 3), "homography")
    condition = float(np.linalg.cond(matrix)) if np.any(matrix) else np.inf
    if not condition < MAX_CONDITION:
        raise CalibrationError(
            f"homography: condition number is {condition:.3g}, allowed: below {MAX_CONDITION:g} "
            "(points could not be mapped back)"
        )
    if lens is not None:
        rotation, translation = home_pose(matrix, lens.matrix)
        camera_position = -rotation.T @ translation
    bends = lens is not None and lens.bends
    return Calibration(matrix, np.linalg.inv(matrix), lens if bends else None, camera_position)


def calibrate_by_rig(rig: Rig, lens: Lens | None = None) -> Calibration:
    """Calibrate by the image points of the plate's corners in the rig file. If no lens is given,
    the lens of the rig file is used."""
    lens = lens or rig_lens(rig)
    # With a lens, `calibrate` computes the position of the camera from the corners.
    position = camera_position(rig) if lens is None else None
    return calibrate(np.array(rig.camera.corners_px), rig.plate.corners, lens, position)


def lens_keys(lens: Lens) -> dict[str, str]:
    """Return the lens as keys and values of the section `camera` of a rig file."""
    matrix = lens.matrix
    return {
        "focal_px": f"[{matrix[0, 0]:.3f}, {matrix[1, 1]:.3f}]",
        "centre_px": f"[{matrix[0, 2]:.3f}, {matrix[1, 2]:.3f}]",
        "distortion": f"[{', '.join(f'{value:.6g}' for value in lens.distortion + 0.0)}]",
        "distortion_model": str(lens.model),
    }


def rig_lens(rig: Rig) -> Lens | None:
    """Return the lens of the rig file. The result is None if the file has no lens."""
    lens = rig.camera.lens
    return None if lens is None else Lens(lens.matrix, np.array(lens.distortion), lens.model)


def _to_points(point: np.ndarray) -> np.ndarray:
    return np.asarray(point, dtype=float).reshape(-1, 2)


def _check_finite(array: np.ndarray, shape: tuple[int, ...], name: str) -> np.ndarray:
    array = np.array(array, dtype=float)
    if array.shape != shape or not np.all(np.isfinite(array)):
        size = " x ".join(map(str, shape))
        raise CalibrationError(f"{name}: got {array.tolist()}, allowed: {size} finite numbers")
    return array
