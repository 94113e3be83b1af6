"""Method B's search for a motion, compiled from the first guess to the finished spline.

Starts are, in this order: those given; then rounds of one fresh guess and disturbances of the best
motion that the round has found. A fresh guess is led to a far request by continuation, in shares
that grow to the whole. What is found is made a spline within the rig's limits, and its forces are
judged on that spline, by a quadrature that the search has not used.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from .force_map import spline_force
from .harmonic_fit import (
    FIRST_DAMPING,
    WARM_DAMPING,
    Desk,
    Motions,
    condition_of,
    descend,
    desk_for,
    force_error,
    full_amplitude,
    product,
)
from .harmonic_force import ADAPTIVE, FEW, FIRST, PANELS
from .packed import Finish, unpacked
from .solution import CERTAIN, exact_share

FEW_CANDIDATES = 12
"""Random motions that are tried at the parts' places for each fresh guess."""

HOPS, HOP = 12, 0.15
"""Disturbances in a row that may fail to better a round's motion, and their size relative to it."""

SURE = 0.7
"""Share of the allowed error that a motion may miss and not be corrected further."""

BETTER = 0.99
"""Squared error, over the best of the round, below which hops are counted anew."""

LEGS = 3
"""Equal shares in which a fresh guess is led to a request that others have not reached."""

LEG_STEPS, LEG_ERROR = 8, 0.03
"""Steps for a share, and the error that is left behind, over the size of the request."""


class Found(NamedTuple):
    """What `meet` finds.

    Attributes
    ----------
    theta : (3 h,)
        Parameters, at full amplitude.
    pose, twist, accel : (k + 1, 3)
        The motion at its knots.
    spline : (k, 6, 3)
        As `PlateCycle.coefficients`.
    error : (M, 2)
        Request minus force of this spline [mu m g].
    worst : float
        Greatest of them.
    condition : float
        Condition number of the forces' derivative by the parameters.
    iterations, tries : int
    """

    theta: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    accel: np.ndarray
    spline: np.ndarray
    error: np.ndarray
    worst: float
    condition: float
    iterations: int
    tries: int


@njit(cache=True)
def meet(
    firsts: np.ndarray,
    pool: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    numbers: np.ndarray,
    shapes: np.ndarray,
    tolerance: float,
    iterations: int,
    tries: int,
) -> Found:
    """Find a motion with the wanted average forces; parameters as in `search` and `Packed`.

    Two dips may be taken for one by the search's quadrature. Where the judge sees more error than
    is allowed, the motion is corrected on panels, and if need be the search done anew.
    """
    motions, finish, room = unpacked(numbers, shapes)
    theta, error, jacobian, done, tried = search(
        firsts, pool, position, velocity, force, motions, tolerance, iterations, tries, room
    )
    found = _finished(theta, jacobian, position, velocity, force, motions, finish, done, tried)
    if found.worst > tolerance and np.max(np.abs(error)) <= tolerance:
        theta, error, jacobian, more = descend(
            theta, position, velocity, force, motions, PANELS, tolerance / 3, iterations,
            WARM_DAMPING, desk_for(motions.waves, room),
        )  # fmt: skip
        done += more
        found = _finished(theta, jacobian, position, velocity, force, motions, finish, done, tried)
    if found.worst > tolerance and np.max(np.abs(error)) <= tolerance:  # from other starts
        theta, error, jacobian, more, others = search(
            pool[:0], pool[::-1].copy(), position, velocity, force, motions, tolerance,
            iterations, tries, room,
        )  # fmt: skip
        done, tried = done + more, tried + others
        found = _finished(theta, jacobian, position, velocity, force, motions, finish, done, tried)
    return found


@njit(cache=True)
def _finished(
    theta: np.ndarray,
    jacobian: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    finish: Finish,
    iterations: int,
    tries: int,
) -> Found:
    """Make parameters a spline within the limits, and judge it."""
    own = theta.reshape(-1, 3) * motions.waves.scale
    third = len(finish.hull) // 3
    for _ in range(4):  # turning enters with its square: nearly linear in the scale
        hull = product(finish.hull, own)
        share = exact_share(
            hull[:third], hull[third : 2 * third], hull[2 * third :],
            finish.points, finish.directions, motions.half, finish.limits,
        )  # fmt: skip
        if share <= CERTAIN:
            break
        own *= 0.9999 * CERTAIN / share
    spline = product(finish.spline, own).reshape(-1, 6, 3)
    got = np.empty_like(force)
    spline_force(finish.times, spline, position, velocity, got)
    error = force - got
    pose, twist = product(finish.pose, own), product(finish.twist, own)
    accel = product(finish.accel, own)
    pose[-1], twist[-1], accel[-1] = pose[0], twist[0], accel[0]  # to the last bit
    condition = condition_of(jacobian)
    worst = np.max(np.abs(error))
    return Found(theta, pose, twist, accel, spline, error, worst, condition, iterations, tries)


