"""Sort: where each part is to go so that every class ends in its region.

Only what the task needs is asked: a part may be anywhere in its region, and what the region leaves
open is free. What is not asked leaves the solver freedom, and with many parts it has none to waste.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from plate_core import Parts, Rig, ScenarioError, Targets, part_class
from plate_core.rig import contains, rim_distance
from plate_core.tasks import Bin, Scenario, Side, SortTask, behind_wall

from .targets import CROWD, GAP, assign, way_weight
from .task import Assessment, Situation, TaskRules

MARGIN, END = 0.03, 0.85
"""How far beyond the goal line parts are to go, and how much of a side or corner holds parts
[fraction of the half length and width]."""

LANE, CROWDED_LANE, LANE_M, LANE_AT = 0.1, 0.3, 0.1, 0.25
"""What a metre beside its lane counts for a part with a way as long as the third [m] or longer, and
in a crowd; and where lanes begin [fraction of the half width]."""

SWITCH = 0.3
"""The hand of a swirl changes if parts are on average so far on the wrong side [fraction of the
half width]."""

SLOT_SPACING, SLOT_CLEAR = 3.5, 1.25
"""Distance of neighbouring slots, and of slots from the bin's sides [part radii]."""

GRID_TRIES = 4
"""Shifts of the grid of slots that are tried along each axis: the one with most slots is taken."""


@dataclass(frozen=True)
class Sorter(TaskRules):
    """The rules of sorting for one task on one rig."""

    task: SortTask
    rig: Rig

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
                slot = self._bins[group.label][1]
                room, hint = len(slot), f"{SLOT_SPACING:g} part radii apart"
                if len(slot):
                    away = np.min(self.rig.plate.half - np.abs(slot))
                    hint += f", the nearest {1e3 * away:.3g} mm from the plate's edges"
            else:
                room = self._room(group.label, region)
                hint = "touching; a lower goal_fraction has more room"
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

    def _room(self, label: str, region: Side) -> int:
        """How many parts of a class find room in a side or corner, in a square pattern."""
        half, wide = self.rig.plate.half, 2 * self.rig.parts.radius_m
        goal = self.task.goal_fraction
        ends = np.maximum(END, goal + 4 * MARGIN)
        ends = np.minimum(ends, 1 - self.rig.edge_margin(label).least_m / half)
        beyond = np.array([region.x, region.y]) != 0
        span = half * np.where(beyond, ends - goal, 2 * END)
        return int(np.prod(np.maximum(1 + np.floor(span / wide + 1e-9), 0)))

    def assess(self, memory: float | None, now: Situation) -> tuple[float, Assessment]:
        """Judge one image, and say what is wanted; the hand of the swirl is remembered."""
        to_go = self.to_go(now.parts)
        count, total = int(np.sum(to_go == 0)), int(np.sum(~np.isnan(to_go)))
        distance = np.nan_to_num(to_go)
        hand = self.hand(memory, now.parts)
        return hand, Assessment(
            request=self.request(now.parts, hand),
            goal_met=count == total,
            count=count,
            total=total,
            distance=distance,
            to_go_m=float(np.sum(distance)),
            outcome=f"{count} of {total} parts in their regions",
        )

    def to_go(self, parts: Parts) -> np.ndarray:
        """How far each part (M,) is from its region [m]; 0 there, NaN for a class without one."""
        sign, goal = self._signs(parts), self.task.goal_fraction * self.rig.plate.half
        short = np.where(sign != 0, np.maximum(goal - parts.position * sign, 0), 0)
        # On the line itself is not beyond it.
        on_line = np.any((sign != 0) & (parts.position * sign <= goal), axis=1)
        result = np.maximum(np.hypot(*short.T), np.where(on_line, np.finfo(float).tiny, 0))
        result[~np.any(sign, axis=1)] = np.nan
        for rows, corner, _ in self._binned(parts):
            point = parts.position[rows]
            away = np.maximum(rim_distance(corner, point), np.finfo(float).tiny)
            result[rows] = np.where(contains(corner, point), 0, away)
        return result

    def hand(self, before: float | None, parts: Parts) -> float:
        """Return which way the parts are to swirl: 1 where those for the right pass above those for
        the left, -1 where below. Opposite corners say which; else it changes only where the other
        way is much nearer."""
        sign = self._signs(parts)
        if diagonal := _diagonal(sign):
            return diagonal
        way = self._ways(parts, sign)[:, 0] * sign[:, 0]
        above = float(np.sum(way * parts.position[:, 1])) / max(float(np.sum(np.abs(way))), 1e-9)
        if before is None or above * before < -SWITCH * self.rig.plate.half[1]:
            return 1.0 if above >= 0 else -1.0
        return before

    def request(self, parts: Parts, hand: float) -> Targets:
        """Return the target of each part, as seen (M)."""
        sign, half = self._signs(parts), self.rig.plate.half
        line = (self.task.goal_fraction + MARGIN) * half
        way = self._ways(parts, sign)
        low, high = np.where(sign > 0, line, -half), np.where(sign < 0, -line, half)
        for rows, corner, slot in self._binned(parts):
            mine = parts.take(rows)
            label = part_class(mine.ids[0])
            place = slot[assign((label,) * len(slot), slot, mine)]
            room = max(float(rim_distance(corner, place).min()) - self.rig.parts.radius_m, 0.0)
            inside = behind_wall(place - room, place + room, label, self.rig)
            low[rows], high[rows] = inside
            way[rows] = place - parts.position[rows]
        asked = (low > -half) | (high < half)
        weight = np.where(asked, way_weight(way), 0.0)
        # Far from their sides, those for either keep to their half: so one swirl carries all.
        most = CROWDED_LANE if len(parts) > CROWD else LANE
        lane = most * np.minimum(way[:, 0] / LANE_M, 1) * (sign[:, 0] != 0)
        if not _diagonal(sign):
            lane[sign[:, 1] != 0] = 0
        if np.all(sign[:, 0] >= 0) or np.all(sign[:, 0] <= 0):
            lane[:] = 0  # all go one way
        lane[lane <= np.where(sign[:, 1] != 0, weight[:, 1], 0)] = 0  # on to the corner
        upper = hand * sign[:, 0] > 0
        middle = LANE_AT * half[1]
        low[:, 1] = np.where((lane > 0) & upper, middle, low[:, 1])
        high[:, 1] = np.where((lane > 0) & ~upper, -middle, high[:, 1])
        weight[:, 1] = np.where(lane > 0, lane, weight[:, 1])
        return Targets(low, high, weight, GAP * self.rig.parts.radius_m)

    def _ways(self, parts: Parts, sign: np.ndarray) -> np.ndarray:
        """Ways (M, 2) [m] to a little beyond the goal lines of sides (M, 2)."""
        line = (self.task.goal_fraction + MARGIN) * self.rig.plate.half
        return np.where(sign != 0, np.maximum(line - parts.position * sign, 0), 0)

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
        return {k: (np.array(v.corner), slots(v, k, self.rig)) for k, v in bins.items()}


