"""Estimates the state of the parts from images and from the plate's motion.

The inputs are the detected parts and the stamp of each image, the cycles sent to the plate, the
reported cycle starts, and the requests to the solver. The outputs are the state of the parts at the
time `Estimator.stamp`, and their predicted state when the solver's next result begins. A result of
the solver is a cycle that it has computed. Kalman filters with a model of the stick-slip motion
track the parts (`filter.py`). Several hypotheses of the image latency are computed in parallel
(`latency.py`). `DriftBias` estimates the remaining prediction error.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts, PlateCycle, Rig, part_class
from plate_core.rig import row_delay

from .cycle_log import MEMORY_S, MIN_S, SNAP, CycleClock, CycleLog
from .filter import Coast, StateEstimate, propagate
from .frame_clock import FrameClock
from .latency import LatencyHypotheses

MISSED_IMAGES = Coast(parts=5, unknown=10)
"""Maximum numbers of consecutive images without a detection: `parts` for a part, `unknown` for an
object of the class `unknown`. Up to this number, the state of the object is propagated. After
`parts` images without a detection, the detector forgets the id of a part too. `unknown` is larger,
because unknown objects are often not detected although they are on the plate. If images are taken
at cycle starts, ten images last about `MEMORY_S`."""

MAX_REQUEST_AGE = 1.5
"""Maximum age of a request to the solver [periods of a cycle]. An older request does not describe
the running cycle. Mean drifts and mean spins are also measured over at most this time."""

SETTLE_S = 0.05
"""All parts are assumed to be at rest when the plate has been at rest for this time [s]."""

SAME_LATENCY_S = 2e-3
"""Two image latencies that differ by less than this value count as equal [s]. Parts drift by about
0.05 mm in this time."""

TRIGGER_TOLERANCE_S = 1e-3
"""Tolerance of image stamps [s]. If the stamp of an image differs from a reported cycle start by
less, the stamp counts as the time of the camera trigger. In this case, the image was taken at its
stamp."""

ERROR_GAIN = 0.3
"""Weight of the newest value in the mean prediction error [-]."""

LATE = 0.01
"""Maximum difference between `Estimator.stamp` and the time for which positions were predicted, as
a fraction of the prediction horizon (`DriftBias.span`). If the difference is larger, the parts are
not compared with the prediction."""

FEWER = 0.02
"""Maximum fraction by which the image rate may be below the cycle rate."""

ODD = 0.25
"""If the interval between two images deviates from a whole number of cycles by more than this
value, the interval counts as odd [cycles]."""

ODD_IMAGES = 20
"""Number of consecutive odd intervals after which the camera counts as not triggered at cycle
starts."""

FEW_UNANSWERED = 0.05
"""Maximum fraction of cycles without a new result of the solver that does not noticeably slow down
a task."""

NO_PARTS = Parts.make((), np.zeros((0, 2)))


def rows_of(ids: tuple[str, ...], among: tuple[str, ...]) -> np.ndarray:
    """Return the index (K,) that each id of `ids` has in `among`. The index is -1 for an id that
    `among` does not contain."""
    row = {name: i for i, name in enumerate(among)}
    return np.array([row.get(name, -1) for name in ids], dtype=int)


@dataclass(frozen=True)
class LastRequest:
    """The last request.

    Attributes
    ----------
    ids : tuple of M str
    drift : (M, 2)
        Requested drift of each part [m/s, plate_home].
    stamp : float
        Value of `Estimator.stamp` when the request was recorded [s].
    force : (M, 2)
        Mean forces that correspond to `drift` [N].
    """

    ids: tuple[str, ...] = ()
    drift: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    stamp: float = -np.inf
    force: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def drift_of(self, parts: Parts, t: float, period: float) -> np.ndarray:
        """Return the drift (M, 2) [m/s] that parts detected at the time t [s] have if they follow
        the request.

        For a part that the request does not contain, the result is the measured drift. If the
        request is older than `MAX_REQUEST_AGE` periods, this applies to all parts.
        """
        drift = parts.velocity.copy()
        if 0 <= t - self.stamp <= MAX_REQUEST_AGE * period:
            row = rows_of(parts.ids, self.ids)
            drift[row >= 0] = self.drift[row[row >= 0]]
        return drift


@dataclass(frozen=True)
class DriftBias:
    """Disturbance observer that estimates the drift error of each part. The drift error is the
    actual mean velocity of the part minus the predicted mean velocity.

    Weak motors, lower friction or errors of the solver's model cause similar errors in consecutive
    cycles. Let x be the position of a part, p the prediction of x that was made a time T before,
    and k the gain. The drift error b is updated by

        b += k ((x - p)/T - b).

    If a part follows a path, the components of its drift error along and across the path are nearly
    constant. Therefore, the drift error is stored in axes that the task chooses, such as these
    directions.

    Attributes
    ----------
    ids : tuple of str
    drift : (M, 2)
        Components of the drift error along the axes of each part [m/s].
    position : (M, 2)
        Predicted position of each part [m, plate_home].
    stamp : float
        Time for which the positions `position` were predicted [s]. NaN if there is no prediction.
    span : float
        Prediction horizon [s]. The horizon is `stamp` minus the time of the newest information in
        the prediction.
    latency : float or None
        Image latency that the prediction assumes [s]. None if unknown.
    """

    ids: tuple[str, ...] = ()
    drift: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    position: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
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
        max_error: np.ndarray,
    ) -> DriftBias:
        """Return the observer after a comparison of the parts with their prediction.

        Parameters
        ----------
        parts : Parts
            M parts at the time `Estimator.stamp`.
        seen : (M,) bool
            Whether the image shows each part. The drift errors of parts that it does not show are
            not updated.
        t : float
            Value of `Estimator.stamp` [s]. If the prediction is for another time, the drift error
            is not updated.
        latency : float or None
            Image latency that is assumed now [s]. If the latency is unknown or has changed, the
            drift error is not updated.
        axes : (M, 2, 2)
            Unit vectors of the axes of each part, in rows. The axes are valid for the middle of the
            cycle that has ended.
        gain : float
            Gain k in the equation above, 0 to 1 [-].
        max_error : (M,)
            Maximum drift error along each axis [m/s]. Larger values are clipped.
        """
        row = rows_of(parts.ids, self.ids)
        known = row >= 0
        drift, position = np.zeros((len(parts), 2)), parts.position.copy()
        drift[known], position[known] = self.drift[row[known]], self.position[row[known]]
        if self.applies(t, latency):
            new = np.einsum("pij,pj->pi", axes, parts.position - position) / self.span
            new = np.clip(new, -max_error[:, None], max_error[:, None])
            drift += gain * np.where((known & seen)[:, None], new - drift, 0.0)
        return DriftBias(parts.ids, drift, parts.position)

    def with_prediction(
        self, position: np.ndarray, t: float, stamp: float, latency: float | None
    ) -> DriftBias:
        """Return the observer with a new prediction. `position` (M, 2) [m] is predicted for the
        time `stamp` [s] with information up to the time t [s]."""
        return replace(self, position=position, stamp=stamp, span=stamp - t, latency=latency)

    def along(self, axes: np.ndarray) -> np.ndarray:
        """Return the drift errors (M, 2) [m/s] of the parts in the frame plate_home. `axes`
        contains the axes of each part."""
        return np.einsum("pi,pij->pj", self.drift, axes)

    def applies(self, t: float, latency: float | None) -> bool:
        """Whether the prediction is for the time t [s] and assumes the image latency `latency`
        [s]."""
        return self._has_same_latency(latency) and self._is_prediction_for(t)

    def error(self, parts: Parts) -> float:
        """Return the largest distance of a part from its predicted position [m]. The distance is 0
        for parts without a prediction."""
        row = rows_of(parts.ids, self.ids)
        distance = np.hypot(*(parts.position[row >= 0] - self.position[row[row >= 0]]).T)
        return float(np.max(distance, initial=0.0))

    def _has_same_latency(self, latency: float | None) -> bool:
        if latency is None or self.latency is None:
            return False
        return abs(latency - self.latency) < SAME_LATENCY_S

    def _is_prediction_for(self, t: float) -> bool:
        return abs(t - self.stamp) <= LATE * self.span


@dataclass(frozen=True)
class Turning:
    """Orientation and angular velocity of the parts, if images are not taken at cycle starts.

    Orientation and angular velocity are measured in the image closest to each cycle start, because
    the plate hardly moves at this time.

    Attributes
    ----------
    ids : tuple of str
    angle, spin : (M,)
        `angle` is the orientation in the last measured image [rad]. `spin` is the mean angular
        velocity since the measurement of the previous cycle [rad/s].
    time : float
        Time at which the last measured image was taken [s].
    start : float
        Cycle start closest to `time` [s].
    last : Turning or None
        Measurement of the previous cycle, whose attribute `last` is None. None before the first
        measurement.
    """

    ids: tuple[str, ...] = ()
    angle: np.ndarray = field(default_factory=lambda: np.zeros(0))
    spin: np.ndarray = field(default_factory=lambda: np.zeros(0))
    time: float = 0.0
    start: float = -np.inf
    last: Turning | None = None

    def update(self, log: CycleLog, parts: Parts, time: float) -> Turning:
        """Return the measurement after an image that was taken at the time `time` [s]."""
        starts = np.array([*(begin for begin, _ in log.runs), log.end])
        start = float(starts[np.argmin(np.abs(starts - time))])
        same = abs(start - self.start) < SNAP * log.period
        if same and abs(time - start) >= abs(self.time - self.start):
            return self
        last = self.last if same else replace(self, last=None)
        spin = np.zeros(len(parts))
        if last is not None and 0 < time - last.time < MAX_REQUEST_AGE * log.period:
            row = rows_of(parts.ids, last.ids)
            turned = parts.angle - np.append(last.angle, 0.0)[row]
            turned = (turned + np.pi) % (2 * np.pi) - np.pi
            spin = np.where(row >= 0, turned / max(time - last.time, MIN_S), 0.0)
        return Turning(parts.ids, parts.angle, spin, time, start, last)

    def of(self, ids: tuple[str, ...], t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the angles (K,) [rad] of parts at the time t [s], and the angular velocities (K,)
        [rad/s] of these parts.

        Angle and angular velocity are 0 for parts that were not measured.
        """
        row = rows_of(ids, self.ids)
        spin = np.append(self.spin, 0.0)[row]
        return np.append(self.angle, 0.0)[row] + spin * (t - self.time), spin


