"""This program measures whether proposed start motions speed up the project's solver in the loop.

Proposals come from a network that imitates the solver, or from the nearest goals that it has solved
before: `python warm_starts.py --task Sort4-v1` (half an hour; needs scikit-learn). Method B solves
300 episodes, which give 36,000 goals with their mirror images. In 100 other episodes its search
also starts from proposals: those of a network (two layers of 512), or the motions of the three most
similar goals. Medians of plate time [s] and time per decision [ms]; all episodes were done:

    further starts    without      network      nearest goals
    40 (default)      3.73, 29     3.73, 31     3.60, 29
    12                4.28, 14     4.07, 14     3.67, 15
    4                 5.03,  9     4.62, 10     3.90, 11

On `Sort10-v1` (120 episodes for learning, 30 for the evaluation) plate times were 7.0, 6.35 and 6.6
s with 40 further starts, 8.4, 7.15 and 7.2 s with 12, and 10.85, 9.0 and 8.2 s with 4. So the
solved goals of a task halve the computing time of this task. With four parts, the network helps
less, because it must predict one motion although many motions are equally good. The solver uses
neither.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.spatial import cKDTree

from plate_core.intervals import of_median
from plate_gym.agents import AGENTS, Ours
from plate_gym.bench import episode, seed_range
from plate_solver import Controller
from plate_solver.goal import Goal
from plate_solver.sinusoids import BEYOND, PLAYS, ROUGH, SinusoidSteering, limited_sinusoids

Solved = list[tuple[Goal, np.ndarray]]
"""Goals with the parameters of their solutions."""

Propose = Callable[[Goal], list[np.ndarray]]
"""Function from a goal to the parameters of proposed start motions."""

TAUGHT = 100_000
"""First seed for learning. The seeds for evaluation are far from this one."""

NEIGHBOURS = 3
"""Number of nearest solved goals whose motions are proposed."""

STATE_UNITS = np.array([[0.01], [1.0], [20.0]])
"""Units of the plate's pose [m, rad], velocity and acceleration in the features."""

PLACE_M, WAY_M = 0.3, 0.1
"""Units of positions and velocities, and of distances to go, in the features [m]."""


class Steering(SinusoidSteering):
    """`SinusoidSteering` that also starts from the proposed motions, and records its solutions."""

    def __init__(self, propose: Propose, solved: Solved, *args: Any) -> None:
        super().__init__(*args)
        self._propose, self._solved = propose, solved

    def steer(self, goal: Goal, number: int, period: float, *args: Any) -> Any:
        """Find a motion. Motions are proposed and recorded only if they are allowed to end in
        motion."""
        self._proposed = self._propose(goal) if goal.free_end else []
        answer = super().steer(goal, number, period, *args)
        if goal.free_end:
            key = number, period, ROUGH, True
            family = limited_sinusoids(*key[:2], self._limits, BEYOND, *key[2:], goal.plate, PLAYS)
            self._solved.append((goal, family.nearest(self._warm[key])))
        return answer

    def _search(self, improved: Any, start: Any, *args: Any) -> Any:
        def begun(index: int, near: Any) -> Any:
            return self._proposed.pop(0) if self._proposed else start(index, near)

        return super()._search(improved, begun, *args)


def played(
    task: str, seeds: range, restarts: int, propose: Propose
) -> tuple[list[dict[str, Any]], Solved]:
    """Run Method B with `restarts` random starts. Return the episodes and the solved goals."""
    solved: Solved = []

    class Tried(Ours):
        def __init__(self, brief: Any, seed: int) -> None:
            super().__init__(brief, seed)
            self._controller = Controller(self._rig, self.method, seed, restarts=restarts)

    made = partial(Steering, propose, solved)
    with (
        patch("plate_solver.sinusoids.solver.SinusoidSteering", made),
        patch.dict(AGENTS, tried=Tried),
    ):
        return [episode("tried", "nominal", task, seed) for seed in seeds], solved


def features(goal: Goal) -> np.ndarray:
    """Return the features of a goal: positions, velocities, distances to go and weights of its
    parts, from left to right, and the state of the plate."""
    count, ends = len(goal.position), goal.ends
    low, high = (
        side[: 2 * count].reshape(2, -1).T - goal.position for side in (ends.low, ends.high)
    )
    weight = np.broadcast_to(goal.weight, (count, 2))
    way = np.where(weight > 0, np.maximum(low, 0) + np.minimum(high, 0), 0)
    rows = np.hstack([goal.position / PLACE_M, goal.velocity / PLACE_M, way / WAY_M, weight])
    plate = np.zeros((3, 3)) if goal.plate is None else goal.plate / STATE_UNITS
    return np.append(rows[np.argsort(goal.position[:, 0])], plate)


def mirrored(goal: Goal, motion: np.ndarray, signs: np.ndarray) -> tuple[Goal, np.ndarray]:
    """Return a goal and its motion mirrored. `signs` is -1 for each axis that changes its sign."""
    turned = np.append(signs, np.prod(signs))
    plate = None if goal.plate is None else goal.plate * turned
    ways = {name: getattr(goal, name) * signs for name in ("position", "velocity", "displacement")}
    return replace(goal, plate=plate, **ways), (motion.reshape(-1, 3) * turned).ravel()


def taught(solved: Solved) -> dict[str, Propose]:
    """Return functions that propose starts, by name. They have learned from the solved goals and
    their mirror images."""
    # Imported here, because only this function needs it.
    from sklearn.neural_network import MLPRegressor

    mirrors = [np.array(signs) for signs in itertools.product((1, -1), repeat=2)]
    pairs = [mirrored(*each, signs) for each in solved for signs in mirrors]
    known = np.array([features(goal) for goal, _ in pairs])
    motions = np.array([motion for _, motion in pairs])
    network = MLPRegressor(
        hidden_layer_sizes=(512, 512), early_stopping=True, max_iter=60, random_state=0
    )
    network.fit(known, motions)
    tree = cKDTree(known)
    return {
        "network": lambda goal: list(network.predict(features(goal)[None])),
        "memory": lambda goal: list(motions[tree.query(features(goal), NEIGHBOURS)[1]]),
    }


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--task", default="Sort4-v1")
    parser.add_argument("--teach", type=int, default=300, help="episodes to learn from")
    parser.add_argument("--seeds", type=seed_range, default=range(100), help="to judge by")
    args = parser.parse_args()
    _, solved = played(args.task, range(TAUGHT, TAUGHT + args.teach), 40, lambda goal: [])
    print(f"learned from {len(solved)} decisions", flush=True)
    proposals = {"as it is": lambda goal: []} | taught(solved)
    print("further starts  proposed by  done  plate time [s]       decision [ms]")
    for restarts, name in itertools.product((40, 12, 4), proposals):
        rows, _ = played(args.task, args.seeds, restarts, proposals[name])
        done = [row["time_s"] for row in rows if row["success"]]
        low, high = of_median(done)
        spent = np.median([row["decision_ms"] for row in rows])
        took = f"{np.median(done):.2f} ({low:.2f} to {high:.2f})"
        print(f"{restarts:14d}  {name:11s}  {len(done):4d}  {took:19s}  {spent:.1f}", flush=True)


if __name__ == "__main__":
    main()
