"""Sequences of rotations on the averaged map, compiled from end to end.

The derivatives are those of `sequence` and of the mean over steps, taken together: what a step of
the motion does to all forces goes straight to the knots of its segment.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from plate_core.kernels import SAME_ROUNDING, kernel

from ..fit import Fit, levenberg_marquardt
from ..fit.levenberg_marquardt import DAMPING
from ..maps import step_forces
from ..maps.mean_force import TINY_SQUARE
from ..requests.request import Request
from .family import Line, RotationFamily, Sequences, runnable, split
from .sequence import corners_back, knot_poses, ramps, timeline_back

PATIENT = DAMPING._replace(stall_steps=10, stall_fraction=0.9)
"""Given up sooner, forces are missed that can be had."""


class SequenceForces(NamedTuple):
    """What is asked of sequences of rotations on the averaged map.

    Attributes
    ----------
    family : Sequences
    position, velocity : (M, 2)
    asked : (3 M,) bool
        Which of force x, force y and curl of each part.
    wanted, scale : (R,)
        These, and what makes force errors of errors in them.
    """

    family: Sequences
    position: np.ndarray
    velocity: np.ndarray
    asked: np.ndarray
    wanted: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, request: Request, family: RotationFamily) -> SequenceForces:
        """Take what is asked from a request."""
        rows = request.rows
        return cls(
            family.plain, request.position, request.velocity, rows,
            request.wanted[rows], request.scale[rows],
        )  # fmt: skip


def fit_mean_force(
    request: Request,
    family: RotationFamily,
    parameters: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Correct a sequence until its average forces (5) are as asked; errors in mu m g."""
    found: Fit = _descend(SequenceForces.of(request, family), parameters, tolerance, iterations)
    return found


def mean_force_error(
    request: Request, family: RotationFamily, parameters: np.ndarray
) -> np.ndarray:
    """Return what is missed in the rows `request.rows` [mu m g], curls by `CURL_LENGTH_M`."""
    _, twist, dt = family.samples(parameters)
    return np.asarray(_missed(SequenceForces.of(request, family), twist, dt))


@kernel()
def _missed(problem: SequenceForces, twist: np.ndarray, dt: np.ndarray) -> np.ndarray:
    got = step_forces(problem.position, problem.velocity, twist, dt).ravel()[problem.asked]
    return (problem.wanted - got) * problem.scale


@njit
def _evaluate(problem: SequenceForces, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, Line]:
    theta, line, moved = runnable(theta, problem.family)
    return theta, _missed(problem, moved[1], moved[3]), line


@njit
def _slopes(problem: SequenceForces, theta: np.ndarray, line: Line) -> np.ndarray:
    jacobian = force_slopes(
        theta, problem.family, line, problem.position, problem.velocity, problem.asked
    )
    return problem.scale.reshape(-1, 1) * jacobian


_search_down = njit(inline="always")(levenberg_marquardt(_evaluate, _slopes))


