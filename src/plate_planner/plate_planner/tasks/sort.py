"""Rules of a sorting task, in which each part moves to the region of its class.

The targets are intervals. A part may be anywhere in its region. If the region does not restrict a
coordinate, the part may have any value of this coordinate. The solver therefore has as much freedom
as possible, which it needs if there are many parts. Parts that cross the plate in opposite
directions pass each other in two lanes, like traffic. The parts together then move in a swirl.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import shapely

from plate_core import Parts, Rig, ScenarioError, Targets, part_class
from plate_core.tasks import Bin, Scenario, Side, SortTask, behind_wall

from .targets import CROWD, GAP, assign, distance_weight
from .task import Assessment, Situation, TaskRules

MARGIN = 0.03
"""Distance of the targets behind the goal line of a side, as a fraction of the plate's half length
or width."""

END = 0.85
"""Outer limit of the area that is used to compute how many parts fit into a side or corner region,
as a fraction of the plate's half length or width."""

LANE = 0.1
"""Weight of the distance from a lane, for a part whose remaining distance along x is at least
`LANE_M` [-]. If this remaining distance is shorter, the weight is proportional to it."""

CROWDED_LANE = 0.3
"""Weight that replaces `LANE` if there are more than `CROWD` parts [-]."""

LANE_M = 0.1
"""Remaining distance of a part along x from which on its lane has the full weight [m]."""

LANE_AT = 0.25
"""Inner edge of the lanes, as a fraction of the plate's half width."""

SWITCH = 0.3
"""If the parts are on average farther than this on the wrong side of their lanes, the swirl
reverses its direction. The unit is the plate's half width."""

SLOT_SPACING = 3.5
"""Distance between neighbouring slots (places for parts) in a bin [part radii]."""

SLOT_CLEAR = 1.25
"""Minimum distance of the slots from the sides of the bin [part radii]."""

GRID_TRIES = 4
"""Number of shifts of the grid of slots that are tried along each axis. The shift that gives the
most slots is used."""


