"""A plant that follows each request one cycle later, and common functions of the planner's
tests."""

from collections import Counter

import numpy as np

from plate_core import CycleRequest, Parts, load_rig
from plate_core.tasks import start_positions

RIG = load_rig()
MASS = RIG.parts.mass_kg
T = 0.1


class Plant:
    """Parts whose drift changes by F T/m, one cycle after the image: no friction model at all."""

    def __init__(self, scenario, seed=0, disturbance=0.0, shuffle=False):
        self.scenario = scenario
        self.rng = np.random.default_rng(seed)
        labels, self.position = start_positions(scenario, RIG, self.rng)
        if shuffle:
            order = self.rng.permutation(len(labels))
            labels, self.position = tuple(labels[i] for i in order), self.position[order]
        number = Counter()
        ids = []
        for label in labels:
            number[label] += 1
            ids.append(f"{label}_{number[label]}")
        self.ids = tuple(ids)
        self.drift = np.zeros_like(self.position)
        self.coming = np.zeros_like(self.position)
        self.disturbance = disturbance

    def seen(self) -> Parts:
        return Parts.make(self.ids, self.position, self.drift)

    def step(self, cycle_request: CycleRequest) -> None:
        noise = self.disturbance * self.rng.normal(size=self.drift.shape)
        answer = self.answer(cycle_request) + noise
        self.drift, self.coming = self.coming, answer
        self.position = self.position + T * self.drift

    def answer(self, cycle_request: CycleRequest) -> np.ndarray:
        """Return the drift request, as far as parts are named; parts that are not come to rest."""
        drift = np.zeros_like(self.position)
        for i, part_id in enumerate(cycle_request.parts.ids):
            row = self.ids.index(part_id)
            drift[row] = self.drift[row] + cycle_request.forces.force[i] * T / MASS
        return drift


def ready(planner, parts: Parts, t=0.0):
    """Return the state of a planner that has seen the parts one cycle before t, and was started."""
    state, _, _ = planner.plan(planner.initial(), parts, t - T)
    return planner.start(state)


def run(planner, plant, cycles=2000, t=0.0, state=None):
    state = ready(planner, plant.seen(), t) if state is None else state
    for k in range(cycles):
        state, request, progress = planner.plan(state, plant.seen(), t + k * T)
        if progress.phase != "running":
            break
        plant.step(request)
    return state, request, progress


def without(parts: Parts, *gone: str) -> Parts:
    keep = [i for i, part_id in enumerate(parts.ids) if part_id not in gone]
    return parts.take(keep)
