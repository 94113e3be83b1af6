"""A hopper that drops parts on the plate, and a robot that takes them.

Parts come to lie in the plane: one that falls on another slides off it, so that heaps are dense and
their parts touch, but none lies on another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import ceil

import numpy as np

from plate_core import Parts, PlateError, Rig, part_class
from plate_core.rig import PartType, contains, overlap, rim_distance
from plate_core.tasks import Hopper, Side, free_gap

from .state import WorldState

LONGEST_OPEN_S = 60.0
"""A hopper is not opened for longer at once [s]."""

WHOLE = 1e-6
"""So much less than a whole part is one [parts]: times are sums of rounded ones."""

TRIES = 20
"""Places at which a part is dropped, one after the other, until there is room for it."""

SLIDE_STEP_M, TOUCH_M = 1e-3, 1e-6
"""Step in which a part slides off another, and how near it then lies to it [m]."""

GRIP_REACH_M = 5e-3
"""A gripper takes no part whose centre is further off [m]."""

FINGER_M = 3e-3
"""Thickness of a gripper's finger [m]: it has to go between the part and its neighbours."""

NUDGE_M, NUDGE_RAD = 2e-3, 0.1
"""How far at most a part is moved and turned by a grip that fails [m], [rad]."""

OVER_EDGE_M = 0.03
"""A part has left the plate over a side if it is not further inside of it [m]: the plate moves."""


@dataclass(frozen=True)
class Flow:
    """How far a hopper has got.

    Attributes
    ----------
    left_s : float
        It is open for so long still [s].
    waited_s : float
        How long it was open since the last part fell [s].
    """

    left_s: float = 0.0
    waited_s: float = 0.0

    def after(self, time_s: float, rate: float) -> tuple[Flow, np.ndarray]:
        """Return it a time [s] later, and when parts fall in that time (n,) [s], at a rate [1/s]
        while it is open."""
        open_s = min(self.left_s, time_s)
        waited = self.waited_s + open_s
        count = int(waited * rate + WHOLE)
        times = np.clip(np.arange(1, count + 1) / rate - self.waited_s, 0.0, open_s)
        return Flow(self.left_s - open_s, max(waited - count / rate, 0.0)), times


@dataclass(frozen=True)
class Dropped:
    """A part that has come out of the hopper.

    Attributes
    ----------
    label : str
        Its class.
    position : (2,)
        Where it comes to lie [m, plate_home].
    angle : float
        [rad].
    unit : float
        How much more friction it has, from -1 to 1 (`FrictionField.unit`).
    """

    label: str
    position: np.ndarray
    angle: float
    unit: float


def check_duration(duration_s: float) -> None:
    """Refuse a time for which a hopper cannot be opened [s]: a PlateError."""
    if not 0 <= duration_s <= LONGEST_OPEN_S:  # so if it is NaN
        raise PlateError(
            f"duration is {duration_s:g} s, allowed: 0, which shuts it, to {LONGEST_OPEN_S:g} s"
        )


def drop_part(
    hopper: Hopper, state: WorldState, rig: Rig, rng: np.random.Generator
) -> Dropped | None:
    """Let a part fall; None if there is no room for it.

    It falls on a place that is drawn evenly from the disc of `spread_m` about the hopper's. If it
    hits a part there, it slides away from that one's centre until it touches none.
    """
    label = str(rng.choice(list(hopper.mix), p=list(hopper.mix.values())))
    kind, angle, unit = rig.part_type(label), rng.uniform(-np.pi, np.pi), rng.uniform(-1, 1)
    room, others = rig.plate.half - kind.reach_m, Lying.of(state, rig)
    for _ in range(TRIES):
        radius, way = hopper.spread_m * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
        place = np.array(hopper.place) + radius * np.array([np.cos(way), np.sin(way)])
        found = _slid_off(others, kind, place, angle, room)
        if found is not None:
            return Dropped(label, found, angle, unit)
    return None


def _slid_off(
    others: Lying, kind: PartType, place: np.ndarray, angle: float, room: np.ndarray
) -> np.ndarray | None:
    """Return where a part that falls on a place (2,) [m] comes to lie; None if not on the plate."""
    hit = others.met(kind, place, angle)
    if not hit:
        return place if np.all(np.abs(place) <= room) else None
    away = place - others.position[hit[0]]
    far = np.hypot(*away)
    away = away / far if far > 0 else np.array([1.0, 0.0])
    for step in range(1, 1 + ceil(2 * np.hypot(*room) / SLIDE_STEP_M)):
        end = place + step * SLIDE_STEP_M * away
        if not np.all(np.abs(end) <= room):
            return None
        if not others.met(kind, end, angle):
            touching, free = (step - 1) * SLIDE_STEP_M, step * SLIDE_STEP_M
            while free - touching > TOUCH_M:
                middle = (touching + free) / 2
                if others.met(kind, place + middle * away, angle):
                    touching = middle
                else:
                    free = middle
            return np.asarray(place + free * away)
    return None


