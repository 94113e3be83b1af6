"""Rules of a feeding task. Parts are made ready for a robot. A ready part has enough distance from
other parts, and the requested angle. Parts are added and removed during the task.

As in `move`, each cycle minimises the sum of squared weighted distances to targets. Ready parts
stay ready. The parts with the shortest remaining motion move to their pick windows and rotate to
their angles. Unwanted parts move over the edge into the chute. All parts move apart until there is
enough space for the gripper between them, so that heaps dissolve. When enough parts are ready, the
plate rests and the robot can pick.

The targets of wanted parts do not depend on whether unwanted parts leave. Only the unwanted part
nearest to the chute has the full weight of a wanted part. A soft limit (wall) keeps wanted parts
away from the chute's edge, as from all edges. With a stronger limit, the unwanted parts between the
wanted parts would stop too, and no part would leave.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from plate_core import AngleTargets, Parts, Rig, Targets, part_class
from plate_core.tasks import (
    FeedMode,
    FeedTask,
    Pick,
    Scenario,
    behind_wall,
    free_gap,
    pick_window,
    ready_parts,
    remaining_rotation,
)

from ..estimation import SETTLE_S
from .targets import FULL_DISTANCE_M, distance_weight
from .task import BAND, Assessment, Situation, TaskRules

STILL_M = 1e-3
"""While the plate is at rest, a part is ready only if it has moved by at most this distance since
the last image [m]."""

MARGIN_M = 4e-3
"""Distance of the targets from the border of the pick window, inside the window [m]."""

KEPT = 0.8
"""Half width of the angle interval in which a ready part is not rotated, as a fraction of the
pick's angle tolerance."""

GAP_MARGIN_M = 2e-3
"""Distance that is added to the gripper's clearance for the gap between parts [m]."""

STOCK = 0.03
"""Weight of the distance to the pick window or to the chute, for parts that need not move there
yet. All other parts have the weight 1 [-]. With a larger value, many such parts would push the
other parts against the edge, and no part would move."""

MANY_UNWANTED = 5
"""If at least this number of unwanted parts are on the plate, they move to the chute, even if
enough other parts are ready."""

PURGED = 6.0
"""Weight of the distance to the chute during a purge, for the part nearest to the chute. All other
parts have the weight 1 [-]."""

NEAREST_M = 1e-3
"""Lower limit of the distance d from which the weight of a part with a requested angle is computed
[m]. The weight is proportional to 1/d, so that the nearest part gets ready first. Parts without a
requested angle have no such weight, because with it they hindered each other in simulations."""

CHANGE_M = 0.02
"""While a part moves to its pick window, another part replaces it only if the other part's distance
is shorter by at least this value [m]."""

RENAMED_M = 0.02
"""If a part vanishes and a new part of the same class appears within this distance, both count as
the same part [m]."""

BEYOND_M = 0.01
"""Minimum distance of the targets of unwanted parts outside the chute's edge [m]."""

MAX_BEYOND_M = 0.1
"""Maximum distance of the targets of unwanted parts outside the chute's edge [m]."""

NEAR_EDGE = 1.5
"""A vanished part counts as having left the plate over an edge if it was last detected near this
edge. This value is the maximum distance, in units of the part's reach."""

NEAR_CHUTE = 4.0
"""A vanished part counts as having left the plate over the chute's edge if it was last detected
near this edge. This value is the maximum distance, in units of the part's reach."""


@dataclass(frozen=True)
class FeedReport:
    """Report of a feed task for one image.

    Attributes
    ----------
    stamp : float
        Time at which the image was taken [s].
    mode : FeedMode
    at_rest : bool
        Whether the plate and the parts were at rest in the image and remain at rest.
    ready : Parts
        Parts that the robot can grip now.
    seen : mapping of str to int
        Number of parts on the plate, by class.
    discharged, lost : int
        `discharged` is the number of unwanted parts that left the plate over the chute's edge.
        `lost` is the number of all other parts that left the plate.
    """

    stamp: float = -np.inf
    mode: FeedMode = FeedMode.FEED
    at_rest: bool = False
    ready: Parts = field(default_factory=lambda: Parts.make((), np.zeros((0, 2))))
    seen: Mapping[str, int] = field(default_factory=dict)
    discharged: int = 0
    lost: int = 0


