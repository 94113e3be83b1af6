"""What becomes of requests: the force that parts really get, hostile requests, manipulability."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from harness import Result, Table, cpu_time
from plate_core import Rig, load_rig
from plate_core.motion import usage
from plate_sim import simulate
from plate_solver import (
    RotationSolver,
    SinusoidSolver,
    Solution,
    Status,
    manipulability,
    manipulability_map,
)
from plate_solver.maps import step_forces
from plate_solver.requests import REFINEMENTS
from stages.scenes import scatter

METHODS: dict[str, Callable[..., Any]] = {"sinusoids": SinusoidSolver, "rotations": RotationSolver}

PARTS = (2, 4, 6, 10)
FORCES = (0.02, 0.04)
"""Greatest force wanted along each axis [mu m g]."""

CASES = {2: 12, 4: 12, 6: 6, 10: 3}
"""Requests by parts."""

RESTARTS = {2: 20, 4: 20, 6: 20, 10: 6}
"""Further starts of a solver by parts: many parts take seconds for each."""

DIP = 1e-3
"""Force [mu m g] by which an independent look may differ, at dips."""

JUDGE_SAMPLES = 20_011
"""Equal steps of the judge: no solver's own rule."""

NEAREST, FARTHEST = 0.005, 0.3
"""Distances of two approaching parts [m]."""


def measure(quick: bool) -> Result:
    """Measure realised forces, hostile requests and manipulability."""
    rig = load_rig()
    realised = [
        realised_row(rig, method, parts, refine, size, 2 if quick else CASES[parts])
        for size in FORCES
        for method in METHODS
        for refine in REFINEMENTS
        for parts in ((2, 4) if quick else PARTS)
    ]
    hostile = [
        hostile_row(rig, method, kind, 10 if quick else 100) for method in METHODS for kind in KINDS
    ]
    reach = [reach_row(rig, parts, 5 if quick else 40) for parts in (1, 2, 4, 6, 10, 16)]
    x, y, force = manipulability_map(rig, np.array([[0.1, 0.05], [-0.1, 0.0], [-0.15, 0.05]]))
    return Result(
        [
            Table(
                "realised",
                "Force over one cycle in the simulator: random requests",
                {
                    "size": "up to, each axis [mu m g]", "method": "method",
                    "refine": "refine", "parts": "parts M",
                    "error_percent": "error [%]", "worst_percent": "worst request [%]",
                    "predicted_percent": "predicted [%]", "share": "least share",
                    "met_percent": "met [%]", "median_ms": "median [ms]",
                },
                realised,
                "Parts at rest at the start. Error: root mean square of request minus realised, "
                "over the request's. Realised: the time average of friction, which is the gain of "
                "velocity over mu g T, for `none` and `velocity`; displacement over mu g T^2 for "
                "`cycle`. Predicted: the same of the solver's own residual. What is not met "
                "counts as error.",
            ),
            Table(
                "hostile",
                "Degenerate and hostile requests",
                {
                    "method": "method", "kind": "requests", "count": "number",
                    "solved": "solved", "partial": "in part", "unreachable": "unreachable",
                    "failed": "nothing", "errors": "exceptions", "untrue": "untrue",
                    "usage": "greatest use of a limit", "worst_ms": "slowest [ms]",
                },
                hostile,
                "Untrue: NaN, a limit broken, a residual that an independent evaluation of the "
                f"force map does not find within {DIP:g} mu m g, or a status or share against it.",
            ),
            Table(
                "manipulability",
                "Random places: what is guaranteed in every direction, before realisation",
                {
                    "parts": "parts M", "guaranteed": "guaranteed, median [mu m g]",
                    "guaranteed_low": "10 % [mu m g]", "condition": "condition, median",
                    "ms": "time [ms]",
                },
                reach,
                "A unit of force has a mean square over the parts of one.",
            ),
        ],
        summary(realised, hostile),
        [{"x": x.tolist(), "y": y.tolist(), "force": force.tolist()}],
    )  # fmt: skip


