"""Method A: sequences of rotations (section 3.1 of the paper).

The linear problem gives weights of rotations about fixed centres; three more rows ask the sequence
to close. The weights become lengths of a sequence in time, from rest to rest, whose lengths and
speeds are then corrected, on the averaged map or on the cycle map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle, PlateError, Rig

from .centres import curl_matrix, grid, priority_order, rotation_matrix, solve_weights, unit_twists
from .force_map import SAMPLES, mean_force_gradient
from .least_squares import Fit, fit
from .sequence import knot_poses, motion, motion_slopes, timeline
from .solution import CURL_LENGTH_M, Bounds, Request, Solution, within_limits
from .steering import Goal, steer

STEPS_PER_SECOND = 1250
"""Samples of a sequence while it is being corrected [1/s]."""

RAMP_SHARE = 0.95
"""Share of the acceleration limit that ramps take; the rest is for closing the motion."""

SHORTEST, FASTEST = 0.02, 2.5
"""Least length of a rotation and greatest speed, in units of their usual values."""

SLOPE_STEP = 1e-4
"""Step of the differences that give a sequence's derivatives, in units of the parameters."""


@dataclass(frozen=True)
class RotationOptions:
    """Options of `RotationSolver`.

    Attributes
    ----------
    period : float
        Length of the cycle [s].
    speed : float
        Usual speed of the plate's fastest corner in a rotation [m/s].
    most_gain : float
        Bound on inverse singular values of the linear problem [-].
    tolerance : float
        Greatest force error that counts as success [mu m g].
    iterations : int
        Most steps from one start.
    restarts : int
        Most further starts when the first fails.
    seed : int
        Seed of the further starts.
    """

    period: float = 0.2
    speed: float = 0.25
    most_gain: float = 30.0
    tolerance: float = 1e-3
    iterations: int = 40
    restarts: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("period", 1e-3, 10),
            ("speed", 1e-3, 10),
            ("most_gain", 1, 1e12),
            ("tolerance", 0, 1),
            ("iterations", 1, 10_000),
            ("restarts", 0, 10_000),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise PlateError(f"{name} is {value!r}, allowed: {low} to {high}")


