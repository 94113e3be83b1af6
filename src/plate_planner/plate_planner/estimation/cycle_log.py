"""Record of the plate cycles that were executed, with their start times, and of the cycle period.

The driver reports the start of each cycle. If no reports arrive, images are assumed to be triggered
at cycle starts. In this case, the stamps of the images are the start times, and the cycles that
were sent to the plate determine which cycle began.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median_low

import numpy as np

from plate_core import PlateCycle, PlateError
from plate_core.motion import in_time, next_cycle
from plate_core.status import MAX_AGE_S

SNAP = 0.25
"""Tolerance of the comparison of a time with the start or the end of a cycle, as a fraction of the
cycle's length. The time can be a stamp, a reported start, or the image time of a request."""

MEMORY_S = 1.5
"""Time for which the log keeps executed cycles [s]. The value is longer than the maximum image
latency and the longest usual cycle."""

MIN_S = 0.005
"""Minimum length of a cycle or tail that the log accepts [s]."""

MAX_S = 10.0
"""Maximum length of a cycle or tail that the log accepts [s]."""

PERIOD_RANGE_S = (0.005, 1.0)
"""Range of cycle periods that the log accepts [s]. The range applies to the intervals between image
stamps and to the periods that the driver reports. The default periods of the solver are 0.1 to 0.4
s."""

SAME_TIME_S = 3.0
"""Maximum difference between the stamp of the last image and the stamp of a reported cycle start
[s]. The value is larger than the longest permitted interruption of images."""

INTERVALS_KEPT = 3
"""Number of intervals between image stamps from which the period is computed. The period is their
median, so that one lost image does not affect it."""

DELAYS_KEPT = 7
"""Number of the solver's last results whose delays are stored. Predictions use the median of these
delays, so a single late result has no effect on them. Controller gains use the maximum of these
delays."""

LATEST = 3
"""Maximum delay of the solver's result that predictions assume [cycles]."""

SAME_POSE = 1e-9
"""Tolerance of the comparison of two poses of the plate [m, rad]. The tolerance is necessary
because the travel of the motors is rounded."""


@dataclass(frozen=True)
class Sent:
    """A cycle that was sent to the plate.

    Attributes
    ----------
    arrival : float
        Time at which the cycle was sent [s, in the time of the image stamps].
    cycle : PlateCycle
    requested : float
        Start time of the cycle during which the image for this cycle's request was taken [s].
    """

    arrival: float
    cycle: PlateCycle
    requested: float


