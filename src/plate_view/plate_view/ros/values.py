"""Conversion of message values for JSON."""

from __future__ import annotations

import math


def state_names(kind: type, *names: str) -> dict[int, str]:
    """Return a mapping from the values of a message's constants to their names in lower case."""
    return {getattr(kind, name): name.lower() for name in names}


def finite_or_none(value: float) -> float | None:
    """Return a number, rounded to six decimals. Return None if the number is not finite."""
    if isinstance(value, int):
        return value
    return round(float(value), 6) if math.isfinite(value) else None
