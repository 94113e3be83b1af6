"""Simulates the cycles of N plates with the same task, and computes observations and rewards.
`PlateEnv` and `PlateVectorEnv` use this module."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from plate_core import AngleTargets, CycleRequest, Parts, PlateCycle, PlateError, Targets
from plate_core.motion import IDLE_S, Timeline
from plate_core.tasks import FeedTask
from plate_driver.setpoints import prepare
from plate_sim.world import Simulation
from plate_solver import Controller
from plate_vision.bare_plate import BARE_IMAGES

from .evaluation import ROUNDING_S, Feeding, Memory, Score, TaskEvaluator, rows_of
from .motions import Motions
from .tasks import WORLDS, chosen, scenario_of

ACTIONS = ("motion", "forces", "progress", "cycle")
OBSERVATIONS = ("parts", "image")

CENTRE_NOISE_M = 3e-5
"""Standard deviation of the noise of the positions in observations `parts` [m]. The value equals
the error of this project's vision in noisy images (measured in 30 images each of sort_10 and
align_6)."""

ANGLE_NOISE = 3.5e-3
"""Standard deviation of the noise of the angles in observations `parts` [rad]. The value equals the
error of this project's vision in noisy images (measured in 30 images each of sort_10 and
align_6)."""

REST = PlateCycle.rest(IDLE_S)
"""Cycle in which the plate rests. All plates share this object, so that the dictionaries `info` of
equal seeds are equal."""

GAP = 0.5
"""Minimum distance between the edges of two moving parts for the action `progress`, divided by the
radius of a part."""

OUT_M = 0.05
"""Positions in observations `parts` are clipped at this distance outside the plate's edges [m]."""

FASTEST_MPS = 2.0
"""Drifts in observations `parts` are clipped at this absolute value [m/s]."""

NEVER_S = 1000.0
"""Maximum time since the last detection in observations `parts` [s]. A part that was never detected
has this value."""

UNSEEN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -np.inf])
"""Row of `Plate.seen` for a part that was never detected: x, y, drift along x and y, angle, time of
detection."""

MIN_DISTANCE_M = 0.01
"""Rewards are divided by the initial distance of the parts from their goals. If that distance is
shorter than this value [m], they are divided by this value."""

SEEDS = 2**31
"""Random seeds of worlds and of the solver are less than this number."""


def clocks() -> np.ndarray:
    """Return the processor time of this process and the time of a steady clock (2,) [s]."""
    return np.array([time.process_time(), time.perf_counter()])


class Step(NamedTuple):
    """Result of one cycle on each of N plates.

    Attributes
    ----------
    reward : (N,)
        Reduction of the remaining distance in this step, divided by the initial distance. In a feed
        task, the number of parts picked in this step, divided by the maximum number. When the task
        is done, 1 is added. For each lost part, 1 is subtracted.
    ended, over : (N,) bool
        `ended` is True if the task is done or has failed. `over` is True if the time limit of the
        task is exceeded.
    info : dict of arrays (N, ...)
        Details of the evaluation, see docs/guide/gym.md.
    """

    reward: np.ndarray
    ended: np.ndarray
    over: np.ndarray
    info: dict[str, np.ndarray]