@dataclass(frozen=True)
class Lying:
    """Parts that lie on the plate.

    Attributes
    ----------
    types : tuple of M PartType
    position : (M, 2)
        [m, plate_home].
    reach : (M,)
        How far they reach from their centres [m].
    outline : tuple of M (n, 2)
        Corners [m, plate_home].
    """

    types: tuple[PartType, ...]
    position: np.ndarray
    reach: np.ndarray
    outline: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, state: WorldState, rig: Rig, but: str = "") -> Lying:
        """Return the parts on the plate, but one."""
        rows = [i for i, name in enumerate(state.ids) if state.on_plate[i] and name != but]
        types = tuple(rig.part_type(part_class(state.ids[i])) for i in rows)
        position = state.position[rows]
        outline = tuple(
            _placed(kind, state.position[i], state.angle[i])
            for kind, i in zip(types, rows, strict=True)
        )
        return cls(types, position, np.array([kind.reach_m for kind in types]), outline)

    def met(self, kind: PartType, place: np.ndarray, angle: float) -> list[int]:
        """Return which of them a part there would overlap, the nearest first."""
        apart = np.hypot(*(self.position - place).T)
        near = [i for i in np.argsort(apart) if apart[i] < self.reach[i] + kind.reach_m]
        corner = _placed(kind, place, angle) if near and not kind.radius_m else np.empty((0, 2))
        return [int(i) for i in near if self._meets(i, kind, place, corner)]

    def _meets(self, i: int, kind: PartType, place: np.ndarray, corner: np.ndarray) -> bool:
        mine, outline = self.types[i], self.outline[i]
        if kind.radius_m and mine.radius_m:
            return True
        if kind.radius_m:
            return _disc_meets(place, kind.radius_m, outline)
        if mine.radius_m:
            return _disc_meets(self.position[i], mine.radius_m, corner)
        return overlap(corner, outline)


def _disc_meets(centre: np.ndarray, radius: float, corner: np.ndarray) -> bool:
    return bool(contains(corner, centre) or rim_distance(corner, centre) < radius)


def _placed(kind: PartType, place: np.ndarray, angle: float) -> np.ndarray:
    """Return the corners (n, 2) of a part's outline [m, plate_home]."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(kind.polygon @ np.array([[cos, sin], [-sin, cos]]) + place)


def went_over(side: Side, position: np.ndarray, rig: Rig) -> np.ndarray:
    """Whether parts that left the plate at places (M, 2) [m, plate_home] did so over a side."""
    sign = np.array([side.x, side.y])
    return np.asarray(np.any(sign * position > rig.plate.half - OVER_EDGE_M, axis=1))


class Move(IntEnum):
    """What a robot is to do, as in the service MoveRobot."""

    AWAY = 0
    OVER = 1
    GRIP = 2


@dataclass(frozen=True)
class Grip:
    """What came of a robot's move.

    Attributes
    ----------
    success : bool
        Of a grip: whether it has a part; else True.
    id : str
        Of the part it has, or that slipped; empty: it found none.
    error_m : float
        True distance of that part's centre from the gripper, or if it found none, of the nearest
        part; infinite if there is none [m].
    error_rad : float
        True angle that the gripper would have to turn to lie as the part does, from -pi to pi, less
        what the part's symmetry hides; 0 if it found none [rad].
    message : str
        What was done, or why not.
    """

    success: bool
    id: str = ""
    error_m: float = 0.0
    error_rad: float = 0.0
    message: str = ""


def check_gripper(x: float, y: float, angle: float, rig: Rig) -> None:
    """Refuse a place at which a gripper cannot be: a PlateError."""
    half = rig.plate.half
    if not (abs(x) <= half[0] and abs(y) <= half[1]):
        raise PlateError(
            f"gripper is at ({x:g}, {y:g}) m, allowed: |x| up to {half[0]:g}, |y| up to "
            f"{half[1]:g} m"
        )
    if not np.isfinite(angle):
        raise PlateError(f"angle is {angle:g}, allowed: finite")


def grip(state: WorldState, rig: Rig, gripper: Sequence[float], slips: bool, marked: bool) -> Grip:
    """Close a gripper at (x, y, angle) [m, m, rad, plate_home] on the nearest part, which may slip.

    Round parts that are `marked` have an angle, too.
    """
    x, y, turn = gripper
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
        error = float((state.angle[row] - turn + period / 2) % period - period / 2)
    here = np.flatnonzero(state.on_plate)
    parts = Parts.make(
        tuple(state.ids[i] for i in here), state.position[here], angle=state.angle[here]
    )
    gap = float(free_gap(parts, rig)[here == row][0])
    beside = f", another is {1e3 * max(gap, 0.0):.1f} mm beside it" if gap < FINGER_M else ""
    done = "slipped" if slips else "is taken"
    return Grip(not slips, name, nearest, error, f"{name} {done}{beside}")


def nudged(
    state: WorldState, rig: Rig, part_id: str, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Return where (2,) [m, plate_home] and at which angle [rad] a part lies from which a gripper
    slipped: where it was, if it cannot move freely."""
    row = state.ids.index(part_id)
    place, angle = state.position[row], float(state.angle[row])
    radius, way = NUDGE_M * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    new = place + radius * np.array([np.cos(way), np.sin(way)])
    turned = angle + rng.uniform(-NUDGE_RAD, NUDGE_RAD)
    kind = rig.part_type(part_class(part_id))
    free = np.all(np.abs(new) <= rig.plate.half - kind.reach_m)
    if free and not Lying.of(state, rig, part_id).met(kind, new, turned):
        return new, turned
    return place, angle
