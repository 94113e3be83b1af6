"""What a solver returns, and how much of the rig a sampled motion uses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, sin, sqrt
from typing import Literal

import numpy as np
from numba import njit

from plate_core import PlateCycle, PlateError, Rig
from plate_core.motion import PIECES

from .traits import FARTHEST_M, FASTEST_MPS, Traits, find_traits

MARGIN = 0.98
"""Share of the limits that a solver uses: its samples may miss a peak by a little."""

CERTAIN = 0.999
"""Share of the limits that a finished cycle uses at most, by the exact check."""

Status = Literal["solved", "share", "unreachable", "failed"]
"""How a request fared: met; a share of it met; beyond what any motion can do, proven (`share` tells
how much of it is met all the same); nothing of it met, and nothing proven."""


@dataclass(frozen=True)
class Solution:
    """A solver's answer.

    Attributes
    ----------
    success : bool
        Whether the request is met within the solver's tolerance.
    message : str
        What was reached, or why not.
    cycle : PlateCycle
        The motion found: closed, within the rig's limits, also when `success` is false.
    residual : (M, 2)
        Request minus prediction, in mu m g: of the whole request, also where a share is met.
    iterations : int
        Steps of the iterative part, all starts together.
    condition : float
        Condition number of the last linear system: large where parts are hard to tell apart.
    status : Status
        As `success`, and why not.
    share : float
        Share of the request, in its direction, that is found to be possible: 1 where it is met. The
        motion does it, unless another misses less of the whole (`refine`).
    """

    success: bool
    message: str
    cycle: PlateCycle
    residual: np.ndarray
    iterations: int
    condition: float
    status: Status = "failed"
    share: float = 0.0

    def __post_init__(self) -> None:
        if self.success:
            object.__setattr__(self, "status", "solved")
            object.__setattr__(self, "share", 1.0)


@dataclass(frozen=True)
class Bounds:
    """The rig's limits in the form that the solvers use.

    Attributes
    ----------
    motor_rows : (4, 3)
        Motor travel per pose, linearised at home.
    motor_points, motor_directions : (4, 2)
        Where motors push [m], and which way.
    half : (2,)
        Half sides of the plate [m].
    stroke_m, speed, accel : float
        Limits times `MARGIN`.
    arm_m : float
        Length that turns theta into a travel of its usual effect: scales the parameters.
    """

    motor_rows: np.ndarray
    motor_points: np.ndarray
    motor_directions: np.ndarray
    half: np.ndarray
    stroke_m: float
    speed: float
    accel: float
    arm_m: float

    @classmethod
    def of(cls, rig: Rig) -> Bounds:
        """Take the bounds of a rig."""
        rows = [
            (*m.direction, m.point[0] * m.direction[1] - m.point[1] * m.direction[0])
            for m in rig.motors
        ]
        return cls(
            motor_rows=np.array(rows),
            motor_points=np.array([m.point for m in rig.motors], dtype=float),
            motor_directions=np.array([m.direction for m in rig.motors], dtype=float),
            half=rig.plate.half,
            stroke_m=MARGIN * rig.limits.stroke_m,
            speed=MARGIN * rig.limits.speed,
            accel=MARGIN * rig.limits.accel,
            arm_m=float(np.hypot(*rig.plate.half)) * 0.6,
        )

    def share(self, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray) -> float:
        """Return the greatest share of a limit that samples (n, 3) of a motion use."""
        stroke, speed, peak = peaks(pose, twist, accel, self.motor_rows, self.half)
        return max(stroke / self.stroke_m, speed / self.speed, peak / self.accel)

    def exact_share(self, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray) -> float:
        """Return the same against the full limits, of control points (n, 3) of the motion."""
        limits = np.array([self.stroke_m, self.speed, self.accel]) / MARGIN
        return exact_share(
            pose, twist, accel, self.motor_points, self.motor_directions, self.half, limits
        )


@njit(cache=True, fastmath=True, error_model="numpy")
def exact_share(
    pose: np.ndarray,
    twist: np.ndarray,
    accel: np.ndarray,
    points: np.ndarray,
    directions: np.ndarray,
    half: np.ndarray,
    limits: np.ndarray,
) -> float:
    """Return the greatest share of a limit, as `plate_core.motion.usage` has it.

    Parameters
    ----------
    pose, twist, accel : (n, 3)
        Control points of a motion, in plate_home.
    points, directions : (4, 2)
        Motors: where they push [m], and which way.
    half : (2,)
        Half sides of the plate [m].
    limits : (3,)
        Stroke [m], speed [m/s], acceleration [m/s2].
    """
    stroke = speed = peak = 0.0
    for k in range(len(pose)):
        angle = pose[k, 2]
        if abs(angle) < 0.1:  # the usual case, to 1e-9
            s = angle * (1 - angle * angle * (1 / 6 - angle * angle / 120))
            c = 1 - angle * angle * (0.5 - angle * angle / 24)
        else:
            s, c = sin(angle), cos(angle)
        spin, spin_rate = twist[k, 2], accel[k, 2]
        for i in range(len(points)):
            ex, ey = directions[i, 0], directions[i, 1]
            px, py = points[i, 0], points[i, 1]
            along = ex * (c * px - s * py - px) + ey * (s * px + c * py - py)
            across = ey * (c * px - s * py) - ex * (s * px + c * py)
            stroke = max(stroke, abs(ex * pose[k, 0] + ey * pose[k, 1] + along))
            speed = max(speed, abs(ex * twist[k, 0] + ey * twist[k, 1] + spin * across))
        for sx in (-half[0], half[0]):
            for sy in (-half[1], half[1]):
                x, y = c * sx - s * sy, s * sx + c * sy
                ax = accel[k, 0] - spin_rate * y - spin * spin * x
                ay = accel[k, 1] + spin_rate * x - spin * spin * y
                peak = max(peak, ax * ax + ay * ay)
    return max(stroke / limits[0], speed / limits[1], sqrt(peak) / limits[2])


@njit(cache=True, fastmath=True)
def peaks(
    pose: np.ndarray, twist: np.ndarray, accel: np.ndarray, rows: np.ndarray, half: np.ndarray
) -> tuple[float, float, float]:
    """Return the peaks of motor travel [m], motor speed [m/s] and corner acceleration [m/s2]."""
    stroke = speed = peak = 0.0
    for k in range(len(twist)):
        for i in range(len(rows)):
            q = rows[i, 0] * pose[k, 0] + rows[i, 1] * pose[k, 1] + rows[i, 2] * pose[k, 2]
            qd = rows[i, 0] * twist[k, 0] + rows[i, 1] * twist[k, 1] + rows[i, 2] * twist[k, 2]
            stroke = max(stroke, abs(q))
            speed = max(speed, abs(qd))
        spin, spin_rate = twist[k, 2] ** 2, accel[k, 2]
        for sx in (-half[0], half[0]):
            for sy in (-half[1], half[1]):
                ax = accel[k, 0] - spin_rate * sy - spin * sx
                ay = accel[k, 1] + spin_rate * sx - spin * sy
                peak = max(peak, ax * ax + ay * ay)
    return stroke, speed, sqrt(peak)


def within_limits(bounds: Bounds, cycle: PlateCycle) -> PlateCycle:
    """Return the cycle, scaled down as a whole if the exact check finds it above the limits."""
    for _ in range(4):
        worst = bounds.exact_share(*(cycle.control_points(order, PIECES) for order in range(3)))
        if worst <= CERTAIN:
            break
        cycle = cycle.scaled(0.9995 * CERTAIN / worst)
    return cycle


def check_options(options: object, **ranges: tuple[float, float]) -> None:
    """Check that options are numbers in their ranges; whole ones where the range is whole.

    Raises
    ------
    PlateError
        Naming the option, its value and what is allowed.
    """
    for name, (low, high) in ranges.items():
        value = getattr(options, name)
        whole = isinstance(low, int)
        numeric = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
        if not numeric or not low <= value <= high:
            allowed = f"{low:g} to {high:g}" + (", a whole number" if whole else "")
            raise PlateError(f"{name} is {value!r}, allowed: {allowed}")


@dataclass(frozen=True)
class Request:
    """What is asked at M parts, checked.

    Attributes
    ----------
    position, force, velocity : (M, 2)
        [m] in plate_home, [mu m g], [m/s].
    curl : (M,)
        [mu m g / m]; NaN where the curl is free.
    tolerance : (M, 2)
        Forces within +- this [mu m g] of those wanted are as good.
    """

    position: np.ndarray
    force: np.ndarray
    velocity: np.ndarray
    curl: np.ndarray
    tolerance: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """Which of force x, force y, curl, part by part, are asked for: (3 M,) bool."""
        asked = np.ones((len(self.position), 3), bool)
        asked[:, 2] = np.isfinite(self.curl)
        return asked.ravel()

    @cached_property
    def traits(self) -> Traits:
        """What kind of request this is."""
        return Traits(
            *find_traits(self.position, self.force, self.velocity, self.curl, self.tolerance)
        )

    @property
    def idle(self) -> bool:
        """Whether a plate at rest does what is asked."""
        return self.traits.within and not self.must_move

    @property
    def must_move(self) -> bool:
        """Whether a plate at rest is no answer: it brakes moving parts, and it has no curl."""
        return self.traits.moving or self.traits.curled

    def times(self, share: float) -> Request:
        """Return a share of the request: less force and curl in the same direction."""
        return replace(self, force=share * self.force, curl=share * self.curl)

    @classmethod
    def check(
        cls,
        position: np.ndarray,
        force: np.ndarray,
        velocity: np.ndarray | None,
        curl: np.ndarray | None,
        tolerance: np.ndarray | None = None,
    ) -> Request:
        """Check shapes and values.

        Raises
        ------
        PlateError
            If a shape is not (M, 2), or (M,) for curl, or a value is not finite or absurd.
        """
        position = np.array(position, dtype=float)
        if position.ndim != 2 or position.shape[1] != 2 or not len(position):
            raise PlateError(f"position has shape {position.shape}, allowed: (M, 2), M at least 1")
        count = len(position)
        force = np.array(force, dtype=float)
        velocity = np.zeros((count, 2)) if velocity is None else np.array(velocity, dtype=float)
        curl = np.full(count, np.nan) if curl is None else np.array(curl, dtype=float)
        slack = np.zeros((count, 2)) if tolerance is None else np.array(tolerance, dtype=float)
        for name, array in (("force", force), ("velocity", velocity), ("tolerance", slack)):
            if array.shape != (count, 2):
                raise PlateError(f"{name} has shape {array.shape}, allowed: ({count}, 2)")
        if curl.shape != (count,):
            raise PlateError(f"curl has shape {curl.shape}, allowed: ({count},)")
        request = cls(position, force, velocity, curl, slack)
        if not request.traits.sound:
            request._complain()
        return request

    def _complain(self) -> None:
        """Tell which value is not allowed."""
        greatest = {"position": FARTHEST_M, "force": np.inf, "velocity": FASTEST_MPS}
        for name, most in greatest.items():
            array = getattr(self, name)
            size = np.abs(array)
            worst = float(size.max())
            if not worst < np.inf:
                raise PlateError(f"{name} has values that are not finite")
            if worst > most:
                value = array.flat[np.argmax(size)]
                raise PlateError(f"{name} has value {value:g}, allowed: {-most:g} to {most:g}")
        if np.isinf(self.curl).any():
            raise PlateError("curl has infinite values, allowed: numbers, NaN where it is free")
        raise PlateError("tolerance has values below 0 or NaN, allowed: 0 and above")
