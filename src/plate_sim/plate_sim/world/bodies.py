"""All parts through cycles of the plate: friction, then contacts, step by step.

One model serves every scene. Parts are finite: friction acts all over a footprint, so they slide,
turn and stick; the plate's exact motion (equation (2) of the paper, with its pose) moves the
surface under them. Steps are of equal length; within them each part's friction is integrated in as
small ones as it needs (`friction.step`), and at their ends parts that touch collide (`contacts`).
What a scene does not have costs nothing: pairs are looked at only once they may have come near, and
parts that slide steadily are moved together.
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
from ..friction.checks import LARGEST, check_motion, for_each, friction_accel, pairs, whole
from ..friction.footprint import Footprint
from ..friction.step import BODY, LANES
from ..plate.ground import LEVEL, Ground
from ..plate.motion import PlateMotion
from ..plate.pieces import tabulate

STEP = 2e-4
"""Default longest integration step [s]: parts then move at most some 0.2 mm between contacts."""

SAMPLES = 64
"""Default output samples per cycle: eight in the shortest wave of a usual motion."""

START_OVERLAP = 0.1
"""Greatest overlap at the start, as a share of half the slimmer part's width."""

NO_POINTS = np.zeros((7, 0)), np.empty((0, 2), np.int64), np.empty((0, 5))
"""Mesh, pieces and corners of discs alone."""

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
    on_plate : (M,)
        Which parts are still on the plate at the end.
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
        """Split states (k, M, 6): x, y, angle and their rates."""
        return cls(
            time, states[..., :2], states[..., 2], states[..., 3:5], states[..., 5], on_plate
        )


