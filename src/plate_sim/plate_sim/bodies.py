"""Finite parts on the moving plate: they slide, turn and stick by friction all over a footprint.

The plate's exact motion (equation (2) of the paper, with its pose) moves the surface under each
part. Steps are of equal length; within them each part's friction is integrated in as small ones as
it needs (`body_step`), and at their ends parts that touch knock against each other (`knocks`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from plate_core import PlateCycle, PlateError

from .body_run import START_OVERLAP, Shapes, run
from .checks import check_motion, whole
from .contacts import Contacts
from .footprint import Footprint
from .friction import LARGEST, friction_accel, pairs
from .ground import LEVEL, Ground
from .motion import tabulate
from .plate_motion import PlateMotion
from .points import SAMPLES

STEP = 2e-4
"""Default longest integration step [s]: parts then move at most some 0.2 mm between contacts."""

ENDLESS = np.full(2, np.inf)
"""Half sides of an endless plate [m]."""


@dataclass(frozen=True)
class BodyTrajectory:
    """Motion of M finite parts in plate_home.

    Attributes
    ----------
    time : (k,)
        Times [s], from 0.
    position, velocity : (k, M, 2)
        Of the centres of mass [m], [m/s].
    angle, spin : (k, M)
        [rad] (not wrapped), [rad/s]; counter-clockwise.
    """

    time: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray

    @classmethod
    def of_states(cls, time: np.ndarray, states: np.ndarray) -> BodyTrajectory:
        """Split states (k, M, 6): x, y, angle and their rates."""
        return cls(time, states[..., :2], states[..., 2], states[..., 3:5], states[..., 5])


def simulate_bodies(
    cycle: PlateCycle | PlateMotion,
    footprint: Footprint | Sequence[Footprint],
    position: np.ndarray,
    angle: float | np.ndarray,
    velocity: np.ndarray,
    spin: float | np.ndarray,
    friction: float | np.ndarray,
    gravity: float = 9.81,
    cycles: int = 1,
    samples: int | None = None,
    step: float = STEP,
    *,
    contacts: Contacts | None = None,
    ground: Ground = LEVEL,
) -> BodyTrajectory:
    """Integrate the motion of finite parts on an endless plate.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate; a PlateCycle is repeated.
    footprint : Footprint, or M of them
        Of all parts or of each.
    position, velocity : (M, 2)
        Centres of mass at the start of the first cycle [m], [m/s], plate_home.
    angle, spin : float or (M,)
        [rad], [rad/s].
    friction : float or (M,)
        Friction coefficient mu, of all parts or of each.
    gravity : float
        [m/s2].
    cycles : int
        How often the cycle is run.
    samples : int, optional
        Output samples per cycle, by default `points.SAMPLES`.
    step : float
        Longest integration step [s].
    contacts : Contacts, optional
        How parts touch each other; if missing they never meet.
    ground : Ground
        Tilt, and static friction.

    Returns
    -------
    BodyTrajectory
        The start and every sample: k = cycles * samples + 1.

    Raises
    ------
    PlateError
        If shapes disagree, a value is not finite, a count or coefficient is out of range, parts
        overlap at the start, or walls are asked for.
    """
    position = pairs("position", position)
    limit = friction_accel(friction, gravity, len(position))
    samples, cycles = (
        whole("samples", SAMPLES if samples is None else samples),
        whole("cycles", cycles),
    )
    check_motion(cycle, cycles)
    if contacts is not None and contacts.walls:
        raise PlateError("contacts have walls, allowed: none on an endless plate")
    every = _steps(cycle.period / samples, step)
    _, path = _run(
        cycle, footprint, limit, ground.pull(gravity), ground.static_ratio, contacts, ENDLESS,
        (position, angle, velocity, spin), np.ones(len(position), bool), samples * every, cycles,
        every, None,
    )  # fmt: skip
    return path


def run_bodies(
    motion: PlateCycle | PlateMotion,
    footprints: Footprint | Sequence[Footprint],
    limit: np.ndarray,
    pull: np.ndarray,
    static_ratio: float,
    contacts: Contacts | None,
    half: np.ndarray,
    position: np.ndarray,
    angle: float | np.ndarray,
    velocity: np.ndarray,
    spin: float | np.ndarray,
    on_plate: np.ndarray,
    step: float = STEP,
    cycles: int = 1,
    record: bool = False,
    ids: Sequence[str] | None = None,
) -> tuple[BodyTrajectory, np.ndarray, BodyTrajectory]:
    """Advance finite parts on a plate with edges, or walls, through cycles of its motion.

    Without walls a part whose centre passes the edge is gone: it stays there, at rest, and touches
    nothing. Parts are sorted by place first: results do not depend on the order of their names.

    Parameters
    ----------
    motion : PlateCycle or PlateMotion
        Motion of the plate; only a PlateCycle may be repeated.
    footprints : Footprint, or M of them
        Of all parts or of each.
    limit : (M,)
        mu g of each part [m/s2].
    pull : (2,)
        Acceleration of a part without friction [m/s2], from `Ground.pull`.
    static_ratio : float
        Static over dynamic friction.
    contacts : Contacts, optional
        How parts touch; if missing they never meet.
    half : (2,)
        Half sides of the plate [m].
    position, velocity : (M, 2)
        Centres of mass [m], [m/s], plate_home.
    angle, spin : float or (M,)
        [rad], [rad/s].
    on_plate : (M,)
        Which parts are there.
    step : float
        Longest step between contacts [s].
    cycles : int
        How often the motion is run.
    record : bool
        Whether to return the motion at every step.
    ids : sequence of str, optional
        Names of the parts in messages, by default 0, 1, ...

    Returns
    -------
    end : BodyTrajectory
        The state after the last cycle: arrays as described there, without the first axis.
    on_plate : (M,)
        Which parts are still there.
    path : BodyTrajectory
        The motion at every step, k = cycles * steps + 1; k = 0 unless `record`.

    Raises
    ------
    PlateError
        If shapes disagree, a value is not finite, or parts overlap at the start.
    """
    check_motion(motion, whole("cycles", cycles))
    end, path = _run(
        motion, footprints, np.asarray(limit, float), pull, static_ratio, contacts,
        np.asarray(half, float), (position, angle, velocity, spin), np.array(on_plate, bool),
        _steps(motion.period, step), cycles, 1 if record else 0, ids,
    )  # fmt: skip
    return end[0], end[1], path


def _run(motion, footprint, limit, pull, static_ratio, contacts, half, state, here, steps, cycles,
         every, ids):  # fmt: skip
    """Check a state, and run it in the order of places."""
    position = pairs("position", state[0])
    count = len(position)
    names = [str(i) for i in range(count)] if ids is None else list(ids)
    velocity = pairs("velocity", state[2], count)
    angle, spin = _each("angle", state[1], count), _each("spin", state[3], count)
    parts = [footprint] * count if isinstance(footprint, Footprint) else list(footprint)
    if len(parts) != count or not all(isinstance(part, Footprint) for part in parts):
        raise PlateError(f"footprint is a list of {len(parts)}, allowed: {count} Footprints, or 1")
    order = np.lexsort((position[:, 1], position[:, 0]))
    shapes = Shapes.of([parts[i] for i in order], limit[order])
    shapes.parts[:, :6] = np.column_stack([position, angle, velocity, spin])[order]
    table, _ = tabulate(motion)
    record = np.empty((cycles * steps // every + 1 if every else 0, count, 6))
    there = here[order]
    rules = (0.0, 0.0) if contacts is None else (contacts.restitution, contacts.friction)
    i, j, depth = run(
        table, steps, cycles, max(every, 1), np.array([*pull, static_ratio], float), shapes.parts,
        shapes.mesh, shapes.pieces, shapes.corners, contacts is not None, np.array(rules), half,
        contacts is not None and contacts.walls, there, record,
    )  # fmt: skip
    if depth > 0:
        first, second = sorted((names[order[i]], names[order[j]]))
        most = START_OVERLAP * min(parts[order[i]].slim, parts[order[j]].slim)
        raise PlateError(
            f"parts {first} and {second} overlap by {1e3 * depth:.3g} mm, "
            f"allowed: at most {1e3 * most:.3g} mm"
        )
    back = np.argsort(order)
    time = np.arange(len(record)) * (motion.period / steps * every)
    end = BodyTrajectory.of_states(np.array(motion.period * cycles), shapes.parts[back, :6])
    return (end, there[back]), BodyTrajectory.of_states(time, record[:, back])


def _steps(time: float, step: float) -> int:
    """Return how many equal steps of at most `step` [s] fill a time [s]."""
    if not 0 < step < np.inf:
        raise PlateError(f"step is {step!r} s, allowed: a positive number")
    return max(1, ceil(time / step - 1e-9))


def _each(name: str, value: float | np.ndarray, count: int) -> np.ndarray:
    array = np.asarray(value, dtype=float)
    if array.shape not in ((), (count,)):
        raise PlateError(f"{name} has shape {array.shape}, allowed: () or ({count},)")
    if not (np.abs(array) <= LARGEST).all():
        raise PlateError(f"{name} has values that are not finite: {array.tolist()}")
    return np.broadcast_to(array, (count,))
