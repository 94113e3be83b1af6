"""Closed loop without ROS. This module runs the same code as the nodes, in one process.

Image k is taken at the start of cycle k. The cycle that is computed from image k is executed as
cycle k + 1. The nodes behave in the same way. With a free-running camera, images are taken at any
time, and the loop computes the next cycle shortly before the present cycle ends. If no new cycle
arrives, the plate repeats the present cycle. The transport sends the cycles to the plate:
immediately (`Direct`), or over a serial line (`SerialLine` of `bench/harness/serial.py`).
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
    CycleRequest,
    Parts,
    PlateCycle,
    PlateError,
    Rig,
    did_you_mean,
    load_rig,
)
from plate_core.files import check_file
from plate_core.motion import Timeline
from plate_core.rig import MAX_HEIGHT_M
from plate_core.tasks import (
    FeedOrder,
    FollowTask,
    PartTarget,
    PoseTask,
    Scenario,
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
from plate_planner.tasks import FeedReport
from plate_sim.camera import NOISE
from plate_sim.plate import PlateMotion
from plate_sim.world import NONE, WORLD_RANGES, Disturbances, Shot, Simulation, WorldState
from plate_solver import METHODS, Controller, CycleResult
from plate_vision import Prediction, Tracker, make_vision, observe
from plate_vision.bare_plate import BARE_IMAGES, BarePlate, know_plate

from .evaluation import is_fulfilled, true_errors
from .views import view_from, with_height

__all__ = [
    "ALIKE",
    "Cell",
    "Direct",
    "Moment",
    "Scene",
    "Setup",
    "SimulatedScene",
    "Transport",
    "load_planner",
    "predicted",
    "run",
    "summary",
    "with_settings",
    "with_setup_camera",
]  # fmt: skip

ALIKE = {
    "OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}  # fmt: skip
"""Environment variables for reproducible runs. If these variables are set, a run with a given seed
has identical results on all processors with AVX2 and FMA. The variables must be set before
libraries are loaded."""

EFFORT = ("iterations", "restarts")
"""Options of the solvers. Larger values of these options improve the results and increase the
computing time."""

MOMENT_S = 1e-6
"""Minimum time by which the loop advances in one step [s]."""

CAMERA = ("exposure_s", "readout_s")
"""Data of the rig's camera that settings of the command line can replace."""

VIEW = ("tilt_deg", "towards_deg", "focal_px", "distance_m")
"""Arguments of `view_from` that settings of the command line can set. The names of these settings
begin with `camera_`."""

PLANNER_BYTES = 1_000_000
"""Maximum size of a planner's Python file [bytes]."""

NUMBERS = {
    **WORLD_RANGES, "image_age_s": (0.0, 1.0), "exposure_s": (0.0, 0.1), "readout_s": (0.0, 0.1),
    "camera_tilt_deg": (0.0, 60.0), "camera_towards_deg": (-360.0, 360.0),
    "camera_focal_px": (50.0, 20000.0), "camera_distance_m": (0.0, 100.0),
    "rig_height_m": (0.0, MAX_HEIGHT_M),
}  # fmt: skip
"""Settings of the command line that are numbers, with their allowed ranges."""


