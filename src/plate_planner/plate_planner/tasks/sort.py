"""Sort: which drift to ask of each part so that every class ends in its region.

Only what the task needs is asked: a part on its way may be faster than asked, a part that has
arrived may stay anywhere in its region, and what the region leaves open is free until an edge or
another part is near. What is not asked leaves the solver freedom, and with many parts it has none
to waste.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np

from plate_core import Parts, Rig, ScenarioError, part_class
from plate_core.tasks import Bin, Scenario, Side, SortTask

from .targets import (
    APPROACH,
    OVER,
    approach_drift,
    assign,
    edges_first,
    hold_back,
    nearness,
    pass_by,
    speed_scaling,
    stay_within,
)
from .task import Assessment, DriftRequest, Situation, TaskRules

CLOSING = 0.5
"""Speed of approach at which parts begin to dodge [drift_max]."""

MARGIN, END = 0.06, 0.85
"""How far beyond the goal line parts are asked to go, and from where they are asked back from the
ends of the plate [fraction of half length]."""

EDGE = (0.70, 0.85)
"""Where the edges along y begin to push back, and do so fully [fraction of half width]."""

DODGE_REACH, DODGE_CLEAR = 5.0, 3.0
"""Distance of centres along x at which parts begin to dodge, and along y at which they need not
[part radii]."""

SLOT_SPACING, SLOT_CLEAR = 3.5, 1.25
"""Distance of neighbouring slots, and of slots from the bin's sides [part radii]."""

GRID_TRIES = 4
"""Shifts of the grid of slots that are tried along each axis: the one with most slots is taken."""


@dataclass(frozen=True)
class SortOptions:
    """Drifts of the sorting rules.

    Attributes
    ----------
    drift_max : float
        Drift asked of the part with the longest way; up to `OVER` times this is welcome [m/s].
    wander : float
        Drift allowed where nothing is asked, in multiples of drift_max [-].
    dodge : float
        Drift along y asked of two parts about to run into each other, in drift_max [-]; 0: none.
    """

    drift_max: float = 0.024
    wander: float = 0.6
    dodge: float = 0.4