@njit(cache=True, fastmath=True, error_model="numpy")
def search(
    firsts: np.ndarray,
    pool: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    tolerance: float,
    iterations: int,
    tries: int,
    room: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Try starts until one leads to the forces asked for; keep the best.

    Parameters
    ----------
    firsts : (F, 3 h)
        Starts that are tried first, as they are.
    pool : (S, 3 h)
        Random motions. A fresh guess is the best of the next `FEW_CANDIDATES`, forwards and
        backwards, at the parts' places; disturbances are taken from here too.
    tolerance : float
        Greatest error that is allowed [mu m g].
    iterations : int
        Most steps from one start.
    tries : int
        Most starts.
    room : (5, n)
        To write on: at least the nodes of the finest grid.

    Returns
    -------
    theta, error, jacobian, iterations, tries
        As `descend`, at full amplitude; iterations of all tries together.
    """
    waves = motions.waves
    desk = desk_for(waves, room)
    best_cost = near_cost = np.inf
    best = (pool[0], np.empty(0), np.empty((0, 0)))
    near = pool[0]
    total, turn, failed = 0, 0, HOPS
    for tried in range(tries):
        fresh = failed == HOPS
        if tried < len(firsts):
            start = firsts[tried]
        elif fresh:
            start = _most_like(pool, turn, position, velocity, force, motions, desk)
            turn = (turn + FEW_CANDIDATES) % len(pool)
            if tried:
                start, done = _led(start, position, velocity, force, motions, desk)
                total += done
        else:
            size = HOP * sqrt(np.sum(near * near) / len(near))
            start = near + size * pool[tried % len(pool)]
        known = tried < len(firsts)
        theta, error, jacobian, done = descend(
            start, position, velocity, force, motions, ADAPTIVE if known else FIRST,
            tolerance / 3, iterations, WARM_DAMPING if known else FIRST_DAMPING, desk,
        )  # fmt: skip
        total += done
        cost, worst = np.sum(error * error), np.max(np.abs(error))
        if worst <= tolerance or cost < best_cost:  # equal steps may have missed a dip
            cost = force_error(
                theta, position, velocity, force, waves, ADAPTIVE, error, desk.none, desk
            )
            if worst <= 30 * tolerance and np.max(np.abs(error)) > SURE * tolerance:
                theta, error, jacobian, done = descend(
                    theta, position, velocity, force, motions, ADAPTIVE, tolerance / 3,
                    iterations, WARM_DAMPING, desk,
                )  # fmt: skip
                total += done
                cost = np.sum(error * error)
        if cost < best_cost:
            best_cost, best = cost, (theta, error, jacobian)
        if np.max(np.abs(best[1])) <= tolerance:
            tries = tried + 1
            break
        failed = 0 if fresh or cost < BETTER * near_cost else failed + 1
        if fresh or cost < near_cost:
            near, near_cost = theta, cost
    return full_amplitude(best[0], motions), best[1], best[2], total, tries


@njit(cache=True, fastmath=True, error_model="numpy")
def _led(
    theta: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    desk: Desk,
) -> tuple[np.ndarray, int]:
    """Lead a motion through smaller shares of a request, roughly; also return the steps."""
    total = 0
    left = LEG_ERROR * sqrt(np.sum(force * force) / force.size)
    for leg in range(1, LEGS):
        theta, _, _, done = descend(
            theta, position, velocity, force * leg / LEGS, motions, FIRST, left, LEG_STEPS,
            FIRST_DAMPING, desk,
        )  # fmt: skip
        total += done
    return theta, total


@njit(cache=True, fastmath=True, error_model="numpy")
def _most_like(
    starts: np.ndarray,
    first: int,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    desk: Desk,
) -> np.ndarray:
    """Return the next start, or its opposite, whose forces are nearest to those asked."""
    error, none = np.empty(2 * len(position)), np.empty((0, 0))
    asked = np.sum(force * force)
    least, index, sign = np.inf, first, 1.0
    moving, waves = bool(np.any(velocity != 0.0)), motions.waves
    for i in range(first, min(first + FEW_CANDIDATES, len(starts))):
        theta = full_amplitude(starts[i], motions) if moving else starts[i]
        cost = force_error(theta, position, velocity, force, waves, FEW, error, none, desk)
        if cost < least:
            least, index, sign = cost, i, 1.0
        along = 0.0
        for k in range(len(error)):
            along += error[k] * force[k // 2, k % 2]
        # |f - e|: with g = f - error the force got, |f + g|^2 = |f - g|^2 + 4 f.g
        opposite = cost + 4 * (asked - along)
        if opposite < least:
            least, index, sign = opposite, i, -1.0
    return sign * starts[index]
