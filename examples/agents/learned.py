"""A learned agent: the small network that train.py made, in plain numpy.

    python -m plate_gym.bench --agent learned:Learned --task Sort4-v1 --seeds 0:20

in this folder. It knows one task, `Sort4-v1`: a network of another size asks for training anew.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from plate_gym.agents import Brief

WEIGHTS = Path(__file__).with_name("weights.npz")

FAST_MPS = 0.1
"""A drift that counts as 1 [m/s]."""


def features(place: Any, drift: Any, last: Any, half: Any, of: Any = np) -> Any:
    """Return what the network sees (N, 4 M + 18), of N plates with M parts.

    Parameters
    ----------
    place, drift : (N, M, 2)
        Of the parts, as `parts` has them [m], [m/s].
    last : (N, 18)
        The last action: it is played while this one is sought.
    half : (2,)
        Half sides of the plate [m].
    of : module
        numpy, or torch if these are its tensors.
    """
    count = len(place)
    shares, drifts = place / half, of.clip(drift / FAST_MPS, -3, 3)
    return of.concatenate([shares.reshape(count, -1), drifts.reshape(count, -1), last], 1)


class Network:
    """Layers with ReLU between: answers with actions (N, 18), each within its bounds."""

    def __init__(self, layers: list[tuple[np.ndarray, np.ndarray]]) -> None:
        self._layers = layers

    @classmethod
    def of(cls, path: Path) -> Network:
        """Read it from a file."""
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
    """Answers with a motion at once."""

    action, observation = "motion", "parts"

    def __init__(self, brief: Brief, seed: int) -> None:
        self._half, self._network = brief.rig.plate.half, Network.of(WEIGHTS)
        self._last = np.zeros((1, brief.motions.size))

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """Return the network's action."""
        place, drift = observation[None, :, :2], observation[None, :, 2:4]
        self._last = self._network(features(place, drift, self._last, self._half))
        return self._last[0]
