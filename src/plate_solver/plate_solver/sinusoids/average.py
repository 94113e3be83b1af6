"""Method B's inversion of the averaged map (3.2.3), compiled from first guess to finished spline.

Starts are, in this order: the last solution; then rounds of one fresh guess and disturbances of the
best motion that the round has found. A fresh guess is led to a far request by continuation, in
fractions that grow to the whole. What is found is made a spline within the rig's limits, and its
forces are judged on that spline, by a quadrature that the search has not used.

Scale and shift in time leave the averaged forces of parts at rest unchanged. Steps of least norm
are orthogonal to both, so none is wasted on them; the scale is spent on the limits: motions are
kept at full amplitude, where the parts' own velocities matter least.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from plate_core.kernels import constant, kernel

from ..fit import FIRST, Damping, Fit, basin_hopping, condition_of, levenberg_marquardt
from ..limits import CERTAIN, EQUAL_WEIGHT, HULL_WEIGHT, MARGIN, Limits, limit_use
from ..maps.mean_force import spline_force
from ..maps.sinusoid_force import (
    ADAPTIVE,
    FEW,
    PANELS,
    USUAL,
    Rules,
    force_of,
    force_rules,
    slip_at,
)
from .basis import SinusoidBasis

AFRESH = Damping(1.25e-3, 1e-9, 1e2, 8.0, 6.0, 6, 0.7)
NEAR = AFRESH._replace(first=1.25e-5)
"""Damping from a fresh guess, and where a solution is near."""

FEW_CANDIDATES = 12
"""Random motions that are tried at the parts' places for each fresh guess."""

HOPS, HOP = 12, 0.15
"""Disturbances in a row that may fail to better a round's motion, and their size relative to it."""

SURE = 0.7
"""Fraction of the allowed error that a motion may miss and not be corrected further."""

LEGS = 3
"""Equal legs in which a fresh guess is led to a request that others have not reached."""

LEG_STEPS, LEG_ERROR = constant(8), 0.03
"""Steps for a leg, and the error that is left behind, over the size of the request."""

SPAN, POSE, TWIST, ACCEL, KNOT_POSE, KNOT_TWIST, KNOT_ACCEL, SPLINE, HULL = range(9)
"""The blocks of `Motions.rows`, as `SinusoidBasis` has them."""


class Motions(NamedTuple):
    """A basis of sinusoidal motions for kernels, in few arrays: a compiled call takes up to 2 us
    for every array that it is given.

    Attributes
    ----------
    rule : Rules
        Nodes of the averages.
    rows : (K, h)
        All matrices of the basis, one below the other.
    starts : tuple of int
        Row where each block begins, and the end.
    times : (k + 1,)
        Knots of a finished cycle [s].
    limits : Limits
        `MARGIN` of the rig's.
    """

    rule: Rules
    rows: np.ndarray
    starts: tuple[int, ...]
    times: np.ndarray
    limits: Limits

    @classmethod
    def of(cls, number: int, basis: SinusoidBasis, limits: Limits) -> Motions:
        """Stack the basis with `number` harmonics."""
        blocks = [basis.span, basis.pose, basis.twist, basis.accel, *basis.knots]
        blocks += [basis.spline, basis.hull]
        starts = np.cumsum([0, *map(len, blocks)]).tolist()
        return cls(force_rules(number), np.vstack(blocks), tuple(starts), basis.times, limits)

    @property
    def plain(self) -> PlainMotions:
        """The same in plain tuples, which a compiled call takes in less time than named ones."""
        rule, *between, limits = self
        return (tuple(rule), *between, tuple(limits))


PlainMotions = tuple[Any, ...]


class Averages(NamedTuple):
    """What is asked of motions on the averaged map.

    Attributes
    ----------
    rule : Rules
    span : (2 N, h)
        Of the basis.
    arm_m : float
        As in `Limits`.
    position, velocity, force : (M, 2)
    moving : bool
        Whether any velocity is not zero: else the scale does not matter.
    grid : int
        As in `force_of`.
    work, slip, gradient
        To write on, for `force_of`.
    motions : Motions
    """

    rule: Rules
    span: np.ndarray
    arm_m: float
    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    moving: bool
    grid: int
    work: np.ndarray
    slip: np.ndarray
    gradient: np.ndarray
    motions: Motions


