"""Feed: have parts lie ready for a robot, alone and turned, while parts come and go.

As in `move`, each cycle is to leave as little as possible of the ways to targets. A few parts have
some: those that are ready stay so, those that are nearest to being ready get there, and those that
nobody wants go over the edge to the chute. All parts keep the gripper's clearance, so a heap comes
apart by itself. When enough are ready the plate rests: the robot may come.

Wanted parts are asked the same whether or not others leave meanwhile, and of these only the one
that is nearest to the chute counts as much. No wanted part is held back from the chute but by the
wall that keeps parts from every edge: else the crowd about it is, too, and nothing leaves.
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
from .targets import FULL_WAY_M, way_weight
from .task import Assessment, Situation, TaskRules

STILL_M = 1e-3
"""On a plate at rest a part that has moved further since the last image is not ready [m]."""

MARGIN_M, BAND = 4e-3, 0.3
"""How far inside the window parts are to come [m], and how near to their angle [tolerance]."""

KEPT = 0.8
"""How near to its angle a ready part is to stay [tolerance]."""

GAP_MARGIN_M = 2e-3
"""How much more than the gripper's clearance parts are to keep [m]."""

STOCK = 0.03
"""What a metre to the window, or to the chute, counts for parts that are not needed yet, beside
others [-]. Many that count more push those before them against the wall, and all stand."""

MANY_UNWANTED = 5
"""When so many parts lie there that nobody wants, all of them go to the chute, also while enough
others are ready."""

PURGED = 6.0
"""What a metre to the chute counts for the part that is nearest to it, in a purge [-]."""

NEAREST_M = 1e-3
"""Of parts that are to be ready at an angle each counts the more the nearer it is, down to this way
[m]: the next one is ready the sooner. Round ones only hinder each other so (by trial)."""

CHANGE_M = 0.02
"""A part that was on its way to being ready is given up for one that is nearer by this [m]."""

RENAMED_M = 0.02
"""A part of its class that appears so near to where one was is that one [m]."""

BEYOND_M, FAR_M = 0.01, 0.1
"""How far beyond the chute's edge parts are to come [m]: anywhere between."""

NEAR_EDGE, NEAR_CHUTE = 1.5, 4.0
"""A part that was seen last so near an edge, or the chute, and no more, has left over it [its
reach]."""