@kernel()
def _descend(problem: SequenceForces, theta: np.ndarray, tolerance: float, iterations: int) -> Fit:
    return _search_down(problem, theta, PATIENT, tolerance, iterations)


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def force_slopes(
    theta: np.ndarray,
    family: Sequences,
    line: Line,
    position: np.ndarray,
    velocity: np.ndarray,
    asked: np.ndarray,
) -> np.ndarray:
    """Return the derivatives (R, P) of `step_forces`, of the R rows `asked` (3 M,) bool only."""
    times, knots = line
    count, segments, period = len(position), len(times) - 1, times[-1]
    turning = bool(np.any(asked[2::3]))
    gap = knot_poses(times, knots)[-1]
    by_time, by_knot = np.zeros((3 * count, segments + 1)), np.zeros((3 * count, segments + 1, 3))
    by_corner = np.zeros((3 * count, segments + 1, 3))
    size = (8 if turning else 5) * count
    value, way = np.zeros((8, count)), np.zeros((3, count))
    flat, weight, total = value.reshape(-1), np.empty(5), np.empty((5, size))
    for k in range(segments):
        h, parts = times[k + 1] - times[k], family.steps[k % 2]
        total[:] = 0.0
        way[:] = 0.0
        for part in range(parts):
            x = (part + 0.5) / parts
            y = (times[k] + h * x) / period
            s, rate = x * x * (3 - 2 * x), 30 * y * y * (1 - y) ** 2 / period
            bend = 60 * y * (1 - y) * (1 - 2 * y) / period**2
            weight[0], weight[1], weight[2] = 1 - s, s, rate
            weight[3], weight[4] = bend * (1 - x), bend * x
            u = knots[k, 0] * (1 - s) + knots[k + 1, 0] * s - gap[0] * rate
            v = knots[k, 1] * (1 - s) + knots[k + 1, 1] * s - gap[1] * rate
            spin = knots[k, 2] * (1 - s) + knots[k + 1, 2] * s - gap[2] * rate
            _directions(u, v, spin, position, velocity, h / (parts * period), turning, value, way)
            for w in range(5):
                for i in range(size):
                    total[w, i] += weight[w] * flat[i]
        _to_knots(k, parts, period, gap, total, way, turning, by_time, by_knot, by_corner)
    corners_back(times, knots, by_corner, by_time, by_knot)
    holds, twists = split(theta, family)
    ramp, slope = ramps(twists, family.limits.half, family.loads, family.accel, family.blend)
    by_hold, by_twist = timeline_back(
        holds, ramp, slope, family.period, by_time[asked], by_knot[asked]
    )
    number, own = family.basis.shape[:2]
    jacobian = np.empty((len(by_hold), len(theta)))
    for r in range(len(by_hold)):
        for j in range(number + 1):
            jacobian[r, j] = by_hold[r, j] * family.hold_scale
        for j in range(number):
            for q in range(own):
                along = 0.0
                for c in range(3):
                    along += by_twist[r, j, c] * family.basis[j, q, c]
                jacobian[r, number + 1 + j * own + q] = along
    return jacobian


@kernel(fastmath=SAME_ROUNDING, error_model="numpy", inline="always")
def _directions(
    u: float, v: float, spin: float, position: np.ndarray, velocity: np.ndarray, fraction: float,
    turning: bool, value: np.ndarray, way: np.ndarray,
) -> None:  # fmt: skip
    """Write the derivatives of each part's force and curl by a twist, in a step of `fraction` of
    the period; add force and curl to `way` (3, M).

    Rows of `value`: force x by u and v, force y by v, both by spin; curl by u, v, spin.
    """
    for i in range(len(position)):
        x, y = position[i, 0], position[i, 1]
        dx, dy = u - spin * y - velocity[i, 0], v + spin * x - velocity[i, 1]
        square = dx * dx + dy * dy
        inverse = 1 / sqrt(max(square, TINY_SQUARE))
        a, b = dx * inverse, dy * inverse
        own = fraction * inverse if square > TINY_SQUARE else 0.0
        xx, xy, yy = own * (1 - a * a), -own * a * b, own * (1 - b * b)
        value[0, i], value[1, i], value[2, i] = xx, xy, yy
        value[3, i], value[4, i] = x * xy - y * xx, x * yy - y * xy
        way[0, i] += a
        way[1, i] += b
        if turning:
            curl = spin * inverse
            gx, gy = -own * a * curl, -own * b * curl
            value[5, i], value[6, i], value[7, i] = gx, gy, x * gy - y * gx + own
            way[2, i] += curl


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _to_knots(
    k: int, parts: int, period: float, gap: np.ndarray, total: np.ndarray, way: np.ndarray,
    turning: bool, by_time: np.ndarray, by_knot: np.ndarray, by_corner: np.ndarray,
) -> None:  # fmt: skip
    """Add what the steps of segment k do, weighted by where in it they are, to its knots."""
    count, last = way.shape[1], by_time.shape[1] - 1
    for i in range(count):
        for axis in range(3 if turning else 2):
            r = 3 * i + axis
            longer = way[axis, i] / (parts * period)
            by_time[r, k] -= longer
            by_time[r, k + 1] += longer
            for c in range(3):
                if axis == 2:
                    row = 5 + c
                elif c == 2:
                    row = 3 + axis
                else:
                    row = axis + c
                at = row * count + i
                by_knot[r, k, c] += total[0, at]
                by_knot[r, k + 1, c] += total[1, at]
                by_corner[r, last, c] -= total[2, at]
                by_time[r, k] -= gap[c] * total[3, at]
                by_time[r, k + 1] -= gap[c] * total[4, at]
