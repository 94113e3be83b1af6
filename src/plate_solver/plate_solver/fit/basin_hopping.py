"""Basin hopping: fresh starts, and disturbances of what is already good, until one will do."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from .. import _kernels

Propose = Callable[[Any, int, Any, bool], Any]
"""The number of the try, the find to hop from, and whether to begin afresh instead, to a start."""

Attempt = Callable[[Any, Any, int, float], tuple[Any, float, int, bool]]
"""A start, its number, and the least cost so far (infinite at first), to what is found from there,
its cost, the steps taken, and whether it will do."""


def basin_hopping(
    propose: Propose, attempt: Attempt
) -> Callable[[Any, Any, int, int, bool, int], tuple[Any, int, int]]:
    """Make a search of two functions.

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
    return partial(_kernels.basin_hopping, propose, attempt)