class RotationFamily:
    """Sequences of J rotations about given centres in a given order, as a family for `steer`.

    Parameters are the J + 1 lengths (the last is the rest at the end) and the J signed speeds, both
    in units of their usual values.
    """

    def __init__(
        self,
        twists: np.ndarray,
        bounds: Bounds,
        options: RotationOptions,
        steps: int = 0,
    ) -> None:
        self._twists = np.ascontiguousarray(twists)
        self._bounds = bounds
        self._options = options
        self._steps = steps or max(60, round(STEPS_PER_SECOND * options.period))
        self._accel = RAMP_SHARE * bounds.accel
        self._lengths = np.array([1.0, 1.0, bounds.arm_m])  # turns the gap into metres
        self._hold_scale = 1 / len(twists)

    @property
    def count(self) -> int:
        """Number of rotations J."""
        return len(self._twists)

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self._options.period / self._steps

    def finer(self, steps: int) -> RotationFamily:
        """Return the same family with another number of samples."""
        return RotationFamily(self._twists, self._bounds, self._options, steps)

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
        for _ in range(3):
            pose, twist, accel, _ = self._motion(parameters)
            share = self._bounds.share(pose, twist, accel)
            if share <= 1:
                break
            speed /= 1.01 * share
        return parameters

    def penalty(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gap (3,) [m] that the sequence leaves: small, so that rotations stay so."""
        gap = self._motion(parameters)[3]
        slopes = self._slopes(parameters)[2]
        return -gap * self._lengths, slopes.T * self._lengths[:, None]

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
        return holds, parameters[self.count + 1 :] * self._options.speed

    def _timeline(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        holds, speed = self._split(parameters)
        half, period = self._bounds.half, self._options.period
        return timeline(holds, speed, self._twists, half, period, self._accel)

    def _motion(
        self, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        times, knots = self._timeline(parameters)
        pose, twist, accel = (np.empty((self._steps, 3)) for _ in range(3))
        gap = motion(times, knots, self._steps, pose, twist, accel)
        return pose, twist, accel, gap

    def _slopes(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        holds, speed = self._split(parameters)
        return motion_slopes(
            holds, speed, self._twists, self._bounds.half, self._options.period, self._accel,
            self._steps, SLOPE_STEP, self._hold_scale, self._options.speed,
        )  # fmt: skip


class RotationSolver:
    """Plate motions made of rotations.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    centres : (N, 2), optional
        Centres of rotation [m], plate_home; 24 on a grid over the plate if left out.
    **options
        Fields of `RotationOptions`.
    """

    def __init__(self, rig: Rig, centres: np.ndarray | None = None, **options: float) -> None:
        try:
            self.options = RotationOptions(**options)  # type: ignore[arg-type]
        except TypeError:
            known = ", ".join(("centres", *RotationOptions.__dataclass_fields__))
            raise PlateError(f"options are {', '.join(options)}, allowed: {known}") from None
        self._rig = rig
        self._bounds = Bounds.of(rig)
        self.centres = grid(rig.plate.half) if centres is None else np.array(centres, dtype=float)
        if self.centres.ndim != 2 or self.centres.shape[1] != 2 or len(self.centres) < 3:
            raise PlateError(
                f"centres have shape {self.centres.shape}, allowed: (N, 2) with N at least 3"
            )
        self._twists = unit_twists(self.centres, rig.plate.half)
        self._rng = np.random.default_rng(self.options.seed)
        self._warm: tuple[RotationFamily, np.ndarray] | None = None

    def reset(self) -> None:
        """Forget the last solution and start the random numbers anew."""
        self._rng = np.random.default_rng(self.options.seed)
        self._warm = None

    def steering_period(self, count: int) -> float:
        """Period [s] of the cycles that `steer` makes, for any number of parts."""
        return self.options.period

    def solve(
        self,
        position: np.ndarray,
        force: np.ndarray,
        velocity: np.ndarray | None = None,
        curl: np.ndarray | None = None,
    ) -> Solution:
        """Find a closed sequence of rotations with the wanted average forces, equation (9).

        Parameters
        ----------
        position : (M, 2)
            Parts [m], plate_home.
        force : (M, 2)
            Wanted average forces [mu m g].
        velocity : (M, 2), optional
            Parts' velocities [m/s]; zero if left out.
        curl : (M,), optional
            Wanted curl of the averaged field [mu m g / m]; NaN where it is free.

        Returns
        -------
        Solution

        Raises
        ------
        PlateError
            If shapes are wrong or values are not finite.
        """
        request = Request.check(position, force, velocity, curl)
        pick = request.rows
        scale = np.tile([1.0, 1.0, CURL_LENGTH_M], len(request.position))[pick]
        wanted = np.column_stack([request.force, request.curl]).ravel()[pick]
        start, family, condition = self._plan(request.position, request.force, request.curl)

        def attempt(family: RotationFamily, theta: np.ndarray) -> Fit:
            def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                _, twist = family.samples(theta)
                mean, field_curl, gradient = mean_force_gradient(
                    request.position, request.velocity, twist
                )
                got = np.column_stack([mean, field_curl]).ravel()[pick]
                jacobian = family.pull_back(theta, gradient[pick], None)
                return (wanted - got) * scale, jacobian * scale[:, None]

            stop, most = self.options.tolerance / 10, self.options.iterations
            return fit(evaluate, theta, family.admissible, stop, most)

        def good(result: Fit) -> bool:
            return bool(np.max(np.abs(result.error)) <= self.options.tolerance)

        best = attempt(family, start)
        iterations = best.iterations
        for _ in range(self.options.restarts):
            if good(best):
                break
            other = attempt(family, self._shaken(family, best.parameters))
            iterations += other.iterations
            best = min(best, other, key=lambda result: result.cost)
        family = family.finer(SAMPLES)
        best = attempt(family, best.parameters)  # a few steps on samples that resolve dips
        iterations += best.iterations
        error = np.zeros(len(pick))
        error[pick] = best.error / scale
        worst = float(np.max(np.abs(best.error)))
        success = worst <= self.options.tolerance
        return Solution(
            success=success,
            message=(
                f"force error {worst:.2g} mu m g after {iterations} iterations"
                + ("" if success else f", allowed: {self.options.tolerance:g}")
            ),
            cycle=within_limits(self._rig, family.cycle(best.parameters)),
            residual=error.reshape(-1, 3)[:, :2],
            iterations=iterations,
            condition=condition,
        )

    def steer(self, goal: Goal, tolerance: float, good_enough: float) -> Solution:
        """Find a motion from rest to rest that moves parts as asked, on the cycle map.

        Parameters and result as in `SinusoidSolver.steer`.
        """
        period = self.options.period
        good_cost = good_enough**2 * 2 * len(goal.position)
        most = self.options.iterations
        best = family = None
        iterations, condition = 0, float("nan")
        if self._warm is not None:
            family, theta = self._warm
            best = steer(goal, family, theta, tolerance, most)
            iterations = best.iterations
        if best is None or best.cost > good_cost:
            impulse = goal.displacement - goal.velocity * period
            force = impulse / (0.5 * period**2 * goal.friction_accel)
            theta, other_family, condition = self._plan(
                goal.position, force, np.full(len(force), np.nan)
            )
            other = steer(goal, other_family, theta, tolerance, 2 * most)
            iterations += other.iterations
            if best is None or other.cost < best.cost:
                best, family = other, other_family
        assert family is not None
        for _ in range(self.options.restarts):
            if best.cost <= good_cost:
                break
            other = steer(goal, family, self._shaken(family, best.parameters), tolerance, 2 * most)
            iterations += other.iterations
            best = min(best, other, key=lambda result: result.cost)
        self._warm = family, best.parameters
        error = best.error[: 2 * len(goal.position)].reshape(-1, 2)
        worst = float(np.max(np.abs(error)))
        return Solution(
            success=worst <= max(tolerance, good_enough),
            message=f"displacement error {worst * 1e3:.3g} mm after {iterations} iterations",
            cycle=within_limits(self._rig, family.cycle(best.parameters)),
            residual=error / (goal.friction_accel * period**2),
            iterations=iterations,
            condition=condition if np.isfinite(condition) else best.condition,
        )

    def _plan(
        self, position: np.ndarray, force: np.ndarray, curl: np.ndarray
    ) -> tuple[np.ndarray, RotationFamily, float]:
        """Solve the linear problem with three rows for closure, and put it in the paper's order."""
        asked = np.isfinite(curl)
        matrix = np.vstack(
            [
                rotation_matrix(position, self.centres),
                curl_matrix(position, self.centres)[asked] * CURL_LENGTH_M,
                self._twists.T,
            ]
        )
        wanted = np.concatenate([force.T.ravel(), curl[asked] * CURL_LENGTH_M, np.zeros(3)])
        share, condition = solve_weights(matrix, wanted, self.options.most_gain)
        order = priority_order(share, position, self.centres)
        family = RotationFamily(self._twists[order], self._bounds, self.options)
        return family.parameters(share[order]), family, condition

    def _shaken(self, family: RotationFamily, theta: np.ndarray) -> np.ndarray:
        """Return admissible parameters some way from `theta`."""
        return family.admissible(theta + 0.4 * self._rng.normal(size=len(theta)))
