"""Rules of a feeding task. Parts are made ready for a robot: they are isolated and rotated to the
requested angles. Parts are added and removed during the task.

As in `move`, each cycle minimises the sum of squared weighted distances to targets. Ready parts
stay ready. The parts with the shortest remaining motion move to their windows and angles. Unwanted
parts move over the edge into the chute. All parts keep the gripper's clearance from each other, so
that heaps dissolve. When enough parts are ready, the plate rests and the robot can pick.

The targets of wanted parts are the same whether or not unwanted parts leave. Only the unwanted part
nearest to the chute has the full weight of a wanted part. A wall keeps wanted parts away from the
chute's edge, as from all edges. A stronger restraint would also stop the unwanted parts between
them, and no part would leave.
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
    to_turn,
)

from ..estimation import SETTLE_S
from .targets import FULL_DISTANCE_M, distance_weight
from .task import BAND, Assessment, Situation, TaskRules

STILL_M = 1e-3
"""Maximum displacement of a ready part since the last image, while the plate is at rest [m]."""

MARGIN_M = 4e-3
"""Margin of the targets inside the window [m]."""

KEPT = 0.8
"""Half width of the angle interval in which a ready part has no error, as a fraction of the pick's
tolerance."""

GAP_MARGIN_M = 2e-3
"""Margin added to the gripper's clearance [m]."""

STOCK = 0.03
"""Weight of the distance to the window or to the chute, for parts that are not needed yet. The
weight of all other parts is 1 [-]. With a larger value, many such parts would push the other parts
against the wall, and no part would move."""

MANY_UNWANTED = 5
"""If the plate has at least this number of unwanted parts, all of them move to the chute, even if
enough other parts are ready."""

PURGED = 6.0
"""Weight of the distance to the chute during a purge, for the part nearest to the chute. The weight
of all other parts is 1 [-]."""

NEAREST_M = 1e-3
"""Minimum distance in the weight of a part that must get ready at an angle [m]. The weight is
inversely proportional to the distance of the part, so that the nearest part gets ready first. Parts
without a requested angle have no such weight, because they would hinder each other in
simulations."""

CHANGE_M = 0.02
"""Another part replaces a part that moves to its window only if its distance is shorter by at least
this value [m]."""

RENAMED_M = 0.02
"""A new part and a vanished part of its class count as the same part if their distance is at most
this value [m]."""

BEYOND_M = 0.01
"""Minimum distance of targets beyond the chute's edge [m]."""

FAR_M = 0.1
"""Maximum distance of targets beyond the chute's edge [m]."""

NEAR_EDGE = 1.5
"""A vanished part counts as having left over an edge if its last position was within this distance
of the edge, in units of the part's reach."""

NEAR_CHUTE = 4.0
"""A vanished part counts as having left over the chute's edge if its last position was within this
distance of the edge, in units of the part's reach."""