@dataclass(frozen=True)
class Setup:
    """Settings of a run: task, method and simulated world.

    Attributes
    ----------
    scenario : str or Scenario
        Scenario, or its name or path.
    seed : int
        Random seed of the start positions, the image noise and the solver's restarts.
    method : str
        A key of `METHODS`.
    noise : float
        Standard deviation of the image noise [grey levels].
    mu_scale : float
        True friction divided by the friction in the rig.
    disturbances : Disturbances
        Disturbances of the simulated world.
    planner : PlannerOptions
    exposure_s, readout_s : float or None
        Values for the rig's camera [s]. None: values in the rig file.
    camera_tilt_deg, camera_towards_deg, camera_focal_px, camera_distance_m : float or None
        Arguments of `view_from`. If one of these values is given, `view_from` moves the camera, and
        None means its default value.
    rig_height_m : float or None
        Height of all parts in the rig model that all stages use [m]. None means the height in the
        rig file.
    image_age_s : float or None
        Image latency that the planner assumes [s]. None means that the planner estimates the
        latency.
    effort : mapping of str to int
        Values of the solver's options `iterations` and `restarts`. For an omitted option, the
        default of `Controller` applies.
    own_planner : str
        Python file with a class `OwnPlanner`, which requests the forces. The project's planner then
        only supervises the task. It decides whether the task is done or stuck, and whether a part
        is lost. It requests a cycle at rest for the image that confirms the result.
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
        """Scenario. If a name or path is given, the scenario is loaded."""
        return (
            self.scenario if isinstance(self.scenario, Scenario) else load_scenario(self.scenario)
        )


def with_settings(setup: Setup, settings: Mapping[str, str]) -> Setup:
    """Return a setup to which settings `key=value` of the command line are applied.

    Allowed keys are the fields of `Setup`, `Disturbances` and `FollowOptions`, and the options in
    `EFFORT`.

    Raises
    ------
    PlateError
        If a key is unknown, or if a value is not allowed.
    """
    follow, world = setup.planner.follow, setup.disturbances
    for key, text in settings.items():
        try:
            if key == "method":
                setup = replace(setup, method=_check_method(text))
            elif key in NUMBERS:
                setup = replace(setup, **{key: _parse_number(key, float(text), *NUMBERS[key])})  # type: ignore[arg-type]
            elif key in EFFORT:
                setup = replace(setup, effort={**setup.effort, key: int(text)})
            elif key == "blur":
                world = replace(world, blur=_parse_flag(key, text))
            elif key in {f.name for f in fields(Disturbances)}:
                world = replace(world, **{key: float(text)})  # type: ignore[arg-type]
            elif key in FollowOptions.RANGES:
                limits = FollowOptions.RANGES[key]
                follow = replace(follow, **{key: _parse_number(key, float(text), *limits)})
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


def _parse_number(key: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise PlateError(f"setting {key} is {value:g}, allowed: {low:g} to {high:g}")
    return value


def _parse_flag(key: str, text: str) -> bool:
    if text not in ("true", "false"):
        raise PlateError(f"setting {key} is {text!r}, allowed: true or false")
    return text == "true"


def _check_method(name: str) -> str:
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
        Start time of the running cycle [s].
    world : WorldState
        True state of the parts at this time.
    parts : Parts
        Detected parts.
    request : CycleRequest
        Request to the solver.
    result : CycleResult
        Result of the solver, with the cycle that is executed next.
    progress : Progress
    image : (H, W)
        Last camera image.
    solve_s : float
        CPU time of the solver [s].
    step_s : float
        CPU time from the image to the motors' table [s].
    limit_share, force_share, heat_share : float
        Fractions of the limits that the motors' table uses. `limit_share` is the maximum over all
        limits, and `force_share` the fraction of the peak force. `heat_share` is the fraction of
        the continuous force if the table is repeated forever.
    scaled : bool
        Whether the driver scaled the cycle down, because it exceeded the limits.
    error_m : (P,)
        True distance of each detected part from its reference or target at the start of the running
        cycle [m]. Empty for a sort task.
    turn_error : (P,)
        True angle error of each part in a pose task [rad]. Empty for other tasks.
    held : int
        Number of times that a cycle was repeated since the last image, because no new cycle had
        arrived.
    """

    time: float
    world: WorldState
    parts: Parts
    request: CycleRequest
    result: CycleResult
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
    """Transport of cycles to the plate, which also returns the motion of the plate.

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
        """Running cycle, or running tail of a cycle."""

    def send(self, table: MotorTable) -> None:
        """Send the table of the next cycle."""

    def play(self, until: float) -> Sequence[PlateCycle | PlateMotion]:
        """Advance the time to the start of the next cycle, or to `until` [s] if this is earlier.
        Return the motions of the plate during this time."""


class Scene(Protocol):
    """Interface of the parts on the plate, and of their detection."""

    @property
    def state(self) -> WorldState:
        """True state of the parts at the present time."""

    def shots(self, begin: float) -> Iterator[Shot]:
        """Return the times of the images of a free-running camera from the time `begin` [s] on."""

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """Return an image (H, W) that was taken `age` [s] ago, or None if the image is missing. If
        `age` is None, the image is taken now."""

    def see(self, image: np.ndarray, stamp: float, expected: Prediction | None) -> Parts:
        """Return the parts that are detected in an image. `stamp` is the stamp of the image [s]."""

    def run(self, motion: PlateCycle | PlateMotion) -> None:
        """Move the plate, and simulate the parts during this motion."""


class SimulatedScene:
    """Parts of the simulator. Vision detects the parts in the images of the simulated camera."""

    def __init__(self, setup: Setup, scenario: Scenario, rig: Rig) -> None:
        self.simulation = Simulation(
            rig, scenario, setup.seed, setup.disturbances, noise=setup.noise,
            mu_scale=setup.mu_scale,
        )  # fmt: skip
        self._vision, self._tracker = make_vision(rig), Tracker()
        self._bare = BarePlate(requested=BARE_IMAGES)
        if self._vision.catalogue is not None:
            for _ in range(BARE_IMAGES):
                self._update_bare_plate(self.simulation.capture_bare())

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
            self._update_bare_plate(image)
        self._tracker = observe(self._vision, self._tracker, image, stamp, expected)
        return self._tracker.parts

    def run(self, motion: PlateCycle | PlateMotion) -> None:
        """See `Scene`."""
        self.simulation.run(motion)

    def _update_bare_plate(self, image: np.ndarray) -> None:
        self._bare, self._vision, _ = know_plate(self._bare, self._vision, image)


class Cell(Protocol):
    """Interface of the devices around the plate in a feed task, for example hopper and robot. These
    devices give orders to the planner."""

    def act(self, simulation: Simulation, now: float) -> None:
        """Perform all actions that are due at the time `now` [s]. The loop calls this method before
        it takes an image."""

    def order(self, report: FeedReport, now: float) -> FeedOrder:
        """Process the planner's report on the last image. Return the order for the planner that
        applies from `now` [s] on."""


class ControlLaw(Protocol):
    """Interface of a user's planner. The loop creates the planner with the rig, and calls the
    planner once per image."""

    def plan(self, parts: Parts, t: float) -> CycleRequest:
        """Return the request for the mean forces on the parts. `t` is the stamp of the image
        [s]."""


def load_planner(path: str, rig: Rig) -> ControlLaw:
    """Load the class `OwnPlanner` from a Python file, and return an instance.

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
    """Immediate transport to the simulator. The transport executes a new cycle after the running
    cycle."""

    def __init__(self) -> None:
        self.now = 0.0
        self._timeline = Timeline.at_rest()

    @property
    def running(self) -> PlateCycle:
        """Running cycle."""
        return self._timeline.cycle

    @property
    def began(self) -> float:
        """Start time of the running cycle [s]."""
        return self._timeline.begin

    def send(self, table: MotorTable) -> None:
        """Send the table of the next cycle."""
        self._timeline = self._timeline.send(table.cycle)

    def play(self, until: float) -> list[PlateCycle | PlateMotion]:
        """Advance the time to the end of the running cycle, or to `until` [s] if this is earlier.
        Return the motion of the plate during this time."""
        played, began, end = self.running, self.began, self._timeline.end
        until = until if until < end - MOMENT_S else end
        begin, stop = self.now - began, min(until - began, played.period)
        is_complete = begin == 0 and stop == played.period
        self.now = min(until, end)
        if self.now == end:
            self._timeline = self._timeline.next()
        return [played if is_complete else PlateMotion.section(played, begin, stop)]