class Shapes(NamedTuple):
    """What compiled code needs of the footprints of M parts; P columns as in a state.

    Attributes
    ----------
    bodies : (P, 10)
        `BODY` of the parts; the last is that of the walls, which nothing moves.
    discs : (4, P - 1)
        mu g [m/s2], squared radius and radius of gyration [m2], and 1 where there is a disc.
    mesh : (7, n)
        Points of all footprints but discs: x, y [m, part's axes], share of the weight, size of the
        cell (see `Footprint.blur`) [m], and the forces of the last step, a first guess of the next.
    pieces : (p, 2)
        First corner, and last + 1, of each convex piece of the rims of all parts but discs.
    corners : (c, 5)
        Place, outward normal of the side that begins there, in the parts' axes, and 1 if that side
        is part of the rim, or 0 if another piece of the part begins there.
    """

    bodies: np.ndarray
    discs: np.ndarray
    mesh: np.ndarray
    pieces: np.ndarray
    corners: np.ndarray

    @classmethod
    def of(cls, footprints: Sequence[Footprint], mu_g: np.ndarray) -> Shapes:
        """Put footprints one after the other, of parts with mu g of `mu_g` (M,) [m/s2]."""
        count = len(footprints)
        first = footprints[0] if count else None
        if first is not None and first.even and all(part is first for part in footprints):
            return cls._alike(first, mu_g)
        bodies = np.zeros(ceil(count / LANES) * LANES + 1, BODY)
        bodies["gyration2"] = 1.0
        mesh, corners, pieces = [np.empty((0, 4))], [np.empty((0, 5))], [np.empty((0, 2), np.int64)]
        point = piece = corner = 0
        for i, part in enumerate(footprints):
            outline = () if part.radius else part.outline
            bodies[i] = (
                0.0, *part.inertial, point, point + len(part.points), piece, piece + len(outline),
            )  # fmt: skip
            ends = corner + np.cumsum([0, *(len(p) for p in outline)])
            pieces.append(np.column_stack([ends[:-1], ends[1:]]))
            mesh.append(np.column_stack([part.points, part.weights, part.blur]))
            corners.append(part.corners)
            point, piece, corner = point + len(part.points), piece + len(outline), ends[-1]
        bodies["mu_g"][:count] = mu_g
        points = np.zeros((7, point))
        points[:4] = np.concatenate(mesh).T
        even = (bodies["radius"] > 0) & (bodies["first_point"] == bodies["end_point"])
        discs = np.array([bodies["mu_g"], bodies["radius"] ** 2, bodies["gyration2"], even])
        return cls(
            bodies.view(float).reshape(-1, 10), np.ascontiguousarray(discs[:, :-1]), points,
            np.concatenate(pieces), np.concatenate(corners),
        )  # fmt: skip

    @classmethod
    def _alike(cls, disc: Footprint, mu_g: np.ndarray) -> Shapes:
        """Return the same of discs that are all alike, in a fraction of the time."""
        count = len(mu_g)
        lanes = ceil(count / LANES) * LANES
        bodies, discs = np.zeros((lanes + 1, 10)), np.zeros((4, lanes))
        bodies[:, 1] = discs[2] = 1.0
        bodies[:count, 0] = discs[0, :count] = mu_g
        bodies[:count, 1:6] = disc.inertial
        discs[1, :count] = disc.radius * disc.radius
        discs[2, :count], discs[3, :count] = disc.gyration2, 1.0
        return cls(bodies, discs, *NO_POINTS)


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
    """Integrate the motion of finite parts.

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
        Output samples per cycle, by default `SAMPLES`; 0: the end alone.
    step : float
        Longest integration step [s].
    contacts : Contacts, optional
        How parts touch each other; if missing they never meet.
    ground : Ground
        Tilt, static friction, and friction that changes with the slip.
    half : (2,), optional
        Half sides of the plate [m]: a part whose centre passes its edge is gone, unless contacts
        have walls. If missing the plate is endless.

    Returns
    -------
    BodyTrajectory
        The start and every sample: k = cycles * samples + 1; or the end, k = 1.

    Raises
    ------
    PlateError
        If shapes disagree, a value is not finite, a count or coefficient is out of range, parts
        overlap at the start, or walls are asked for on an endless plate.
    """
    cycles = whole("cycles", cycles)
    check_motion(cycle, cycles)
    position = pairs("position", position)
    limit = friction_accel(friction, gravity, len(position))
    samples = SAMPLES if samples is None else samples
    if samples != 0:
        samples = whole("samples", samples)
    if contacts is not None and contacts.walls and half is None:
        raise PlateError("contacts have walls, allowed: none on an endless plate")
    every = equal_steps(cycle.period / max(1, samples), step)
    return job_of(
        cycle, footprint, limit, (position, angle, velocity, spin), np.ones(len(position), bool),
        gravity, contacts, ground, ENDLESS if half is None else half, every * max(1, samples),
        whole("cycles", cycles), every if samples else 0,
    ).run()  # fmt: skip


class Job(NamedTuple):
    """A call of the kernel, and what is needed to read its outcome.

    Attributes
    ----------
    arguments : tuple
        Of `_kernels.run`.
    order : (M,)
        Which part each of the kernel's is.
    names : sequence
        Of the parts, in messages.
    """

    arguments: tuple
    order: np.ndarray
    names: Sequence[Any]

    def run(self) -> BodyTrajectory:
        """Make the call."""
        return self.outcome(_kernels.run(*self.arguments))

    def outcome(self, overlap: tuple[int, int, float, float]) -> BodyTrajectory:
        """Return what has become of the parts, if the kernel found no overlap.

        Parameters
        ----------
        overlap : i, j, depth, share
            Parts that overlap most at the start, by how much [m], and as a share of the slimmer
            one: if that is more than `START_OVERLAP` nothing has moved.
        """
        i, j, depth, share = overlap
        if share > START_OVERLAP:
            first, second = sorted(str(self.names[self.order[k]]) for k in (i, j))
            raise PlateError(
                f"parts {first} and {second} overlap by {1e3 * depth:.3g} mm, "
                f"allowed: at most {1e3 * depth / share * START_OVERLAP:.3g} mm"
            )
        table, steps, cycles, every = self.arguments[:4]
        state, here, record = self.arguments[8], *self.arguments[-2:]
        back = np.argsort(self.order)
        period = table[-1, 1]
        if not len(record):
            end = state[:, back].T[None]
            return BodyTrajectory.of_states(np.array([period * cycles]), end, here[back])
        time = np.arange(len(record)) * (period / steps * every)
        return BodyTrajectory.of_states(time, record[:, back], here[back])