def realised_row(
    rig: Rig, method: str, parts: int, refine: str, size: float, count: int
) -> dict[str, Any]:
    """Solve random requests and let the simulator run the answers."""
    rng = np.random.default_rng(parts)
    solver = METHODS[method](rig, restarts=RESTARTS[parts])
    asked, missed, predicted, ms, solutions = [], [], [], [], []
    for number in range(count + 1):  # the first one warms up
        position = scatter(rig, parts, rng)
        force = rng.uniform(-size, size, (parts, 2))
        solver.reset()
        began = cpu_time()
        solution = solver.solve(position, force, refine=refine)
        if not number:
            continue
        ms.append(1e3 * (cpu_time() - began))
        cycle, friction = solution.cycle, rig.friction
        run = simulate(cycle, position, np.zeros_like(force), friction.mu, friction.gravity)
        got = run.velocity[-1] / (friction.accel * cycle.period)
        if refine == "cycle":
            got = (run.position[-1] - position) / (friction.accel * cycle.period**2)
        asked.append(rms(force))
        missed.append(rms(force - got))
        predicted.append(rms(solution.residual))
        solutions.append(solution)
    return {
        "size": size,
        "method": method,
        "refine": refine,
        "parts": parts,
        "error_percent": 100 * rms(missed) / rms(asked),
        "worst_percent": 100 * float(np.max(np.array(missed) / asked)),
        "predicted_percent": 100 * rms(predicted) / rms(asked),
        "share": min(solution.fraction for solution in solutions),
        "met_percent": 100 * float(np.mean([solution.success for solution in solutions])),
        "median_ms": float(np.median(ms)),
    }


