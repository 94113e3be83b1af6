"""Plates with one task each: simulation of cycles, observations and rewards. The environment of one
plate and the environment of many plates use this module."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from plate_core import AngleTargets, Parts, PlateCycle, PlateError, Targets, Wanted
from plate_core.motion import IDLE_S, Timeline
from plate_core.tasks import FeedTask
from plate_driver.setpoints import prepare
from plate_sim.world import Simulation
from plate_solver import Controller
from plate_vision.bare_plate import BARE_IMAGES

from .judge import ROUNDING_S, Feeding, Judge, Memory, Score, rows_of
from .motions import Motions
from .tasks import WORLDS, chosen, scenario_of

ACTIONS = ("motion", "forces", "progress", "cycle")
OBSERVATIONS = ("parts", "image")

CENTRE_NOISE_M = 3e-5
"""Standard deviation of the positions in `parts` [m]. This noise was measured for this project's
vision in noisy images (sort_10 and align_6, 30 images each)."""

ANGLE_NOISE = 3.5e-3
"""Standard deviation of the angles in `parts` [rad]. This noise was measured for this project's
vision in noisy images (sort_10 and align_6, 30 images each)."""

REST = PlateCycle.rest(IDLE_S)
"""Cycle at rest that all plates share. If each plate had a cycle object of its own, the `info` of
equal seeds would not be equal."""

GAP = 0.5
"""Minimum distance between the edges of two moving parts in the action `progress` [part radii]."""

OUT_M = 0.05
"""Maximum distance of a part beyond the plate's edges in `parts` [m]."""

FASTEST_MPS = 2.0
"""Maximum speed in `parts` [m/s]."""

NEVER_S = 1000.0
"""Time since the last detection in `parts`, if the part was never detected [s]."""

UNSEEN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -np.inf])
"""Row of a part that was never seen."""

MIN_DISTANCE_M = 0.01
"""Minimum of the initial distance when rewards are normalised [m]."""

SEEDS = 2**31
"""Upper bound of random seeds, including the seeds of the solver."""


def clocks() -> np.ndarray:
    """Return the processor time of this process, and the elapsed time [s]."""
    return np.array([time.process_time(), time.perf_counter()])


