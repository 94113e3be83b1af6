"""Agent that searches each cycle's motion with CMA-ES.

The agent searches for the 18 numbers of the action `motion`, and evaluates candidates in a
simulator of the nominal rig. The agent needs `pip install cma`. Run it in this folder:

    python -m plate_gym.bench --agent cma_es:CmaEs --task Sort4-v1 --seeds 0:20
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cma
import numpy as np

from plate_core import PlateCycle
from plate_gym.agent import Brief
from plate_gym.evaluation import Memory, TaskEvaluator
from plate_sim.world import Simulation, WorldState

TRIED, ROUNDS, SPREAD = 12, 8, 0.4
"""Motions per round, rounds per decision, and initial standard deviation of the search around the
last action."""

COAST_S = 0.03
"""Time by which the parts' final positions are extrapolated with their final velocities before the
evaluation [s]."""

EDGE_M, EDGE_COST = 0.02, 3.0
"""Width of the zone at the plate's edges [m]. Cost of a part in this zone, per metre beyond the
zone's inner border [metres of distance to go]."""

IDLE_S = 0.1
"""Length of the cycle at rest before the first action [s]."""


class CmaEs:
    """Agent that tries about a hundred motions per decision. The agent returns the motion after
    which the parts have the lowest cost: remaining distance plus cost near edges."""

    action, observation = "motion", "parts"

    def __init__(self, brief: Brief, seed: int) -> None:
        self._motions, self._rng = brief.motions, np.random.default_rng(seed)
        self._inner = brief.rig.plate.half - EDGE_M
        self._evaluator = TaskEvaluator(brief.scenario.task, brief.rig)
        self._worlds = [Simulation(brief.rig, brief.scenario) for _ in range(TRIED)]
        self._now = self._worlds[0].state
        self._memory: Memory = None
        self._running, self._last = PlateCycle.rest(IDLE_S), np.zeros(brief.motions.size)

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """Return the best of the tried motions."""
        seen = observation[:, 5] == 0
        at, turned = self._now.position.copy(), self._now.angle.copy()
        at[seen], turned[seen] = observation[seen, :2], observation[seen, 4]
        self._now = replace(self._now, position=at, angle=turned)
        self._worlds[0].state = self._now
        self._memory = self._memory or self._evaluator.begin(self._worlds[0], self._running)
        self._goal = observation[:, 8:10]
        self._now = self._after([self._running])[0]
        chance = {"randn": lambda *shape: self._rng.standard_normal(shape), "seed": np.nan}
        search = cma.CMAEvolutionStrategy(
            self._last, SPREAD, {"popsize": TRIED, "verbose": -9, **chance}
        )
        for _ in range(ROUNDS):
            tried = search.ask()
            cycles = [self._motions.cycle(np.clip(own, -1, 1))[0] for own in tried]
            search.tell(tried, self._cost(self._after(cycles)))
        self._last = np.clip(search.best.x, -1, 1)
        self._running = self._motions.cycle(self._last)[0]
        return self._last

    def _after(self, cycles: list[PlateCycle]) -> list[WorldState]:
        """Return the state of the parts after each cycle, simulated from the current state."""
        worlds = self._worlds[: len(cycles)]
        for world in worlds:
            world.state = self._now
        Simulation.run_together(worlds, cycles, 1)
        return [world.state for world in worlds]

    def _cost(self, states: list[WorldState]) -> list[float]:
        """Return the cost of each state [m]: the distance to go, plus the cost of parts near an
        edge."""
        states = [replace(s, position=s.position + COAST_S * s.velocity) for s in states]
        place = np.array([s.position for s in states])
        beyond = np.maximum(np.abs(place) - self._inner, 0).sum(axis=(1, 2))
        if self._evaluator.follows:
            left = np.linalg.norm(place - self._goal, axis=2).sum(axis=1)
        else:
            left = self._evaluator.score([self._memory] * len(states), states).to_go
        return list(left + EDGE_COST * beyond)
