"""Parts on a shaken plate: error and speed of the simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from harness import Result, Table, missing, optional, race
from plate_core import PlateCycle, Rig, load_rig
from plate_sim import WorldState, run_cycle
from plate_sim.friction import TOLERANCE
from plate_sim.world import STEP
from stages.mujoco_scene import MujocoScene
from stages.pymunk_scene import PymunkScene
from stages.scenes import (
    CYCLES,
    EXACT_M,
    FREQUENCY,
    MU,
    MU_G,
    Scene,
    random_directions,
    resting_scene,
)
from stages.tray import tray_rows

EVENTS = "by events"
"""Method: the reference."""

STEPS = "in steps"
"""Method: the simulator's model of parts."""

PYMUNK = "pymunk"
"""Method: a baseline."""

MUJOCO = "MuJoCo"
"""Method: a second baseline."""

PYMUNK_STEP_MS = 0.1
"""Time step of pymunk. With this step pymunk's error in the exact scene is 0.12 %. Speeds are
compared at this error."""

SPAN, BASELINE_SPAN = CYCLES / FREQUENCY, 0.1
"""Simulated time of a scene, and of a timed run of a baseline [s]."""

MUJOCO_MIN_MS = 0.05
"""Minimum time step of MuJoCo [ms]. Shorter steps take long and are not more accurate."""

WIDE_M = 2.0
"""Side length of the plate in measurements of the cost [m], large enough for 1000 parts."""

SPACING_M = 0.02
"""Distance between the centres of parts in measurements of the cost [m]. They do not touch."""


def measure(quick: bool) -> Result:
    """Measure the error of each setting, the speed at the error of pymunk, colliding discs, and the
    CPU time."""
    tables = [
        Table.of("error", error_rows(quick)),
        Table.of("speed", speed_rows(quick), step=PYMUNK_STEP_MS),
        Table.of("cost", cost_rows(quick), step=1e3 * STEP),
        Table.of("discs", tray_rows(quick)),
    ]
    return Result(tables, missing(PYMUNK, "mujoco"))


def rms(values: Any) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def pymunk_scene(scene: Scene, dt: float, span: float, offset: float = 0.5) -> PymunkScene:
    """Return pymunk's scene. `offset` is the time in a step at which the plate's velocity is
    evaluated."""
    return PymunkScene(scene.cycle, dt, span, scene.position, MU_G, scene.velocity, offset=offset)


def pymunk_travel(scene: Scene, dt: float, offset: float) -> np.ndarray:
    """Return the displacement of pymunk's parts in 1 s (M, 2) [m]."""
    return np.asarray(pymunk_scene(scene, dt, SPAN, offset).run() - scene.position)


Setting = tuple[str, str, list[float], Callable[[], object], float]
"""One method with one setting: method, setting, errors [m], function to time, and the time that
this function simulates [s]."""


def error_rows(quick: bool) -> list[dict[str, Any]]:
    """For each setting, return a row with the error of one part's travel after 1 s, and with the
    speed of the simulation."""
    rows = []
    for gamma, exact in EXACT_M.items():
        for method, setting, errors, run, span in settings(resting_scene(gamma, 1), exact, quick):
            timed = race({"": run}, 0.1 if quick else 0.4)
            rows.append(
                {
                    "method": method, "gamma": gamma, "setting": setting,
                    "error_mm": 1e3 * rms(errors), "error_percent": 100 * rms(errors) / exact,
                    "speed": span / timed.median(""),
                }
            )  # fmt: skip
    return rows


