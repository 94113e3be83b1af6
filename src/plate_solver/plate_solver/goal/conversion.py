"""Converts a request (forces or targets) to the goal of one cycle.

A goal is an interval and a weight for x, y and the angle of each part at the end of the cycle. For
a requested force, this interval depends on the length of the cycle, which the solver selects. The
interval also depends on the state at the start of the cycle, which the solver predicts. Therefore,
the solver converts the request, not the planner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import AngleTargets, CycleRequest, Forces, PlateError, Rig, Targets

from ..start import StartState, contact_spread, part_types
from .goal import Goal, PartRotations

MAX_REQUEST = 1e9
"""Maximum absolute value in a request, in SI units. The value is larger than all practical values,
and small enough that its square does not overflow."""

NEAR_M = 0.006
"""If a part is within this distance of its target, it counts as near its target [m]. If all parts
are near their targets, every cycle ends with the plate at rest, so that the parts stay in place."""


@dataclass(frozen=True)
class RequestFacts:
    """Properties of a request that determine the length of the cycle and the kind of search.

    Attributes
    ----------
    multi_cycle : bool
        Whether targets are requested. In this case, later cycles can complete the motion.
    rotating_parts : int or None
        Number of parts with a requested rotation. None if there are no angle targets and all
        torques are 0.
    far : bool
        Whether any part is farther than `NEAR_M` from its target. A rotation counts as the arc
        length by which the edge of the part must move.
    exact : bool
        Whether forces are requested and at least one part has zero tolerance on both axes.
    """

    multi_cycle: bool
    rotating_parts: int | None
    far: bool
    exact: bool

    @classmethod
    def of(cls, rig: Rig, request: CycleRequest) -> RequestFacts:
        """Compute the properties of a request."""
        content = request.forces_or_targets
        if isinstance(content, Forces):
            rotating_parts = int(np.count_nonzero(content.torque)) or None
            exact = not np.all(np.any(content.tolerance > 0, axis=1))
            return cls(multi_cycle=False, rotating_parts=rotating_parts, far=False, exact=exact)
        angles = content.angles
        rotating_parts = None if angles is None else int(np.count_nonzero(angles.weight))
        far = bool(np.any(_to_go(rig, request, content) > NEAR_M))
        return cls(multi_cycle=True, rotating_parts=rotating_parts, far=far, exact=False)


def form_goal(
    rig: Rig, request: CycleRequest, start: StartState, period: float, coast: float, free_end: bool
) -> Goal:
    """Convert a request into the goal of one cycle.

    Parameters
    ----------
    rig : Rig
    request : CycleRequest
        Request for M parts.
    start : StartState
        Predicted state at the start of the cycle.
    period : float
        Length P of the cycle [s].
    coast : float
        Time of the extrapolation beyond the end of the cycle, see `Goal.coast` [s]. It is used only
        for targets.
    free_end : bool
        Whether the plate may be in motion at the end of the cycle. It is used only for targets.

    Raises
    ------
    PlateError
        If the request contains an invalid value. Values must be finite and at most `MAX_REQUEST`;
        only force tolerances may be infinite. An upper bound must not be below the lower bound.
        Weights, tolerances and the clearance must not be negative. The period of forces must be
        positive.
    """
    content = request.forces_or_targets
    if isinstance(content, Targets):
        return _goal_of_targets(rig, content, request, start, coast, free_end)
    return _goal_of_forces(rig, content, request, start, period)


def _goal_of_targets(
    rig: Rig,
    targets: Targets,
    request: CycleRequest,
    start: StartState,
    coast: float,
    free_end: bool,
) -> Goal:
    """Convert targets to a goal. Let x0 be the predicted position and a0 the predicted angle of a
    part at the start of the cycle. The displacement d and the rotation are

        d = target - x0,    turn = target angle - a0,

    for the lower and the upper bound of each interval. The attribute `multi_cycle` of the goal is
    True, because later cycles complete the motion. For such a goal, every motion counts as a
    success. End positions that are too close to edges or to other parts cause additional errors.
    """
    ids, types = request.parts.ids, part_types(rig, request.parts.ids)
    _check_targets(ids, "target", targets)
    _check(("targets",), "gap_m", np.array([targets.gap_m]), 0.0)
    radius = np.array([t.reach_m for t in types])
    margin = np.array([[rig.edge_margin(t.name).wall_m] for t in types])
    rotations = None
    if start.spin is not None and targets.angles is not None:
        _check_targets(ids, "target angle", targets.angles)
        angle = request.parts.angle
        spread = contact_spread(types, request.parts.angle + start.rotation)
        low = targets.angles.low - angle - start.rotation
        high = targets.angles.high - angle - start.rotation
        rotations = PartRotations(start.spin, spread, low, high, targets.angles.weight)
    return Goal(
        position=start.position,
        velocity=start.velocity,
        displacement=(targets.low + targets.high) / 2 - start.position,
        tolerance=(targets.high - targets.low) / 2,
        friction_accel=start.friction_accel,
        part_rotations=rotations,
        multi_cycle=True,
        weight=targets.weight,
        edge=rig.plate.half - margin,
        clear=radius[:, None] + radius + targets.gap_m,
        coast=coast,
        plate=start.plate,
        free_end=free_end,
    )


def _goal_of_forces(
    rig: Rig, forces: Forces, request: CycleRequest, start: StartState, period: float
) -> Goal:
    """Convert forces to a goal. Let v be the drift of a part, m its mass, w its mean angular
    velocity, and J its moment of inertia. A mean force F over a period T changes v by F T/m. A mean
    torque N changes w by N T/J. Over a cycle of length P, the displacement d and the rotation are

        d = (v + F T/m) P,    turn = (w + N T/J) P,    J = m (Sxx + Syy)

    Sxx and Syy are the second moments of the contact area. A tolerance f of the force becomes the
    tolerance f T P/m of the displacement. Displacements have the weight 1. The weight of a
    requested rotation is the radius of the part.
    """
    parts, types = request.parts, part_types(rig, request.parts.ids)
    if not 0 < forces.period <= MAX_REQUEST:
        raise PlateError(
            f"period of forces is {forces.period:g}, allowed: above 0, at most {MAX_REQUEST:g}"
        )
    _check(parts.ids, "force", forces.force, -MAX_REQUEST)
    _check(parts.ids, "tolerance", forces.tolerance, 0.0, np.inf)
    _check(parts.ids, "torque", forces.torque, -MAX_REQUEST)
    gain = forces.period / np.array([[t.mass_kg] for t in types])
    displacement = (parts.velocity + gain * forces.force) * period
    tolerance = gain * forces.tolerance * period
    # Clip the end positions at the edges of the plate. Without the clipping, a part that cannot
    # reach its end position would limit the displacements of all parts.
    edge = rig.plate.half - np.array([[t.reach_m] for t in types])
    low = np.clip(displacement - tolerance, -edge - start.position, edge - start.position)
    high = np.clip(displacement + tolerance, -edge - start.position, edge - start.position)
    rotations = None
    if start.spin is not None:
        weight = np.where(forces.torque != 0, [t.reach_m for t in types], 0.0)
        inertia = np.array([(t.mass_kg or 0.0) * np.trace(t.spread_m2) for t in types])
        rotation = (parts.spin + forces.period / inertia * forces.torque) * period
        spread = contact_spread(types, parts.angle + start.rotation)
        rotations = PartRotations(start.spin, spread, rotation, rotation, weight)
    return Goal(
        position=start.position,
        velocity=start.velocity,
        displacement=(low + high) / 2,
        tolerance=(high - low) / 2,
        friction_accel=start.friction_accel,
        part_rotations=rotations,
        plate=start.plate,
    )


def _to_go(rig: Rig, request: CycleRequest, to: Targets) -> np.ndarray:
    """Return the distance (M,) [m] of each part from its target.

    For a part whose remaining rotation, as an arc length at the part's edge, is larger than this
    distance, the result is the arc length.
    """
    position = request.parts.position if request.start is None else request.start[:, :2]
    distance = np.maximum(np.maximum(to.low - position, position - to.high), 0.0)
    distance = np.hypot(*np.where(to.weight > 0, distance, 0.0).T)
    if to.angles is None:
        return np.asarray(distance)
    angle = request.parts.angle
    rotation = np.maximum(np.maximum(to.angles.low - angle, angle - to.angles.high), 0.0)
    reach = np.array([kind.reach_m for kind in part_types(rig, request.parts.ids)])
    return np.maximum(distance, np.where(to.angles.weight > 0, reach * rotation, 0.0))


def _check_targets(ids: tuple[str, ...], name: str, targets: Targets | AngleTargets) -> None:
    """Check the intervals and weights of targets (M, ...)."""
    _check(ids, f"lower bound of the {name}", targets.low, -MAX_REQUEST)
    _check(ids, f"upper bound of the {name}", targets.high, -MAX_REQUEST)
    _check(ids, f"width of the {name}", targets.high - targets.low, 0.0, np.inf)
    _check(ids, f"weight of the {name}", targets.weight, 0.0)


def _check(
    owners: tuple[str, ...], name: str, values: np.ndarray, low: float, high: float = MAX_REQUEST
) -> None:
    """Check that all values (M, ...) are in the range `low` to `high`. Row i of the values belongs
    to the part owners[i].

    Raises
    ------
    PlateError
        If a value is outside the range. The error names the first such value, its owner and the
        range.
    """
    wrong = ~((values >= low) & (values <= high))  # false for NaN
    if np.any(wrong):
        row = tuple(np.argwhere(wrong)[0])
        raise PlateError(
            f"{name} of {owners[row[0]]} is {values[row]:g}, allowed: {low:g} to {high:g}"
        )
