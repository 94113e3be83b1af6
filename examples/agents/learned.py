"""Learned agent. The agent evaluates the small network that train.py has trained. It needs only
numpy.

Run it in this folder:

    python -m plate_gym.bench --agent learned:Learned --task Sort4-v1 --seeds 0:20

The stored network fits only the task `Sort4-v1`. Other tasks require new training.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from plate_gym.agent import Brief

WEIGHTS = Path(__file__).with_name("weights.npz")

FAST_MPS = 0.1
"""Unit of the drift velocities in the features [m/s]."""


def features(place: Any, drift: Any, last: Any, half: Any, of: Any = np) -> Any:
    """Return the network's input (N, 4 M + 18) for N plates with M parts.

    Parameters
    ----------
    place, drift : (N, M, 2)
        Positions [m] and drift velocities [m/s] of the parts, as in the observation `parts`.
    last : (N, 18)
        Last action. The plate plays this motion while the next action is computed.
    half : (2,)
        Half side lengths of the plate [m].
    of : module
        numpy, or torch if the arguments are tensors.
    """
    count = len(place)
    relative, drifts = place / half, of.clip(drift / FAST_MPS, -3, 3)
    return of.concatenate([relative.reshape(count, -1), drifts.reshape(count, -1), last], 1)


class Network:
    """Linear layers with ReLU between them. An action that exceeds its bounds is scaled down to the
    bounds."""

    def __init__(self, layers: list[tuple[np.ndarray, np.ndarray]]) -> None:
        self._layers = layers

    @classmethod
    def of(cls, path: Path) -> Network:
        """Read a network from a file."""
        with np.load(path) as kept:
            count = len(kept.files) // 2
            return cls([(kept[f"weight_{k}"], kept[f"bias_{k}"]) for k in range(count)])

    def __call__(self, seen: np.ndarray) -> np.ndarray:
        """Return the actions for features (N, 4 M + 18)."""
        *hidden, (weight, bias) = self._layers
        for w, b in hidden:
            seen = np.maximum(seen @ w.T + b, 0)
        found = seen @ weight.T + bias
        return found / np.maximum(np.max(np.abs(found), axis=1, keepdims=True), 1)


class Learned:
    """Agent that computes each motion with the network."""

    action, observation = "motion", "parts"

    def __init__(self, brief: Brief, seed: int) -> None:
        self._half, self._network = brief.rig.plate.half, Network.of(WEIGHTS)
        self._last = np.zeros((1, brief.motions.size))

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """Return the network's action."""
        place, drift = observation[None, :, :2], observation[None, :, 2:4]
        self._last = self._network(features(place, drift, self._last, self._half))
        return self._last[0]
