"""Method B's inversion of the average map: beside scipy, from several starts, to its end.

Requests are fresh: no seed here was used while the solver was made. All answers are judged by
`average_force` on the finished cycle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from harness import Result, Table, cpu_time, shown
from plate_core import Rig, load_rig
from plate_solver import Limits, SinusoidSolver, Status, average_force
from plate_solver.maps import force_rules, sinusoid_forces
from plate_solver.sinusoids import invert, sinusoid_basis
from stages.scenes import targets
from stages.solver import TOLERANCE, ScipySolver

SEED = 30_000
"""First seed of the requests; the number of parts and harmonics is added."""

CASES = ((3, 2), (4, 2), (5, 2), (5, 3), (6, 3), (7, 3), (8, 3))
"""Parts M and harmonics N: up to where the rank, 6 N - 2, no longer allows 2 M numbers."""

TEN_TIMES = 1000
"""Restarts of the search that shows what more of them find; the solver's own: 100."""

CREEP = 0.004
"""Change of a request from one image to the next [mu m g], root mean square."""


TABLE_SIZE = 20_000
"""Entries: a fifth of a second to make. More do not make better guesses for several parts."""

ANY_PERIOD = 1.0
"""Averaged forces do not depend on the period [s]."""


class GuessTable:
    """The paper's table of first guesses (3.2.3, figure 13): motions by (place, force).

    Random motions are piped through the force map at random places; a k-d tree finds the motions
    that did something like what is asked now.

    Parameters
    ----------
    coefficients : (S, h, 3)
        Motions of a family.
    position : (S, 2)
        Places [m], plate_home.
    force : (S, 2)
        Their average forces there [mu m g].
    half : (2,)
        Half sides of the plate [m]: scale of places.
    """

    def __init__(
        self, coefficients: np.ndarray, position: np.ndarray, force: np.ndarray, half: np.ndarray
    ) -> None:
        self.coefficients, self.position, self.force = coefficients, position, force
        self._scale = np.concatenate([half, np.full(2, max(float(force.std()), 1e-12))])
        self._tree = cKDTree(np.hstack([position, force]) / self._scale)

    @classmethod
    def make(
        cls, rig: Rig, number: int, at_rest: bool, seed: int = 0, size: int = TABLE_SIZE
    ) -> GuessTable:
        """Make a table for motions of `number` harmonics: the same seed makes the same table."""
        rng = np.random.default_rng(seed)
        basis, limits = sinusoid_basis(number, ANY_PERIOD, at_rest), Limits.of(rig)
        coefficients = rng.normal(size=(size, basis.size, 3))
        coefficients[:, :, 2] /= limits.arm_m
        position = rng.uniform(-rig.plate.half, rig.plate.half, (size, 2))
        waves = np.einsum("jh,shc->sjc", basis.span, coefficients)
        force = sinusoid_forces(waves, position, np.zeros_like(position), force_rules(number))
        return cls(coefficients, position, force, rig.plate.half)

    def nearest(self, position: np.ndarray, force: np.ndarray, count: int = 1) -> list[np.ndarray]:
        """Return coefficients (h, 3) for the parts' mean place and mean force, best first.

        Parameters
        ----------
        position, force : (M, 2)
            [m] in plate_home, [mu m g].
        """
        query = np.concatenate([position.mean(axis=0), force.mean(axis=0)]) / self._scale
        _, index = self._tree.query(query, k=count)
        return [self.coefficients[i] for i in np.atleast_1d(index)]


def measure(quick: bool) -> Result:
    """Measure speed beside scipy, starts, and what becomes of requests."""
    rig = load_rig()
    pairs = race_with_scipy(rig, 12 if quick else 300)
    starts = compare_starts(rig, 12 if quick else 200)
    fates = [fate(rig, parts, number, 3 if quick else 30) for parts, number in CASES]
    free = [fate(rig, parts, 0, 2 if quick else 15) for parts in (3, 4, 5, 6, 8)]
    ours, peer = pairs
    return Result(
        [
            Table(
                "speed",
                "2 parts, N = 2, requests up to 0.2 mu m g, cold start",
                {
                    "method": "method", "solved": "true error below 1e-4 [%]",
                    "median_ms": "median [ms]", "p99_ms": "99 % [ms]",
                },
                pairs,
                "Restarts included. Ours ends with a PlateCycle within the limits, scipy's with "
                "the parameters: least_squares(method='lm'), our Jacobian, random starts.",
            ),
            Table(
                "starts",
                "First guesses",
                {
                    "parts": "parts M", "start": "start", "first": "solved at the first try [%]",
                    "iterations": "iterations, median", "most": "iterations, 99 %",
                },
                starts,
                f"warm: the request crept by {CREEP} mu m g since the last solution, as in a "
                "closed loop. table: nearest in a k-d tree over mean place and force, as the paper "
                "has it. best of 12: random motions tried at the parts' places, both ways round.",
            ),
            Table(
                "fate",
                "What becomes of requests up to 0.2 mu m g",
                {
                    "parts": "parts M", "harmonics": "harmonics N", "solved": "solved [%]",
                    "more": "by ten times the starts [%]", "proven": "proven out of reach [%]",
                    "wrong": "wrong successes",
                    "share": "share met of the rest, median", "median_ms": "median [ms]",
                },
                [*fates, *free],
                "Harmonics: as asked for, or as the solver chooses (in brackets).",
            ),
        ],
        [
            f"2 parts: {shown(ours['solved'])} % solved in {shown(ours['median_ms'])} ms "
            f"(99 %: {shown(ours['p99_ms'])}), scipy {shown(peer['median_ms'])} ms "
            f"({shown(peer['p99_ms'])}): {peer['median_ms'] / ours['median_ms']:.1f} and "
            f"{peer['p99_ms'] / ours['p99_ms']:.1f} times as long",
            "warm start: "
            + ", ".join(
                f"{row['iterations']:.0f} iterations at {row['parts']} parts"
                for row in starts
                if row["start"] == "warm"
            ),
            "solved or proven: "
            + ", ".join(
                f"{row['solved'] + row['proven']:.0f} % of {row['parts']} parts at N = "
                f"{row['harmonics']}"
                for row in fates
            ),
        ],
    )  # fmt: skip


