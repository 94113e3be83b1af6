"""What the planner makes of the images: where the parts are, and where its answer finds them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts, PlateCycle, Rig, part_class
from plate_core.rig import row_delay

from .cycle_log import MEMORY_S, SHORTEST_S, SNAP, CycleClock, CycleLog
from .filter import Coast, StateEstimate, propagate
from .frame_clock import FrameClock
from .latency import LatencyHypotheses

COAST = Coast(parts=5, unknown=10)
"""Images for which what is not seen is propagated. A part: as long as vision keeps its name. A
thing that may be a part is often not seen, and is still there meanwhile: as long as `MEMORY_S`, if
images are taken at the starts of cycles."""

FRESH = 1.5
"""A request is what the present cycle does if it is at most this many periods old."""

SETTLE_S = 0.05
"""Parts lie still so long after the plate has come to rest [s]."""

SAME_LATENCY_S = 2e-3
"""Latencies that differ by less are the same to a prediction [s]: parts drift some 0.05 mm."""

STARTS_S = 1e-3
"""An image whose stamp is so near to a reported start of a cycle was stamped by what triggers the
camera: then it was taken [s]."""

LATE = 0.01
"""A prediction is for images at most this fraction of its span from its stamp."""

FEWER = 0.02
"""By this fraction a rate of images may seem less than that of the cycles, and be the same."""

ODD, ODD_IMAGES = 0.25, 20
"""So many images in a row that are this fraction of a cycle off a whole number of cycles apart are
not of a camera that is triggered at the starts of cycles."""

FEW_UNANSWERED = 0.05
"""By so many cycles without an answer a task hardly takes longer [share]."""

NOBODY = Parts.make((), np.zeros((0, 2)))


def rows_of(ids: tuple[str, ...], among: tuple[str, ...]) -> np.ndarray:
    """Return where each id is among others (K,) int; -1 where it is not."""
    row = {name: i for i, name in enumerate(among)}
    return np.array([row.get(name, -1) for name in ids], dtype=int)


@dataclass(frozen=True)
class LastRequest:
    """What drift (M, 2) [m/s, plate_home] was asked of which part, and when.

    `force` (M, 2) [N] is what it took.
    """

    ids: tuple[str, ...] = ()
    drift: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    stamp: float = -np.inf
    force: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def drift_of(self, parts: Parts, t: float, period: float) -> np.ndarray:
        """Drift (M, 2) [m/s] of parts seen at t [s], if they do as they were asked.

        Parts that were not asked go on drifting.
        """
        drift = parts.velocity.copy()
        if 0 <= t - self.stamp <= FRESH * period:
            row = rows_of(parts.ids, self.ids)
            drift[row >= 0] = self.drift[row[row >= 0]]
        return drift


@dataclass(frozen=True)
class DriftBias:
    """A disturbance observer: what parts do otherwise than was predicted, cycle after cycle.

    Motors that give less than they should, a surface that is more slippery than assumed, a solver's
    model that is not quite true: what one cycle does differently the next one will do too, nearly.
    On a path it is the same along and across it, so it is kept in axes that the task chooses.

    Attributes
    ----------
    ids : tuple of str
    drift : (M, 2)
        Beyond what was predicted, along each part's axes [m/s].
    place : (M, 2)
        Where each part will be by the last prediction [m, plate_home].
    stamp : float
        When [s]; NaN: there is no prediction.
    span : float
        How far ahead that was [s].
    latency : float or None
        Of the images, as it was taken to be [s]; None: it was not known.
    """

    ids: tuple[str, ...] = ()
    drift: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    place: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    stamp: float = np.nan
    span: float = np.nan
    latency: float | None = None

    def update(
        self,
        parts: Parts,
        seen: np.ndarray,
        t: float,
        latency: float | None,
        axes: np.ndarray,
        gain: float,
        most: np.ndarray,
    ) -> DriftBias:
        """Compare the parts with what was predicted of them.

        Parameters
        ----------
        parts : Parts
            M parts at an image's stamp.
        seen : (M,) bool
            Whether the image shows them; nothing is learnt of others.
        t : float
            The stamp [s]; nothing is learnt if nothing was predicted for it.
        latency : float or None
            As it is taken to be now [s]; nothing is learnt if it has changed, or is not known.
        axes : (M, 2, 2)
            Unit vectors in rows, at the middle of the cycle that has ended.
        gain : float
            Fraction of what is new that counts [-].
        most : (M,)
            Greatest drift to be believed, along each axis [m/s].
        """
        row = rows_of(parts.ids, self.ids)
        known = row >= 0
        drift, place = np.zeros((len(parts), 2)), parts.position.copy()
        drift[known], place[known] = self.drift[row[known]], self.place[row[known]]
        if self._had(latency) and self._was_for(t):
            new = np.einsum("pij,pj->pi", axes, parts.position - place) / self.span
            new = np.clip(new, -most[:, None], most[:, None])
            drift += gain * np.where((known & seen)[:, None], new - drift, 0.0)
        return DriftBias(parts.ids, drift, parts.position)

    def predict(self, place: np.ndarray, t: float, at: float, latency: float | None) -> DriftBias:
        """Return it with where the parts will be (M, 2) [m] `at` a stamp, as predicted at t [s]."""
        return replace(self, place=place, stamp=at, span=at - t, latency=latency)

    def along(self, axes: np.ndarray) -> np.ndarray:
        """Return the drift (M, 2) [m/s, plate_home] for parts with these axes."""
        return np.einsum("pi,pij->pj", self.drift, axes)

    def _had(self, latency: float | None) -> bool:
        if latency is None or self.latency is None:
            return False
        return abs(latency - self.latency) < SAME_LATENCY_S

    def _was_for(self, t: float) -> bool:
        return abs(t - self.stamp) <= LATE * self.span


@dataclass(frozen=True)
class Turning:
    """How parts are turned, by a camera that runs free: from the image nearest to each cycle's
    start, when the plate hardly moves.

    Attributes
    ----------
    ids : tuple of str
    angle, spin : (M,)
        Orientation [rad] then, and turning since the image of a cycle before [rad/s].
    time : float
        When that image was taken [s].
    start : float
        The start of a cycle that it is nearest to [s].
    last : Turning or None
        The same of the cycle before.
    """

    ids: tuple[str, ...] = ()
    angle: np.ndarray = field(default_factory=lambda: np.zeros(0))
    spin: np.ndarray = field(default_factory=lambda: np.zeros(0))
    time: float = 0.0
    start: float = -np.inf
    last: Turning | None = None

    def update(self, log: CycleLog, parts: Parts, time: float) -> Turning:
        """Take in an image that was taken at a time [s]."""
        starts = np.array([*(begin for begin, _ in log.runs), log.end])
        start = float(starts[np.argmin(np.abs(starts - time))])
        same = abs(start - self.start) < SNAP * log.period
        if same and abs(time - start) >= abs(self.time - self.start):
            return self
        last = self.last if same else replace(self, last=None)
        spin = np.zeros(len(parts))
        if last is not None and 0 < time - last.time < FRESH * log.period:
            row = rows_of(parts.ids, last.ids)
            turned = parts.angle - np.append(last.angle, 0.0)[row]
            turned = (turned + np.pi) % (2 * np.pi) - np.pi
            spin = np.where(row >= 0, turned / max(time - last.time, SHORTEST_S), 0.0)
        return Turning(parts.ids, parts.angle, spin, time, start, last)

    def of(self, ids: tuple[str, ...], t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return angle (K,) [rad] at a time [s], and spin (K,) [rad/s], of parts; 0 of others."""
        row = rows_of(ids, self.ids)
        spin = np.append(self.spin, 0.0)[row]
        return np.append(self.angle, 0.0)[row] + spin * (t - self.time), spin


