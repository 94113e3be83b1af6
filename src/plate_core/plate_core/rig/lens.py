"""Lens model of a camera. The parameters are K, D and distortion_model of sensor_msgs/CameraInfo.

`Lens.bend` maps points of the undistorted image to the distorted image by OpenCV's formulas, and
`Lens.straighten` inverts this by Newton's method. The data of a lens can be from a rig file, a
camera file or camera_info. The error for invalid data is the same in all cases. Callers put the
source of the data before the message.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import RigError

MODELS = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (5, 8, 12, 14),
    "equidistant": (4,),
}
"""Names of the distortion models, and the allowed numbers of distortion values of each model."""

BIGGEST = 1e6
"""Maximum absolute value in K [px] or D [-]."""

MIN_FOCAL_PX = 10.0
"""Minimum focal length [px]. A smaller value is not in pixels, or a driver's placeholder."""

STEEPEST_RAD = np.deg2rad(89.0)
"""Maximum angle between a ray and the optical axis [rad]. At 90 degrees, the image point in the
undistorted image would be at infinity."""

SETTLED = 1e-8
"""If a Newton step is shorter than this value [focal lengths], the iteration ends. The remaining
error is about the square of this value: 1e-16 focal lengths, or 1e-13 px if the focal length is
1000 px."""

CONVERGED = 1e-7
"""Maximum length of the last Newton step of a valid result, as a fraction of the length of the ray
(x, y, 1)."""

MAX_STEPS = 30
"""Maximum number of Newton steps. If the lens does not fold the image, 2 or 3 steps are
sufficient."""

TABLE = 1025
"""Number of radii in the table of start values for Newton's method."""

SHORT_OF = 1e-6
"""Relative distance between the end of the table and the radius at which the image folds. The table
ends before this radius, because a rational polynomial can have a pole there."""

ROUNDED = 1.01
"""Maximum radius of a ray that Newton's method may return, divided by the radius at which the
radial distortion folds the image. The value exceeds 1, because tangential terms of the distortion
move the fold."""

MARGIN = 0.05
"""Width of the border around the plate in which a lens must not fold the image, as a fraction of
the plate's length and width. The border is needed because the moving plate carries parts beyond
the area that the plate covers at rest."""

GRID = 33
"""Number of points along each side of a grid over the plate. At these points, the lens is checked
for folding of the image."""

VALUES = 14
"""Number of distortion values: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y."""