def race_with_scipy(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Solve the same requests by both, in turns."""
    ours, peer = SinusoidSolver(rig, harmonics=2, period=0.05), ScipySolver(rig, 2, 0.05)
    times: dict[str, list[float]] = {"SinusoidSolver": [], "scipy lm": []}
    good = dict.fromkeys(times, 0)
    basis = sinusoid_basis(2, 0.05, False)
    for index, (position, force) in enumerate(
        targets(rig, 2, count + 1, np.random.default_rng(SEED))
    ):
        for name, solver in (("SinusoidSolver", ours), ("scipy lm", peer)):
            solver.reset()
            began = cpu_time()
            answer = solver.solve(position, force)
            seconds = cpu_time() - began
            if not index:  # the first one warms up
                continue
            times[name].append(1e3 * seconds)
            cycle = (
                basis.cycle(peer.family.coefficients(answer))
                if isinstance(answer, np.ndarray)
                else answer.cycle
            )
            error = np.max(np.abs(average_force(cycle, position) - force))
            good[name] += bool(error < TOLERANCE)
    return [
        {
            "method": name,
            "solved": 100 * good[name] / count,
            "median_ms": float(np.median(ms)),
            "p99_ms": float(np.percentile(ms, 99)),
        }
        for name, ms in times.items()
    ]


def compare_starts(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Count iterations from several kinds of first guess, same requests."""
    table = GuessTable.make(rig, 2, False)
    turns = np.array([1.0, 1.0, Limits.of(rig).arm_m])  # parameters of coefficients
    rows = []
    for parts in (1, 2, 3):
        solver = SinusoidSolver(rig, harmonics=2, period=0.05)
        known, pool = solver.search_of(2 * parts)
        rng = np.random.default_rng(SEED + parts)
        counts: dict[str, list[tuple[int, int]]] = {
            "warm": [], "table": [], "best of 12": [], "random": [],
        }  # fmt: skip
        still, none = np.zeros((parts, 2)), np.empty((0, pool.shape[1]))
        for position, force in targets(rig, parts, count, rng):
            before = force + CREEP * rng.normal(size=force.shape)
            last = invert(none, pool, position, still, before, known, TOLERANCE, 40, 41)
            guess = (table.nearest(position, force)[0] * turns).ravel()[None]
            firsts = {
                "warm": last.theta[None], "table": guess, "best of 12": none,
                "random": rng.normal(size=(41, pool.shape[1])),
            }  # fmt: skip
            for name, first in firsts.items():
                if name == "warm" and last.worst > TOLERANCE:
                    continue
                found = invert(first, pool, position, still, force, known, TOLERANCE, 40, 41)
                counts[name].append((found.iterations, found.tries))
        rows += [
            {
                "parts": parts,
                "start": name,
                "first": 100 * float(np.mean([tries == 1 for _, tries in pairs])),
                "iterations": float(np.median([steps for steps, _ in pairs])),
                "most": float(np.percentile([steps for steps, _ in pairs], 99)),
            }
            for name, pairs in counts.items()
        ]
    return rows


def fate(rig: Rig, parts: int, number: int, count: int) -> dict[str, Any]:
    """Tell how many requests are solved, proven out of reach, or neither."""
    solver = SinusoidSolver(rig, harmonics=number)
    thorough = SinusoidSolver(rig, harmonics=number, restarts=TEN_TIMES)
    rng = np.random.default_rng(SEED + 100 * parts + number)
    solved = more = proven = wrong = 0
    times, shares = [], []
    for position, force in targets(rig, parts, count, rng):
        solver.reset()
        began = cpu_time()
        answer = solver.solve(position, force)
        times.append(1e3 * (cpu_time() - began))
        error = np.max(np.abs(average_force(answer.cycle, position) - force))
        solved += answer.success
        wrong += answer.success and bool(error > TOLERANCE)
        proven += answer.status is Status.UNREACHABLE
        if not answer.success:
            shares.append(answer.fraction)
            thorough.reset()
            more += thorough.solve(position, force).success
    chosen = solver.harmonics(2 * parts)
    return {
        "parts": parts,
        "harmonics": number or f"({chosen})",
        "solved": 100 * solved / count,
        "more": 100 * (solved + more) / count,
        "proven": 100 * proven / count,
        "wrong": int(wrong),
        "share": float(np.median(shares)) if shares else None,
        "median_ms": float(np.median(times)),
    }
