"""Search for the feasible part of a request.

The function `easiest_force` solves a linear programme. The linear programme selects those forces
within the tolerance that need the minimum time. The function `largest_fraction` finds the largest
feasible fraction of a request by bisection.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from ..goal import Solution, Status
from ..library import Library, min_time
from .request import Request

MAX_TRIED = 1.15
"""Maximum fraction of a request that is tried, divided by the upper bound from the library of
rotations. The value is above 1, because this bound is a few per cent too low. The bound is too low
because the library contains a finite number of rotations."""

BISECTIONS = 5
"""Maximum number of bisections. The bisections determine the largest fraction to within 1/32 of the
upper bound."""

CAUTION = 0.95
"""First fraction of a request that is tried, divided by the fraction that the solution for the
whole request achieves."""

WORTH_IT = 0.5
"""If the root mean square error of the best motion exceeds this fraction of the root mean square of
the request, the plate rests instead."""

OUT_OF_REACH = 1e4
"""Cost of a unit of force error [cycles / (mu m g)]. The cost is so high that force errors are 0
whenever this is possible."""


def easiest_force(request: Request, library: Library) -> np.ndarray:
    """Return those forces (M, 2) within the tolerance of the request that need the minimum time.

    A linear programme computes them. Let w be the weights of the library's rotations, and A the
    matrix of their unit forces. The programme minimises the sum of abs(w) subject to `force -
    tolerance <= A w <= force + tolerance`.

    If no force within the tolerance is feasible, the requested forces are returned.
    """
    if not request.flags.has_tolerance:
        return request.force
    rows = library.forces(request.position)
    requested, slack = request.force.T.ravel(), request.tolerance.T.ravel()
    bounded, matrix = np.isfinite(slack), np.hstack([rows, -rows])
    bounds = np.concatenate([(requested + slack)[bounded], (slack - requested)[bounded]])
    result = linprog(
        np.ones(matrix.shape[1]), np.vstack([matrix[bounded], -matrix[bounded]]), bounds,
        method="highs",
    )  # fmt: skip
    if result.status != 0:
        return request.force
    return np.asarray((matrix @ result.x).reshape(2, -1).T)


def largest_fraction(
    request: Request,
    library: Library,
    attempt: Callable[[Request], Solution],
    nothing: Callable[[], Solution],
    resolution: float,
    limit: float,
    prove: Callable[[Request], bool] | None,
) -> Solution:
    """Solve a request. If this fails, solve the largest fraction of the request that a bisection
    finds feasible.

    Parameters
    ----------
    request : Request
        Forces and curls are multiplied by the same fraction. Tolerances do not change.
    library : Library
        Library that gives an upper bound of the fraction.
    attempt : function
        Function that solves a request. The function returns the best motion found, even if the
        request is infeasible.
    nothing : function
        Function that returns the solution in which the plate rests. It is called if no fraction of
        the request is feasible.
    resolution : float
        The bisection ends when the force difference between both bounds is less than this value [mu
        m g].
    limit : float
        Maximum force that a motion can exert on a part [mu m g].
    prove : function, optional
        Function that returns whether a request is proven infeasible. The function is slow and is
        called at most once. If `prove` is not given, the solutions for the whole request and for
        the fraction are compared. The solution with the smaller error for the whole request is
        returned.
    """
    fits = min(1.0, limit / max(request.flags.max_force, 1e-300))
    solution = attempt(request if fits == 1 else request.scaled(fits))
    if solution.success and fits == 1:
        return solution
    low, best, iterations = _bisect(request, library, attempt, solution, fits, resolution, limit)
    proven = fits < 1 or (prove is not None and prove(request))
    why = solution.message
    if fits < 1:
        why = (
            f"the requested force on a part is {request.flags.max_force:.3g} mu m g, "
            f"allowed: {limit:g}"
        )
    elif proven:
        why = f"proven impossible for such motions; {why}"
    rest_of_whole = solution.residual + (1 - fits) * request.force
    if low > 0:
        residual = best.residual + (1 - low) * request.force
        message = f"a fraction of {low:.3g} of the request is met; the whole request fails: {why}"
        if prove is None and _size(rest_of_whole) < _size(residual):
            best, residual = solution, rest_of_whole
            message = (
                f"a fraction of {low:.3g} of the request can be met, but this solution is nearer "
                f"to the whole request; {why}"
            )
    elif request.must_move or _size(rest_of_whole) < WORTH_IT * _size(request.force):
        residual = rest_of_whole
        message = f"the request is not met, this is the nearest solution; {why}"
    else:
        best, residual = nothing(), request.force
        message = f"the request is not met, so the plate rests; {why}"
    return replace(
        best,
        success=False,
        message=message,
        residual=residual,
        iterations=iterations,
        condition=solution.condition,
        status=(Status.UNREACHABLE if proven else Status.PARTIAL if low > 0 else Status.FAILED),
        fraction=low,
    )


def _bisect(
    request: Request,
    library: Library,
    attempt: Callable[[Request], Solution],
    solution: Solution,
    fits: float,
    resolution: float,
    limit: float,
) -> tuple[float, Solution, int]:
    """Search for the largest feasible fraction of a request by bisection.

    `solution` is the solution for the fraction `fits` of the request. The other arguments are those
    of `largest_fraction`. Return the largest fraction that was met (0 if none was met), its
    solution, and the number of iterations of all solutions. If no fraction was met, the returned
    solution is `solution`.
    """
    low = fits if solution.success else 0.0
    high, best, iterations = fits, solution, solution.iterations
    if not request.flags.parts_move and not request.flags.has_tolerance:
        bound = reachable_fraction(library, request.position, request.force)
        high = min(high, MAX_TRIED * limit * bound)
    peak = float(np.max(np.abs(request.force)))
    trial = fits * CAUTION * _along(fits * request.force, solution.residual)
    for _ in range(BISECTIONS):
        if (high - low) * peak < resolution:
            break
        fraction = trial if low < trial < high else (low + high) / 2
        trial = 0.0
        result = attempt(request.scaled(fraction))
        iterations += result.iterations
        if result.success:
            low, best = fraction, result
        else:
            high = fraction
    return low, best, iterations


def reachable_fraction(library: Library, position: np.ndarray, force: np.ndarray) -> float:
    """Return the maximum factor by which the forces `force` (M, 2) [mu m g] can be multiplied
    so that a motion can still produce them.

    The reciprocal of the result is the minimum time that the forces need [cycles]. A linear
    programme computes this time. It does not require that the motion is closed. The result is
    an upper bound for all motions, because the forces of any motion are a weighted mean of the
    forces of the library's twists. The finite number of twists causes an error of a few per
    cent.
    """
    rows, right_side = library.forces(position), force.T.ravel()
    if not np.any(right_side):
        return float("inf")
    costs = np.full(len(rows), OUT_OF_REACH)
    return 1 / min_time(rows, right_side, np.ones(rows.shape[1]), costs).cost


def _along(requested: np.ndarray, missed: np.ndarray) -> float:
    """Return the component of the achieved forces in the direction of the requested forces, as a
    fraction of the requested forces."""
    size = float(np.sum(requested**2))  # no overflow, because the request was scaled
    return float(np.sum((requested - missed) * requested)) / size if size > 0 else 0.0


def _size(force: np.ndarray) -> float:
    """Return the root mean square of forces (M, 2). The computation does not overflow."""
    peak = float(np.max(np.abs(force)))
    return peak * float(np.sqrt(np.mean((force / peak) ** 2))) if peak > 0 else 0.0