@dataclass(frozen=True)
class FeedReport:
    """What there is to tell of one image.

    Attributes
    ----------
    stamp : float
        Of the image [s].
    mode : FeedMode
        What is done.
    at_rest : bool
        Whether parts lie where the image shows them: the plate rests, and goes on resting.
    ready : Parts
        Those that may be gripped.
    seen : mapping of str to int
        Parts on the plate, by class.
    discharged, lost : int
        Parts that have left over the chute's edge, as they were to, and others that have left.
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
    """What is remembered from image to image.

    Attributes
    ----------
    rest_from : float
        The plate rests from this stamp on [s]; infinite while it moves.
    place : mapping of str to (x, y)
        Where parts were at the last image [m, plate_home]; of none that a robot may take.
    chosen : tuple of str
        Parts on their way to being ready.
    clearing : bool
        Whether parts that nobody wants are on their way to the chute.
    report : FeedReport
    """

    rest_from: float = np.inf
    place: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chosen: tuple[str, ...] = ()
    clearing: bool = False
    report: FeedReport = field(default_factory=FeedReport)


@dataclass(frozen=True)
class Feeder(TaskRules):
    """The rules of feeding for one task on one rig."""

    task: FeedTask
    rig: Rig

    @property
    def hold_s(self) -> float:
        """It is never done."""
        return np.inf

    @property
    def endless(self) -> bool:
        """It goes on until it is canceled."""
        return True

    @property
    def open_ended(self) -> bool:
        """Parts come and go."""
        return True

    def check(self, scenario: Scenario) -> None:
        """Any recipe that fits the rig will do."""

    def assess(self, memory: FeedMemory | None, now: Situation) -> tuple[FeedMemory, Assessment]:
        """Judge one image, and say what is wanted."""
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
        if now.kept:  # what the robot takes is not lost
            taken = memory.report.ready.ids
            place = {name: at for name, at in memory.place.items() if name not in taken}
        ready, asked = len(report.ready), sum(pick.ready for pick in self._picks)
        left = sum(report.seen.values())
        doing = f"{ready} of {asked} parts ready, {left} on the plate"
        if self._mode is FeedMode.PURGE:
            doing = f"{left} parts left to purge"
        elif self._mode is FeedMode.REST:
            doing += ", the plate rests for the robot"
        return FeedMemory(rest_from, place, chosen, clearing, report), Assessment(
            request=request,
            count=ready,
            distance=np.zeros(len(parts)),
            missing=(),
            doing=doing,
        )

    def keeps_last(self, memory: FeedMemory | None) -> bool:
        """While a robot hides parts, and none moves, what an image shows does not count."""
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
        """Tell what this image shows, and what has left the plate since the last one; the plate
        rests from a stamp on [s]."""
        seen, before = now.seen, memory.report
        hidden = [i for i, name in enumerate(now.parts.ids) if name not in seen.ids]
        every = _join(seen, now.parts.take(hidden))  # others may stand beside them
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
        """Whether a part is to stay on the plate."""
        labels = [pick.label for pick in self._picks]
        return self._mode is not FeedMode.PURGE and part_class(name) in labels

    def _left_over(self, name: str, place: np.ndarray) -> tuple[int, int] | None:
        """Over which side a part has left that was last seen (2,) there; None: it has not."""
        reach = self.rig.part_type(part_class(name)).reach_m
        away = self.rig.plate.half - np.abs(place)
        axis = int(np.argmin(away))
        sign = 1 if place[axis] > 0 else -1
        side = (sign, 0) if axis == 0 else (0, sign)
        near = NEAR_CHUTE if side == self._chute else NEAR_EDGE
        return side if away[axis] <= near * reach else None

    def _clearing(self, memory: FeedMemory, parts: Parts, near: np.ndarray) -> bool:
        """Whether parts (M,) that nobody wants are to go to the chute now: many of them, or nothing
        else can be done."""
        if self._chute is None or self._mode is FeedMode.REST:  # then a robot may look like one
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
        """Return what is wanted of parts (M,), which are ready (picks, M) or not, and those that
        are to become so; nothing if enough are, and nothing is to be cleared."""
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
        """Gap that parts are to keep [m]."""
        return self.task.clearance_m + GAP_MARGIN_M

    def _aim(self, aims: Aims, parts: Parts, pick: Pick, near: np.ndarray) -> np.ndarray:
        """Have parts of a class come to their window and angle, and those that are ready (M,) stay
        so; return which are of the class (M,)."""
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
        """Have parts (n,) that nobody wants go over the chute's edge, the one that is nearest
        first."""
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
    """Where M parts are to come, while that is being put together.

    Attributes
    ----------
    position : (M, 2)
        Where they are [m, plate_home].
    low, high : (M, 2)
        Where they are to come: anywhere between [m, plate_home].
    weight : (M,)
        What a metre counts, beside one of the ways that count in full [-].
    full : (M,) bool
        Whether their ways count in full at least.
    angle, turn, slack : (M,)
        Their angles, how far they are to turn, and how much less will do [rad].
    angled : (M,) bool
        Whether an angle is asked.
    leaving : (M,) bool
        Whether they are to go to the chute.
    reach : (M,)
        Greatest distance of their rims from their centres [m].
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
        """Ask nothing of parts but to stay on the plate."""
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
        """Ways (M,) that are left, and of turns what their rims have to go [m]."""
        way = np.hypot(*(self.position - np.clip(self.position, self.low, self.high)).T)
        return np.asarray(way + self.reach * np.maximum(np.abs(self.turn) - self.slack, 0))

    def targets(self, gap_m: float) -> Targets:
        """Return it as targets of parts that keep a gap [m]. Of those that are leaving, and of
        others, ways are measured by the longest that counts in full; of those that are to be ready
        at an angle by their own."""
        left = self.left
        counts, way = np.zeros(len(left)), np.column_stack([left, 0 * left])
        for who in (self.leaving, ~self.leaving):
            counts[who] = way_weight(way[self.full & who])
        needed = self.full & ~self.leaving & self.angled
        counts[needed] = FULL_WAY_M / np.maximum(left[needed], NEAREST_M)
        weight = counts * np.where(self.full, np.maximum(self.weight, 1.0), self.weight)
        angles, turned = None, self.angled & self.full
        if np.any(turned):
            goal = self.angle + self.turn
            angles = AngleTargets(
                goal - self.slack, goal + self.slack, counts * self.reach * turned
            )
        return Targets(self.low, self.high, weight[:, None] * np.ones(2), gap_m, angles)


def _is_among(parts: Parts, name: str, place: tuple[float, float]) -> bool:
    """Whether a part of the class of another lies where that was: the same under a new name."""
    same = [part_class(each) == part_class(name) for each in parts.ids]
    away = np.hypot(*(parts.position - place).T)
    return bool(np.any(away[np.array(same, dtype=bool)] <= RENAMED_M))


def _join(one: Parts, other: Parts) -> Parts:
    """Return both in one."""
    return Parts.make(
        (*one.ids, *other.ids),
        np.vstack([one.position, other.position]),
        np.vstack([one.velocity, other.velocity]),
        np.append(one.angle, other.angle),
        np.append(one.spin, other.spin),
        np.append(one.friction_limit, other.friction_limit),
    )
