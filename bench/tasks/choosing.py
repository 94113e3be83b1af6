"""Variants of the solver that choose among the motions of one search, for `horizon`.

The cost-to-go of a motion is v phi(x1). x1 is the state of plate and parts after the motion, and
phi are the `features` of this state. v is fitted by ridge regression to the distances that remain
after `LATER` more cycles of the solver. Only differences between the motions of the same search are
fitted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from harness import ROOT
from plate_core import load_rig
from plate_solver import Goal
from plate_solver.cycle_map import end_state
from plate_solver.sinusoids import (
    AT_ONCE,
    ROUGH,
    SPREAD,
    LimitedSinusoids,
    Problem,
    SinusoidSteering,
    descend,
    limited_sinusoids,
    sinusoid_basis,
)

BEST, LATER, STARTS, STEPS, TWICE, EVERY = 5, 6, 4, 12, 2, 5
"""Number of best motions that are compared in a search; number of cycles until they are evaluated;
number of descents in each of these cycles; number of iterations of a descent; number of repetitions
for each motion. Only every EVERY-th search is used."""

RIDGE = 100.0
"""Ridge parameter of the regression, for features in units of their standard deviation."""

NEAR = 3
"""Number of starts near the motion that the network proposes."""

LANE_M, CLEAR_M, ARM_M = 0.03, 0.04, 0.2
"""Distance from a part's path within which another part is an obstacle; distance of two centres
below which parts are too close; lever arm that converts rotation of the plate to a shift [m]."""


class Comparing(SinusoidSteering):
    """Steering that records the motions found by a search and its goal, so that subclasses can
    choose another motion."""

    def steer(self, goal: Goal, number: int, period: float, *args: Any) -> Any:
        """Find a motion."""
        self.goal, self.key = goal, (number, period, ROUGH, goal.free_end)
        return super().steer(goal, number, period, *args)

    def _search(self, improved: Any, *args: Any) -> Any:
        self.found: list[Any] = []

        def noted(start: np.ndarray) -> Any:
            self.found.append(improved(start))
            return self.found[-1]

        best, iterations = super()._search(noted, *args)
        return self.chosen(best) if self.goal.free_end else best, iterations

    def chosen(self, best: Any) -> Any:
        """Return the motion to use. `best` is the motion with the minimum cost."""
        return best

    def family(self, goal: Goal) -> LimitedSinusoids:
        """Return the family of motions within the limits that begin in the goal's plate state."""
        number, period, grid, free = self.key
        return limited_sinusoids(number, period, self._limits, 1.0, grid, free, goal.plate)

    def finished(self) -> list[np.ndarray]:
        """Return the parameters of the `BEST` motions, corrected to the limits."""
        motions, best = self._motions[self.key], sorted(self.found, key=lambda one: one.cost)
        return [self._within(self.goal, motions, f.parameters, 0.0).parameters for f in best[:BEST]]


class Judging(Comparing):
    """Steering that uses the motion with the minimum cost-to-go among the best motions."""

    value: list[float]

    def chosen(self, best: Any) -> Any:
        """See `Comparing`."""
        family, order = self.family(self.goal), sorted(self.found, key=lambda one: one.cost)
        phi = [features(moved(self.goal, family, own)) for own in self.finished()]
        return order[int(np.argmin(phi @ np.array(self.value)))]


class Following(Comparing):
    """Simulates in some searches the consequences of the best motions, as data for learning a
    cost-to-go."""

    answers = 0
    groups: list[list[list[float]]]

    def chosen(self, best: Any) -> Any:
        """See `Comparing`."""
        self.answers += 1
        if self.answers % EVERY == 2:
            family, group = self.family(self.goal), []
            for own in self.finished():
                end, twist = moved(self.goal, family, own), family.samples(own)[1]
                left = [self.followed(end, twist, [self.answers, k]) for k in range(TWICE)]
                group.append([float(np.mean(left)), *features(end).tolist()])
            self.groups.append(group)
        return best

    def followed(self, goal: Goal, twist: np.ndarray, seed: list[int]) -> float:
        """Return the total distance to go after `LATER` more cycles [m]."""
        rng = np.random.default_rng(seed)
        for _ in range(LATER):
            family = self.family(goal)
            search = partial(descend, Problem.of(goal, self._motions[self.key], 1.0))
            best = search(family.nearest(twist), 0.0, STEPS)
            for _ in range(STARTS - 1):
                size = SPREAD * np.sqrt(np.mean(best.parameters**2))
                start = best.parameters + size * rng.normal(size=len(best.parameters))
                best = min(best, search(start, 0.0, STEPS), key=lambda one: one.cost)
            twist, goal = family.samples(best.parameters)[1], moved(goal, family, best.parameters)
        return float(np.sum(np.hypot(*goal.left(goal.position.T.ravel()).T)))


