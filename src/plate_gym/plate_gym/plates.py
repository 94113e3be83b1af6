"""Plates with a task on each: what a cycle does to their parts, what is seen of these, and what is
counted. Environments of one plate and of many are views of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from plate_core import AngleTargets, Parts, PlateCycle, PlateError, Targets, Wanted
from plate_driver.setpoints import prepare
from plate_sim.plate import Playback, next_playback
from plate_sim.world import Simulation
from plate_solver import Controller

from .judge import Judge, Memory, Score
from .motions import Motions
from .tasks import WORLDS, chosen, scenario_of

ACTIONS = ("motion", "forces", "progress", "cycle")
OBSERVATIONS = ("parts", "image")

CENTRE_NOISE_M, ANGLE_NOISE = 3e-5, 3.5e-3
"""Standard deviation of places [m] and angles [rad] in `parts`: what our vision has in images with
noise (sort_10 and align_6, 30 images each)."""

HOLD_CYCLES, IDLE_S = 2, 0.1
"""As the simulator node's."""

BARE_IMAGES = 5
"""Of the bare plate, for who has to know it: rigs with types of parts."""

GAP = 0.5
"""Least distance of the rims of two parts on their way, in `progress` [part radii]."""

OUT_M, FASTEST_MPS, NEVER_S = 0.05, 2.0, 1000.0
"""Bounds of `parts`: how far beyond the plate's edges [m], how fast [m/s], and how long ago a part
was seen that never was [s]."""

LEAST_WAY_M = 0.01
"""A task with less of a way counts as one with so much, in rewards [m]."""

SEEDS = 2**31
"""Of worlds where none is given, and of solvers: below this."""

ROUNDING_S = 1e-6
"""Sums of periods that differ by less are the same [s]."""


def clocks() -> np.ndarray:
    """Return the time of this process's work, and that of the wall [s]."""
    return np.array([time.process_time(), time.perf_counter()])


class Step(NamedTuple):
    """What a cycle has brought on N plates.

    Attributes
    ----------
    reward : (N,)
        The way made good, as a share of the way at the start; 1 more if the task is done, 1 less
        for each part that has left the plate.
    ended, over : (N,) bool
        Whether the task is done or a part is lost; whether time is up.
    info : dict of arrays (N, ...)
        What judges; docs/guide/gym.md says what is in it.
    """

    reward: np.ndarray
    ended: np.ndarray
    over: np.ndarray
    info: dict[str, np.ndarray]


class Plate:
    """One plate, from one `reset` to the next."""

    def __init__(self, shared: Plates, seed: int) -> None:
        self._shared = shared
        world = shared.world
        self.simulation = Simulation(
            shared.rig, shared.scenario, seed, world.disturbances, mu_scale=world.mu_scale
        )
        self.noise = np.random.default_rng((seed, 1))
        self._seed = seed
        self.time = 0.0
        self.memory: Memory = shared.judge.begin(self.simulation.state, IDLE_S)
        self.met_since: float | None = None
        self.done = False
        self.dropped, self.to_go_m, self.first_m = 0, 0.0, 0.0
        self.limit_share, self.scaled = 0.0, False
        self.solving_s = np.zeros(2)  # our solver, in all: see `clocks`
        self.image = np.zeros(shared.image_shape, np.uint8)
        self.bare = np.zeros(0)
        self._playback = Playback(PlateCycle.rest(IDLE_S), resting=True)
        # x, y, drift along x and y, angle, time: as the parts were seen last
        self.seen = np.zeros((len(self.simulation.state.ids), 6))
        self.seen[:, 5] = -np.inf
        if shared.observation == "image" and shared.rig.types:
            bare = [self.simulation.capture_bare() for _ in range(BARE_IMAGES)]
            self.bare = np.stack(bare)

    @property
    def running(self) -> PlateCycle:
        """The cycle that runs now: it began when the parts were as they are seen."""
        return self._playback.cycle

    @cached_property
    def controller(self) -> Controller:
        """Our solver, for levels of action that need one."""
        return Controller(self._shared.rig, seed=self._seed % SEEDS)

    def begin(self, cycle: PlateCycle) -> None:
        """Take in that the cycle that ran has ended, and begin the next."""
        self.time += self._playback.cycle.period
        if self._shared.action == "motion":  # from rest to rest
            self._playback = Playback(cycle)
        else:
            self._playback = next_playback(self._playback, cycle, HOLD_CYCLES, IDLE_S)
        state, period = self.simulation.state, self.running.period
        self.memory = self._shared.judge.look(self.memory, state, self.time, period)

    def capture(self) -> None:
        """Take in the image of the start of the cycle that runs."""
        image = self.simulation.capture()
        self.image = self.image if image is None else image  # a missed one changes nothing

    def answer(self, action: Any) -> PlateCycle:
        """Return the cycle of an action, within the limits; not of `motion`."""
        level = self._shared.action
        if level != "cycle":
            make = self._forces if level == "forces" else self._progress
            began = clocks()
            action = self.controller.answer(make(np.asarray(action, float)), self.running).cycle
            self.solving_s += clocks() - began
        stamp = round(self.time * 1e9)
        table, fitted = prepare(self._shared.rig, action, stamp, before=self.running)
        self.limit_share, self.scaled = fitted.usage.overall, fitted.factor < 1
        return table.cycle

    def _parts(self) -> Parts:
        """The parts as they were seen last."""
        seen = self.seen
        return Parts.make(self.simulation.state.ids, seen[:, :2], seen[:, 2:4], seen[:, 4])

    def _forces(self, action: np.ndarray) -> Wanted:
        """Return what (M, 2), in mu m g, asks for."""
        return Wanted.make(self._parts(), action * self._shared.friction_limit[:, None])

    def _progress(self, action: np.ndarray) -> Wanted:
        """Return what places, weights, and angles with their weights, (M, 3) or (M, 5), ask for."""
        rig, angle = self._shared.rig, self.seen[:, 4]
        place, weight = action[:, :2] * rig.plate.half, np.repeat(np.abs(action[:, 2:3]), 2, axis=1)
        angles = None
        if action.shape[1] == 5:
            goal = angle + (np.pi * action[:, 3] - angle + np.pi) % (2 * np.pi) - np.pi
            angles = AngleTargets(goal, goal, np.abs(action[:, 4]) * self._shared.reach_m)
        gap = GAP * rig.parts.radius_m
        return Wanted.make(self._parts(), targets=Targets(place, place, weight, gap, angles))


