"""The simulator beside pymunk: error and speed in a scene whose answer is known.

One plate velocity, V (sin w t + 0.5 cos 2 w t) along x at 30 Hz. The travel after 1 s is known from
an event-driven integration that agrees with `solve_ivp` at rtol 1e-12 to 1e-10 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from harness import Race, Result, Table, cpu_time, missing_peer, optional, race
from pymunk_scene import PymunkScene

from plate_core import PlateCycle, load_rig
from plate_sim import WorldState, run_cycle, simulate
from plate_sim.friction import STEP

FREQUENCY = 30.0
"""Of the exact scene [Hz]."""

CYCLES = 30
"""Cycles after which the travel is known: 1 s."""

SPEED_CYCLES = 3
"""Cycles simulated in one timed call: 0.1 s."""

EXACT_M = {4: 4.997416048e-3, 20: 65.3462e-3}
"""Travel [m] after 1 s, by peak acceleration over mu g."""

MU, GRAVITY = 0.25, 9.81
MU_G = MU * GRAVITY
OURS, PEER = "plate_sim", "pymunk"


def measure(quick: bool) -> Result:
    """Measure error by step, and speed by step and number of parts."""
    pymunk = optional("pymunk")
    steps_ms = (1.0, 0.2, STEP * 1e3) if quick else (1.0, 0.5, 0.2, 0.1, STEP * 1e3, 0.02, 0.01)
    errors = error_rows(steps_ms, pymunk, quick)
    speeds = speed_rows((1.0, STEP * 1e3) if quick else (1.0, 0.2, STEP * 1e3), pymunk, quick)
    discs = disc_rows(pymunk, quick)
    return Result(
        [
            Table(
                "error",
                "Error of the travel after 1 s, 1 part",
                {
                    "method": "method", "gamma": "peak accel / mu g", "step_ms": "step [ms]",
                    "error_percent": "error [%]", "speed": "simulated s per s",
                },
                errors,
                f"Default step of plate_sim: {STEP * 1e3:g} ms. Root mean square over neighbouring "
                "steps, as the error of a single one depends on where the steps fall.",
            ),
            Table(
                "speed",
                "Speed in the same scene",
                {
                    "parts": "parts", "step_ms": "step [ms]", "plate_sim": "plate_sim [s/s]",
                    "pymunk": "pymunk [s/s]", "lead": "ours / pymunk",
                },
                speeds,
            ),
            Table(
                "discs",
                "Colliding discs, step 1 ms",
                {
                    "parts": "parts", "plate_sim": "plate_sim [s/s]", "pymunk": "pymunk [s/s]",
                    "lead": "ours / pymunk", "overlap_um": "our overlap [um]",
                    "peer_overlap_um": "pymunk's overlap [um]",
                },
                discs,
                "Overlap: deepest at the end of 0.1 s.",
            ),
        ],
        summary(errors, speeds, discs, pymunk),
    )  # fmt: skip


def exact_cycle(gamma: float) -> PlateCycle:
    """Return the exact scene's motion with peak acceleration gamma mu g."""
    w = 2 * np.pi * FREQUENCY
    phase = np.linspace(0, 2 * np.pi, 20001)
    speed = gamma * MU * GRAVITY / w / np.max(np.abs(np.cos(phase) - np.sin(2 * phase)))
    wt = 2 * np.pi * np.arange(256) / 256
    pose, twist, accel = np.zeros((3, 256, 3))
    pose[:, 0] = speed / w * (-np.cos(wt) + 0.25 * np.sin(2 * wt))
    twist[:, 0] = speed * (np.sin(wt) + 0.5 * np.cos(2 * wt))
    accel[:, 0] = speed * w * (np.cos(wt) - np.sin(2 * wt))
    return PlateCycle.from_samples(1 / FREQUENCY, pose, twist, accel)


def step_count(step_ms: float) -> int:
    """Steps in one cycle, as near to the wanted step as they fit."""
    return round(1e3 / FREQUENCY / step_ms)


def our_errors(cycle: PlateCycle, step_ms: float, exact: float, cases: int) -> float:
    """Root mean square error of the travel over `cases` neighbouring steps, as a share."""
    start, first = np.zeros((1, 2)), step_count(step_ms)
    runs = [simulate(cycle, start, start, MU, GRAVITY, CYCLES, first + i) for i in range(cases)]
    return rms([run.position[-1, 0, 0] / exact - 1 for run in runs])


def peer_errors(pymunk: Any, cycle: PlateCycle, step_ms: float, exact: float, cases: int) -> float:
    """As `our_errors`; the peer may take the plate's velocity where it serves it best."""
    start, span = np.zeros((1, 2)), CYCLES / FREQUENCY
    steps = [span / (round(1e3 * span / step_ms) + 3 * i) for i in range(cases)]
    return min(
        rms(
            [
                PymunkScene(pymunk, cycle, dt, span, start, MU_G, offset=offset).run()[0, 0] / exact
                - 1
                for dt in steps
            ]
        )
        for offset in (0.5, 1.0)
    )