def settings(scene: Scene, exact: float, quick: bool) -> Iterator[Setting]:
    """Yield every method with each of its settings. `exact` is the exact travel [m]."""
    steps_ms = (1.0, 0.1) if quick else (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
    tolerances = (1e-4, TOLERANCE) if quick else (1e-3, 1e-4, 1e-5, 1e-6, TOLERANCE, 1e-9, 1e-12)
    repeats = range(2 if quick else 5)
    for tolerance in tolerances:
        run = partial(scene.travel, tolerance)
        yield EVENTS, f"{tolerance:g} m", [run()[0, 0] - exact], run, SPAN
    for step_ms in steps_ms:
        name, dt = f"{step_ms:g} ms", 1e-3 * step_ms
        count = max(1, round(1 / FREQUENCY / dt))  # number of steps per cycle nearest to dt
        steps = [1 / FREQUENCY / (count + i) for i in repeats]
        errors = [scene.travel_in_steps(step)[0, 0] - exact for step in steps]
        yield STEPS, name, errors, partial(scene.travel_in_steps, steps[0]), SPAN
        # measure the other simulator twice: with the plate's velocity at two different times in a
        # step
        if optional(PYMUNK):
            spans = [SPAN / (CYCLES * count + 3 * i) for i in repeats]
            both = [
                [pymunk_travel(scene, span, offset)[0, 0] - exact for span in spans]
                for offset in (0.5, 1.0)
            ]
            baseline = pymunk_scene(scene, dt, BASELINE_SPAN)
            yield PYMUNK, name, min(both, key=rms), baseline.run, BASELINE_SPAN
        if optional("mujoco") and step_ms >= MUJOCO_MIN_MS:
            long, short = (
                MujocoScene(scene.cycle, dt, span, scene.position, MU)
                for span in (SPAN, BASELINE_SPAN)
            )
            error = long.run()[0, 0] - scene.position[0, 0] - exact
            yield MUJOCO, name, [error], short.run, BASELINE_SPAN


def speed_rows(quick: bool) -> list[dict[str, Any]]:
    """For each number of parts, return a row with the speeds of the methods. All methods are
    compared at the error of pymunk. The parts move in all directions."""
    counts, has_pymunk = (1, 10, 100), optional(PYMUNK)
    return [
        {"parts": count, "lead": speedup(count, quick) if has_pymunk else None} for count in counts
    ]


def speedup(count: int, quick: bool) -> float:
    """Return the ratio of the simulator's speed to pymunk's, at the same error."""
    scene, dt = random_directions(20, count), 1e-3 * PYMUNK_STEP_MS
    truth = scene.travel(1e-11)
    error = min(rms(pymunk_travel(scene, dt, offset) - truth) for offset in (0.5, 1.0))
    ours = partial(scene.travel, loosest(scene, truth, error))
    run = pymunk_scene(scene, dt, BASELINE_SPAN)
    timed = race({"ours": ours, PYMUNK: run.run}, 0.3 if quick else 2.0)
    return SPAN / BASELINE_SPAN * timed.speedup("ours", PYMUNK)


def loosest(scene: Scene, truth: np.ndarray, limit: float) -> float:
    """Return the largest tolerance with which the error does not exceed `required` [m]."""
    for tolerance in 10.0 ** np.arange(-3, -10, -1):
        if rms(scene.travel(tolerance) - truth) <= limit:
            break
    return float(tolerance)


def cost_rows(quick: bool) -> list[dict[str, Any]]:
    """Return rows of simulated seconds per second of every method, for 1 to 1000 parts."""
    rows = []
    for count in (1, 100) if quick else (1, 3, 10, 30, 100, 300, 1000):
        scene = random_directions(20, count)
        side = int(np.ceil(np.sqrt(count)))
        position = SPACING_M * (np.arange(side) - 0.5 * (side - 1))
        grid = np.stack(np.meshgrid(position, position), axis=-1).reshape(-1, 2)[:count]
        scene = Scene(scene.cycle, grid, 0 * scene.velocity)
        contestants: dict[str, Callable[[], object]] = {
            EVENTS: partial(scene.travel, TOLERANCE),
            STEPS: partial(run_world, scene.cycle, scene.position),
        }
        if optional(PYMUNK):
            contestants[PYMUNK] = pymunk_scene(scene, 1e-3, BASELINE_SPAN).run
        spans = {EVENTS: SPAN, STEPS: 3 / FREQUENCY, PYMUNK: BASELINE_SPAN}
        timed = race(contestants, 0.3 if quick else 1.5)
        rows.append({"parts": count} | {n: spans[n] / timed.median(n) for n in contestants})
    return rows


def run_world(cycle: PlateCycle, position: np.ndarray) -> WorldState:
    """Run three cycles of the closed loop's world, on a larger plate."""
    ids = tuple(f"black_{i + 1}" for i in range(len(position)))
    state = WorldState.at_rest(ids, position)
    return run_cycle(state, cycle, wide_rig(), MU, cycles=3)


@lru_cache(maxsize=1)
def wide_rig() -> Rig:
    """Return the default rig with a plate that is large enough for many parts."""
    rig = load_rig()
    return replace(rig, plate=replace(rig.plate, length_m=WIDE_M, width_m=WIDE_M))
