"""Plate motions for wanted average forces, from a cold start.

Every answer, ours and the peer's, is judged by the force map on samples that neither has used.
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
"""Harmonics N by parts M: the fewest with parameters to spare, as `SinusoidSolver` chooses."""

PERIOD_PER_HARMONIC = 0.025
"""[s]; averaged forces do not depend on it."""

ROTATION_SHARE = 3
"""`RotationSolver` gets every third target only: it takes ten times as long."""

TOLERANCE = 1e-4
"""Greatest error of a component that counts as success [mu m g]."""

RESTARTS = 20
"""Further starts that every method has."""

SAMPLES = 1024
"""Samples of the peer's last steps: enough for most dips."""

JUDGE_SAMPLES = 6007
"""Samples of the judge: no multiple of anybody else's."""

OURS, PEER, ROTATIONS = METHODS = "SinusoidSolver", "scipy lm", "RotationSolver"
"""The peer: least_squares(method='lm') with our Jacobian on the same samples, random starts, then
the same last steps on fine samples. Our times include the finished PlateCycle within the rig's
limits, RotationSolver's also closure and ramps; scipy's end with the parameters."""


def measure(quick: bool) -> Result:
    """Solve random targets for 1 to 4 parts."""
    rig = load_rig()
    samples = []
    for parts in HARMONICS:
        samples += solve_all(rig, parts, 4 if quick else 45)
    return Result([], [told(parts, m, samples) for parts in HARMONICS for m in METHODS], samples)


def solve_all(rig: Rig, parts: int, count: int) -> list[dict[str, Any]]:
    """Solve the same targets by all methods, in turns; one sample per target and method."""
    number = HARMONICS[parts]
    period = PERIOD_PER_HARMONIC * number
    ours = SinusoidSolver(
        rig, harmonics=number, period=period, tolerance=TOLERANCE, restarts=RESTARTS
    )
    rotations = RotationSolver(rig, restarts=RESTARTS)
    peer = ScipySolver(rig, number, period)
    rng = np.random.default_rng(parts)
    samples = []
    for index, (position, force) in enumerate(targets(rig, parts, count + 1, rng)):
        ours.reset()
        rotations.reset()
        peer.reset()
        for method, solver in ((OURS, ours), (PEER, peer), (ROTATIONS, rotations)):
            if method == ROTATIONS and index and index % ROTATION_SHARE != 1:
                continue
            answer, seconds = timed(solver.solve, position, force)
            if not index:  # the first one warms up
                continue
            t = (np.arange(JUDGE_SAMPLES) + 0.5) / JUDGE_SAMPLES
            if isinstance(answer, np.ndarray):
                basis = sinusoid_basis(number, period, False, JUDGE_SAMPLES)
                twist = basis.twist @ peer.family.coefficients(answer)
            else:
                twist = answer.cycle.twist(t * answer.cycle.period)
            still, equal = np.zeros_like(position), np.ones(JUDGE_SAMPLES)
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
    """scipy's least_squares on the force map: what one would write without our solver."""

    def __init__(self, rig: Rig, number: int, period: float) -> None:
        limits = Limits.of(rig)
        self.family = SinusoidFamily(sinusoid_basis(number, period, False), limits)
        self._fine = SinusoidFamily(sinusoid_basis(number, period, False, SAMPLES), limits)
        self.reset()

    def reset(self) -> None:
        """Start the random numbers anew."""
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
        # 'lm' wants at least as many errors as parameters: the further ones are zero.
        spare = max(0, len(start) - force.size)

        def errors(theta: np.ndarray) -> np.ndarray:
            _, twist, dt = family.samples(theta)
            got = step_forces(position, still, twist, dt)[:, :2]
            return np.concatenate([(got - force).ravel(), np.zeros(spare)])

        def jacobian(theta: np.ndarray) -> np.ndarray:
            _, twist, dt = family.samples(theta)
            slopes = family.pull_back(theta, None, step_force_gradient(position, still, twist, dt))
            return np.vstack([slopes[rows], np.zeros((spare, len(theta)))])

        return least_squares(errors, start, jacobian, method="lm", max_nfev=60)


def told(parts: int, method: str, samples: list[dict[str, Any]]) -> str:
    """Sum up the samples of one method at one number of parts."""
    mine = [s for s in samples if s["parts"] == parts and s["method"] == method]
    met = 100 * np.mean([s["error"] <= TOLERANCE for s in mine])
    ms = np.median([s["ms"] for s in mine])
    return f"{parts} parts, {method}: {met:.0f} % within {TOLERANCE:g} mu m g, median {ms:.3g} ms"
