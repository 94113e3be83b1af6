"""The averaged problem: a family of motions fitted to wanted average forces and curls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plate_core import PlateCycle

from .force_map import mean_force_gradient
from .least_squares import Fit, fit
from .solution import Request, Solution
from .steering import Family

CURL_LENGTH_M = 0.05
"""Turns a curl error [mu m g / m] into a force error: as it would act over this distance."""


def fit_force(
    request: Request, family: Family, parameters: np.ndarray, tolerance: float, iterations: int
) -> Fit:
    """Correct a motion until its average forces, equation (5), are as asked.

    Errors are in mu m g, for the rows `request.rows`; `tolerance` is the greatest at which to stop.
    """
    rows = request.rows
    scale = np.tile([1.0, 1.0, CURL_LENGTH_M], len(request.position))[rows]
    wanted = np.column_stack([request.force, request.curl]).ravel()[rows]

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        _, twist = family.samples(theta)
        force, curl, gradient = mean_force_gradient(request.position, request.velocity, twist)
        got = np.column_stack([force, curl]).ravel()[rows]

        def slopes() -> np.ndarray:
            return scale[:, None] * family.pull_back(theta, gradient[rows], None)

        return (wanted - got) * scale, slopes

    return fit(evaluate, parameters, family.admissible, tolerance, iterations)


def fit_force_finely(
    request: Request,
    coarse: Family,
    fine: Family,
    parameters: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Do as `fit_force`; what is good on coarse samples is corrected on ones that resolve dips."""
    found = fit_force(request, coarse, parameters, tolerance / 10, iterations)
    if np.max(np.abs(found.error)) > tolerance:
        return found
    better = fit_force(request, fine, found.parameters, tolerance / 10, iterations)
    return replace(better, iterations=found.iterations + better.iterations)


def force_solution(
    request: Request,
    best: Fit,
    cycle: PlateCycle,
    tolerance: float,
    iterations: int,
    condition: float,
) -> Solution:
    """Put a fit and its motion, within the limits, into a solution."""
    worst = float(np.max(np.abs(best.error)))
    error = np.zeros(len(request.rows))
    error[request.rows] = best.error
    success = worst <= tolerance
    message = f"force error {worst:.2g} mu m g after {iterations} iterations"
    return Solution(
        success=success,
        message=message if success else f"{message}, allowed: {tolerance:g}",
        cycle=cycle,
        residual=error.reshape(-1, 3)[:, :2],
        iterations=iterations,
        condition=condition,
    )
