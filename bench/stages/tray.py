"""Colliding discs in a walled tray, beside the peers: speed, overlap, energy.

Discs start in a grid with gaps of 1 mm, at random velocities. The tray shakes along x as in the
exact scene, at 20 mu g; contacts stop parts. Energy is measured in a still tray without friction:
with restitution 1 it should stay what it was, with less it should never rise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from harness import LEAST_ROUNDS, Race, Table, cpu_time
from plate_core import PlateCycle, load_rig
from plate_sim import BodyTrajectory, Contacts, simulate_bodies
from plate_sim.friction import disc
from plate_sim.world import STEP
from stages.mujoco_scene import MujocoScene
from stages.pymunk_scene import PymunkScene
from stages.scenes import CYCLES, FREQUENCY, GRAVITY, MU, MU_G, exact_cycle

OURS, PYMUNK, MUJOCO = "plate_sim", "pymunk", "MuJoCo"

RIG = load_rig()
RADIUS, HALF = RIG.parts.radius_m, RIG.plate.half
DISC = disc(RADIUS)

DENSE = 6
"""Cycles of the first 0.2 s, when all discs meet all the time."""

SLOP = 1e-5
"""Overlap [m] that pymunk may leave: as little as we do. By default it is 0.1 m, for pixels."""

THICK = 0.05
"""Of pymunk's walls [m]: none goes through."""

REPEATS = 20
"""Of our runs in one timing: it then takes about as long as the peer's, caches as warm."""

GRIDS = {10: (5, 2), 100: (20, 5), 300: (30, 10)}
"""Columns and lines of the grid by number of discs."""


