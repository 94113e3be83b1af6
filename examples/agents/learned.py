"""Learned agent. The agent evaluates the small network that train.py has trained. It needs only
numpy.

Run it in this folder:

    python -m plate_gym.bench --agent learned:Learned --task Sort10-v1 --seeds 0:20

The network accepts any number of parts, because it sums over the parts. The stored network was
trained for `Sort4-v1` and `Sort10-v1`. Other tasks require new training.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from plate_gym.agent import Brief

WEIGHTS = Path(__file__).with_name("weights.npz")

FAST_MPS, FAR_M, EDGE_M = 0.1, 0.1, 0.03
"""Units of drift velocities [m/s] and distances to go [m] in the features, and width of the zone at
the edges [m]."""

TINY = 1e-6
"""Added to squares before a root or a logarithm."""


class Network:
    """Network for any number of parts.

    Two layers (`part_0`, `part_1`) and a linear one (`weigh`) compute 32 weights for each part. The
    network sums weight times 1, x, y, x^2, x y and y^2 over the parts. The sums are scaled to a
    root mean square of 1. Two layers (`plate_0`, `plate_1`) and a linear one (`action`) compute the
    action from the sums, their scale, and the last action. The mean force on a part is a smooth
    function of its position. Therefore the sums approximately describe how a motion acts on all
    parts.

    An action that exceeds its bounds is scaled down to the bounds.

    Parameters
    ----------
    arrays : mapping
        Weight and bias of each layer, as `part_0_weight`, `part_0_bias` and so on.
    of : module
        numpy, or torch if the arrays are tensors.
    """

    def __init__(self, arrays: Any, of: Any = np) -> None:
        self._arrays, self._of = arrays, of

    @classmethod
    def read(cls, path: Path) -> Network:
        """Read a network from a file."""
        with np.load(path) as kept:
            return cls({name: kept[name].astype(np.float32) for name in kept.files})

    def __call__(self, place: Any, drift: Any, last: Any, side: Any, goal: Any, half: Any) -> Any:
        """Return the actions (N, 18) for N plates with M parts.

        Parameters
        ----------
        place, drift : (N, M, 2)
            Positions [m] and drift velocities [m/s] of the parts, as in the observation `parts`.
        last : (N, 18)
            Last action. The plate plays this motion while the next action is computed.
        side : (M, 2)
            Direction (-1, 0 or 1 along x and y) of each part's target region.
        goal : (M, 2)
            Distance of each part's goal lines from the centre [m].
        half : (2,)
            Half side lengths of the plate [m].
        """
        of, relative = self._of, place / half
        to_go = (goal - place * side).clip(min=0) * side / FAR_M
        edge = ((abs(place) - half) / EDGE_M + 1).clip(min=0) * of.sign(place)
        sides = of.zeros_like(place) + side
        seen = of.concatenate([relative, sides, to_go, of.clip(drift / FAST_MPS, -3, 3), edge], -1)
        weights = self._layer("weigh", self._relu("part_1", self._relu("part_0", seen)))
        x, y = relative[..., 0], relative[..., 1]
        powers = of.stack([x * 0 + 1, x, y, x * x, x * y, y * y], -1)
        sums = of.einsum("nmc,nmk->nck", weights, powers).reshape(len(place), -1)
        sums = sums / place.shape[1] ** 0.5
        square = (sums**2).mean(axis=1, keepdims=True) + TINY
        sums = of.concatenate([sums / of.sqrt(square), last, of.log(square)], 1)
        found = self._layer("action", self._relu("plate_1", self._relu("plate_0", sums)))
        return found / of.amax(abs(found), 1)[:, None].clip(min=1)

    def _layer(self, name: str, values: Any) -> Any:
        return values @ self._arrays[f"{name}_weight"].T + self._arrays[f"{name}_bias"]

    def _relu(self, name: str, values: Any) -> Any:
        return self._layer(name, values).clip(min=0)


class Learned:
    """Agent that computes each motion with the network."""

    action, observation = "motion", "parts"

    def __init__(self, brief: Brief, seed: int) -> None:
        half, task = brief.rig.plate.half.astype(np.float32), brief.scenario.task
        regions = [task.regions[label] for label in brief.scenario.labels]
        side = np.array([[region.x, region.y] for region in regions], np.float32)
        self._aim = side, np.float32(task.goal_fraction) * abs(side) * half, half
        self._network = Network.read(WEIGHTS)
        self._last = np.zeros((1, brief.motions.size), np.float32)

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """Return the network's action."""
        seen = observation[None].astype(np.float32)
        self._last = self._network(seen[:, :, :2], seen[:, :, 2:4], self._last, *self._aim)
        return self._last[0].astype(float)
