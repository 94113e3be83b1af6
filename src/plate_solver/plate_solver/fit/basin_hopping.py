"""Basin hopping: fresh starts, and disturbances of what is already good, until one will do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from plate_core.kernels import constant

FIRST = constant(0)
"""Number of the first start."""

BETTER = 0.99
"""Cost over that of the round's best, below which a hop has helped: hops are counted anew."""

Propose = Callable[[Any, int, Any, bool], Any]
"""The number of the try, the find to hop from, and whether to begin afresh instead, to a start."""

Attempt = Callable[[Any, Any, int, float], tuple[Any, float, int, bool]]
"""A start, its number, and the least cost so far (infinite at first), to what is found from there,
its cost, the steps taken, and whether it will do."""


def basin_hopping(
    propose: Propose, attempt: Attempt
) -> Callable[[Any, Any, int, int, bool, int], tuple[Any, int, int]]:
    """Make a search of two functions: plain, or to be compiled with compiled ones.

    The search keeps the best find. It takes

    problem
        Given to both functions.
    begin
        The first start.
    tries : int
        Most starts.
    hops : int
        Hops in a row that may fail; then comes a fresh start.
    rounds : bool
        True: hops start from the best since the last fresh start, and one that helps gets `hops`
        more. False: hops start from the best of all.
    failed : int
        Hops that count as failed before the second start.

    and returns the best find, the steps of all starts, and how many these were.
    """

    def search(
        problem: Any, begin: Any, tries: int, hops: int, rounds: bool, failed: int
    ) -> tuple[Any, int, int]:
        tried = FIRST
        best, least, steps, enough = attempt(problem, begin, tried, np.inf)
        near, near_cost, tried = best, least, tried + 1
        while not enough and tried < tries:
            fresh = failed >= hops
            start = propose(problem, tried, near, fresh)
            found, cost, more, enough = attempt(problem, start, tried, least)
            steps += more
            tried += 1
            if enough or cost < least:
                best, least = found, cost
            helped = rounds and cost < BETTER * near_cost
            failed = 0 if fresh or helped else failed + 1
            if cost < near_cost or (fresh and rounds):
                near, near_cost = found, cost
        return best, steps, tried

    return search
