"""The plain PD loop with wrong friction and late images of which nobody tells it."""

from __future__ import annotations

from functools import cache

import numpy as np

from maps.grid import Grid, StabilityMap, grid
from plate_core import PlateCycle, Rig, load_rig
from plate_planner import FollowOptions
from plate_planner.tasks import pd_drift
from plate_sim import simulate
from plate_solver import DRIFT_TOLERANCE, EXACT_MISS, Goal, SinusoidSolver
from plate_solver.cycle_map import PREDICTION_STEP, after, end_state

FRICTIONS = np.geomspace(0.5, 2.0, 9)
"""True friction over the one believed."""

LATENCIES = np.linspace(0.0, 1.5, 9)
"""Age of an image when it is taken for new, in cycles."""

SEEDS = (1, 2)
CYCLES, FIRST = 40, 10
"""Length of a run, and the first cycle that counts."""

PUSH_M = 3e-3
"""How far the part lies from where it is to stay."""

SPEED = 0.1
"""Greatest drift that is asked [m/s]."""

KP = FollowOptions().kp
STEPS = 64
LEVEL_MM = 2.0
"""Error that tells a loop that swings up from one that settles."""

CASES, ASKED_M, SEED = 40, 2e-3, 84
"""Motions to which the linear loop is fitted, the size of what is asked of them, and chance."""


