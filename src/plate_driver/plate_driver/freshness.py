"""Decision whether a cycle is recent enough to move the plate.

The driver makes this decision immediately before it sends a cycle to the motors. Each message of
the control loop carries the stamp of the image, or of the cycle start, from which it is derived.
Therefore the age is known even if a message was delayed, lost, repeated or reordered. This module
uses neither ROS nor a clock: all times are arguments.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from plate_core import CycleError
from plate_core.clock_steps import KEPT_S, MAX_STEPS, ClockSteps
from plate_core.status import age_limit

__all__ = ["AHEAD_S", "ALONE_S", "STALL_S", "Freshness"]

SEND_S = 0.02
"""Maximum time that a busy computer needs to send a cycle [s]. This time is subtracted from the age
limit. Therefore no cycle reaches the device after the limit."""

AHEAD_S = 0.1
"""Maximum time by which another computer's clock may be ahead of this computer's clock [s]."""

CLOCKS_S = 3.0
"""Maximum image age that a slow computer can cause [s]. If the age is larger or negative, the error
message advises the user to check the synchronisation of the clocks."""

STALL_S = 0.25
"""If the time between two calls of `Freshness.with_state` is longer than this value, the driver
counts as stalled [s]. The value is about one cycle."""

ALONE_S = 1.0
"""If cycles of two publishers arrive within this time [s], both are refused, even if the publishers
have equal names. A restart of the solver takes longer, so it does not cause this error."""

RESTART_NS = 1_000_000_000
"""Maximum time between a stamp and a later event for which both are compared [ns]. If the time is
longer, the age limit refuses the stamp, or a simulator was restarted after the stamp."""


@dataclass(frozen=True)
class Freshness:
    """Record of the facts that can make a cycle invalid: its age, events after its image, or a
    second publisher.

    Stamps are in ns.

    Attributes
    ----------
    since_ns : int
        Time at which the motors became ready or the driver resumed after a stall, on the clock that
        stamps images. The later of these two events determines the time.
    why : str
        Text that names the event at `since_ns`.
    ended_ns : int
        Stamp of the last request of a task that has ended.
    number : int or None
        Number of stops before the motors became ready. None if the motors are not ready. If the
        number has changed since the last call of `with_state`, the motors were stopped and enabled
        again.
    updated_at : float
        Time of the last call of `with_state` [s, steady clock].
    last_cycles : dict of bytes to float
        Time of the last cycle of each publisher [s, steady clock]. The keys identify the
        publishers.
    clock : ClockSteps
        Steps of the clock that stamps images.
    """

    since_ns: int = 0
    why: str = ""
    ended_ns: int = 0
    number: int | None = None
    updated_at: float = 0.0
    last_cycles: dict[bytes, float] = field(default_factory=dict)
    clock: ClockSteps = field(default_factory=ClockSteps)

    def with_clocks(self, now: float, clock_ns: int) -> Freshness:
        """Record one reading of the steady clock [s] and of the clock that stamps images [ns]. Call
        this method before each call of another method, except in simulated time, which has no
        relation to the steady clock."""
        clock = self.clock.with_reading(now, clock_ns)
        by_ns = sum(step.by_ns for step in clock.steps if step not in self.clock.steps)
        return replace(self, clock=clock, since_ns=self.since_ns + by_ns)

    def with_state(self, number: int | None, now: float, clock_ns: int) -> Freshness:
        """Record whether the motors are ready. Call this method about every 20 ms.

        Parameters
        ----------
        number : int or None
            Number of stops so far if the motors are ready. Otherwise None.
        now : float
            Time on the steady clock [s].
        clock_ns : int
            The same time on the clock that stamps images [ns].
        """
        stalled_s, why = now - self.updated_at, ""
        if number is not None and number != self.number:
            why = "the motors became ready"
        elif number is not None and stalled_s > STALL_S:
            why = f"the driver was stalled for {stalled_s:.1f} s"
        new = replace(self, number=number, updated_at=now)
        return replace(new, since_ns=clock_ns, why=why) if why else new

    def ended(self, stamp_ns: int) -> Freshness:
        """Record that a task has ended or that no task runs.

        `stamp_ns` is the image stamp of the planner's last request. The stamp is ignored if it is 0
        (no request yet) or less than `RESTART_NS` older than the last recorded stamp.
        """
        old = not stamp_ns or 0 < self.ended_ns - stamp_ns < RESTART_NS
        return self if old else replace(self, ended_ns=stamp_ns)

    def with_cycle(self, source: bytes, now: float) -> Freshness:
        """Record that publisher `source` sent a cycle, moving or at rest, at `now` [s, steady
        clock]."""
        recent = {
            key: arrival for key, arrival in self.last_cycles.items() if now - arrival < ALONE_S
        }
        return replace(self, last_cycles=recent | {source: now})

    def remaining_s(self, stamp_ns: int, clock_ns: int, period: float) -> float:
        """Return the remaining time in which a moving cycle may be sent [s].

        Raises
        ------
        CycleError
            If the cycle must not be sent. The message gives the reason.
        """
        if not self.clock.usable:
            raise CycleError(
                f"the clock of the image stamps stepped more than {MAX_STEPS} times in {KEPT_S:g} "
                f"s, allowed: at most {MAX_STEPS}; check the clock's synchronisation"
            )
        earliest_ns = self.clock.earliest_ns(stamp_ns)
        age, limit = 1e-9 * (clock_ns - stamp_ns), age_limit(period) - SEND_S
        oldest = 1e-9 * (clock_ns - earliest_ns)
        if -AHEAD_S <= age <= limit < oldest:
            raise CycleError(
                f"plate_cycle is for an image that may be {oldest:.2f} s old, because the clock "
                f"was set back by {oldest - age:.2f} s, allowed: -{AHEAD_S:.2f} to {limit:.2f} s"
            )
        if not -AHEAD_S <= age <= limit:
            slow = 0 <= age < CLOCKS_S
            clocks = "check that the clock of the image stamps and this computer's are synchronised"
            raise CycleError(
                f"plate_cycle is for an image {age:.2f} s old, allowed: -{AHEAD_S:.2f} to "
                f"{limit:.2f} s; {'check that the computer is fast enough' if slow else clocks}"
            )
        if len(self.last_cycles) > 1:
            raise CycleError(f"{len(self.last_cycles)} nodes publish plate_cycle, allowed: one")
        if 0 < self.since_ns - earliest_ns < RESTART_NS:
            raise CycleError(f"plate_cycle is for an image that was taken before {self.why}")
        if 0 <= self.ended_ns - earliest_ns < RESTART_NS:
            raise CycleError("plate_cycle is for a task that has ended")
        return limit - oldest
