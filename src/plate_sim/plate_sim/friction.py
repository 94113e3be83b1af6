"""Point parts on the moving plate in equal steps: Coulomb friction, slip and stick.

The surface under a part at P moves with v_s = O' + theta' x (P - O_s(t)), equation (2) of the
paper, with the plate's true pose and twist. Friction turns the part's velocity v towards v_s at
mu g, and holds it once the two agree (section 2.1). Away from v = v_s a step takes the direction
of friction at its middle: second order. Where |v_s - v| is so small that it may vanish within
the step, the step is split, and each piece is the implicit Coulomb step
v += clip_to_ball(v_s - v, mu g dt), which slips, sticks and reverses without overshooting. Static
friction may be greater: a part that sticks is held by it until the surface accelerates more. A
tilted plate pulls parts; a step is made in the frame that falls with them from the step's start.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numba import njit

from plate_core import PlateCycle, PlateError

from .plate_motion import PlateMotion

STEP = 5e-5
"""Default integration step [s]: travel within 0.05 % of exact at 4 to 20 times mu g."""

SPLIT = 16
"""Pieces of a step in which the slip may stop or reverse: 20 times less error, 20 % more time."""

LARGEST = 1e60
"""Greatest number that a state or a coefficient may have: its products stay finite."""

STUCK = 1e-3
"""A slip below this share of mu g dt counts as none: it comes from rounding, not from sliding."""


@dataclass(frozen=True)
class Trajectory:
    """Motion of M parts in plate_home.

    Attributes
    ----------
    time : (k,)
        Times [s], from 0.
    position : (k, M, 2)
        Positions [m].
    velocity : (k, M, 2)
        Velocities [m/s].
    unchecked : tuple of int
        Parts whose motion was too restless for the wanted tolerance: it was finished in coarse
        steps, with an error that is not known. Empty for all but freak motions.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    unchecked: tuple[int, ...] = ()


def default_steps(cycle: PlateCycle | PlateMotion, step: float = STEP) -> int:
    """Return how many equal steps of at most `step` [s] fill the cycle."""
    return max(1, int(np.ceil(cycle.period / step - 1e-9)))


