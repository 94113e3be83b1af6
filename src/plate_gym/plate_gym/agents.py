"""Reference agents. Four agents use the planner of this project. They use Method B on the cycle
map, Method A on the cycle map, Method B with images, and Method B on the averaged map. The other
two agents use the paper's Method A and random motions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from plate_core import CycleRequest, Parts, PlateCycle, part_class
from plate_core.motion import IDLE_S
from plate_planner import Planner
from plate_planner.tasks import FollowMemory
from plate_solver import Controller, SinusoidSolver
from plate_vision import Prediction, Tracker, make_vision, observe
from plate_vision.shapes import learn_plate

from .agent import Agent, Brief
from .classic import Classic

__all__ = ["AGENTS", "Ours"]


class Random:
    """Uniformly random motions."""

    action, observation = "motion", "parts"

    def __init__(self, brief: Brief, seed: int) -> None:
        self._size, self._rng = brief.motions.size, np.random.default_rng(seed)

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """Return a motion."""
        return self._rng.uniform(-1, 1, self._size)


class Ours:
    """Agent with this project's planner and solver. The solver uses Method B: it chooses sinusoids
    by the cycle map, which predicts the positions of the parts after one cycle."""

    action, observation, method = "cycle", "parts", "sinusoids"

    def __init__(self, brief: Brief, seed: int) -> None:
        self._rig, self._ids = brief.rig, brief.ids
        self._planner = Planner(self._rig, brief.scenario)
        self._state = self._planner.start(self._planner.initial())
        self._controller = Controller(self._rig, self.method, seed)

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> PlateCycle:
        """Return the cycle that the solver computes for the planner's request."""
        time, running = float(info["time_s"]), info["running"]
        self._ids = tuple(info.get("ids", self._ids))
        self._state = self._planner.started(self._state, running, time, True)
        parts = self._parts(observation, time)
        if not len(parts):  # no part has been detected yet
            return running if running.closes else PlateCycle.rest(IDLE_S)
        self._state = self._planner.see(self._state, parts, time)
        # In a feed task, the planner must execute the feeder's order.
        if "order" in info and self._state.memory is not None:
            self._planner = self._planner.order(self._state, info["order"])
        follow = self._state.memory
        # In a follow task, the reference paths of the evaluation replace the reference paths of the
        # planner.
        if isinstance(follow, FollowMemory):
            before, after = map(float, info["pace"])
            start, path_s = time + running.period, float(info["path_s"])
            follow = replace(
                follow, anchor=start, progress=path_s, scaling=(before, after), fixed=True
            )
            self._state = replace(self._state, memory=follow)
        self._state, request, _ = self._planner.next_request(self._state)
        cycle = self._solve(request, running)
        self._state = self._planner.record_cycle(self._state, cycle, time)
        return cycle

    def _parts(self, seen: np.ndarray, time: float) -> Parts:
        """Return the parts of the last image, from the rows of an observation."""
        rows = np.flatnonzero(seen[:, 5] == 0)
        names = tuple(self._ids[row] for row in rows)
        return Parts.make(names, seen[rows, :2], seen[rows, 2:4], seen[rows, 4])

    def _solve(self, request: CycleRequest, running: PlateCycle) -> PlateCycle:
        return self._controller.solve(request, running).cycle


class MethodA(Ours):
    """Agent with this project's planner and Method A, which moves the plate by rotations about a
    few centres."""

    method = "rotations"


class ByImage(Ours):
    """The same as agent `Ours`, but this project's detector measures the positions of the parts in
    images."""

    observation = "image"

    def __init__(self, brief: Brief, seed: int) -> None:
        super().__init__(brief, seed)
        self._vision, self._tracker = make_vision(self._rig), Tracker()
        self._expected: Prediction | None = None

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> PlateCycle:
        """Return the cycle that the solver computes for the planner's request. If the detector
        needs images of the plate without parts, `info` contains these images together with the
        first image."""
        if "bare_images" in info:
            self._vision = replace(self._vision, background=learn_plate(info["bare_images"]))
        return super().act(observation, info)

    def _parts(self, seen: np.ndarray, time: float) -> Parts:
        self._tracker = observe(self._vision, self._tracker, seen, time, self._expected)
        return self._tracker.parts

    def _solve(self, request: CycleRequest, running: PlateCycle) -> PlateCycle:
        self._expected = None
        if request.start is not None:
            next_start = self._state.estimator.next_start
            self._expected = Prediction(request.parts.ids, next_start, request.start[:, :2])
        return super()._solve(request, running)


class Averaged(Ours):
    """Agent with Method B on the averaged map, as in the paper. The averaged map predicts mean
    forces on the assumption that the parts are at rest."""

    def __init__(self, brief: Brief, seed: int) -> None:
        super().__init__(brief, seed)
        self._solver = SinusoidSolver(self._rig, seed=seed, at_rest=True)

    def _solve(self, request: CycleRequest, running: PlateCycle) -> PlateCycle:
        parts = request.parts
        if not len(parts):
            return PlateCycle.rest(IDLE_S)
        types = [self._rig.part_type(part_class(name)) for name in parts.ids]
        mu_mass = np.array([[part_type.mu, part_type.mass_kg] for part_type in types], float)
        limit = np.prod(mu_mass, axis=1, keepdims=True) * self._rig.friction.gravity
        position = parts.position if request.start is None else request.start[:, :2]
        force, tolerance = request.forces.force / limit, request.forces.tolerance / limit
        return self._solver.solve(position, force, tolerance=tolerance).cycle


AGENTS: dict[str, type[Agent]] = {
    "B": Ours, "A": MethodA, "B_by_image": ByImage, "averaged": Averaged, "1998": Classic,
    "random": Random,
}  # fmt: skip
"""Agents of this package, by name."""
