"""The closed loop without ROS. The loop runs the same cores as the nodes, in one process.

As in the graph, image k is taken at the start of cycle k. The cycle that is computed from this
image is executed as cycle k + 1. A free-running camera takes images at any time. The loop then
computes each cycle shortly before the present cycle ends. If no new cycle arrives, the plate
repeats the present one. An argument selects the transport of cycles to the plate: immediate
(`Direct`), or over a serial line (`SerialLine` of `bench/harness/serial.py`).
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from time import process_time as cpu_time
from typing import Any, Protocol

import numpy as np

from plate_core import (
    Parts,
    PlateCycle,
    PlateError,
    Rig,
    Wanted,
    did_you_mean,
    load_rig,
)
from plate_core.files import check_file
from plate_core.motion import Timeline
from plate_core.rig import MAX_HEIGHT_M
from plate_core.tasks import (
    AssembleTask,
    FeedOrder,
    FeedTask,
    FollowTask,
    MoveTask,
    PartTarget,
    PoseTask,
    Scenario,
    SortTask,
    Task,
    load_scenario,
)
from plate_driver.setpoints import MotorTable, prepare
from plate_planner import (
    FollowOptions,
    Planner,
    PlannerOptions,
    PlannerState,
    Progress,
)
from plate_planner.tasks import (
    SIGHT_M,
    SIGHT_RAD,
    Assembler,
    FeedReport,
    Follower,
    Poser,
    Sorter,
)
from plate_sim.camera import NOISE
from plate_sim.plate import PlateMotion
from plate_sim.world import NONE, WORLD_RANGES, Disturbances, Shot, Simulation, WorldState
from plate_solver import METHODS, Answer, Controller
from plate_vision import Prediction, Tracker, make_vision, observe
from plate_vision.bare_plate import BARE_IMAGES, BarePlate, know_plate

from .views import view_from, with_height

__all__ = [
    "ALIKE", "Cell", "Direct", "Moment", "Scene", "Setup",
    "Transport", "as_asked", "load_planner", "predicted", "run", "seen_by", "summary",
    "with_settings",
]  # fmt: skip

ALIKE = {
    "OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}  # fmt: skip
"""Environment variables for reproducible runs. With them, the run of a seed is identical to the
last bit on every processor with AVX2 and FMA. Libraries read these variables when they are
loaded."""

EFFORT = ("iterations", "restarts")
"""Options of the solvers. Larger values improve the result and increase the computing time."""

MOMENT_S = 1e-6
"""Minimum time between two events [s]."""

CAMERA = ("exposure_s", "readout_s")
"""Data of the rig's camera that settings can replace."""

VIEW = ("tilt_deg", "towards_deg", "focal_px", "distance_m")
"""Arguments of `view_from` that are settings. The settings have the prefix `camera_`."""

PLANNER_BYTES = 1_000_000
"""Maximum size of a planner's Python file [bytes]."""

NUMBERS = {
    **WORLD_RANGES, "image_age_s": (0.0, 1.0), "exposure_s": (0.0, 0.1), "readout_s": (0.0, 0.1),
    "camera_tilt_deg": (0.0, 60.0), "camera_towards_deg": (-360.0, 360.0),
    "camera_focal_px": (50.0, 20000.0), "camera_distance_m": (0.0, 100.0),
    "rig_height_m": (0.0, MAX_HEIGHT_M),
}  # fmt: skip
"""Numeric settings, and their allowed ranges."""


