"""Simulation of all parts during cycles of the plate. Each integration step computes friction
first, and then contacts.

The same model is used for all scenes. Friction acts on the whole footprint of a part, so that parts
slide, rotate and stick. The surface under the parts has the velocity of equation (2) of the paper,
with the actual pose of the plate. All steps have the same length. Within a step, the friction of
each part is integrated in as many substeps as necessary (`friction.step`). At the end of the step,
touching parts collide (`contacts`). Two parts are checked for contact only if they can have moved
close enough since their last check. Parts that slide without sticking during a step are computed
together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from plate_core import PlateCycle, PlateError

from .. import _kernels
from ..contacts import INELASTIC, Contacts
from ..friction.checks import MAX_ABS, check_motion, for_each, friction_accel, pairs, whole
from ..friction.footprint import Footprint
from ..friction.step import BODY
from ..plate.ground import LEVEL, Ground, GroundEffect
from ..plate.motion import PlateMotion

STEP = 2e-4
"""Default maximum integration step [s]. During one step, parts move by at most about 0.2 mm."""

SAMPLES = 64
"""Default number of output samples per cycle. For usual cycles, this number gives eight samples per
period of the highest harmonic."""

START_OVERLAP = 0.1
"""Maximum overlap of two parts at the start of a simulation, divided by half the width of the
slimmer part."""

COLUMNS: tuple[slice | int, ...] = slice(2), 2, slice(3, 5), 5
"""Indices of the columns that contain position, angle, velocity and spin in an array of states."""

ENDLESS = np.full(2, np.inf)
"""Half sides of a plate without edges [m]."""


@dataclass(frozen=True)
class BodyTrajectory:
    """Motion of M parts in plate_home.

    Attributes
    ----------
    time : (k,)
        Times since the start of the motion [s].
    position, velocity : (k, M, 2)
        Positions [m] and velocities [m/s] of the centres of mass.
    angle, spin : (k, M)
        Angles [rad] (not wrapped) and spins [rad/s], counter-clockwise.
    on_plate : (M,)
        Whether each part is still on the plate at the end.
    """

    time: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    on_plate: np.ndarray

    @classmethod
    def of_states(
        cls, time: np.ndarray, states: np.ndarray, on_plate: np.ndarray
    ) -> BodyTrajectory:
        """Split an array of states (k, M, 6) into position, angle, velocity and spin."""
        position, angle, velocity, spin = (states[..., columns] for columns in COLUMNS)
        return cls(time, position, angle, velocity, spin, on_plate)

    @classmethod
    def recorded(cls, record: np.ndarray, interval: float, on_plate: np.ndarray) -> BodyTrajectory:
        """Convert an array of states (k, M, 6), recorded at equal intervals [s], to a
        trajectory."""
        return cls.of_states(np.arange(len(record)) * interval, record, on_plate)


class Shapes(NamedTuple):
    """Footprints of M parts in the form that compiled code needs.

    Attributes
    ----------
    bodies : (M, 10)
        Record `BODY` for each part.
    mesh : (4, n)
        Points of all footprints except discs. The rows are x and y [m, part's axes], the fraction
        of the part's weight, and the size of the cell around the point [m] (see `Footprint.blur`).
    pieces : (p, 2)
        Index of the first corner, and index of the last corner + 1, for each convex piece of all
        outlines except discs.
    corners : (c, 5)
        Corners of the pieces in the part's axes. Columns 0 and 1 contain the position [m]. Columns
        2 and 3 contain the outward normal of the side that begins at the corner. Column 4 is 1 if
        this side belongs to the outline, and 0 if it adjoins another piece of the part.
    """

    bodies: np.ndarray
    mesh: np.ndarray
    pieces: np.ndarray
    corners: np.ndarray

    @classmethod
    def of(cls, footprints: Sequence[Footprint]) -> Shapes:
        """Concatenate footprints."""
        bodies = np.zeros(len(footprints), BODY)
        mesh, corners, pieces = [np.empty((0, 4))], [np.empty((0, 5))], [np.empty((0, 2), np.int64)]
        point = piece = corner = 0
        for i, part in enumerate(footprints):
            outline = () if part.radius else part.outline
            bodies[i] = (
                0.0, *part.inertial, point, point + len(part.points), piece, piece + len(outline),
            )  # fmt: skip
            if len(part.points):
                mesh.append(np.column_stack([part.points, part.weights, part.blur]))
                point += len(part.points)
            if outline:
                ends = corner + np.cumsum([0, *(len(p) for p in outline)])
                pieces.append(np.column_stack([ends[:-1], ends[1:]]))
                corners.append(part.corners)
                piece, corner = piece + len(outline), ends[-1]
        return cls(
            bodies.view(float).reshape(-1, 10), np.ascontiguousarray(np.concatenate(mesh).T),
            np.concatenate(pieces), np.concatenate(corners),
        )  # fmt: skip


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
    half: np.ndarray | None = None,
) -> BodyTrajectory:
    """Simulate the motion of parts on a plate.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate. Only a PlateCycle can be repeated.
    footprint : Footprint, or M of them
        One footprint for all parts, or one footprint for each part.
    position, velocity : (M, 2)
        Positions [m] and velocities [m/s] of the centres of mass at the start of the first cycle,
        plate_home.
    angle, spin : float or (M,)
        Angles [rad] and angular velocities [rad/s] at the start of the first cycle.
    friction : float or (M,)
        Friction coefficient mu: one number for all parts, or one number for each part.
    gravity : float
        Gravity [m/s2].
    cycles : int
        Number of cycles.
    samples : int, optional
        Number of output samples per cycle. 0 returns only the end. Default: `SAMPLES`.
    step : float
        Maximum integration step [s].
    contacts : Contacts, optional
        Contact parameters of the parts. Default: parts do not collide.
    ground : Ground
        Tilt, static friction, and dependence of friction on the slip speed.
    half : (2,), optional
        Half sides of the plate [m]. A part is removed if its centre crosses an edge, unless the
        contacts have walls. Default: a plate without edges.

    Returns
    -------
    BodyTrajectory
        Motion with k = cycles * samples + 1 samples, including the start. If `samples` is 0, the
        motion contains only the end, k = 1.

    Raises
    ------
    PlateError
        If shapes disagree, if a value is not finite, or if a count or coefficient is outside its
        range. Also if parts overlap at the start, or if the contacts have walls but the plate has
        no edges.
    """
    cycles = whole("cycles", cycles)
    check_motion(cycle, cycles)
    position = pairs("position", position)
    limit = friction_accel(friction, gravity, len(position))
    samples = SAMPLES if samples is None else samples
    if samples != 0:
        samples = whole("samples", samples)
    if contacts is not None and contacts.walls and half is None:
        raise PlateError(
            "contacts have walls on an unbounded plate, allowed: contacts without walls"
        )
    every = equal_steps(cycle.period / max(1, samples), step)
    count = len(position)
    parts = [footprint] * count if isinstance(footprint, Footprint) else list(footprint)
    if len(parts) != count or not all(isinstance(part, Footprint) for part in parts):
        raise PlateError(
            f"footprint is a list of {len(parts)}, allowed: one Footprint, or {count} of them"
        )
    states = check_starts([(position, angle, velocity, spin)])
    on_plate = np.ones((1, count), bool)
    steps = every * max(1, samples)
    record = run_plates(
        [cycle], [steps], Shapes.of(parts), states, on_plate, limit[None], [ground.effect(gravity)],
        contacts, ENDLESS if half is None else half, whole("cycles", cycles),
        every if samples else 0, range(count),
    )  # fmt: skip
    if not samples:
        return BodyTrajectory.of_states(np.array([cycle.period * cycles]), states, on_plate[0])
    return BodyTrajectory.recorded(record[0], cycle.period / steps * every, on_plate[0])


def run_plates(
    motions: Sequence[PlateCycle | PlateMotion],
    steps: Sequence[int],
    shapes: Shapes,
    states: np.ndarray,
    here: np.ndarray,
    limit: np.ndarray,
    grounds: Sequence[GroundEffect],
    contacts: Contacts | None,
    half: np.ndarray,
    cycles: int,
    every: int,
    names: Sequence[Any],
    threads: int = 1,
) -> np.ndarray:
    """Simulate the parts on N plates during cycles of the plates. The arrays `states` and `here`
    are modified. All plates have the same M parts.

    The kernel sorts the parts by position, so that the results do not depend on the order of the
    parts.

    Parameters
    ----------
    motions, steps, grounds : N of each
        Motion, number of equal integration steps per cycle, and surface of each plate.
    shapes : Shapes
    states : (N, M, 6)
        x [m], y [m], angle [rad] and their time derivatives. The array is modified.
    here : (N, M) bool
        Whether each part is on the plate. The array is modified. A removed part stays at rest at
        its place, and does not touch other parts.
    limit : (N, M)
        mu g of each part [m/s2].
    contacts, half
        The same as in `simulate_bodies`.
    every : int
        Number of steps between two recorded states. With 0, no states are recorded.
    names : M
        Names of the parts, for messages.
    threads : int
        Number of threads.

    Returns
    -------
    (N, k, M, 6)
        Recorded states at the start and after each group of `every` steps. If `every` is 0, k is 0.

    Raises
    ------
    PlateError
        If a motion is invalid, or if parts overlap at the start.
    """
    for motion in motions:
        check_motion(motion, cycles)
    frames = cycles * steps[0] // every + 1 if every else 0
    record = np.empty((len(states), frames, *states.shape[1:]))
    touch = contacts or INELASTIC
    overlap = _kernels.run(
        np.concatenate([motion.times for motion in motions]),
        np.concatenate([motion.coefficients for motion in motions]),
        np.array([[len(m.coefficients), n] for m, n in zip(motions, steps, strict=True)]),
        cycles, max(every, 1), np.array(grounds, float), states, limit, here, record, *shapes,
        touch.restitution, touch.friction, contacts is not None, touch.walls, START_OVERLAP,
        np.asarray(half, float), threads,
    )  # fmt: skip
    for i, j, depth, relative in overlap[overlap[:, 3] > START_OVERLAP]:
        first, second = sorted(str(names[int(k)]) for k in (i, j))
        raise PlateError(
            f"parts {first} and {second} overlap by {1e3 * depth:.3g} mm, "
            f"allowed: at most {1e3 * depth / relative * START_OVERLAP:.3g} mm"
        )
    return record


def check_starts(starts: Sequence[tuple[Any, Any, Any, Any]]) -> np.ndarray:
    """Check the initial states of the parts on N plates, and convert them to an array (N, M, 6).
    Each item of `starts` contains position, angle, velocity and spin of the parts, with the array
    shapes of `simulate_bodies`."""
    count = len(starts[0][0])
    shapes = (count, 2), (count,), (count, 2), (count,)
    fields = [np.asarray(column) for column in zip(*starts, strict=True)]
    if all(field.shape[1:] == shape for field, shape in zip(fields, shapes, strict=True)):
        states = np.empty((len(starts), count, 6))
        for columns, field in zip(COLUMNS, fields, strict=True):
            states[..., columns] = field
        if np.abs(states).max(initial=0.0) <= MAX_ABS:
            return states
    # At least one value is wrong. `_check_start` raises an error that names the wrong value.
    return np.stack([_check_start(*start) for start in starts])


def _check_start(
    position: np.ndarray, angle: float | np.ndarray, velocity: np.ndarray, spin: float | np.ndarray
) -> np.ndarray:
    """Check position, angle, velocity and spin of the parts, and convert them to an array (M,
    6)."""
    position = pairs("position", position)
    count = len(position)
    velocity = pairs("velocity", velocity, count)
    angle, spin = for_each("angle", angle, count), for_each("spin", spin, count)
    return np.column_stack([position, angle, velocity, spin])


def equal_steps(time: float, step: float) -> int:
    """Return the minimum number of equal steps into which the time `time` [s] is divided, if no
    step is longer than `step` [s]."""
    if not 0 < step < np.inf:
        raise PlateError(f"step is {step!r} s, allowed: a positive number")
    return max(1, ceil(time / step - 1e-9))