class Search(NamedTuple):
    """What the starts of one search share: what is asked, random motions (S, 3 h), whether the
    first start is a known one, greatest error allowed [mu m g], and most steps of one start."""

    asked: Averages
    pool: np.ndarray
    warm: bool
    tolerance: float
    iterations: int


class Found(NamedTuple):
    """What `invert` finds.

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


@kernel()
def invert(
    warm: np.ndarray,
    pool: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    plain: PlainMotions,
    tolerance: float,
    iterations: int,
    tries: int,
) -> Found:
    """Find a motion with the wanted average forces.

    Two dips may be taken for one by the search's quadrature. Where the judge sees more error than
    is allowed, the motion is corrected on panels, and if need be the search done anew.

    Parameters
    ----------
    warm : (F, 3 h)
        The last solution, if there is one.
    pool : (S, 3 h)
        Random motions. A fresh guess is the best of the next `FEW_CANDIDATES`, forwards and
        backwards, at the parts' places; disturbances are taken from here too.
    position, velocity, force : (M, 2)
        Parts [m], [m/s], plate_home; wanted forces [mu m g].
    plain : PlainMotions
        Of the family of motions.
    tolerance : float
        Greatest error that is allowed [mu m g].
    iterations, tries : int
        Most steps from one start, and most starts.
    """
    motions = Motions(Rules(*plain[0]), plain[1], plain[2], plain[3], Limits(*plain[4]))
    asked = _asked(motions, position, velocity, force, ADAPTIVE)
    task = Search(asked, pool, len(warm) > 0, tolerance, iterations)
    begin = warm[0] if len(warm) else _fresh(task, FIRST)
    fit, done, tried = _search(task, begin, tries, HOPS, True, 0)
    found = _finished(asked, fit, done, tried)
    if found.worst > tolerance and np.max(np.abs(fit.error)) <= tolerance:
        fit = _descend(asked, PANELS, fit.parameters, NEAR, tolerance / 3, iterations)
        done += fit.iterations
        found = _finished(asked, fit, done, tried)
    if found.worst > tolerance and np.max(np.abs(fit.error)) <= tolerance:  # from other starts
        task = Search(asked, pool[::-1].copy(), False, tolerance, iterations)
        fit, more, others = _search(task, _fresh(task, FIRST), tries, HOPS, True, 0)
        found = _finished(asked, fit, done + more, tried + others)
    return found


@njit
def _asked(
    motions: Motions, position: np.ndarray, velocity: np.ndarray, force: np.ndarray, grid: int
) -> Averages:
    rows = len(motions.rule.waves)
    return Averages(
        motions.rule, _block(motions, SPAN), motions.limits.arm_m,
        position, velocity, force, bool(np.any(velocity != 0.0)), grid,
        np.empty((5, motions.rule.waves.shape[1])), np.empty((rows + 1, 2)), np.empty((3, rows)),
        motions,
    )  # fmt: skip


@njit(inline="always")
def _with(asked: Averages, force: np.ndarray, grid: int) -> Averages:
    """Return the same with another force and grid."""
    return Averages(
        asked.rule, asked.span, asked.arm_m, asked.position, asked.velocity, force, asked.moving,
        grid, asked.work, asked.slip, asked.gradient, asked.motions,
    )  # fmt: skip


@njit
def _finished(asked: Averages, fit: Fit, iterations: int, tries: int) -> Found:
    """Make parameters a spline within the limits, and judge it."""
    motions = asked.motions
    theta = _full_amplitude(fit.parameters, motions)
    own = _coefficients(theta, motions.limits.arm_m)
    for _ in range(4):  # turning enters with its square: nearly linear in the scale
        hull = _product(_block(motions, HULL), own)
        third = len(hull) // 3
        used = MARGIN * limit_use(
            hull[:third], hull[third : 2 * third], hull[2 * third :], HULL_WEIGHT, motions.limits,
            False,
        )  # fmt: skip
        if used <= CERTAIN:
            break
        own *= 0.9999 * CERTAIN / used
    spline = _product(_block(motions, SPLINE), own).reshape(-1, 6, 3)
    got = np.empty_like(asked.force)
    spline_force(motions.times, spline, asked.position, asked.velocity, got)
    error = asked.force - got
    pose = _product(_block(motions, KNOT_POSE), own)
    twist = _product(_block(motions, KNOT_TWIST), own)
    accel = _product(_block(motions, KNOT_ACCEL), own)
    pose[-1], twist[-1], accel[-1] = pose[0], twist[0], accel[0]  # to the last bit
    condition, worst = condition_of(fit.jacobian), np.max(np.abs(error))
    return Found(theta, pose, twist, accel, spline, error, worst, condition, iterations, tries)


@njit(error_model="numpy")
def _attempt(
    task: Search, start: np.ndarray, number: int, least: float
) -> tuple[Fit, float, int, bool]:
    """Descend from a start; what is good by equal steps is corrected where these miss dips."""
    asked, tolerance = task.asked, task.tolerance
    if number == 0 and task.warm:
        fit = _descend(asked, ADAPTIVE, start, NEAR, tolerance / 3, task.iterations)
    else:
        fit = _descend(asked, USUAL, start, AFRESH, tolerance / 3, task.iterations)
    done, cost, worst = fit.iterations, np.sum(fit.error**2), np.max(np.abs(fit.error))
    if worst <= tolerance or cost < least:  # equal steps may have missed a dip
        error = fit.error.copy()
        cost = force_error(asked, ADAPTIVE, fit.parameters, error, np.empty((0, 0)))
        fit = Fit(fit.parameters, error, fit.jacobian, done)
        if worst <= 30 * tolerance and np.max(np.abs(error)) > SURE * tolerance:
            fit = _descend(asked, ADAPTIVE, fit.parameters, NEAR, tolerance / 3, task.iterations)
            done, cost = done + fit.iterations, np.sum(fit.error**2)
    return fit, cost, done, np.max(np.abs(fit.error)) <= tolerance


@njit(error_model="numpy")
def _propose(task: Search, number: int, near: Fit, fresh: bool) -> np.ndarray:
    """Return a fresh start, led towards the request, or a disturbance of what is near."""
    pool = task.pool
    if not fresh:
        size = HOP * sqrt(np.sum(near.parameters**2) / len(near.parameters))
        return near.parameters + size * pool[number % len(pool)]
    theta, asked = _fresh(task, number), task.asked
    left = LEG_ERROR * sqrt(np.sum(asked.force**2) / asked.force.size)
    for leg in range(1, LEGS):
        part = _with(asked, asked.force * leg / LEGS, USUAL)
        theta = _descend(part, USUAL, theta, AFRESH, left, LEG_STEPS).parameters
    return theta


@njit(error_model="numpy")
def _fresh(task: Search, number: int) -> np.ndarray:
    """Return the next random motion, or its opposite, that does most of what is asked."""
    asked, pool = task.asked, task.pool
    error, none = np.empty(asked.force.size), np.empty((0, 0))
    wanted = asked.force.copy().reshape(-1)
    first = number // (HOPS + 1) * FEW_CANDIDATES % len(pool)  # another for every fresh start
    least, index, sign = 1e300, first, 1.0
    for i in range(first, min(first + FEW_CANDIDATES, len(pool))):
        theta = _full_amplitude(pool[i], asked.motions) if asked.moving else pool[i]
        cost = force_error(asked, FEW, theta, error, none)
        if cost < least:
            least, index, sign = cost, i, 1.0
        # With g = f - error the force got, |f + g|^2 = |f - g|^2 + 4 f.g
        opposite = cost
        for k in range(len(error)):
            opposite += 4 * wanted[k] * (wanted[k] - error[k])
        if opposite < least:
            least, index, sign = opposite, i, -1.0
    return sign * pool[index]


@njit(error_model="numpy")
def _descend(
    asked: Averages, grid: int, theta: np.ndarray, damping: Damping, tolerance: float,
    iterations: int,
) -> Fit:  # fmt: skip
    """Correct a motion until its forces on a grid are as asked."""
    problem = _with(asked, asked.force, grid)
    return _search_down(problem, theta, damping, tolerance, iterations)


@njit(inline="always")
def _evaluate(asked: Averages, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the motion at full amplitude where that matters, its errors, and their slopes: in one
    pass, as they share most of the work."""
    if asked.moving:
        theta = _full_amplitude(theta, asked.motions)
    error = np.empty(asked.force.size)
    jacobian = np.empty((len(error), len(theta)))
    force_error(asked, asked.grid, theta, error, jacobian)
    return theta, error, jacobian


