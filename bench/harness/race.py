"""Fair timing: contestants take turns, so that all meet the same noise."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

BATCH_S = 2e-3
"""Least time of one timed batch of calls [s]: far above the clock's resolution."""

LEAST_ROUNDS = 3
"""Rounds of a race, however slow the contestants: a median needs them."""

cpu_time = time.process_time
"""The clock of all measurements [s]: time of the cores, of all threads together. On an idle machine
it is the wall time of our single thread; other programs that take the cores do not count."""


def timed(call: Callable[..., Any], *arguments: Any, **named: Any) -> tuple[Any, float]:
    """Return what a call gives, and the time that it took [s]."""
    began = cpu_time()
    found = call(*arguments, **named)
    return found, cpu_time() - began


@dataclass(frozen=True)
class Race:
    """Times of contestants that took turns.

    Attributes
    ----------
    times : mapping of str to (rounds,)
        Time per call [s], round by round.
    """

    times: Mapping[str, np.ndarray]

    def median(self, name: str) -> float:
        """Median time per call [s]."""
        return float(np.median(self.times[name]))

    def lead(self, name: str, peer: str) -> float:
        """How many times faster `name` is than `peer`: the median of the rounds' ratios."""
        return float(np.median(self.times[peer] / self.times[name]))


def race(contestants: Mapping[str, Callable[[], object]], seconds: float) -> Race:
    """Time contestants in turns for about `seconds` in all; the first call of each is not timed."""
    batch = {}
    for name, call in contestants.items():
        call()
        began = cpu_time()
        call()
        batch[name] = max(1, math.ceil(BATCH_S / max(cpu_time() - began, 1e-9)))
    times: dict[str, list[float]] = {name: [] for name in contestants}
    deadline = time.perf_counter() + seconds
    rounds = 0
    while rounds < LEAST_ROUNDS or time.perf_counter() < deadline:
        rounds += 1
        for name, call in contestants.items():
            began = cpu_time()
            for _ in range(batch[name]):
                call()
            times[name].append((cpu_time() - began) / batch[name])
    return Race({name: np.array(values) for name, values in times.items()})
