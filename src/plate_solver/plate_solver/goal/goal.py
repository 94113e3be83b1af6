"""The goal of one cycle. A goal contains displacements and rotations of the parts. The cycle map
predicts how well a motion meets a goal.

Averaged forces are valid only if the parts hardly move within a cycle, but many parts require long
cycles. Therefore, a goal does not specify forces, but the displacement over the cycle from a given
initial state (section 3.1.2). The function `goal_solution` evaluates the finished cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from plate_core import PlateCycle, PlateError

from .. import _kernels
from ..cycle_map import (
    end_state,
    end_state_gradient,
    end_turning,
    end_turning_gradient,
    finely_sampled,
)
from .ends import Ends
from .solution import Solution

COMING_M = 0.05
"""If the distance of two parts exceeds their minimum distance by at least this value, the pair is
ignored [m]. Within one cycle, two parts approach each other by less than this value."""


@dataclass(frozen=True)
class PartRotations:
    """Requested rotations of M parts over one cycle.

    Attributes
    ----------
    spin : (M,)
        Angular velocity of each part at the start of the cycle [rad/s].
    spread : (M, 3)
        Second moments xx, xy, yy of the contact area of each part at the start of the cycle [m2,
        plate_home].
    low, high : (M,)
        Interval of the rotation over the cycle in which each part has no error [rad].
    weight : (M,)
        Error divided by the distance from the interval [m/rad]. With 0, any rotation is accepted.
    """

    spin: np.ndarray
    spread: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """Middle of each interval (M,) [rad]. 0 if the weight is 0."""
        return np.where(self.weight > 0, (self.low + self.high) / 2, 0.0)

    @property
    def count(self) -> int:
        """Number of parts with a requested rotation."""
        return int(np.count_nonzero(self.weight))

    def shifted(self, shift: np.ndarray | float) -> PartRotations:
        """Return a copy in which all intervals are shifted by `shift` (M,) [rad]."""
        return replace(self, low=self.low + shift, high=self.high + shift)


@dataclass(frozen=True)
class Goal:
    """Goal of one cycle for M parts.

    Attributes
    ----------
    position, velocity : (M, 2)
        Positions [m] and velocities [m/s] of the parts at the start of the cycle, in plate_home.
    displacement : (M, 2)
        Requested displacement over the cycle [m].
    tolerance : (M, 2)
        Tolerances of the displacements [m]. Errors within +-tolerance count as 0.
    friction_accel : (M,)
        mu g of each part [m/s2]. A scalar applies to all parts.
    part_rotations : PartRotations, optional
        Requested rotations. If None, the parts are modelled as points.
    multi_cycle : bool
        Whether later cycles can complete the goal. For such a goal, every motion counts as a
        success.
    weight : (M, 2)
        Error divided by the displacement error outside the tolerance [-]. A scalar applies to all
        parts.
    edge : (2,) or (M, 2)
        Maximum distance of a part's centre from the plate's centre along x and y [m]. Default:
        infinite.
    clear : (M, M) or float
        Minimum distance between the centres of two parts at the end of the cycle [m].
    coast : float
        Time by which the end positions and angles are extrapolated with the final velocities and
        angular velocities [s].
    plate : (3, 3), optional
        State of the plate at the start of the cycle, in the form of `PlateCycle.state`. None if the
        plate is at rest.
    free_end : bool
        Whether the plate may be in any state at the end of the cycle. If False, it must be at rest.

    Raises
    ------
    PlateError
        If a weight is negative, infinite or NaN.
    """

    position: np.ndarray
    velocity: np.ndarray
    displacement: np.ndarray
    tolerance: np.ndarray
    friction_accel: np.ndarray
    part_rotations: PartRotations | None = None
    multi_cycle: bool = False
    weight: np.ndarray | float = 1.0
    edge: np.ndarray | float = np.inf
    clear: np.ndarray | float = 0.0
    coast: float = 0.0
    plate: np.ndarray | None = None
    free_end: bool = False

    def __post_init__(self) -> None:
        same = np.broadcast_to(self.friction_accel, len(self.position))
        object.__setattr__(self, "friction_accel", np.array(same, dtype=float))
        _check_weights("weight", self.weight)
        if self.part_rotations is not None:
            _check_weights("weight of rotations", self.part_rotations.weight)

    @cached_property
    def ends(self) -> Ends:
        """Requested coordinates at the end of the cycle."""
        shape, middle = self.position.shape, self.position + self.displacement

        def flat(values: np.ndarray | float) -> np.ndarray:
            return np.broadcast_to(values, shape).T.ravel()

        low, high = middle - self.tolerance, middle + self.tolerance
        weighed = np.broadcast_to(self.weight, shape) > 0
        beyond = np.where(weighed, [-high, low], -np.inf)
        # If the goal of a part is beyond a wall, the wall of this part is moved to the goal.
        below, above = np.maximum(self.edge, beyond)
        gap = self.position[None] - self.position[:, None]
        clear = np.broadcast_to(self.clear, (len(middle), len(middle)))
        near = np.hypot(gap[..., 0], gap[..., 1]) < clear + COMING_M
        pair = np.ascontiguousarray(np.argwhere(np.triu(near & (clear > 0), 1)))
        requested = np.array([flat(low), flat(high), flat(self.weight), flat(-below), flat(above)])
        if self.part_rotations is not None:
            rotations, free = self.part_rotations, np.full(len(self.position), np.inf)
            angles = np.array([rotations.low, rotations.high, rotations.weight, -free, free])
            requested = np.ascontiguousarray(np.hstack([requested, angles]))
        low, high, weight, edge_low, edge_high = requested
        clear = clear[pair[:, 0], pair[:, 1]]
        return Ends(low, high, weight, edge_low, edge_high, pair, clear, len(self.position))

    @property
    def rows(self) -> int:
        """Number of coordinates. There are two per part, or three per part if rotations are
        requested."""
        return self.position.size + (0 if self.part_rotations is None else len(self.position))

    @property
    def requested_count(self) -> int:
        """Number of requested coordinates. All positions are requested, and those angles whose
        weight is above 0."""
        return self.position.size + (
            0 if self.part_rotations is None else self.part_rotations.count
        )

    @property
    def size(self) -> float:
        """Root mean square of the requested displacements and weighted rotations [m]."""
        requested = self.displacement.ravel()
        if self.part_rotations is not None:
            arc = self.part_rotations.weight * self.part_rotations.middle
            requested = np.concatenate([requested, arc[self.part_rotations.weight > 0]])
        return float(np.sqrt(np.mean(requested**2)))

    def scaled(self, fraction: float) -> Goal:
        """Return the goal reduced to the fraction `fraction`.

        If `multi_cycle` is False, displacements and rotations are multiplied by the fraction f.

        If `multi_cycle` is True, the weights w of the goal are multiplied by f^2. Errors at edges
        and between parts then dominate. Consider a target at the distance d beyond a wall, and a
        part that moves by b beyond the wall. The sum of its squared errors is about (w (d - b))^2 +
        b^2. For a small weight w, the minimum of this sum is at b = w^2 d. With the weight f^2 w,
        the minimum is at b = f^4 w^2 d. With f = 1/2, the part thus moves only 1/16 as far beyond
        the wall.
        """
        rotations = self.part_rotations
        if self.multi_cycle:
            if rotations is not None:
                rotations = replace(rotations, weight=fraction**2 * rotations.weight)
            return replace(self, weight=fraction**2 * self.weight, part_rotations=rotations)
        if rotations is not None:
            rotations = rotations.shifted((fraction - 1) * rotations.middle)
        return replace(self, displacement=fraction * self.displacement, part_rotations=rotations)

    def downhill(self, length: float) -> np.ndarray:
        """Return displacements of the parts (M, 2) [m] in the direction in which the sum of squared
        errors decreases most.

        The longest displacement has the length `length` [m].
        """
        end = (self.position + self.coast * self.velocity).T.ravel()
        if self.part_rotations is not None:
            end = np.append(end, self.coast * self.part_rotations.spin)
        error, slope = self.error(end)
        direction = (error @ slope)[: self.position.size].reshape(2, -1).T
        return np.asarray(direction * (length / max(float(np.max(np.hypot(*direction.T))), 1e-12)))

    def left(self, end: np.ndarray) -> np.ndarray:
        """Return the signed distances (M, 2) [m] from end positions to the nearest points of the
        requested intervals. `end` contains the coordinates at the end of the cycle."""
        miss = self.position + self.displacement - end[: self.position.size].reshape(2, -1).T
        beyond = np.sign(miss) * np.maximum(np.abs(miss) - self.tolerance, 0.0)
        return np.where(np.asarray(self.weight) > 0, beyond, 0.0)

    def angle_errors(self, end: np.ndarray) -> np.ndarray:
        """Return the signed errors (Q,) [rad] of the Q requested rotations. `end` contains the
        coordinates at the end of the cycle."""
        if self.part_rotations is None:
            return np.zeros(0)
        rotations, rotation = self.part_rotations, end[self.position.size :]
        return (np.clip(rotation, rotations.low, rotations.high) - rotation)[rotations.weight > 0]

    def shifted(self, shift: np.ndarray) -> Goal:
        """Return a copy of the goal whose displacements and rotations are increased by `shift` (C,)
        [m, rad]. The order of the coordinates is the same as in `end`."""
        places = self.position.size
        displacement = self.displacement + shift[:places].reshape(2, -1).T
        rotations = (
            None if self.part_rotations is None else self.part_rotations.shifted(shift[places:])
        )
        return replace(self, displacement=displacement, part_rotations=rotations)

    def ahead(self, coast: float, period: float) -> Goal:
        """Return a goal for end positions and angles that are extrapolated by the time `coast` [s].

        Let x0 be the position of a part at the start, x its position at the end, v its final
        velocity, d the requested displacement, and P the length of the cycle. The goal x - x0 = d
        becomes

            x + coast v - x0 = d (1 + coast/P)

        A motion that meets both goals has v = d/P. The final velocity of the part then equals the
        requested mean velocity, so that the next cycle can request the same displacement. Rotations
        are changed in the same way.
        """
        scale, rotations = 1 + coast / period, self.part_rotations
        if rotations is not None:
            rotations = replace(rotations, low=scale * rotations.low, high=scale * rotations.high)
        return replace(
            self,
            displacement=scale * self.displacement,
            tolerance=scale * self.tolerance,
            part_rotations=rotations,
            coast=coast,
        )

    def end(self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Predict the coordinates (C,) of the parts at the end of a sampled motion.

        The order is x of all parts [m], then y of all parts. If rotations are requested, the
        rotations of all parts follow [rad].
        """
        moved = pose, twist, dt, self.friction_accel
        if self.part_rotations is None:
            position, velocity = end_state(self.position, self.velocity, *moved)
            return (position + self.coast * velocity).T.ravel()
        position, velocity, rotation, spin = end_turning(
            self.position,
            self.velocity,
            self.part_rotations.spin,
            self.part_rotations.spread,
            *moved,
        )
        position += self.coast * velocity
        return np.concatenate([position.T.ravel(), rotation + self.coast * spin])

    def end_slopes(
        self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the derivatives of `end` with respect to pose (2, n, C), twist (3, n, C) and dt
        (n, C)."""
        moved = pose, twist, dt, self.friction_accel, self.coast
        if self.part_rotations is None:
            return end_state_gradient(self.position, self.velocity, *moved)
        return end_turning_gradient(
            self.position,
            self.velocity,
            self.part_rotations.spin,
            self.part_rotations.spread,
            *moved,
        )

    def error(self, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors (R,) [m] of the parts' coordinates `end` (C,) after a cycle, and the
        negative derivatives of the errors (R, C).

        The first C errors belong to the coordinates. The other errors belong to pairs of parts that
        are too close to each other.
        """
        return _kernels.end_errors(end, self.ends)


def _check_weights(name: str, weights: np.ndarray | float) -> None:
    values = np.atleast_1d(weights)
    wrong = values[~((values >= 0) & (values < np.inf))]
    if len(wrong):
        raise PlateError(f"{name} has {wrong[0]:g}, allowed: finite, 0 and above")


def goal_solution(
    goal: Goal, cycle: PlateCycle, good_enough: float, iterations: int, condition: float
) -> Solution:
    """Return the `Solution` for a finished cycle that is within the limits of the rig.

    The cycle is evaluated with finer time steps than in the search. The attribute `residual` is the
    remaining distance divided by mu g T^2, with the length T of the cycle. `success` is True if
    `goal.multi_cycle` is True, or if the root mean square error is at most `good_enough` [m].
    """
    end = goal.end(*finely_sampled(cycle))
    left, unit = goal.left(end), goal.friction_accel[:, None] * cycle.period**2
    error, _ = goal.error(end)
    if goal.multi_cycle:
        message = f"{1e3 * float(np.sqrt(np.mean(left**2))):.3g} mm to go"
        if goal.part_rotations is not None and goal.part_rotations.count:
            rotation = float(np.sqrt(np.mean(goal.angle_errors(end) ** 2)))
            message += f", {np.degrees(rotation):.2g} deg to rotate"
    else:
        message = f"displacement error {1e3 * float(np.max(np.abs(error))):.3g} mm"
    return Solution(
        success=goal.multi_cycle
        or bool(np.sqrt(np.sum(error**2) / goal.requested_count) <= good_enough),
        message=f"{message} after {iterations} iterations",
        cycle=cycle,
        residual=left / unit,
        iterations=iterations,
        condition=condition,
        predicted=end,
    )
