"""Round parts on the moving plate: friction, collisions, and the plate's edge.

Parts are discs of equal mass and radius. Without walls, a part whose centre passes the plate's
edge is gone: it moves no more and touches nothing. Parts are sorted by place before anything
else, so that results do not depend on the order in which they are named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from plate_core import PlateCycle, PlateError

# numba does not see changes in these: delete the cache then
from .crowd import LANES, advance, drift_apart, fall, sample_motion
from .friction import LARGEST, Trajectory, friction_accel, pairs
from .ground import LEVEL, Ground
from .impacts import push_off, separate
from .neighbours import SKIN, by_place, near_pairs
from .plate_motion import PlateMotion

START_OVERLAP = 0.1
"""Greatest overlap at the start, as a share of the radius: less is left of a pressed crowd."""

GOOD, NOT_FINITE, OVERLAPPING = 0, 1, 2
"""What `run_discs` may find."""


@dataclass(frozen=True)
class Contacts:
    """How parts touch.

    Attributes
    ----------
    restitution : float
        Speed after over speed before along the line of centres: 0 to 1.
    friction : float
        Coulomb friction coefficient between rims: at least 0.
    walls : bool
        Whether walls around the plate, of the same restitution and friction, keep parts on it.

    Raises
    ------
    PlateError
        If a coefficient is out of range.
    """

    restitution: float = 0.0
    friction: float = 0.0
    walls: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.restitution <= 1:
            raise PlateError(f"contacts: restitution is {self.restitution!r}, allowed: 0 to 1")
        if not 0 <= self.friction <= LARGEST:
            raise PlateError(f"contacts: friction is {self.friction!r}, allowed: at least 0")


INELASTIC = Contacts()
"""Parts stop each other, rims do not rub, no walls."""


def check_found(found: tuple[int, int, int, float], ids: tuple[str, ...], radius: float) -> None:
    """Raise a PlateError if `run_discs` could not run."""
    problem, i, j, value = found
    if problem == NOT_FINITE:
        raise PlateError(
            f"part {ids[i]}: {'position' if j < 2 else 'velocity'} has {value!r}, "
            f"allowed: finite numbers up to {LARGEST:g}"
        )
    if problem == OVERLAPPING:
        first, second = sorted((ids[i], ids[j]))
        raise PlateError(
            f"parts {first} and {second} overlap by {1e3 * value:.3g} mm, "
            f"allowed: at most {1e3 * START_OVERLAP * radius:.3g} mm"
        )


def motion_of(cycle: PlateCycle | PlateMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return knots (K + 1,) [s] and powers (K, 6, 3) of the plate's motion."""
    return cycle.times, cycle.coefficients


def simulate_discs(
    cycle: PlateCycle | PlateMotion,
    position: np.ndarray,
    velocity: np.ndarray,
    friction: float | np.ndarray,
    radius: float,
    half: np.ndarray,
    contacts: Contacts = INELASTIC,
    *,
    gravity: float = 9.81,
    ground: Ground = LEVEL,
    steps: int,
    cycles: int = 1,
    record: bool = True,
) -> tuple[Trajectory, np.ndarray]:
    """Move discs that meet, in equal steps.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate, repeated; a PlateMotion is run once.
    position, velocity : (M, 2)
        At the start [m], [m/s], plate_home.
    friction : float or (M,)
        Friction coefficient mu of the plate, for all discs or each.
    radius, half : float, (2,)
        Of all discs, and half sides of the plate [m].
    contacts : Contacts
        How discs touch.
    gravity, ground : float, Ground
        [m/s2]; tilt and static friction.
    steps, cycles : int
        Steps in a cycle, and how often it is run.
    record : bool
        Whether all steps are wanted, or only the end.

    Returns
    -------
    run, on_plate : Trajectory, (M,)
        The start and every step, or the end alone; which discs are still on the plate.

    Raises
    ------
    PlateError
        If shapes disagree, a value is not finite or out of range, or discs overlap at the start.
    """
    if min(steps, cycles) < 1 or (cycles > 1 and not isinstance(cycle, PlateCycle)):
        raise PlateError(
            f"steps is {steps!r}, cycles is {cycles!r}, allowed: at least 1; 1 cycle of a motion "
            "that need not close"
        )
    position = pairs("position", position)
    velocity = pairs("velocity", velocity, len(position))
    limit = friction_accel(friction, gravity, len(position))
    on_plate = np.ones(len(position), bool)
    path, speed = np.empty((2, cycles * steps + 1 if record else 0, *position.shape))
    found = run_discs(
        *motion_of(cycle), steps, cycles, limit, ground.pull(gravity), ground.static_ratio, radius,
        half, contacts.restitution, contacts.friction, contacts.walls, position, velocity,
        on_plate, path, speed,
    )  # fmt: skip
    check_found(found, tuple(str(i) for i in range(len(position))), radius)
    if not record:
        run = Trajectory(np.array([cycles * cycle.period]), position[None], velocity[None])
        return run, on_plate
    return Trajectory(np.arange(len(path)) * (cycle.period / steps), path, speed), on_plate


