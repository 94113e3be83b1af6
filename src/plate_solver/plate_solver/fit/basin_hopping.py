"""Basin hopping: local searches from fresh starts and from perturbations of good results, until a
result is good enough."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from .. import _kernels

Propose = Callable[[Any, int, Any, bool], Any]
"""Function that returns a start. Arguments: problem, number of the try, result to perturb, and
whether to return a fresh start instead."""

Attempt = Callable[[Any, Any, int, float], tuple[Any, float, int, bool]]
"""Local search. Arguments: problem, start, its number, and the minimum cost so far (initially
infinite). Returns the result, its cost, the number of steps, and whether it is good enough."""


def basin_hopping(
    propose: Propose, attempt: Attempt
) -> Callable[[Any, Any, int, int, bool, int], tuple[Any, int, int]]:
    """Return a search function that uses the two given functions.

    The search function has the arguments

    problem
        Object passed to both functions.
    begin
        First start.
    tries : int
        Maximum number of starts.
    hops : int
        Number of consecutive failed hops before a fresh start.
    rounds : bool
        True: hops start from the best result since the last fresh start, and a successful hop
        resets the count of failures. False: hops start from the best result of all.
    failed : int
        Initial count of failed hops, before the second start.

    It returns the best result, the total number of steps, and the number of starts.
    """
    return partial(_kernels.basin_hopping, propose, attempt)
