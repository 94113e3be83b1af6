"""Colliding discs in a tray with walls, compared with the baselines: speed and overlap.

Discs start on a grid with gaps of 1 mm, with random velocities. The tray shakes along x as in the
exact scene, with 20 mu g. Contacts are inelastic.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from harness import MIN_ROUNDS, cpu_time, optional
from plate_core import load_rig
from plate_sim import BodyTrajectory, Contacts, simulate_bodies
from plate_sim.friction import disc
from plate_sim.world import STEP
from stages.mujoco_scene import MujocoScene
from stages.pymunk_scene import PymunkScene
from stages.scenes import CYCLES, FREQUENCY, GRAVITY, MU, MU_G, Scene, exact_cycle

PROJECT, PYMUNK, MUJOCO = "plate_sim", "pymunk", "MuJoCo"

RIG = load_rig()
RADIUS, HALF = RIG.parts.radius_m, RIG.plate.half
DISC = disc(RADIUS)

SPAN = CYCLES / FREQUENCY
"""Simulated time [s]."""

SLOP = 1e-5
"""Overlap that pymunk allows [m], as small as in the project's simulator. pymunk's default of 0.1
is meant for lengths in pixels."""

THICK = 0.05
"""Thickness of pymunk's walls [m], so that no disc passes through."""

REPEATS = 20
"""Number of the simulator's runs in one timing. These runs take about as long as one run of a
baseline, so that the processor's caches are in a similar state."""

GRIDS = {10: (5, 2), 100: (20, 5), 300: (30, 10)}
"""Columns and rows of the grid, by number of discs."""


MUJOCO_MAX = 100
"""Maximum number of discs for MuJoCo. With more it takes too long."""


def tray_scene(count: int) -> Scene:
    """Return the tray with `count` discs."""
    columns, lines = GRIDS[count]
    x = np.arange(columns) - 0.5 * (columns - 1)
    y = np.arange(lines) - 0.5 * (lines - 1)
    spacing = min(2 * RADIUS + 1e-3, 1.99 * (HALF[0] - RADIUS) / (columns - 1))
    position = spacing * np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    speed = np.random.default_rng(1).uniform(-0.3, 0.3, position.shape)
    return Scene(exact_cycle(20), position, speed)


def simulate_discs(tray: Scene, steps: int, samples: int = 0) -> BodyTrajectory:
    """Simulate the discs with plate_sim, with given numbers of steps and samples per cycle."""
    return simulate_bodies(
        tray.cycle, DISC, tray.position, 0, tray.velocity, 0, MU, GRAVITY, CYCLES, samples,
        tray.cycle.period / steps, contacts=Contacts(0.0, walls=True), half=HALF,
    )  # fmt: skip


def simulate_trace(tray: Scene, steps: int) -> np.ndarray:
    """Return plate_sim's positions in the plate's frame after every step (k, M, 2) [m]."""
    run = simulate_discs(tray, steps, steps)
    t = np.arange(1, len(run.time)) % steps * (tray.cycle.period / steps)
    return np.asarray(run.position[1:] - tray.cycle.pose(t)[:, None, :2])


class PymunkTray(PymunkScene):
    """The tray in pymunk."""

    def __init__(self, tray: Scene, dt: float) -> None:
        import pymunk

        super().__init__(tray.cycle, dt, SPAN, tray.position, MU_G, tray.velocity, RADIUS)
        self.space.collision_slop = SLOP
        x, y = HALF + THICK
        for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            first, last = ((i * x + k * j * x, j * y + k * i * y) for k in (-1, 1))
            self.space.add(pymunk.Segment(self.plate, first, last, THICK))
        for shape in self.space.shapes:
            shape.friction = shape.elasticity = 0.0

    def trace(self) -> np.ndarray:
        """Simulate the scene. Return positions in the plate's frame after every step (k, M, 2)
        [m]."""
        path = np.empty((len(self.twist), len(self.parts), 2))
        for k, velocity in enumerate(self.twist):
            self.plate.velocity = velocity
            self.space.step(self.dt)
            path[k] = [part.position - self.plate.position for part in self.parts]
        return path


def max_overlap(path: np.ndarray) -> float:
    """Return the maximum overlap of two discs, or of a disc and a wall, at any step (k, M, 2)
    [m]."""
    i, j = np.triu_indices(path.shape[1], 1)
    min_gap = min(float(np.linalg.norm(p[i] - p[j], axis=1).min()) for p in path)
    return max(0.0, 2 * RADIUS - min_gap, float(np.max(np.abs(path) - (HALF - RADIUS))))


def tray_rows(quick: bool) -> list[dict[str, Any]]:
    """Measure speed and overlap in the tray, by number of discs and step."""
    counts = (10, 100) if quick else GRIDS
    return [row for count in counts for row in disc_rows(tray_scene(count), quick)]


def disc_rows(tray: Scene, quick: bool) -> list[dict[str, Any]]:
    """Return rows of speed and overlap of all methods, with time steps of about 1, 1.5 and 0.2 ms,
    and of the simulator's default step.

    The methods are timed in turn. The baselines' scenes are built for each run, which is not timed.
    """
    steps = (33, 22) if quick else (33, 22, 167)
    tray_steps = round(tray.cycle.period / STEP)
    build: dict[str, Callable[[int], Any]] = {
        PYMUNK: lambda n: PymunkTray(tray, tray.cycle.period / n),
        MUJOCO: lambda n: MujocoScene(
            tray.cycle, tray.cycle.period / n, SPAN, tray.position, MU, tray.velocity,
            RADIUS, HALF,
        ),
    }  # fmt: skip
    cases = [(PROJECT, n) for n in dict.fromkeys((*steps, tray_steps))]
    cases += [(PYMUNK, n) for n in steps[::2] if optional(PYMUNK)]
    cases += [
        (MUJOCO, n) for n in steps[:1] if optional("mujoco") and len(tray.position) <= MUJOCO_MAX
    ]

    def trace(name: str, n: int) -> np.ndarray:
        return simulate_trace(tray, n) if name == PROJECT else np.asarray(build[name](n).trace())

    times: dict[tuple[str, int], list[float]] = {case: [] for case in cases}
    for _ in range(1 + (MIN_ROUNDS if quick else 7)):
        for (name, n), spent in times.items():
            if name == MUJOCO and len(spent) > 1:
                continue  # MuJoCo is timed only once, because MuJoCo is slow
            run = partial(simulate_discs, tray, n) if name == PROJECT else build[name](n).run
            repeats = REPEATS if name == PROJECT else 1
            began = cpu_time()
            for _ in range(repeats):
                run()
            spent.append((cpu_time() - began) / repeats)
    return [
        {
            "parts": len(tray.position), "method": name, "step_ms": 1e3 / FREQUENCY / n,
            "speed": SPAN / float(np.median(spent[1:])),
            "overlap_um": 1e6 * max_overlap(trace(name, n)),
        }
        for (name, n), spent in times.items()
    ]  # fmt: skip
