"""Checks of what integrators are asked for, which they have in common."""

from __future__ import annotations

from numbers import Integral

import numpy as np

from plate_core import PlateCycle, PlateError

from .plate_motion import PlateMotion


def whole(name: str, value: int) -> int:
    """Return a count, checked to be a whole number of at least 1."""
    if not isinstance(value, Integral) or value < 1:
        raise PlateError(f"{name} is {value!r}, allowed: a whole number, at least 1")
    return int(value)


def check_motion(cycle: PlateCycle | PlateMotion, cycles: int) -> None:
    """Refuse what is no motion of the plate, and repeats of one that need not close."""
    if not isinstance(cycle, PlateCycle | PlateMotion):
        raise PlateError(f"cycle is a {type(cycle).__name__}, allowed: a PlateCycle or PlateMotion")
    if isinstance(cycle, PlateCycle):
        return
    if cycles > 1:
        raise PlateError(f"cycles is {cycles}, allowed: 1 for a PlateMotion, as it need not close")
    finite = np.isfinite(cycle.coefficients).all(axis=(1, 2))
    if not finite.all():
        raise PlateError(f"piece {int(np.argmin(finite))} of the plate's motion is not finite")
