"""The solver's door: the one conversion of a request, forces or targets, into a goal.

A goal is an interval and a weight for x, y and the angle of each part at the end of the cycle.
Only here can it be formed, since the interval of a force depends on the length of the cycle and on
the state at its start, which the solver chooses and predicts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import AngleTargets, Forces, PlateError, Rig, Targets, Wanted

from ..start import StartState, contact_spread, part_types
from .goal import Goal, Turns

MAX_REQUEST = 1e9
"""Maximum value in a request, in SI units: enough for all, and its square can be computed with."""

NEAR_M = 0.006
"""Distance within which a part counts as near its target [m]. If all parts are near, every cycle
ends at rest so that they stay in place."""


@dataclass(frozen=True)
class RequestFacts:
    """Properties of a request that decide how long a cycle is, and how it is searched.

    Attributes
    ----------
    lasting : bool
        Whether targets are requested, which later cycles may reach too.
    rotating : int or None
        Number of parts with a requested rotation; None if no rotation is requested.
    far : bool
        Whether a part, or its rim by rotation, is farther than `NEAR_M` from its target.
    exact : bool
        Whether forces are requested, of a part without any tolerance.
    """

    lasting: bool
    rotating: int | None
    far: bool
    exact: bool

    @classmethod
    def of(cls, rig: Rig, wanted: Wanted) -> RequestFacts:
        """Return those of a request."""
        request = wanted.request
        if isinstance(request, Forces):
            rotating = int(np.count_nonzero(request.torque)) or None
            exact = not np.all(np.any(request.tolerance > 0, axis=1))
            return cls(False, rotating, False, exact)
        angles = request.angles
        rotating = None if angles is None else int(np.count_nonzero(angles.weight))
        return cls(True, rotating, bool(np.any(_to_go(rig, wanted, request) > NEAR_M)), False)


def form_goal(
    rig: Rig, wanted: Wanted, start: StartState, period: float, coast: float, free_end: bool
) -> Goal:
    """Convert a request into the goal of one cycle.

    Parameters
    ----------
    rig : Rig
    wanted : Wanted
        The request, for M parts.
    start : StartState
        Predicted state at the start of the cycle.
    period : float
        Length P of the cycle [s].
    coast : float
        With targets: as in `Goal` [s].
    free_end : bool
        With targets: whether the plate may end in motion.

    Raises
    ------
    PlateError
        If a value is not finite or beyond `MAX_REQUEST`, an interval ends before it begins, or a
        weight, a tolerance, the clearance or the length of a cycle is negative.
    """
    request = wanted.request
    if isinstance(request, Targets):
        return _goal_of_targets(rig, request, wanted, start, coast, free_end)
    return _goal_of_forces(rig, request, wanted, start, period)


def _goal_of_targets(
    rig: Rig, targets: Targets, wanted: Wanted, start: StartState, coast: float, free_end: bool
) -> Goal:
    """Convert targets: with the predicted place x0 and angle a0 at the start of the cycle

        d = target - x0,    turn = target angle - a0,

    for both ends of each interval. The goal lasts: every motion is accepted that leaves little of
    the distances, since later cycles go on. Places near edges and other parts count as errors too.
    """
    ids, types = wanted.parts.ids, part_types(rig, wanted.parts.ids)
    _check_targets(ids, "target", targets)
    _check(("targets",), "gap_m", np.array([targets.gap_m]), 0.0)
    radius = np.array([t.reach_m for t in types])
    margin = np.array([[rig.edge_margin(t.name).wall_m] for t in types])
    turns = None
    if start.spin is not None and targets.angles is not None:
        _check_targets(ids, "target angle", targets.angles)
        angle, spread = wanted.parts.angle, contact_spread(types, wanted.parts.angle + start.turn)
        low = targets.angles.low - angle - start.turn
        high = targets.angles.high - angle - start.turn
        turns = Turns(start.spin, spread, low, high, targets.angles.weight)
    return Goal(
        position=start.position,
        velocity=start.velocity,
        displacement=(targets.low + targets.high) / 2 - start.position,
        tolerance=(targets.high - targets.low) / 2,
        friction_accel=start.friction_accel,
        turns=turns,
        lasting=True,
        weight=targets.weight,
        edge=rig.plate.half - margin,
        clear=radius[:, None] + radius + targets.gap_m,
        coast=coast,
        plate=start.plate,
        free_end=free_end,
    )


def _goal_of_forces(
    rig: Rig, forces: Forces, wanted: Wanted, start: StartState, period: float
) -> Goal:
    """Convert forces: a mean force F over a cycle of length T changes the drift v of a part of mass
    m by F T/m, a mean torque N its spin w by N T/J, so over a cycle of length P

        d = (v + F T/m) P,    turn = (w + N T/J) P,    J = m (Sxx + Syy)

    with the second moments S of its contacts. A half width of forces is one of displacements in the
    same ratio. Displacements have weight 1, rotations the radius at which the part's rim moves.
    """
    parts, types = wanted.parts, part_types(rig, wanted.parts.ids)
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
    # Displacements that lead off the plate are cut at its edge, so they do not hold up the others.
    edge = rig.plate.half - np.array([[t.reach_m] for t in types])
    low = np.clip(displacement - tolerance, -edge - start.position, edge - start.position)
    high = np.clip(displacement + tolerance, -edge - start.position, edge - start.position)
    turns = None
    if start.spin is not None:
        weight = np.where(forces.torque != 0, [t.reach_m for t in types], 0.0)
        inertia = np.array([(t.mass_kg or 0.0) * np.trace(t.spread_m2) for t in types])
        turn = (parts.spin + forces.period / inertia * forces.torque) * period
        spread = contact_spread(types, parts.angle + start.turn)
        turns = Turns(start.spin, spread, turn, turn, weight)
    return Goal(
        position=start.position,
        velocity=start.velocity,
        displacement=(low + high) / 2,
        tolerance=(high - low) / 2,
        friction_accel=start.friction_accel,
        turns=turns,
        plate=start.plate,
    )


def _to_go(rig: Rig, wanted: Wanted, to: Targets) -> np.ndarray:
    """Return the distance (M,) [m] of each part from its target, or of its rim by rotation."""
    place = wanted.parts.position if wanted.start is None else wanted.start[:, :2]
    way = np.maximum(np.maximum(to.low - place, place - to.high), 0.0)
    way = np.hypot(*np.where(to.weight > 0, way, 0.0).T)
    if to.angles is None:
        return np.asarray(way)
    angle = wanted.parts.angle
    turn = np.maximum(np.maximum(to.angles.low - angle, angle - to.angles.high), 0.0)
    reach = np.array([kind.reach_m for kind in part_types(rig, wanted.parts.ids)])
    return np.maximum(way, np.where(to.angles.weight > 0, reach * turn, 0.0))


def _check_targets(ids: tuple[str, ...], name: str, targets: Targets | AngleTargets) -> None:
    """Check interval and weight of targets (M, ...)."""
    _check(ids, f"low end of the {name}", targets.low, -MAX_REQUEST)
    _check(ids, f"high end of the {name}", targets.high, -MAX_REQUEST)
    _check(ids, f"width of the {name}", targets.high - targets.low, 0.0, np.inf)
    _check(ids, f"weight of the {name}", targets.weight, 0.0)


def _check(
    owners: tuple[str, ...], name: str, values: np.ndarray, low: float, high: float = MAX_REQUEST
) -> None:
    """Check that values (M, ...), a row for each owner, are from `low` to `high`.

    Raises
    ------
    PlateError
        Naming the first wrong value, its owner and the range.
    """
    wrong = ~((values >= low) & (values <= high))  # so is NaN
    if np.any(wrong):
        row = tuple(np.argwhere(wrong)[0])
        raise PlateError(
            f"{name} of {owners[row[0]]} is {values[row]:g}, allowed: {low:g} to {high:g}"
        )