@dataclass(frozen=True)
class Setup:
    """Settings of one run: task, method and simulated world.

    Attributes
    ----------
    scenario : str or Scenario
        Scenario, or the name or path of a scenario.
    seed : int
        Random seed of the start positions, the image noise and the solver's restarts.
    method : str
        A key of `METHODS`.
    noise : float
        Standard deviation of the image noise [grey levels].
    mu_scale : float
        Ratio of the true friction to the friction in the rig [-].
    disturbances : Disturbances
        Disturbances of the simulated world.
    planner : PlannerOptions
    exposure_s, readout_s : float or None
        Values that replace the values of the rig's camera [s]. If None, the values of the rig are
        used.
    camera_tilt_deg, camera_towards_deg, camera_focal_px, camera_distance_m : float or None
        If one of them is given, `view_from` moves the camera. `view_from` uses its defaults for the
        others.
    rig_height_m : float or None
        Height of all parts in the rig model that all stages use [m]. If None, the height in the rig
        file is used.
    image_age_s : float or None
        Image latency that the planner assumes [s]. If it is None, the planner estimates the
        latency.
    effort : mapping of str to int
        Options `iterations` and `restarts` of the solver, if they differ from the defaults of
        `Controller`.
    own_planner : str
        Python file with a class `OwnPlanner`, which requests the forces. The project's planner then
        only supervises the task. The planner decides whether the task is done, stuck or has lost a
        part, and it requests rest for the image that confirms the result.
    """

    scenario: str | Scenario
    seed: int = 0
    method: str = "sinusoids"
    noise: float = NOISE
    mu_scale: float = 1.0
    disturbances: Disturbances = NONE
    planner: PlannerOptions = field(default_factory=PlannerOptions)
    exposure_s: float | None = None
    readout_s: float | None = None
    camera_tilt_deg: float | None = None
    camera_towards_deg: float | None = None
    camera_focal_px: float | None = None
    camera_distance_m: float | None = None
    rig_height_m: float | None = None
    image_age_s: float | None = None
    effort: Mapping[str, Any] = field(default_factory=dict)
    own_planner: str = ""

    @property
    def recipe(self) -> Scenario:
        """The scenario. The scenario is loaded if only its name or path is given."""
        return (
            self.scenario if isinstance(self.scenario, Scenario) else load_scenario(self.scenario)
        )


def with_settings(setup: Setup, settings: Mapping[str, str]) -> Setup:
    """Apply settings `key=value` of the command line to a setup.

    Keys are the fields of `Setup`, `Disturbances` and `FollowOptions`, and the options in `EFFORT`.

    Raises
    ------
    PlateError
        If a key is unknown, or if a value is not allowed.
    """
    follow, world = setup.planner.follow, setup.disturbances
    for key, text in settings.items():
        try:
            if key == "method":
                setup = replace(setup, method=_method(text))
            elif key in NUMBERS:
                setup = replace(setup, **{key: _number(key, float(text), *NUMBERS[key])})  # type: ignore[arg-type]
            elif key in EFFORT:
                setup = replace(setup, effort={**setup.effort, key: int(text)})
            elif key == "blur":
                world = replace(world, blur=_flag(key, text))
            elif key in {f.name for f in fields(Disturbances)}:
                world = replace(world, **{key: float(text)})  # type: ignore[arg-type]
            elif key in FollowOptions.RANGES:
                limits = FollowOptions.RANGES[key]
                follow = replace(follow, **{key: _number(key, float(text), *limits)})
            else:
                raise KeyError(key)
        except KeyError:
            known = ["method", *NUMBERS, *EFFORT]
            known += [f.name for f in fields(Disturbances)] + [*FollowOptions.RANGES]
            names = ", ".join(dict.fromkeys(known))
            hint = did_you_mean(key, known)
            raise PlateError(f"setting {key!r}{hint}, allowed: {names}") from None
        except PlateError:
            raise
        except ValueError:
            raise PlateError(f"setting {key} is {text!r}, allowed: a number") from None
    planner = replace(setup.planner, follow=follow)
    return replace(setup, disturbances=world, planner=planner)


