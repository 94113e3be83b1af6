"""Simulated robot that grips parts. In images, the robot's arm hides the plate below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from plate_core import Parts, PlateError, Rig, part_class
from plate_core.tasks import free_gap

from .hopper import PartsOnPlate
from .state import WorldState

GRIP_REACH_M = 5e-3
"""Maximum distance of a part's centre from the gripper at which the robot can grip the part [m]."""

FINGER_M = 3e-3
"""Thickness of a finger of the gripper [m]. There must be enough space for a finger between a part
and its neighbours."""

NUDGE_M = 2e-3
"""Maximum displacement of a part that slips from the gripper [m]."""

NUDGE_RAD = 0.1
"""Maximum rotation of a part that slips from the gripper [rad]."""


class Move(IntEnum):
    """Command to the robot, as in the service MoveRobot."""

    AWAY = 0
    OVER = 1
    GRIP = 2


@dataclass(frozen=True)
class Grip:
    """Result of a robot's move.

    Attributes
    ----------
    success : bool
        Whether the robot has taken a part. For moves without a grip, the value is True.
    id : str
        Id of the part that was taken or that slipped. Empty if no part was near enough.
    error_m : float
        True distance of the part's centre from the gripper [m]. If no part was near enough, the
        distance of the nearest part. Infinite if the plate is empty.
    error_rad : float
        True angle of the part minus the angle of the gripper [rad], -pi to pi. Equivalent angles of
        a symmetric part count as equal. 0 if no part was near enough.
    message : str
        Text about the result or the failure.
    """

    success: bool
    id: str = ""
    error_m: float = 0.0
    error_rad: float = 0.0
    message: str = ""


def check_gripper(x: float, y: float, angle: float, rig: Rig) -> None:
    """Raise a PlateError if the pose of the gripper is not above the plate."""
    half = rig.plate.half
    if not (abs(x) <= half[0] and abs(y) <= half[1]):
        raise PlateError(
            f"gripper is at ({x:g}, {y:g}) m, allowed: |x| up to {half[0]:g}, |y| up to "
            f"{half[1]:g} m"
        )
    if not np.isfinite(angle):
        raise PlateError(f"angle is {angle:g}, allowed: finite")


def grip_nearest_part(
    state: WorldState, rig: Rig, gripper: Sequence[float], slips: bool, marked: bool
) -> Grip:
    """Compute the result of a grip of the nearest part. `gripper` is the pose x, y, angle of the
    gripper [m, m, rad, plate_home]. If `slips` is True, the part slips and is not taken.

    If `marked` is True, round parts have marks, so that they have an angle.
    """
    x, y, angle = gripper
    apart = np.where(state.on_plate, np.hypot(*(state.position - (x, y)).T), np.inf)
    nearest = float(np.min(apart, initial=np.inf))
    if not nearest <= GRIP_REACH_M:
        near = f", the nearest is {1e3 * nearest:.1f} mm away" if np.isfinite(nearest) else ""
        return Grip(
            False, error_m=nearest,
            message=f"no part within {1e3 * GRIP_REACH_M:g} mm of ({x:.4f}, {y:.4f}) m{near}",
        )  # fmt: skip
    row = int(np.argmin(apart))
    name = state.ids[row]
    symmetry = rig.part_type(part_class(name)).symmetry or int(marked)
    error = 0.0
    if symmetry:
        period = 2 * np.pi / symmetry
        error = float((state.angle[row] - angle + period / 2) % period - period / 2)
    on_plate = np.flatnonzero(state.on_plate)
    parts = Parts.make(
        tuple(state.ids[i] for i in on_plate), state.position[on_plate], angle=state.angle[on_plate]
    )
    gap = float(free_gap(parts, rig)[on_plate == row][0])
    beside = f", another is {1e3 * max(gap, 0.0):.1f} mm beside it" if gap < FINGER_M else ""
    done = "slipped" if slips else "is taken"
    return Grip(not slips, name, nearest, error, f"{name} {done}{beside}")