@dataclass(frozen=True)
class FeedMemory:
    """Data that the rules of a feed task store between images.

    Attributes
    ----------
    rest_from : float
        Time since which the plate has been at rest, or from which it will be at rest [s]. Infinite
        while motion is requested.
    position : mapping of str to (x, y)
        Positions of the parts at the last image [m, plate_home]. If the last image was ignored, the
        parts that were ready are omitted, because the robot may have taken them.
    chosen : tuple of str
        Ids of the parts that move to their pick windows.
    clearing : bool
        Whether unwanted parts are moving to the chute.
    report : FeedReport
    """

    rest_from: float = np.inf
    position: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chosen: tuple[str, ...] = ()
    clearing: bool = False
    report: FeedReport = field(default_factory=FeedReport)


@dataclass(frozen=True)
class Feeder(TaskRules):
    """Rules of a feeding task on one rig."""

    task: FeedTask
    rig: Rig

    @property
    def hold_s(self) -> float:
        """Time for which the goal must be met [s]. Infinite, because the task is never done."""
        return np.inf

    @property
    def endless(self) -> bool:
        """True, because the task runs until it is canceled."""
        return True

    @property
    def open_ended(self) -> bool:
        """True, because parts may be added and removed."""
        return True

    def check(self, scenario: Scenario) -> None:
        """Do nothing, because `check_scenario` has already checked the recipe for this rig."""

    def assess(self, memory: FeedMemory | None, now: Situation) -> tuple[FeedMemory, Assessment]:
        """Evaluate one image and return the request, see `TaskRules.assess`."""
        memory = memory or FeedMemory()
        parts, gap = now.parts, free_gap(now.parts, self.rig)
        near = np.array(
            [
                ready_parts(parts, pick, self.task.clearance_m, self.rig, gap)
                for pick in self._picks
            ],
            dtype=bool,
        ).reshape(len(self._picks), len(parts))
        clearing = self._is_clearing_needed(memory, parts, near)
        request, chosen = None, memory.chosen
        if now.active and self._mode is not FeedMode.REST:
            request, chosen = self._make_targets(memory, parts, near, gap, clearing)
        rest_from = np.inf
        if request is None:
            rest_from = min(memory.rest_from, now.rests)
        report = self._make_report(memory, now, rest_from)
        position = {
            name: (x, y)
            for name, (x, y) in zip(parts.ids, parts.position.tolist(), strict=True)
            if name in now.seen.ids or name in memory.position
        }
        if now.kept:  # ready parts that are missing are not lost, because the robot takes them
            taken = memory.report.ready.ids
            position = {
                name: part_position
                for name, part_position in memory.position.items()
                if name not in taken
            }
        ready, ordered = len(report.ready), sum(pick.ready for pick in self._picks)
        left = sum(report.seen.values())
        doing = f"{ready} of {ordered} parts ready, {left} on the plate"
        if self._mode is FeedMode.PURGE:
            doing = f"{left} parts left to purge"
        elif self._mode is FeedMode.REST:
            doing += ", the plate is at rest for the robot"
        return FeedMemory(rest_from, position, chosen, clearing, report), Assessment(
            request=request,
            count=ready,
            distance=np.zeros(len(parts)),
            missing=(),
            doing=doing,
        )

    def keeps_last(self, memory: FeedMemory | None) -> bool:
        """Whether the next image is ignored, because a robot may hide parts and all parts are at
        rest."""
        report = FeedReport() if memory is None else memory.report
        return (
            self.task.order.hidden and self._mode is FeedMode.REST is report.mode and report.at_rest
        )

    @property
    def _mode(self) -> FeedMode:
        return self.task.order.mode

    @property
    def _picks(self) -> tuple[Pick, ...]:
        return self.task.order.picks or self.task.picks

    def _make_report(self, memory: FeedMemory, now: Situation, rest_from: float) -> FeedReport:
        """Return the report for an image. Parts that have left the plate since the last report are
        added to the counts. The plate rests from the time `rest_from` [s] on."""
        seen, before = now.seen, memory.report
        hidden = [i for i, name in enumerate(now.parts.ids) if name not in seen.ids]
        every = _concatenate_parts(
            seen, now.parts.take(hidden)
        )  # also keep clearance from parts that the image does not show
        gap = free_gap(every, self.rig)
        is_seen = np.arange(len(every)) < len(seen)
        ready = np.zeros(len(every), dtype=bool)
        for pick in self._picks:
            ready |= ready_parts(every, pick, self.task.clearance_m, self.rig, gap)
        at_rest = now.taken >= max(rest_from, now.resting_since) + SETTLE_S
        if at_rest and not now.kept:
            last = [memory.position.get(name, (np.inf, np.inf)) for name in every.ids]
            moved = np.hypot(*(every.position - np.reshape(last, (-1, 2))).T)
            ready &= moved <= STILL_M
        ready &= is_seen
        discharged, lost = before.discharged, before.lost
        new = every.take([i for i, name in enumerate(every.ids) if name not in memory.position])
        for name, position in () if now.kept else memory.position.items():
            if name not in every.ids and not _has_new_id(new, name, position):
                side = self._find_exit_side(name, np.array(position))
                meant = side == self._chute_side and not self._is_wanted(name)
                discharged += side is not None and meant
                lost += side is not None and not meant
        return FeedReport(
            stamp=now.taken,
            mode=self._mode,
            at_rest=at_rest,
            ready=every.take(np.flatnonzero(ready)),
            seen=Counter(part_class(name) for name in every.ids),
            discharged=discharged,
            lost=lost,
        )

    @property
    def _chute_side(self) -> tuple[int, int] | None:
        return None if self.task.chute is None else (self.task.chute.x, self.task.chute.y)

    def _is_wanted(self, name: str) -> bool:
        """Whether a part is wanted, so that it must stay on the plate."""
        labels = [pick.label for pick in self._picks]
        return self._mode is not FeedMode.PURGE and part_class(name) in labels

    def _find_exit_side(self, name: str, position: np.ndarray) -> tuple[int, int] | None:
        """Return the side over which a vanished part has left the plate, or None if it has not left
        the plate. `position` (2,) [m] is the last position of the part."""
        reach = self.rig.part_type(part_class(name)).reach_m
        to_edge = self.rig.plate.half - np.abs(position)
        axis = int(np.argmin(to_edge))
        sign = 1 if position[axis] > 0 else -1
        side = (sign, 0) if axis == 0 else (0, sign)
        near = NEAR_CHUTE if side == self._chute_side else NEAR_EDGE
        return side if to_edge[axis] <= near * reach else None

    def _is_clearing_needed(self, memory: FeedMemory, parts: Parts, near: np.ndarray) -> bool:
        """Whether the unwanted parts must move to the chute now. Unwanted parts must move if there
        are many of them, or if no other part can get ready."""
        # If the order is to rest, parts are not counted, because vision may detect the robot as a
        # part.
        if self._chute_side is None or self._mode is FeedMode.REST:
            return self._chute_side is not None and memory.clearing
        unwanted = sum(not self._is_wanted(name) for name in parts.ids)
        if self._mode is FeedMode.PURGE:
            return unwanted > 0
        spare = len(parts) - unwanted - int(np.sum(near))
        return unwanted > 0 and (memory.clearing or unwanted >= MANY_UNWANTED or spare == 0)

    def _make_targets(
        self,
        memory: FeedMemory,
        parts: Parts,
        near: np.ndarray,
        gap: np.ndarray,
        clearing: bool,
    ) -> tuple[Targets | None, tuple[str, ...]]:
        """Return the targets of M parts, and the ids of the parts that must get ready.

        `near` (picks, M) states which parts are ready for each pick. `gap` (M,) is the free
        distance around each part [m]. The targets are None if enough parts are ready and no
        unwanted parts must move to the chute.
        """
        aims, chosen = Aims.none(parts, self.rig), []
        purging = self._mode is FeedMode.PURGE
        for row, pick in enumerate(() if purging else self._picks):
            matching = self._aim_at_window(aims, parts, pick, near[row])
            missing = pick.ready - int(np.sum(near[row]))
            if missing > 0:
                cost = aims.left + np.maximum(self._min_gap - gap, 0)
                cost -= CHANGE_M * np.array([name in memory.chosen for name in parts.ids], float)
                cost[~matching | near[row]] = np.inf
                best = np.argsort(cost)[:missing]
                best = best[np.isfinite(cost[best])]
                aims.full[best] = True
                chosen += [parts.ids[k] for k in best]
        if not chosen and not clearing:
            return None, ()
        unwanted = np.flatnonzero([not self._is_wanted(name) for name in parts.ids])
        if self._chute_side is not None and len(unwanted):
            self._aim_at_chute(aims, unwanted)
        return aims.targets(self._min_gap), tuple(chosen)

    @property
    def _min_gap(self) -> float:
        """Minimum distance between the edges of two parts [m]."""
        return self.task.clearance_m + GAP_MARGIN_M

    def _aim_at_window(self, aims: Aims, parts: Parts, pick: Pick, near: np.ndarray) -> np.ndarray:
        """Set the window and the angle of a pick as targets for the parts of the pick's class.
        `near` (M,) states which parts are ready. Return a mask (M,) that is True for the parts of
        this class."""
        matching = np.array([part_class(name) == pick.label for name in parts.ids], dtype=bool)
        low, high = pick_window(pick, self.rig)
        low, high = behind_wall(low, high, pick.label, self.rig)
        margin = np.minimum(MARGIN_M, (high - low) / 2)
        aims.low[matching], aims.high[matching] = low + margin, high - margin
        aims.weight[matching] = STOCK
        aims.full |= near
        if pick.angle is not None:
            symmetry = self.rig.part_type(pick.label).symmetry
            aims.rotation[matching] = remaining_rotation(parts, pick.angle, symmetry)[matching]
            aims.slack[matching], aims.angled[matching] = BAND * pick.tolerance_rad, True
            aims.slack[near] = KEPT * pick.tolerance_rad
        return matching

    def _aim_at_chute(self, aims: Aims, unwanted: np.ndarray) -> None:
        """Set targets outside the chute's edge for the parts with the indices `unwanted` (n,). The
        part nearest to the chute gets the largest weight."""
        out, half = np.array(self._chute_side, float), self.rig.plate.half
        for axis in np.flatnonzero(out):
            ends = out[axis] * (half[axis] + np.array([BEYOND_M, MAX_BEYOND_M]))
            aims.low[unwanted, axis], aims.high[unwanted, axis] = ends.min(), ends.max()
        aims.leaving[unwanted] = True
        first = unwanted[np.argmin(aims.left[unwanted])]
        purging = self._mode is FeedMode.PURGE
        aims.weight[unwanted] = 1.0 if purging else STOCK
        aims.weight[first], aims.full[first] = PURGED if purging else 1.0, True