def job_of(
    motion: PlateCycle | PlateMotion,
    footprint: Footprint | Sequence[Footprint],
    limit: np.ndarray,
    start: tuple[np.ndarray, float | np.ndarray, np.ndarray, float | np.ndarray],
    on_plate: np.ndarray,
    gravity: float,
    contacts: Contacts | None,
    ground: Ground,
    half: np.ndarray,
    steps: int,
    cycles: int,
    every: int,
    ids: Sequence[str] | None = None,
) -> Job:
    """Return the call that advances finite parts through cycles of the plate's motion, in `steps`
    equal steps each; all is checked.

    Parts are sorted by place first: results do not depend on the order of their names. Parameters
    are those of `simulate_bodies`, and

    limit : (M,)
        mu g of each part [m/s2].
    start : tuple
        Position, angle, velocity, spin.
    on_plate : (M,)
        Which parts are there. One that is gone stays where it is, at rest, and touches nothing.
    every : int
        Steps from one recorded state to the next; 0: the end alone.
    ids : sequence of str, optional
        Names of the parts in messages, by default 0, 1, ...
    """
    check_motion(motion, cycles)
    started = _columns(*start)
    count = len(started)
    parts = [footprint] * count if isinstance(footprint, Footprint) else list(footprint)
    if len(parts) != count or not all(isinstance(part, Footprint) for part in parts):
        raise PlateError(f"footprint is a list of {len(parts)}, allowed: {count} Footprints, or 1")
    order = np.lexsort((started[:, 1], started[:, 0]))
    shapes = Shapes.of([parts[i] for i in order], limit[order])
    state = np.zeros((6, len(shapes.bodies)))
    state[:, :count] = started[order].T
    here = np.array(on_plate, bool)[order]
    record = np.empty((cycles * steps // every + 1 if every else 0, count, 6))
    touch = contacts or INELASTIC
    arguments = (
        tabulate(motion)[0], steps, cycles, max(every, 1), *ground.effect(gravity), state, *shapes,
        touch.restitution, touch.friction, contacts is not None, touch.walls, START_OVERLAP,
        np.asarray(half, float), here, record,
    )  # fmt: skip
    return Job(arguments, order, range(count) if ids is None else ids)


def _columns(
    position: np.ndarray, angle: float | np.ndarray, velocity: np.ndarray, spin: float | np.ndarray
) -> np.ndarray:
    """Return states (M, 6), checked."""
    count = len(position)
    pairs_are = np.shape(position) == np.shape(velocity) == (count, 2)
    if pairs_are and np.shape(angle) == np.shape(spin) == (count,):
        state = np.empty((count, 6))
        state[:, :2], state[:, 2], state[:, 3:5], state[:, 5] = position, angle, velocity, spin
        if np.abs(state).max(initial=0.0) <= LARGEST:
            return state
    position = pairs("position", position)  # says what is wrong
    count = len(position)
    velocity = pairs("velocity", velocity, count)
    angle, spin = for_each("angle", angle, count), for_each("spin", spin, count)
    return np.column_stack([position, angle, velocity, spin])


def equal_steps(time: float, step: float) -> int:
    """Return how many equal steps of at most `step` [s] fill a time [s]."""
    if not 0 < step < np.inf:
        raise PlateError(f"step is {step!r} s, allowed: a positive number")
    return max(1, ceil(time / step - 1e-9))