@dataclass(frozen=True)
class Estimator:
    """State of the estimation. The state includes the last detections, the filters, and the motion
    of the plate.

    Attributes
    ----------
    rig : Rig
    clock : CycleClock
    frames : FrameClock
        Estimate of the exposure times of a free-running camera.
    hypotheses : LatencyHypotheses
        State estimates of the parts for each hypothesis of the image latency.
    log : CycleLog
    seen : Parts
        Parts detected in the last image.
    request : LastRequest
        Last request to the solver. While the plate's motion is unknown, the parts are assumed to
        have the requested drift.
    odd : int
        Number of consecutive images whose interval to the previous image is not a whole number of
        cycles.
    turning : Turning
        Orientations of the parts, if images are not taken at cycle starts. If images are taken at
        cycle starts, `turning` contains no parts.
    before, before_stamp : Parts, float
        Parts at the last call of `observe`, and the value of `stamp` at that time [s].
    bias : DriftBias
        Estimated error of the predicted drift.
    prediction_error : float
        Moving average of the largest distance of a part from its predicted position, over the
        cycles in which the plate moved [m].
    """

    rig: Rig
    clock: CycleClock
    hypotheses: LatencyHypotheses
    frames: FrameClock = field(default_factory=FrameClock)
    log: CycleLog = field(default_factory=CycleLog)
    seen: Parts = NO_PARTS
    request: LastRequest = field(default_factory=LastRequest)
    odd: int = 0
    turning: Turning = field(default_factory=Turning)
    before: Parts = NO_PARTS
    before_stamp: float = -np.inf
    bias: DriftBias = field(default_factory=DriftBias)
    prediction_error: float = 0.0

    @classmethod
    def of(cls, rig: Rig, default_period: float, latency: float | None) -> Estimator:
        """Return the initial state.

        Parameters
        ----------
        rig : Rig
        default_period : float
            Length of a cycle [s] that is assumed until the length is known.
        latency : float or None
            Age of an image at its stamp [s]. If None, this age is estimated.
        """
        clock = CycleClock.starting(default_period)
        hypotheses = LatencyHypotheses.of(latency)
        return cls(rig, clock, hypotheses)

    @property
    def friction_accel(self) -> float:
        """Friction coefficient of the rig multiplied by gravity, mu g [m/s2]."""
        return self.rig.friction.accel

    def record_cycle(
        self, cycle: PlateCycle, arrival: float, requested: float | None = None
    ) -> Estimator:
        """Record a cycle sent to the plate, as in `CycleLog.record_cycle`."""
        return replace(self, log=self.log.record_cycle(cycle, arrival, requested))

    def started(self, cycle: PlateCycle, begin: float, triggered: bool = False) -> Estimator:
        """Record that the plate began a cycle at the time `begin` [s, in the time of the image
        stamps], as in `CycleLog.started`."""
        hypotheses = self.hypotheses
        if self.rig.camera.trigger is not None and not self.log.free_running:
            # The trigger determines the exposure times, so the latency is known.
            hypotheses = LatencyHypotheses.of(0.0)
        log = self.log.started(cycle, begin, triggered)
        return replace(self, log=log, hypotheses=hypotheses)

    def update(self, parts: Parts, t: float, coast: Coast = MISSED_IMAGES) -> Estimator:
        """Return the estimator after one image with the detected parts `parts` and the stamp t [s].

        The state of an undetected part is propagated for at most the number of images in `coast`.
        """
        log, hypotheses = self.log.advance(t), self.hypotheses
        if self.clock.went_back(t):
            forgotten = StateEstimate.nothing(len(hypotheses.latencies))
            hypotheses = replace(hypotheses, estimate=forgotten)
        if not log.free_running and abs(t - log.last_report) < TRIGGER_TOLERANCE_S:
            hypotheses = hypotheses.none_old(log, self.friction_accel)
        delay = np.zeros(len(parts))
        if self.rig.camera.readout_s > 0:
            delay = row_delay(self.rig, parts.position)
        clock, frames = self.clock.tick(t), self.frames.tick(t)
        # `stamped` is the corrected stamp of the image. The image was taken earlier, by the
        # latency.
        stamped, unsure = (frames.instant, frames.deviation) if log.free_running else (t, 0.0)
        camera = self.rig.camera
        if log.free_running and camera.trigger is not None:
            shown = camera.exposure_s + camera.readout_s
            stamped, unsure = log.triggered(t, camera.trigger.phase) + shown / 2, 0.0
        cycles = clock.interval / log.period if log.known else 1.0
        odd = self.odd + 1 if abs(cycles - max(round(cycles), 1)) > ODD else 0
        types = [self.rig.part_type(part_class(name)) for name in parts.ids]
        friction = np.array([part.mu for part in types], float) / self.rig.friction.mu
        hypotheses = hypotheses.update(
            log, parts, stamped, unsure, delay, self.friction_accel, coast, friction
        )
        turning = self.turning
        if log.free_running:
            turning = turning.update(log, parts, stamped - hypotheses.latency)
        return replace(
            self, clock=clock, frames=frames, seen=parts, log=log, hypotheses=hypotheses,
            odd=odd, turning=turning,
        )  # fmt: skip

    @property
    def image_rate(self) -> float:
        """Number of images per second. 0 until the frame interval is known."""
        return self.frames.rate

    @property
    def image_problem(self) -> str:
        """Text that describes a problem with the image rate. Empty if there is no problem."""
        if not self.log.known:
            return ""
        rate, cycles = self.image_rate, 1 / self.period
        if self.log.free_running and 0 < rate < (1 - FEWER) * cycles:
            allowed = f"{cycles:.3g} or more (one per cycle)"
            return f"image rate is {rate:.3g} per second, allowed: {allowed}"
        if not self.log.free_running and self.odd >= ODD_IMAGES:
            return (
                f"image rate is {rate:.3g} per second, but the plate makes {cycles:.3g} cycles per "
                "second: the camera is not triggered at the start of each cycle"
            )
        return ""

    @property
    def answer_problem(self) -> str:
        """Text that describes the delay of the solver's results. Empty if the results have no
        delay."""
        late = self.log.delay
        cycles = "a cycle" if late == 1 else f"{late} cycles"
        return (
            f"results start {cycles} late, because the computer or the serial line is too slow"
            if late
            else ""
        )

    def begin_task(self) -> Estimator:
        """Return the estimator for a new task: the counts of cycles and the drift error are
        reset."""
        log = replace(self.log, begun=0, unanswered_cycles=0)
        return replace(self, bias=DriftBias(), prediction_error=0.0, log=log)

    @property
    def unanswered_problem(self) -> str:
        """Text about the cycles without a new result of the solver since the task began. Empty if
        the fraction of such cycles is at most `FEW_UNANSWERED`."""
        log = self.log
        if log.unanswered_cycles <= FEW_UNANSWERED * log.begun:
            return ""
        lacking = "" if log.free_running else "images are missing, or "
        return (
            f"{log.unanswered_cycles} of {log.begun} cycles were not answered in time: "
            f"{lacking}the computer or the line is too slow"
        )

    def with_request(self, ids: tuple[str, ...], drift: np.ndarray, force: np.ndarray) -> Estimator:
        """Record a request to the solver: the drift (M, 2) [m/s] of each part, and the
        corresponding mean force (M, 2) [N]."""
        return replace(self, request=LastRequest(ids, drift, self.stamp, force))

    @property
    def stamp(self) -> float:
        """Time at which the state `parts` is valid [s].

        If images are not taken at cycle starts, this time is the start of the running cycle.
        Otherwise, this time is the stamp of the last image. The value is minus infinity before the
        first image.
        """
        if self.log.free_running:
            return self.log.begin
        return -np.inf if self.clock.stamp is None else self.clock.stamp

    @property
    def taken(self) -> float:
        """Time at which the last image was taken [s]. Minus infinity before the first image."""
        stamp = -np.inf if self.clock.stamp is None else self.clock.stamp
        return stamp - self.hypotheses.latency

    @property
    def at_rest(self) -> bool:
        """Whether parts and plate were at rest when the last image was taken."""
        return self.taken >= self._rest_start + SETTLE_S

    @property
    def _rest_start(self) -> float:
        """Time since which the plate has been at rest [s]. The time is derived from the log of
        cycles or, if the log is empty, from the last request."""
        if self.log.known:
            return self.log.resting_since
        # Without reports of cycle starts, a request is assumed to be executed in the cycle after
        # its image.
        requested = self.request.stamp
        return requested + 2 * self.period if requested <= self.stamp else -np.inf

    @property
    def resting_since(self) -> float:
        """Time since which the plate has been at rest [s], provided that the plate remains at rest
        until the next request.

        The result is infinite if the plate moves or may move. The plate may move if the start of
        the last image's cycle has not been reported, or if the cycle of the last request may still
        begin.
        """
        log, requested = self.log, self.request.stamp
        if not log.known:
            return self._rest_start
        shown = max(
            (begin for begin, _ in log.runs if begin < self.taken + TRIGGER_TOLERANCE_S),
            default=0.0,
        )
        reports = log.last_report > self.taken - MEMORY_S  # whether there is a recent report
        # `unanswered` is also false if the clock was set back, because the request then seems to be
        # in the future.
        unanswered = log.solved_start < requested < self.taken + MEMORY_S
        may_come = unanswered or log.may_move(log.last_report if reports else self.taken)
        return np.inf if may_come or (reports and log.last_report < shown) else log.resting_since

    @property
    def period(self) -> float:
        """Length of the last cycle that is not a tail [s]. If no cycle is known, the length is
        estimated from the image stamps."""
        return self.log.period if self.log.known else self.clock.period

    @property
    def next_start(self) -> float:
        """Time at which the solver's result for the last image begins [s]."""
        return self.log.until_result.end if self.log.known else self.stamp + self.clock.period

    @property
    def next_rest(self) -> float:
        """Time at which the plate comes to rest [s], if no motion is requested for the last
        image."""
        tail = self.log.until_result.runs[-1][1].tail if self.log.known else None
        return self.next_start + (tail.period if tail is not None else 0.0)

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the tracked parts."""
        return self.hypotheses.estimate.ids

    @property
    def mean(self) -> np.ndarray:
        """State of the parts (M, 5), with the components of `StateEstimate.mean`. Each state is
        valid at the time of the part's last detection."""
        return self.hypotheses.estimate.mean[self.hypotheses.best]

    @property
    def friction(self) -> np.ndarray:
        """Friction coefficient of each part (M,) divided by the friction coefficient in the rig
        file."""
        return np.exp(self.mean[:, 4])

    @property
    def parts(self) -> Parts:
        """State of the parts at the time `stamp`. Until the plate's motion is known, the state is
        that of the last detections."""
        if not self.log.known:
            return self.seen
        estimate, best = self.hypotheses.estimate, self.hypotheses.best
        position = estimate.at(best, self.log, self.stamp, self.friction_accel)[:, :2]
        types = [self.rig.part_type(part_class(name)) for name in estimate.ids]
        grip = self.friction_accel * self.friction * np.array([part.mass_kg for part in types])
        angle, spin = self._predict_angles(estimate.ids)
        return Parts.make(estimate.ids, position, self._estimate_drift(position), angle, spin, grip)

    def _predict_angles(self, ids: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the angles (K,) [rad] and the angular velocities (K,) [rad/s] of parts at the time
        `stamp`.

        Angle and angular velocity are 0 for parts without a measurement.
        """
        if self.log.free_running:
            return self.turning.of(ids, self.stamp)
        row = rows_of(ids, self.seen.ids)
        return np.append(self.seen.angle, 0.0)[row], np.append(self.seen.spin, 0.0)[row]

    def _estimate_drift(self, position: np.ndarray) -> np.ndarray:
        """Return the drift (M, 2) [m/s] of the parts. `position` (M, 2) [m] is their position at
        the time `stamp`.

        If images are not taken at cycle starts, the drift is the mean velocity since the last call
        of `observe`. Otherwise, it is the drift that the detector measured.
        """
        if not self.log.free_running:
            return self.hypotheses.estimate.drift
        row, span = rows_of(self.ids, self.before.ids), self.stamp - self.before_stamp
        usual = 0 < span < MAX_REQUEST_AGE * self.period
        displacement = position - np.vstack([self.before.position, np.zeros((1, 2))])[row]
        return np.where((row >= 0)[:, None] & usual, displacement / max(span, MIN_S), 0.0)

    def predict(self, parts: Parts) -> np.ndarray:
        """Return the predicted positions (M, 2) [m] of parts at the time `next_start`.

        Until the plate's motion is known, the parts are assumed to follow the last request.
        """
        start = self.start_of(parts)
        return self.by_request(parts) if start is None else start[:, :2]

    def start_of(self, parts: Parts) -> np.ndarray | None:
        """Return the predicted positions and velocities (M, 4) [m, m/s] of parts at the time
        `next_start`.

        The result is None until the plate's motion is known.
        """
        if not self.log.known:
            return None
        row = rows_of(parts.ids, self.ids)
        time = self.hypotheses.estimate.time[self.hypotheses.best][row]
        log = self.log.until_result
        return propagate(log, self.mean[row], time, log.end, self.friction_accel)[:, :4]

    @property
    def next_plate(self) -> np.ndarray | None:
        """Pose, twist and acceleration (3, 3) of the plate at the time `next_start`. None if they
        are uncertain."""
        return self.log.until_result.plate if self.log.certain else None

    def by_request(self, parts: Parts) -> np.ndarray:
        """Return the positions (M, 2) [m] that the parts have at the time `next_start` if they
        follow the last request."""
        drift = self.request.drift_of(parts, self.stamp, self.period)
        return parts.position + (self.next_start - self.stamp) * drift

    def observe(
        self,
        parts: Parts,
        predicted: np.ndarray,
        axes: np.ndarray,
        gain: float,
        max_error: np.ndarray,
    ) -> Estimator:
        """Update the estimated drift error with the parts at the time `stamp`. Then store
        `predicted` (M, 2) [m], which are the positions predicted for the time `next_start`. The
        other parameters are the same as in `DriftBias.update`."""
        seen, latency = rows_of(parts.ids, self.seen.ids) >= 0, self._assumed_latency
        mean_error = self.prediction_error
        moved = self.log.moves_between(self.stamp - self.bias.span, self.stamp)
        if moved and self.bias.applies(self.stamp, latency):
            error = self.bias.error(parts.take(np.flatnonzero(seen)))
            mean_error += ERROR_GAIN * (error - mean_error)
        # A prediction over a short time contains less information, so the gain is reduced.
        ahead = min(self.bias.span / self.period, 1.0)
        bias = self.bias.update(parts, seen, self.stamp, latency, axes, gain * ahead, max_error)
        bias = bias.with_prediction(predicted, self._newest_information, self.next_start, latency)
        return replace(
            self, bias=bias, prediction_error=mean_error, before=parts, before_stamp=self.stamp
        )

    @property
    def moves_before_answer(self) -> bool:
        """Whether the plate moves between the times `stamp` and `next_start`. In this case, the
        start of the solver's next result must be predicted by the model of the parts' motion."""
        log = self.log
        return log.known and log.until_result.moves_between(self.stamp, self.next_start)

    @property
    def _newest_information(self) -> float:
        """Time of the newest information in predictions [s]. The newest information is the last
        detection of a part, or the start of the running cycle if that is later."""
        if not self.log.free_running:
            return self.stamp
        return float(
            np.max(self.hypotheses.estimate.time[self.hypotheses.best], initial=self.log.begin)
        )

    @property
    def latency_known(self) -> bool:
        """Whether the image latency is known to within a few milliseconds."""
        return self.hypotheses.estimated

    @property
    def _assumed_latency(self) -> float | None:
        """Image latency that predictions assume [s]. None while the latency is being estimated."""
        known = self.latency_known or not self.log.known
        return self.hypotheses.latency if known else None


def warm_up(rig: Rig) -> None:
    """Track a fictitious part for one step. All code is thus loaded before the first image
    arrives."""
    part = Parts.make(("part_1",), np.zeros((1, 2)))
    estimator = (
        Estimator.of(rig, 0.1, None).update(part, 0.0).record_cycle(PlateCycle.rest(0.1), 0.0)
    )
    estimator.update(part, 0.1).predict(part)
