"""Stability of the plain PD loop with a wrong friction coefficient and an unknown image latency."""

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
"""True friction divided by the assumed one."""

LATENCIES = np.linspace(0.0, 1.5, 9)
"""Latency of images, which the loop assumes to be 0 [cycles]."""

SEEDS = (1, 2)
CYCLES, FIRST = 40, 10
"""Length of a run, and the first cycle that is evaluated."""

PUSH_M = 3e-3
"""Initial distance of the part from its target [m]."""

SPEED = 0.1
"""Maximum requested drift velocity [m/s]."""

KP = FollowOptions().kp
STEPS = 64
LEVEL_MM = 2.0
"""Minimum error of a loop that counts as unstable [mm]."""

CASES, ASKED_M, SEED = 40, 2e-3, 84
"""Number of motions to which the linear loop is fitted, size of their requests [m], random seed."""


class Loop:
    """Loop that holds one part at its place. The solver assumes the rig's friction."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self.rig = rig
        self.solver = SinusoidSolver(rig, iterations=24, restarts=1, seed=seed)
        self.period = self.solver.steering_period(1)
        self.home = np.random.default_rng(seed).uniform(-0.4, 0.4, (1, 2)) * rig.plate.half

    def answer(
        self, running: PlateCycle, seen: np.ndarray, velocity: np.ndarray
    ) -> tuple[PlateCycle, np.ndarray]:
        """Return the next cycle, and the predicted velocity (1, 2) [m/s] at its start."""
        friction = np.full(1, self.rig.friction.accel)
        ahead, then = after(running, seen, velocity, friction)
        drift = pd_drift(ahead, self.home, self.home, self.period, KP, np.full(1, SPEED))
        return self.motion(ahead, then, drift * self.period), then

    def motion(
        self, position: np.ndarray, velocity: np.ndarray, requested: np.ndarray
    ) -> PlateCycle:
        """Return a cycle for a displacement (1, 2) [m]."""
        least = DRIFT_TOLERANCE * self.period
        friction = np.full(1, self.rig.friction.accel)
        goal = Goal(position, velocity, requested, np.zeros((1, 2)), friction)
        good = max(least, EXACT_MISS * goal.size)
        return self.solver.steer(goal, least, good).cycle

    def run(self, friction: float, latency: float) -> float:
        """Return the root mean square error at the starts of cycles [m]."""
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
    """Linear model of the loop.

    On each axis, a part's displacement and final velocity are linear in the requested displacement
    a, the velocity b that the solver assumes, and the true velocity v. The coefficients are fitted
    to the solver's cycle map, for successive motions of the solver.
    """

    def __init__(self, rig: Rig) -> None:
        loop = Loop(rig, SEEDS[0])
        self.period, self.rig = loop.period, rig
        rng, velocity, self.cases = np.random.default_rng(SEED), np.zeros((1, 2)), []
        self.response = cache(self._response)
        for _ in range(CASES):
            requested = ASKED_M * rng.normal(size=(1, 2))
            cycle = loop.motion(loop.home, velocity, requested)
            true = velocity + ASKED_M / self.period * rng.normal(size=(1, 2))
            self.cases.append((cycle, loop.home, requested, velocity, true))
            velocity = self._after(cycle, loop.home, velocity, 1.0, 1.0)[1]

    def _after(
        self, cycle: PlateCycle, position: np.ndarray, velocity: np.ndarray, friction: float,
        share: float,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Return position and velocity after a fraction of the cycle, by the solver's cycle map."""
        steps = max(1, round(share * self.period / PREDICTION_STEP))
        t = (np.arange(steps) + 0.5) * share * self.period / steps
        accel = np.full(1, friction * self.rig.friction.accel)
        dt = np.full(steps, share * self.period / steps)
        return end_state(position, velocity, cycle.pose(t), cycle.twist(t), dt, accel)

    def _response(self, friction: float, share: float) -> np.ndarray:
        """Return the coefficients (2, 3) of a, b and v in displacement and velocity after a
        fraction of a cycle."""
        if share == 0:
            return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        rows, ends = [], []
        for cycle, home, requested, assumed, true in self.cases:
            place, velocity = self._after(cycle, home, true, friction, share)
            rows.append(np.stack([requested[0], assumed[0], true[0]], axis=1))
            ends.append(np.stack([(place - home)[0], velocity[0]], axis=1))
        return np.linalg.lstsq(np.concatenate(rows), np.concatenate(ends), rcond=None)[0].T

    def growth(self, friction: float, latency: float) -> float:
        """Return the spectral radius of the loop per cycle. The loop is unstable above 1.

        The state at an image is (x, a, b, v) of the running cycle and of the two before. The
        controller uses the position y at the time of the image minus the latency. It adds the
        request a of the running cycle, and requests -kp (y + a).
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
        """Return the minimum latency at which the loop is unstable [cycles]. NaN if it is always
        stable."""
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
    x_label="true over assumed friction [-]",
    y_label="latency of the image [cycles]",
    z_label="RMS error of a held part [mm]",
    line_label="delay margin of the linear loop",
    level=LEVEL_MM,
    measure=measure,
    bounds=(0.0, 6.0),
    log="x",
    finding="A loop that treats late images as new is unstable above a latency of about half a "
    "cycle, or less if the friction is higher than assumed. If the friction is lower, the error "
    "should grow by some per cent per cycle, which is not visible within the runs.",
    note=f"Values are means of {len(SEEDS)} runs with one part and {CYCLES} cycles of 0.1 s; "
    f"kp = {KP:g}. "
    "Unlike the planner, this loop does not estimate friction and the age of images.",
)
