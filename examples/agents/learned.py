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


def features(seen: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return what the network sees (4 M,) of parts (M, 6) as `parts` has them: places as shares
    of the plate's half sides (2,) [m], and drifts."""
    there = np.hstack([seen[:, :2] / half, np.clip(seen[:, 2:4] / FAST_MPS, -3, 3)])
    return there.astype(np.float32).ravel()


class Learned:
    """Says where each part is to come: `progress`."""

    action, observation = "progress", "parts"

    def __init__(self, brief: Brief, seed: int) -> None:
        self._half, space = brief.rig.plate.half, brief.action_space
        self._low, self._high = space.low, space.high
        with np.load(WEIGHTS) as kept:
            self._layers = [
                (kept[f"weight_{k}"], kept[f"bias_{k}"]) for k in range(len(kept.files) // 2)
            ]

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """Return the network's action: its mean, without chance."""
        values = features(observation, self._half)
        *hidden, (weight, bias) = self._layers
        for w, b in hidden:
            values = np.maximum(w @ values + b, 0)
        share = (np.tanh(weight @ values + bias) + 1) / 2
        return self._low + share.reshape(self._low.shape) * (self._high - self._low)