def rms(values: Any) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def approaching(rig: Rig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two parts, near to far, pushed against each other."""
    gap = NEAREST * (FARTHEST / NEAREST) ** rng.uniform()
    angle, push = rng.uniform(0, 2 * np.pi, 2)
    arm = gap / 2 * np.array([np.cos(angle), np.sin(angle)])
    force = 0.1 * np.array([np.cos(push), np.sin(push)])
    middle = rng.uniform(-0.4, 0.4, 2) * rig.plate.half
    return np.array([middle - arm, middle + arm]), np.array([force, -force])


def anywhere(rig: Rig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Some parts on the plate, small and great forces."""
    count = int(rng.integers(1, 7))
    size = 10 ** rng.uniform(-3, 0)
    position = rng.uniform(-1, 1, (count, 2)) * rig.plate.half
    return position, rng.uniform(-size, size, (count, 2))


def far_outside(rig: Rig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The same, metres away from all centres."""
    position, force = anywhere(rig, rng)
    return position * 10 ** rng.uniform(0, 3), force


def on_centres(rig: Rig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Parts on centres of Method A's library."""
    centres = RotationSolver(rig).library.centre
    chosen = centres[rng.choice(len(centres), int(rng.integers(1, 5)), replace=False)]
    return chosen, rng.uniform(-0.1, 0.1, chosen.shape)


def coincident(rig: Rig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two or three parts in one place, pushed different ways; another one elsewhere."""
    place, other = rng.uniform(-0.8, 0.8, (2, 2)) * rig.plate.half
    position = np.array([place] * int(rng.integers(2, 4)) + [other])
    return position, rng.uniform(-0.1, 0.1, position.shape)


def nothing(rig: Rig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """No force anywhere."""
    position, force = anywhere(rig, rng)
    return position, 0 * force


def too_much(rig: Rig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """More than friction gives."""
    position, force = anywhere(rig, rng)
    return position, force / np.max(np.abs(force)) * 10 ** rng.uniform(0, 6)


KINDS = {
    "anywhere": anywhere, "approaching": approaching, "far outside": far_outside,
    "on centres": on_centres, "coincident": coincident, "zero": nothing, "too much": too_much,
}  # fmt: skip


def hostile_row(rig: Rig, method: str, kind: str, count: int, seed: int = 0) -> dict[str, Any]:
    """Make many requests of one kind, some with slack, and check every answer."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    solver = METHODS[method](rig, restarts=1, iterations=20)
    solver.solve(np.array([[0.1, 0.0], [-0.1, 0.0]]), np.array([[0.1, 0.0], [0.0, 0.1]]))
    statuses: Counter[Status] = Counter()
    errors, untrue, most, slowest = 0, 0, 0.0, 0.0
    for number in range(count):
        position, force = KINDS[kind](rig, rng)
        tolerance = np.zeros_like(force)
        tolerance[:, 1] = (0.0, 0.0, 0.05, np.inf)[number % 4]
        solver.reset()
        began = cpu_time()
        try:
            solution = solver.solve(position, force, tolerance=tolerance)
        except Exception as error:  # any at all is what this counts
            print(f"{method}, {kind}, request {number}: {error!r}", file=sys.stderr)
            errors += 1
            continue
        slowest = max(slowest, 1e3 * (cpu_time() - began))
        statuses[solution.status] += 1
        most = max(most, usage(rig, solution.cycle).worst)
        if not is_true(rig, solution, position, force, tolerance, solver.options.tolerance):
            print(f"{method}, {kind}, request {number}: {solution.message}", file=sys.stderr)
            untrue += 1
    return {
        "method": method, "kind": kind, "count": count,
        **{status.value: statuses[status] for status in Status},
        "errors": errors, "untrue": untrue, "usage": most, "worst_ms": slowest,
    }  # fmt: skip


def is_true(
    rig: Rig,
    solution: Solution,
    position: np.ndarray,
    force: np.ndarray,
    tolerance: np.ndarray,
    own: float,
) -> bool:
    """Whether an answer is within the limits and what it says of itself is so."""
    t = (np.arange(JUDGE_SAMPLES) + 0.5) / JUDGE_SAMPLES * solution.cycle.period
    still, equal = np.zeros_like(position), np.ones(JUDGE_SAMPLES)
    got = step_forces(position, still, solution.cycle.twist(t), equal)[:, :2]
    bound = DIP * max(1.0, float(np.max(np.abs(force))))
    missed = np.abs(solution.fraction * force - got) - tolerance
    return bool(
        usage(rig, solution.cycle).worst <= 1
        and np.all(np.isfinite(solution.residual))
        and np.all(np.abs(force - got - solution.residual) <= bound)
        and solution.success == (solution.status is Status.SOLVED) == (solution.fraction == 1)
        and (solution.fraction == 0 or np.all(missed <= own + bound))
    )


def reach_row(rig: Rig, parts: int, count: int) -> dict[str, Any]:
    """Sum up the manipulability of random places."""
    rng = np.random.default_rng(parts)
    manipulability(rig, scatter(rig, parts, rng))
    began = cpu_time()
    found = [manipulability(rig, scatter(rig, parts, rng)) for _ in range(count)]
    forces = [one.weakest_force for one in found]
    return {
        "parts": parts,
        "guaranteed": float(np.median(forces)),
        "guaranteed_low": float(np.percentile(forces, 10)),
        "condition": float(np.median([one.condition for one in found])),
        "ms": 1e3 * (cpu_time() - began) / count,
    }


def summary(realised: list[dict[str, Any]], hostile: list[dict[str, Any]]) -> list[str]:
    """Sum up in sentences."""
    lines = []
    for method in METHODS:
        for size in FORCES:
            shares = ", ".join(
                f"{row['error_percent']:.1f} % at {row['parts']}"
                for row in realised
                if (row["method"], row["refine"], row["size"]) == (method, "cycle", size)
            )
            lines.append(
                f"{method}, refine=cycle, up to {size} mu m g: the simulator's force misses "
                f"{shares} parts"
            )
    count = sum(row["count"] for row in hostile)
    wrong = sum(row["errors"] + row["untrue"] for row in hostile)
    lines.append(f"{count} degenerate and hostile requests: {wrong} exceptions or untrue answers")
    return lines
