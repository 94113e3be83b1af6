"""Basin hopping: a series of local searches. Each search begins at a perturbation of the best
result or at a fresh start. The series ends when a result is good enough."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

Start = TypeVar("Start")
Result = TypeVar("Result")


def basin_hopping(
    propose: Callable[[int, Result, bool], Start],
    attempt: Callable[[Start, int], tuple[Result, float, int, bool]],
    begin: Start,
    tries: int,
    fresh: bool = False,
) -> tuple[Result, int]:
    """Return the best result, and the total number of steps.

    Parameters
    ----------
    propose : function
        Function that returns a start. Its arguments are the number of the start, the best result,
        and whether to return a fresh start instead of a perturbation of this result.
    attempt : function
        Local search. Its arguments are a start and the number of the start. The search returns the
        result, its cost, the number of steps, and whether the result is good enough.
    begin : object
        First start.
    tries : int
        Maximum number of starts.
    fresh : bool
        Whether the second start is a fresh one.
    """
    best, least, steps, enough = attempt(begin, 0)
    for number in range(1, tries):
        if enough:
            break
        result, cost, more, enough = attempt(propose(number, best, fresh), number)
        steps, fresh = steps + more, not fresh
        if enough or cost < least:
            best, least = result, cost
    return best, steps
