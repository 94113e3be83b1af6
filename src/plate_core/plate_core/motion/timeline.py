"""Which cycle the plate runs, which one follows, and from when.

The simulator, the loop without ROS and the environments play cycles by this rule. Planner and
solver predict by it which cycle is played. The guards of driver and firmware do not use it: they
must not trust it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .cycle import PlateCycle

HANDOVER_S = 4e-3
"""Time from the publication of a cycle until the device can play it [s]: two messages between nodes
and the computation of the driver."""

HOLD_CYCLES = 2
"""Default number of repetitions of a cycle without a tail that no other one follows: the plate goes
on through one or two late answers, and then stops."""

IDLE_S = 0.1
"""Default length of a cycle at rest [s]: a typical cycle of the solver."""


def in_time(arrival: float, begin: float) -> bool:
    """Whether a cycle that was published at `arrival` [s] can run from `begin` [s] on, by the same
    clock: the device has it by then."""
    return arrival + HANDOVER_S <= begin


def next_cycle(
    running: PlateCycle, sent: Sequence[PlateCycle], repeat: bool = True, idle_s: float = IDLE_S
) -> PlateCycle:
    """Return the cycle that the plate runs after another one.

    This is the first possible of: the newest cycle sent that begins in the state in which the
    running one ends; the tail of the running one; the running one again, if it ends as it began;
    rest.

    Parameters
    ----------
    running : PlateCycle
    sent : sequence of PlateCycle
        Cycles that the device has, the newest one last.
    repeat : bool
        Whether the running cycle may run again.
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
    """The cycle that a player runs now, and the one that waits.

    Attributes
    ----------
    cycle : PlateCycle
        The running cycle, or the tail of one.
    begin : float
        When it began, on the player's clock [s].
    repeats : int
        How often it has been repeated.
    filling : bool
        Whether it only fills the time until another one is sent: a tail, or rest.
    waiting : PlateCycle or None
        The cycle to run next, if it begins as the running one ends.
    """

    cycle: PlateCycle
    begin: float = 0.0
    repeats: int = 0
    filling: bool = False
    waiting: PlateCycle | None = None

    @classmethod
    def at_rest(cls, idle_s: float = IDLE_S) -> Timeline:
        """Return the timeline of a plate at rest, from 0 on, in cycles of `idle_s` [s]."""
        return cls(PlateCycle.rest(idle_s), filling=True)

    @property
    def end(self) -> float:
        """When the running cycle ends [s]."""
        return self.begin + self.cycle.period

    def send(self, cycle: PlateCycle) -> Timeline:
        """Return the timeline with a cycle that has reached the player.

        The newest one that begins as the running one ends waits. Another one, which would have to
        wait for the tail, does not replace it, except rest: this may be a stop.
        """
        kept = self.waiting is not None and self.waiting.follows(self.cycle)
        if kept and cycle.moves and not cycle.follows(self.cycle):
            return self
        return Timeline(self.cycle, self.begin, self.repeats, self.filling, cycle)

    def next(self, hold_cycles: int = HOLD_CYCLES, idle_s: float = IDLE_S) -> Timeline:
        """Return the timeline from the end of the running cycle on.

        A cycle that no other one follows is repeated `hold_cycles` times at most. During a tail, a
        cycle that begins at rest goes on waiting. `idle_s` [s] is the length of a cycle at rest.
        """
        waiting = () if self.waiting is None else (self.waiting,)
        repeat = not self.filling and self.repeats < hold_cycles
        cycle = next_cycle(self.cycle, waiting, repeat, idle_s)
        if cycle is self.waiting:
            return Timeline(cycle, self.end)
        if cycle is self.cycle:
            return Timeline(cycle, self.end, self.repeats + 1)
        later = self.waiting if cycle is self.cycle.tail else None
        if later is not None and not later.starts_at_rest:
            later = None
        return Timeline(cycle, self.end, filling=True, waiting=later)