def run(
    setup: Setup,
    rig: Rig | None = None,
    transport: Transport | None = None,
    drag: Callable[[float], Sequence[PartTarget]] | None = None,
    cell: Cell | None = None,
    scene: Scene | None = None,
) -> Iterator[Moment]:
    """Run the loop until the task has ended. For each computed cycle, yield a `Moment`.

    `drag` is a function of the time [s] that returns new targets for a running move task. `cell`
    represents the devices around the plate in a feed task. `scene` provides the parts. Default: the
    parts of the simulator.
    """
    scenario = setup.recipe
    rig = with_setup_camera(setup, rig or load_rig(scenario.rig))
    loop = _Loop(
        setup, rig, transport or Direct(), drag, cell, scene or SimulatedScene(setup, scenario, rig)
    )
    while True:
        loop.record_cycle_start()
        new_image = loop.process_image()
        if loop.is_cycle_due(new_image):
            moment = loop.send_cycle()
            yield moment
            if moment.progress.ended:
                return
        loop.advance()


class _Loop:
    """Stages of a run, and the state of the loop between two steps.

    A step consists of four parts, in the order in which `run` calls them. `record_cycle_start`
    informs the planner if a cycle has started. `process_image` takes an image and detects the
    parts. `send_cycle` computes and sends the next cycle. `advance` moves the plate and the parts.
    """

    def __init__(
        self,
        setup: Setup,
        rig: Rig,
        line: Transport,
        drag: Callable[[float], Sequence[PartTarget]] | None,
        cell: Cell | None,
        scene: Scene,
    ) -> None:
        self._rig = rig
        self._line = line
        self._drag = drag
        self._cell = cell
        self._scene = scene
        options = replace(setup.planner, image_age_s=setup.image_age_s)
        self._planner = Planner(rig, setup.recipe, options)
        self._state = self._planner.start(self._planner.initial())
        self._own_path = setup.own_planner
        self._own_planner = load_planner(setup.own_planner, rig) if setup.own_planner else None
        self._controller = Controller(rig, setup.method, setup.seed, **setup.effort)
        # next image of a free-running camera; None: images are taken at the starts of cycles
        self._shots = scene.shots(line.now)
        self._shot = next(self._shots) if setup.disturbances.image_rate > 0 else None
        # repetitions of the running cycle; -1 until a newly computed cycle has started
        self._held = -1
        # start of the running cycle, and the parts at that time
        self._began = -np.inf
        self._start = scene.state
        self._image: np.ndarray | None = None
        self._expected: Prediction | None = None
        self._parts = Parts.make((), np.zeros((0, 2)))
        self._work_began = 0.0  # CPU time at the start of the work on the present image [s]

    def record_cycle_start(self) -> None:
        """Inform the planner if the plate has started a cycle."""
        self._work_began = cpu_time()
        if self._line.began > self._began:
            self._held += 1
            self._began = self._line.began
            self._start = self._scene.state
            triggered = self._shot is None
            self._state = self._planner.started(
                self._state, self._line.running, self._began, triggered
            )

    def process_image(self) -> bool:
        """Let the devices act. If an image is available, detect its parts. Return whether an image
        is available."""
        now = self._line.now
        if self._cell is not None:
            assert isinstance(self._scene, SimulatedScene)
            self._cell.act(self._scene.simulation, now)
        image, stamp = None, now
        if self._shot is None:
            image = self._scene.capture()
        elif self._shot.delivered <= now:
            image, stamp = self._scene.capture(now - self._shot.middle), self._shot.stamp
            self._shot = next(self._shots)
        if image is None:
            return False
        self._image = image
        self._work_began = cpu_time()
        self._parts = self._scene.see(image, stamp, self._expected)
        self._state = self._planner.see(self._state, self._parts, stamp)
        return True

    def is_cycle_due(self, new_image: bool) -> bool:
        """Return whether the next cycle must be computed now."""
        due = new_image if self._shot is None else self._state.due <= self._line.now
        return due and self._image is not None

    def send_cycle(self) -> Moment:
        """Compute the next cycle, and send it."""
        line, rig = self._line, self._rig
        assert self._image is not None
        request, progress = self._request()
        solve_began = cpu_time()
        result = self._controller.solve(request, line.running)
        solve_s = cpu_time() - solve_began
        stamp_ns = round(self._began * 1e9)
        table, scaled = prepare(rig, result.cycle, stamp_ns, before=(line.running,))
        line.send(table)
        self._state = self._planner.record_cycle(self._state, result.cycle, line.now)
        step_s = cpu_time() - self._work_began
        error, turned = true_errors(
            self._planner.scenario, rig, self._state, self._parts, self._start, self._began
        )
        used = scaled.usage
        moment = Moment(
            time=self._began,
            world=self._start,
            parts=self._parts,
            request=request,
            result=result,
            progress=progress,
            image=self._image,
            solve_s=solve_s,
            step_s=step_s,
            limit_share=used.overall,
            force_share=used.force / rig.limits.force,
            heat_share=float(np.sqrt(np.max(used.thermal_load))),
            scaled=scaled.factor < 1,
            error_m=error,
            turn_error=turned,
            held=max(self._held, 0),
        )
        self._held = -1
        return moment

    def _request(self) -> tuple[CycleRequest, Progress]:
        """Return the request for the next cycle, and the progress of the task."""
        now = self._line.now
        if self._drag is not None and self._state.task.active:
            self._planner, self._state, _ = self._planner.retarget(self._state, self._drag(now))
        if self._cell is not None and self._state.memory is not None:
            order = self._cell.order(self._state.memory.report, now)
            self._planner = self._planner.order(self._state, order)
        self._state, request, progress = self._planner.next_request(self._state)
        self._expected = predicted(request, self._state)
        # The result of a task is confirmed with an image that is taken at rest. For this image, the
        # request of a user's planner is ignored.
        is_confirmed = self._state.task.held(self._state.estimator.stamp, self._planner.limits)
        if self._own_planner is not None and not is_confirmed:
            request = _own_request(self._own_planner, self._own_path, self._parts, self._began)
        return request, progress

    def advance(self) -> None:
        """Move the plate and the parts until the next image, the next cycle, or the time at which
        the next cycle must be computed."""
        until = np.inf
        if self._shot is not None:
            due = self._state.due if self._image is not None else np.inf
            until = min(self._shot.delivered, max(due, self._line.now + MOMENT_S))
        for motion in self._line.play(until):
            self._scene.run(motion)


