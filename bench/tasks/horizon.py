"""Trials beyond the greedy step: a motion played again, a learned cost-to-go, a learned start.

Each answer of the solver minimises what its one cycle leaves to do,

    J(x1) = |w way(x1)|^2 + edges + neighbours,   x1 = F(x0, p0; a),

over coefficients a; F moves the parts' state x0, the plate begins in p0. Here the same loop takes

- `n times`: J(xn) of the same coefficients played n times, xk = F(xk-1, pk-1; a), pk = E a: no
  parameters more. An evaluation costs more, so fewer starts are made;
- `cost-to-go`: of the five best motions the one with the least v phi(x1), a regression of the ways
  that are left `LATER` cycles later, learned from sorts of its own (phi: `features`);
- `network`: one start, and three near what comes of it, from the network of examples/agents, which
  knows four parts.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np

from harness import Cache, Result, Table, by_case, missing, optional
from plate_bringup import loop
from plate_bringup.loop import Setup, summary, with_settings
from plate_core import PlateCycle, load_rig
from plate_core.motion import quintic_pieces
from plate_solver import Controller, Goal
from plate_solver.sinusoids import (
    TAIL_LOOKS,
    TAIL_PERIOD_S,
    TAIL_S,
    LimitedSinusoids,
    SinusoidBasis,
    SinusoidSteering,
    limited_sinusoids,
    steer,
)
from tasks.choosing import Following, Judging, Proposing, learned
from tasks.runs import UNEVEN, summed

SEEDS: dict[str, dict[str, int]] = {
    "sort_10": {"2 times": 20, "3 times": 14, "cost-to-go": 10},
    "sort_24": {"2 times": 6},
    "assemble_8": {"2 times": 6},
    "sort_4": {"network": 13},
}
"""Scenario -> how many seeds of each trial, from `FIRST` on."""

FIRST, LEARNED_FROM = 57_100, range(57_000, 57_004)
"""Seed of the first run; seeds of the sorts from which a cost-to-go is learned."""

TRIALS: dict[str, tuple[str, int, int]] = {
    "present": ("", 1, 40), "2 times": ("n times", 2, 20), "3 times": ("n times", 3, 13),
    "cost-to-go": ("cost-to-go", 1, 40), "network": ("network", 1, 40),
}  # fmt: skip
"""Trial -> kind, plays of the motion, and restarts, by which an answer costs about the same."""


def measure(quick: bool) -> Result:
    """Run every trial beside the present solver, seed by seed."""
    cache, counts = Cache.of(__name__), SEEDS
    if quick:
        counts = {"sort_10": dict.fromkeys(SEEDS["sort_10"], 1)}
    elif not optional("gymnasium"):
        counts = {name: own for name, own in SEEDS.items() if "network" not in own}
    sorts = {"learned": [(seed,) for seed in (LEARNED_FROM[:1] if quick else LEARNED_FROM)]}
    groups = [group for sort in by_case(what_comes, sorts, cache, 1)["learned"] for group in sort]
    value = {"cost-to-go": learned(groups)}
    names = {
        (scenario, FIRST + k): ["present", *(trial for trial in own if k < own[trial])]
        for scenario, own in counts.items()
        for k in range(max(own.values()))
    }
    cases = {
        case: [(*case, *TRIALS[trial], value.get(trial)) for trial in trials]
        for case, trials in names.items()
    }
    found = by_case(tried, cases, cache, 1)  # side by side they would slow each other down
    runs = {case: dict(zip(names[case], found[case], strict=True)) for case in cases}
    rows = []
    for scenario, own in counts.items():
        for trial, count in {"present": max(own.values()), **own}.items():
            these = [runs[scenario, FIRST + k] for k in range(count)]
            rows.append({"scenario": scenario, "trial": trial} | compared(these, trial))
    facts = {"first": FIRST, "learned": len(LEARNED_FROM)}
    return Result([Table.of("horizon", rows, **facts)], missing("gymnasium"))


def compared(runs: list[dict[str, Any]], trial: str) -> dict[str, Any]:
    """Sum up the runs of a trial, beside those of the present solver of the same seeds."""

    def of(name: str, key: str) -> np.ndarray:
        return np.array([run[name][key] for run in runs])

    time, before = of(trial, "time_s"), of("present", "time_s")
    change = 100 * (time - before) / np.mean(before)
    answer = of(trial, "solve_ms_median") / of("present", "solve_ms_median")
    return summed(run[trial] for run in runs) | {
        "mean_s": float(np.mean(time)),
        "change": float(np.mean(change)),
        "error": float(np.std(change) / max(len(change) - 1, 1) ** 0.5),
        "answer": float(np.median(answer)),
    }


def tried(
    scenario: str, seed: int, kind: str, plays: int, restarts: int, value: list[float] | None
) -> dict[str, Any]:
    """Run the closed loop once; returns a row of `bench/closed_loop.py`."""
    options: dict[str, dict[str, Any]] = {
        "n times": {"plays": plays}, "cost-to-go": {"value": value},
    }  # fmt: skip
    return driven(scenario, seed, restarts, kind, options.get(kind, {}))


def what_comes(seed: int) -> list[list[list[float]]]:
    """Sort ten parts; returns what `learned` takes."""
    groups: list[list[list[float]]] = []
    driven("sort_10", seed, 20, "following", {"groups": groups})
    return groups


def driven(
    scenario: str, seed: int, restarts: int, kind: str, options: dict[str, Any]
) -> dict[str, Any]:
    """Run the closed loop, friction uneven by 10 %, with a steering of `STEERING`."""
    setup = with_settings(Setup(scenario, seed), UNEVEN | {"restarts": str(restarts)})
    with patch.object(loop, "Controller", partial(Trying, kind, options)):
        return summary(setup, load_rig())


class Trying(Controller):
    """The controller with a steering of this module in place of its own."""

    def __init__(self, kind: str, options: dict[str, Any], *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        solver: Any = self._solvers["sinusoids"]
        own = solver._steering
        if kind:
            now = STEERING[kind](own._limits, own._full, own._iterations, own._restarts)
            vars(now).update(options)
            solver._steering = now

    def answer(self, wanted: Any, running: Any, until: float = np.inf) -> Any:
        """Tell the steering what the camera saw, too."""
        steering: Any = self._solvers["sinusoids"]
        steering._steering.seen = wanted.parts, running
        return super().answer(wanted, running, until)


class Repeating(SinusoidSteering):
    """Judges a motion by where parts are once it was played `plays` times."""

    plays = 2

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.bases: dict[Any, SinusoidBasis] = {}

    def steer(self, goal: Goal, number: int, period: float, *args: Any) -> Any:
        """Find a motion; what must end at rest is not played again."""
        if not goal.free_end:
            return super().steer(goal, number, period, *args)
        one = limited_sinusoids

        def family(*key: Any) -> LimitedSinusoids:
            number, period, limits, most, grid, _, plate = key
            kind = number, period, grid
            if kind not in self.bases:
                self.bases[kind] = repeated(one(*key).basis, self.plays)
            return LimitedSinusoids(self.bases[kind], limits, most, plate)

        with patch.object(steer, "limited_sinusoids", family):
            cycle, *statistics = super().steer(goal, number, period, *args)
        end = len(cycle.times) // self.plays
        times, pose, twist, accel = (knots[: end + 1].copy() for knots in cycle.knots)
        tail = PlateCycle.stopping(cycle.state(end), TAIL_S, TAIL_PERIOD_S)
        spline = cycle.coefficients[:end].copy()
        return PlateCycle(times, pose, twist, accel, spline, tail), *statistics


def repeated(basis: SinusoidBasis, plays: int) -> SinusoidBasis:
    """Return the basis of motions with a free end that are played `plays` times.

    The plate settles from the state E a in which the play before has ended, so pose, twist and
    acceleration stay linear in the coefficients a: (B + S E) a, S the way to rest from a state.
    """
    end, more = np.stack([knots[-1] for knots in basis.knots]), plays - 1
    inner = len(basis.looks[0]) - TAIL_LOOKS

    def again(first: Any, settling: Any, last: Any = None) -> Any:
        last = first[:0] if last is None else last
        return np.vstack([first, *[first + settling @ end] * more, last])

    def once(settling: Any, inner: int | None = None) -> Any:
        own = settling[:inner]
        rest = np.zeros((more * len(own) + len(settling) - len(own), 3))
        return np.vstack([own, rest])

    pose, twist, accel = map(again, (basis.pose, basis.twist, basis.accel), basis.settling)
    looks = zip(basis.looks, basis.settling_looks, strict=True)
    knots = zip(basis.knots, basis.settling_knots, strict=True)
    pieces = quintic_pieces(basis.times, *basis.settling_knots).reshape(-1, 3)
    steps = [basis.times[:-1] + k * basis.period for k in range(plays)]
    changed: dict[str, Any] = {
        "period": plays * basis.period, "steps": plays * basis.steps,
        "pose": pose, "twist": twist, "accel": accel, "spline": again(basis.spline, pieces),
        "times": np.append(np.concatenate(steps), plays * basis.period),
        "knots": tuple(again(own[:-1], way[:-1], own[-1:]) for own, way in knots),
        "looks": tuple(again(own[:inner], way[:inner], own[inner:]) for own, way in looks),
        "settling": tuple(map(once, basis.settling)),
        "settling_knots": tuple(once(way, -1) for way in basis.settling_knots),
        "settling_looks": tuple(once(way, inner) for way in basis.settling_looks),
    }  # fmt: skip
    return replace(basis, **changed)


STEERING: dict[str, Any] = {
    "n times": Repeating, "cost-to-go": Judging, "network": Proposing, "following": Following,
}  # fmt: skip
"""Kind of a trial -> its steering."""
