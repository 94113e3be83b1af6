"""Method A of the paper (sections 3.1 and 4.1). A PD controller requests a force for each part. 24
rotations of the plate together exert these forces. An SVD of the averaged map gives their weights,
with minimum norm."""

from __future__ import annotations

from typing import Any

import numpy as np

from plate_core import Parts, PlateCycle, PlateError, part_class
from plate_core.tasks import AssembleTask, FollowTask, Side, SortTask
from plate_planner.tasks import assign
from plate_solver import Limits
from plate_solver.averages import solve_weights
from plate_solver.library import Library, grid
from plate_solver.rotations import RotationFamily

from .agent import Brief
from .evaluation import AHEAD_S

GOAL = 0.8
"""Distance of the goals of sorted parts from the plate's centre, divided by the plate's half
side."""

GAIN = 1.5
"""Requested drift divided by the distance to the goal [1/s]."""

FASTEST_MPS = 0.03
"""Maximum requested drift [m/s]."""

MAX_GAIN = 3.0
"""Bound of the reciprocals of the singular values of the matrix of mean forces. If a reciprocal
exceeds this bound, the singular direction is omitted (section 3.1.5). Without this bound, two parts
close to each other would cause very large weights."""

PERIOD_S = 0.2
"""Period of a cycle [s]."""

SPEED_MPS = 0.3
"""Speed of the plate's fastest corner during a return stroke [m/s]."""

RETURN = 2.5
"""Speed of a return stroke divided by the speed of the stroke before it. Each rotation consists of
a stroke and a return stroke in the opposite direction. The mean force results from the difference
of their speeds."""


class Classic:
    """Agent for tasks without angles: sort to sides, assemble, and follow paths."""

    action, observation = "cycle", "parts"

    def __init__(self, brief: Brief, seed: int) -> None:
        self._task, self._ids, rig = brief.scenario.task, brief.ids, brief.rig
        if isinstance(self._task, SortTask):
            sides = [self._task.regions[part_class(name)] for name in self._ids]
            self._side = np.array([[side.x, side.y] for side in sides if isinstance(side, Side)])
        elif not isinstance(self._task, AssembleTask | FollowTask):
            raise PlateError(f"task is {brief.scenario.name}, allowed: sort, assemble, follow")
        self._half, self._limits = rig.plate.half, Limits.of(rig, 1.0)
        self._library = Library.about(grid(self._half), self._half)
        self._push = rig.friction.accel * PERIOD_S
        self._goal: np.ndarray | None = None

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> PlateCycle:
        """Return a cycle of rotations that exert the mean forces that the PD controller requests.
        Each rotation is followed by its return stroke."""
        position = observation[:, :2]
        force = (self._drift(observation) - observation[:, 2:4]) / self._push
        matrix = self._library.forces(position)
        weight, _ = solve_weights(matrix, force.T.ravel(), MAX_GAIN)
        fraction = np.abs(weight) * (RETURN + 1) / (RETURN - 1)
        nearest = self._library.clearance(position)
        # The rotations are ordered as in section 3.1.4 of the original publication.
        order = np.argsort(-fraction / nearest, kind="stable")
        out = np.sign(weight)[order, None] * self._library.twist[order] / RETURN
        fraction = fraction[order] / max(1.0, float(np.sum(fraction)))
        spent = np.outer(fraction, [RETURN, 1.0]).ravel() / (RETURN + 1)
        twist = np.stack([out, -RETURN * out], axis=1).reshape(-1, 3)
        # The averaged map assumes that the plate always moves, and that even the smallest motion
        # causes full friction. Therefore the remaining time of the period is filled with a stroke
        # and its return stroke of equal speeds, whose mean force is 0.
        spent = np.append(spent, np.full(2, (1 - np.sum(fraction)) / 2))
        twist = np.vstack([twist, out[:1], -out[:1]])
        family = RotationFamily(twist, self._limits, PERIOD_S, SPEED_MPS)
        return family.cycle(family.parameters(spent))

    def _drift(self, seen: np.ndarray) -> np.ndarray:
        """Return the requested drift of each part (M, 2) [m/s]."""
        position, feed = seen[:, :2], np.zeros(2)
        if isinstance(self._task, FollowTask):
            goal, feed = seen[:, 6:8], (seen[:, 8:10] - seen[:, 6:8]) / AHEAD_S
        elif isinstance(self._task, AssembleTask):
            if self._goal is None:
                places = np.array(self._task.place)
                row = assign(self._task.labels, places, Parts.make(self._ids, position))
                self._goal = places[row]
            goal = self._goal
        else:
            goal = np.where(self._side == 0, position, self._side * GOAL * self._half)
        return feed + np.clip(GAIN * (goal - position), -FASTEST_MPS, FASTEST_MPS)