@dataclass(frozen=True)
class Sorter(TaskRules):
    """Rules of a sorting task on one rig."""

    task: SortTask
    rig: Rig

    @property
    def hold_s(self) -> float:
        """Time for which all parts must be in their regions until the task is done [s]."""
        return self.task.hold_s

    def check(self, scenario: Scenario) -> None:
        """Check that each region has enough space for its parts, and that bins do not overlap.

        Raises
        ------
        ScenarioError
            If a region is too small, or if bins overlap. The error names the class, its number of
            parts and the capacity of its region, or the classes of the overlapping bins.
        """
        for group in scenario.parts:
            region = self.task.regions[group.label]
            if isinstance(region, Bin):
                slot = self._bins[group.label][1]
                capacity, hint = len(slot), f"{SLOT_SPACING:g} part radii apart"
                if len(slot):
                    to_edge = np.min(self.rig.plate.half - np.abs(slot))
                    hint += f", the nearest {1e3 * to_edge:.3g} mm from the plate's edges"
            else:
                capacity = self._capacity(group.label, region)
                hint = "touching; a lower goal_fraction gives more space"
            if group.count > capacity:
                raise ScenarioError(
                    f"{scenario.where}: task: regions: {group.label} has {group.count} parts, "
                    f"allowed: at most {capacity} in its region ({hint})"
                )
        radius = self.rig.parts.radius_m
        for (one, (_, a)), (other, (_, b)) in combinations(self._bins.items(), 2):
            gap = float(np.min(np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1))))
            if gap < 2 * SLOT_CLEAR * radius - 1e-9:
                raise ScenarioError(
                    f"{scenario.where}: task: regions: bin_m of {one} and of {other} overlap "
                    f"(their parts would be {1e3 * gap:.0f} mm apart), allowed: bins that "
                    "do not overlap"
                )

    def _capacity(self, label: str, region: Side) -> int:
        """Return the number of parts of a class that have space in a side or corner region, in a
        square pattern."""
        half, wide = self.rig.plate.half, 2 * self.rig.parts.radius_m
        goal = self.task.goal_fraction
        ends = np.maximum(END, goal + 4 * MARGIN)
        ends = np.minimum(ends, 1 - self.rig.edge_margin(label).min_m / half)
        beyond = np.array([region.x, region.y]) != 0
        span = half * np.where(beyond, ends - goal, 2 * END)
        return int(np.prod(np.maximum(1 + np.floor(span / wide + 1e-9), 0)))

    def assess(self, memory: float | None, now: Situation) -> tuple[float, Assessment]:
        """Evaluate one image and return the request, see `TaskRules.assess`. `memory` is the
        direction of the swirl."""
        to_go = self.to_go(now.parts)
        count, total = int(np.sum(to_go == 0)), int(np.sum(~np.isnan(to_go)))
        distance = np.nan_to_num(to_go)
        swirl = self.swirl(memory, now.parts)
        return swirl, Assessment(
            request=self.request(now.parts, swirl),
            goal_met=count == total,
            count=count,
            total=total,
            distance=distance,
            to_go_m=float(np.sum(distance)),
            outcome=f"{count} of {total} parts in their regions",
        )

    def to_go(self, parts: Parts) -> np.ndarray:
        """Return the distance of each part from its region (M,) [m]. The distance is 0 inside the
        region, and NaN for a class without a region."""
        return self.distances(parts.ids, parts.position)

    def distances(self, ids: tuple[str, ...], position: np.ndarray) -> np.ndarray:
        """Return the distances (..., M) [m] of parts from their regions, for one or several sets of
        positions (..., M, 2) [m]. Special values are the same as in `to_go`."""
        sign, goal = self._signs(ids), self.task.goal_fraction * self.rig.plate.half
        short = np.where(sign != 0, np.maximum(goal - position * sign, 0), 0)
        # A part on the goal line is not in its region yet.
        on_line = np.any((sign != 0) & (position * sign <= goal), axis=-1)
        distance = np.hypot(short[..., 0], short[..., 1])
        result = np.maximum(distance, np.where(on_line, np.finfo(float).tiny, 0))
        result[..., ~np.any(sign, axis=1)] = np.nan
        for rows, region, _ in self._parts_by_bin(ids):
            result[..., rows] = shapely.distance(region, shapely.points(position[..., rows, :]))
        return result

    def swirl(self, before: float | None, parts: Parts) -> float:
        """Return the direction of the swirl. The direction is 1 if parts that move to the right
        pass above parts that move to the left, and -1 if they pass below. If the regions are
        opposite corners, these corners determine the direction. Otherwise, the direction changes
        only if the opposite direction suits the present positions much better."""
        sign = self._signs(parts.ids)
        if diagonal := _diagonal_sign(sign):
            return diagonal
        along = self._displacements(parts, sign)[:, 0] * sign[:, 0]
        above = float(np.sum(along * parts.position[:, 1])) / max(
            float(np.sum(np.abs(along))), 1e-9
        )
        if before is None or above * before < -SWITCH * self.rig.plate.half[1]:
            return 1.0 if above >= 0 else -1.0
        return before

    def request(self, parts: Parts, swirl: float) -> Targets:
        """Return the targets of M parts for the request to the solver. `swirl` is the direction of
        the swirl."""
        sign, half = self._signs(parts.ids), self.rig.plate.half
        line = (self.task.goal_fraction + MARGIN) * half
        displacement = self._displacements(parts, sign)
        low, high = np.where(sign > 0, line, -half), np.where(sign < 0, -line, half)
        for rows, region, slot in self._parts_by_bin(parts.ids):
            group = parts.take(rows)
            label = part_class(group.ids[0])
            position = slot[assign((label,) * len(slot), slot, group)]
            clearance = (
                region.exterior.distance(shapely.MultiPoint(position)) - self.rig.parts.radius_m
            )
            clearance = max(clearance, 0.0)
            inside = behind_wall(position - clearance, position + clearance, label, self.rig)
            low[rows], high[rows] = inside
            displacement[rows] = position - parts.position[rows]
        requested = (low > -half) | (high < half)
        weight = np.where(requested, distance_weight(displacement), 0.0)
        # Parts that are far from their sides use one lane to move to the left and another lane to
        # move to the right. Therefore a single rotating force field moves all these parts.
        max_lane = CROWDED_LANE if len(parts) > CROWD else LANE
        lane = max_lane * np.minimum(displacement[:, 0] / LANE_M, 1) * (sign[:, 0] != 0)
        if not _diagonal_sign(sign):
            lane[sign[:, 1] != 0] = 0
        if np.all(sign[:, 0] >= 0) or np.all(sign[:, 0] <= 0):
            lane[:] = 0  # no lanes are needed if all parts move in one direction
        # If the weight of the motion along y is higher, it replaces the weight of the lane.
        lane[lane <= np.where(sign[:, 1] != 0, weight[:, 1], 0)] = 0
        upper = swirl * sign[:, 0] > 0
        middle = LANE_AT * half[1]
        low[:, 1] = np.where((lane > 0) & upper, middle, low[:, 1])
        high[:, 1] = np.where((lane > 0) & ~upper, -middle, high[:, 1])
        weight[:, 1] = np.where(lane > 0, lane, weight[:, 1])
        return Targets(low, high, weight, GAP * self.rig.parts.radius_m)

    def _displacements(self, parts: Parts, sign: np.ndarray) -> np.ndarray:
        """Return the distances of the parts from their targets along x and y (M, 2) [m]. The
        targets are behind the goal lines by `MARGIN`. `sign` (M, 2) contains the signs of the sides
        of each part."""
        line = (self.task.goal_fraction + MARGIN) * self.rig.plate.half
        return np.where(sign != 0, np.maximum(line - parts.position * sign, 0), 0)

    def _signs(self, ids: tuple[str, ...]) -> np.ndarray:
        """Return for each part the signs of its side along x and y (M, 2). A sign is 0 if the
        region does not restrict this coordinate."""
        sides = {k: v for k, v in self.task.regions.items() if isinstance(v, Side)}
        signs = [(s.x, s.y) if (s := sides.get(part_class(i))) else (0, 0) for i in ids]
        return np.array(signs, dtype=float).reshape(-1, 2)

    def _parts_by_bin(
        self, ids: tuple[str, ...]
    ) -> list[tuple[np.ndarray, shapely.Polygon, np.ndarray]]:
        """Return for each bin the indices of its parts, its outline, and its slots (k, 2) [m]."""
        label = np.array([part_class(i) for i in ids])
        found = [(np.flatnonzero(label == name), *bin_) for name, bin_ in self._bins.items()]
        return [(rows, region, slot) for rows, region, slot in found if len(rows)]

    @cached_property
    def _bins(self) -> dict[str, tuple[shapely.Polygon, np.ndarray]]:
        bins = {k: v for k, v in self.task.regions.items() if isinstance(v, Bin)}
        return {k: (shapely.Polygon(v.corner), bin_slots(v, k, self.rig)) for k, v in bins.items()}