def surface_samples(cycle: PlateCycle | PlateMotion, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose and twist (steps + 1, 3) of the plate at the ends of equal steps."""
    t = np.linspace(0, cycle.period, steps + 1)
    return np.ascontiguousarray(cycle.pose(t)), np.ascontiguousarray(cycle.twist(t))


def pairs(name: str, array: np.ndarray, count: int | None = None) -> np.ndarray:
    """Return a float copy of `array`, checked to be of shape (count, 2) and within `LARGEST`."""
    array = np.array(array, dtype=float)
    if array.ndim != 2 or array.shape[1] != 2 or (count is not None and len(array) != count):
        rows = "M" if count is None else count
        raise PlateError(f"{name} has shape {array.shape}, allowed: ({rows}, 2)")
    usable = np.abs(array) <= LARGEST  # a NaN is not
    if not usable.all():
        part = int(np.argmin(usable.all(axis=1)))
        finite = "not finite" if not np.isfinite(array[part]).all() else "too large"
        raise PlateError(
            f"{name} has values that are {finite}: part {part} has {array[part].tolist()}, "
            f"allowed: up to {LARGEST:g}"
        )
    return array


def friction_accel(friction: float | np.ndarray, gravity: float, count: int) -> np.ndarray:
    """Greatest acceleration mu g (count,) [m/s2] that friction gives each part."""
    mu = np.array(friction, dtype=float)
    if mu.shape not in ((), (count,)):
        raise PlateError(f"friction has shape {mu.shape}, allowed: () or ({count},)")
    if not 0 <= gravity <= LARGEST:
        raise PlateError(f"gravity is {gravity!r} m/s2, allowed: finite and at least 0")
    usable = (mu >= 0) & (mu <= LARGEST)  # a NaN is not
    if not usable.all():
        part = int(np.argmin(usable))
        which = f" for part {part}" if mu.ndim else ""
        raise PlateError(
            f"friction is {mu.flat[part]:g}{which}, allowed: finite and at least 0, "
            f"up to {LARGEST:g}"
        )
    return mu * gravity if mu.ndim else np.full(count, float(mu) * gravity)


@njit(cache=True, inline="always")
def friction_step(px, py, vx, vy, pose, twist, k, step, limit, static, pull_x, pull_y):
    """Advance one part from sample k to k + 1 of the plate's motion.

    Parameters are the part's position [m] and velocity [m/s], samples of the plate's pose and
    twist (n, 3), k, the step [s], mu g [m/s2], static over dynamic friction, and the pull down the
    tilt [m/s2]. Returns position and velocity.
    """
    kick = limit * step
    sx = twist[k, 0] - twist[k, 2] * (py - pose[k, 1])
    sy = twist[k, 1] + twist[k, 2] * (px - pose[k, 0])
    # Where the part will be to first order: v_s changes with that only by theta' dt^2.
    ex = twist[k + 1, 0] - twist[k + 1, 2] * (py + step * vy - pose[k + 1, 1]) - step * pull_x
    ey = twist[k + 1, 1] + twist[k + 1, 2] * (px + step * vx - pose[k + 1, 0]) - step * pull_y
    slip2 = (sx - vx) ** 2 + (sy - vy) ** 2
    slip2_end = (ex - vx) ** 2 + (ey - vy) ** 2
    # May the slip vanish within the step? Not if it is more than kick + |e - s| at both ends;
    # (a + b)^2 <= 2 a^2 + 2 b^2 saves the roots.
    reach2 = 2 * kick**2 + 2 * ((ex - sx) ** 2 + (ey - sy) ** 2)
    if slip2 > reach2 and slip2_end > reach2:
        dx, dy = 0.5 * (sx + ex) - vx, 0.5 * (sy + ey) - vy
        share = kick / sqrt(dx * dx + dy * dy)
        wx, wy = vx + share * dx, vy + share * dy
        px, py = px + step * 0.5 * (vx + wx), py + step * 0.5 * (vy + wy)
        vx, vy = wx, wy
    elif slip2 <= (STUCK * kick) ** 2 and slip2_end <= (static * kick) ** 2:
        # Riding on, at the place where it then is: else rounding would look like a slip.
        ex -= twist[k + 1, 2] * step * 0.5 * (ey - vy)
        ey += twist[k + 1, 2] * step * 0.5 * (ex - vx)
        px, py = px + step * 0.5 * (vx + ex), py + step * 0.5 * (vy + ey)
        vx, vy = ex, ey
    else:
        px, py, vx, vy = _split_step(px, py, vx, vy, sx, sy, ex, ey, step, kick, static)
    fall = 0.5 * step * step
    return px + fall * pull_x, py + fall * pull_y, vx + step * pull_x, vy + step * pull_y


@njit(cache=True)
def _split_step(px, py, vx, vy, sx, sy, ex, ey, step, kick, static):
    """Advance one part while the surface goes from velocity s to e, linear in time."""
    rx, ry = sx - vx, sy - vy
    stuck = rx * rx + ry * ry <= (STUCK * kick) ** 2
    piece, kick = step / SPLIT, kick / SPLIT
    grip2 = (static * kick) ** 2
    held = ((ex - sx) / SPLIT) ** 2 + ((ey - sy) / SPLIT) ** 2 <= grip2
    for j in range(1, SPLIT + 1):
        dx = sx + (ex - sx) * (j / SPLIT) - vx
        dy = sy + (ey - sy) * (j / SPLIT) - vy
        slip2 = dx * dx + dy * dy
        stuck = slip2 <= (grip2 if stuck else kick * kick)
        share = 1.0 if stuck else kick / sqrt(slip2)
        if held and rx * dx + ry * dy < 0:  # the slip has vanished on the way
            stuck, share = True, 1.0
        rx, ry = (1 - share) * dx, (1 - share) * dy
        wx, wy = vx + share * dx, vy + share * dy
        px += piece * 0.5 * (vx + wx)
        py += piece * 0.5 * (vy + wy)
        vx, vy = wx, wy
    return px, py, vx, vy


@njit(cache=True)
def run_steps(pose, twist, step, limit, static, pull, path, speed):
    """Fill path and speed (cycles * steps + 1, M, 2) from their first rows, step by step."""
    steps = len(pose) - 1
    for k in range(len(path) - 1):
        for i in range(path.shape[1]):
            px, py, vx, vy = friction_step(
                path[k, i, 0], path[k, i, 1], speed[k, i, 0], speed[k, i, 1],
                pose, twist, k % steps, step, limit[i], static, pull[0], pull[1],
            )  # fmt: skip
            path[k + 1, i, 0] = px
            path[k + 1, i, 1] = py
            speed[k + 1, i, 0] = vx
            speed[k + 1, i, 1] = vy
