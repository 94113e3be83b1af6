"""The simulator's model of parts: cost and error by scene, compared with the reference and pymunk.

There are scenes with separate parts, with touching parts, with a rotating plate, and with a
suspended plate. For each number of parts the cost of a plate cycle and the error at its end are
measured. The reference simulates parts as points. The reference computes the exact times at which a
part begins to slide or to stick.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from harness import Result, Table, missing, optional, race
from plate_core import PlateCycle, Rig, load_rig
from plate_sim import (
    Contacts,
    PlateMotion,
    PlateState,
    WorldState,
    realise,
    run_cycle,
    simulate,
)
from plate_sim.world import STEP
from stages.learning import rig_on_flexures
from stages.pymunk_scene import PymunkScene

KINDS = ("apart", "rotating", "touching", "touching and rotating", "suspension")
COUNTS = (1, 3, 10, 30, 100)
PERIOD, HARMONICS, SIZE_M = 0.1, 4, 2.5e-3
"""Period [s], number of harmonics, and approximate amplitude [m] of the plate's motion."""

ANGLE = 0.03
"""Approximate amplitude of the plate's rotation, in scenes with rotation [rad]."""

EDGE_FRICTION = 0.2
"""Friction coefficient between parts that touch on a rotating plate."""

CYCLES = 3
"""Number of cycles in a timed run. The error is measured after the first cycle."""

FINE = 1e-5
"""Time step of the reference in scenes where parts cannot be simulated as points [s]."""

BASELINE_STEP = 1e-3
"""Time step of pymunk [s]."""

MODEL, BY_EVENTS, PYMUNK = "one model", "by events", "pymunk"


@dataclass(frozen=True)
class Scene:
    """Scene: parts at the start of `CYCLES` equal cycles.

    Attributes
    ----------
    kind : str
    rig : Rig
    cycle : PlateCycle
    state : WorldState
    contacts : Contacts
    """

    kind: str
    rig: Rig
    cycle: PlateCycle
    state: WorldState
    contacts: Contacts

    @classmethod
    def of(cls, kind: str, count: int) -> Scene:
        """Return a scene with `count` moving parts on a grid."""
        rig, touching, rotates = load_rig(), "touching" in kind, "rotating" in kind
        spacing = 2 * rig.parts.radius_m + 4e-4 if touching else 0.037
        k, columns = np.arange(count), int(np.ceil(np.sqrt(2 * count)))
        position = spacing * np.column_stack([k % columns, k // columns])
        speed = np.random.default_rng(3).normal(0, 0.08 if touching else 0.03, (count, 2))
        ids = tuple(f"black_{i + 1}" for i in k)
        return cls(
            kind, rig_on_flexures(rig) if kind == "suspension" else rig,
            shaking_cycle(ANGLE if rotates else 0.0),
            replace(WorldState.at_rest(ids, position - position.mean(0)), velocity=speed),
            Contacts(friction=EDGE_FRICTION if touching and rotates else 0.0),
        )  # fmt: skip

    def motions(self, cycles: int) -> Iterator[PlateCycle | PlateMotion]:
        """Yield the plate's actual motion in each cycle."""
        plate = PlateState.at_rest()
        for _ in range(cycles):
            if self.rig.suspension is None:
                yield self.cycle
            else:
                motion, plate = realise(self.rig, plate, self.cycle)
                yield motion

    def run(self, cycles: int = CYCLES, step: float = STEP) -> np.ndarray:
        """Return the final positions of the parts (M, 2) [m] in the simulator's `World`."""
        state = self.state
        for motion in self.motions(cycles):
            state = run_cycle(state, motion, self.rig, step=step, contacts=self.contacts)
        return state.position

    def by_events(self, cycles: int = CYCLES, tolerance: float = 1e-7) -> np.ndarray:
        """Return the final positions (M, 2) [m] of the parts, simulated as points without
        collisions."""
        position, speed, friction = self.state.position, self.state.velocity, self.rig.friction
        for motion in self.motions(cycles):
            run = simulate(motion, position, speed, friction.mu, friction.gravity, 1, 1, tolerance)
            position, speed = run.position[-1], run.velocity[-1]
        return position

    def truth(self) -> np.ndarray:
        """Return the reference positions of the parts after one cycle (M, 2) [m]."""
        if self.kind in ("apart", "suspension"):
            return self.by_events(1, 1e-10)
        return self.run(1, step=FINE)

    def in_pymunk(self, cycles: int = CYCLES) -> PymunkScene:
        """Return the scene in pymunk, which does not simulate the friction torque of a rotating
        plate."""
        radius = self.rig.parts.radius_m if "touching" in self.kind else 0.0
        return PymunkScene(
            self.cycle, BASELINE_STEP, cycles * PERIOD, self.state.position,
            self.rig.friction.accel, self.state.velocity, radius,
        )  # fmt: skip


def shaking_cycle(rotation: float) -> PlateCycle:
    """Return a motion of several harmonics along x and y, and rotations of about `rotation`
    [rad]."""
    t, h = np.arange(96) / 96, np.arange(1, HARMONICS + 1)[:, None, None]
    rng = np.random.default_rng(7)
    phase, size = rng.uniform(0, 2 * np.pi, (HARMONICS, 3, 1)), rng.normal(size=(HARMONICS, 3, 1))
    pose = np.sum(size / h * np.sin(2 * np.pi * h * t + phase), 0).T * [SIZE_M, SIZE_M, rotation]
    return PlateCycle.from_samples(PERIOD, pose)


def measure(quick: bool) -> Result:
    """Measure cost and error by scene and number of parts."""
    rows = []
    for kind in KINDS:
        for count in COUNTS[::2] if quick else COUNTS:
            rows += scene_rows(Scene.of(kind, count), 0.1 if quick else 1.0)
    return Result([Table.of("model", rows)], missing(PYMUNK))


def scene_rows(scene: Scene, seconds: float) -> list[dict[str, Any]]:
    """Return a row for every method."""
    truth = scene.truth()
    ends = {MODEL: scene.run(1), BY_EVENTS: scene.by_events(1)}
    runs: dict[str, Callable[[], object]] = {MODEL: scene.run, BY_EVENTS: scene.by_events}
    if optional(PYMUNK) and scene.kind in ("apart", "touching"):
        ends[PYMUNK] = scene.in_pymunk(1).run()
        runs[PYMUNK] = scene.in_pymunk().run
    timed = race(runs, seconds)
    return [
        {
            "scene": scene.kind, "parts": len(truth), "method": name,
            "cpu_ms": 1e3 * timed.median(name) / CYCLES,
            "error_um": 1e6 * float(np.sqrt(np.mean(np.sum((ends[name] - truth) ** 2, axis=1)))),
        }
        for name in runs
    ]  # fmt: skip