def _own_request(planner: ControlLaw, path: str, parts: Parts, t: float) -> CycleRequest:
    """Return the request of a user's planner from the file `path`. Raise PlateError if the planner
    returns another object."""
    request = planner.plan(parts, t)
    if not isinstance(request, CycleRequest):
        raise PlateError(
            f"planner {path}: plan() returned a {type(request).__name__}, allowed: a "
            "plate_core.CycleRequest"
        )
    return request


def predicted(request: CycleRequest, state: PlannerState) -> Prediction | None:
    """Return the positions of the parts that the planner predicts for the start of the next cycle,
    or None if the planner's request contains no prediction."""
    if request.start is None:
        return None
    return Prediction(request.parts.ids, state.estimator.next_start, request.start[:, :2])


def with_setup_camera(setup: Setup, rig: Rig) -> Rig:
    """Return the rig with the camera and the part height that the setup requests."""
    view = {key: getattr(setup, f"camera_{key}") for key in VIEW}
    if any(value is not None for value in view.values()):
        rig = view_from(rig, **{key: value for key, value in view.items() if value is not None})
    if setup.rig_height_m is not None:
        rig = with_height(rig, setup.rig_height_m)
    settings = {key: getattr(setup, key) for key in CAMERA if getattr(setup, key) is not None}
    return replace(rig, camera=replace(rig.camera, **settings)) if settings else rig