def rms(values: list[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def error_rows(steps_ms: tuple[float, ...], pymunk: Any, quick: bool) -> list[dict[str, Any]]:
    """Error of the travel of one part after 1 s, and the speed at that step."""
    rows = []
    for gamma, exact in EXACT_M.items():
        cycle = exact_cycle(gamma)
        for step_ms in steps_ms:
            cases = 2 if quick or step_ms < 0.02 else 5
            error = {OURS: our_errors(cycle, step_ms, exact, cases)}
            if pymunk:
                error[PEER] = peer_errors(pymunk, cycle, step_ms, exact, cases)
            timed = speed_race(cycle, step_ms, np.zeros((1, 2)), pymunk, 0.1 if quick else 0.4)
            for method, share in error.items():
                rows.append(
                    {
                        "method": method,
                        "gamma": gamma,
                        "step_ms": step_ms,
                        "error_percent": 100 * share,
                        "speed": SPEED_CYCLES / FREQUENCY / timed.median(method),
                    }
                )
    return rows


def speed_race(
    cycle: PlateCycle, step_ms: float, start: np.ndarray, pymunk: Any, seconds: float
) -> Race:
    """Time both in the exact scene; the peer's scene is built beforehand and runs on."""
    still, steps = np.zeros_like(start), step_count(step_ms)
    contestants: dict[str, Callable[[], object]] = {
        OURS: lambda: simulate(cycle, start, still, MU, GRAVITY, SPEED_CYCLES, steps)
    }
    if pymunk:
        scene = PymunkScene(
            pymunk, cycle, cycle.period / steps, SPEED_CYCLES / FREQUENCY, start, MU_G
        )
        contestants[PEER] = scene.run
    return race(contestants, seconds)


def speed_rows(steps_ms: tuple[float, ...], pymunk: Any, quick: bool) -> list[dict[str, Any]]:
    """Simulated seconds per second of one core by step and number of parts."""
    rng = np.random.default_rng(0)
    rows = []
    for count in (1, 10, 100):
        start = rng.uniform(-0.1, 0.1, (count, 2))
        for step_ms in steps_ms:
            timed = speed_race(exact_cycle(20), step_ms, start, pymunk, 0.2 if quick else 1.0)
            rows.append({"parts": count, "step_ms": step_ms, **speeds_of(timed)})
    return rows


def speeds_of(timed: Race) -> dict[str, float | None]:
    """Return speeds [simulated s per s] and their ratio."""
    span = SPEED_CYCLES / FREQUENCY
    return {
        OURS: span / timed.median(OURS),
        PEER: span / timed.median(PEER) if PEER in timed.times else None,
        "lead": timed.lead(OURS, PEER) if PEER in timed.times else None,
    }


def disc_rows(pymunk: Any, quick: bool) -> list[dict[str, Any]]:
    """Discs that collide: a grid with gaps of 1 mm, moving at random, on the shaken plate."""
    rig, cycle = load_rig(), exact_cycle(20)
    step, span, radius = (
        cycle.period / step_count(1.0),
        SPEED_CYCLES / FREQUENCY,
        rig.parts.radius_m,
    )
    rng = np.random.default_rng(1)
    rows = []
    for columns, lines in ((5, 2), (20, 5)):
        x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(lines) - lines / 2)
        position = (2 * radius + 1e-3) * np.column_stack([x.ravel(), y.ravel()])
        velocity = rng.uniform(-0.3, 0.3, position.shape)
        ids = tuple(f"black_{i}" for i in range(len(position)))
        times: dict[str, list[float]] = {OURS: [], PEER: []}
        peer_end = None
        for _ in range(3 if quick else 15):
            world = WorldState(ids, position, velocity, np.ones(len(position), bool))
            began = cpu_time()
            for _ in range(SPEED_CYCLES):
                world = run_cycle(world, cycle, rig, MU, step)
            times[OURS].append(cpu_time() - began)
            if pymunk:
                scene = PymunkScene(pymunk, cycle, step, span, position, MU_G, velocity, radius)
                began = cpu_time()
                peer_end = scene.run()
                times[PEER].append(cpu_time() - began)
        timed = Race({name: np.array(values[1:]) for name, values in times.items() if values})
        rows.append(
            {
                "parts": len(position),
                **speeds_of(timed),
                "overlap_um": 1e6 * overlap(world.position, radius),
                "peer_overlap_um": None if peer_end is None else 1e6 * overlap(peer_end, radius),
            }
        )
    return rows


def overlap(position: np.ndarray, radius: float) -> float:
    """Deepest overlap [m] of discs at (M, 2) [m]."""
    apart = np.linalg.norm(position[:, None] - position, axis=2) + 1e9 * np.eye(len(position))
    return max(0.0, 2 * radius - float(np.min(apart)))


def summary(
    errors: list[dict[str, Any]], speeds: list[dict[str, Any]], discs: list[dict[str, Any]],
    pymunk: Any,
) -> list[str]:  # fmt: skip
    """Sum up in sentences."""
    default = next(
        r for r in errors
        if r["method"] == OURS and r["gamma"] == 20 and r["step_ms"] == STEP * 1e3
    )  # fmt: skip
    lines = [
        f"default step {STEP * 1e3:g} ms: error {default['error_percent']:.2g} % at 20 mu g, "
        f"{default['speed']:.0f} simulated s per s with 1 part"
    ]
    if not pymunk:
        return [*lines, missing_peer("pymunk")]
    ratios = [r["lead"] for r in speeds if r["step_ms"] == 1.0]
    lines.append(
        "at 1 ms with 1 / 10 / 100 parts "
        + " / ".join(f"{ratio:.2g}" for ratio in ratios)
        + " times as fast as pymunk"
    )
    peers = [r for r in errors if r["method"] == PEER and r["gamma"] == 20]
    same = [r for r in peers if r["error_percent"] <= default["error_percent"]]
    if same:
        best = max(same, key=lambda r: r["speed"])
        lines.append(
            f"pymunk needs {best['step_ms']:g} ms for that error: we are "
            f"{default['speed'] / best['speed']:.2g} times as fast"
        )
    else:
        lines.append("pymunk reaches that error at none of the steps measured")
    lines.append(
        "colliding discs, 10 / 100: "
        + " / ".join(f"{r['lead']:.2g}" for r in discs)
        + " times as fast as pymunk"
    )
    return lines
