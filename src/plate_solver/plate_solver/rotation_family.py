"""Sequences of rotations as a family of motions: lengths and speeds are the parameters."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from .sequence import knot_poses, motion, motion_slopes, timeline
from .solution import Bounds

STEPS_PER_SECOND = 2000
"""Samples of a sequence while it is being corrected [1/s]."""

RAMP_SHARE = 0.95
"""Share of the acceleration limit that ramps take; the rest is for closing the motion."""

SHORTEST, FASTEST = 0.02, 2.5
"""Least length of a rotation and greatest speed, in units of their usual values."""

SLOPE_STEP = 1e-4
"""Step of the differences that give a sequence's derivatives, in units of the parameters."""


class RotationFamily:
    """Sequences of J rotations about given centres in a given order, as a family for `steer`.

    Parameters are the J + 1 lengths (the last is the rest at the end) and the J signed speeds, both
    in units of their usual values.
    """

    def __init__(
        self,
        twists: np.ndarray,
        bounds: Bounds,
        period: float,
        speed: float,
        steps: int = 0,
    ) -> None:
        self._twists = np.ascontiguousarray(twists)
        self._bounds = bounds
        self._period = period
        self._speed = speed
        self._steps = steps or max(60, round(STEPS_PER_SECOND * period))
        self._accel = RAMP_SHARE * bounds.accel
        self._lengths = np.array([1.0, 1.0, bounds.arm_m])  # turns the gap into metres
        self._hold_scale = 1 / len(twists)
        self._known: tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None

    @property
    def count(self) -> int:
        """Number of rotations J."""
        return len(self._twists)

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self._period / self._steps

    def finer(self, steps: int) -> RotationFamily:
        """Return the same family with another number of samples."""
        return RotationFamily(self._twists, self._bounds, self._period, self._speed, steps)

    def parameters(self, share: np.ndarray) -> np.ndarray:
        """Return parameters of signed shares (J,) of the cycle; what is left over is rest."""
        used = max(1.0, float(np.sum(np.abs(share))))
        rest = max(0.0, 1.0 - float(np.sum(np.abs(share))))
        holds = np.append(np.abs(share) / used, rest) / self._hold_scale
        return self.admissible(np.concatenate([holds, np.where(share < 0, -1.0, 1.0)]))

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3)."""
        pose, twist, _, _ = self._motion(parameters)
        return pose, twist

    def pull_back(
        self, parameters: np.ndarray, by_twist: np.ndarray, by_pose: np.ndarray | None
    ) -> np.ndarray:
        """Return derivatives (R, P) by the parameters."""
        twist_slopes, pose_slopes, _ = self._slopes(parameters)
        rows, size = len(by_twist), len(parameters)
        jacobian = by_twist.reshape(rows, -1) @ twist_slopes.reshape(size, -1).T
        if by_pose is not None:
            jacobian += by_pose.reshape(rows, -1) @ pose_slopes.reshape(size, -1).T
        return jacobian

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Keep lengths positive and speeds within the limits."""
        parameters = parameters.copy()
        holds, speed = parameters[: self.count + 1], parameters[self.count + 1 :]
        np.maximum(holds, SHORTEST, out=holds)
        np.clip(speed, -FASTEST, FASTEST, out=speed)
        for _ in range(8):
            pose, twist, accel, _ = self._motion(parameters)
            share = self._bounds.share(pose, twist, accel)
            if share <= 1:
                break
            speed /= 1.01 * share
        return parameters

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return the gap (3,) [m] that the sequence leaves: small, so that rotations stay so."""
        return -self._motion(parameters)[3] * self._lengths

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the derivative (3, P) of the gap."""
        return self._slopes(parameters)[2].T * self._lengths[:, None]

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle, with knots where ramps begin and end."""
        times, twist = self._timeline(parameters)
        pose = knot_poses(times, twist)
        period, y = times[-1], times / times[-1]
        shape = np.column_stack(
            [
                y**3 * (10 - 15 * y + 6 * y**2),
                30 * y**2 * (1 - y) ** 2 / period,
                60 * y * (1 - y) * (1 - 2 * y) / period**2,
            ]
        )
        bump = shape[:, :, None] * pose[-1]
        keep = np.append(np.diff(times) > 1e-7, True)
        keep[0] = True
        return PlateCycle.from_knots(
            times[keep], (pose - bump[:, 0])[keep], (twist - bump[:, 1])[keep], -bump[keep, 2]
        )

    def _split(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        holds = parameters[: self.count + 1] * self._hold_scale
        return holds, parameters[self.count + 1 :] * self._speed

    def _timeline(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        holds, speed = self._split(parameters)
        half, period = self._bounds.half, self._period
        return timeline(holds, speed, self._twists, half, period, self._accel)

    def _motion(
        self, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        times, knots = self._timeline(parameters)
        pose, twist, accel = (np.empty((self._steps, 3)) for _ in range(3))
        gap = motion(times, knots, self._steps, pose, twist, accel)
        return pose, twist, accel, gap

    def _slopes(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self._known is not None and self._known[0] is parameters:
            return self._known[1]
        holds, speed = self._split(parameters)
        slopes = motion_slopes(
            holds, speed, self._twists, self._bounds.half, self._period, self._accel,
            self._steps, SLOPE_STEP, self._hold_scale, self._speed,
        )  # fmt: skip
        self._known = parameters, slopes
        return slopes
