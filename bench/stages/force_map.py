"""Average friction over a cycle: time and error of several methods.

The reference is scipy's quad with a tolerance of 1e-10. The reference integrates separately between
the times of nearly zero slip.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from math import cos, hypot, pi, sin
from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import quad

from harness import Result, Table, race
from plate_core import load_rig
from plate_solver import Limits, average_force
from plate_solver.averages import (
    force_rules,
    sinusoid_forces,
    step_forces,
)
from plate_solver.sinusoids import SinusoidBasis, SinusoidFamily, sinusoid_basis

ForceMap = Callable[[np.ndarray], np.ndarray]
"""Function from positions (M, 2) [m] to forces (M, 2) [mu m g]."""

NUMBER, PERIOD = 2, 0.05
"""Number of harmonics and period [s] of the motions. Such a motion has 2 x 2 x 3 = 12
parameters."""


def measure(quick: bool) -> Result:
    """Measure the errors of the average friction forces in random cases, and the time per part."""
    rig = load_rig()
    rng = np.random.default_rng(0)
    basis = sinusoid_basis(NUMBER, PERIOD, False)
    family, cases = SinusoidFamily(basis, Limits.of(rig)), []
    for _ in range(15 if quick else 400):
        coefficients = family.coefficients(family.random(rng))
        cases.append((coefficients, rng.uniform(-rig.plate.half, rig.plate.half)))
    truth = np.array([exact_force(c, p) for c, p in cases])
    methods = evaluators(basis)
    error = {
        name: np.max(np.abs([of(c)(p[None])[0] for c, p in cases] - truth), axis=1)
        for name, of in methods.items()
    }
    seconds = 0.5 if quick else 3.0
    position = rng.uniform(-rig.plate.half, rig.plate.half)[None]
    single = race({n: partial(of(cases[0][0]), position) for n, of in methods.items()}, seconds)
    rows = batch_rows(cases, truth, seconds)
    rows += [row("one", name, single.median(name), error[name]) for name in methods]
    return Result([Table.of("force_map", rows, count=len(cases))])


@njit(cache=True, fastmath=True)
def plain_forces(coefficients: np.ndarray, position: np.ndarray, waves: np.ndarray) -> np.ndarray:
    """Return the average forces (C, 2), computed with equal time steps. Equal steps are the
    simplest method."""
    force = np.empty((len(coefficients), 2))
    for i in range(len(coefficients)):
        fx = fy = 0.0
        for k in range(len(waves)):
            u = v = w = 0.0
            for j in range(waves.shape[1]):
                u += coefficients[i, j, 0] * waves[k, j]
                v += coefficients[i, j, 1] * waves[k, j]
                w += coefficients[i, j, 2] * waves[k, j]
            dx, dy = u - w * position[i, 1], v + w * position[i, 0]
            d = np.sqrt(dx * dx + dy * dy)
            fx += dx / d
            fy += dy / d
        force[i, 0], force[i, 1] = fx / len(waves), fy / len(waves)
    return force


def batch_rows(
    cases: list[tuple[np.ndarray, np.ndarray]], truth: np.ndarray, seconds: float
) -> list[dict[str, Any]]:
    """Measure the time of each method for all cases. The methods run in turn."""
    motion, position = (np.array(column) for column in zip(*cases, strict=True))
    still, steps = np.zeros_like(position), sinusoid_basis(NUMBER, PERIOD, False, 128).twist
    calls: dict[str, Callable[[], np.ndarray]] = {
        "forces": partial(sinusoid_forces, motion, position, still, force_rules(NUMBER)),
        "plain numba, n = 128": partial(plain_forces, motion, position, steps),
    }
    timed = race(calls, seconds)
    return [
        row("many", name, timed.median(name) / len(cases), np.max(np.abs(call() - truth), axis=1))
        for name, call in calls.items()
    ]


def row(case: str, method: str, seconds: float, error: np.ndarray) -> dict[str, Any]:
    """Return the row of a method from the time per force [s] and the errors (n,) [mu m g]."""
    return {
        "case": case, "method": method, "us": 1e6 * seconds,
        "median": float(np.median(error)), "p99": float(np.percentile(error, 99)),
    }  # fmt: skip


def slip(coefficients: np.ndarray, point: np.ndarray) -> Callable[[float], tuple[float, float]]:
    """Return the plate's velocity [m/s] under a held part, directly by equation (13) of the
    paper."""
    sine, cosine = coefficients[:NUMBER].tolist(), coefficients[NUMBER:].tolist()
    x, y = point.tolist()
    rates = [2 * pi / PERIOD * (j + 1) for j in range(NUMBER)]

    def velocity(t: float) -> tuple[float, float]:
        u = v = w = 0.0
        for rate, a, b in zip(rates, sine, cosine, strict=True):
            s, c = sin(rate * t), cos(rate * t)
            u += s * a[0] + c * b[0]
            v += s * a[1] + c * b[1]
            w += s * a[2] + c * b[2]
        return u - w * y, v + w * x

    return velocity


def exact_force(coefficients: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the force (2,) [mu m g] by adaptive quadrature between the minima of the slip
    speed."""
    grid = np.linspace(0, PERIOD, 2049)
    velocity = slip(coefficients, point)
    speed = np.array([hypot(*velocity(t)) for t in grid.tolist()])
    low = np.flatnonzero((speed[1:-1] < speed[:-2]) & (speed[1:-1] <= speed[2:])) + 1
    edges = np.concatenate([[0.0], grid[low], [PERIOD]])
    total = np.zeros(2)
    for a, b in pairwise(edges.tolist()):
        if b > a:
            total += integrate_direction(coefficients, point, a, b, 1e-10 * PERIOD)
    return total / PERIOD