class Loop:
    """One part that is to stay in its place; the solver believes the rig's friction."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self.rig = rig
        self.solver = SinusoidSolver(rig, iterations=24, restarts=1, seed=seed)
        self.period = self.solver.steering_period(1)
        self.home = np.random.default_rng(seed).uniform(-0.4, 0.4, (1, 2)) * rig.plate.half

    def answer(
        self, running: PlateCycle, seen: np.ndarray, velocity: np.ndarray
    ) -> tuple[PlateCycle, np.ndarray]:
        """Return the next cycle, and the velocity (1, 2) [m/s] that is expected at its start."""
        friction = np.full(1, self.rig.friction.accel)
        ahead, then = after(running, seen, velocity, friction)
        drift = pd_drift(ahead, self.home, self.home, self.period, KP, np.full(1, SPEED))
        return self.motion(ahead, then, drift * self.period), then

    def motion(self, position: np.ndarray, velocity: np.ndarray, wanted: np.ndarray) -> PlateCycle:
        """Return a cycle for a displacement (1, 2) [m]."""
        least = DRIFT_TOLERANCE * self.period
        friction = np.full(1, self.rig.friction.accel)
        goal = Goal(position, velocity, wanted, np.zeros((1, 2)), friction)
        good = max(least, EXACT_MISS * goal.size)
        return self.solver.steer(goal, least, good).cycle

    def run(self, friction: float, latency: float) -> float:
        """Return the error [m], root mean square at the starts of cycles."""
        running, expected = PlateCycle.rest(self.period), np.zeros((1, 2))
        position, velocity = self.home + [PUSH_M, 0.0], np.zeros((1, 2))
        track, errors = np.repeat(position[None], 2 * STEPS + 1, axis=0), []
        for _ in range(CYCLES):
            seen = track[-1 - round(latency * STEPS)]
            following, expected = self.answer(running, seen, expected)
            moved = simulate(
                running, position, velocity, friction * self.rig.friction.mu,
                self.rig.friction.gravity, samples=STEPS, tolerance=1e-6,
            )  # fmt: skip
            track = np.concatenate([track, moved.position[1:]])[-2 * STEPS - 1 :]
            position, velocity = moved.position[-1], moved.velocity[-1]
            errors.append(float(np.linalg.norm(position - self.home)))
            running = following
        return float(np.sqrt(np.mean(np.square(errors[FIRST:]))))


class LinearLoop:
    """The same loop, linear: theory's.

    What a part does in a cycle is taken as linear in what is asked (a), the velocity that the
    solver believes (b) and the one that is true (v), the same on both axes. The coefficients are
    fitted to the solver's cycle map, for motions that the solver makes in a row.
    """

    def __init__(self, rig: Rig) -> None:
        loop = Loop(rig, SEEDS[0])
        self.period, self.rig = loop.period, rig
        rng, velocity, self.cases = np.random.default_rng(SEED), np.zeros((1, 2)), []
        self.response = cache(self._response)
        for _ in range(CASES):
            wanted = ASKED_M * rng.normal(size=(1, 2))
            cycle = loop.motion(loop.home, velocity, wanted)
            true = velocity + ASKED_M / self.period * rng.normal(size=(1, 2))
            self.cases.append((cycle, loop.home, wanted, velocity, true))
            velocity = self._after(cycle, loop.home, velocity, 1.0, 1.0)[1]

    def _after(
        self, cycle: PlateCycle, position: np.ndarray, velocity: np.ndarray, friction: float,
        share: float,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Return place and velocity after a share of the cycle, as the solver foresees them."""
        steps = max(1, round(share * self.period / PREDICTION_STEP))
        t = (np.arange(steps) + 0.5) * share * self.period / steps
        accel = np.full(1, friction * self.rig.friction.accel)
        dt = np.full(steps, share * self.period / steps)
        return end_state(position, velocity, cycle.pose(t), cycle.twist(t), dt, accel)

    def _response(self, friction: float, share: float) -> np.ndarray:
        """Return what a, b and v make of place and velocity (2, 3) after a share of a cycle."""
        if share == 0:
            return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        rows, ends = [], []
        for cycle, home, wanted, believed, true in self.cases:
            place, velocity = self._after(cycle, home, true, friction, share)
            rows.append(np.stack([wanted[0], believed[0], true[0]], axis=1))
            ends.append(np.stack([(place - home)[0], velocity[0]], axis=1))
        return np.linalg.lstsq(np.concatenate(rows), np.concatenate(ends), rcond=None)[0].T

    def growth(self, friction: float, latency: float) -> float:
        """Return by how much the slowest mode grows in a cycle: above 1 the loop swings up.

        At an image, the running cycle and two before have (x, a, b, v) each. The controller sees
        the place a latency ago, adds what the running cycle was asked, and asks for kp of the
        error that it expects then.
        """
        whole, own = self.response(friction, 1.0), self.response(1.0, 1.0)
        back = int(np.ceil(latency))
        part = self.response(friction, back - latency)

        def step(state: np.ndarray) -> np.ndarray:
            cycles = state.reshape(3, 4)
            x, a, b, _ = cycles[0]
            moved, velocity = whole @ cycles[0, 1:]
            seen = cycles[back, 0] + part[0] @ cycles[back, 1:]
            new = [x + moved, -KP * (seen + a), own[1] @ [a, b, b], velocity]
            return np.concatenate([new, state[:8]])

        matrix = np.column_stack([step(row) for row in np.eye(12)])
        return float(np.max(np.abs(np.linalg.eigvals(matrix))))

    def delay_margin(self, friction: float) -> float:
        """Return the latency [cycles] from which on the loop swings up; NaN if it never does."""
        tried = np.linspace(LATENCIES[0], LATENCIES[-1], 61)
        grows = [self.growth(friction, latency) >= 1 for latency in tried]
        return float(tried[int(np.argmax(grows))]) if any(grows) else float("nan")


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig = load_rig()
    frictions, latencies = (FRICTIONS[4::2], LATENCIES[::2]) if quick else (FRICTIONS, LATENCIES)
    loops = [Loop(rig, seed) for seed in (SEEDS[:1] if quick else SEEDS)]
    z = [
        [1e3 * float(np.mean([loop.run(k, age) for loop in loops])) for k in frictions]
        for age in latencies
    ]
    linear = LinearLoop(rig)
    line = [(k, linear.delay_margin(k)) for k in FRICTIONS]
    line = [(k, age) for k, age in line if not np.isnan(age)]
    return [grid(frictions, latencies, z, *np.reshape(line, (-1, 2)).T)]


MAP = StabilityMap(
    key="latency",
    title="Late images: latency and error of the assumed friction, plain PD loop",
    x_label="true friction over the friction believed [-]",
    y_label="latency of the image [cycles]",
    z_label="RMS error of a part to be held [mm]",
    line_label="theory: the delay margin of the linear loop",
    level=LEVEL_MM,
    measure=measure,
    bounds=(0.0, 6.0),
    log="x",
    finding="A loop that treats late images as new is unstable from a latency of about half a "
    "cycle on, or less if the friction is higher than assumed. If it is lower, the predicted "
    "growth of some per cent per cycle is not visible within the runs.",
    note=f"One part, {CYCLES} cycles of 0.1 s, mean of {len(SEEDS)} runs; kp = {KP:g}. "
    "Unlike in the planner, friction and age are not estimated.",
)
