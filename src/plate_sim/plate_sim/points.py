"""Trajectories of point parts: what is asked for is checked, and one of two integrators runs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from plate_core import PlateCycle, PlateError

from .checks import check_motion, whole
from .exact import run_points
from .friction import LARGEST, Trajectory, friction_accel, pairs, run_steps, surface_samples
from .ground import LEVEL, Ground
from .line import tabulate_line
from .motion import tabulate
from .plate_motion import PlateMotion

TOLERANCE = 1e-7
"""Default error of the displacement in one cycle [m]: a ten-thousandth of a pixel."""

SAMPLES = 64
"""Default output samples per cycle: eight in the shortest wave of a usual motion."""


def simulate(
    cycle: PlateCycle | PlateMotion,
    position: np.ndarray,
    velocity: np.ndarray,
    friction: float | np.ndarray,
    gravity: float = 9.81,
    cycles: int = 1,
    samples: int | None = None,
    tolerance: float | None = None,
    *,
    ground: Ground = LEVEL,
) -> Trajectory:
    """Integrate the stick-slip motion of point parts that never meet, on an endless plate.

    By default event by event, for an error of `TOLERANCE` in each cycle, and exactly where parts
    slip along a line. With `samples` alone, in that many equal steps of first order.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate, repeated; a PlateMotion, which need not close, runs once.
    position, velocity : (M, 2)
        Parts at the start of the first cycle [m], [m/s], plate_home.
    friction : float or (M,)
        Friction coefficient mu, of all parts or of each.
    gravity : float
        [m/s2].
    cycles : int
        How often the cycle is run.
    samples : int, optional
        Samples per cycle: the integration steps where no tolerance is given, else output only,
        by default `SAMPLES`.
    tolerance : float, optional
        Wanted error of the displacement in one cycle [m].
    ground : Ground
        Static friction and tilt.

    Returns
    -------
    Trajectory
        The start and every sample: k = cycles * samples + 1.

    Raises
    ------
    PlateError
        If shapes disagree, a value is not finite, or a count or coefficient is out of range.
    """
    cycles = whole("cycles", cycles)
    check_motion(cycle, cycles)
    position = pairs("position", position)
    velocity = pairs("velocity", velocity, len(position))
    limit = friction_accel(friction, gravity, len(position))
    exact = samples is None or tolerance is not None
    samples = whole("samples", SAMPLES if samples is None else samples)
    path, speed = np.empty((2, cycles * samples + 1, len(position), 2))
    path[0], speed[0] = position, velocity
    pull, static = ground.pull(gravity), ground.static_ratio
    checked = np.ones(len(position), bool)
    if exact:
        tolerance = _tolerance(TOLERANCE if tolerance is None else tolerance)
        tables = _tables(cycle, pull)
        run_points(*tables, limit, static, tolerance, cycles, path, speed, checked)
    else:
        pose, twist = surface_samples(cycle, samples)
        run_steps(pose, twist, cycle.period / samples, limit, static, pull, path, speed)
    unchecked = () if checked.all() else tuple(np.flatnonzero(~checked).tolist())
    return Trajectory(np.arange(len(path)) * (cycle.period / samples), path, speed, unchecked)


def _tables(
    cycle: PlateCycle | PlateMotion, pull: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the tables of a motion for `run_points`; those of the last one are kept."""
    global _kept
    of, under, tables = _kept  # at once: another thread may replace it
    if of is not cycle or under[0] != pull[0] or under[1] != pull[1]:
        table, scales = tabulate(cycle, pull)
        if not scales.max() <= LARGEST:
            raise PlateError(f"cycle accelerates by {scales.max():g}, allowed: up to {LARGEST:g}")
        tables = table, tabulate_line(table, scales), scales
        _kept = cycle, pull, tables
    return tables


_kept: tuple[Any, ...] = (None, None, None)


def simulate_many(
    cycle: PlateCycle | PlateMotion | Sequence[PlateCycle | PlateMotion],
    position: Sequence[np.ndarray] | np.ndarray,
    velocity: Sequence[np.ndarray] | np.ndarray,
    friction: float | Sequence[float | np.ndarray] | np.ndarray,
    *,
    workers: int | None = None,
    **options: Any,
) -> list[Trajectory]:
    """Simulate many scenes at once, on all processors; results do not depend on how many.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion, or S of them
        Motion of the plate, of all scenes or of each.
    position, velocity : (S, M, 2), or S arrays (M, 2)
        Parts of each scene [m], [m/s], plate_home.
    friction : float, or S floats or arrays (M,)
        Friction coefficients, of all scenes or of each.
    workers : int, optional
        Threads; by default as many as there are processors.
    **options
        gravity, cycles, samples, tolerance, ground: as for `simulate`, the same for all scenes.

    Returns
    -------
    list of Trajectory
        One per scene, in their order.

    Raises
    ------
    PlateError
        If the numbers of scenes disagree, or `simulate` refuses one: the message names it.
    """
    count = len(position)
    alike = not isinstance(friction, Sequence) and np.ndim(friction) == 0
    scenes: dict[str, Any] = {
        "cycle": [cycle] * count if isinstance(cycle, PlateCycle | PlateMotion) else cycle,
        "position": position,
        "velocity": velocity,
        "friction": [friction] * count if alike else friction,
    }
    for name, each in scenes.items():
        if len(each) != count:
            raise PlateError(f"{name} has {len(each)} scenes, allowed: {count} as position has")

    def run(scene: int) -> Trajectory:
        try:
            return simulate(**{name: each[scene] for name, each in scenes.items()}, **options)
        except PlateError as error:
            raise PlateError(f"scene {scene}: {error}") from error

    workers = whole("workers", (os.cpu_count() or 1) if workers is None else workers)
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(run, range(count)))


def _tolerance(value: float) -> float:
    if not 0 < value <= LARGEST:
        raise PlateError(f"tolerance is {value!r} m, allowed: a positive number")
    return float(value)
