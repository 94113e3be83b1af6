"""Measures how many cycles per second the environments simulate, with one plate and with many
plates: `python -m plate_gym.speed`."""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time

import numpy as np

from plate_core import piped

from .env import PlateVectorEnv
from .plates import OBSERVATIONS

TASKS = ("Sort4-v1", "Sort10-v1", "Sort24-v1", "Sort50-v1")
MANY = 64
"""Number of parallel plates."""

CYCLES = 1920
"""Total number of cycles that are simulated in one measurement without images."""

IMAGES = 320
"""Total number of cycles that are simulated in one measurement with images."""


def measure(task: str, count: int, threads: int, observation: str) -> tuple[float, float]:
    """Run random motions. Return the number of cycles per second, and the processor time per cycle
    [us]."""
    env = PlateVectorEnv(task, count, observation=observation, threads=threads)
    env.reset(seed=0)
    cycles = IMAGES if observation == "image" else CYCLES
    draw = np.random.default_rng(0).uniform
    actions = [draw(-1, 1, env.action_space.shape) for _ in range(cycles // count)]
    env.step(actions[0])
    began, busy = time.perf_counter(), time.process_time()
    for action in actions:
        env.step(action)
    passed, spent = time.perf_counter() - began, time.process_time() - busy
    done = count * len(actions)
    return done / passed, 1e6 * spent / done


def memory_mb() -> float:
    """Return the peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m plate_gym.speed", description=__doc__)
    parser.add_argument("--observation", choices=OBSERVATIONS, default="parts")
    args = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    print("task        plates  cores  cycles/s  processor us/cycle  memory MB")
    for task in TASKS:
        for count, threads in ((1, 1), (MANY, 1), (MANY, cores))[: 2 + (cores > 1)]:
            rate, spent = measure(task, count, threads, args.observation)
            print(
                f"{task:10s}  {count:6d}  {threads:5d}  {rate:8.0f}  {spent:18.0f}  "
                f"{memory_mb():9.0f}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
