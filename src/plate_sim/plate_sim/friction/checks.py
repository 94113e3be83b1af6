"""Checks of the integrators' arguments. The functions return arrays of the expected shape, or raise
errors that contain the name, the value and the allowed range of an argument."""

from __future__ import annotations

from numbers import Integral

import numpy as np

from plate_core import PlateCycle, PlateError
from plate_core.motion import REST_TOLERANCE

from ..plate.motion import PlateMotion

MAX_ABS = 1e60
"""Maximum absolute value of a state or coefficient. With this limit, products of such values are
finite."""


def whole(name: str, value: int) -> int:
    """Check that a count is a whole number of at least 1, and return the count."""
    if not isinstance(value, Integral) or value < 1:
        raise PlateError(f"{name} is {value!r}, allowed: a whole number, at least 1")
    return int(value)


def check_motion(cycle: PlateCycle | PlateMotion, cycles: int) -> None:
    """Raise an error if a motion of the plate is invalid, or if it is repeated although its end
    differs from its start."""
    if not isinstance(cycle, PlateCycle | PlateMotion):
        raise PlateError(f"cycle is a {type(cycle).__name__}, allowed: a PlateCycle or PlateMotion")
    if isinstance(cycle, PlateCycle):
        if cycles > 1 and not cycle.closes:
            pose, twist, accel = np.abs(cycle.state(-1) - cycle.state(0)).max(axis=1)
            max_m, max_rad = REST_TOLERANCE[0], REST_TOLERANCE[2]
            raise PlateError(
                f"cycles is {cycles}, allowed: 1, because the cycle does not close. Its end and "
                f"start differ by {pose:.3g} m or rad in pose, {twist:.3g} m/s or rad/s in "
                f"twist, {accel:.3g} m/s2 or rad/s2 in acceleration, allowed: {max_m:g} m and "
                f"{max_rad:g} rad, {1e2 * max_m:g} m/s and {1e2 * max_rad:g} rad/s, "
                f"{1e4 * max_m:g} m/s2 and {1e4 * max_rad:g} rad/s2"
            )
        return
    if cycles > 1:
        raise PlateError(f"cycles is {cycles}, allowed: 1 for a PlateMotion")
    finite = np.isfinite(cycle.coefficients).all(axis=(1, 2))
    if not finite.all():
        raise PlateError(f"piece {int(np.argmin(finite))} of the plate's motion is not finite")


def pairs(name: str, array: np.ndarray, count: int | None = None) -> np.ndarray:
    """Check that `array` has the shape (count, 2) and that its absolute values are at most
    `MAX_ABS`. Return a copy with the type float."""
    array = np.array(array, dtype=float)
    if array.ndim != 2 or array.shape[1] != 2 or (count is not None and len(array) != count):
        rows = "M" if count is None else count
        raise PlateError(f"{name} has shape {array.shape}, allowed: ({rows}, 2)")
    usable = np.abs(array) <= MAX_ABS  # False for NaN
    if not usable.all():
        part = int(np.argmin(usable.all(axis=1)))
        finite = "not finite" if not np.isfinite(array[part]).all() else "too large"
        raise PlateError(
            f"{name} has values that are {finite}: part {part} has {array[part].tolist()}, "
            f"allowed: up to {MAX_ABS:g}"
        )
    return array


def friction_accel(friction: float | np.ndarray, gravity: float, count: int) -> np.ndarray:
    """Return the maximum acceleration mu g that friction can give to each part (count,) [m/s2]."""
    mu = np.array(friction, dtype=float)
    if mu.shape not in ((), (count,)):
        raise PlateError(f"friction has shape {mu.shape}, allowed: () or ({count},)")
    if not 0 <= gravity <= MAX_ABS:
        raise PlateError(f"gravity is {gravity!r} m/s2, allowed: 0 to {MAX_ABS:g}")
    usable = (mu >= 0) & (mu <= MAX_ABS)  # False for NaN
    if not usable.all():
        part = int(np.argmin(usable))
        which = f" for part {part}" if mu.ndim else ""
        raise PlateError(f"friction is {mu.flat[part]:g}{which}, allowed: 0 to {MAX_ABS:g}")
    return mu * gravity if mu.ndim else np.full(count, float(mu) * gravity)


def for_each(name: str, value: float | np.ndarray, count: int) -> np.ndarray:
    """Convert a value to an array (count,) of finite numbers. The value is one number for all
    parts, or one number for each part."""
    array = np.asarray(value, dtype=float)
    if array.shape not in ((), (count,)):
        raise PlateError(f"{name} has shape {array.shape}, allowed: () or ({count},)")
    if not (np.abs(array) <= MAX_ABS).all():
        raise PlateError(f"{name} is {array.tolist()}, allowed: -{MAX_ABS:g} to {MAX_ABS:g}")
    return np.broadcast_to(array, (count,))
