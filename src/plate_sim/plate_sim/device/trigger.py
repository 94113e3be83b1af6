"""The camera's trigger line (firmware/trigger.c)."""

from __future__ import annotations

from dataclasses import dataclass

from .table import changed

REST_US = 100_000
"""Between pulses while no table plays [us]."""


@dataclass(frozen=True)
class TriggerLine:
    """When the line is high.

    Attributes
    ----------
    phase, pulse_ms : int
        As in `Trigger`.
    done : bool
        Whether this cycle or tail has had its pulse.
    into : int
        It, in the tick before [TICK_S].
    rose_us : int
        When the last pulse began [us].
    high : bool
        In this tick.
    """

    phase: int = 0
    pulse_ms: int = 0
    done: bool = False
    into: int = 0
    rose_us: int = 0
    high: bool = False

    def stepped(self, now_us: int, into: int, period: int) -> TriggerLine:
        """Return the line in a tick, `into` a cycle or tail of `period`; both 0: none
        plays [TICK_S]."""
        if not self.pulse_ms:
            return changed(self, high=False) if self.high else self
        done, rises = self.done, False
        if not period:
            done, rises = False, now_us - self.rose_us >= REST_US
        else:
            if into < self.into:  # the next one: it was due between the last tick and the end
                done, rises = False, not done
            if not done and into >= period * self.phase >> 16:
                done = rises = True
        rose_us = now_us if rises else self.rose_us
        high = now_us - rose_us < 1000 * self.pulse_ms
        return changed(self, done=done, into=into, rose_us=rose_us, high=high)