@njit(inline="always")
def _slopes(asked: Averages, theta: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    return jacobian


@njit(fastmath=True, error_model="numpy")
def force_error(
    asked: Averages, grid: int, theta: np.ndarray, error: np.ndarray, jacobian: np.ndarray
) -> float:
    """Write request minus average force (2 M,), and d force / d theta (2 M, 3 h) unless it is
    (0, 0); return the squared error. `grid` as in `force_of`."""
    rule, span, slip, work = asked.rule, asked.span, asked.slip, asked.work
    position, velocity, force = asked.position, asked.velocity, asked.force
    turn = 1 / asked.arm_m
    coefficients = _product(span, _coefficients(theta, asked.arm_m))
    gradient = asked.gradient if len(jacobian) else np.empty((0, 0))
    cost = 0.0
    for i in range(len(position)):
        x, y = position[i, 0], position[i, 1]
        slip_at(coefficients, x, y, velocity[i, 0], velocity[i, 1], slip)
        fx, fy = force_of(slip, rule, grid, work, gradient)
        error[2 * i], error[2 * i + 1] = force[i, 0] - fx, force[i, 1] - fy
        cost += error[2 * i] ** 2 + error[2 * i + 1] ** 2
        for h in range(span.shape[1] if len(jacobian) else 0):
            xx = xy = yy = 0.0
            for j in range(len(span)):
                xx += gradient[0, j] * span[j, h]
                xy += gradient[1, j] * span[j, h]
                yy += gradient[2, j] * span[j, h]
            for axis in range(2):
                gx, gy = (xx, xy) if axis == 0 else (xy, yy)
                row = 2 * i + axis
                jacobian[row, 3 * h] = gx
                jacobian[row, 3 * h + 1] = gy
                jacobian[row, 3 * h + 2] = (x * gy - y * gx) * turn
    return cost


@njit(fastmath=True, error_model="numpy")
def _full_amplitude(theta: np.ndarray, motions: Motions) -> np.ndarray:
    """Scale parameters (3 h,) so that the samples just reach the first of the limits."""
    own = _coefficients(theta, motions.limits.arm_m)
    used = limit_use(
        _product(_block(motions, POSE), own), _product(_block(motions, TWIST), own),
        _product(_block(motions, ACCEL), own), EQUAL_WEIGHT, motions.limits, True,
    )  # fmt: skip
    return theta / used if used > 0 else theta


@njit(inline="always")
def _block(motions: Motions, which: int) -> np.ndarray:
    return motions.rows[motions.starts[which] : motions.starts[which + 1]]


@njit(inline="always")
def _coefficients(theta: np.ndarray, arm_m: float) -> np.ndarray:
    """Return coefficients (h, 3) of parameters (3 h,)."""
    own = theta.copy().reshape(-1, 3)
    own[:, 2] /= arm_m
    return own


@njit(fastmath=True, error_model="numpy")
def _product(basis: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return a basis (n, h) times coefficients (h, 3): a library takes longer to call than this."""
    samples = np.empty((len(basis), 3))
    for k in range(len(basis)):
        x = y = turn = 0.0
        for h in range(len(own)):
            weight = basis[k, h]
            x += weight * own[h, 0]
            y += weight * own[h, 1]
            turn += weight * own[h, 2]
        samples[k, 0], samples[k, 1], samples[k, 2] = x, y, turn
    return samples


_search_down = njit(error_model="numpy", inline="always")(levenberg_marquardt(_evaluate, _slopes))
_search = njit(error_model="numpy")(basin_hopping(_propose, _attempt))