@dataclass(frozen=True)
class Lens:
    """Lens model: image point of a light ray.

    The image point of the ray (x, y, 1) in the camera frame (x right, y down, z forward) is

        u = fx x' + cx,    v = fy y' + cy

    `plumb_bob` and `rational_polynomial`, with r2 = x^2 + y^2 and
    c = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3):

        x' = x c + 2 p1 x y + p2 (r2 + 2 x^2) + s1 r2 + s2 r2^2
        y' = y c + p1 (r2 + 2 y^2) + 2 p2 x y + s3 r2 + s4 r2^2

    tau_x and tau_y describe a tilted image plane. `equidistant`, with r = sqrt(r2) and
    t = atan(r):

        (x', y') = (x, y) / r (t + k1 t^3 + k2 t^5 + k3 t^7 + k4 t^9)

    These are the formulas of OpenCV's `projectPoints` and `fisheye.projectPoints`. The undistorted
    image has x' = x and y' = y.

    Attributes
    ----------
    focal_px : (float, float)
        fx, fy [px].
    centre_px : (float, float)
        cx, cy [px]; the centre of the first pixel is (0, 0).
    distortion : floats
        k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, tau_x, tau_y]]]] [-, tau in rad];
        equidistant: k1, k2, k3, k4.
    model : str
        A key of `MODELS`.

    Raises
    ------
    RigError
        If the model is unknown, `MODELS` does not allow this number of values, or a value is out of
        range. If all distortion values are zero, any number of values is allowed, including none.
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    model: str = "plumb_bob"

    def __post_init__(self) -> None:
        values = tuple(float(value) for value in self.distortion)
        if not self.model and not any(values):
            # drivers of cameras without distortion publish an empty model
            object.__setattr__(self, "model", "plumb_bob")
        if self.model not in MODELS:
            raise RigError(
                f"lens: distortion_model is {self.model!r}, allowed: {', '.join(MODELS)}"
            )
        counts = MODELS[self.model]
        if len(values) not in counts:
            if any(values):
                allowed = " or ".join(map(str, counts))
                raise RigError(
                    f"lens: distortion has {len(values)} values, allowed: {allowed} for "
                    f"{self.model}"
                )
            values = (0.0,) * (5 if 5 in counts else counts[0])
        # This condition also refuses NaN.
        if not np.all(np.abs([*values, *self.focal_px, *self.centre_px]) <= BIGGEST):
            raise RigError(
                f"lens: fx, fy, cx and cy of K are {self.focal_px + self.centre_px}, and "
                f"distortion is {values}, allowed: numbers from {-BIGGEST:g} to {BIGGEST:g}"
            )
        if min(self.focal_px) < MIN_FOCAL_PX:
            fx, fy = self.focal_px
            raise RigError(
                f"lens: focal lengths are {fx:g} and {fy:g} px, allowed: {MIN_FOCAL_PX:g} px or "
                "more; check that the camera is calibrated"
            )
        object.__setattr__(self, "distortion", values)

    @property
    def matrix(self) -> np.ndarray:
        """The camera matrix K (3, 3) [px]."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    @property
    def bends(self) -> bool:
        """Whether the lens has distortion. An equidistant lens has distortion even if all values
        are zero."""
        return self.model == "equidistant" or any(self.distortion)

    def bend(self, point_px: np.ndarray) -> np.ndarray:
        """Map points (..., 2) [px] of the undistorted image to the distorted image (..., 2)
        [px]."""
        seen, _ = self._distort(self._points_to_rays(point_px))
        return (
            _project_to_tilted_plane(seen, self._tilt_projection)[0] * self.focal_px
            + self.centre_px
        )

    def slopes(self, point_px: np.ndarray) -> np.ndarray:
        """Return the derivative (..., 2, 2) of `bend` at points (..., 2) [px] of the undistorted
        image."""
        seen, slopes = self._distort(self._points_to_rays(point_px))
        _, tilts = _project_to_tilted_plane(seen, self._tilt_projection)
        focal = np.array(self.focal_px)
        return (slopes if tilts is None else tilts @ slopes) * focal[:, None] / focal

    def straighten(self, point_px: np.ndarray) -> np.ndarray:
        """Map points (..., 2) [px] of the distorted image to the undistorted image (..., 2) [px].

        This is the inverse of `bend`, computed by Newton's method. The result is NaN for points
        outside the lens's field of view, because no ray has such an image point. If several rays
        have the same image point, the result is the ray between the optical axis and the fold.
        """
        tilt = self._tilt_projection
        seen = _project_to_tilted_plane(
            self._points_to_rays(point_px), None if tilt is None else np.linalg.inv(tilt)
        )[0]
        u, v = seen[..., 0], seen[..., 1]
        with np.errstate(all="ignore"):
            radius = np.hypot(u, v)
            growth = np.interp(radius, self._radius_table[1], self._radius_table[0]) / radius
            growth = np.where(radius > 0, growth, 1.0)
            x, y = u * growth, v * growth
            for _ in range(MAX_STEPS):
                r2 = x * x + y * y
                bent_u, bent_v, a, b, c, d = self._distort_with_derivatives(x, y, r2)
                off_u, off_v = u - bent_u, v - bent_v
                volume = a * d - b * c
                step_x, step_y = (d * off_u - b * off_v) / volume, (a * off_v - c * off_u) / volume
                x, y = x + step_x, y + step_y
                step = np.maximum(np.abs(step_x), np.abs(step_y))
                if not np.any(step > SETTLED):
                    break
            shown = (step * step <= CONVERGED**2 * (1 + r2)) & self._is_upright(volume, a + d, r2)
        straight = np.stack([x, y], axis=-1) * self.focal_px + self.centre_px
        return np.where(shown[..., None], straight, np.nan)

    def folds(self, corners_px: np.ndarray, straight: bool = False) -> str:
        """Return a message if the lens folds the image of a plate. The message is empty if each
        image point shows only one point of the plate.

        Parameters
        ----------
        corners_px : (4, 2)
            Image points of the plate's corners [px].
        straight : bool
            Whether `corners_px` are points of the undistorted image.
        """
        if not self.bends:
            return ""
        corner = np.asarray(corners_px, dtype=float).reshape(4, 2)
        if not straight:
            corner = self.straighten(corner)
        if np.all(np.isfinite(corner)):
            along = np.linspace(-MARGIN, 1 + MARGIN, GRID)
            u, v = (part[..., None] for part in np.meshgrid(along, along))
            near = corner[0] + u * (corner[1] - corner[0])
            far = corner[3] + u * (corner[2] - corner[3])
            x, y = np.moveaxis(self._points_to_rays(near + v * (far - near)), -1, 0)
            _, _, a, b, c, d = self._distort_with_derivatives(x, y, r2 := x * x + y * y)
            if np.all(self._is_upright(a * d - b * c, a + d, r2)):
                return ""
        edge = ""
        if np.isfinite(self._max_radius):
            pixels = self._radius_table[1][-1] * np.array(self.focal_px).min()
            edge = f", {pixels:.0f} px from the optical centre"
        return (
            f"lens: distortion is {[float(f'{value:.6g}') for value in self.distortion]} "
            f"({self.model}), which folds the image of the plate{edge}, allowed: a distortion "
            "without a fold on the plate; check that K and D are from this camera, at this image "
            "size"
        )

    def _points_to_rays(self, point_px: np.ndarray) -> np.ndarray:
        return (np.asarray(point_px, dtype=float) - self.centre_px) / self.focal_px

    def _is_upright(self, volume: np.ndarray, trace: np.ndarray, r2: np.ndarray) -> np.ndarray:
        """Whether the image is neither folded nor mirrored at rays (...). `volume` and `trace` are
        the determinant and the trace of the derivative at these rays, and `r2` their squared
        radii."""
        return (volume > 0) & (trace > 0) & (r2 <= (ROUNDED * self._max_radius) ** 2)

    @cached_property
    def _all_coefficients(self) -> tuple[float, ...]:
        return self.distortion + (0.0,) * (VALUES - len(self.distortion))

    @cached_property
    def _tilt_projection(self) -> np.ndarray | None:
        """The projection (3, 3) onto a tilted image plane. None if the plane is not tilted."""
        tau_x, tau_y = self._all_coefficients[12:]
        if self.model == "equidistant" or (tau_x == 0 and tau_y == 0):
            return None
        (cx, sx), (cy, sy) = ((np.cos(tau), np.sin(tau)) for tau in (tau_x, tau_y))
        rotation = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ np.array(
            [[1, 0, 0], [0, cx, sx], [0, -sx, cx]]
        )
        return (
            np.array(
                [
                    [rotation[2, 2], 0, -rotation[0, 2]],
                    [0, rotation[2, 2], -rotation[1, 2]],
                    [0, 0, 1],
                ]
            )
            @ rotation
        )

    @cached_property
    def _max_radius(self) -> float:
        """Radius [focal lengths] of the rays at which the radial distortion folds the image.
        Infinite if the distortion never folds the image. The field of view of an equidistant lens
        can exceed 90 degrees, but the undistorted image cannot. Therefore `STEEPEST_RAD` limits the
        radius."""
        if self.model == "equidistant":
            powers = (2 * np.arange(5) + 1) * np.array([1, *self._all_coefficients[:4]])
            return float(np.tan(min(np.sqrt(_smallest_positive_root(powers)), STEEPEST_RAD)))
        k1, k2, _, _, k3, k4, k5, k6 = self._all_coefficients[:8]
        up = np.polynomial.Polynomial([1, k1, k2, k3])
        down = np.polynomial.Polynomial([1, k4, k5, k6])
        twice = np.polynomial.Polynomial([0, 2])
        # derivative of r up / down with respect to r, times down^2
        growth = up * down + twice * (up.deriv() * down - up * down.deriv())
        return float(
            np.sqrt(min(_smallest_positive_root(growth.coef), _smallest_positive_root(down.coef)))
        )

    @cached_property
    def _radius_table(self) -> tuple[np.ndarray, np.ndarray]:
        """Table of increasing radii of rays, and of their radii after the radial distortion [focal
        lengths]."""
        steep = min(np.arctan(self._max_radius), STEEPEST_RAD)
        radius = np.tan(np.linspace(0, (1 - SHORT_OF) * steep, TABLE))
        return radius, radius * self._radial_factor(radius * radius)[0]

    def _radial_factor(self, r2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the radial factor c and its derivative by r2, for squared radii r2 of rays."""
        if self.model == "equidistant":
            k1, k2, k3, k4 = self.distortion
            far = r2 > 1e-8
            safe = np.where(far, r2, 1.0)
            r = np.sqrt(safe)
            t = np.arctan(r)
            t2 = t * t
            bent = t * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
            # derivative of bent / r with respect to r2
            steep = (slope / (1 + safe) - bent / r) / (2 * safe)
            first = k1 - 1 / 3  # Taylor series for points near the axis
            return np.where(far, bent / r, 1 + first * r2), np.where(far, steep, first)
        k1, k2, _, _, k3, k4, k5, k6 = self._all_coefficients[:8]
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        steep = k1 + r2 * (2 * k2 + r2 * 3 * k3)
        if k4 or k5 or k6:
            down = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
            radial = radial / down
            steep = (steep - radial * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / down
        return radial, steep

    def _distort_with_derivatives(
        self, x: np.ndarray, y: np.ndarray, r2: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Return distorted rays x', y' (...), before the tilt of the image plane, and their
        derivatives dx'/dx, dx'/dy, dy'/dx, dy'/dy at rays x, y with x^2 + y^2 = r2 (...)."""
        radial, steep = self._radial_factor(r2)
        growth = 2 * steep
        xy = x * y
        u, v = x * radial, y * radial
        a, d = radial + x * x * growth, radial + y * y * growth
        b = c = xy * growth
        if self.model == "equidistant":
            return u, v, a, b, c, d
        p1, p2 = self._all_coefficients[2:4]
        if p1 or p2:
            twice = 2 * xy
            u, v = u + p1 * twice + p2 * (r2 + 2 * x * x), v + p1 * (r2 + 2 * y * y) + p2 * twice
            b = c = b + 2 * p1 * x + 2 * p2 * y
            a, d = a + 2 * p1 * y + 6 * p2 * x, d + 6 * p1 * y + 2 * p2 * x
        s1, s2, s3, s4 = self._all_coefficients[8:12]
        if s1 or s2 or s3 or s4:
            u, v = u + r2 * (s1 + r2 * s2), v + r2 * (s3 + r2 * s4)
            across, down = 2 * s1 + 4 * s2 * r2, 2 * s3 + 4 * s4 * r2
            a = a + across * x
            b = b + across * y
            c = c + down * x
            d = d + down * y
        return u, v, a, b, c, d

    def _distort(self, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distorted rays (..., 2), before the tilt of the image plane, and their derivative
        (..., 2, 2) in the rays (..., 2)."""
        x, y = ray[..., 0], ray[..., 1]
        u, v, *slopes = self._distort_with_derivatives(x, y, x * x + y * y)
        return (
            np.stack([u, v], axis=-1),
            np.stack(slopes, axis=-1).reshape(*np.shape(u), 2, 2),
        )


def lens_of_matrix(matrix: np.ndarray, distortion: Sequence[float], model: str) -> Lens:
    """Return the lens with a camera matrix K (3, 3) [px], and D and distortion_model of
    sensor_msgs/CameraInfo.

    Raises
    ------
    RigError
        If K is not [fx, 0, cx], [0, fy, cy], [0, 0, 1], or if `Lens` raises an error.
    """
    matrix = np.array(matrix, dtype=float)
    shape = np.array([[1, 0, 1], [0, 1, 1], [0, 0, 0]])
    if matrix.shape != (3, 3) or not np.array_equal(matrix * shape + np.diag([0, 0, 1]), matrix):
        raise RigError(
            f"lens: K is {matrix.tolist()}, allowed: [fx, 0, cx], [0, fy, cy], [0, 0, 1]"
        )
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    return Lens((fx, fy), (cx, cy), tuple(np.ravel(distortion).tolist()), model)


def _smallest_positive_root(powers: np.ndarray) -> float:
    """Return the smallest positive root of a polynomial with these coefficients, lowest power
    first. The result is infinite if there is no such root."""
    roots = np.polynomial.Polynomial(powers).trim().roots()
    real = roots.real[np.abs(roots.imag) <= 1e-9 * np.abs(roots)]
    return float(np.min(real[real > 0], initial=np.inf))


def _project_to_tilted_plane(
    ray: np.ndarray, tilt: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Project rays (..., 2) onto a tilted plane with a matrix (3, 3). Return the points and their
    derivative (..., 2, 2). If the matrix is None, return the rays unchanged, and None as
    derivative."""
    if tilt is None:
        return ray, None
    third = ray @ tilt[2, :2] + tilt[2, 2]
    seen = (ray @ tilt[:2, :2].T + tilt[:2, 2]) / third[..., None]
    slopes = (tilt[:2, :2] - seen[..., :, None] * tilt[2, :2]) / third[..., None, None]
    return seen, slopes