@njit(cache=True)
def run_discs(
    times, pieces, steps, cycles, limit, pull, ratio, radius, half, bounce, rub, walls, position,
    velocity, on_plate, path, speed,
):  # fmt: skip
    """Advance discs through cycles of the plate, in place.

    Parameters
    ----------
    times, pieces : (K + 1,), (K, 6, 3)
        The plate's motion, from `motion_of`.
    steps, cycles : int
        Equal steps in a cycle, and cycles.
    limit : (M,)
        mu g of each part [m/s2].
    pull, ratio : (2,), float
        Acceleration of parts without friction [m/s2], and static over dynamic friction.
    radius : float
        Of all parts [m]; 0 means that they never touch.
    half : (2,)
        Half sides of the plate [m].
    bounce, rub, walls : float, float, bool
        Restitution and friction of contacts; whether the plate has walls.
    position, velocity : (M, 2)
        Parts in plate_home; changed.
    on_plate : (M,)
        Which parts are there; changed.
    path, speed : (k, M, 2) or (0, M, 2)
        Every (cycles * steps / (k - 1), rounded up)th step, and the last.
        Filled with the motion, unless empty.

    Returns
    -------
    problem, i, j, value : int, int, int, float
        One of `GOOD`, `NOT_FINITE`, `OVERLAPPING`; the parts, or part and column, and the value.
    """
    for i in range(len(position)):
        for d in range(4):
            value = position[i, d] if d < 2 else velocity[i, d - 2]
            if not abs(value) <= LARGEST:
                return NOT_FINITE, i, d, value
    who = np.flatnonzero(on_plate)
    # Sorted roughly, then exactly: equal x are common, and quick sorts leave them in any order.
    who = who[np.argsort(position[who, 0])]
    by_place(position, who)
    room = (len(who) + LANES - 1) // LANES * LANES
    discs, work = np.zeros((5, room)), np.empty((12, room))
    for column in range(room if len(who) else 0):
        i = who[min(column, len(who) - 1)]
        discs[0, column], discs[1, column] = position[i]
        discs[2, column], discs[3, column] = velocity[i]
        discs[4, column] = limit[i]
    pose, twist = np.empty((2 * steps + 1, 3)), np.empty((2 * steps + 1, 3))
    sample_motion(times, pieces, 2 * steps, pose, twist)
    edge = np.empty(10)
    edge[6:8] = half
    step = times[-1] / steps
    x, y, u, v = discs[0], discs[1], discs[2], discs[3]
    count = len(who)
    order = np.arange(count)
    pairs, hits = np.empty((4 * room, 2), np.uint32), np.empty((4 * room, 2), np.uint32)
    found = 0
    tilted = pull[0] != 0 or pull[1] != 0
    gap = 0.0  # the least of all pairs when they were listed, at x0, y0 [m]
    x0, y0 = np.empty(room), np.empty(room)
    every = (cycles * steps + len(path) - 2) // (len(path) - 1) if len(path) > 1 else 1
    for k in range(cycles * steps):
        if len(path) and k % every == 0:
            _write(x, y, u, v, who, count, position, velocity)
            path[k // every], speed[k // every] = position, velocity
        if count == 0:
            continue
        row = 2 * (k % steps)
        if radius > 0 and k == 0:
            pairs, found, gap = near_pairs(x, y, order[:count], radius, pairs, x0, y0, work)
            worst, i, j = _deepest(x, y, radius, pairs, found)
            if worst > START_OVERLAP * radius:
                return OVERLAPPING, who[i], who[j], worst
        advance(discs, work, pose, twist, row, step, pull, ratio)
        if tilted:
            fall(discs, pull, step)
        for d in range(3):
            edge[d], edge[3 + d] = pose[row + 2, d], twist[row + 2, d]
        edge[8], edge[9] = np.cos(edge[2]), np.sin(edge[2])
        apart = True
        if radius > 0 and count > 1:
            drift = drift_apart(x, y, x0, y0, count)
            if drift >= SKIN * radius:
                pairs, found, gap = near_pairs(x, y, order[:count], radius, pairs, x0, y0, work)
                drift = 0.0
            apart = drift < gap
            if not apart:
                if len(hits) < len(pairs):
                    hits = np.empty(pairs.shape, np.uint32)
                separate(discs, count, radius, pairs, found, hits, edge, walls, bounce, rub, step)
        if walls and apart:
            push_off(discs, count, radius, edge, bounce, rub, step)
        if not walls and _outside(x, y, count, edge) > 0:
            _write(x, y, u, v, who, count, position, velocity)
            left = _drop(discs, who, count, edge, position, velocity, on_plate)
            if left < count:
                count, order = left, np.arange(left)
                if radius > 0:
                    pairs, found, gap = near_pairs(x, y, order, radius, pairs, x0, y0, work)
    _write(x, y, u, v, who, count, position, velocity)
    if len(path):
        path[-1], speed[-1] = position, velocity
    return GOOD, 0, 0, 0.0


@njit(cache=True)
def _deepest(x, y, radius, pairs, found):
    """Return the deepest overlap [m] in a list, and its parts."""
    worst, first, second = 0.0, 0, 0
    for k in range(found):
        i, j = pairs[k, 0], pairs[k, 1]
        depth = 2 * radius - np.sqrt((x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2)
        if depth > worst:
            worst, first, second = depth, i, j
    return worst, first, second


@njit(cache=True)
def _write(x, y, u, v, who, count, position, velocity):
    """Write discs to where their parts stand."""
    for column in range(count):
        i = who[column]
        position[i, 0], position[i, 1] = x[column], y[column]
        velocity[i, 0], velocity[i, 1] = u[column], v[column]


@njit(cache=True, fastmath={"nsz", "nnan"})
def _outside(x, y, count, edge):
    """Greatest distance [m] of a centre beyond the plate's edge; negative inside."""
    c, s = edge[8], edge[9]
    worst = -1e300
    for i in range(count):
        rx, ry = x[i] - edge[0], y[i] - edge[1]
        worst = max(worst, abs(c * rx + s * ry) - edge[6], abs(c * ry - s * rx) - edge[7])
    return worst


@njit(cache=True)
def _drop(discs, who, count, edge, position, velocity, on_plate):
    """Take parts whose centre is beyond the edge off the plate; returns how many are left."""
    left = 0
    for column in range(count):
        if _outside(discs[0, column : column + 1], discs[1, column : column + 1], 1, edge) > 0:
            on_plate[who[column]] = False
            velocity[who[column]] = 0.0
            continue
        discs[:, left] = discs[:, column]
        who[left] = who[column]
        left += 1
    for column in range(left, discs.shape[1]):
        discs[:4, column] = discs[:4, max(left - 1, 0)]
    return left