@dataclass(frozen=True)
class Sorter(TaskRules):
    """The rules of sorting for one task on one rig."""

    task: SortTask
    rig: Rig
    options: SortOptions = field(default_factory=SortOptions)

    @property
    def hold_s(self) -> float:
        """Done when all parts have been sorted for this long [s]."""
        return self.task.hold_s

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario with a region that has no room for its parts, or with two bins in one
        place.

        Raises
        ------
        ScenarioError
            Names the class, how many parts it has and how many there is room for; or both classes.
        """
        for group in scenario.parts:
            region = self.task.regions[group.label]
            if isinstance(region, Bin):
                room, hint = len(slots(region, self.rig)), f"{SLOT_SPACING:g} part radii apart"
            else:
                room, hint = self._room(region), "touching; a lower goal_fraction has more room"
            if group.count > room:
                raise ScenarioError(
                    f"{scenario.where}: task: regions: that of {group.label} is for {group.count} "
                    f"parts, allowed: at most {room}, {hint}"
                )
        radius = self.rig.parts.radius_m
        for (one, (_, a)), (other, (_, b)) in combinations(self._bins.items(), 2):
            gap = float(np.min(np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1))))
            if gap < 2 * SLOT_CLEAR * radius - 1e-9:
                raise ScenarioError(
                    f"{scenario.where}: task: regions: bin_m of {one} and of {other} overlap "
                    f"(parts would come {1e3 * gap:.0f} mm near each other), allowed: one beside "
                    "the other"
                )

    def _room(self, region: Side) -> int:
        """How many parts find room in a side or corner, in a square pattern."""
        half, wide = self.rig.plate.half, 2 * self.rig.parts.radius_m
        goal = self.task.goal_fraction
        ends = np.maximum((END, EDGE[1]), goal + 2 * MARGIN)
        beyond = np.array([region.x, region.y]) != 0
        span = half * np.where(beyond, ends - goal, 2 * np.array((END, EDGE[1])))
        return int(np.prod(1 + np.floor(span / wide + 1e-9)))

    def assess(self, memory: None, now: Situation) -> tuple[None, Assessment]:
        """Judge one image, and say what is wanted; nothing is remembered."""
        to_go = self.to_go(now.parts)
        count, distance = int(np.sum(to_go == 0)), np.nan_to_num(to_go)
        return None, Assessment(
            request=self.request(now.parts, now.period),
            goal_met=count == np.count_nonzero(~np.isnan(to_go)),
            count=count,
            distance=distance,
            to_go_m=float(np.sum(distance)),
            outcome=f"{count} of {len(to_go)} parts in their regions",
        )

    def to_go(self, parts: Parts, sign: np.ndarray | None = None) -> np.ndarray:
        """How far each part (M,) is from its region [m]; 0 there, NaN for a class without one.

        `sign` (M, 2) are those of the sides, if other than where the parts belong in the end.
        """
        goal = self.task.goal_fraction * self.rig.plate.half
        sign = self._signs(parts) if sign is None else sign
        short = np.where(sign != 0, np.maximum(goal - parts.position * sign, 0), 0)
        # On the line itself is not beyond it.
        on_line = np.any((sign != 0) & (parts.position * sign <= goal), axis=1)
        result = np.maximum(np.hypot(*short.T), np.where(on_line, np.finfo(float).tiny, 0))
        result[~np.any(sign, axis=1)] = np.nan
        for rows, corner, _ in self._binned(parts):
            point = parts.position[rows]
            away = np.maximum(outline_distance(point, corner), np.finfo(float).tiny)
            result[rows] = np.where(inside(point, corner), 0, away)
        return result

    def request(self, parts: Parts, period: float) -> DriftRequest:
        """Return the drift wanted of each part.

        Parameters
        ----------
        parts : Parts
            Parts as seen, M of them.
        period : float
            Length of a cycle [s]: the request acts one cycle after `parts` was seen.

        Returns
        -------
        DriftRequest
            Intervals (M, 2) [m/s, plate_home].
        """
        options = self.options
        position = parts.position + period * parts.velocity
        sign, half, goal = self._in_turn(parts), self.rig.plate.half, self.task.goal_fraction
        ends = (END, EDGE[1])
        speed = options.drift_max * speed_scaling(self.to_go(parts, sign))
        axes = [
            _along(position[:, k], sign[:, k], goal, half[k], ends[k], speed, options)
            for k in range(2)
        ]
        # Parts dodge across the axis along which they are sorted; in a corner that is y by then.
        across = np.where(sign[:, 1] != 0, 0, 1)
        request = DriftRequest(
            np.column_stack([low for low, _ in axes]), np.column_stack([high for _, high in axes])
        )
        dodged = [_dodge(position, axis, request, self.rig, options) for axis in range(2)]
        for axis, (low, high) in enumerate(dodged):
            request.low[:, axis] = np.where(across == axis, low, request.low[:, axis])
            request.high[:, axis] = np.where(across == axis, high, request.high[:, axis])
        request, aim = self._to_slots(parts, position, speed, request)
        wander, fastest = options.wander * options.drift_max, OVER * options.drift_max
        return edges_first(position, aim, half, request, wander, fastest)

    def _to_slots(
        self,
        parts: Parts,
        position: np.ndarray,
        speed: np.ndarray,
        request: DriftRequest,
    ) -> tuple[DriftRequest, np.ndarray]:
        """Replace what is asked of parts that belong in bins; returns their places (M, 2) [m], too,
        0 for parts without."""
        options, radius = self.options, self.rig.parts.radius_m
        low, high, aim = request.low.copy(), request.high.copy(), position.copy()
        binned = np.zeros(len(parts), dtype=bool)
        for rows, corner, slot in self._binned(parts):
            mine = parts.take(rows)
            label = part_class(mine.ids[0])
            place = slot[assign((label,) * len(slot), slot, mine)]
            room = outline_distance(place, corner).min() - radius
            wanted = approach_drift(
                position[rows], place, max(room, 0), speed[rows],
                OVER * options.drift_max,
            )  # fmt: skip
            low[rows], high[rows], aim[rows], binned[rows] = wanted.low, wanted.high, place, True
        if not np.any(binned):
            return request, np.zeros_like(position)
        wanted = pass_by(position, DriftRequest(low, high), radius)
        wanted = hold_back(position, aim, self.rig.plate.half, wanted)
        rows = binned[:, None]
        request = DriftRequest(
            np.where(rows, wanted.low, request.low), np.where(rows, wanted.high, request.high)
        )
        return request, np.where(rows, aim, 0.0)

    def _in_turn(self, parts: Parts) -> np.ndarray:
        """Signs (M, 2) of the sides to which parts are to go now; 0 where they may be anywhere.

        Those that belong in corners go along x first, and along y when all have come so far. Both
        at once is more than a cycle has freedom for: 2 M requests of parts that are mixed. Once all
        are at their ends, those at one end want the same, which is easy.
        """
        sign = self._signs(parts)
        first = sign * [1, 0]
        corner = np.all(sign != 0, axis=1)
        if np.any(self.to_go(parts, first)[corner] > 0):
            sign[corner] = first[corner]
        return sign

    def _signs(self, parts: Parts) -> np.ndarray:
        """Signs (M, 2) of the sides where parts belong; 0 where they may be anywhere."""
        sides = {k: v for k, v in self.task.regions.items() if isinstance(v, Side)}
        signs = [(s.x, s.y) if (s := sides.get(part_class(i))) else (0, 0) for i in parts.ids]
        return np.array(signs, dtype=float).reshape(-1, 2)

    def _binned(self, parts: Parts) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Rows of parts that belong in each bin, the bin's corners (n, 2), its slots (k, 2)."""
        label = np.array([part_class(i) for i in parts.ids])
        found = [(np.flatnonzero(label == name), *bin_) for name, bin_ in self._bins.items()]
        return [(rows, corner, slot) for rows, corner, slot in found if len(rows)]

    @cached_property
    def _bins(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        bins = {k: v for k, v in self.task.regions.items() if isinstance(v, Bin)}
        return {k: (np.array(v.corner), slots(v, self.rig)) for k, v in bins.items()}


def _along(
    x: np.ndarray,
    side: np.ndarray,
    goal: float,
    half: float,
    end: float,
    slowest: np.ndarray,
    options: SortOptions,
) -> tuple[np.ndarray, np.ndarray]:
    """Interval of drift (M,) along one axis that leads into the band beyond the goal line.

    Far from the band it is from `slowest` (M,) [m/s] to over drift_max towards the own side; inside
    it, whatever does not lead out soon; beyond it, back.
    """
    speed, wander = options.drift_max, options.wander * options.drift_max
    own = x * side  # grows towards the own side, for either side
    inner = half * (goal + MARGIN)
    outer = half * max(end, goal + 2 * MARGIN)
    low = np.clip(APPROACH * (inner - own), -wander, slowest)
    high = np.clip(APPROACH * (outer - own), -speed, OVER * speed)
    low = np.minimum(low, high)
    free_low, free_high = stay_within(x, half, *EDGE, speed, wander)
    return (
        np.where(side > 0, low, np.where(side < 0, -high, free_low)),
        np.where(side > 0, high, np.where(side < 0, -low, free_high)),
    )


def _dodge(
    position: np.ndarray,
    across: int,
    request: DriftRequest,
    rig: Rig,
    options: SortOptions,
) -> tuple[np.ndarray, np.ndarray]:
    """Narrow the interval of drift along y of parts about to run into each other along x.

    Of two parts that are asked towards each other, and nearly level in y, the upper one is sent
    up, the lower one down (of two exactly level, the first in the list goes down). Parts on the
    same way at different speeds are left alone. The nearer the edge, the less they are sent: the
    edge comes first. With `across` 0, x and y change places.
    """
    drift_x = request.centre[:, 1 - across]
    low, high = request.low[:, across], request.high[:, across]
    position = position[:, ::-1] if across == 0 else position
    radius, half = rig.parts.radius_m, rig.plate.half[across]
    gap = position[None] - position[:, None]  # [i, j]: from i to j
    approach = (drift_x[:, None] - drift_x[None]) * np.sign(gap[..., 0])
    closing = np.clip(approach / options.drift_max - CLOSING, 0, 1)
    # Over one radius from "far" to "near", so that a request does not jump.
    near = np.clip(DODGE_REACH - np.abs(gap[..., 0]) / radius, 0, 1)
    level = np.clip(DODGE_CLEAR - np.abs(gap[..., 1]) / radius, 0, 1)
    index = np.arange(len(position))
    level_order = np.sign(index[:, None] - index[None])
    away = np.where(gap[..., 1] != 0, -np.sign(gap[..., 1]), level_order)
    push = np.clip(np.sum(away * closing * near * level, axis=1), -1, 1)
    push *= 1 - nearness(position[:, 1], half, *EDGE)
    speed = options.dodge * options.drift_max
    if speed == 0:
        return low, high
    up = low + np.maximum(push, 0) * np.maximum(speed - low, 0)
    down = high - np.maximum(-push, 0) * np.maximum(high + speed, 0)
    return np.where(push > 0, np.minimum(up, high), low), np.where(
        push < 0, np.maximum(down, low), high
    )


def inside(point: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Whether points (..., 2) are in a polygon (n, 2): a ray from each crosses it an odd number."""
    after = np.roll(corner, -1, axis=0)
    x, y = point[..., 0, None], point[..., 1, None]
    crosses = (corner[:, 1] > y) != (after[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (y - corner[:, 1]) / (after[:, 1] - corner[:, 1])
        right = x < corner[:, 0] + fraction * (after[:, 0] - corner[:, 0])
    return np.asarray(np.sum(crosses & right, axis=-1) % 2 == 1)


def outline_distance(point: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Distance (...) [m] of points (..., 2) from the sides of a polygon (n, 2) [m]."""
    edge = np.roll(corner, -1, axis=0) - corner
    offset = point[..., None, :] - corner
    fraction = np.clip(np.sum(offset * edge, axis=-1) / np.sum(edge**2, axis=-1), 0, 1)
    nearest = offset - fraction[..., None] * edge
    return np.asarray(np.min(np.hypot(nearest[..., 0], nearest[..., 1]), axis=-1))


def slots(region: Bin, rig: Rig) -> np.ndarray:
    """Return places (n, 2) [m] in a bin, on a square grid, apart from each other and its sides."""
    corner = np.array(region.corner)
    spacing, clear = SLOT_SPACING * rig.parts.radius_m, SLOT_CLEAR * rig.parts.radius_m
    low, high = np.min(corner, axis=0), np.max(corner, axis=0)
    best = np.zeros((0, 2))
    for shift in np.ndindex(GRID_TRIES, GRID_TRIES):
        start = low + clear + spacing * np.array(shift) / GRID_TRIES
        axes = [np.arange(a, b - clear + 1e-9, spacing) for a, b in zip(start, high, strict=True)]
        point = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        fits = inside(point, corner) & (outline_distance(point, corner) >= clear - 1e-9)
        if np.sum(fits) > len(best):
            best = point[fits]
    return best