@dataclass(frozen=True)
class CycleLog:
    """Record of the cycles that the plate has executed or is expected to execute, oldest first.

    When the driver reports the start of a cycle, the report replaces the cycle that was expected to
    start at about this time. The solver's result is the cycle that the solver has computed for a
    request.

    Attributes
    ----------
    runs : tuple of (begin [s], PlateCycle)
        Executed cycles with their start times. An executed cycle is called a run. Each run ends
        when the next run begins. The plate is at rest before the first run.
    sent : tuple of Sent
        Cycles that were sent to the plate and whose start has not been reported, oldest first. If
        the driver reports no starts, only the newest sent cycle is stored.
    free_running : bool
        Whether images are not taken at cycle starts (free-running camera, or trigger at a phase of
        the cycle). In this case, only the driver's reports determine the cycle starts. Otherwise,
        stamps of images determine them too.
    last_report : float
        Start time of the last reported cycle [s]. Minus infinity if no cycle was reported.
    delays : tuple of int
        Delays of the solver's last results [cycles]. A result has the delay 0 if it begins at the
        end of the cycle at whose start the image for its request was taken.
    solved_start : float
        Value of `Sent.requested` for the last sent cycle [s]. Minus infinity if no cycle was sent.
    awaited : Sent or None
        Last sent cycle that moves the plate. None after this cycle has begun.
    begun, unanswered_cycles : int
        `begun` is the number of reported cycles. `unanswered_cycles` is the number of reported
        cycles that moved the plate without a new result of the solver. Such cycles are repeated
        cycles and tails.
    """

    runs: tuple[tuple[float, PlateCycle], ...] = ()
    sent: tuple[Sent, ...] = ()
    free_running: bool = False
    delays: tuple[int, ...] = ()
    last_report: float = -math.inf
    solved_start: float = -math.inf
    awaited: Sent | None = None
    begun: int = 0
    unanswered_cycles: int = 0

    @property
    def known(self) -> bool:
        """Whether the plate has executed any cycle."""
        return bool(self.runs)

    @property
    def begin(self) -> float:
        """Start time of the last run [s]."""
        return self.runs[-1][0]

    @property
    def end(self) -> float:
        """End time of the last run [s]."""
        begin, cycle = self.runs[-1]
        return begin + cycle.period

    @property
    def period(self) -> float:
        """Length of the last run that is not a tail [s]."""
        cycles = [cycle for _, cycle in reversed(self.runs)]
        return next((cycle for cycle in cycles if not _is_tail(cycle)), cycles[0]).period

    @property
    def certain(self) -> bool:
        """Whether the state of the plate is known for the time at which the solver's next result
        begins.

        The state is known only if the last run or the run before it was reported, because the log
        is uncertain without recent reports. In addition, `delay` must be 0, because the start of a
        delayed result depends on an earlier result that has not begun.
        """
        return self.known and self.last_report >= self.runs[-2:][0][0] and not self.delay

    @property
    def plate(self) -> np.ndarray:
        """Pose, twist and acceleration (3, 3) of the plate at the end of the last run."""
        return self.runs[-1][1].state(-1)

    @property
    def resting_since(self) -> float:
        """Time since which the plate has been at rest [s]. Infinite while the plate moves."""
        since = math.inf
        for begin, cycle in reversed(self.runs):
            if cycle.moves:
                break
            since = begin
        return since

    @property
    def delay(self) -> int:
        """Median delay of the solver's last results [cycles], at most `LATEST`. The delay is above
        0 if the computer or the connection is too slow."""
        return min(median_low(self.delays), LATEST) if self.delays else 0

    @property
    def max_delay(self) -> int:
        """Maximum delay of the solver's last results [cycles], at most `LATEST`. A controller that
        is stable with this delay remains stable if the delays vary."""
        return min(max(self.delays, default=0), LATEST)

    @property
    def until_result(self) -> CycleLog:
        """Predicted log at the time when the solver's result for the running cycle begins. Results
        that were sent earlier begin before this result."""
        log, before = self, [sent.cycle for sent in self.sent][::-1]
        for k in reversed(range(self.delay)):  # the newest result is the last one to be executed
            cycle = log.next(before[k : k + 1])
            log = replace(log, runs=(*log.runs, (log.end, cycle)))
        return log

    def next(self, sent: Sequence[PlateCycle]) -> PlateCycle:
        """Return the cycle that follows the last run according to `plate_core.motion.next_cycle`.
        `sent` contains the cycles that were sent to the plate, the newest cycle last."""
        return next_cycle(self.runs[-1][1], sent, idle_s=self.period)

    def record_cycle(
        self, cycle: PlateCycle, arrival: float, requested: float | None = None
    ) -> CycleLog:
        """Record a cycle that was sent to the plate at the time `arrival` [s, in the time of the
        image stamps].

        `requested` is the start time of the cycle during which the image for this cycle's request
        was taken [s]. Default: the start of the running cycle.
        """
        if not _has_allowed_lengths(cycle):
            return self
        if requested is None:
            requested = self.begin if self.runs else arrival
        before = self.sent[-LATEST:] if math.isfinite(self.last_report) else ()
        sent = Sent(arrival, cycle, requested)
        awaited = sent if cycle.moves else self.awaited
        return replace(self, sent=(*before, sent), solved_start=requested, awaited=awaited)

    def started(self, cycle: PlateCycle, begin: float, triggered: bool = False) -> CycleLog:
        """Record the report that the plate began a cycle at the time `begin` [s]. A repeated report
        changes nothing. `triggered` states whether images are taken at cycle starts."""
        if not _has_allowed_lengths(cycle):
            return self
        if self._clock_was_reset(begin):
            return CycleLog(((begin, cycle),), free_running=not triggered, last_report=begin)
        if self._is_reported(cycle, begin):
            return self
        before = self._list_runs_before(begin)
        kept = tuple(run for run in before if run[0] + run[1].period > begin - MEMORY_S)
        answer = self._index_in_sent(cycle)
        return replace(
            self,
            runs=(*kept, (begin, cycle)),
            sent=self.sent if answer is None else self.sent[answer + 1 :],
            free_running=not triggered,
            delays=self._updated_delays(answer, kept),
            last_report=begin,
            awaited=self._updated_awaited(cycle),
            begun=self.begun + 1,
            unanswered_cycles=self.unanswered_cycles
            + (answer is None and self._is_continuation(cycle, before)),
        )

    def _clock_was_reset(self, begin: float) -> bool:
        """Whether the start time `begin` of a report [s] is so old that the clock must have been
        set back."""
        return bool(self.runs) and begin < self.begin - MEMORY_S

    def _is_reported(self, cycle: PlateCycle, begin: float) -> bool:
        """Whether an earlier report stated that this cycle began at the time `begin` [s]."""
        return begin <= self.last_report and any(
            begin == start and _is_same_cycle(cycle, run) for start, run in self.runs
        )

    def _list_runs_before(self, begin: float) -> tuple[tuple[float, PlateCycle], ...]:
        """Return the runs that began clearly before a reported start time `begin` [s]. If a run was
        expected to begin at about this time, it was only a prediction. The report replaces this
        run, so it is omitted."""
        return tuple(run for run in self.runs if run[0] < begin - SNAP * run[1].period)

    def _index_in_sent(self, cycle: PlateCycle) -> int | None:
        """Return the index in `sent` of a cycle that has begun, or None if `sent` does not contain
        this cycle."""
        return next(
            (k for k, sent in enumerate(self.sent) if _is_same_cycle(sent.cycle, cycle)), None
        )

    def _updated_delays(
        self, answer: int | None, kept: tuple[tuple[float, PlateCycle], ...]
    ) -> tuple[int, ...]:
        """Return the value of `delays` after a result of the solver has begun. `answer` is the
        index of this result in `sent`. `kept` contains the start time [s] and the cycle of each
        stored run before the result. If the result is a cycle at rest, no delay is added, because
        cycles at rest cannot be distinguished."""
        if answer is None or not self.sent[answer].cycle.moves:
            return self.delays
        requested = self.sent[answer].requested
        late = sum(  # cycles at rest and tails are not counted, because they do not delay results
            start > requested + SNAP * run.period and run.moves and not _is_tail(run)
            for start, run in kept
        )
        return (*self.delays, late)[-DELAYS_KEPT:]

    def _is_continuation(
        self, cycle: PlateCycle, before: tuple[tuple[float, PlateCycle], ...]
    ) -> bool:
        """Whether a cycle moves the plate only because no result of the solver arrived in time. In
        this case, the cycle repeats the last run or is the tail of the last run. In addition, the
        newest sent cycle is not a cycle at rest."""
        if not (before and cycle.moves) or (self.sent and not self.sent[-1].cycle.moves):
            return False
        return any(_is_same_cycle(cycle, part) for part in before[-1][1].parts)

    def advance(self, t: float) -> CycleLog:
        """Return the log advanced to the stamp t [s] of an image. If the driver reports no cycle
        starts, a cycle is assumed to start at this stamp.

        When a cycle has ended, the newest sent cycle follows if it arrived in time. If the solver's
        results have a delay, an older sent cycle follows. Otherwise, `next_cycle` determines the
        following cycle.
        """
        if self.free_running:
            log = self
            while log.end <= t < log.end + MEMORY_S:
                log = log._begin_cycle(log.end)
            return log
        log = self
        if self.runs and t < (self.runs[0][0] if self.begin == self.last_report else self.begin):
            log = CycleLog()  # the time is before the log, because the clock was restarted
        elif self.runs and t > self.end + MEMORY_S:
            # No image has arrived for a long time.
            log = CycleLog(sent=self.sent, solved_start=self.solved_start, awaited=self.awaited)
        if not log.runs:
            return log._begin_cycle(t)
        while log.end <= t - SNAP * (log.end - log.begin):
            log = log._begin_cycle(log.end)
        if log.end <= t + SNAP * (log.end - log.begin):
            log = log._begin_cycle(t)
        kept = tuple(run for run in log.runs if run[0] + run[1].period > t - MEMORY_S)
        return replace(log, runs=kept)

    def triggered(self, t: float, phase: float) -> float:
        """Return the time [s] at which the camera was triggered for an image with the stamp t [s].
        The camera is triggered at the phase `phase` of each cycle.

        The stamp may be up to `SNAP` cycles before the trigger, and up to 1 - `SNAP` cycles after
        the trigger. If the plate is at rest, the result is the stamp itself.
        """
        # The next cycle may have started, although its start is not reported yet.
        ahead = (self.end, self.runs[-1][1])
        for begin, cycle in (ahead, *reversed(self.runs)):
            taken = begin + phase * cycle.period
            if taken <= t + SNAP * cycle.period:
                return taken if cycle.moves else t
        return t

    def _begin_cycle(self, t: float) -> CycleLog:
        """Return the log after the next cycle has begun at time t [s]."""
        arrived = [sent for sent in self.sent if in_time(sent.arrival, t)]
        if self.delay:
            cycles = self.delay + 1 - SNAP
            arrived = [sent for sent in arrived if sent.requested + cycles * sent.cycle.period <= t]
        waiting = [
            sent.cycle for sent in arrived if not any(sent.cycle is run for _, run in self.runs)
        ]
        if not (self.runs or waiting):
            return self
        cycle = self.next(waiting) if self.runs else waiting[-1]
        # Keep the sent cycles in two cases: their starts may be reported later, or a sent cycle may
        # follow a tail.
        keeps = math.isfinite(self.last_report) or not any(
            cycle is candidate for candidate in waiting
        )
        awaited = self.awaited if keeps else self._updated_awaited(cycle)
        runs = (*self.runs, (t, cycle))
        return replace(self, runs=runs, sent=self.sent if keeps else (), awaited=awaited)

    def _updated_awaited(self, cycle: PlateCycle) -> Sent | None:
        """Return the value of `awaited` after `cycle` has begun. The value is None if `cycle` is
        the awaited cycle."""
        awaited = self.awaited
        return None if awaited is not None and _is_same_cycle(awaited.cycle, cycle) else awaited

    def may_move(self, t: float) -> bool:
        """Whether the cycle `awaited` may still begin after the time t [s].

        If the driver has accepted this cycle, it starts at the end of the running cycle.
        """
        awaited = self.awaited
        # this request is in the future, because the clock was set back
        if awaited is None or awaited.requested > t + MEMORY_S:
            return False
        return t < awaited.requested + MAX_AGE_S + awaited.cycle.period

    def moves_between(self, begin: float, end: float) -> bool:
        """Whether the plate moves between the times `begin` and `end` [s]. Motion during a short
        part of a cycle (`SNAP`) is not counted, because the times are uncertain."""
        return any(
            cycle.moves and b - a > SNAP * cycle.period
            for cycle, _, a, b in self.between(begin, end)
        )

    def between(self, begin: float, end: float) -> Iterator[tuple[PlateCycle, float, float, float]]:
        """Yield the parts of all runs that are between the times `begin` and `end` [s]. Each item
        contains the cycle, the start time of the cycle [s], and the start and the end of the part
        relative to this start time [s].

        If no run exists at a time, no item covers this time.
        """
        for k, (start, cycle) in enumerate(self.runs):
            stop = self.runs[k + 1][0] if k + 1 < len(self.runs) else start + cycle.period
            a, b = max(begin, start), min(end, stop, start + cycle.period)
            if b > a:
                yield cycle, start, a - start, b - start


