"""A camera's lens: the K and D (`plumb_bob`) of sensor_msgs/CameraInfo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SETTLED = 1e-13
"""Change of a ray [focal lengths] after which straightening has converged: 1e-10 px."""

MAX_STEPS = 30
"""Newton steps of straightening; 4 to 6 are enough wherever a lens does not fold the image."""


@dataclass(frozen=True)
class Lens:
    """Where a ray of light falls on the image: Brown and Conrady's model.

    The ray (x, y, 1) in the camera's frame (x to the right, y down, z ahead) is seen at

        u = fx x' + cx,    x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2)
        v = fy y' + cy,    y' = y (1 + k1 r2 + k2 r2^2 + k3 r2^3) + p1 (r2 + 2 y^2) + 2 p2 x y

    with r2 = x^2 + y^2. Without distortion x' = x and y' = y: the straight image.

    Attributes
    ----------
    focal_px : (float, float)
        fx, fy [px].
    centre_px : (float, float)
        cx, cy [px]; the centre of the first pixel is (0, 0).
    distortion : five floats
        k1, k2, p1, p2, k3 [-].
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def matrix(self) -> np.ndarray:
        """The camera matrix K (3, 3) [px]."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    @property
    def bends(self) -> bool:
        """Whether there is any distortion."""
        return any(self.distortion)

    def bend(self, point_px: np.ndarray) -> np.ndarray:
        """Return where points (..., 2) [px] of the straight image are seen (..., 2) [px]."""
        seen, _ = _distort(self._rays(point_px), self.distortion)
        return seen * self.focal_px + self.centre_px

    def slopes(self, point_px: np.ndarray) -> np.ndarray:
        """Derivative (..., 2, 2) of `bend` at points (..., 2) [px] of the straight image."""
        _, slopes = _distort(self._rays(point_px), self.distortion)
        focal = np.array(self.focal_px)
        return slopes * focal[:, None] / focal

    def straighten(self, point_px: np.ndarray) -> np.ndarray:
        """Return where seen points (..., 2) [px] are in the straight image (..., 2) [px].

        The inverse of `bend`, by Newton's method; NaN where there is none, that is outside of what
        the lens shows.
        """
        seen = self._rays(point_px)
        ray = seen.copy()
        with np.errstate(all="ignore"):
            for _ in range(MAX_STEPS):
                bent, slopes = _distort(ray, self.distortion)
                error = seen - bent
                (a, b), (c, d) = np.moveaxis(slopes, (-2, -1), (0, 1))
                step = np.stack(
                    [d * error[..., 0] - b * error[..., 1], a * error[..., 1] - c * error[..., 0]],
                    axis=-1,
                ) / (a * d - b * c)[..., None]  # fmt: skip
                ray += step
                if not np.any(np.abs(step) > SETTLED):
                    break
            folded = ~((a * d - b * c > 0) & (a + d > 0) & (np.abs(step).max(axis=-1) < 1e-9))
        ray[folded] = np.nan
        return ray * self.focal_px + self.centre_px

    def _rays(self, point_px: np.ndarray) -> np.ndarray:
        return (np.asarray(point_px, dtype=float) - self.centre_px) / self.focal_px


def _distort(ray: np.ndarray, distortion: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return distorted rays (..., 2) and their derivative (..., 2, 2) in the rays (..., 2)."""
    k1, k2, p1, p2, k3 = distortion
    x, y = ray[..., 0], ray[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    growth = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    bent = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )
    across = x * y * growth + 2 * p1 * x + 2 * p2 * y
    slopes = np.stack(
        [
            np.stack([radial + x * x * growth + 2 * p1 * y + 6 * p2 * x, across], axis=-1),
            np.stack([across, radial + y * y * growth + 6 * p1 * y + 2 * p2 * x], axis=-1),
        ],
        axis=-2,
    )
    return bent, slopes
