"""Cases of `tools/robustness.py`.

Each module has a function `run(logs, ...)`, which yields an `Outcome` after every step. The other
arguments of this function are the options of the case.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from plate_core import PlateError


@dataclass(frozen=True)
class Outcome:
    """Result of a case up to the current step.

    Attributes
    ----------
    result : object
        Content of the JSON file with the results.
    line : str
        Line that is printed at once. If empty, nothing is printed.
    well : bool
        Whether the case has passed. Only the last outcome counts.
    text : str
        Text that is printed at the end if this outcome is the last one. If empty, the result is
        printed as JSON.
    """

    result: Any
    line: str = ""
    well: bool = False
    text: str = ""


def select_nodes(nodes: Iterable[str], known: Iterable[str]) -> list[str]:
    """Return the given nodes, or all known nodes if no node is given.

    Raises
    ------
    PlateError
        If a node is unknown.
    """
    known, nodes = list(known), list(nodes)
    for name in nodes:
        if name not in known:
            raise PlateError(f"node is {name!r}, allowed: {', '.join(known)}")
    return nodes or known