class Plate:
    """One plate in one episode."""

    def __init__(self, shared: Plates, seed: int) -> None:
        self._shared = shared
        world = shared.world
        self.simulation = Simulation(
            shared.rig, shared.scenario, seed, world.disturbances, mu_scale=world.mu_scale
        )
        self.noise = np.random.default_rng((seed, 1))
        self._seed = seed
        # total computing time of this project's solver (see `clocks`) [s]
        self.solving_s = np.zeros(2)
        self.image = np.zeros(shared.image_shape, np.uint8)
        self.bare = np.zeros(0)
        self.timeline = Timeline(REST, filling=True)
        self.memory: Memory = shared.evaluator.begin(self.simulation, self.running)
        # Last observation of each part: x, y, velocity of the drift along x and y, angle, time.
        self.seen = np.tile(UNSEEN, (len(self.ids), 1))
        if shared.observation == "image" and shared.rig.types:
            bare = [self.simulation.capture_bare() for _ in range(BARE_IMAGES)]
            self.bare = np.stack(bare)

    @property
    def running(self) -> PlateCycle:
        """Running cycle, which began at the time of the last observation."""
        return self.timeline.cycle

    @property
    def time(self) -> float:
        """Time from the reset to the start of the running cycle [s]."""
        return self.timeline.begin

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the parts, in the order of the rows of observations. The id of an empty row is an
        empty text."""
        memory = self.memory
        return tuple(memory.ids) if isinstance(memory, Feeding) else self.simulation.state.ids

    @cached_property
    def controller(self) -> Controller:
        """Solver of this project. The actions `forces` and `progress` need it."""
        return Controller(self._shared.rig, seed=self._seed % SEEDS)

    def begin(self, cycle: PlateCycle) -> None:
        """End the running cycle, and begin the cycle `cycle`."""
        if isinstance(self.memory, Feeding) and self.memory.rests:
            cycle = REST
        if self._shared.action == "motion":  # motions of the action `motion` begin and end at rest
            self.timeline = Timeline(cycle, self.timeline.end)
        else:
            self.timeline = self.timeline.send(cycle).next()
        if self.memory is None:
            return
        ids, evaluator = self.ids, self._shared.evaluator
        self.memory = evaluator.update(self.memory, self.simulation, self.time, self.running)
        if evaluator.feeds:
            other = np.array([now != before for now, before in zip(self.ids, ids, strict=True)])
            self.seen = np.where(other[:, None], UNSEEN, self.seen)

    def capture(self) -> None:
        """Take an image at the start of the running cycle. If the simulated camera misses this
        image, the previous image remains in `image`."""
        image = self.simulation.capture()
        if image is not None:
            self.image = image

    def sighted(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return what an image would show, or None if the simulated camera misses the image. The
        result consists of three arrays in the order of the rows. They contain the positions (M, 2)
        [m] and the angles (M,) [rad] of the parts, and whether the image shows each part (M,)."""
        parts, state = self.simulation.visible_parts(), self.simulation.state
        if parts is None:
            return None
        visible = parts.seen & state.on_plate
        if not self._shared.evaluator.feeds:
            return parts.position, parts.angle, visible
        rows = np.array([state.ids.index(name) if name else -1 for name in self.ids])
        return (  # the appended entry at index -1 is the value of empty rows
            np.append(parts.position, [[0.0, 0.0]], axis=0)[rows],
            np.append(parts.angle, 0.0)[rows],
            np.append(visible, False)[rows],
        )

    def cycle_for(self, action: Any) -> tuple[PlateCycle, float, bool]:
        """Convert an action to a cycle within the rig's limits. Return the cycle, the largest
        fraction of a limit that it uses, and whether it was scaled down to the limits. Actions of
        the kind `motion` are not allowed."""
        level = self._shared.action
        if level != "cycle":
            make = self._forces if level == "forces" else self._progress
            began = clocks()
            request = make(np.asarray(action, float)[self._rows])
            action = self.controller.solve(request, self.running).cycle
            self.solving_s += clocks() - began
        stamp = round(self.time * 1e9)
        table, scaled = prepare(self._shared.rig, action, stamp, before=(self.running,))
        return table.cycle, scaled.usage.overall, scaled.factor < 1

    @property
    def _rows(self) -> np.ndarray:
        """Indices of the rows of parts that the solver receives (n,). In a feed task, these are the
        rows of the parts that were detected. In other tasks, these are all rows."""
        return np.flatnonzero(np.isfinite(self.seen[:, 5]) | (not self._shared.evaluator.feeds))

    def _parts(self) -> Parts:
        """Return the parts of the last observation."""
        ids, seen = tuple(self.ids[row] for row in self._rows), self.seen[self._rows]
        return Parts.make(ids, seen[:, :2], seen[:, 2:4], seen[:, 4])

    def _forces(self, action: np.ndarray) -> CycleRequest:
        """Convert an action `forces` (n, 2), in units of mu m g, to a request for mean forces."""
        return CycleRequest.make(
            self._parts(), action * self._shared.friction_limit[self._rows, None]
        )

    def _progress(self, action: np.ndarray) -> CycleRequest:
        """Convert an action `progress` to a request with targets and weights. The action has the
        shape (n, 3), or (n, 5) if parts have angles."""
        rig, angle = self._shared.rig, self.seen[self._rows, 4]
        position = action[:, :2] * rig.plate.half
        weight = np.repeat(np.abs(action[:, 2:3]), 2, axis=1)
        angles = None
        if action.shape[1] == 5:
            goal = angle + (np.pi * action[:, 3] - angle + np.pi) % (2 * np.pi) - np.pi
            reach = self._shared.reach_m[self._rows]
            angles = AngleTargets(goal, goal, np.abs(action[:, 4]) * reach)
        gap = GAP * rig.parts.radius_m
        return CycleRequest.make(
            self._parts(), targets=Targets(position, position, weight, gap, angles)
        )


