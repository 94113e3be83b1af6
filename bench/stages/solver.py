"""Plate motions for requested average forces, without a warm start.

All results are checked by average forces from samples that no method has used.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares

from harness import Result, timed
from plate_core import Rig, load_rig
from plate_solver import Limits, RotationSolver, SinusoidSolver
from plate_solver.averages import step_force_gradient, step_forces
from plate_solver.sinusoids import SinusoidFamily, sinusoid_basis
from stages.scenes import targets

HARMONICS = {1: 2, 2: 2, 3: 3, 4: 4}
"""Number of harmonics N for each number of parts M. N is the minimum number with which a motion has
more parameters than the request has force components. `SinusoidSolver` chooses it too."""

PERIOD_PER_HARMONIC = 0.025
"""Period per harmonic [s]. Averaged forces do not depend on the period."""

ROTATION_STRIDE = 3
"""`RotationSolver` gets only every third target, because it takes ten times as long."""

TOLERANCE = 1e-4
"""Maximum error of a force component in a successful solution [mu m g]."""

RESTARTS = 20
"""Number of restarts of every method."""

SAMPLES = 1024
"""Number of samples in scipy's final steps. These samples resolve most short minima of the slip
speed."""

CHECK_SAMPLES = 6007
"""Number of samples per cycle from which the error of each solution is computed. This number is not
a multiple of any method's number of samples. Therefore errors between the samples of a method are
visible too."""

PROJECT, BASELINE, ROTATIONS = METHODS = "SinusoidSolver", "scipy lm", "RotationSolver"
"""Methods. scipy is least_squares(method='lm') with the project's Jacobian on the same samples,
from random starts, with the same final steps on fine samples. The times of the project's solvers
include the computation of the final PlateCycle within the rig's limits. For RotationSolver, they
also include closure and ramps. scipy's times include only the computation of the parameters."""


def measure(quick: bool) -> Result:
    """Solve random requests for 1 to 4 parts."""
    rig = load_rig()
    samples = []
    for parts in HARMONICS:
        samples += solve_all(rig, parts, 4 if quick else 45)
    return Result(
        [], [solved_sentence(parts, m, samples) for parts in HARMONICS for m in METHODS], samples
    )


def solve_all(rig: Rig, parts: int, count: int) -> list[dict[str, Any]]:
    """Solve the same requests with all methods in turn. Return one result per request and
    method."""
    number = HARMONICS[parts]
    period = PERIOD_PER_HARMONIC * number
    ours = SinusoidSolver(
        rig, harmonics=number, period=period, tolerance=TOLERANCE, restarts=RESTARTS
    )
    rotations = RotationSolver(rig, restarts=RESTARTS)
    baseline = ScipySolver(rig, number, period)
    rng = np.random.default_rng(parts)
    samples = []
    for index, (position, force) in enumerate(targets(rig, parts, count + 1, rng)):
        ours.reset()
        rotations.reset()
        baseline.reset()
        for method, solver in ((PROJECT, ours), (BASELINE, baseline), (ROTATIONS, rotations)):
            if method == ROTATIONS and index and index % ROTATION_STRIDE != 1:
                continue
            result, seconds = timed(solver.solve, position, force)
            if not index:  # do not count the first request, because it includes the warm-up
                continue
            t = (np.arange(CHECK_SAMPLES) + 0.5) / CHECK_SAMPLES
            if isinstance(result, np.ndarray):
                basis = sinusoid_basis(number, period, False, CHECK_SAMPLES)
                twist = basis.twist @ baseline.family.coefficients(result)
            else:
                twist = result.cycle.twist(t * result.cycle.period)
            still, equal = np.zeros_like(position), np.ones(CHECK_SAMPLES)
            got = step_forces(position, still, twist, equal)[:, :2]
            samples.append(
                {
                    "parts": parts,
                    "method": method,
                    "ms": 1e3 * seconds,
                    "error": float(np.max(np.abs(got - force))),
                }
            )
    return samples


class ScipySolver:
    """scipy's least_squares on the averaged forces: the obvious alternative to the project's
    solver."""

    def __init__(self, rig: Rig, number: int, period: float) -> None:
        limits = Limits.of(rig)
        self.family = SinusoidFamily(sinusoid_basis(number, period, False), limits)
        self._fine = SinusoidFamily(sinusoid_basis(number, period, False, SAMPLES), limits)
        self.reset()

    def reset(self) -> None:
        """Reset the random number generator to its seed."""
        self._rng = np.random.default_rng(0)

    def solve(self, position: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the best parameters of up to `RESTARTS` + 1 random starts."""
        best: Any = None
        for _ in range(RESTARTS + 1):
            start = self.family.random(self._rng)
            result = self._search(self.family, start, position, force)
            if best is None or result.cost < best.cost:
                best = result
            if np.max(np.abs(best.fun)) <= TOLERANCE:
                break
        return np.asarray(self._search(self._fine, best.x, position, force).x)

    def _search(
        self, family: SinusoidFamily, start: np.ndarray, position: np.ndarray, force: np.ndarray
    ) -> Any:
        still = np.zeros_like(position)
        rows = np.tile([True, True, False], len(position))
        # SciPy's method 'lm' requires at least as many errors as parameters. Therefore errors of
        # zero are added.
        spare = max(0, len(start) - force.size)

        def errors(theta: np.ndarray) -> np.ndarray:
            _, twist, dt = family.samples(theta)
            got = step_forces(position, still, twist, dt)[:, :2]
            return np.concatenate([(got - force).ravel(), np.zeros(spare)])

        def jacobian(theta: np.ndarray) -> np.ndarray:
            _, twist, dt = family.samples(theta)
            slopes = family.pull_back(step_force_gradient(position, still, twist, dt))
            return np.vstack([slopes[rows], np.zeros((spare, len(theta)))])

        return least_squares(errors, start, jacobian, method="lm", max_nfev=60)


def solved_sentence(parts: int, method: str, samples: list[dict[str, Any]]) -> str:
    """Return the statistics of one method's results for one number of parts."""
    method_samples = [s for s in samples if s["parts"] == parts and s["method"] == method]
    met = 100 * np.mean([s["error"] <= TOLERANCE for s in method_samples])
    ms = np.median([s["ms"] for s in method_samples])
    return f"{parts} parts, {method}: {met:.0f} % within {TOLERANCE:g} mu m g, median {ms:.3g} ms"
