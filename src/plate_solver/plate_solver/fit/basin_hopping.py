"""Basin hopping is a series of local searches from different starts. Each start is a perturbation
of the best result, or a new start that does not depend on it. The series ends when a result is good
enough."""

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
    expired: Callable[[], bool] = lambda: False,
) -> tuple[Result, int]:
    """Run local searches from several starts. Return the best result, and the total number of
    steps.

    Parameters
    ----------
    propose : function
        Function that returns a start. The arguments of the function are the number of the start,
        the best result, and a flag. If the flag is True, the function returns a new start,
        otherwise a perturbation of the best result.
    attempt : function
        Function that runs a local search. The arguments of the function are a start and the number
        of the start. The function returns the result, the cost of the result, the number of steps,
        and whether the result is good enough.
    begin : object
        First start.
    tries : int
        Maximum number of starts.
    fresh : bool
        Whether the second start is a new start instead of a perturbation. After that, both kinds
        alternate.
    expired : function
        Function that is called before each further start. If it returns True, the series ends.
    """
    best, min_cost, steps, enough = attempt(begin, 0)
    for number in range(1, tries):
        if enough or expired():
            break
        result, cost, more, enough = attempt(propose(number, best, fresh), number)
        steps, fresh = steps + more, not fresh
        if enough or cost < min_cost:
            best, min_cost = result, cost
    return best, steps
