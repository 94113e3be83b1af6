"""Detection of steps of the clock that stamps messages.

A clock that is synchronised over a network may step. If the clock steps back while a message is in
transit, the message seems younger than it is. The steady (monotonic) clock never steps. Therefore a
change of the difference between the two clocks reveals a step. This module uses no ROS and reads no
clock itself. Times and clocks are arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

__all__ = ["KEPT_S", "MAX_STEPS", "ClockSteps", "read_together"]

STEP_NS = 20_000_000
"""Minimum change of the difference between the clocks that counts as a step [ns]. Smaller changes
occur if the process is interrupted between reading the two clocks."""

TOGETHER_S = 0.002
"""Maximum duration of a reading of both clocks [s]. A longer reading was interrupted and is
repeated, because its result could look like a step."""

READINGS = 5
"""Maximum number of readings. If all readings are interrupted, the reading with the shortest
duration is used."""

KEPT_S = 60.0
"""Time for which a step of the clock is taken into account [s]. No message is in transit for a
longer time. After a step back, the clock shows some times twice. A stamp with such a time may be
older than it seems, so it is treated as a stamp from before the step. Therefore the plate rests
until the clock has passed these times, but at most for `KEPT_S`."""

MAX_STEPS = 20
"""Maximum number of steps in `KEPT_S`. With more steps, the clock is not usable. If the clock is
not usable, each stamp is treated as `KEPT_S` older than it seems."""


class Step(NamedTuple):
    """One step of the clock.

    Attributes
    ----------
    at : float
        Time at which the step was detected [s, steady clock].
    before_ns : int
        Time that the clock would have shown at the time `at` without the step [ns].
    by_ns : int
        Size of the step [ns]. Negative if the clock was set back.
    """

    at: float
    before_ns: int
    by_ns: int


@dataclass(frozen=True)
class ClockSteps:
    """Steps of the clock in the last `KEPT_S`.

    Attributes
    ----------
    offset_ns : int or None
        Last difference between the clock and the steady clock [ns]. None before the first reading
        of the clocks.
    steps : tuple of Step
        The newest steps, at most `MAX_STEPS` + 1, in order of time.
    """

    offset_ns: int | None = None
    steps: tuple[Step, ...] = ()

    def with_reading(self, now: float, clock_ns: int) -> ClockSteps:
        """Record one reading of both clocks. The exact time of a step is unknown, so the time of
        the reading that detects the step is used instead. Frequent readings keep this error small.

        Parameters
        ----------
        now : float
            Time on the steady clock [s].
        clock_ns : int
            The same time on the clock that stamps messages [ns].
        """
        offset_ns = clock_ns - round(1e9 * now)
        by_ns = 0 if self.offset_ns is None else offset_ns - self.offset_ns
        steps = tuple(step for step in self.steps if now - step.at < KEPT_S)
        if abs(by_ns) > STEP_NS:
            steps += (Step(now, clock_ns - by_ns, by_ns),)
        # Keep up to `MAX_STEPS` + 1 steps. More than `MAX_STEPS` steps show that the clock is not
        # usable.
        return replace(self, offset_ns=offset_ns, steps=steps[-MAX_STEPS - 1 :])

    @property
    def usable(self) -> bool:
        """Whether the clock has at most `MAX_STEPS` steps in `KEPT_S`."""
        return len(self.steps) <= MAX_STEPS

    def earliest_ns(self, stamp_ns: int) -> int:
        """Return the earliest time at which a stamp may have been made [ns], as the clock would
        show this time now. The result is earlier than the stamp if the clock was set back, or if
        the clock is not `usable`."""
        if not self.usable:
            return stamp_ns - round(1e9 * KEPT_S)
        earliest_ns, by_ns = stamp_ns, 0
        for step in reversed(self.steps):
            by_ns += step.by_ns
            if stamp_ns <= step.before_ns:  # the stamp may have been made before this step
                earliest_ns = min(earliest_ns, stamp_ns + by_ns)
        return earliest_ns


def read_together(steady_s: Callable[[], float], stamp_ns: Callable[[], int]) -> tuple[float, int]:
    """Read two clocks at almost the same time.

    Parameters
    ----------
    steady_s : callable
        Function that returns the time on the steady clock [s].
    stamp_ns : callable
        Function that returns the time on the other clock [ns].

    Returns
    -------
    now : float
        Time on the steady clock [s].
    clock_ns : int
        The same time on the other clock [ns].
    """
    shortest, now, clock_ns = float("inf"), 0.0, 0
    for _ in range(READINGS):
        start, other, end = steady_s(), stamp_ns(), steady_s()
        if end - start < shortest:
            shortest, now, clock_ns = end - start, end, other
        if shortest <= TOGETHER_S:
            break
    return now, clock_ns
