"""Scenes for the simulator and its baselines: parts without collisions on a shaken plate.

In the exact scene the plate has the velocity V (sin w t + 0.5 cos 2 w t) along x at 30 Hz. The
travel after 1 s is known from an event-driven integration. This travel agrees with `solve_ivp` at
rtol 1e-12 within 1e-10 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle, Rig
from plate_sim import simulate, simulate_bodies
from plate_sim.friction import TOLERANCE, disc

FREQUENCY = 30.0
"""Frequency of the plate [Hz]."""

CYCLES = 30
"""Number of cycles in a scene, 1 s."""

EXACT_M = {4: 4.9974160443e-3, 20: 65.346182922e-3}
"""Displacement after 1 s of a part that starts at rest [m]. The key is the plate's peak
acceleration divided by mu g."""

MU, GRAVITY = 0.25, 9.81
MU_G = MU * GRAVITY

RADIUS = 0.008
"""Radius of the parts [m]. The parts never touch each other."""

SPEED = 0.1
"""Standard deviation of the initial velocities, in scenes in which they differ [m/s]."""

SPIN = 5.0
"""Ratio of the peak angular velocity of a rotating plate [rad/s] to its peak speed [m/s]."""


@dataclass(frozen=True)
class Scene:
    """Parts at the start of `CYCLES` cycles.

    Attributes
    ----------
    cycle : PlateCycle
    position, velocity : (M, 2)
        [m], [m/s], plate_home.
    """

    cycle: PlateCycle
    position: np.ndarray
    velocity: np.ndarray

    def travel(self, tolerance: float = TOLERANCE) -> np.ndarray:
        """Simulate the scene event by event. Return the displacement of each part (M, 2) [m]."""
        run = simulate(self.cycle, self.position, self.velocity, MU, GRAVITY, CYCLES, 1, tolerance)
        return np.asarray(run.position[-1] - self.position)

    def travel_in_steps(self, step: float) -> np.ndarray:
        """Simulate the scene with the model of parts of the simulator's `World`, in time steps [s].
        Return the displacement of each part (M, 2) [m]."""
        run = simulate_bodies(
            self.cycle, disc(RADIUS), self.position, 0, self.velocity, 0, MU, GRAVITY, CYCLES, 0,
            step,
        )  # fmt: skip
        return np.asarray(run.position[-1] - self.position)


def wave_cycle(
    frequency: float, speed: np.ndarray, overtone: float = 0.5, late: np.ndarray | float = 0.0
) -> PlateCycle:
    """Return a motion whose velocity is u = speed (sin w t + overtone cos 2 w t).

    Parameters
    ----------
    frequency : float
        [Hz]
    speed : (3,)
        Peak speed along x and y [m/s], and angular speed about the centre [rad/s].
    late : (3,) or float
        Phase delays of the three components [rad].
    """
    w, wt = 2 * np.pi * frequency, 2 * np.pi * np.arange(256)[:, None] / 256 - late
    pose = speed / w * (-np.cos(wt) + 0.5 * overtone * np.sin(2 * wt))
    twist = speed * (np.sin(wt) + overtone * np.cos(2 * wt))
    accel = speed * w * (np.cos(wt) - 2 * overtone * np.sin(2 * wt))
    return PlateCycle.from_samples(1 / frequency, pose, twist, accel)


def exact_cycle(gamma: float, spin: float = 0.0) -> PlateCycle:
    """Return the motion of the exact scene with the peak acceleration gamma mu g.

    The plate also rotates with theta' = `spin` times the velocity along x, a quarter of a cycle
    later. `spin` has the unit rad/m, and 0 means no rotation.
    """
    phase = np.linspace(0, 2 * np.pi, 20001)
    peak = np.max(np.abs(np.cos(phase) - np.sin(2 * phase)))
    speed = gamma * MU_G / (2 * np.pi * FREQUENCY) / peak * np.array([1.0, 0.0, spin])
    return wave_cycle(FREQUENCY, speed, late=np.array([0.0, 0.0, 0.5 * np.pi]))


def resting_scene(gamma: float, count: int) -> Scene:
    """Return the exact scene, in which all parts start at rest."""
    position = np.random.default_rng(0).uniform(-0.1, 0.1, (count, 2))
    return Scene(exact_cycle(gamma), position, np.zeros((count, 2)))


def random_directions(gamma: float, count: int) -> Scene:
    """Return the exact scene with random initial velocities of the parts."""
    scene = resting_scene(gamma, count)
    velocity = np.random.default_rng(1).normal(0, SPEED, (count, 2))
    return Scene(scene.cycle, scene.position, velocity)


MAX_FORCE = 0.2
"""Maximum length of target forces [mu m g]."""


TRIES = 1000
"""Number of random scenes generated at once. With 24 parts, only about one scene in 100,000 has the
required gaps."""


def random_positions(rig: Rig, parts: int, rng: np.random.Generator) -> np.ndarray:
    """Return random positions (M, 2) [m]. The distance between two parts is at least 40 mm. The
    distance from the edges is at least 15 % of the plate's size."""
    limit = 0.85 * rig.plate.half
    while True:
        before = rng.bit_generator.state
        tried = rng.uniform(-limit, limit, (TRIES, parts, 2))
        good = np.arange(TRIES)
        for k in range(1, parts):
            gaps = np.linalg.norm(tried[good, :k] - tried[good, k, None], axis=2)
            good = good[np.min(gaps, axis=1) >= 0.04]
        # repeat the draw, so that the random numbers continue as if the scenes were drawn one by
        # one
        if len(good):
            rng.bit_generator.state = before
            return rng.uniform(-limit, limit, (good[0] + 1, parts, 2))[-1]


def targets(
    rig: Rig, parts: int, count: int, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return random positions (M, 2) [m] and forces (M, 2) [mu m g]."""
    found = []
    for _ in range(count):
        position = random_positions(rig, parts, rng)
        angle, size = rng.uniform(0, 2 * np.pi, parts), MAX_FORCE * np.sqrt(rng.uniform(size=parts))
        found.append((position, size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])))
    return found