def check_start(cycle: PlateCycle, begin: float, image: float | None) -> None:
    """Check a reported cycle. The start time `begin` [s] of the cycle is compared with the stamp
    `image` [s] of the last image.

    Raises
    ------
    PlateError
        If the period of the cycle is outside `PERIOD_RANGE_S`, or `begin` and `image` differ by
        more than `SAME_TIME_S`.
    """
    low, high = PERIOD_RANGE_S
    if not low <= cycle.period <= high:
        raise PlateError(
            f"cycle_started: period is {cycle.period:g} s, allowed: {low:g} to {high:g}"
        )
    if image is not None and abs(begin - image) > SAME_TIME_S:
        raise PlateError(
            "cycle_started: its stamp minus the stamp of the last image is "
            f"{begin - image:.1f} s, allowed: -{SAME_TIME_S:g} to {SAME_TIME_S:g} s; check that "
            "all clocks are synchronised and that the detector runs"
        )


def _is_same_cycle(first: PlateCycle, second: PlateCycle) -> bool:
    """Whether two cycles have equal knot poses, up to rounding. Times are not compared."""
    a, b = first.knot_pose, second.knot_pose
    return a.shape == b.shape and bool(np.all(np.abs(a - b) < SAME_POSE))


def _has_allowed_lengths(cycle: PlateCycle) -> bool:
    """Whether the lengths of a cycle and its tail are in the range that the log accepts."""
    return all(MIN_S <= part.period <= MAX_S for part in cycle.parts)


