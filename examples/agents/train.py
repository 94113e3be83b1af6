"""Train a small network on Sort4-v1 by SAC, and write its weights and its learning curve.

In this folder, in an environment of its own (pip install ../../src/plate_gym -r requirements.txt):

    python train.py --minutes 40

Writes weights.npz, of the last step, and curve.csv, a row for each episode of training.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
from learned import WEIGHTS, features
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback

import plate_gym

TASK, SEED = "Sort4-v1", 1
LAYERS = [64, 64]

REWARD = 10.0
"""Rewards are so many times those of the task: these are 2 in all."""

STEPS = 100
"""Of an episode of training, at most: the judge's are up to 800."""

CURVE = Path(__file__).with_name("curve.csv")


class Told(gymnasium.Wrapper):
    """The environment as the network sees it; keeps a row for each episode that has ended."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        plates = env.unwrapped.plates
        self._half, size = plates.rig.plate.half, 4 * plates.scenario.count
        self.observation_space = gymnasium.spaces.Box(-3, 3, (size,), np.float32)
        self.rows: list[list[float]] = []
        self._steps, self._total = 0, 0.0

    def reset(self, **settings):
        """Begin anew."""
        seen, info = self.env.reset(**settings)
        return features(seen, self._half), info

    def step(self, action):
        """Let a cycle pass."""
        seen, reward, ended, over, info = self.env.step(action.astype(float))
        self._steps, self._total = self._steps + 1, self._total + reward
        if ended or over:
            self.rows.append(
                [
                    self._steps,
                    round(self._total, 4),
                    int(info["success"]),
                    int(info["dropped"]),
                    round(float(info["time_s"]), 3),
                ]
            )
            self._total = 0.0
        return features(seen, self._half), REWARD * reward, ended, over, info


class Clock(BaseCallback):
    """Ends training at a time, and keeps what there is from time to time."""

    def __init__(self, minutes: float, told: Told) -> None:
        super().__init__()
        self._end, self._told, self._kept = time.monotonic() + 60 * minutes, told, 0

    def _on_step(self) -> bool:
        if len(self._told.rows) >= self._kept + 20:
            self._kept = len(self._told.rows)
            keep(self.model, self._told)
        return time.monotonic() < self._end


def keep(model: SAC, told: Told) -> None:
    """Write the policy's mean as numpy has it, and the curve."""
    policy = model.policy.actor
    layers = [*policy.latent_pi, policy.mu]
    linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
    arrays = {}
    for k, layer in enumerate(linear):
        arrays[f"weight_{k}"] = layer.weight.detach().numpy().astype(np.float32)
        arrays[f"bias_{k}"] = layer.bias.detach().numpy().astype(np.float32)
    np.savez_compressed(WEIGHTS, **arrays)
    with CURVE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["steps", "return", "success", "dropped", "time_s"])
        writer.writerows(told.rows)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=40.0, help="of training (40)")
    minutes = parser.parse_args().minutes
    torch.set_num_threads(1)
    plate = plate_gym.PlateEnv(TASK, action="progress")
    told = Told(gymnasium.wrappers.TimeLimit(plate, STEPS))
    model = SAC(
        "MlpPolicy", told, learning_rate=1e-3, buffer_size=200_000, learning_starts=500,
        batch_size=256, gamma=0.9, tau=0.01, ent_coef="auto_0.02",
        policy_kwargs={"net_arch": LAYERS}, seed=SEED,
    )  # fmt: skip
    model.learn(10**9, callback=Clock(minutes, told))
    keep(model, told)


if __name__ == "__main__":
    main()