def displace_slipped_part(
    state: WorldState, rig: Rig, part_id: str, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Return the new position (2,) [m, plate_home] and the new angle [rad] of a part that slipped
    from the gripper. The part is displaced and rotated at random. If the displaced part would
    overlap another part or leave the plate, the part stays at its place instead."""
    row = state.ids.index(part_id)
    position, angle = state.position[row], float(state.angle[row])
    radius, direction = NUDGE_M * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    new = position + radius * np.array([np.cos(direction), np.sin(direction)])
    turned = angle + rng.uniform(-NUDGE_RAD, NUDGE_RAD)
    kind = rig.part_type(part_class(part_id))
    free = np.all(np.abs(new) <= rig.plate.half - kind.reach_m)
    if free and not PartsOnPlate.of(state, rig, part_id).met(kind, new, turned):
        return new, turned
    return position, angle


class Robot:
    """Robot. The object stores past positions of the robot, and the ids of the parts that the robot
    has taken.

    Parameters
    ----------
    rig : Rig
    marked : bool
        Whether round parts have marks, so that they have an angle.
    rng : Generator
        Random number generator for the grips.

    Attributes
    ----------
    taken : frozenset of str
        Ids of the parts that the robot has taken. An id is removed when the part is removed from
        the state.
    stations : list of (float, (2,) or None)
        Past positions of the robot. Each item contains the time since which the robot was at a
        position [s], and the position [m, plate_home]. While the robot is away from the plate, the
        position is None.
    """

    def __init__(self, rig: Rig, marked: bool, rng: np.random.Generator) -> None:
        self._rig, self._marked, self._rng = rig, marked, rng
        self.taken: frozenset[str] = frozenset()
        self.stations: list[tuple[float, np.ndarray | None]] = [(0.0, None)]

    def move(
        self,
        state: WorldState,
        to: int,
        gripper: tuple[float, float, float],
        failure: float,
        now: float,
        shown: float,
    ) -> tuple[WorldState, Grip]:
        """Move the robot. If `to` is `Move.GRIP`, the robot then grips a part. Return the new state
        of the parts, and the result.

        Parameters
        ----------
        state : WorldState
        to : int
            The requested `Move`.
        gripper : tuple of float
            Pose x, y [m, plate_home] and angle [rad] of the gripper.
        failure : float
            Probability that a gripped part slips.
        now, shown : float
            `now` is the time of the move. `shown` is the earliest time that later images can show
            [s]. Positions that the robot left before `shown` are deleted.

        Raises
        ------
        PlateError
            If the move is unknown, or the pose of the gripper is not above the plate.
        """
        x, y, _ = gripper
        if to not in set(Move):
            raise PlateError(f"to is {to}, allowed: 0 (away), 1 (over), 2 (grip)")
        if to == Move.AWAY:
            self._record_station(None, now, shown)
            return state, Grip(True, message="the robot is away")
        check_gripper(*gripper, self._rig)
        self._record_station(np.array([x, y]), now, shown)
        if to == Move.OVER:
            return state, Grip(True, message=f"the robot is over ({x:.4f}, {y:.4f}) m")
        rng = self._rng.spawn(1)[0]  # separate random numbers for each grip
        slips = bool(rng.random() < failure)
        result = grip_nearest_part(state, self._rig, gripper, slips, self._marked)
        row = np.array([name == result.id for name in state.ids], bool)
        if result.success:
            self.taken |= {result.id}
            state = replace(state, on_plate=state.on_plate & ~row)
        elif result.id:
            position, turned = displace_slipped_part(state, self._rig, result.id, rng)
            state = replace(
                state,
                position=np.where(row[:, None], position, state.position),
                velocity=np.where(row[:, None], 0.0, state.velocity),
                angle=np.where(row, turned, state.angle),
                spin=np.where(row, 0.0, state.spin),
            )
        return state, result

    def _record_station(self, position: np.ndarray | None, now: float, shown: float) -> None:
        oldest = max(i for i, (since, _) in enumerate(self.stations) if since <= max(shown, 0.0))
        self.stations = [*self.stations[oldest:], (now, position)]

    def at(self, time: float) -> np.ndarray | None:
        """Return the position of the gripper (2,) [m, plate_home] at the time `time` [s]. Return
        None if the robot was away from the plate."""
        return [position for since, position in self.stations if since <= max(time, 0.0)][-1]

    def has(self, ids: tuple[str, ...]) -> np.ndarray:
        """Return for each of the parts `ids` whether the robot has taken it (M,)."""
        return np.array([name in self.taken for name in ids], bool)
