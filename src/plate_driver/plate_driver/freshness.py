"""Whether a cycle may still move the plate: how old what it answers is, and what happened since.

The one rule, in the last place before the motors. Each message of the loop carries the stamp of the
image, or of the cycle's start, that it descends from; so whatever was delayed, frozen, lost, sent
again or out of order on the way, its age is known here. Pure; times are arguments.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from plate_core import CycleError
from plate_core.status import age_limit

__all__ = ["AHEAD_S", "ALONE_S", "STANDSTILL_S", "Freshness"]

SEND_S = 0.02
"""What sending may take on a busy computer [s]: a cycle that comes later than that before its limit
is refused, so that none is sent beyond it."""

AHEAD_S = 0.1
"""How far the clock of another computer may be ahead of ours [s]."""

CLOCKS_S = 3.0
"""An image that seems to be older than this, or not to be taken yet, is one of another clock [s]: a
computer that is too slow answers sooner."""

STANDSTILL_S = 0.25
"""A driver that did not run for longer stood still [s]: about a cycle."""

ALONE_S = 1.0
"""Two nodes that have sent cycles within this time are rivals [s], also if their names are one: a
solver that was started again is not so quick."""

RESTART_NS = 1_000_000_000
"""What happened so long after a stamp does not count [ns]: that stamp is too old anyway, or of a
simulator that began anew."""


@dataclass(frozen=True)
class Freshness:
    """What the driver must know to tell old cycles from new ones. Stamps are in ns.

    Attributes
    ----------
    since_ns : int
        When the motors became ready, or the driver ran again after it had stood still, whichever
        was last: by the clock that stamps images.
    why : str
        Which of the two.
    ended_ns : int
        Stamp of the last request of a task that has ended.
    number : int or None
        Stops before the motors became ready; None: they are not.
    looked : float
        When it was last looked whether they are [s, steady clock].
    heard : dict of bytes to float
        When each publisher has sent its last cycle [s, steady clock], by its key.
    """

    since_ns: int = 0
    why: str = ""
    ended_ns: int = 0
    number: int | None = None
    looked: float = 0.0
    heard: dict[bytes, float] = field(default_factory=dict)

    def seen(self, number: int | None, now: float, clock_ns: int) -> Freshness:
        """Take in whether the motors are ready; to be called every 20 ms or so.

        Parameters
        ----------
        number : int or None
            Stops so far if they are ready, else None.
        now : float
            Of the steady clock [s].
        clock_ns : int
            The same instant by the clock that stamps images.
        """
        away, why = now - self.looked, ""
        if number is not None and number != self.number:
            why = "the motors became ready"
        elif number is not None and away > STANDSTILL_S:
            why = f"the driver itself stood still for {away:.1f} s"
        new = replace(self, number=number, looked=now)
        return replace(new, since_ns=clock_ns, why=why) if why else new

    def ended(self, stamp_ns: int) -> Freshness:
        """Take in that a task has ended, or that none runs: the planner's last request answered the
        image of this stamp. 0, of one that has asked for nothing yet, and what was said of older
        images count for nothing."""
        old = not stamp_ns or 0 < self.ended_ns - stamp_ns < RESTART_NS
        return self if old else replace(self, ended_ns=stamp_ns)

    def came(self, source: bytes, now: float) -> Freshness:
        """Take in that a cycle has come, at rest or not: from whom, and when [s, steady clock]."""
        recent = {key: at for key, at in self.heard.items() if now - at < ALONE_S}
        return replace(self, heard=recent | {source: now})

    def left(self, stamp_ns: int, clock_ns: int, period: float) -> float:
        """Return for how long a moving cycle may still be sent [s].

        Raises
        ------
        CycleError
            If it may no more, with the reason.
        """
        age, limit = 1e-9 * (clock_ns - stamp_ns), age_limit(period) - SEND_S
        if not -AHEAD_S <= age <= limit:
            slow = 0 <= age < CLOCKS_S
            clocks = "does the clock that stamps images agree with this computer's?"
            raise CycleError(
                f"plate_cycle answers an image that is {age:.2f} s old, allowed: 0 to {limit:.2f} s"
                f"; {'is the computer too slow?' if slow else clocks}"
            )
        if len(self.heard) > 1:
            raise CycleError(f"{len(self.heard)} nodes publish plate_cycle, allowed: one")
        if 0 < self.since_ns - stamp_ns < RESTART_NS:
            raise CycleError(f"plate_cycle answers an image from before {self.why}")
        if 0 <= self.ended_ns - stamp_ns < RESTART_NS:
            raise CycleError("plate_cycle was asked for by a task that has ended")
        return limit - age