def _number(key: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise PlateError(f"setting {key} is {value:g}, allowed: {low:g} to {high:g}")
    return value


def _flag(key: str, text: str) -> bool:
    if text not in ("true", "false"):
        raise PlateError(f"setting {key} is {text!r}, allowed: true or false")
    return text == "true"


def _method(name: str) -> str:
    if name not in METHODS:
        hint = did_you_mean(name, METHODS)
        raise PlateError(f"setting method is {name!r}{hint}, allowed: {', '.join(METHODS)}")
    return METHODS[name]


@dataclass(frozen=True)
class Moment:
    """State of the loop in one cycle, for evaluation and drawing.

    Attributes
    ----------
    time : float
        Start of the running cycle [s].
    world : WorldState
        True state of the parts at this time.
    parts : Parts
        Detected parts.
    wanted : Wanted
        Request to the solver.
    answer : Answer
        Result of the solver. The result contains the cycle that is executed next.
    progress : Progress
    image : (H, W)
        Last camera image.
    solve_s : float
        CPU time of the solver [s].
    step_s : float
        CPU time from the image to the motors' table [s].
    limit_share, force_share, heat_share : float
        Used fractions of the limits by the motors' table [-]: maximum over all limits, peak force,
        and continuous force if the table is repeated continuously.
    scaled : bool
        Whether the driver had to scale the cycle down to these limits.
    error_m : (P,)
        True distance of each detected part from its reference or target at the start of the running
        cycle [m]. Empty in a sort task.
    turn_error : (P,)
        True angle error of each part in a pose task [rad].
    held : int
        Number of times that the cycle was repeated since the last image, because no new image
        arrived.
    """

    time: float
    world: WorldState
    parts: Parts
    wanted: Wanted
    answer: Answer
    progress: Progress
    image: np.ndarray
    solve_s: float
    step_s: float
    limit_share: float
    force_share: float
    heat_share: float
    scaled: bool
    error_m: np.ndarray
    turn_error: np.ndarray
    held: int


class Transport(Protocol):
    """Transport of cycles to the plate, and motion of the plate.

    Attributes
    ----------
    now : float
        Present time [s].
    """

    now: float

    @property
    def began(self) -> float:
        """Start time of the running cycle [s]."""

    @property
    def running(self) -> PlateCycle:
        """The running cycle, or the running tail of a cycle."""

    def send(self, table: MotorTable) -> None:
        """Send the table of the next cycle."""

    def play(self, until: float) -> Sequence[PlateCycle | PlateMotion]:
        """Advance the time to the start of the next cycle, but at most to `until` [s]. Return the
        motions of the plate in this time."""


class Scene(Protocol):
    """The parts that the loop moves, and the detection of these parts."""

    @property
    def state(self) -> WorldState:
        """Present true state of the parts."""

    def shots(self, begin: float) -> Iterator[Shot]:
        """Return the images of a free-running camera from the time `begin` [s] on."""

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """Return an image (H, W) of the present, or of the time `age` [s] ago. Return None if there
        is no image."""

    def see(self, image: np.ndarray, stamp: float, expected: Prediction | None) -> Parts:
        """Return the parts detected in an image with this stamp [s]."""

    def run(self, motion: PlateCycle | PlateMotion) -> None:
        """Move the plate. The parts move with the plate."""


class Watched:
    """The parts of the simulator. Vision detects them in the images of the simulated camera."""

    def __init__(self, setup: Setup, scenario: Scenario, rig: Rig) -> None:
        self.simulation = Simulation(
            rig, scenario, setup.seed, setup.disturbances, noise=setup.noise,
            mu_scale=setup.mu_scale,
        )  # fmt: skip
        self._vision, self._tracker = make_vision(rig), Tracker()
        self._bare = BarePlate(requested=BARE_IMAGES)
        if self._vision.catalogue is not None:
            for _ in range(BARE_IMAGES):
                self._know(self.simulation.capture_bare())

    @property
    def state(self) -> WorldState:
        """See `Scene`."""
        return self.simulation.state

    def shots(self, begin: float) -> Iterator[Shot]:
        """See `Scene`."""
        return self.simulation.shots(begin)

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """See `Scene`."""
        return self.simulation.capture(age)

    def see(self, image: np.ndarray, stamp: float, expected: Prediction | None) -> Parts:
        """See `Scene`."""
        if self._vision.catalogue is not None:
            self._know(image)
        self._tracker = observe(self._vision, self._tracker, image, stamp, expected)
        return self._tracker.parts

    def run(self, motion: PlateCycle | PlateMotion) -> None:
        """See `Scene`."""
        self.simulation.run(motion)

    def _know(self, image: np.ndarray) -> None:
        self._bare, self._vision, _ = know_plate(self._bare, self._vision, image)


class Cell(Protocol):
    """The surroundings of the plate in a feed task, for example hopper and robot. The surroundings
    control the task."""

    def act(self, simulation: Simulation, now: float) -> None:
        """Perform all actions that are due at the time `now` [s]. This is done before an image is
        taken."""

    def order(self, report: FeedReport, now: float) -> FeedOrder:
        """Process the report of the last image. Return the order for the task that applies from
        `now` [s] on."""


class ControlLaw(Protocol):
    """A planner that is provided by the user. The planner is created with the rig, and called once
    per image."""

    def plan(self, parts: Parts, t: float) -> Wanted:
        """Return the requested mean force on each part. `t` is the stamp of the image [s]."""


def load_planner(path: str, rig: Rig) -> ControlLaw:
    """Load the class `OwnPlanner` from a Python file, and return an instance of it.

    Raises
    ------
    PlateError
        If the file does not exist, cannot be loaded, or has no such class.
    """
    if not Path(path).is_file():
        raise PlateError(f"planner is {path!r}, allowed: a Python file with a class OwnPlanner")
    check_file(path, PLANNER_BYTES)
    spec = importlib.util.spec_from_file_location("own_planner", path)
    if spec is None or spec.loader is None:
        raise PlateError(f"planner is {path!r}, allowed: a file whose name ends in .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (SyntaxError, ImportError) as error:
        raise PlateError(f"planner {path} cannot be loaded: {error}") from error
    if not callable(getattr(getattr(module, "OwnPlanner", None), "plan", None)):
        raise PlateError(f"planner {path} has no class OwnPlanner with a method plan")
    law: ControlLaw = module.OwnPlanner(rig)
    return law


class Direct:
    """Immediate transport to the simulator. If a cycle is sent while another one is running, it is
    executed after the running one."""

    def __init__(self) -> None:
        self.now = 0.0
        self._timeline = Timeline.at_rest()

    @property
    def running(self) -> PlateCycle:
        """The running cycle."""
        return self._timeline.cycle

    @property
    def began(self) -> float:
        """Start time of the running cycle [s]."""
        return self._timeline.begin

    def send(self, table: MotorTable) -> None:
        """Send the table of the next cycle."""
        self._timeline = self._timeline.send(table.cycle)

    def play(self, until: float) -> list[PlateCycle | PlateMotion]:
        """Advance the running cycle to its end, but at most to `until` [s]. Return the motion in
        this time."""
        played, began, end = self.running, self.began, self._timeline.end
        until = until if until < end - MOMENT_S else end
        begin, stop = self.now - began, min(until - began, played.period)
        whole = begin == 0 and stop == played.period
        self.now = min(until, end)
        if self.now == end:
            self._timeline = self._timeline.next()
        return [played if whole else PlateMotion.piece(played, begin, stop)]


def run(
    setup: Setup,
    rig: Rig | None = None,
    transport: Transport | None = None,
    drag: Callable[[float], Sequence[PartTarget]] | None = None,
    cell: Cell | None = None,
    scene: Scene | None = None,
) -> Iterator[Moment]:
    """Run the loop until the task has ended. Yield a `Moment` for each computed cycle.

    `drag` is a function of the time [s]. The function returns new targets for a running move task.
    `cell` is used in a feed task. `scene` provides the parts. By default, these are the parts of
    the simulator.
    """
    line = transport or Direct()
    scenario = setup.recipe
    rig = seen_by(setup, rig or load_rig(scenario.rig))
    scene = scene or Watched(setup, scenario, rig)
    planner = Planner(rig, scenario, replace(setup.planner, image_age_s=setup.image_age_s))
    state = planner.start(planner.initial())
    own = load_planner(setup.own_planner, rig) if setup.own_planner else None
    controller = Controller(rig, setup.method, setup.seed, **setup.effort)
    free = setup.disturbances.image_rate > 0
    shots = scene.shots(line.now)
    shot = next(shots) if free else None
    held, began, start, image, expected = -1, -np.inf, scene.state, None, None
    parts = Parts.make((), np.zeros((0, 2)))
    while True:
        world, now, at_work = scene.state, line.now, cpu_time()
        if line.began > began:  # a new cycle has started
            held, began, start = held + 1, line.began, world
            state = planner.started(state, line.running, began, not free)
        new, stamp = None, now
        if cell is not None:
            assert isinstance(scene, Watched)
            cell.act(scene.simulation, now)
            world = scene.state
        if shot is None:
            new = scene.capture()
        elif shot.delivered <= now:
            new, stamp = scene.capture(now - shot.middle), shot.stamp
            shot = next(shots)
        if new is not None:
            image, at_work = new, cpu_time()
            parts = scene.see(image, stamp, expected)
            state = planner.see(state, parts, stamp)
        due = new is not None if shot is None else state.due <= now
        if due and image is not None:
            if drag is not None and state.task.active:
                planner, state, _ = planner.retarget(state, drag(now))
            if cell is not None and state.memory is not None:
                planner = planner.order(state, cell.order(state.memory.report, now))
            state, wanted, progress = planner.answer(state)
            expected = predicted(wanted, state)
            # Before the task is confirmed, the plate must rest for an image. This requirement also
            # applies to a user's planner.
            if own is not None and not state.task.held(state.estimator.stamp, planner.limits):
                wanted = own.plan(parts, began)
                if not isinstance(wanted, Wanted):
                    raise PlateError(
                        f"planner {setup.own_planner}: plan returned {type(wanted).__name__}, "
                        "allowed: a plate_core.Wanted"
                    )
            solving = cpu_time()
            answer = controller.answer(wanted, line.running)
            solve_s = cpu_time() - solving
            table, fitted = prepare(rig, answer.cycle, round(began * 1e9), before=(line.running,))
            line.send(table)
            state = planner.record_cycle(state, answer.cycle, now)
            step_s = cpu_time() - at_work
            error, turned = _true_errors(planner.scenario, rig, state, parts, start, began)
            used = fitted.usage
            yield Moment(
                began, start, parts, wanted, answer, progress, image, solve_s, step_s,
                used.overall, used.force / rig.limits.force,
                float(np.sqrt(np.max(used.thermal_load))), fitted.factor < 1, error, turned,
                max(held, 0),
            )  # fmt: skip
            held = -1
            if progress.ended:
                return
        answer_at = state.due if image is not None else np.inf
        until = np.inf if shot is None else min(shot.delivered, max(answer_at, now + MOMENT_S))
        for motion in line.play(until):
            scene.run(motion)


def predicted(wanted: Wanted, state: PlannerState) -> Prediction | None:
    """Return the positions of the parts that the planner predicts for the next start of a cycle.
    None if the planner's request contains no prediction."""
    if wanted.start is None:
        return None
    return Prediction(wanted.parts.ids, state.estimator.next_start, wanted.start[:, :2])


def seen_by(setup: Setup, rig: Rig) -> Rig:
    """Return the rig with the camera and the part heights of the setup."""
    view = {key: getattr(setup, f"camera_{key}") for key in VIEW}
    if any(value is not None for value in view.values()):
        rig = view_from(rig, **{key: value for key, value in view.items() if value is not None})
    if setup.rig_height_m is not None:
        rig = with_height(rig, setup.rig_height_m)
    settings = {key: getattr(setup, key) for key in CAMERA if getattr(setup, key) is not None}
    return replace(rig, camera=replace(rig.camera, **settings)) if settings else rig


def _true_errors(
    scenario: Scenario,
    rig: Rig,
    state: PlannerState,
    parts: Parts,
    world: WorldState,
    t: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the true position errors (P,) [m] of the parts relative to their references or
    targets. In a pose task, also return their angle errors (P,) [rad]. Both arrays are empty if no
    errors are defined yet."""
    task, true, none = scenario.task, world.position, np.zeros(0)
    if not len(true):
        return none, none
    if isinstance(task, AssembleTask):
        distance = Assembler(task, rig).distance(Parts.make(world.ids, true))
        return distance[~np.isnan(distance)], none
    if state.memory is None:
        return none, none
    if isinstance(task, PoseTask):
        missing = Poser(task, rig).errors(state.memory, _named(parts, state.memory.match, world))
        return missing[0], np.abs(missing[1])
    if isinstance(task, MoveTask):
        true_parts = _named(parts, tuple(target.id for target in task.targets), world)
        place = {target.id: target.place for target in task.targets}
        goal = np.array([place[name] for name in true_parts.ids]).reshape(-1, 2)
        return np.hypot(*(true_parts.position - goal).T), none
    if not isinstance(task, FollowTask) or state.memory.leading:  # the paths have not begun
        return none, none
    reference = Follower(task, rig).reference(state.memory, t)
    seen = dict(zip(parts.ids, parts.position, strict=True))
    errors = []
    for k, name in enumerate(state.memory.match):
        if name in seen:
            nearest = np.argmin(np.sum((true - seen[name]) ** 2, axis=1))
            errors.append(np.linalg.norm(true[nearest] - reference[k]))
    return np.array(errors), none


def _named(parts: Parts, wanted: tuple[str, ...], world: WorldState) -> Parts:
    """Return the true parts that are nearest to the detected parts with the ids `wanted`. The true
    parts get these ids."""
    ids = [name for name in wanted if name in parts.ids]
    seen = parts.position[[parts.ids.index(name) for name in ids]]
    rows = [int(np.argmin(np.sum((world.position - place) ** 2, axis=1))) for place in seen]
    return Parts.make(tuple(ids), world.position[rows], angle=world.angle[rows])


def as_asked(task: Task, rig: Rig, moment: Moment, error: np.ndarray) -> bool:
    """Whether the final true state of the parts fulfils the task. All parts must be on the plate.

    `error` (n,) [m] are the distances of the parts from their references that count for this task.
    """
    if moment.world.dropped:
        return False
    if isinstance(task, FeedTask):
        return True
    if isinstance(task, SortTask):
        true = Parts.make(moment.world.ids, moment.world.position)
        return float(np.max(np.nan_to_num(Sorter(task, rig).to_go(true)))) <= SIGHT_M
    if isinstance(task, FollowTask):
        return float(np.max(error, initial=0.0)) <= task.max_error_m + SIGHT_M
    there = float(np.max(moment.error_m, initial=0.0)) <= task.tolerance_m + SIGHT_M
    if isinstance(task, PoseTask):
        turned = float(np.max(moment.turn_error, initial=0.0))
        there = there and turned <= task.tolerance_rad + SIGHT_RAD
    return there


def summary(setup: Setup, rig: Rig, transport: Transport | None = None) -> dict[str, object]:
    """Run the loop. Return the row that `bench/closed_loop.py` prints."""
    solve_s, step_s, errors, misses, requests = [], [], [], [], []
    shares, scaled, held, late = [], 0, 0, 0
    task, cycles = setup.recipe.task, hashlib.blake2b(digest_size=8)
    for moment in run(setup, rig, transport):
        cycle = moment.answer.cycle
        for knots in (cycle.times, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel):
            cycles.update(knots.tobytes())
        held += moment.held
        late += moment.step_s > cycle.period
        if moment.answer.solution is not None:
            solve_s.append(moment.solve_s)
            step_s.append(moment.step_s)
            misses.append(moment.answer.error_m)
            requests.append(moment.answer.requested_m)
        shares.append((moment.limit_share, moment.force_share, moment.heat_share))
        scaled += moment.scaled
        errors.append(moment.error_m)
    stay = isinstance(task, PoseTask) and all(pose.place is None for pose in task.poses)
    all_along = stay or isinstance(task, FollowTask)
    # In other tasks, only the error at the end counts.
    error = np.concatenate(errors) if all_along else errors[-1]
    turned = np.degrees(np.max(moment.turn_error, initial=0.0))
    milliseconds = 1e3 * np.array(solve_s[1:] or [0.0])  # omit the first cycle, which makes tables
    steps = 1e3 * np.array(step_s[1:] or [0.0])
    most = np.max(shares, axis=0).tolist()
    return {
        "scenario": setup.scenario if isinstance(setup.scenario, str) else setup.scenario.name,
        "seed": setup.seed,
        "method": setup.method,
        "cycles": cycles.hexdigest(),
        "success": moment.progress.phase == "done" and as_asked(task, rig, moment, error),
        "message": moment.progress.text,
        "time_s": round(moment.progress.time_s, 3),
        "dropped": moment.world.dropped,
        "parts": len(moment.world.ids),
        "rms_error_m": float(np.sqrt(np.mean(error**2))) if len(error) else None,
        "max_error_m": float(np.max(error)) if len(error) else None,
        "turn_error_deg": float(turned) if isinstance(task, PoseTask) else None,
        "pace": moment.progress.pace if isinstance(task, FollowTask) else None,
        "held_cycles": held,
        "late_cycles": late,
        "load": round(os.getloadavg()[0], 2),
        "missed_share": float(np.sum(misses) / max(np.sum(requests), 1e-12)),
        "solve_ms_median": float(np.median(milliseconds)),
        "solve_ms_p99": float(np.percentile(milliseconds, 99)),
        "step_ms_median": float(np.median(steps)),
        "step_ms_p99": float(np.percentile(steps, 99)),
        **dict(zip(("limit_share_max", "force_share_max", "heat_share_max"), most, strict=True)),
        "scaled": scaled,
        "gamma": round(rig.gamma, 2),
    }
