"""What the planner makes of the images: where the parts are, and where its answer finds them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts, PlateCycle, Rig

from .cycle_log import CycleClock, CycleLog
from .filter import StateEstimate, propagate
from .latency import LatencyHypotheses

COAST = 5
"""Images for which a part that is not seen is propagated: as long as vision keeps its name."""

FRESH = 1.5
"""A request is what the present cycle does if it is at most this many periods old."""

LATE = 0.01
"""A prediction is for images at most this fraction of its span from its stamp."""

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

    def predict(self, parts: Parts, t: float, period: float) -> np.ndarray:
        """Where parts (M, 2) [m] seen at t [s] are a cycle later, if they do as they were asked.

        Parts that were not asked go on drifting.
        """
        drift = parts.velocity.copy()
        if 0 <= t - self.stamp <= FRESH * period:
            row = rows_of(parts.ids, self.ids)
            drift[row >= 0] = self.drift[row[row >= 0]]
        return parts.position + period * drift


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
        if latency is not None and latency == self.latency and self._was_for(t):
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

    def _was_for(self, t: float) -> bool:
        return abs(t - self.stamp) <= LATE * self.span


@dataclass(frozen=True)
class Estimator:
    """The parts as last seen, and the plate's motion since.

    Attributes
    ----------
    friction_accel, mass : float
        mu g of the rig [m/s2], and of a part [kg].
    clock : CycleClock
    latency : LatencyHypotheses
        Estimates of the parts, by how old an image is at its stamp.
    log : CycleLog
    seen : Parts
        As vision saw them.
    request : LastRequest
        What parts are taken to do as long as the plate's motion is not known.
    bias : DriftBias
        What they do otherwise than predicted.
    """

    friction_accel: float
    mass: float
    clock: CycleClock
    latency: LatencyHypotheses
    log: CycleLog = field(default_factory=CycleLog)
    seen: Parts = NOBODY
    request: LastRequest = field(default_factory=LastRequest)
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
        return cls(rig.friction.accel, rig.parts.mass_kg, clock, hypotheses)

    def hear(self, cycle: PlateCycle, arrival: float) -> Estimator:
        """Take in a cycle that was sent to the plate, and when [s, the time of the stamps]."""
        return replace(self, log=self.log.hear(cycle, arrival))

    def update(self, parts: Parts, t: float) -> Estimator:
        """Take in one image: its parts and its stamp [s]."""
        log = self.log.advance(t)
        latency = self.latency.update(log, parts, t, self.friction_accel, COAST)
        return replace(self, clock=self.clock.tick(t), seen=parts, log=log, latency=latency)

    def ask(self, ids: tuple[str, ...], drift: np.ndarray, force: np.ndarray) -> Estimator:
        """Take in what is asked of the parts: drift (M, 2) [m/s] and force (M, 2) [N]."""
        return replace(self, request=LastRequest(ids, drift, self.stamp, force))

    @property
    def stamp(self) -> float:
        """Stamp of the last image [s]; minus infinity before the first."""
        return -np.inf if self.clock.stamp is None else self.clock.stamp

    @property
    def period(self) -> float:
        """Length of a cycle [s]: of the one that runs, or what the images' stamps tell."""
        return self.log.period if self.log.known else self.clock.period

    @property
    def next_start(self) -> float:
        """Stamp at which the answer to the last image begins to act [s]."""
        return self.log.end if self.log.known else self.stamp + self.clock.period

    @property
    def estimate(self) -> StateEstimate:
        """What is known of the parts."""
        return self.latency.estimate

    @property
    def parts(self) -> Parts:
        """The parts at the stamp; as they were seen, as long as the plate's motion is not known."""
        if not self.log.known:
            return self.seen
        place = self.estimate.predict(self.log, self.stamp, self.friction_accel)
        grip = self.mass * self.friction_accel * self.estimate.friction
        return Parts.make(self.estimate.ids, place, self.estimate.drift, friction_limit=grip)

    def predict(self, parts: Parts) -> np.ndarray:
        """Where parts will be (M, 2) [m] when the answer to the last image begins to act.

        As they were asked to, as long as the plate's motion is not known.
        """
        if not self.log.known:
            return self.as_asked(parts)
        state = self.estimate.mean[rows_of(parts.ids, self.estimate.ids)]
        end = propagate(self.log, state, self.estimate.time, self.log.end, self.friction_accel)
        return end[:, :2]

    def as_asked(self, parts: Parts) -> np.ndarray:
        """Where parts would be (M, 2) [m] then, if they did as they were asked."""
        return self.request.predict(parts, self.stamp, self.period)

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
        bias = self.bias.update(parts, seen, self.stamp, latency, axes, gain, most)
        return replace(self, bias=bias.predict(predicted, self.stamp, self.next_start, latency))

    @property
    def _known_latency(self) -> float | None:
        """Latency [s] that predictions rest on; None as long as it is being found out."""
        known = self.latency.found or not self.log.known
        return self.latency.latency if known else None


def warm_up(rig: Rig) -> None:
    """Compile the motion model before the first image comes."""
    part = Parts.make(("part_1",), np.zeros((1, 2)))
    estimator = Estimator.of(rig, 0.1, None).update(part, 0.0).hear(PlateCycle.rest(0.1), 0.0)
    estimator.update(part, 0.1).predict(part)
