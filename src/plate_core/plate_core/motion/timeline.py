"""Rule for the order of the cycles: which cycle the plate plays, which cycle follows, and when the
next cycle starts.

The simulator, the closed loop without ROS and the Gymnasium environments play cycles by this rule.
Planner and solver predict the played cycle by this rule. The guards of driver and firmware check
the motion independently, so they do not use this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .cycle import PlateCycle

HANDOVER_S = 4e-3
"""Time from the publication of a cycle until the device can play it [s]. This time covers two
messages between nodes and the computation of the driver."""

HOLD_CYCLES = 1
"""Default number of plays (executions) of a cycle without a tail, if no other cycle follows. A
cycle moves each part to a target. A second play would move the part further, possibly over the
edge."""

IDLE_S = 0.1
"""Default length of a cycle at rest [s]: a typical cycle of the solver."""


def in_time(arrival: float, begin: float) -> bool:
    """Whether a cycle that was published at `arrival` [s] reaches the device before `begin` [s].
    Both times are from the same clock."""
    return arrival + HANDOVER_S <= begin


def next_cycle(
    running: PlateCycle, sent: Sequence[PlateCycle], repeat: bool = False, idle_s: float = IDLE_S
) -> PlateCycle:
    """Return the cycle that the plate plays after the running cycle.

    The result is the first cycle of this list that exists:

    - the newest sent cycle that begins in the final state of the running cycle
    - the tail of the running cycle
    - the running cycle again, if `repeat` is True and it ends in its initial state
    - rest

    Parameters
    ----------
    running : PlateCycle
    sent : sequence of PlateCycle
        Cycles that the device has received, in order of arrival.
    repeat : bool
        Whether the running cycle is allowed to be repeated.
    idle_s : float
        Length of a cycle at rest [s].
    """
    newest = next((cycle for cycle in reversed(sent) if cycle.follows(running)), None)
    if newest is not None:
        return newest
    if running.tail is not None:
        return running.tail
    return running if repeat and running.closes else PlateCycle.rest(idle_s)


@dataclass(frozen=True)
class Timeline:
    """The cycle that the plate plays, and the next cycle that it has received.

    Attributes
    ----------
    cycle : PlateCycle
        The running cycle, which can be a tail.
    begin : float
        Start time of the running cycle [s].
    repeats : int
        Number of repetitions of the running cycle so far.
    filling : bool
        Whether the running cycle is a tail or rest, which only fills the time until the next cycle.
    waiting : PlateCycle or None
        The cycle that follows, if it begins in the final state of the running cycle. None if no
        cycle has been received.
    """

    cycle: PlateCycle
    begin: float = 0.0
    repeats: int = 0
    filling: bool = False
    waiting: PlateCycle | None = None

    @classmethod
    def at_rest(cls, idle_s: float = IDLE_S) -> Timeline:
        """Return the timeline of a plate at rest that starts at 0, with cycles of `idle_s` [s]."""
        return cls(PlateCycle.rest(idle_s), filling=True)

    @property
    def end(self) -> float:
        """End time of the running cycle [s]."""
        return self.begin + self.cycle.period

    def send(self, cycle: PlateCycle) -> Timeline:
        """Return the timeline after the plate has received a cycle.

        The new cycle replaces the waiting cycle. There is one exception. The waiting cycle is kept
        if it begins in the final state of the running cycle and the new cycle does not. However, a
        new cycle at rest always replaces the waiting cycle, because the new cycle may be a stop.
        """
        kept = self.waiting is not None and self.waiting.follows(self.cycle)
        if kept and cycle.moves and not cycle.follows(self.cycle):
            return self
        return Timeline(self.cycle, self.begin, self.repeats, self.filling, cycle)

    def next(self, hold_cycles: int = HOLD_CYCLES, idle_s: float = IDLE_S) -> Timeline:
        """Return the timeline after the end of the running cycle.

        If no other cycle follows, the running cycle is played `hold_cycles` times in total. During
        a tail, a waiting cycle that begins at rest is kept. `idle_s` [s] is the length of a cycle
        at rest.
        """
        waiting = () if self.waiting is None else (self.waiting,)
        repeat = not self.filling and self.repeats + 1 < hold_cycles
        cycle = next_cycle(self.cycle, waiting, repeat, idle_s)
        if cycle is self.waiting:
            return Timeline(cycle, self.end)
        if cycle is self.cycle:
            return Timeline(cycle, self.end, self.repeats + 1)
        later = self.waiting if cycle is self.cycle.tail else None
        if later is not None and not later.starts_at_rest:
            later = None
        return Timeline(cycle, self.end, filling=True, waiting=later)