class Plates:
    """N plates with the same task, and the data that they share.

    Parameters
    ----------
    task, world, action, observation : str
        Keys of `TASKS`, of `WORLDS`, of `ACTIONS` and of `OBSERVATIONS`.
    count, threads : int
        The number N of plates, and the maximum number of parallel threads.

    Attributes
    ----------
    dropped : (N,)
        Number of parts that have left each plate unintentionally.
    to_go, first : (N,)
        `to_go` is the remaining distance of the parts, see `Score.to_go`. `first` is the initial
        distance by which rewards are divided [m].
    done : (N,) bool
        Whether the task is done.
    met_since : (N,)
        Time since which the requirements of the task are fulfilled [s]. NaN if they are not
        fulfilled now.
    limit_share : (N,)
        Fraction of the rig's limits that the last action uses. The largest fraction of any limit
        counts.
    scaled : (N,) bool
        Whether the last action was scaled down to the limits.

    Raises
    ------
    PlateError
        If a key is unknown.
    """

    def __init__(
        self, task: str, world: str, action: str, observation: str, count: int = 1, threads: int = 1
    ) -> None:
        chosen("action", action, dict.fromkeys(ACTIONS))
        chosen("observation", observation, dict.fromkeys(OBSERVATIONS))
        if observation == "image" and action not in ("motion", "cycle"):
            raise PlateError(
                f"action is {action!r} with images, allowed: motion, cycle (other actions require "
                "the parts' ids)"
            )
        self.world = chosen("world", world, WORLDS)
        self.scenario, self.rig = scenario_of(task)
        self.action, self.observation = action, observation
        self.evaluator = TaskEvaluator(self.scenario.task, self.rig)
        self.motions = Motions(self.rig)
        types = [self.rig.part_type(label) for label in self._labels()]
        mu, mass = (np.array([getattr(t, k) for t in types], float) for k in ("mu", "mass_kg"))
        self.friction_limit = mu * mass * self.rig.friction.gravity
        self.reach_m = np.array([t.reach_m for t in types])
        self.turned = any(t.symmetry for t in types)
        high = np.array([*(self.rig.plate.half + OUT_M), FASTEST_MPS, FASTEST_MPS, np.pi, NEVER_S])
        goals = (
            np.ones(1) if self.evaluator.feeds else np.tile(high[:2], 2 * self.evaluator.follows)
        )
        self.bounds = np.concatenate([-high[:5], [0.0], -goals]), np.append(high, goals)
        camera = self.rig.camera
        self.image_shape = (camera.height_px, camera.width_px) + (3,) * camera.colour
        self._threads = threads
        self.plates: list[Plate] = [None] * count  # type: ignore[list-item]  # until reset
        self.dropped, self.to_go, self.first = np.zeros(count, int), np.zeros(count), np.ones(count)
        self.done, self.met_since = np.zeros(count, bool), np.full(count, np.nan)
        self.limit_share, self.scaled = np.zeros(count), np.zeros(count, bool)

    def reset(self, rows: Sequence[int], seeds: Sequence[int]) -> dict[str, np.ndarray]:
        """Begin new episodes on the plates `rows`. Return the content of `Step.info`."""
        for row, seed in zip(rows, seeds, strict=True):
            self.plates[row] = Plate(self, seed)
        plates = [self.plates[row] for row in rows]
        self._update_observations(plates)
        score = self._score(plates)
        self.to_go[rows] = score.to_go
        self.first[rows] = np.maximum(score.to_go, MIN_DISTANCE_M)
        self.dropped[rows], self.done[rows], self.met_since[rows] = 0, False, np.nan
        self.limit_share[rows], self.scaled[rows] = 0.0, False
        info = self._info(rows, score)
        bare = [plate.bare for plate in plates if len(plate.bare)]
        return info | {"bare_images": np.stack(bare)} if bare else info

    def step(self, rows: Sequence[int], actions: Sequence[Any]) -> Step:
        """Simulate the running cycles of the plates `rows`, and begin the cycles that the actions
        define."""
        plates = [self.plates[row] for row in rows]
        cycles, self.limit_share[rows], self.scaled[rows] = self._cycles_for(plates, actions)
        worlds, running = [p.simulation for p in plates], [p.running for p in plates]
        Simulation.run_together(worlds, running, self._threads)
        for plate, cycle in zip(plates, cycles, strict=True):
            plate.begin(cycle)
        self._update_observations(plates)
        score = self._score(plates)
        lost = self._lost(plates) - self.dropped[rows]
        gained = (self.to_go[rows] - score.to_go) / self.first[rows]
        self.dropped[rows] += lost
        self.to_go[rows] = score.to_go
        # In feeding, a lost part does not end the episode, because the hopper adds other parts.
        failed = (self.dropped[rows] > 0) & (not self.evaluator.feeds)
        time, before = np.array([plate.time for plate in plates]), self.done[rows]
        self._mark(rows, time, score.met & ~failed)
        ended = self.done[rows] | failed | score.failed
        over = ~ended & (time >= self.scenario.time_limit_s - ROUNDING_S)
        reward = gained - lost + (self.done[rows].astype(float) - before)
        return Step(reward, ended, over, self._info(rows, score))

    def observed(self) -> np.ndarray:
        """Return the observations of all plates (N, ...), see `observation_space`."""
        if self.observation == "image":
            return np.array([plate.image for plate in self.plates])
        result = np.array([plate.seen for plate in self.plates])
        time = np.array([plate.time for plate in self.plates])
        result[..., 5] = np.minimum(time[:, None] - result[..., 5], NEVER_S)
        if self.evaluator.follows or self.evaluator.feeds:
            goals = [self.evaluator.references(p.memory, p.ids) for p in self.plates]
            result = np.concatenate([result, np.stack(goals)], axis=2)
        return np.clip(result, *self.bounds)

    def _cycles_for(
        self, plates: Sequence[Plate], actions: Sequence[Any]
    ) -> tuple[Sequence[PlateCycle], Any, Any]:
        """Convert one action per plate to cycles within the rig's limits. Return the cycles, the
        largest fraction of a limit that each cycle uses, and whether each cycle was scaled down."""
        if self.action == "motion":
            return *self.motions.cycles(np.array(actions, float)), False
        cycles, uses, scaled = zip(*self._each(Plate.cycle_for, plates, actions), strict=True)
        return cycles, uses, scaled

    def _update_observations(self, plates: Sequence[Plate]) -> None:
        """Compute the observations of plates at the start of their running cycles."""
        if self.observation == "image":
            self._each(Plate.capture, plates)
            return
        shown = [(plate, plate.sighted()) for plate in plates]
        captured = [(plate, parts) for plate, parts in shown if parts is not None]
        if not captured:
            return
        visible = zip(*(parts for _, parts in captured), strict=True)
        position, angle, is_seen = map(np.array, visible)
        noise = np.empty((*angle.shape, 3))
        for (plate, _), row in zip(captured, noise, strict=True):
            plate.noise.standard_normal(out=row)
        time = np.array([plate.time for plate, _ in captured])[:, None, None]
        before = np.array([plate.seen for plate, _ in captured])
        now = np.empty_like(before)
        now[..., :2] = position + CENTRE_NOISE_M * noise[..., :2]
        now[..., 2:4] = (now[..., :2] - before[..., :2]) / (time - before[..., 5:])
        angle = angle + ANGLE_NOISE * noise[..., 2]
        now[..., 4] = (angle + np.pi) % (2 * np.pi) - np.pi
        now[..., 5:] = time
        now = np.where(is_seen[..., None], now, before)
        for (plate, _), seen in zip(captured, now, strict=True):
            plate.seen = seen

    def _each(self, do: Callable[..., Any], *of: Iterable[Any]) -> list[Any]:
        """Apply the function `do` to each plate, in parallel threads. The threads end before this
        method returns, because a forked process would not contain them."""
        if self._threads < 2:
            return list(map(do, *of))
        with ThreadPoolExecutor(self._threads) as pool:
            return list(pool.map(do, *of))

    def _mark(self, rows: Sequence[int], time: np.ndarray, met: np.ndarray) -> None:
        """Record whether the requirements of the tasks are fulfilled, `met` (n,), at the times
        `time` (n,) [s]. A task is done when its requirements have been fulfilled for `hold_s`."""
        since = self.met_since[rows]
        since = np.where(met, np.where(np.isnan(since), time, since), np.nan)
        held = time - since >= self.evaluator.hold_s - ROUNDING_S
        self.met_since[rows], self.done[rows] = since, np.where(met, held, self.done[rows])

    def _lost(self, plates: Sequence[Plate]) -> np.ndarray:
        """Return the number of parts (n,) that have left each plate unintentionally."""
        memories = [plate.memory for plate in plates]
        if self.evaluator.feeds:
            return np.array(
                [memory.made.lost for memory in memories if isinstance(memory, Feeding)]
            )
        on_plate = np.array([plate.simulation.state.on_plate for plate in plates])
        return np.count_nonzero(~on_plate, axis=1)

    def _labels(self) -> tuple[str, ...]:
        """Return the classes of the parts by row (M,). In a feed task, all rows have the same
        class."""
        task = self.scenario.task
        if isinstance(task, FeedTask):
            return (task.picks[0].label,) * rows_of(task)
        return self.scenario.labels

    def _score(self, plates: Sequence[Plate]) -> Score:
        return self.evaluator.score(
            [p.memory for p in plates], [p.simulation.state for p in plates]
        )

    def _info(self, rows: Sequence[int], score: Score) -> dict[str, np.ndarray]:
        plates = [self.plates[row] for row in rows]
        info = {
            "error_m": score.error_m,
            "turn_error": score.turn_error,
            "there": score.there.sum(axis=1),
            "time_s": np.array([p.time for p in plates]),
            "dropped": self.dropped[rows],
            "success": self.done[rows],
            "limit_share": self.limit_share[rows],
            "scaled": self.scaled[rows],
        }
        if not self.evaluator.feeds:
            info["to_go_m"] = score.to_go
        infos = [self.evaluator.agent_info(p.memory) for p in plates]
        info |= {name: np.array([plate_info[name] for plate_info in infos]) for name in infos[0]}
        if self.action == "cycle":
            running = np.empty(len(plates), object)
            running[:] = [p.running for p in plates]
            info["running"] = running
        return info