def _is_tail(cycle: PlateCycle) -> bool:
    """Whether a cycle is a tail, which only brings the plate to rest."""
    return cycle.tail is None and not cycle.closes


@dataclass(frozen=True)
class CycleClock:
    """Estimate of the cycle period from the stamps of consecutive images.

    Attributes
    ----------
    stamp : float or None
        Stamp of the last image [s]. None before the first image.
    intervals : tuple of float
        The last plausible intervals between consecutive stamps [s].
    period : float
        Assumed length of a cycle [s].
    """

    stamp: float | None
    intervals: tuple[float, ...]
    period: float

    @classmethod
    def starting(cls, default_period: float) -> CycleClock:
        """Return a clock that has received no stamps yet."""
        return cls(None, (), default_period)

    def tick(self, t: float) -> CycleClock:
        """Return the clock updated with the stamp t [s] of the next image. A stamp that is earlier
        than the last stamp, or much later than it, does not change the period."""
        step = None if self.stamp is None else t - self.stamp
        if step is None or not PERIOD_RANGE_S[0] <= step <= PERIOD_RANGE_S[1]:
            return replace(self, stamp=t)
        intervals = (*self.intervals, step)[-INTERVALS_KEPT:]
        return CycleClock(t, intervals, median_low(intervals))

    @property
    def interval(self) -> float:
        """Interval between the last two images [s]. Before the second image, it is `period`."""
        return self.intervals[-1] if self.intervals else self.period

    def went_back(self, t: float) -> bool:
        """Whether the stamp t [s] is earlier than the last stamp. In this case, the source of the
        images was restarted."""
        return self.stamp is not None and t < self.stamp