def _diagonal_sign(sign: np.ndarray) -> float:
    """Check whether the regions of all parts are two opposite corners. Return 1 for the bottom left
    and the top right corner, -1 for the other two corners, and 0 for other regions. `sign` (M, 2)
    contains the signs of the sides of each part."""
    side = np.prod(sign, axis=1)
    if not len(side) or np.ptp(sign[:, 0]) == 0 or np.ptp(side) != 0:
        return 0.0
    return float(side[0])


def bin_slots(region: Bin, label: str, rig: Rig) -> np.ndarray:
    """Return places (n, 2) [m] for parts of a class in a bin. The places have the distance `wall_m`
    from the plate's edges. If the bin has no such places, the shorter distance `min_m` is
    used."""
    margin = rig.edge_margin(label)
    behind = _grid_slots(region, margin.wall_m, rig)
    return behind if len(behind) else _grid_slots(region, margin.min_m, rig)


def _grid_slots(region: Bin, edge_m: float, rig: Rig) -> np.ndarray:
    """Return places (n, 2) [m] in a bin. The places form a square grid, at least `edge_m` from the
    plate's edges."""
    outline = shapely.Polygon(region.corner)
    spacing, clear = SLOT_SPACING * rig.parts.radius_m, SLOT_CLEAR * rig.parts.radius_m
    limit = (
        rig.plate.half - edge_m + clear
    )  # the outermost grid points are `clear` inside these bounds
    low, high = np.reshape(outline.bounds, (2, 2))
    low, high = np.maximum(low, -limit), np.minimum(high, limit)
    best = np.zeros((0, 2))
    for shift in np.ndindex(GRID_TRIES, GRID_TRIES):
        start = low + clear + spacing * np.array(shift) / GRID_TRIES
        axes = [np.arange(a, b - clear + 1e-9, spacing) for a, b in zip(start, high, strict=True)]
        point = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        to_edge = shapely.distance(outline.exterior, shapely.points(point))
        fits = shapely.contains_xy(outline, *point.T) & (to_edge >= clear - 1e-9)
        if np.sum(fits) > len(best):
            best = point[fits]
    return best