def summary(setup: Setup, rig: Rig, transport: Transport | None = None) -> dict[str, object]:
    """Run the loop until the task has ended. Return the row that `bench/closed_loop.py` prints."""
    solve_s: list[float] = []
    step_s: list[float] = []
    errors: list[np.ndarray] = []
    misses: list[float] = []
    requests: list[float] = []
    uses: list[tuple[float, float, float]] = []
    scaled = held = late = 0
    task, cycles = setup.recipe.task, hashlib.blake2b(digest_size=8)
    for moment in run(setup, rig, transport):
        cycle = moment.result.cycle
        for knots in (cycle.times, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel):
            cycles.update(knots.tobytes())
        held += moment.held
        late += moment.step_s > cycle.period
        if moment.result.solution is not None:
            solve_s.append(moment.solve_s)
            step_s.append(moment.step_s)
            misses.append(moment.result.error_m)
            requests.append(moment.result.requested_m)
        uses.append((moment.limit_share, moment.force_share, moment.heat_share))
        scaled += moment.scaled
        errors.append(moment.error_m)
    stay = isinstance(task, PoseTask) and all(pose.place is None for pose in task.poses)
    all_along = stay or isinstance(task, FollowTask)
    # In all other tasks, only the error at the end counts.
    error = np.concatenate(errors) if all_along else errors[-1]
    evaluated = error if isinstance(task, FollowTask) else moment.error_m
    fulfilled = is_fulfilled(task, rig, moment.world, evaluated, moment.turn_error)
    turned = np.degrees(np.max(moment.turn_error, initial=0.0))
    # The first cycle is omitted, because lookup tables of the solver are computed in it.
    milliseconds = 1e3 * np.array(solve_s[1:] or [0.0])
    steps = 1e3 * np.array(step_s[1:] or [0.0])
    max_uses = np.max(uses, axis=0).tolist()
    return {
        "scenario": setup.scenario if isinstance(setup.scenario, str) else setup.scenario.name,
        "seed": setup.seed,
        "method": setup.method,
        "cycles": cycles.hexdigest(),
        "success": moment.progress.phase == "done" and fulfilled,
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
        **dict(
            zip(("limit_share_max", "force_share_max", "heat_share_max"), max_uses, strict=True)
        ),
        "scaled": scaled,
        "gamma": round(rig.gamma, 2),
    }