@dataclass
class Aims:
    """Targets of M parts. The object is mutable, and the rules set its values in several steps.

    Attributes
    ----------
    position : (M, 2)
        Positions of the parts [m, plate_home].
    low, high : (M, 2)
        Target intervals [m, plate_home].
    weight : (M,)
        Weight of the distance from the target, as a fraction of the full weight [-]. `targets`
        computes the full weight.
    full : (M,) bool
        Whether each part has at least the full weight.
    angle, rotation, slack : (M,)
        Present angle of each part, requested rotation, and tolerance of the rotation [rad].
    angled : (M,) bool
        Whether an angle is requested for each part.
    leaving : (M,) bool
        Whether each part must move to the chute.
    reach : (M,)
        Maximum distance of the contour from the centre, for each part [m].
    """

    position: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    full: np.ndarray
    angle: np.ndarray
    rotation: np.ndarray
    slack: np.ndarray
    angled: np.ndarray
    leaving: np.ndarray
    reach: np.ndarray

    @classmethod
    def none(cls, parts: Parts, rig: Rig) -> Aims:
        """Return targets that only keep the parts on the plate."""
        position, count = parts.position, len(parts)
        anywhere = np.tile(rig.plate.half, (count, 1))
        reach = np.array([rig.part_type(part_class(name)).reach_m for name in parts.ids])
        zero, no = np.zeros(count), np.zeros(count, dtype=bool)
        return cls(
            position, -anywhere, anywhere, zero, no, parts.angle, zero.copy(), zero.copy(),
            no.copy(), no.copy(), reach,
        )  # fmt: skip

    @property
    def left(self) -> np.ndarray:
        """Remaining motion of each part (M,) [m]. The remaining motion is the distance from the
        target, plus the arc length of the remaining rotation at the part's edge."""
        distance = np.hypot(*(self.position - np.clip(self.position, self.low, self.high)).T)
        return np.asarray(distance + self.reach * np.maximum(np.abs(self.rotation) - self.slack, 0))

    def targets(self, gap_m: float) -> Targets:
        """Return the targets of the parts for the request to the solver. `gap_m` is the minimum
        distance between the edges of two parts [m].

        Weights are computed separately for parts that leave and for all other parts. In each group,
        the weights scale the longest distance of a part with full weight to `FULL_DISTANCE_M`. If a
        part must get ready at an angle, the weight scales the distance of this part to
        `FULL_DISTANCE_M`.
        """
        left = self.left
        counts, offset = np.zeros(len(left)), np.column_stack([left, 0 * left])
        for who in (self.leaving, ~self.leaving):
            counts[who] = distance_weight(offset[self.full & who])
        needed = self.full & ~self.leaving & self.angled
        counts[needed] = FULL_DISTANCE_M / np.maximum(left[needed], NEAREST_M)
        weight = counts * np.where(self.full, np.maximum(self.weight, 1.0), self.weight)
        angles, turned = None, self.angled & self.full
        if np.any(turned):
            goal = self.angle + self.rotation
            angles = AngleTargets(
                goal - self.slack, goal + self.slack, counts * self.reach * turned
            )
        return Targets(self.low, self.high, weight[:, None] * np.ones(2), gap_m, angles)


def _has_new_id(parts: Parts, name: str, position: tuple[float, float]) -> bool:
    """Whether one of the parts has the same class as the vanished part `name` and is close to its
    last position (x, y). In this case, both are the same part, which has got a new id."""
    same = [part_class(part_id) == part_class(name) for part_id in parts.ids]
    distance = np.hypot(*(parts.position - position).T)
    return bool(np.any(distance[np.array(same, dtype=bool)] <= RENAMED_M))


def _concatenate_parts(first: Parts, second: Parts) -> Parts:
    """Concatenate two groups of parts."""
    return Parts.make(
        (*first.ids, *second.ids),
        np.vstack([first.position, second.position]),
        np.vstack([first.velocity, second.velocity]),
        np.append(first.angle, second.angle),
        np.append(first.spin, second.spin),
        np.append(first.friction_limit, second.friction_limit),
    )