@dataclass(frozen=True)
class FeedReport:
    """Report of the task for one image.

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
        `discharged` is the number of unwanted parts that left over the chute's edge. `lost` is the
        number of all other parts that left.
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
    """Memory of the feeding rules between images.

    Attributes
    ----------
    rest_from : float
        Start of the plate's rest [s]. Infinite while the plate moves.
    place : mapping of str to (x, y)
        Positions of parts at the last image [m, plate_home]. If the last image was ignored, the
        ready parts are omitted, because the robot may have taken them.
    chosen : tuple of str
        Parts that move to their windows.
    clearing : bool
        Whether unwanted parts are on their way to the chute.
    report : FeedReport
    """

    rest_from: float = np.inf
    place: Mapping[str, tuple[float, float]] = field(default_factory=dict)
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
        """Accept any recipe, because `check_scenario` has already checked it for this rig."""

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
        clearing = self._clearing(memory, parts, near)
        request, chosen = None, memory.chosen
        if now.active and self._mode is not FeedMode.REST:
            request, chosen = self._request(memory, parts, near, gap, clearing)
        rest_from = np.inf
        if request is None:
            rest_from = min(memory.rest_from, now.rests)
        report = self._report(memory, now, rest_from)
        place = {
            name: (x, y)
            for name, (x, y) in zip(parts.ids, parts.position.tolist(), strict=True)
            if name in now.seen.ids or name in memory.place
        }
        if now.kept:  # missing ready parts are not lost: the robot takes them
            taken = memory.report.ready.ids
            place = {name: at for name, at in memory.place.items() if name not in taken}
        ready, ordered = len(report.ready), sum(pick.ready for pick in self._picks)
        left = sum(report.seen.values())
        doing = f"{ready} of {ordered} parts ready, {left} on the plate"
        if self._mode is FeedMode.PURGE:
            doing = f"{left} parts left to purge"
        elif self._mode is FeedMode.REST:
            doing += ", the plate is at rest for the robot"
        return FeedMemory(rest_from, place, chosen, clearing, report), Assessment(
            request=request,
            count=ready,
            distance=np.zeros(len(parts)),
            missing=(),
            doing=doing,
        )

    def keeps_last(self, memory: FeedMemory | None) -> bool:
        """Whether the image is ignored, because the robot hides parts and all parts are at rest."""
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

    def _report(self, memory: FeedMemory, now: Situation, rest_from: float) -> FeedReport:
        """Return the report of this image. It adds the parts that left since the last report to its
        counts. The plate rests from `rest_from` [s] on."""
        seen, before = now.seen, memory.report
        hidden = [i for i, name in enumerate(now.parts.ids) if name not in seen.ids]
        every = _join(
            seen, now.parts.take(hidden)
        )  # parts that the image does not show also need clearance
        gap = free_gap(every, self.rig)
        here = np.arange(len(every)) < len(seen)
        ready = np.zeros(len(every), dtype=bool)
        for pick in self._picks:
            ready |= ready_parts(every, pick, self.task.clearance_m, self.rig, gap)
        at_rest = now.taken >= max(rest_from, now.resting_since) + SETTLE_S
        if at_rest and not now.kept:
            last = [memory.place.get(name, (np.inf, np.inf)) for name in every.ids]
            moved = np.hypot(*(every.position - np.reshape(last, (-1, 2))).T)
            ready &= moved <= STILL_M
        ready &= here
        discharged, lost = before.discharged, before.lost
        new = every.take([i for i, name in enumerate(every.ids) if name not in memory.place])
        for name, place in () if now.kept else memory.place.items():
            if name not in every.ids and not _is_among(new, name, place):
                side = self._left_over(name, np.array(place))
                meant = side == self._chute and not self._is_wanted(name)
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
    def _chute(self) -> tuple[int, int] | None:
        return None if self.task.chute is None else (self.task.chute.x, self.task.chute.y)

    def _is_wanted(self, name: str) -> bool:
        """Whether a part must stay on the plate."""
        labels = [pick.label for pick in self._picks]
        return self._mode is not FeedMode.PURGE and part_class(name) in labels

    def _left_over(self, name: str, place: np.ndarray) -> tuple[int, int] | None:
        """Return the side over which a part with the last position `place` (2,) [m] left the plate.
        Return None if it did not leave the plate."""
        reach = self.rig.part_type(part_class(name)).reach_m
        away = self.rig.plate.half - np.abs(place)
        axis = int(np.argmin(away))
        sign = 1 if place[axis] > 0 else -1
        side = (sign, 0) if axis == 0 else (0, sign)
        near = NEAR_CHUTE if side == self._chute else NEAR_EDGE
        return side if away[axis] <= near * reach else None

    def _clearing(self, memory: FeedMemory, parts: Parts, near: np.ndarray) -> bool:
        """Whether the unwanted parts must move to the chute now, because there are many of them or
        because no other part can get ready."""
        # The order is to rest. In this case parts are not counted, because vision may detect the
        # robot as a part.
        if self._chute is None or self._mode is FeedMode.REST:
            return self._chute is not None and memory.clearing
        unwanted = sum(not self._is_wanted(name) for name in parts.ids)
        if self._mode is FeedMode.PURGE:
            return unwanted > 0
        spare = len(parts) - unwanted - int(np.sum(near))
        return unwanted > 0 and (memory.clearing or unwanted >= MANY_UNWANTED or spare == 0)

    def _request(
        self,
        memory: FeedMemory,
        parts: Parts,
        near: np.ndarray,
        gap: np.ndarray,
        clearing: bool,
    ) -> tuple[Targets | None, tuple[str, ...]]:
        """Return the targets of M parts, and the ids of the parts that must get ready.

        `near` (picks, M) states which parts are ready for each pick. `gap` (M,) is the free gap
        around each part [m]. The targets are None if enough parts are ready and no parts must move
        to the chute.
        """
        aims, chosen = Aims.none(parts, self.rig), []
        purging = self._mode is FeedMode.PURGE
        for row, pick in enumerate(() if purging else self._picks):
            mine = self._aim(aims, parts, pick, near[row])
            missing = pick.ready - int(np.sum(near[row]))
            if missing > 0:
                cost = aims.left + np.maximum(self._keep - gap, 0)
                cost -= CHANGE_M * np.array([name in memory.chosen for name in parts.ids], float)
                cost[~mine | near[row]] = np.inf
                best = np.argsort(cost)[:missing]
                best = best[np.isfinite(cost[best])]
                aims.full[best] = True
                chosen += [parts.ids[k] for k in best]
        if not chosen and not clearing:
            return None, ()
        unwanted = np.flatnonzero([not self._is_wanted(name) for name in parts.ids])
        if self._chute is not None and len(unwanted):
            self._aim_at_chute(aims, unwanted)
        return aims.targets(self._keep), tuple(chosen)

    @property
    def _keep(self) -> float:
        """Minimum gap between parts [m]."""
        return self.task.clearance_m + GAP_MARGIN_M

    def _aim(self, aims: Aims, parts: Parts, pick: Pick, near: np.ndarray) -> np.ndarray:
        """Set the window and the angle of a pick as targets for the parts of its class. `near` (M,)
        states which parts are ready. Return a mask (M,) of the parts of this class."""
        mine = np.array([part_class(name) == pick.label for name in parts.ids], dtype=bool)
        low, high = pick_window(pick, self.rig)
        low, high = behind_wall(low, high, pick.label, self.rig)
        margin = np.minimum(MARGIN_M, (high - low) / 2)
        aims.low[mine], aims.high[mine] = low + margin, high - margin
        aims.weight[mine] = STOCK
        aims.full |= near
        if pick.angle is not None:
            symmetry = self.rig.part_type(pick.label).symmetry
            aims.turn[mine] = to_turn(parts, pick.angle, symmetry)[mine]
            aims.slack[mine], aims.angled[mine] = BAND * pick.tolerance_rad, True
            aims.slack[near] = KEPT * pick.tolerance_rad
        return mine

    def _aim_at_chute(self, aims: Aims, unwanted: np.ndarray) -> None:
        """Set targets beyond the chute's edge for the unwanted parts (n,). The nearest part has the
        largest weight."""
        out, half = np.array(self._chute, float), self.rig.plate.half
        for axis in np.flatnonzero(out):
            ends = out[axis] * (half[axis] + np.array([BEYOND_M, FAR_M]))
            aims.low[unwanted, axis], aims.high[unwanted, axis] = ends.min(), ends.max()
        aims.leaving[unwanted] = True
        first = unwanted[np.argmin(aims.left[unwanted])]
        purging = self._mode is FeedMode.PURGE
        aims.weight[unwanted] = 1.0 if purging else STOCK
        aims.weight[first], aims.full[first] = PURGED if purging else 1.0, True


@dataclass
class Aims:
    """Targets of M parts. The rules fill them in step by step.

    Attributes
    ----------
    position : (M, 2)
        Positions of the parts [m, plate_home].
    low, high : (M, 2)
        Target intervals [m, plate_home].
    weight : (M,)
        Weight of the distance to the target, relative to the full weight [-].
    full : (M,) bool
        Whether the part has at least the full weight.
    angle, turn, slack : (M,)
        Angle of each part, requested rotation, and tolerance of the rotation [rad].
    angled : (M,) bool
        Whether an angle is requested.
    leaving : (M,) bool
        Whether the part must move to the chute.
    reach : (M,)
        Maximum distance of the part's edge from its centre [m].
    """

    position: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    full: np.ndarray
    angle: np.ndarray
    turn: np.ndarray
    slack: np.ndarray
    angled: np.ndarray
    leaving: np.ndarray
    reach: np.ndarray

    @classmethod
    def none(cls, parts: Parts, rig: Rig) -> Aims:
        """Return targets that only keep the parts on the plate."""
        at, count = parts.position, len(parts)
        anywhere = np.tile(rig.plate.half, (count, 1))
        reach = np.array([rig.part_type(part_class(name)).reach_m for name in parts.ids])
        zero, no = np.zeros(count), np.zeros(count, dtype=bool)
        return cls(
            at, -anywhere, anywhere, zero, no, parts.angle, zero.copy(), zero.copy(), no.copy(),
            no.copy(), reach,
        )  # fmt: skip

    @property
    def left(self) -> np.ndarray:
        """Distance of each part from its target (M,) [m], plus the arc length of its remaining
        rotation at its edge."""
        distance = np.hypot(*(self.position - np.clip(self.position, self.low, self.high)).T)
        return np.asarray(distance + self.reach * np.maximum(np.abs(self.turn) - self.slack, 0))

    def targets(self, gap_m: float) -> Targets:
        """Return the targets of the parts, with a minimum gap [m] between parts.

        Weights are computed separately for parts that leave and for all other parts. They scale the
        longest distance of a part with full weight to `FULL_DISTANCE_M`. If a part must get ready
        at an angle, its own distance is scaled to this value.
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
            goal = self.angle + self.turn
            angles = AngleTargets(
                goal - self.slack, goal + self.slack, counts * self.reach * turned
            )
        return Targets(self.low, self.high, weight[:, None] * np.ones(2), gap_m, angles)


def _is_among(parts: Parts, name: str, place: tuple[float, float]) -> bool:
    """Whether one of the parts has the class of `name` and is at the place (x, y). If so, it is the
    same part with a new id."""
    same = [part_class(each) == part_class(name) for each in parts.ids]
    away = np.hypot(*(parts.position - place).T)
    return bool(np.any(away[np.array(same, dtype=bool)] <= RENAMED_M))


def _join(one: Parts, other: Parts) -> Parts:
    """Return the parts of both groups."""
    return Parts.make(
        (*one.ids, *other.ids),
        np.vstack([one.position, other.position]),
        np.vstack([one.velocity, other.velocity]),
        np.append(one.angle, other.angle),
        np.append(one.spin, other.spin),
        np.append(one.friction_limit, other.friction_limit),
    )