def integrate_direction(
    coefficients: np.ndarray, point: np.ndarray, a: float, b: float, tolerance: float
) -> np.ndarray:
    """Integrate the direction of slip over [a, b] by scipy's quad: (2,) [s]."""

    velocity = slip(coefficients, point)

    def direction(t: float, axis: int) -> float:
        both = velocity(t)
        return both[axis] / max(hypot(*both), 1e-300)

    return np.array(
        [
            quad(direction, a, b, args=(axis,), epsabs=tolerance, epsrel=0, limit=400)[0]
            for axis in (0, 1)
        ]
    )


def evaluators(basis: SinusoidBasis) -> dict[str, Callable[[np.ndarray], ForceMap]]:
    """Return functions, by name of the method, that convert coefficients (4, 3) to a `ForceMap`.
    This conversion is not timed."""

    def twist(coefficients: np.ndarray, n: int) -> np.ndarray:
        return np.asarray(sinusoid_basis(NUMBER, PERIOD, False, n).twist @ coefficients)

    def stepwise_map(n: int, coefficients: np.ndarray) -> ForceMap:
        return partial(forces_by_steps, twist(coefficients, n), np.ones(n))

    return {
        "average_force": lambda c: partial(average_force, basis.cycle(c)),
        **{f"step_forces, n = {n}": partial(stepwise_map, n) for n in (128, 512, 1024)},
        "numpy, n = 256": lambda c: partial(forces_by_numpy, twist(c, 256)),
        "quad (scipy)": lambda c: partial(forces_by_quad, c),
    }


def forces_by_steps(twist: np.ndarray, dt: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return average forces, computed by the project's kernel for equal time steps."""
    return step_forces(position, np.zeros_like(position), twist, dt)[:, :2]


def forces_by_numpy(twist: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return average forces, computed by numpy with equal time steps."""
    u = twist[:, None]
    velocity = np.stack(
        [u[..., 0] - u[..., 2] * position[:, 1], u[..., 1] + u[..., 2] * position[:, 0]], -1
    )
    speed = np.sqrt(np.sum(velocity**2, axis=2, keepdims=True))
    return np.asarray(np.mean(velocity / speed, axis=0))


def forces_by_quad(coefficients: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return average forces, computed by scipy's quad with its default tolerance."""
    return (
        np.array(
            [integrate_direction(coefficients, p, 0, PERIOD, 1.5e-8 * PERIOD) for p in position]
        )
        / PERIOD
    )
