"""Cases of `tools/robustness.py`. Each has `run(logs, ...)`, which yields an `Outcome` after every
step; its other arguments are the case's options.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from plate_core import PlateError


@dataclass(frozen=True)
class Outcome:
    """Result of a case up to the present step.

    Attributes
    ----------
    result : object
        For JSON.
    line : str
        Printed at once; empty: nothing.
    well : bool
        Whether the case has passed, if this outcome is the last one.
    text : str
        Printed at the end if this outcome is the last one; empty: the result as JSON.
    """

    result: Any
    line: str = ""
    well: bool = False
    text: str = ""


def chosen(nodes: Iterable[str], known: Iterable[str]) -> list[str]:
    """Return the given nodes, or all known ones if none is given.

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
