"""One run of the world as node and bench see it: images out, plate cycles in."""

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
"""Of a simulation: allowed values."""

TRIAL_S = 1e-3
"""Length of the rest in which a part that is put down must lie clear of the others [s]."""

SHORTEST_S = 1e-6
"""Shorter pieces of a cycle are not run for themselves [s]."""


class Simulation:
    """A scenario's parts on a rig's plate.

    Parameters
    ----------
    rig : Rig
        What all stages believe of the rig; with a suspension the plate does not quite obey.
    scenario : Scenario
        Gives the parts.
    seed : int
        Of all chance; what one kind of disturbance draws does not depend on the others.
    disturbances : Disturbances
        What is unlike the rig's facts.
    noise : float
        Standard deviation of a pixel [grey values].
    mu_scale : float
        True friction over the rig's.
    contacts : Contacts

    Raises
    ------
    PlateError
        If noise or mu_scale is out of range.

    Attributes
    ----------
    state : WorldState
        The parts. Where the task is to feed, those that have left the plate are forgotten when the
        next cycle begins; so are, everywhere, those that the robot has taken.
    plate : PlateState
    disturbances : Disturbances
    dropped, chuted : int
        How many parts have left the plate otherwise than by hand or robot, since the beginning:
        elsewhere than over the side of the task's chute, and over it.
    chuted_classes : Counter of str
        The latter by class.
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
                f"image_rate is {disturbances.image_rate:g} with a trigger_phase, allowed: 0, "
                "as the rig file has the motor controller trigger the camera"
            )
        # The order is part of each seed's run.
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
        """Look up what the parts are."""
        types = [self._rig.part_type(part_class(name)) for name in self.state.ids]
        self._shapes = Shapes.of([footprint_of(part) for part in types])
        self._mu = np.array([part.mu for part in types], dtype=float)
        self._view.know(self.state.ids, types)

    @property
    def mu(self) -> np.ndarray:
        """True friction coefficients (M,) now."""
        mu = self._mu * self._mu_scale
        return self._field.friction(mu, self.state.position, self.plate.pose)

    @property
    def _limit(self) -> np.ndarray:
        """Greatest acceleration (M,) that friction gives each part now [m/s2]."""
        return self.mu * self._rig.friction.gravity

    def change(self, disturbances: Disturbances, noise: float, mu_scale: float) -> None:
        """Go on in another world. When images are taken does not change: `latency`, `image_rate`.

        A run is then no longer repeated by its seed alone.

        Raises
        ------
        PlateError
            If noise or mu_scale is out of range, or parts get a height and the rig does not give
            the camera's place.
        """
        _check(noise=noise, mu_scale=mu_scale)
        check_height(self._rig, disturbances)
        self.disturbances, self._mu_scale = disturbances, mu_scale
        self._view.change(disturbances, noise)
        self._know_types()
        self._field = replace(
            self._field, spread=disturbances.friction_spread, share=disturbances.friction_patches
        )

    def place(self, part_id: str, label: str, position: np.ndarray, angle: float = 0.0) -> str:
        """Put a part down at rest, by hand.

        Parameters
        ----------
        part_id : str
            Of a part that is there, or has left the plate and is not forgotten; empty: a new one.
        label : str
            Type of the new one.
        position : (2,)
            Its centre [m, plate_home].
        angle : float
            [rad].

        Returns
        -------
        str
            Its id: of a new one the next number of its type.

        Raises
        ------
        PlateError
            If there is no such part or type, no more parts are allowed, or it would not lie on the
            plate, or on another part. Then nothing has changed.
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
        """Go on with parts of another run; what is their own of friction is lost."""
        self._take_over(state, np.zeros(len(state.ids)), History())

    def remove(self, part_id: str) -> None:
        """Take a part off the plate, by hand.

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
        """Go on with other parts."""
        for name in self.state.ids:
            label = part_class(name)
            self._last_number[label] = max(_number(name), self._last_number.get(label, 0))
        self.state, self._field = state, replace(self._field, unit=unit)
        self._view.history = history
        self._know_types()

    def _next_number(self, label: str) -> int:
        """Return the number of the next part of a class: none is used twice."""
        there = max((_number(i) for i in self.state.ids if part_class(i) == label), default=0)
        return 1 + max(there, self._last_number.get(label, 0))

    def open_hopper(self, duration_s: float) -> int:
        """Let parts drop for a time from now [s], in place of what is left of an earlier one.

        One drops after each 1/rate s in which it is open. A part for which there is no room stays
        in the hopper: while `MOST_PARTS` are on the plate, or where the heap reaches its edge.

        Returns
        -------
        int
            How many parts drop in that time if there is room.

        Raises
        ------
        PlateError
            If the task has no hopper, the time is not allowed, or the plate is full.
        """
        return self._hopper.open(duration_s, self.state)

    def move_robot(self, to: int, x: float = 0.0, y: float = 0.0, angle: float = 0.0) -> Grip:
        """Move the robot, at once: images from now on show it where it then is.

        Parameters
        ----------
        to : int
            A `Move`: away; over a place, where its arm hides what is below it; or there, and to
            grip the nearest part, which then leaves the plate. With the probability `pick_failure`
            the part slips, and may be moved a little.
        x, y, angle : float
            Of the gripper [m, m, rad, plate_home]; not used if it goes away.

        Raises
        ------
        PlateError
            If the move is not known, or the gripper would not be over the plate.
        """
        now, failure = self._time, self.disturbances.pick_failure
        self.state, result = self._robot.move(
            self.state, to, (x, y, angle), failure, now, now - self._view.past
        )
        return result

    @property
    def dropped(self) -> int:
        """See above."""
        return self._departures.dropped + self._departures.count(self.state, self._left)[0]

    @property
    def chuted(self) -> int:
        """See above."""
        return self.chuted_classes.total()

    @property
    def chuted_classes(self) -> Counter[str]:
        """See above."""
        return self._departures.chuted + self._departures.count(self.state, self._left)[1]

    @property
    def _left(self) -> np.ndarray:
        """Which parts (M,) have left the plate otherwise than by the robot."""
        return ~self.state.on_plate & ~self._robot.has(self.state.ids)

    def _forget(self) -> None:
        """Forget parts that are gone, and that no image will show."""
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
        """Let a part fall out of the hopper, if there is room for it."""
        part = self._hopper.drop(self.state)
        if part is None:
            return
        name = f"{part.label}_{self._next_number(part.label)}"
        state = self.state.joined(name, part.position, part.angle)
        unit = np.append(self._field.unit, part.unit)
        self._take_over(state, unit, self._view.history.joined(part.position))

    def shots(self, begin: float) -> Iterator[Shot]:
        """Yield the images of a camera that runs free, from `begin` [s] on, without end."""
        return self._view.shots(begin)

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered now; None if it is missed.

        `age` is the time since the middle of its exposure [s]; if None its exposure began
        `latency` ago.
        """
        return self._view.capture(self.state, self.plate, self._robot, self._time, age)

    def sight(self, age: float | None = None) -> Sight | None:
        """Return what that image, in place of `capture`, would show to one who sees exactly."""
        return self._view.sight(self.state, self.plate, age)

    def capture_bare(self) -> np.ndarray:
        """Return an image (height, width) or (height, width, 3), uint8, of the bare plate at
        home."""
        return self._view.capture_bare(self._time)

    def run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Command a cycle, or what a motor controller has played, and move the parts to its end;
        some may drop out of the hopper meanwhile."""
        self._forget()
        if not self._hopper.is_open:
            self._run(cycle)
            return
        begin, end = 0.0, cycle.period
        for at in self._hopper.after(end):
            if at - begin > SHORTEST_S:
                at = at if end - at > SHORTEST_S else end
                self._run(PlateMotion.piece(cycle, begin, at))
                begin = at
            self._drop()
        if begin == 0:
            self._run(cycle)
        elif begin < end:
            self._run(PlateMotion.piece(cycle, begin, end))

    def _run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Move the parts to the end of a cycle, or of a piece of one."""
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
        """Do what `run` does, on plates with one rig, in one call on several cores: the same to the
        last bit."""
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
        """Move parts that are alike on plates with one rig; see `step.run_together`."""
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
