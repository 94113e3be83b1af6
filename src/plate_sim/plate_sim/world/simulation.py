"""One run of the simulated world, for the node and the bench. The inputs are plate cycles, and
commands to the hand, the hopper and the robot. The outputs are images and the state of the
parts."""

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
from .departures import Departures
from .disturbances import NONE, Disturbances
from .friction_field import FrictionField
from .hand import Hand, check_id
from .history import History, Passage
from .hopper import Dispenser
from .robot import Grip, Robot
from .sight import CameraView, Shot, Sight, check_height
from .state import WorldState
from .step import run_cycle, run_together

WORLD_RANGES = {"noise": (0.0, 50.0), "mu_scale": (0.1, 10.0)}
"""Allowed ranges of a simulation's parameters."""

TRIAL_S = 1e-3
"""Length of a simulated rest [s]. This rest checks whether a placed part overlaps other parts."""

MIN_S = 1e-6
"""Minimum length of a piece of a cycle that is simulated separately [s]."""


class Simulation:
    """Parts of a scenario on a rig's plate.

    Parameters
    ----------
    rig : Rig
        Rig model that all stages use. If the rig has a suspension, the plate deviates from its
        commands.
    scenario : Scenario
        Scenario with the parts.
    seed : int
        Random seed. Each kind of disturbance has random numbers of its own, which do not depend on
        the other kinds.
    disturbances : Disturbances
        Deviations of the world from the rig model.
    noise : float
        Standard deviation of the noise of a pixel [grey values].
    mu_scale : float
        Ratio of the true friction to the friction in the rig.
    contacts : Contacts

    Raises
    ------
    PlateError
        If noise or mu_scale is out of range.

    Attributes
    ----------
    state : WorldState
        State of the parts. In a feed task, parts that left the plate are removed from the state
        when the next cycle begins. In all tasks, parts that the robot has taken are also removed
        then.
    plate : PlateState
    disturbances : Disturbances
    dropped, chuted : int
        Number of parts that left the plate after the start of the simulation. `chuted` counts the
        parts that left over the side of the task's chute, and `dropped` all other parts. Parts that
        were removed by hand or by the robot are not counted.
    chuted_classes : Counter of str
        Number `chuted`, by class.
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
        _check(noise=noise, mu_scale=mu_scale)
        check_height(rig, disturbances)
        if disturbances.image_rate > 0 and rig.camera.trigger is not None:
            raise PlateError(
                f"image_rate is {disturbances.image_rate:g}, allowed: 0, because the motor "
                "controller triggers the camera (trigger_phase in the rig file)"
            )
        # Keep this order, because it determines the results of each seed.
        layout, pixels, field, images, parts, stamps, hand, hopper, robot = np.random.default_rng(
            seed
        ).spawn(9)
        self.state = WorldState.of_scenario(scenario, rig, layout)
        self.plate = PlateState.at_rest()
        self.disturbances = disturbances
        self._rig, self._contacts, self._mu_scale, self._time = rig, contacts, mu_scale, 0.0
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
        self._know_types()

    def _know_types(self) -> None:
        """Set shapes, friction and appearance of the current parts."""
        self._even_limit: np.ndarray | None = None  # `_limit`, if it does not depend on the places
        types = [self._rig.part_type(part_class(name)) for name in self.state.ids]
        self._shapes = Shapes.of([footprint_of(part) for part in types])
        self._mu = np.array([part.mu for part in types], dtype=float)
        self._view.know(self.state.ids, types)

    @property
    def mu(self) -> np.ndarray:
        """Current true friction coefficients (M,)."""
        mu = self._mu * self._mu_scale
        return self._field.friction(mu, self.state.position, self.plate.pose)

    @property
    def _limit(self) -> np.ndarray:
        """Current maximum acceleration of each part by friction (M,) [m/s2]."""
        if self._field.share:
            return self.mu * self._rig.friction.gravity
        if self._even_limit is None:
            self._even_limit = self.mu * self._rig.friction.gravity
        return self._even_limit

    def change(self, disturbances: Disturbances, noise: float, mu_scale: float) -> None:
        """Apply new disturbances. `latency` and `image_rate`, which determine the times of images,
        do not change.

        Afterwards, the seed alone no longer reproduces the run.

        Raises
        ------
        PlateError
            If noise or mu_scale is out of range, or if parts get a height and the rig does not
            contain the position of the camera.
        """
        _check(noise=noise, mu_scale=mu_scale)
        check_height(self._rig, disturbances)
        self.disturbances, self._mu_scale = disturbances, mu_scale
        self._view.change(disturbances, noise)
        self._field = replace(
            self._field, spread=disturbances.friction_spread, share=disturbances.friction_patches
        )
        self._know_types()

    def place(self, part_id: str, label: str, position: np.ndarray, angle: float = 0.0) -> str:
        """Place a part at rest, as if by hand.

        Parameters
        ----------
        part_id : str
            Id of a part on the plate, or of a part that left and is still in the state. Empty for a
            new part.
        label : str
            Type of the new part.
        position : (2,)
            Centre of the part [m, plate_home].
        angle : float
            Angle of the part [rad].

        Returns
        -------
        str
            Id of the part. A new part gets the next number of its type.

        Raises
        ------
        PlateError
            If there is no such part or type, if no more parts are allowed, or if the part would be
            off the plate or overlap another part. In these cases nothing is changed.
        """
        state, unit = self.state, self._field.unit
        state, part_id, own = self._hand.put(
            state, part_id, label, position, angle, self._next_number
        )
        run_cycle(state, PlateCycle.rest(TRIAL_S), self._rig)
        if own is not None:
            unit = np.append(unit, own)
            self._last_number[part_class(part_id)] = _number(part_id)
        self._robot.taken -= {part_id}
        self._take_over(state, unit, History())
        return part_id

    def show(self, state: WorldState) -> None:
        """Continue with the parts of another run. The individual friction of the present parts is
        lost."""
        self._take_over(state, np.zeros(len(state.ids)), History())

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
        self._take_over(state.take(keep), self._field.unit[keep], History())

    def _take_over(self, state: WorldState, unit: np.ndarray, history: History) -> None:
        """Continue with other parts."""
        for name in self.state.ids:
            label = part_class(name)
            self._last_number[label] = max(_number(name), self._last_number.get(label, 0))
        self.state, self._field = state, replace(self._field, unit=unit)
        self._view.history = history
        self._know_types()

    def _next_number(self, label: str) -> int:
        """Return the number of the next part of a class. No number is used twice."""
        there = max((_number(i) for i in self.state.ids if part_class(i) == label), default=0)
        return 1 + max(there, self._last_number.get(label, 0))

    def open_hopper(self, duration_s: float) -> int:
        """Open the hopper for a time from now [s]. This replaces an earlier opening.

        One part drops after each 1/rate [s] of open time. There is no space if `MAX_PARTS` are on
        the plate, or if the heap reaches the edge of the plate. The part then stays in the hopper.

        Returns
        -------
        int
            Number of parts that drop in that time if there is enough space.

        Raises
        ------
        PlateError
            If the task has no hopper, if the time is not allowed, or if the plate is full.
        """
        return self._hopper.open(duration_s, self.state)

    def move_robot(self, to: int, x: float = 0.0, y: float = 0.0, angle: float = 0.0) -> Grip:
        """Move the robot without delay. Later images show it at its new place.

        Parameters
        ----------
        to : int
            The requested `Move`. AWAY moves the robot away from the plate. OVER moves it over the
            pose, where its arm hides the plate below. GRIP moves it in the same way and grips: it
            removes the nearest part from the plate. With the probability `pick_failure` the part
            slips and may be displaced slightly.
        x, y, angle : float
            Pose of the gripper [m, m, rad, plate_home]. The pose is not used if the robot moves
            away.

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
        """`dropped`, see `Simulation`."""
        return self._departures.dropped + self._departures.count(self.state, self._left)[0]

    @property
    def chuted(self) -> int:
        """`chuted`, see `Simulation`."""
        return self.chuted_classes.total()

    @property
    def chuted_classes(self) -> Counter[str]:
        """`chuted` by class, see `Simulation`."""
        return self._departures.chuted + self._departures.count(self.state, self._left)[1]

    @property
    def _left(self) -> np.ndarray:
        """Whether each part (M,) left the plate. Parts that the robot took are not counted."""
        return ~self.state.on_plate & ~self._robot.has(self.state.ids)

    def _forget(self) -> None:
        """Remove parts that left the plate, if no later image can show them."""
        state, history = self.state, self._view.history
        if np.all(state.on_plate) or not (self._feeds or self._robot.taken):
            return
        away = ~state.on_plate & ~history.shows(len(state.ids))
        if not self._feeds:
            away &= self._robot.has(state.ids)
        if not np.any(away):
            return
        self._departures.forget(state, self._left & away)
        self._take_over(state.take(~away), self._field.unit[~away], history.take(~away))
        self._robot.taken &= set(self.state.ids)

    def _drop(self) -> None:
        """Drop a part from the hopper if there is free space for it."""
        part = self._hopper.drop(self.state)
        if part is None:
            return
        name = f"{part.label}_{self._next_number(part.label)}"
        state = self.state.joined(name, part.position, part.angle)
        unit = np.append(self._field.unit, part.unit)
        self._take_over(state, unit, self._view.history.joined(part.position))

    def shots(self, begin: float) -> Iterator[Shot]:
        """Yield the images of a free-running camera from `begin` [s] on. The sequence has no
        end."""
        return self._view.shots(begin)

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered now. Return None if it is
        missing.

        `age` is the time since the middle of the exposure of the image [s]. If it is None, the
        exposure began `latency` ago.
        """
        return self._view.capture(self.state, self.plate, self._robot, self._time, age)

    def sight(self, age: float | None = None) -> Sight | None:
        """Return the exact content of the image that `capture` would return. Call only one of the
        two for an image."""
        return self._view.sight(self.state, self.plate, age)

    def capture_bare(self) -> np.ndarray:
        """Return an image (height, width) or (height, width, 3), uint8, of the bare plate at
        home."""
        return self._view.capture_bare(self._time)

    def run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Simulate a commanded cycle, or a motion that a motor controller has executed.

        The parts move until the end of the cycle. Parts may drop from an open hopper.
        """
        self._forget()
        if not self._hopper.is_open:
            self._run(cycle)
            return
        begin, end = 0.0, cycle.period
        for at in self._hopper.after(end):
            if at - begin > MIN_S:
                at = at if end - at > MIN_S else end
                self._run(PlateMotion.piece(cycle, begin, at))
                begin = at
            self._drop()
        if begin == 0:
            self._run(cycle)
        elif begin < end:
            self._run(PlateMotion.piece(cycle, begin, end))

    def _run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Simulate the parts until the end of a cycle or of a piece of a cycle."""
        self._time += cycle.period
        motion: PlateCycle | PlateMotion = cycle
        limit = self._limit
        if self._rig.suspension is not None:
            motion, self.plate = realise(self._rig, self.plate, cycle)
        past = self._view.past
        for path in self._move([self], [motion], [limit], 1, every=1 if past else 0):
            plate = PlateMotion(motion.times, motion.coefficients)
            self._view.history = self._view.history.after(
                Passage(plate, path, self.state.on_plate), past
            )

    @staticmethod
    def run_together(
        simulations: Sequence[Simulation], cycles: Sequence[PlateCycle], threads: int
    ) -> None:
        """Do the same as `run` for several plates with one rig, in parallel threads. The results
        are equal to the last bit."""
        plain: dict[tuple[str, ...], list[tuple[Simulation, PlateCycle]]] = {}
        for own, cycle in zip(simulations, cycles, strict=True):
            if own._view.past or own._feeds or own._robot.taken or own._rig.suspension is not None:
                own.run(cycle)
            else:
                plain.setdefault(own.state.ids, []).append((own, cycle))
                own._time += cycle.period
        for alike in plain.values():
            worlds, motions = zip(*alike, strict=True)
            Simulation._move(worlds, motions, [world._limit for world in worlds], threads)

    @staticmethod
    def _move(
        worlds: Sequence[Simulation],
        motions: Sequence[PlateCycle | PlateMotion],
        limits: Sequence[np.ndarray],
        threads: int,
        every: int = 0,
    ) -> list[BodyTrajectory]:
        """Simulate the same parts on several plates with one rig, see `step.run_together`."""
        own = worlds[0]
        states, paths = run_together(
            [world.state for world in worlds], motions, own._shapes, limits, own._rig,
            own._contacts, [world.disturbances.ground for world in worlds], threads, every=every,
        )  # fmt: skip
        for world, state in zip(worlds, states, strict=True):
            world.state = state
        return paths


def _check(**values: float) -> None:
    for name, value in values.items():
        low, high = WORLD_RANGES[name]
        if not low <= value <= high:
            raise PlateError(f"{name} is {value:g}, allowed: {low:g} to {high:g}")


def _number(part_id: str) -> int:
    return int(part_id.rpartition("_")[2])