class Proposing(Comparing):
    """Starts one descent from the network's motion, and `NEAR` descents near its result."""

    seen: Any

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        sys.path.append(str(ROOT / "examples/agents"))
        self.agent, gym = (import_module(name) for name in ("learned", "plate_gym.motions"))
        self.network = self.agent.Network.of(self.agent.WEIGHTS)
        self.before: Any = (None, None)
        self.motions, self.half = gym.Motions(load_rig()), load_rig().plate.half

    def _search(self, improved: Any, start: Any, *more: Any) -> Any:
        offer = self.offered() if self.goal.free_end else None

        def own(index: int, near: Any) -> np.ndarray:
            if offer is not None and index == 0:
                return offer
            here = offer is not None and AT_ONCE <= index < AT_ONCE + NEAR
            return start(index, self.found[1] if here else near)

        return super()._search(improved, own, *more)

    def offered(self) -> np.ndarray:
        """Return the network's motion, converted to the solver's parameters."""
        (parts, running), family, motions = self.seen, self.family(self.goal), self.motions
        known, place = self.before[0] == parts.ids and running is not None, parts.position
        drift = (place - self.before[1]) / running.period if known else np.zeros_like(place)
        self.before = parts.ids, place
        order = np.argsort(self.goal.position[:, 0] + self.goal.displacement[:, 0], kind="stable")
        basis = sinusoid_basis(
            len(motions.basis.span) // 2, motions.basis.period, True, family.basis.steps
        )
        last = np.zeros((1, motions.size))
        if running is not None:
            times = (np.arange(basis.steps) + 0.5) / basis.steps * running.period
            own = basis.inverse @ running.twist(times) / motions.scale
            last = np.clip(own, -1, 1).reshape(1, -1)
        seen = self.agent.features(place[order][None], drift[order][None], last, self.half)
        cycle, _ = motions.cycle(self.network(seen)[0])
        times = (np.arange(basis.steps) + 0.5) * basis.dt
        return family.nearest(cycle.twist(times))


def moved(goal: Goal, family: LimitedSinusoids, parameters: np.ndarray) -> Goal:
    """Return the remaining goal after a motion, with the final state of the motion."""
    motion = *family.samples(parameters), goal.friction_accel
    place, velocity = end_state(goal.position, goal.velocity, *motion)
    own = family.coefficients(parameters)
    return replace(
        goal, position=place, velocity=velocity,
        displacement=goal.position + goal.displacement - place,
        plate=np.stack([knots[-1] @ own for knots in family.basis.knots]),
    )  # fmt: skip


def features(goal: Goal) -> np.ndarray:
    """Return the features phi (10,) of the state in which a goal begins.

    The first four are the sum of the distances to go, their sum after a coast, their maximum, and
    their sum of squares. The others are the solver's cost, the parts' speed towards their targets,
    the number of parts in others' paths, the missing distance between close parts, the part of the
    displacements that no rigid motion of the plate achieves, and the plate's squared speed.
    """
    place, coasted = goal.position, goal.position + goal.coast * goal.velocity
    way, later = (goal.left(at.T.ravel()) for at in (place, coasted))
    far = np.hypot(*way.T)
    unit = way / (far[:, None] + 1e-3)
    dx, dy = (place[:, axis] - place[:, axis, None] for axis in (0, 1))
    along, across = dx * unit[:, :1] + dy * unit[:, 1:], dx * unit[:, 1:] - dy * unit[:, :1]
    blocked = np.sum((along > 0) & (along < far[:, None]) & (np.abs(across) < LANE_M))
    near = np.hypot(dx, dy)[np.triu_indices(len(place), 1)]
    one, none, (x, y) = np.ones(len(place)), np.zeros(len(place)), place.T
    rigid = np.block([[one[:, None], none[:, None], -y[:, None]],
                      [none[:, None], one[:, None], x[:, None]]])  # fmt: skip
    fitted = rigid @ np.linalg.lstsq(rigid, way.T.ravel(), rcond=None)[0]
    error, _ = goal.error(coasted.T.ravel())
    plate = np.zeros((3, 3)) if goal.plate is None else goal.plate
    return np.array([
        np.sum(far), np.sum(np.hypot(*later.T)), np.max(far), far @ far, error @ error,
        np.sum(goal.velocity * unit), blocked, np.sum(np.maximum(CLEAR_M - near, 0)),
        np.sum((way.T.ravel() - fitted) ** 2), np.sum((plate[1] * [1, 1, ARM_M]) ** 2),
    ])  # fmt: skip


def learned(groups: Sequence[Sequence[Sequence[float]]]) -> list[float]:
    """Return v (10,), fitted to groups of motions. Each motion has its final distance to go and
    its phi."""
    within = [np.array(group) - np.mean(group, axis=0) for group in groups]
    rows = np.vstack(within)
    left, phi, spread = rows[:, 0], rows[:, 1:], np.std(rows[:, 1:], axis=0) + 1e-12
    phi = phi / spread
    value = np.linalg.solve(phi.T @ phi + RIDGE * np.eye(len(spread)), phi.T @ left)
    return (value / spread).tolist()