def _diagonal(sign: np.ndarray) -> float:
    """Return 1 where parts (M, 2) belong in the bottom left and top right corners, and both do, -1
    for the other two, 0 for other regions."""
    side = np.prod(sign, axis=1)
    if not len(side) or np.ptp(sign[:, 0]) == 0 or np.ptp(side) != 0:
        return 0.0
    return float(side[0])


def slots(region: Bin, label: str, rig: Rig) -> np.ndarray:
    """Return places (n, 2) [m] in a bin for parts of a class: behind the wall along the plate's
    edges, or, where it has none there, as far from them as they have to be."""
    margin = rig.edge_margin(label)
    behind = _grid(region, margin.wall_m, rig)
    return behind if len(behind) else _grid(region, margin.least_m, rig)


def _grid(region: Bin, edge_m: float, rig: Rig) -> np.ndarray:
    """Return places (n, 2) [m] in a bin, on a square grid, apart from each other and its sides, and
    so far from the plate's edges [m]."""
    corner = np.array(region.corner)
    spacing, clear = SLOT_SPACING * rig.parts.radius_m, SLOT_CLEAR * rig.parts.radius_m
    room = rig.plate.half - edge_m + clear  # the grid keeps so clear of its ends
    low = np.maximum(np.min(corner, axis=0), -room)
    high = np.minimum(np.max(corner, axis=0), room)
    best = np.zeros((0, 2))
    for shift in np.ndindex(GRID_TRIES, GRID_TRIES):
        start = low + clear + spacing * np.array(shift) / GRID_TRIES
        axes = [np.arange(a, b - clear + 1e-9, spacing) for a, b in zip(start, high, strict=True)]
        point = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        fits = contains(corner, point) & (rim_distance(corner, point) >= clear - 1e-9)
        if np.sum(fits) > len(best):
            best = point[fits]
    return best