@dataclass(frozen=True)
class Estimator:
    """The parts as last seen, and the plate's motion since.

    Attributes
    ----------
    rig : Rig
    clock : CycleClock
    frames : FrameClock
        When images were taken, by a camera that runs free.
    latency : LatencyHypotheses
        Estimates of the parts, by how old an image is at its stamp.
    log : CycleLog
    seen : Parts
        As vision saw them.
    request : LastRequest
        What parts are taken to do as long as the plate's motion is not known.
    odd : int
        Images in a row that did not come a whole number of cycles after the one before.
    turning : Turning
        How parts are turned, if starts of cycles are reported.
    before, before_stamp : Parts, float
        The parts as they were said at the last answer, and when that was [s].
    bias : DriftBias
        What they do otherwise than predicted.
    """

    rig: Rig
    clock: CycleClock
    latency: LatencyHypotheses
    frames: FrameClock = field(default_factory=FrameClock)
    log: CycleLog = field(default_factory=CycleLog)
    seen: Parts = NOBODY
    request: LastRequest = field(default_factory=LastRequest)
    odd: int = 0
    turning: Turning = field(default_factory=Turning)
    before: Parts = NOBODY
    before_stamp: float = -np.inf
    bias: DriftBias = field(default_factory=DriftBias)

    @classmethod
    def of(cls, rig: Rig, default_period: float, latency: float | None) -> Estimator:
        """Return what is known at the start.

        Parameters
        ----------
        rig : Rig
        default_period : float
            Length of a cycle until it is known [s].
        latency : float or None
            How old an image is at its stamp [s]; None: found out.
        """
        clock = CycleClock.starting(default_period)
        hypotheses = LatencyHypotheses.of(latency)
        return cls(rig, clock, hypotheses)

    @property
    def friction_accel(self) -> float:
        """mu g of the rig [m/s2]."""
        return self.rig.friction.accel

    def hear(self, cycle: PlateCycle, arrival: float, asked: float | None = None) -> Estimator:
        """Take in a cycle that was sent to the plate; as in `CycleLog.hear`."""
        return replace(self, log=self.log.hear(cycle, arrival, asked))

    def started(self, cycle: PlateCycle, begin: float, triggered: bool = False) -> Estimator:
        """Take in that the plate began a cycle at `begin` [s, the time of the stamps]; as in
        `CycleLog.started`."""
        latency = self.latency
        if self.rig.camera.trigger is not None and not self.log.reported:
            latency = LatencyHypotheses.of(0.0)  # from now on it is known when images are taken
        return replace(self, log=self.log.started(cycle, begin, triggered), latency=latency)

    def update(self, parts: Parts, t: float, coast: Coast = COAST) -> Estimator:
        """Take in one image: its parts and its stamp [s]; parts that are not seen are propagated
        for `coast` images."""
        log, hypotheses = self.log.advance(t), self.latency
        if self.clock.went_back(t):
            forgotten = StateEstimate.nothing(len(hypotheses.latencies))
            hypotheses = replace(hypotheses, estimate=forgotten)
        if not log.reported and abs(t - log.told) < STARTS_S:
            hypotheses = hypotheses.none_old(log, self.friction_accel)
        delay = np.zeros(len(parts))
        if self.rig.camera.readout_s > 0:
            delay = row_delay(self.rig, parts.position)
        clock, frames = self.clock.tick(t), self.frames.tick(t)
        taken, unsure = (frames.instant, frames.deviation) if log.reported else (t, 0.0)
        camera = self.rig.camera
        if log.reported and camera.trigger is not None:
            shown = camera.exposure_s + camera.readout_s
            taken, unsure = log.triggered(t, camera.trigger.phase) + shown / 2, 0.0
        cycles = clock.interval / log.period if log.known else 1.0
        odd = self.odd + 1 if abs(cycles - max(round(cycles), 1)) > ODD else 0
        types = [self.rig.part_type(part_class(name)) for name in parts.ids]
        friction = np.array([part.mu for part in types], float) / self.rig.friction.mu
        latency = hypotheses.update(
            log, parts, taken, unsure, delay, self.friction_accel, coast, friction
        )
        turning = self.turning
        if log.reported:
            turning = turning.update(log, parts, taken - latency.latency)
        return replace(
            self, clock=clock, frames=frames, seen=parts, log=log, latency=latency, odd=odd,
            turning=turning,
        )  # fmt: skip

    @property
    def image_rate(self) -> float:
        """Images a second; 0 until it is known."""
        return self.frames.rate

    @property
    def image_problem(self) -> str:
        """What is wrong with when images come; empty if nothing is."""
        if not self.log.known:
            return ""
        rate, cycles = self.image_rate, 1 / self.period
        if self.log.reported and 0 < rate < (1 - FEWER) * cycles:
            return f"{rate:.3g} images a second, allowed: {cycles:.3g} or more, one in each cycle"
        if not self.log.reported and self.odd >= ODD_IMAGES:
            return (
                f"{rate:.3g} images a second and {cycles:.3g} cycles: the camera is not triggered "
                "at the start of each cycle"
            )
        return ""

    @property
    def answer_problem(self) -> str:
        """What is wrong with when answers begin; empty if nothing is."""
        late = self.log.delay
        cycles = "a cycle" if late == 1 else f"{late} cycles"
        return f"answers begin {cycles} late: the computer or the line is too slow" if late else ""

    def begin_task(self) -> Estimator:
        """Count cycles anew, and forget what parts did otherwise than predicted."""
        log = replace(self.log, begun=0, unanswered=0)
        return replace(self, bias=DriftBias(), log=log)

    @property
    def unanswered(self) -> str:
        """How many cycles no answer began since the task did; empty if they were few."""
        log = self.log
        if log.unanswered <= FEW_UNANSWERED * log.begun:
            return ""
        lacking = "" if log.reported else "images are missing, or "
        return (
            f"{log.unanswered} of {log.begun} cycles had no answer in time: {lacking}the computer "
            "or the line is too slow"
        )

    def ask(self, ids: tuple[str, ...], drift: np.ndarray, force: np.ndarray) -> Estimator:
        """Take in what is asked of the parts: drift (M, 2) [m/s] and force (M, 2) [N]."""
        return replace(self, request=LastRequest(ids, drift, self.stamp, force))

    @property
    def stamp(self) -> float:
        """When the parts are as said [s]: the start of the running cycle, which is the stamp of the
        last image where starts are not reported; minus infinity before the first."""
        if self.log.reported:
            return self.log.begin
        return -np.inf if self.clock.stamp is None else self.clock.stamp

    @property
    def taken(self) -> float:
        """When the last image was taken [s]; minus infinity before the first."""
        stamp = -np.inf if self.clock.stamp is None else self.clock.stamp
        return stamp - self.latency.latency

    @property
    def at_rest(self) -> bool:
        """Whether parts and plate lay still when the last image was taken, as far as is known."""
        return self.taken >= self._known_rest + SETTLE_S

    @property
    def _known_rest(self) -> float:
        """Since when the plate has been at rest by what was reported, sent or asked [s]."""
        if self.log.known:
            return self.log.resting_since
        asked = self.request.stamp  # what was asked last is done in the cycle after the image
        return asked + 2 * self.period if asked <= self.stamp else -np.inf

    @property
    def resting_since(self) -> float:
        """Since when the plate has been at rest, to stay so until motion is asked for again [s];
        infinite while it moves, and where it may: as long as the cycle of the last image is not
        reported, and what was asked for last may begin and is not known to have."""
        log, asked = self.log, self.request.stamp
        if not log.known:
            return self._known_rest
        shown = max((begin for begin, _ in log.runs if begin < self.taken + STARTS_S), default=0.0)
        reports = log.told > self.taken - MEMORY_S  # else nobody has reported for long
        unanswered = log.answered < asked < self.taken + MEMORY_S  # else the clock was put back
        may_come = unanswered or log.may_move(log.told if reports else self.taken)
        return np.inf if may_come or (reports and log.told < shown) else log.resting_since

    @property
    def period(self) -> float:
        """Length of a cycle that is no tail [s]: of the last one, or what the stamps tell."""
        return self.log.period if self.log.known else self.clock.period

    @property
    def next_start(self) -> float:
        """Stamp at which the answer to the last image begins to act [s]."""
        return self.log.until_answer.end if self.log.known else self.stamp + self.clock.period

    @property
    def next_rest(self) -> float:
        """Stamp from which the plate rests if that answer asks for nothing [s]."""
        tail = self.log.until_answer.runs[-1][1].tail if self.log.known else None
        return self.next_start + (tail.period if tail is not None else 0.0)

    @property
    def ids(self) -> tuple[str, ...]:
        """The parts that are known."""
        return self.latency.estimate.ids

    @property
    def mean(self) -> np.ndarray:
        """State of the parts (M, 5) as `StateEstimate.mean`, when each was seen last."""
        return self.latency.estimate.mean[self.latency.best]

    @property
    def friction(self) -> np.ndarray:
        """Friction of each part (M,) over the rig's."""
        return np.exp(self.mean[:, 4])

    @property
    def parts(self) -> Parts:
        """The parts at the stamp; as they were seen, as long as the plate's motion is not known."""
        if not self.log.known:
            return self.seen
        estimate, best = self.latency.estimate, self.latency.best
        place = estimate.at(best, self.log, self.stamp, self.friction_accel)[:, :2]
        types = [self.rig.part_type(part_class(name)) for name in estimate.ids]
        grip = self.friction_accel * self.friction * np.array([part.mass_kg for part in types])
        angle, spin = self._angles(estimate.ids)
        return Parts.make(estimate.ids, place, self._drift(place), angle, spin, grip)

    def _angles(self, ids: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Angles (K,) [rad] at the stamp and turning (K,) [rad/s] of parts; 0 of those that the
        last image does not show."""
        if self.log.reported:
            return self.turning.of(ids, self.stamp)
        row = rows_of(ids, self.seen.ids)
        return np.append(self.seen.angle, 0.0)[row], np.append(self.seen.spin, 0.0)[row]

    def _drift(self, place: np.ndarray) -> np.ndarray:
        """Drift (M, 2) [m/s] of the parts that are at `place` (M, 2) [m] at the stamp: since the
        cycle before began, or as seen where images are taken at the starts of cycles."""
        if not self.log.reported:
            return self.latency.estimate.drift
        row, span = rows_of(self.ids, self.before.ids), self.stamp - self.before_stamp
        usual = 0 < span < FRESH * self.period
        gone = place - np.vstack([self.before.position, np.zeros((1, 2))])[row]
        return np.where((row >= 0)[:, None] & usual, gone / max(span, SHORTEST_S), 0.0)

    def predict(self, parts: Parts) -> np.ndarray:
        """Where parts will be (M, 2) [m] when the answer to the last image begins to act.

        As they were asked to, as long as the plate's motion is not known.
        """
        start = self.start_of(parts)
        return self.as_asked(parts) if start is None else start[:, :2]

    def start_of(self, parts: Parts) -> np.ndarray | None:
        """Where parts will be then, and their velocity (M, 4) [m, m/s]; None as long as the plate's
        motion is not known."""
        if not self.log.known:
            return None
        row = rows_of(parts.ids, self.ids)
        time = self.latency.estimate.time[self.latency.best][row]
        log = self.log.until_answer
        return propagate(log, self.mean[row], time, log.end, self.friction_accel)[:, :4]

    @property
    def next_plate(self) -> np.ndarray | None:
        """Pose, twist and acceleration (3, 3) of the plate then; None where it is not certain."""
        return self.log.until_answer.plate if self.log.certain else None

    def as_asked(self, parts: Parts) -> np.ndarray:
        """Where parts would be (M, 2) [m] then, if they did as they were asked."""
        drift = self.request.drift_of(parts, self.stamp, self.period)
        return parts.position + (self.next_start - self.stamp) * drift

    def observe(
        self,
        parts: Parts,
        predicted: np.ndarray,
        axes: np.ndarray,
        gain: float,
        most: np.ndarray,
    ) -> Estimator:
        """Learn from parts at the stamp, and from where they are `predicted` to be (M, 2) [m] at
        `next_start` the next time; the rest as in `DriftBias.update`."""
        seen, latency = rows_of(parts.ids, self.seen.ids) >= 0, self._known_latency
        # What was predicted a short while ahead tells less.
        ahead = min(self.bias.span / self.period, 1.0)
        bias = self.bias.update(parts, seen, self.stamp, latency, axes, gain * ahead, most)
        bias = bias.predict(predicted, self._known_until, self.next_start, latency)
        return replace(self, bias=bias, before=parts, before_stamp=self.stamp)

    @property
    def _known_until(self) -> float:
        """When parts were seen that predictions rest on [s]."""
        if not self.log.reported:
            return self.stamp
        return float(np.max(self.latency.estimate.time[self.latency.best], initial=self.log.begin))

    @property
    def latency_known(self) -> bool:
        """Whether it is known how old images are, but for a few milliseconds."""
        return self.latency.found

    @property
    def _known_latency(self) -> float | None:
        """Latency [s] that predictions rest on; None as long as it is being found out."""
        known = self.latency_known or not self.log.known
        return self.latency.latency if known else None


def warm_up(rig: Rig) -> None:
    """Follow a part once: what the first step loads is there when the first image comes."""
    part = Parts.make(("part_1",), np.zeros((1, 2)))
    estimator = Estimator.of(rig, 0.1, None).update(part, 0.0).hear(PlateCycle.rest(0.1), 0.0)
    estimator.update(part, 0.1).predict(part)
