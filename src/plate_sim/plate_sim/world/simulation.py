"""One run of the simulated world. The simulator node and the benchmark programs use this class. The
inputs of a simulation are cycles of the plate, and commands to the hand, the hopper and the robot.
The outputs are images and the state of the parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from plate_core import PlateCycle, PlateError, Rig, part_class
from plate_core.tasks import FeedTask, Scenario

from ..camera import NOISE
from ..contacts import INELASTIC, Contacts
from ..friction.outline import footprint_of
from ..plate import PlateMotion, PlateState, realise
from .bodies import BodyTrajectory, Shapes
from .camera_view import CameraView, Shot, VisibleParts, check_height
from .departures import Departures
from .disturbances import NONE, Disturbances
from .friction_field import FrictionField
from .hand import Hand, check_id
from .history import History, Passage
from .hopper import Dispenser
from .robot import Grip, Robot
from .state import WorldState
from .step import run_cycle, run_together

WORLD_RANGES = {"noise": (0.0, 50.0), "mu_scale": (0.1, 10.0)}
"""Allowed ranges of a simulation's parameters."""

TRIAL_S = 1e-3
"""Duration of a test simulation with the plate at rest [s]. The test simulation checks whether a
placed part overlaps other parts."""

MIN_S = 1e-6
"""Minimum length of a piece of a cycle that is simulated separately [s]."""


