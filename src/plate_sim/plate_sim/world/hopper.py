"""Simulated hopper that drops parts onto the plate.

A part that falls on another part slides off this part. Therefore, parts never lie on each other,
but they can touch and form dense heaps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
import shapely

from plate_core import MAX_PARTS, PlateError, Rig, part_class
from plate_core.rig import PartType
from plate_core.tasks import MAX_OPEN_S, Hopper

from .state import WorldState

WHOLE = 1e-6
"""Tolerance for rounding errors in the number of parts that have dropped. The number of dropped
parts is computed from a sum of rounded times."""

TRIES = 20
"""Maximum number of random places that are tried for a dropped part."""

SLIDE_STEP_M = 1e-3
"""Length of the steps in which the simulation moves a part that slides off another part [m]."""

TOUCH_M = 1e-6
"""Maximum gap between two parts after one part has slid off the other [m]."""


@dataclass(frozen=True)
class Flow:
    """State of a hopper.

    Attributes
    ----------
    left_s : float
        Remaining time for which the hopper is open [s].
    waited_s : float
        Time for which the hopper has been open after the last part fell [s].
    """

    left_s: float = 0.0
    waited_s: float = 0.0

    def after(self, time_s: float, rate: float) -> tuple[Flow, np.ndarray]:
        """Advance the state by `time_s` [s]. Return the new state, and the times from now at which
        parts drop in this interval (n,) [s]. While the hopper is open, parts drop at the rate
        `rate` [1/s]."""
        open_s = min(self.left_s, time_s)
        waited = self.waited_s + open_s
        count = int(waited * rate + WHOLE)
        times = np.clip(np.arange(1, count + 1) / rate - self.waited_s, 0.0, open_s)
        return Flow(self.left_s - open_s, max(waited - count / rate, 0.0)), times


@dataclass(frozen=True)
class Dropped:
    """A dropped part.

    Attributes
    ----------
    label : str
        Class of the part.
    position : (2,)
        Final position of the part [m, plate_home].
    angle : float
        Angle of the part [rad].
    unit : float
        Relative friction of the part, from -1 to 1 (see `FrictionField.unit`).
    """

    label: str
    position: np.ndarray
    angle: float
    unit: float


def check_duration(duration_s: float) -> None:
    """Raise a PlateError if a hopper cannot be opened for `duration_s` [s]."""
    if not 0 <= duration_s <= MAX_OPEN_S:  # this condition also refuses NaN
        raise PlateError(
            f"duration is {duration_s:g} s, allowed: 0 (closes it) to {MAX_OPEN_S:g} s"
        )


def drop_part(
    hopper: Hopper, state: WorldState, rig: Rig, rng: np.random.Generator
) -> Dropped | None:
    """Drop a part. Return None if no free place for the part was found.

    The part falls at a random place. The distribution of the places is uniform in a disc of radius
    `spread_m` around the place of the hopper. If the part falls on another part, it slides away
    from the centre of the other part until it no longer overlaps any part.
    """
    label = str(rng.choice(list(hopper.mix), p=list(hopper.mix.values())))
    kind, angle, unit = rig.part_type(label), rng.uniform(-np.pi, np.pi), rng.uniform(-1, 1)
    limit, others = rig.plate.half - kind.reach_m, PartsOnPlate.of(state, rig)
    for _ in range(TRIES):
        radius, direction = hopper.spread_m * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
        position = np.array(hopper.place) + radius * np.array(
            [np.cos(direction), np.sin(direction)]
        )
        found = _find_rest_position(others, kind, position, angle, limit)
        if found is not None:
            return Dropped(label, found, angle, unit)
    return None


def _find_rest_position(
    others: PartsOnPlate, kind: PartType, position: np.ndarray, angle: float, limit: np.ndarray
) -> np.ndarray | None:
    """Return the final position of a part that falls at `position` (2,) [m]. Return None if
    the part is not completely on the plate in the end."""
    hit = others.met(kind, position, angle)
    if not hit:
        return position if np.all(np.abs(position) <= limit) else None
    direction = position - others.position[hit[0]]
    distance = np.hypot(*direction)
    direction = direction / distance if distance > 0 else np.array([1.0, 0.0])
    for step in range(1, 1 + ceil(2 * np.hypot(*limit) / SLIDE_STEP_M)):
        end = position + step * SLIDE_STEP_M * direction
        if not np.all(np.abs(end) <= limit):
            return None
        if not others.met(kind, end, angle):
            touching, free = (step - 1) * SLIDE_STEP_M, step * SLIDE_STEP_M
            while free - touching > TOUCH_M:
                middle = (touching + free) / 2
                if others.met(kind, position + middle * direction, angle):
                    touching = middle
                else:
                    free = middle
            return np.asarray(position + free * direction)
    return None


@dataclass(frozen=True)
class PartsOnPlate:
    """Parts on the plate.

    Attributes
    ----------
    position : (M, 2)
        Positions of the parts [m, plate_home].
    reach, radius : (M,)
        `reach` is the maximum distance of a part's outline from its centre [m]. `radius` is the
        radius of a disc [m], and 0 for other parts.
    shape : (M,)
        Outline of each part [m, plate_home]. The outline of a disc is represented by its centre
        (see `PartType.placed`).
    """

    position: np.ndarray
    reach: np.ndarray
    radius: np.ndarray
    shape: np.ndarray

    @classmethod
    def of(cls, state: WorldState, rig: Rig, but: str = "") -> PartsOnPlate:
        """Return the parts of the state that are on the plate, except the part with the id
        `but`."""
        rows = [i for i, name in enumerate(state.ids) if state.on_plate[i] and name != but]
        types = [rig.part_type(part_class(state.ids[i])) for i in rows]
        shapes = map(PartType.placed, types, state.position[rows], state.angle[rows])
        reach, radius = np.array([(kind.reach_m, kind.radius_m) for kind in types]).reshape(-1, 2).T
        return cls(state.position[rows], reach, radius, np.array(list(shapes), dtype=object))

    def met(self, kind: PartType, position: np.ndarray, angle: float) -> list[int]:
        """Return the indices of the parts that another part of type `kind` would overlap at the
        pose `position`, `angle`. The nearest part is first."""
        apart = np.hypot(*(self.position - position).T)
        near = np.argsort(apart)
        near = near[apart[near] < self.reach[near] + kind.reach_m]
        other, shape = self.shape[near], kind.placed(position, angle)
        met = shapely.distance(other, shape) < self.radius[near] + kind.radius_m
        # This pattern (DE-9IM) is true if the interiors of two shapes intersect.
        met |= shapely.relate_pattern(other, shape, "T********")
        return [int(i) for i in near[met]]


class Dispenser:
    """Hopper that opens for a time and drops parts while it is open.

    Parameters
    ----------
    hopper : Hopper or None
        Hopper of the task. None if the task has no hopper.
    rig : Rig
    rng : Generator
        Random number generator for the dropped parts.
    """

    def __init__(self, hopper: Hopper | None, rig: Rig, rng: np.random.Generator) -> None:
        self._hopper = hopper
        self._rig = rig
        self._rng = rng
        self._flow = Flow()

    @property
    def is_open(self) -> bool:
        """Whether the hopper is open."""
        return self._flow.left_s > 0

    def open(self, duration_s: float, state: WorldState) -> int:
        """Open the hopper for `duration_s` from now [s]. If the hopper is still open, the new
        duration replaces the remaining time. Return the number of parts that will drop if there is
        enough free space.

        Raises
        ------
        PlateError
            If there is no hopper, if the time is not allowed, or if the plate is full.
        """
        if self._hopper is None:
            raise PlateError("this scenario has no hopper, required: kind feed with a hopper")
        check_duration(duration_s)
        on_plate = int(np.count_nonzero(state.on_plate))
        if duration_s > 0 and on_plate >= MAX_PARTS:
            raise PlateError(
                f"hopper cannot open: {on_plate} parts are on the plate, allowed: fewer than "
                f"{MAX_PARTS}"
            )
        self._flow = replace(self._flow, left_s=float(duration_s))
        return len(self._flow.after(duration_s, self._hopper.rate)[1])

    def after(self, time_s: float) -> np.ndarray:
        """Advance the time by `time_s` [s]. Return the times from the start of this interval at
        which parts drop (n,) [s]."""
        assert self._hopper is not None
        self._flow, drops = self._flow.after(time_s, self._hopper.rate)
        return drops

    def drop(self, state: WorldState) -> Dropped | None:
        """Drop a part. Return None if the plate is full or no free place for the part was found."""
        assert self._hopper is not None
        if np.count_nonzero(state.on_plate) >= MAX_PARTS:
            return None
        rng = self._rng.spawn(1)[0]  # separate random numbers for each part
        return drop_part(self._hopper, state, self._rig, rng)
