"""Sequences of rotations as a family of motions: lengths and twists are the parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core import PlateCycle

from .. import _kernels
from ..limits import Limits
from .sequence import knot_poses, motion

RAMP_STEPS, LEAST_STEPS = 8, 6
"""Steps in a ramp, and least ones in a hold, while a sequence is being corrected."""

HOLD_STEP = 1e-3
"""Step in a hold of mean length [s]."""

RAMP_PART = 0.95
"""Fraction of the acceleration limit that ramps take; the rest is for closing the motion."""

UNLIMITED_M = 1e9
"""Stroke of a plate whose stroke is not counted [m]."""


class Sequences(NamedTuple):
    """A family of sequences of J rotations in plain numbers; see `RotationFamily`.

    Attributes
    ----------
    basis : (J, F, 3)
        Twist j is its F parameters times basis j.
    hold_scale : float
        Length of a rotation from its parameter.
    period, accel : float
        [s], peak acceleration of ramps [m/s2].
    loads : (m, 3)
        As in `ramps`: the motors' forces, where they matter.
    steps : (int, int)
        Of a ramp and of a hold.
    limits : Limits
        Its stroke is `UNLIMITED_M` if that is not counted.
    """

    basis: np.ndarray
    hold_scale: float
    period: float
    accel: float
    loads: np.ndarray
    steps: tuple[int, int]
    limits: Limits


Line = tuple[np.ndarray, np.ndarray]
Moved = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def line_of(theta: np.ndarray, family: Sequences) -> Line:
    """Return knot times and twists there, as `timeline`."""
    return _kernels.line_of(theta, family)


def runnable(theta: np.ndarray, family: Sequences) -> tuple[np.ndarray, Line, Moved]:
    """Keep lengths positive, and the motion within the limits; return its knots and samples."""
    return _kernels.runnable(theta, family)


class RotationFamily:
    """Sequences of J rotations in a given order.

    Parameters are the J + 1 lengths (the last is the rest at the end) in units of their mean, and
    for each rotation the three components of its twist in units of the usual speed. The stroke
    limit is a penalty that a search trades against its errors, or, with `within_stroke`, kept by
    all admissible parameters.
    """

    def __init__(
        self,
        twists: np.ndarray,
        limits: Limits,
        period: float,
        speed: float,
        steps: tuple[int, int] | None = None,
        within_stroke: bool = False,
    ) -> None:
        self._limits = limits
        self.period = period
        self._known: tuple[np.ndarray, Line, Moved] | None = None  # of the last samples
        self._lengths = np.array([1.0, 1.0, limits.arm_m])  # turns theta into metres
        hold_steps = max(LEAST_STEPS, round(period / len(twists) / HOLD_STEP))
        stroke = limits.stroke_m if within_stroke else UNLIMITED_M
        self.plain = Sequences(
            np.repeat(np.diag(speed / self._lengths)[None], len(twists), axis=0),
            1 / len(twists),
            period,
            RAMP_PART * limits.accel,
            limits.accel * limits.loads[2] if limits.forceful else np.empty((0, 3)),
            steps or (RAMP_STEPS, hold_steps),
            limits._replace(stroke_m=stroke),
        )
        self._speed_parameters = (twists * self._lengths).ravel()

    @property
    def count(self) -> int:
        """Number of rotations J."""
        return len(self.plain.basis)

    def finer(self, steps: tuple[int, int] | int) -> RotationFamily:
        """Return the same family with other numbers of steps, or so many times those it has."""
        if isinstance(steps, int):
            steps = self.plain.steps[0] * steps, self.plain.steps[1] * steps
        other = object.__new__(RotationFamily)
        other.__dict__.update(self.__dict__, plain=self.plain._replace(steps=steps), _known=None)
        return other

    def parameters(self, fraction: np.ndarray) -> np.ndarray:
        """Return parameters of fractions (J,) of the cycle; what remains is rest at the end."""
        total = float(np.sum(fraction))
        holds = np.append(fraction / max(1.0, total), max(0.0, 1.0 - total)) / self.plain.hold_scale
        return self.admissible(np.concatenate([holds, self._speed_parameters]))

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of steps (n,) [s], and these.

        They are kept until the next: do not change the parameters in place.
        """
        line, moved = self._timeline(parameters), self._motion(parameters)
        self._known = parameters, line, moved
        pose, twist, _, dt, _ = moved
        return pose, twist, dt

    def pull_back(
        self, parameters: np.ndarray, by_pose: np.ndarray, by_twist: np.ndarray, by_dt: np.ndarray
    ) -> np.ndarray:
        """Turn derivatives of R results by the samples into ones (R, P).

        Parameters
        ----------
        parameters : (P,)
        by_pose : (3, n, R), or (2, n, R) where nothing depends on theta itself
        by_twist : (3, n, R)
        by_dt : (n, R)
        """
        return _kernels.pull_back(parameters, self.plain, by_pose, by_twist, by_dt)

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Keep lengths positive, and all but the stroke within the limits."""
        self._known = runnable(np.asarray(parameters, dtype=float), self.plain)
        return self._known[0]

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return the gap that the sequence leaves (3,), and travel beyond the stroke (4,) [m]."""
        pose, _, _, _, gap = self._motion(parameters)
        travel = pose @ self._limits.levers.T
        stroke = self._limits.stroke_m
        over = np.maximum(travel.max(axis=0) - stroke, 0) + np.minimum(
            travel.min(axis=0) + stroke, 0
        )
        return -np.concatenate([gap * self._lengths, over])

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the derivative (7, P) of minus the penalty."""
        rows = self._limits.levers
        gap = _kernels.gap_slopes(parameters, self.plain) * self._lengths[:, None]
        pose = self._motion(parameters)[0]
        travel = pose @ rows.T
        by_pose = np.zeros((3, len(pose), len(rows)))
        for i, row in enumerate(rows):
            for k in (np.argmax(travel[:, i]), np.argmin(travel[:, i])):
                if abs(travel[k, i]) > self._limits.stroke_m:
                    by_pose[:, k, i] += row
        nothing = np.zeros_like(by_pose)
        stroke = self.pull_back(parameters, by_pose, nothing, nothing[0])
        return np.vstack([gap, stroke])

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

    def _timeline(self, parameters: np.ndarray) -> Line:
        if self._known is not None and self._known[0] is parameters:
            return self._known[1]
        return line_of(parameters, self.plain)

    def _motion(self, parameters: np.ndarray) -> Moved:
        if self._known is not None and self._known[0] is parameters:
            return self._known[2]
        return motion(*self._timeline(parameters), self.plain.steps)
