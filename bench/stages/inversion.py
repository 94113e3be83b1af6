"""Method B: fractions of requests that are solved, and that are proven unreachable.

No seed of these requests was used during the development of the solver. All results are checked by
`average_force` on the finished cycle.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import Result, Table, timed
from plate_core import Rig, load_rig
from plate_solver import SinusoidSolver, Status, average_force
from stages.scenes import targets
from stages.solver import TOLERANCE
from tasks.runs import median

SEED = 30_000
"""First seed of the requests; the number of parts and harmonics is added."""

CASES = ((3, 2), (4, 2), (5, 2), (5, 3), (6, 3), (7, 3), (8, 3))
"""Numbers of parts M and harmonics N, up to cases with 2 M > 6 N - 2, the rank of the motions."""

TEN_TIMES = 1000
"""Number of restarts in a longer search, for comparison. The solver uses 100."""


def measure(quick: bool) -> Result:
    """Solve random requests for all numbers of parts and harmonics."""
    rig = load_rig()
    fates = [fate(rig, parts, number, 3 if quick else 30) for parts, number in CASES]
    free = [fate(rig, parts, 0, 2 if quick else 15) for parts in (3, 4, 5, 6, 8)]
    return Result([Table.of("fate", [*fates, *free])])


def fate(rig: Rig, parts: int, number: int, count: int) -> dict[str, Any]:
    """Return the row of a case: numbers of requests that are solved, proven unreachable, or
    neither."""
    solver = SinusoidSolver(rig, harmonics=number)
    thorough = SinusoidSolver(rig, harmonics=number, restarts=TEN_TIMES)
    rng = np.random.default_rng(SEED + 100 * parts + number)
    answers, more, wrong, times = [], 0, 0, []
    for position, force in targets(rig, parts, count, rng):
        solver.reset()
        answer, seconds = timed(solver.solve, position, force)
        times.append(1e3 * seconds)
        answers.append(answer)
        error = np.max(np.abs(average_force(answer.cycle, position) - force))
        wrong += answer.success and bool(error > TOLERANCE)
        if not answer.success:
            thorough.reset()
            more += thorough.solve(position, force).success
    solved = sum(answer.success for answer in answers)
    proven = sum(answer.status is Status.UNREACHABLE for answer in answers)
    return {
        "parts": parts, "harmonics": number or f"({solver.harmonics(2 * parts)})",
        "solved": 100 * solved / count, "more": 100 * (solved + more) / count,
        "proven": 100 * proven / count, "wrong": int(wrong),
        "share": median([answer.fraction for answer in answers if not answer.success]),
        "median_ms": median(times),
    }  # fmt: skip