class Simulation:
    """Simulation of the parts of a scenario on the plate of a rig.

    Parameters
    ----------
    rig : Rig
        Rig file that all other programs also use. If the rig has a suspension, the plate does not
        follow its setpoints exactly.
    scenario : Scenario
        Scenario with the parts.
    seed : int
        Random seed. Each kind of disturbance has a separate random number generator.
    disturbances : Disturbances
        Deviations of the world from the rig model.
    noise : float
        Standard deviation of the noise of a pixel [grey values].
    mu_scale : float
        True friction divided by the friction in the rig file.
    contacts : Contacts

    Raises
    ------
    PlateError
        If the value of `noise` or `mu_scale` is outside its range.

    Attributes
    ----------
    state : WorldState
        State of the parts. Parts that the robot has taken stay in the state until no later image
        can show them. In a feed task, the same applies to parts that left the plate.
    plate : PlateState
    disturbances : Disturbances
    dropped, discharged : int
        Number of parts that left the plate since the start of the simulation. `discharged` counts
        the parts that left over the side of the task's chute, and `dropped` counts all other parts.
        Parts that the hand or the robot removed are not counted.
    discharged_classes : Counter of str
        Number of parts that left over the side of the chute, by class.
    """

    def __init__(
        self,
        rig: Rig,
        scenario: Scenario,
        seed: int = 0,
        disturbances: Disturbances = NONE,
        *,
        noise: float = NOISE,
        mu_scale: float = 1.0,
        contacts: Contacts = INELASTIC,
    ) -> None:
        _check_ranges(noise=noise, mu_scale=mu_scale)
        check_height(rig, disturbances)
        if disturbances.image_rate > 0 and rig.camera.trigger is not None:
            raise PlateError(
                f"image_rate is {disturbances.image_rate:g}, allowed: 0, because the motor "
                "controller triggers the camera (trigger_phase in the rig file)"
            )
        # The order of these generators must not change, because it determines the results of each
        # seed.
        layout, pixels, field, images, parts, stamps, hand, hopper, robot = np.random.default_rng(
            seed
        ).spawn(9)
        self.state = WorldState.of_scenario(scenario, rig, layout)
        self.plate = PlateState.at_rest()
        self.disturbances = disturbances
        self._rig = rig
        self._contacts = contacts
        self._mu_scale = mu_scale
        self._time = 0.0
        self._field = FrictionField.draw(disturbances, len(self.state.ids), field)
        feed = scenario.task if isinstance(scenario.task, FeedTask) else None
        self._feeds = feed is not None
        self._departures = Departures(rig, feed.chute if feed else None)
        self._hopper = Dispenser(feed.hopper if feed else None, rig, hopper)
        self._hand, self._robot = Hand(rig, hand), Robot(rig, scenario.marked, robot)
        self._view = CameraView(
            rig, seed, scenario.marked, disturbances, noise,
            pixels=pixels, images=images, parts=parts, stamps=stamps,
        )  # fmt: skip
        self._last_number: dict[str, int] = {}
        self._set_types()

    def _set_types(self) -> None:
        """Set shapes, friction and appearance of the parts in the state."""
        # cached result of `_friction_limit`, if it does not depend on the positions of the parts
        self._even_limit: np.ndarray | None = None
        types = [self._rig.part_type(part_class(name)) for name in self.state.ids]
        self._shapes = Shapes.of([footprint_of(part) for part in types])
        self._mu = np.array([part.mu for part in types], dtype=float)
        self._view.set_types(self.state.ids, types)

    @property
    def mu(self) -> np.ndarray:
        """True friction coefficients of the parts at their current positions (M,)."""
        mu = self._mu * self._mu_scale
        return self._field.friction(mu, self.state.position, self.plate.pose)

    @property
    def _friction_limit(self) -> np.ndarray:
        """Maximum acceleration that friction can give each part at its current position (M,)
        [m/s2]."""
        if self._field.patches:
            return self.mu * self._rig.friction.gravity
        if self._even_limit is None:
            self._even_limit = self.mu * self._rig.friction.gravity
        return self._even_limit

    def change(self, disturbances: Disturbances, noise: float, mu_scale: float) -> None:
        """Apply new disturbances, except `latency` and `image_rate`, which determine the times of
        the images.

        After this call, the seed alone no longer reproduces the run.

        Raises
        ------
        PlateError
            If the value of `noise` or `mu_scale` is outside its range, or parts get a height
            although the rig file does not contain the position of the camera.
        """
        _check_ranges(noise=noise, mu_scale=mu_scale)
        check_height(self._rig, disturbances)
        self.disturbances, self._mu_scale = disturbances, mu_scale
        self._view.change(disturbances, noise)
        self._field = replace(
            self._field, spread=disturbances.friction_spread, patches=disturbances.friction_patches
        )
        self._set_types()

    def place(self, part_id: str, label: str, position: np.ndarray, angle: float = 0.0) -> str:
        """Place a part at rest, as if by hand.

        Parameters
        ----------
        part_id : str
            Id of a part on the plate, or of a part that left the plate and is still in the state.
            For a new part, the id is an empty text.
        label : str
            Type of a new part.
        position : (2,)
            Centre of the part [m, plate_home].
        angle : float
            Angle of the part [rad].

        Returns
        -------
        str
            Id of the part. The id of a new part contains the next number of its type.

        Raises
        ------
        PlateError
            If there is no such part or type, no more parts are allowed, or the part would be
            outside the plate or overlap another part. The state is then unchanged.
        """
        state, unit = self.state, self._field.unit
        state, part_id, spin = self._hand.put(
            state, part_id, label, position, angle, self._next_number
        )
        run_cycle(state, PlateCycle.rest(TRIAL_S), self._rig)
        if spin is not None:
            unit = np.append(unit, spin)
            self._last_number[part_class(part_id)] = _id_number(part_id)
        self._robot.taken -= {part_id}
        self._replace_state(state, unit, History())
        return part_id

    def show(self, state: WorldState) -> None:
        """Replace the parts by the parts of another run, given by their state. These parts have the
        nominal friction, without individual deviations."""
        self._replace_state(state, np.zeros(len(state.ids)), History())

    def remove(self, part_id: str) -> None:
        """Remove a part from the plate, as if by hand.

        Raises
        ------
        PlateError
            If there is no such part.
        """
        state = self.state
        check_id(state, part_id)
        keep = np.array([name != part_id for name in state.ids])
        self._replace_state(state.take(keep), self._field.unit[keep], History())

    def _replace_state(self, state: WorldState, unit: np.ndarray, history: History) -> None:
        """Replace the state of the parts, their values `FrictionField.unit` (M,) and their
        history."""
        for name in self.state.ids:
            label = part_class(name)
            self._last_number[label] = max(_id_number(name), self._last_number.get(label, 0))
        self.state, self._field = state, replace(self._field, unit=unit)
        self._view.history = history
        self._set_types()

    def _next_number(self, label: str) -> int:
        """Return the number for the id of the next part of a class. No number is used twice."""
        max_present = max(
            (_id_number(i) for i in self.state.ids if part_class(i) == label), default=0
        )
        return 1 + max(max_present, self._last_number.get(label, 0))

    def open_hopper(self, duration_s: float) -> int:
        """Open the hopper for the time `duration_s` from now [s]. If the hopper is still open, the
        new duration replaces the remaining time.

        While the hopper is open, one part drops every 1/rate [s]. If `MAX_PARTS` parts are on the
        plate, or if the heap reaches the edge of the plate, no part drops.

        Returns
        -------
        int
            Number of parts that will drop if there is enough free space.

        Raises
        ------
        PlateError
            If the task has no hopper, if the time is not allowed, or if the plate is full.
        """
        return self._hopper.open(duration_s, self.state)

    def move_robot(self, to: int, x: float = 0.0, y: float = 0.0, angle: float = 0.0) -> Grip:
        """Move the robot without delay. Later images show the robot at its new position.

        Parameters
        ----------
        to : int
            The requested `Move`. AWAY moves the robot away from the plate. OVER moves the gripper
            to the pose above the plate, where the robot hides the plate in images. GRIP does the
            same, and the robot then takes the nearest part from the plate. With the probability
            `pick_failure`, the part slips and is displaced slightly instead.
        x, y, angle : float
            Pose of the gripper [m, m, rad, plate_home]. AWAY ignores the pose.

        Raises
        ------
        PlateError
            If the move is unknown, or if the gripper would not be over the plate.
        """
        now, failure = self._time, self.disturbances.pick_failure
        self.state, result = self._robot.move(
            self.state, to, (x, y, angle), failure, now, now - self._view.past
        )
        return result

    @property
    def dropped(self) -> int:
        """Number of parts that left the plate over another side than that of the chute."""
        return (
            self._departures.dropped + self._departures.count(self.state, self._has_left_plate)[0]
        )

    @property
    def discharged(self) -> int:
        """Number of parts that left the plate over the side of the chute."""
        return self.discharged_classes.total()

    @property
    def discharged_classes(self) -> Counter[str]:
        """Number of parts that left the plate over the side of the chute, by class."""
        return (
            self._departures.discharged
            + self._departures.count(self.state, self._has_left_plate)[1]
        )

    @property
    def _has_left_plate(self) -> np.ndarray:
        """Whether each part left the plate (M,). The value is False for parts that the robot has
        taken."""
        return ~self.state.on_plate & ~self._robot.has(self.state.ids)

    def _remove_invisible_parts(self) -> None:
        """Remove from the state those parts that later images cannot show. These
        are the parts that the robot has taken and, in a feed task, the parts that left the
        plate."""
        state, history = self.state, self._view.history
        if np.all(state.on_plate) or not (self._feeds or self._robot.taken):
            return
        invisible = ~state.on_plate & ~history.shows(len(state.ids))
        if not self._feeds:
            invisible &= self._robot.has(state.ids)
        if not np.any(invisible):
            return
        self._departures.forget(state, self._has_left_plate & invisible)
        self._replace_state(
            state.take(~invisible), self._field.unit[~invisible], history.take(~invisible)
        )
        self._robot.taken &= set(self.state.ids)

    def _drop_part(self) -> None:
        """Drop one part from the hopper onto the plate, if there is free space."""
        part = self._hopper.drop(self.state)
        if part is None:
            return
        name = f"{part.label}_{self._next_number(part.label)}"
        state = self.state.joined(name, part.position, part.angle)
        unit = np.append(self._field.unit, part.unit)
        self._replace_state(state, unit, self._view.history.joined(part.position))

    def shots(self, begin: float) -> Iterator[Shot]:
        """Yield the times of the images of a free-running camera from the time `begin` [s] on. The
        sequence has no end."""
        return self._view.shots(begin)

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered now. Return None if this image
        is missing.

        `age` is the time since the middle of the image's exposure [s]. If `age` is None, the
        exposure began `latency` ago.
        """
        return self._view.capture(self.state, self.plate, self._robot, self._time, age)

    def visible_parts(self, age: float | None = None) -> VisibleParts | None:
        """Return the exact positions of the parts in the image that `capture` would return. Return
        None if this image is missing. For each image, call either `capture` or this method."""
        return self._view.visible_parts(self.state, self.plate, age)

    def capture_bare(self) -> np.ndarray:
        """Return an image of the plate without parts, at home. The shape is (height, width), or
        (height, width, 3) for an image in colour."""
        return self._view.capture_bare(self._time)

    def run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Simulate a commanded cycle, or a motion that a motor controller has executed.

        If the hopper is open, parts may drop onto the plate during the cycle.
        """
        self._remove_invisible_parts()
        if not self._hopper.is_open:
            self._simulate_cycle(cycle)
            return
        begin, end = 0.0, cycle.period
        for drop_time in self._hopper.after(end):
            if drop_time - begin > MIN_S:
                drop_time = drop_time if end - drop_time > MIN_S else end
                self._simulate_cycle(PlateMotion.section(cycle, begin, drop_time))
                begin = drop_time
            self._drop_part()
        if begin == 0:
            self._simulate_cycle(cycle)
        elif begin < end:
            self._simulate_cycle(PlateMotion.section(cycle, begin, end))

    def _simulate_cycle(self, cycle: PlateCycle | PlateMotion) -> None:
        """Simulate the parts until the end of a cycle, or of a section of a cycle."""
        self._time += cycle.period
        motion: PlateCycle | PlateMotion = cycle
        limit = self._friction_limit
        if self._rig.suspension is not None:
            motion, self.plate = realise(self._rig, self.plate, cycle)
        past = self._view.past
        for path in self._simulate_together([self], [motion], [limit], 1, every=1 if past else 0):
            plate = PlateMotion(motion.times, motion.coefficients)
            self._view.history = self._view.history.after(
                Passage(plate, path, self.state.on_plate), past
            )

    @staticmethod
    def run_together(
        simulations: Sequence[Simulation], cycles: Sequence[PlateCycle], threads: int
    ) -> None:
        """Simulate one cycle of each of several simulations with the same rig, in parallel threads.
        The results are identical to those of `run`."""
        plain: dict[tuple[str, ...], list[tuple[Simulation, PlateCycle]]] = {}
        for simulation, cycle in zip(simulations, cycles, strict=True):
            if (
                simulation._view.past
                or simulation._feeds
                or simulation._robot.taken
                or simulation._rig.suspension is not None
            ):
                simulation.run(cycle)
            else:
                plain.setdefault(simulation.state.ids, []).append((simulation, cycle))
                simulation._time += cycle.period
        for alike in plain.values():
            worlds, motions = zip(*alike, strict=True)
            Simulation._simulate_together(
                worlds, motions, [world._friction_limit for world in worlds], threads
            )

    @staticmethod
    def _simulate_together(
        worlds: Sequence[Simulation],
        motions: Sequence[PlateCycle | PlateMotion],
        limits: Sequence[np.ndarray],
        threads: int,
        every: int = 0,
    ) -> list[BodyTrajectory]:
        """Simulate the parts of several simulations that have the same rig and the same ids of
        parts, see `step.run_together`."""
        first = worlds[0]
        states, paths = run_together(
            [world.state for world in worlds], motions, first._shapes, limits, first._rig,
            first._contacts, [world.disturbances.ground for world in worlds], threads, every=every,
        )  # fmt: skip
        for world, state in zip(worlds, states, strict=True):
            world.state = state
        return paths


def _check_ranges(**values: float) -> None:
    for name, value in values.items():
        low, high = WORLD_RANGES[name]
        if not low <= value <= high:
            raise PlateError(f"{name} is {value:g}, allowed: {low:g} to {high:g}")


def _id_number(part_id: str) -> int:
    return int(part_id.rpartition("_")[2])