class Step(NamedTuple):
    """Result of a cycle on N plates.

    Attributes
    ----------
    reward : (N,)
        Reward. The reward is the reduction of the remaining distance as a fraction of the initial
        distance or, for feeding, the picked parts as a fraction of the maximum. 1 is added if the
        task is done, and 1 is subtracted for each lost part.
    ended, over : (N,) bool
        Whether the task is done or a part is lost. Whether the time is over.
    info : dict of arrays (N, ...)
        Details of the evaluation; see docs/guide/gym.md.
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
        self.solving_s = np.zeros(2)  # total time of this project's solver, see `clocks`
        self.image = np.zeros(shared.image_shape, np.uint8)
        self.bare = np.zeros(0)
        self.timeline = Timeline(REST, filling=True)
        self.memory: Memory = shared.judge.begin(self.simulation, self.running)
        # Last observation of each part: x, y, drift along x and y, angle, time.
        self.seen = np.tile(UNSEEN, (len(self.ids), 1))
        if shared.observation == "image" and shared.rig.types:
            bare = [self.simulation.capture_bare() for _ in range(BARE_IMAGES)]
            self.bare = np.stack(bare)

    @property
    def running(self) -> PlateCycle:
        """The running cycle. The cycle began at the time of the last observation."""
        return self.timeline.cycle

    @property
    def time(self) -> float:
        """Start of the running cycle, as time since the reset [s]."""
        return self.timeline.begin

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the parts by row. Empty if there is no part."""
        memory = self.memory
        return tuple(memory.ids) if isinstance(memory, Feeding) else self.simulation.state.ids

    @cached_property
    def controller(self) -> Controller:
        """This project's solver. The solver is used for actions that need it."""
        return Controller(self._shared.rig, seed=self._seed % SEEDS)

    def begin(self, cycle: PlateCycle) -> None:
        """End the running cycle, and begin the next one."""
        if isinstance(self.memory, Feeding) and self.memory.rests:
            cycle = REST
        if self._shared.action == "motion":  # motions of this action go from rest to rest
            self.timeline = Timeline(cycle, self.timeline.end)
        else:
            self.timeline = self.timeline.send(cycle).next()
        if self.memory is None:
            return
        ids, judge = self.ids, self._shared.judge
        self.memory = judge.update(self.memory, self.simulation, self.time, self.running)
        if judge.feeds:
            other = np.array([now != before for now, before in zip(self.ids, ids, strict=True)])
            self.seen = np.where(other[:, None], UNSEEN, self.seen)

    def capture(self) -> None:
        """Take the image at the start of the running cycle."""
        image = self.simulation.capture()
        self.image = self.image if image is None else image  # a missed image changes nothing

    def sighted(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return the positions (M, 2) [m] and angles (M,) [rad] of the parts in an image, and
        whether the image shows each part (M,). The arrays are ordered by row. Return None if the
        image is missed."""
        sight, state = self.simulation.sight(), self.simulation.state
        if sight is None:
            return None
        there = sight.seen & state.on_plate
        if not self._shared.judge.feeds:
            return sight.position, sight.angle, there
        rows = np.array([state.ids.index(name) if name else -1 for name in self.ids])
        return (  # an empty row takes the last entry
            np.append(sight.position, [[0.0, 0.0]], axis=0)[rows],
            np.append(sight.angle, 0.0)[rows],
            np.append(there, False)[rows],
        )

    def answer(self, action: Any) -> tuple[PlateCycle, float, bool]:
        """Return the cycle of an action, within the limits. Also return the maximum fraction of any
        limit that it uses, and whether it was scaled down. The action must not be `motion`."""
        level = self._shared.action
        if level != "cycle":
            make = self._forces if level == "forces" else self._progress
            began = clocks()
            wanted = make(np.asarray(action, float)[self._rows])
            action = self.controller.answer(wanted, self.running).cycle
            self.solving_s += clocks() - began
        stamp = round(self.time * 1e9)
        table, fitted = prepare(self._shared.rig, action, stamp, before=(self.running,))
        return table.cycle, fitted.usage.overall, fitted.factor < 1

    @property
    def _rows(self) -> np.ndarray:
        """Indices (n,) of the rows to which actions apply. The rows are all rows or, if parts come
        and go, the rows of parts that were detected."""
        return np.flatnonzero(np.isfinite(self.seen[:, 5]) | (not self._shared.judge.feeds))

    def _parts(self) -> Parts:
        """The parts of the last observation."""
        ids, seen = tuple(self.ids[row] for row in self._rows), self.seen[self._rows]
        return Parts.make(ids, seen[:, :2], seen[:, 2:4], seen[:, 4])

    def _forces(self, action: np.ndarray) -> Wanted:
        """Return the request for mean forces (n, 2) [mu m g]."""
        return Wanted.make(self._parts(), action * self._shared.friction_limit[self._rows, None])

    def _progress(self, action: np.ndarray) -> Wanted:
        """Return the request for places and weights. An action is (n, 3), or (n, 5) with angles and
        their weights."""
        rig, angle = self._shared.rig, self.seen[self._rows, 4]
        place, weight = action[:, :2] * rig.plate.half, np.repeat(np.abs(action[:, 2:3]), 2, axis=1)
        angles = None
        if action.shape[1] == 5:
            goal = angle + (np.pi * action[:, 3] - angle + np.pi) % (2 * np.pi) - np.pi
            reach = self._shared.reach_m[self._rows]
            angles = AngleTargets(goal, goal, np.abs(action[:, 4]) * reach)
        gap = GAP * rig.parts.radius_m
        return Wanted.make(self._parts(), targets=Targets(place, place, weight, gap, angles))


class Plates:
    """N plates of one task, and the data that they share.

    Parameters
    ----------
    task, world, action, observation : str
        Keys of `TASKS`, of `WORLDS`, of `ACTIONS` and of `OBSERVATIONS`.
    count, threads : int
        Number N of plates, and maximum number of parallel threads.

    Attributes
    ----------
    dropped : (N,)
        Number of parts that have left each plate unintentionally.
    to_go, first : (N,)
        Remaining distance, and initial distance for the rewards [m]; see `Score.to_go`.
    done : (N,) bool
        Whether the task is done.
    met_since : (N,)
        Time since which the task is fulfilled [s]. NaN if it is not fulfilled.
    limit_share : (N,)
        Maximum fraction of any limit that the last action uses.
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
        self.judge, self.motions = Judge(self.scenario.task, self.rig), Motions(self.rig)
        types = [self.rig.part_type(label) for label in self._labels()]
        mu, mass = (np.array([getattr(t, k) for t in types], float) for k in ("mu", "mass_kg"))
        self.friction_limit = mu * mass * self.rig.friction.gravity
        self.reach_m = np.array([t.reach_m for t in types])
        self.turned = any(t.symmetry for t in types)
        high = np.array([*(self.rig.plate.half + OUT_M), FASTEST_MPS, FASTEST_MPS, np.pi, NEVER_S])
        goals = np.ones(1) if self.judge.feeds else np.tile(high[:2], 2 * self.judge.follows)
        self.bounds = np.concatenate([-high[:5], [0.0], -goals]), np.append(high, goals)
        camera = self.rig.camera
        self.image_shape = (camera.height_px, camera.width_px) + (3,) * camera.colour
        self._threads = threads
        self.plates: list[Plate] = [None] * count  # type: ignore[list-item]  # until reset
        self.dropped, self.to_go, self.first = np.zeros(count, int), np.zeros(count), np.ones(count)
        self.done, self.met_since = np.zeros(count, bool), np.full(count, np.nan)
        self.limit_share, self.scaled = np.zeros(count), np.zeros(count, bool)

    def reset(self, rows: Sequence[int], seeds: Sequence[int]) -> dict[str, np.ndarray]:
        """Begin new episodes on some plates. Return the content of `Step.info`."""
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
        """Run a cycle on some plates."""
        plates = [self.plates[row] for row in rows]
        answers, self.limit_share[rows], self.scaled[rows] = self._answers(plates, actions)
        worlds, running = [p.simulation for p in plates], [p.running for p in plates]
        Simulation.run_together(worlds, running, self._threads)
        for plate, cycle in zip(plates, answers, strict=True):
            plate.begin(cycle)
        self._update_observations(plates)
        score = self._score(plates)
        lost = self._lost(plates) - self.dropped[rows]
        gained = (self.to_go[rows] - score.to_go) / self.first[rows]
        self.dropped[rows] += lost
        self.to_go[rows] = score.to_go
        # In feeding, a lost part does not end the episode, because the hopper adds other parts.
        spoilt = (self.dropped[rows] > 0) & (not self.judge.feeds)
        time, before = np.array([plate.time for plate in plates]), self.done[rows]
        self._mark(rows, time, score.met & ~spoilt)
        ended = self.done[rows] | spoilt | score.failed
        over = ~ended & (time >= self.scenario.time_limit_s - ROUNDING_S)
        reward = gained - lost + (self.done[rows].astype(float) - before)
        return Step(reward, ended, over, self._info(rows, score))

    def observed(self) -> np.ndarray:
        """Return the observation of each plate (N, ...), see `observation_space`."""
        if self.observation == "image":
            return np.array([plate.image for plate in self.plates])
        result = np.array([plate.seen for plate in self.plates])
        time = np.array([plate.time for plate in self.plates])
        result[..., 5] = np.minimum(time[:, None] - result[..., 5], NEVER_S)
        if self.judge.follows or self.judge.feeds:
            goals = [self.judge.references(p.memory, p.ids) for p in self.plates]
            result = np.concatenate([result, np.stack(goals)], axis=2)
        return np.clip(result, *self.bounds)

    def _answers(
        self, plates: Sequence[Plate], actions: Sequence[Any]
    ) -> tuple[Sequence[PlateCycle], Any, Any]:
        """Return the cycles for actions, within the limits. Also return the maximum fraction of any
        limit that each cycle uses, and whether each was scaled down."""
        if self.action == "motion":
            return *self.motions.cycles(np.array(actions, float)), False
        cycles, shares, scaled = zip(*self._each(Plate.answer, plates, actions), strict=True)
        return cycles, shares, scaled

    def _update_observations(self, plates: Sequence[Plate]) -> None:
        """Make the observations at the start of the running cycles."""
        if self.observation == "image":
            self._each(Plate.capture, plates)
            return
        shown = [(plate, plate.sighted()) for plate in plates]
        captured = [(plate, sight) for plate, sight in shown if sight is not None]
        if not captured:
            return
        sights = zip(*(sight for _, sight in captured), strict=True)
        position, angle, there = map(np.array, sights)
        noise = np.array([p.noise.standard_normal((len(p.seen), 3)) for p, _ in captured])
        time = np.array([plate.time for plate, _ in captured])[:, None, None]
        before = np.array([plate.seen for plate, _ in captured])
        now = np.empty_like(before)
        now[..., :2] = position + CENTRE_NOISE_M * noise[..., :2]
        now[..., 2:4] = (now[..., :2] - before[..., :2]) / (time - before[..., 5:])
        angle = angle + ANGLE_NOISE * noise[..., 2]
        now[..., 4] = (angle + np.pi) % (2 * np.pi) - np.pi
        now[..., 5:] = time
        now = np.where(there[..., None], now, before)
        for (plate, _), seen in zip(captured, now, strict=True):
            plate.seen = seen

    def _each(self, do: Callable[..., Any], *of: Iterable[Any]) -> list[Any]:
        """`map` on all cores. The threads end with the call, because a forked process would not
        contain them."""
        if self._threads < 2:
            return list(map(do, *of))
        with ThreadPoolExecutor(self._threads) as pool:
            return list(pool.map(do, *of))

    def _mark(self, rows: Sequence[int], time: np.ndarray, met: np.ndarray) -> None:
        """Record whether the tasks are fulfilled (n,) at times (n,) [s]. A task is done when it has
        been fulfilled for `hold_s`."""
        since = self.met_since[rows]
        since = np.where(met, np.where(np.isnan(since), time, since), np.nan)
        held = time - since >= self.judge.hold_s - ROUNDING_S
        self.met_since[rows], self.done[rows] = since, np.where(met, held, self.done[rows])

    def _lost(self, plates: Sequence[Plate]) -> np.ndarray:
        """Return the number of parts (n,) that have left each plate unintentionally."""
        memories = [plate.memory for plate in plates]
        if self.judge.feeds:
            return np.array(
                [memory.made.lost for memory in memories if isinstance(memory, Feeding)]
            )
        there = np.array([plate.simulation.state.on_plate for plate in plates])
        return np.count_nonzero(~there, axis=1)

    def _labels(self) -> tuple[str, ...]:
        """Return the classes of the parts (M,) by row. If parts come and go, all rows have one
        class."""
        task = self.scenario.task
        if isinstance(task, FeedTask):
            return (task.picks[0].label,) * rows_of(task)
        return self.scenario.labels

    def _score(self, plates: Sequence[Plate]) -> Score:
        return self.judge.score([p.memory for p in plates], [p.simulation.state for p in plates])

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
        if not self.judge.feeds:
            info["to_go_m"] = score.to_go
        infos = [self.judge.agent_info(p.memory) for p in plates]
        info |= {name: np.array([each[name] for each in infos]) for name in infos[0]}
        if self.action == "cycle":
            running = np.empty(len(plates), object)
            running[:] = [p.running for p in plates]
            info["running"] = running
        return info
