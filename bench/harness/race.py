"""Fair timing: the compared functions run in turn, so that the same disturbances affect all."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

BATCH_S = 2e-3
"""Minimum time of a timed batch of calls [s], which is much longer than the clock's resolution."""

MIN_ROUNDS = 3
"""Minimum number of rounds. Slow functions also run in this number of rounds, because the median of
fewer times is unreliable."""

cpu_time = time.process_time
"""Clock of all measurements [s]: CPU time of all threads of this process. On an idle computer, this
time equals the wall time of a single thread. The clock does not include the CPU time of other
programs."""


def timed(call: Callable[..., Any], *arguments: Any, **named: Any) -> tuple[Any, float]:
    """Return the result of a call, and the CPU time of the call [s]."""
    began = cpu_time()
    found = call(*arguments, **named)
    return found, cpu_time() - began


@dataclass(frozen=True)
class Race:
    """Times of functions that were called in turn.

    Attributes
    ----------
    times : mapping of str to (rounds,)
        Time per call [s], round by round.
    """

    times: Mapping[str, np.ndarray]

    def median(self, name: str) -> float:
        """Return the median time per call [s]."""
        return float(np.median(self.times[name]))

    def speedup(self, name: str, baseline: str) -> float:
        """Return the median over the rounds of (time of `baseline` / time of `name`)."""
        return float(np.median(self.times[baseline] / self.times[name]))


def race(contestants: Mapping[str, Callable[[], object]], seconds: float) -> Race:
    """Time functions in turn for about `seconds` in total. The first call of each function is not
    timed."""
    batch = {}
    for name, call in contestants.items():
        call()
        began = cpu_time()
        call()
        batch[name] = max(1, math.ceil(BATCH_S / max(cpu_time() - began, 1e-9)))
    times: dict[str, list[float]] = {name: [] for name in contestants}
    deadline = time.perf_counter() + seconds
    rounds = 0
    while rounds < MIN_ROUNDS or time.perf_counter() < deadline:
        rounds += 1
        for name, call in contestants.items():
            began = cpu_time()
            for _ in range(batch[name]):
                call()
            times[name].append((cpu_time() - began) / batch[name])
    return Race({name: np.array(values) for name, values in times.items()})
