"""Trials of longer horizons: a motion played repeatedly, a learned cost-to-go, a learned start.

The solver minimises the remaining error after its motion was played n times,

    J(xn) = |w way(xn)|^2 + edges + neighbours,   xk = F(xk-1, pk-1; a),   pk = E a,

over the coefficients a. Here w way are the weighted distances to go, F is the cycle map of the
parts' state, and pk is the plate's state at the start of play k + 1. The trials are

- `once`, `2 times` (the default), `3 times`: n = 1, 2, 3 with 40, 20 and 14 starts, because more
  plays take longer to evaluate. The other trials use n = 1, and are compared with `once`:
- `cost-to-go`: of the five best motions, the solver uses the one with the minimum v phi(x1). v is a
  regression of the distances to go after `LATER` more cycles, learned from other sort tasks (phi:
  `features`).
- `network`: one start from the network of examples/agents, which is trained for four parts, and
  three starts near its result.
"""

from __future__ import annotations

from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np

from harness import Cache, Result, Table, by_case, missing, optional
from plate_bringup import loop
from plate_bringup.loop import Setup, summary, with_settings
from plate_core import load_rig
from plate_solver import Controller
from plate_solver.sinusoids import steer
from tasks.choosing import Following, Judging, Proposing, learned
from tasks.runs import UNEVEN, summed

SEEDS: dict[str, dict[str, int]] = {
    "sort_10": {"2 times": 20, "3 times": 14, "cost-to-go": 10},
    "sort_24": {"2 times": 6},
    "assemble_8": {"2 times": 6},
    "sort_4": {"network": 13},
}
"""Number of seeds of each trial from `FIRST` on, by scenario."""

FIRST, LEARNED_FROM = 57_100, range(57_000, 57_004)
"""Seed of the first run, and seeds of the sort tasks from which the cost-to-go is learned."""

TRIALS: dict[str, tuple[str, int]] = {
    "once": ("", 1), "2 times": ("", 2), "3 times": ("", 3),
    "cost-to-go": ("cost-to-go", 1), "network": ("network", 1),
}  # fmt: skip
"""Kind, and number of plays of the motion, by trial."""


def measure(quick: bool) -> Result:
    """Run every trial and the search with one play with the same seeds."""
    cache, counts = Cache.of(__name__), SEEDS
    if quick:
        counts = {"sort_10": dict.fromkeys(SEEDS["sort_10"], 1)}
    elif not optional("gymnasium"):
        counts = {name: own for name, own in SEEDS.items() if "network" not in own}
    sorts = {"learned": [(seed,) for seed in (LEARNED_FROM[:1] if quick else LEARNED_FROM)]}
    groups = [group for sort in by_case(what_comes, sorts, cache, 1)["learned"] for group in sort]
    value = {"cost-to-go": learned(groups)}
    names = {
        (scenario, FIRST + k): ["once", *(trial for trial in own if k < own[trial])]
        for scenario, own in counts.items()
        for k in range(max(own.values()))
    }
    cases = {
        case: [(*case, *TRIALS[trial], value.get(trial)) for trial in trials]
        for case, trials in names.items()
    }
    # Use one process, because parallel runs would slow each other down.
    found = by_case(tried, cases, cache, 1)
    runs = {case: dict(zip(names[case], found[case], strict=True)) for case in cases}
    rows = []
    for scenario, own in counts.items():
        for trial, count in {"once": max(own.values()), **own}.items():
            these = [runs[scenario, FIRST + k] for k in range(count)]
            rows.append({"scenario": scenario, "trial": trial} | compared(these, trial))
    facts = {"first": FIRST, "learned": len(LEARNED_FROM)}
    return Result([Table.of("horizon", rows, **facts)], missing("gymnasium"))


def compared(runs: list[dict[str, Any]], trial: str) -> dict[str, Any]:
    """Return the row that compares the runs of a trial with those of one play, for the same
    seeds."""

    def of(name: str, key: str) -> np.ndarray:
        return np.array([run[name][key] for run in runs])

    time, before = of(trial, "time_s"), of("once", "time_s")
    change = 100 * (time - before) / np.mean(before)
    answer = of(trial, "solve_ms_median") / of("once", "solve_ms_median")
    return summed(run[trial] for run in runs) | {
        "mean_s": float(np.mean(time)),
        "change": float(np.mean(change)),
        "error": float(np.std(change) / max(len(change) - 1, 1) ** 0.5),
        "answer": float(np.median(answer)),
    }


def tried(
    scenario: str, seed: int, kind: str, plays: int, value: list[float] | None
) -> dict[str, Any]:
    """Run the closed loop once. Return a row of `bench/closed_loop.py`."""
    return driven(scenario, seed, plays, kind, {"value": value} if kind == "cost-to-go" else {})


def what_comes(seed: int) -> list[list[list[float]]]:
    """Sort ten parts. Return the input of `learned`."""
    groups: list[list[list[float]]] = []
    driven("sort_10", seed, 1, "following", {"groups": groups}, restarts="20")
    return groups


def driven(
    scenario: str, seed: int, plays: int, kind: str, options: dict[str, Any], **settings: str
) -> dict[str, Any]:
    """Run the closed loop with friction uneven by 10 % and a steering of `STEERING`."""
    setup = with_settings(Setup(scenario, seed), UNEVEN | settings)
    trying = patch.object(loop, "Controller", partial(Trying, kind, options))
    with trying, patch.object(steer, "PLAYS", plays):
        return summary(setup, load_rig())


class Trying(Controller):
    """The controller with a steering of this module instead of its own."""

    def __init__(self, kind: str, options: dict[str, Any], *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        solver: Any = self._solvers["sinusoids"]
        own = solver._steering
        if kind:
            now = STEERING[kind](own._limits, own._full, own._iterations, own._restarts)
            vars(now).update(options)
            solver._steering = now

    def answer(self, wanted: Any, running: Any, until: float = np.inf) -> Any:
        """Return the controller's answer. Also give the steering the request's parts."""
        steering: Any = self._solvers["sinusoids"]
        steering._steering.seen = wanted.parts, running
        return super().answer(wanted, running, until)


STEERING: dict[str, Any] = {
    "cost-to-go": Judging, "network": Proposing, "following": Following
}  # fmt: skip
"""Steering, by kind of a trial."""