@dataclass(frozen=True)
class Tray:
    """Discs at the start, and how they touch.

    Attributes
    ----------
    position, velocity : (M, 2)
        [m], [m/s], plate_home.
    restitution, mu : float
        Of all contacts; of the plate.
    cycle : PlateCycle
        How the tray moves.
    """

    position: np.ndarray
    velocity: np.ndarray
    cycle: PlateCycle
    restitution: float = 0.0
    mu: float = MU

    @classmethod
    def of(cls, count: int) -> Tray:
        """Return the tray that shakes, with so many discs."""
        columns, lines = GRIDS[count]
        x = np.arange(columns) - 0.5 * (columns - 1)
        y = np.arange(lines) - 0.5 * (lines - 1)
        spacing = min(2 * RADIUS + 1e-3, 1.99 * (HALF[0] - RADIUS) / (columns - 1))
        place = spacing * np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        speed = np.random.default_rng(1).uniform(-0.3, 0.3, place.shape)
        return cls(place, speed, exact_cycle(20))

    def still(self, restitution: float) -> Tray:
        """Return it at rest, without friction."""
        rest = PlateCycle.rest(self.cycle.period)
        return replace(self, cycle=rest, restitution=restitution, mu=0.0)

    def ours(self, steps: int, cycles: int, record: bool = False) -> BodyTrajectory:
        """Run plate_sim's parts in so many steps a cycle."""
        return simulate_bodies(
            self.cycle, DISC, self.position, 0, self.velocity, 0, self.mu, GRAVITY, cycles,
            steps if record else 0, self.cycle.period / steps,
            contacts=Contacts(self.restitution, walls=True), half=HALF,
        )  # fmt: skip

    def trace(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return plate_sim's positions and velocities after every step (k, M, 2), in the plate."""
        run = self.ours(steps, CYCLES, record=True)
        t = np.arange(1, len(run.time)) % steps * (self.cycle.period / steps)
        pose, twist = self.cycle.pose(t)[:, None, :2], self.cycle.twist(t)[:, None, :2]
        return run.position[1:] - pose, run.velocity[1:] - twist

    def in_pymunk(self, pymunk: Any, steps: int, cycles: int) -> PymunkTray:
        """Build it in pymunk."""
        return PymunkTray(pymunk, self, self.cycle.period / steps, cycles * self.cycle.period)

    def in_mujoco(self, mujoco: Any, steps: int, cycles: int) -> MujocoScene:
        """Build it in MuJoCo, which knows no restitution: only whether contacts are damped."""
        return MujocoScene(
            mujoco, self.cycle, self.cycle.period / steps, cycles * self.cycle.period,
            self.position, self.mu, self.velocity, RADIUS, HALF, 1.0 - self.restitution,
        )  # fmt: skip


class PymunkTray(PymunkScene):
    """The tray in pymunk."""

    def __init__(self, pymunk: Any, tray: Tray, dt: float, span: float) -> None:
        super().__init__(
            pymunk, tray.cycle, dt, span, tray.position, tray.mu * MU_G / MU, tray.velocity, RADIUS
        )
        self.space.collision_slop = SLOP
        x, y = HALF + THICK
        for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            ends = [(i * x + k * j * x, j * y + k * i * y) for k in (-1, 1)]
            self.space.add(pymunk.Segment(self.plate, *ends, THICK))
        for shape in self.space.shapes:
            shape.friction, shape.elasticity = 0.0, tray.restitution

    def trace(self) -> tuple[np.ndarray, np.ndarray]:
        """Advance; returns positions and velocities after every step (k, M, 2), in the plate."""
        path, speed = np.empty((2, len(self.twist), len(self.parts), 2))
        for k, velocity in enumerate(self.twist):
            self.plate.velocity = velocity
            self.space.step(self.dt)
            path[k] = [part.position - self.plate.position for part in self.parts]
            speed[k] = [part.velocity - self.plate.velocity for part in self.parts]
        return path, speed


def overlap(path: np.ndarray) -> float:
    """Deepest overlap [m] of any two discs, or of a disc and a wall, at any step (k, M, 2)."""
    i, j = np.triu_indices(path.shape[1], 1)
    least = min(float(np.linalg.norm(p[i] - p[j], axis=1).min()) for p in path)
    return max(0.0, 2 * RADIUS - least, float(np.max(np.abs(path) - (HALF - RADIUS))))


def energy_of(speed: np.ndarray) -> np.ndarray:
    """Energy (k,) of velocities (k, M, 2), whatever its unit."""
    return np.asarray(np.sum(speed**2, axis=(1, 2)))


def tray_tables(pymunk: Any, mujoco: Any, quick: bool) -> list[Table]:
    """Measure speed, overlap and energy in the tray, by number of discs and step."""
    return [
        Table(
            "discs",
            "Colliding discs in a shaken tray: speed, and overlap",
            {
                "parts": "parts", "method": "method", "step_ms": "step [ms]",
                "speed": "simulated s per s", "lead": "times pymunk at 1 ms",
                "lead_dense": "times, first 0.2 s", "overlap_um": "deepest overlap [um]",
            },
            disc_rows(pymunk, quick, mujoco),
            "1 s; discs are thrown together and come to rest in heaps. Overlap: deepest at any "
            "step. Pymunk with 10 iterations and a slop of 0.01 mm.",
        ),
        Table(
            "disc_energy",
            "100 colliding discs in a still tray without friction, 1 s: energy",
            {
                "method": "method", "step_ms": "step [ms]", "drift": "drift, restitution 1",
                "rise": "greatest rise in a step, restitution 0.5",
                "overlap_um": "deepest overlap, restitution 1 [um]",
            },
            energy_rows(pymunk, mujoco, quick),
            "As shares of the energy at the start. MuJoCo: damping 0 and 0.5 instead.",
        ),
    ]  # fmt: skip


def methods(tray: Tray, pymunk: Any, mujoco: Any, quick: bool) -> list[tuple[str, int, Any]]:
    """Methods with their steps a cycle, about 1, 1.5 and 0.2 ms, and how they trace the tray.

    Ours come with the simulator's own step, too.
    """
    steps = (33, 22) if quick else (33, 22, 167)
    own = round(tray.cycle.period / STEP)
    found: list[tuple[str, int, Any]] = [
        (OURS, n, lambda t, n=n: t.trace(n)) for n in dict.fromkeys((*steps, own))
    ]
    for name, module, build in ((PYMUNK, pymunk, Tray.in_pymunk), (MUJOCO, mujoco, Tray.in_mujoco)):
        if module:
            chosen = steps[::2] if name == PYMUNK else steps[:1]
            found += [
                (name, n, lambda t, n=n, b=build, m=module: b(t, m, n, CYCLES).trace())
                for n in chosen
            ]
    return found


def disc_rows(pymunk: Any, quick: bool, mujoco: Any = None) -> list[dict[str, Any]]:
    """Speed and overlap in the shaken tray."""
    rows = []
    for count in (10, 100) if quick else GRIDS:
        tray = Tray.of(count)
        cases = methods(tray, pymunk, mujoco if count <= 100 else None, quick)
        timed = {
            cycles: turns(tray, cases, pymunk, mujoco, cycles, quick) for cycles in (CYCLES, DENSE)
        }
        for name, steps, trace in cases:
            key = f"{name} {steps}"
            leads = {
                cycles: race.lead(key, f"{PYMUNK} 33") if pymunk else None
                for cycles, race in timed.items()
            }
            rows.append(
                {
                    "parts": count, "method": name, "step_ms": 1e3 / FREQUENCY / steps,
                    "speed": CYCLES / FREQUENCY / timed[CYCLES].median(key),
                    "lead": leads[CYCLES], "lead_dense": leads[DENSE],
                    "overlap_um": 1e6 * overlap(trace(tray)[0]),
                }
            )  # fmt: skip
    return rows


def turns(
    tray: Tray,
    cases: list[tuple[str, int, Any]],
    pymunk: Any,
    mujoco: Any,
    cycles: int,
    quick: bool,
) -> Race:
    """Time all in turns; the peers' scenes are built afresh, which is not timed."""
    times: dict[str, list[float]] = {}
    for _ in range(1 + (LEAST_ROUNDS if quick else 7)):
        for name, steps, _trace in cases:
            if name == MUJOCO and len(times.get(f"{name} {steps}", ())) > 1:
                spent = times[f"{name} {steps}"][-1]  # slow: once is enough
            else:
                run: Any = {
                    OURS: lambda n=steps: partial(tray.ours, n, cycles),
                    PYMUNK: lambda n=steps: tray.in_pymunk(pymunk, n, cycles).run,
                    MUJOCO: lambda n=steps: tray.in_mujoco(mujoco, n, cycles).run,
                }[name]()
                repeats = REPEATS if name == OURS else 1
                began = cpu_time()
                for _ in range(repeats):
                    run()
                spent = (cpu_time() - began) / repeats
            times.setdefault(f"{name} {steps}", []).append(spent)
    return Race({name: np.array(values[1:]) for name, values in times.items()})


def energy_rows(pymunk: Any, mujoco: Any, quick: bool) -> list[dict[str, Any]]:
    """Energy in the still tray."""
    tray, rows = Tray.of(100), []
    start = energy_of(tray.velocity[None])[0]
    for name, steps, trace in methods(tray, pymunk, mujoco, quick):
        path, speed = trace(tray.still(1.0))
        lossy = energy_of(trace(tray.still(0.5))[1]) / start
        rows.append(
            {
                "method": name, "step_ms": 1e3 / FREQUENCY / steps,
                "drift": float(energy_of(speed)[-1] / start - 1),
                "rise": max(0.0, float(np.diff(lossy, prepend=1.0).max())),
                "overlap_um": 1e6 * overlap(path),
            }
        )  # fmt: skip
    return rows