class Plates:
    """What N plates of one task share, and the plates.

    Parameters
    ----------
    task, world, action, observation : str
        Keys of `TASKS` and `WORLDS`, and of `ACTIONS` and `OBSERVATIONS`.
    count, threads : int
        N, and how many cores may work at the same time.

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
                f"action is {action!r} with images, allowed: motion, cycle (the others are of "
                "parts that are known by name)"
            )
        self.world = chosen("world", world, WORLDS)
        self.scenario, self.rig = scenario_of(task)
        self.action, self.observation = action, observation
        self.judge, self.motions = Judge(self.scenario.task, self.rig), Motions(self.rig)
        types = [self.rig.part_type(label) for label in self.scenario.labels]
        mu, mass = (np.array([getattr(t, k) for t in types], float) for k in ("mu", "mass_kg"))
        self.friction_limit = mu * mass * self.rig.friction.gravity
        self.reach_m = np.array([t.reach_m for t in types])
        self.turned = any(t.symmetry for t in types)
        high = np.array([*(self.rig.plate.half + OUT_M), FASTEST_MPS, FASTEST_MPS, np.pi, NEVER_S])
        goals = np.tile(high[:2], 2 * self.judge.follows)
        self.bounds = np.concatenate([-high[:5], [0.0], -goals]), np.append(high, goals)
        camera = self.rig.camera
        self.image_shape = (camera.height_px, camera.width_px) + (3,) * camera.colour
        self._threads = threads
        self.plates: list[Plate] = [None] * count  # type: ignore[list-item]  # until reset

    def reset(self, rows: Sequence[int], seeds: Sequence[int]) -> dict[str, np.ndarray]:
        """Begin anew on some plates; returns what `Step.info` has."""
        for row, seed in zip(rows, seeds, strict=True):
            self.plates[row] = Plate(self, seed)
        self._look([self.plates[row] for row in rows])
        score = self._score(rows)
        for row, to_go in zip(rows, score.to_go_m, strict=True):
            plate = self.plates[row]
            plate.to_go_m, plate.first_m = to_go, max(to_go, LEAST_WAY_M)
        info = self._info(rows, score)
        bare = [plate.bare for row in rows if len((plate := self.plates[row]).bare)]
        return info | {"bare_images": np.stack(bare)} if bare else info

    def step(self, rows: Sequence[int], actions: Sequence[Any]) -> Step:
        """Let a cycle pass on some plates."""
        plates = [self.plates[row] for row in rows]
        answers = self._answers(plates, actions)
        worlds, running = [p.simulation for p in plates], [p.running for p in plates]
        Simulation.run_together(worlds, running, self._threads)
        for plate, cycle in zip(plates, answers, strict=True):
            plate.begin(cycle)
        self._look(plates)
        score = self._score(rows)
        count = len(plates)
        reward, ended, over = np.zeros(count), np.zeros(count, bool), np.zeros(count, bool)
        for k, plate in enumerate(plates):
            lost = plate.simulation.state.dropped - plate.dropped
            gained = (plate.to_go_m - score.to_go_m[k]) / plate.first_m
            plate.dropped, plate.to_go_m = plate.dropped + lost, score.to_go_m[k]
            before = plate.done
            self._mark(plate, bool(score.met[k]))
            failed = plate.dropped > 0 or score.failed[k]
            reward[k], ended[k] = gained - lost + (plate.done - before), plate.done or failed
            over[k] = not ended[k] and plate.time >= self.scenario.time_limit_s - ROUNDING_S
        return Step(reward, ended, over, self._info(rows, score))

    def observed(self) -> np.ndarray:
        """Return what is seen of each plate (N, ...): see `observation_space`."""
        if self.observation == "image":
            return np.array([plate.image for plate in self.plates])
        result = np.array([plate.seen for plate in self.plates])
        time = np.array([plate.time for plate in self.plates])
        result[..., 5] = np.minimum(time[:, None] - result[..., 5], NEVER_S)
        goals = [self.judge.references(p.memory, p.simulation.state.ids) for p in self.plates]
        return np.clip(np.concatenate([result, np.stack(goals)], axis=2), *self.bounds)

    def _answers(self, plates: Sequence[Plate], actions: Sequence[Any]) -> list[PlateCycle]:
        """Return the cycles of actions, within the limits."""
        if self.action != "motion":
            return self._each(Plate.answer, plates, actions)
        cycles, shares = self.motions.cycles(np.array(actions, float))
        for plate, share in zip(plates, shares, strict=True):
            plate.limit_share = share
        return cycles

    def _look(self, plates: Sequence[Plate]) -> None:
        """Take in what is seen at the start of the cycles that run."""
        if self.observation == "image":
            self._each(Plate.capture, plates)
            return
        shown = [(plate, plate.simulation.sight()) for plate in plates]
        looked = [(plate, sight) for plate, sight in shown if sight is not None]
        if not looked:
            return
        there = [sight.seen & plate.simulation.state.on_plate for plate, sight in looked]
        noise = np.array([p.noise.standard_normal((len(p.seen), 3)) for p, _ in looked])
        time = np.array([plate.time for plate, _ in looked])[:, None, None]
        before = np.array([plate.seen for plate, _ in looked])
        now = np.empty_like(before)
        now[..., :2] = np.array([sight.position for _, sight in looked])
        now[..., :2] += CENTRE_NOISE_M * noise[..., :2]
        now[..., 2:4] = (now[..., :2] - before[..., :2]) / (time - before[..., 5:])
        angle = np.array([sight.angle for _, sight in looked]) + ANGLE_NOISE * noise[..., 2]
        now[..., 4] = (angle + np.pi) % (2 * np.pi) - np.pi
        now[..., 5:] = time
        now = np.where(np.array(there)[..., None], now, before)
        for (plate, _), seen in zip(looked, now, strict=True):
            plate.seen = seen

    def _each(self, do: Callable[..., Any], *of: Iterable[Any]) -> list[Any]:
        """`map`, on all cores: on threads that end with it, as a forked process has none."""
        if self._threads < 2:
            return list(map(do, *of))
        with ThreadPoolExecutor(self._threads) as pool:
            return list(pool.map(do, *of))

    def _mark(self, plate: Plate, met: bool) -> None:
        """Take in whether all is as asked: the task is done when it has been so long enough."""
        if not met or plate.dropped:
            plate.met_since = None
            return
        plate.met_since = plate.time if plate.met_since is None else plate.met_since
        plate.done = plate.time - plate.met_since >= self.judge.hold_s - ROUNDING_S

    def _score(self, rows: Sequence[int]) -> Score:
        plates = [self.plates[row] for row in rows]
        return self.judge.score([p.memory for p in plates], [p.simulation.state for p in plates])

    def _info(self, rows: Sequence[int], score: Score) -> dict[str, np.ndarray]:
        plates = [self.plates[row] for row in rows]
        info = {
            "error_m": score.error_m,
            "turn_error": score.turn_error,
            "there": score.there.sum(axis=1),
            "to_go_m": score.to_go_m,
            "time_s": np.array([p.time for p in plates]),
            "dropped": np.array([p.dropped for p in plates]),
            "success": np.array([p.done for p in plates]),
            "limit_share": np.array([p.limit_share for p in plates]),
            "scaled": np.array([p.scaled for p in plates]),
        }
        told = [self.judge.told(p.memory) for p in plates]
        info |= {name: np.array([each[name] for each in told]) for name in told[0]}
        if self.action == "cycle":
            running = np.empty(len(plates), object)
            running[:] = [p.running for p in plates]
            info["running"] = running
        return info
