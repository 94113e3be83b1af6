"""One run of the world as node and bench see it: images out, plate cycles in."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from plate_core import MOST_PARTS, PlateCycle, PlateError, Rig, did_you_mean, part_class
from plate_core.rig import camera_place, row_delay
from plate_core.tasks import CLASSES, FeedTask, Scenario

from ..camera import NOISE, Camera, part_colours
from ..contacts import INELASTIC, Contacts
from ..friction.outline import footprint_of
from ..plate import PlateMotion, PlateState, realise
from .bodies import BodyTrajectory, Shapes
from .disturbances import NONE, Disturbances
from .feeding import (
    Flow,
    Grip,
    Move,
    check_duration,
    check_gripper,
    drop_part,
    grip,
    nudged,
    went_over,
)
from .friction_field import FrictionField
from .history import History, Passage
from .state import WorldState
from .step import run_cycle, run_together

EXPOSURES, LONGEST_STEP_S = 5, 3e-3
"""Least number of times during an image at which parts and plate are looked up, and the greatest
distance between two [s]: the plate turns round in no less than 20 ms."""

WORLD_RANGES = {"noise": (0.0, 50.0), "mu_scale": (0.1, 10.0)}
"""Of a simulation: allowed values."""

DRAWN = ("plate_grey", "room_grey", "defocus_px")
"""Disturbances of which the camera keeps images."""

FINEST_STAMP_S = 1e-4
"""Least distance of two stamps [s]."""

TRIAL_S = 1e-3
"""Length of the rest in which a part that is put down must lie clear of the others [s]."""

SHORTEST_S = 1e-6
"""Shorter pieces of a cycle are not run for themselves [s]."""

BANDS = 8
"""Bands of rows in which a rolling shutter shows the plate's edges."""


@dataclass(frozen=True)
class Shot:
    """An image of a camera that runs free: the middle of its exposure, its stamp, and when it is
    delivered [s]."""

    middle: float
    stamp: float
    delivered: float


@dataclass(frozen=True)
class Sight:
    """What an image shows: place (M, 2) [m, plate_home] and angle (M,) [rad] of each part, which of
    them are `seen` (M,), and the places (F, 2) of false parts [m]."""

    position: np.ndarray
    angle: np.ndarray
    seen: np.ndarray
    false: np.ndarray


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
        _check_height(rig, disturbances)
        if disturbances.image_rate > 0 and rig.camera.trigger is not None:
            raise PlateError(
                f"image_rate is {disturbances.image_rate:g} with a trigger_phase, allowed: 0, "
                "as the rig file has the motor controller trigger the camera"
            )
        generators = np.random.default_rng(seed).spawn(9)
        layout, self._pixel_rng, field, self._image_rng, self._part_rng, self._stamp_rng = (
            generators[:6]
        )
        self._hand_rng, self._hopper_rng, self._robot_rng = generators[6:]
        self.state = WorldState.of_scenario(scenario, rig, layout)
        self.plate = PlateState.at_rest()
        self.disturbances = disturbances
        self._rig, self._contacts, self._seed = rig, contacts, seed
        self._field = FrictionField.draw(disturbances, len(self.state.ids), field)
        self._noise, self._mu_scale = noise, mu_scale
        self._marked = scenario.marked
        self._feed = scenario.task if isinstance(scenario.task, FeedTask) else None
        self._flow, self._time = Flow(), 0.0
        self._robot: list[tuple[float, np.ndarray | None]] = [(0.0, None)]  # since when, where
        self._taken: frozenset[str] = frozenset()
        self._last_number: dict[str, int] = {}
        self._gone_dropped, self._gone_chuted = 0, Counter[str]()  # of parts that are forgotten
        self._history = History()
        self._know_types()

    def _know_types(self) -> None:
        """Look up what the parts are."""
        labels = [part_class(name) for name in self.state.ids]
        self._types = [self._rig.part_type(label) for label in labels]
        self._shapes = Shapes.of([footprint_of(part) for part in self._types])
        self._mu = np.array([part.mu for part in self._types], dtype=float)
        world = self.disturbances
        self._grey = part_colours(self._types, self._rig.camera.colour, world.greys)
        height = np.array([world.part_height_m or part.height_m for part in self._types])
        self._height = height if np.any(height) else None
        self._size = None
        if world.size_spread:
            units = [_own_number(self._seed, name) for name in self.state.ids]
            self._size = 1 + world.size_spread * np.array(units)
        self._typed = any(label in self._rig.types for label in labels)

    @cached_property
    def _camera(self) -> Camera:
        """Made for the first image: it takes as long as a hundred cycles."""
        world = self.disturbances
        return Camera(
            self._rig, self._noise, plate=world.plate_grey, room=world.room_grey,
            defocus_px=world.defocus_px,
        )  # fmt: skip

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
        _check_height(self._rig, disturbances)
        before = self.disturbances
        self.disturbances, self._mu_scale, self._noise = disturbances, mu_scale, noise
        if any(getattr(before, name) != getattr(disturbances, name) for name in DRAWN):
            self.__dict__.pop("_camera", None)  # what it keeps is drawn again
        self._camera.noise = noise
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
        state = self.state
        if part_id and part_id not in state.ids:
            raise PlateError(self._unknown(part_id))
        kinds = tuple(self._rig.types) or CLASSES
        label = part_class(part_id) if part_id else label
        if label not in kinds:
            hint = did_you_mean(label[:50], kinds)
            raise PlateError(f"type is {label[:50]!r}{hint}, allowed: {', '.join(kinds)}")
        if not part_id and len(state.ids) >= MOST_PARTS:
            raise PlateError(f"{len(state.ids)} parts are there, allowed: at most {MOST_PARTS}")
        room = self._rig.plate.half - self._rig.part_type(label).reach_m
        if not np.all(np.abs(position) <= room + 1e-9):  # so where one is NaN
            raise PlateError(
                f"place is ({position[0]:g}, {position[1]:g}) m, allowed for {label}: |x| up to "
                f"{room[0]:g}, |y| up to {room[1]:g} m"
            )
        if not np.isfinite(angle):
            raise PlateError(f"angle is {angle:g}, allowed: finite")
        unit = self._field.unit
        number = 0
        if not part_id:
            number = self._next_number(label)
            part_id, unit = f"{label}_{number}", np.append(unit, self._hand_rng.uniform(-1, 1))
            state = state.joined(part_id, position, 0.0)
        row = np.array([name == part_id for name in state.ids])
        state = replace(
            state,
            position=np.where(row[:, None], position, state.position),
            velocity=np.where(row[:, None], 0.0, state.velocity),
            on_plate=state.on_plate | row,
            angle=np.where(row, np.remainder(angle, 2 * np.pi), state.angle),
            spin=np.where(row, 0.0, state.spin),
        )
        run_cycle(state, PlateCycle.rest(TRIAL_S), self._rig)
        if number:
            self._last_number[label] = number
        self._taken -= {part_id}
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
        if part_id not in state.ids:
            raise PlateError(self._unknown(part_id))
        keep = np.array([name != part_id for name in state.ids])
        self._take_over(state.take(keep), self._field.unit[keep], History())

    def _take_over(self, state: WorldState, unit: np.ndarray, history: History) -> None:
        """Go on with other parts."""
        for name in self.state.ids:
            label = part_class(name)
            self._last_number[label] = max(_number(name), self._last_number.get(label, 0))
        self.state, self._field, self._history = state, replace(self._field, unit=unit), history
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
        hopper = self._feed.hopper if self._feed is not None else None
        if hopper is None:
            raise PlateError("this scenario has no hopper, allowed: one of the kind feed that does")
        check_duration(duration_s)
        there = int(np.count_nonzero(self.state.on_plate))
        if duration_s > 0 and there >= MOST_PARTS:
            raise PlateError(f"{there} parts are on the plate, allowed: at most {MOST_PARTS}")
        self._flow = replace(self._flow, left_s=float(duration_s))
        return len(self._flow.after(duration_s, hopper.rate)[1])

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
        if to not in set(Move):
            raise PlateError(f"to is {to}, allowed: 0 (away), 1 (over), 2 (grip)")
        if to == Move.AWAY:
            self._robot_goes(None)
            return Grip(True, message="the robot is away")
        check_gripper(x, y, angle, self._rig)
        self._robot_goes(np.array([x, y]))
        if to == Move.OVER:
            return Grip(True, message=f"the robot is over ({x:.4f}, {y:.4f}) m")
        state = self.state
        rng = self._robot_rng.spawn(1)[0]  # so that what a grip draws does not depend on others
        slips = bool(rng.random() < self.disturbances.pick_failure)
        result = grip(state, self._rig, (x, y, angle), slips, self._marked)
        row = np.array([name == result.id for name in state.ids], bool)
        if result.success:
            self._taken |= {result.id}
            self.state = replace(state, on_plate=state.on_plate & ~row)
        elif result.id:
            place, turned = nudged(state, self._rig, result.id, rng)
            self.state = replace(
                state,
                position=np.where(row[:, None], place, state.position),
                velocity=np.where(row[:, None], 0.0, state.velocity),
                angle=np.where(row, turned, state.angle),
                spin=np.where(row, 0.0, state.spin),
            )
        return result

    def _robot_goes(self, place: np.ndarray | None) -> None:
        shown = self._time - self._past
        begin = max(i for i, (since, _) in enumerate(self._robot) if since <= max(shown, 0.0))
        self._robot = [*self._robot[begin:], (self._time, place)]

    def _robot_ago(self, age: float) -> np.ndarray | None:
        """Return where the gripper (2,) was some time ago [m, plate_home]; None: away."""
        there = [place for since, place in self._robot if since <= max(self._time - age, 0.0)]
        return there[-1]

    @property
    def dropped(self) -> int:
        """See above."""
        return self._gone_dropped + self._gone()[0]

    @property
    def chuted(self) -> int:
        """See above."""
        return self.chuted_classes.total()

    @property
    def chuted_classes(self) -> Counter[str]:
        """See above."""
        return self._gone_chuted + self._gone()[1]

    def _gone(self, rows: np.ndarray | None = None) -> tuple[int, Counter[str]]:
        """Return how many parts, of all or of those in some rows (M,), left the plate elsewhere
        than over the chute, and by class over it."""
        state = self.state
        taken = np.array([name in self._taken for name in state.ids], bool)
        left = ~state.on_plate & ~taken & (True if rows is None else rows)
        chute = self._feed.chute if self._feed is not None else None
        if chute is None:
            return int(np.count_nonzero(left)), Counter()
        over = went_over(chute, state.position, self._rig)
        labels = Counter(part_class(state.ids[k]) for k in np.flatnonzero(left & over))
        return int(np.count_nonzero(left & ~over)), labels

    def _forget(self) -> None:
        """Forget parts that are gone, and that no image will show."""
        state = self.state
        if np.all(state.on_plate) or not (self._feed or self._taken):
            return
        away = ~state.on_plate & ~self._history.shows(len(state.ids))
        if self._feed is None:
            away &= np.array([name in self._taken for name in state.ids])
        if not np.any(away):
            return
        dropped, chuted = self._gone(away)
        self._gone_dropped, self._gone_chuted = (
            self._gone_dropped + dropped, self._gone_chuted + chuted,
        )  # fmt: skip
        self._take_over(state.take(~away), self._field.unit[~away], self._history.take(~away))
        self._taken &= set(self.state.ids)

    def _drop(self) -> None:
        """Let a part fall out of the hopper, if there is room for it."""
        assert self._feed is not None
        assert self._feed.hopper is not None
        if np.count_nonzero(self.state.on_plate) >= MOST_PARTS:
            return
        rng = self._hopper_rng.spawn(1)[0]  # so that what is drawn for a part is its own
        part = drop_part(self._feed.hopper, self.state, self._rig, rng)
        if part is None:
            return
        name = f"{part.label}_{self._next_number(part.label)}"
        state = self.state.joined(name, part.position, part.angle)
        unit = np.append(self._field.unit, part.unit)
        self._take_over(state, unit, self._history.joined(part.position))

    def _unknown(self, part_id: str) -> str:
        hint = did_you_mean(part_id[:50], self.state.ids)
        return f"id is {part_id[:50]!r}{hint}, allowed: {', '.join(self.state.ids) or 'none'}"

    def shots(self, begin: float) -> Iterator[Shot]:
        """Yield the images of a camera that runs free, from `begin` [s] on, without end."""
        camera, world, rng = self._rig.camera, self.disturbances, self._stamp_rng
        interval, last = 1 / max(world.image_rate, 1e-9), -np.inf
        shown = camera.exposure_s + camera.readout_s
        middle = begin + interval * rng.random()
        while True:
            jitter = world.stamp_jitter * rng.standard_normal()
            # A camera's driver stamps images in the order in which they come.
            last = max(middle + world.latency + jitter, last + FINEST_STAMP_S)
            yield Shot(middle, last, middle + max(world.latency, shown / 2))
            middle += interval

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered now; None if it is missed.

        `age` is the time since the middle of its exposure [s]; if None its exposure began
        `latency` ago.
        """
        shown = self._chance()
        if shown is None:
            return None
        hidden, place, like = shown
        path, angle, seen, pose = self._view(age)
        false = len(like)
        drawn = np.append(np.flatnonzero(seen & ~hidden), like)
        spots = np.broadcast_to(place, (len(path), false, 2))
        there = path[:, drawn[: len(drawn) - false]]
        turned = self._marked or self._typed
        old = self.disturbances.latency if age is None else age
        return self._camera.render(
            np.concatenate([there, spots], axis=1),
            self._grey[drawn],
            self._pixel_rng,
            pose=pose,
            angle=np.append(angle[drawn[: len(drawn) - false]], np.zeros(false))
            if turned
            else None,
            types=[self._types[i] for i in drawn] if self._typed else None,
            lighting=self.disturbances.lighting(self._time - old),
            gripper=self._robot_ago(old),
            height=None if self._height is None else self._height[drawn],
            size=None if self._size is None else self._size[drawn],
        )

    def sight(self, age: float | None = None) -> Sight | None:
        """Return what that image, in place of `capture`, would show to one who sees exactly."""
        shown = self._chance()
        if shown is None:
            return None
        hidden, place, _ = shown
        path, angle, seen, _ = self._view(age)
        return Sight(path[len(path) // 2], angle, seen & ~hidden, place)

    def _chance(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Draw which parts an image hides (M,), the places (F, 2) of false ones [m], and which part
        (F,) each looks like; None: the image is missed."""
        count, world = len(self._types), self.disturbances
        if not (world.missed_images or world.missed_parts or world.false_parts):
            return np.zeros(count, bool), np.zeros((0, 2)), np.zeros(0, np.int64)
        missed = self._image_rng.random() < self.disturbances.missed_images
        hidden = self._part_rng.random(count) < self.disturbances.missed_parts
        false = self._part_rng.binomial(count, self.disturbances.false_parts)
        place = self._rig.plate.half * self._part_rng.uniform(-1, 1, (false, 2))
        like = self._part_rng.choice(count, false)
        return None if missed else (hidden, place, like)

    def capture_bare(self) -> np.ndarray:
        """Return an image (height, width) or (height, width, 3), uint8, of the bare plate at
        home."""
        return self._camera.render(
            np.zeros((0, 2)), self._grey[:0], self._pixel_rng,
            lighting=self.disturbances.lighting(self._time),
        )  # fmt: skip

    def run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Command a cycle, or what a motor controller has played, and move the parts to its end;
        some may drop out of the hopper meanwhile."""
        self._forget()
        if not self._flow.left_s:
            self._run(cycle)
            return
        assert self._feed is not None
        assert self._feed.hopper is not None
        self._flow, drops = self._flow.after(cycle.period, self._feed.hopper.rate)
        begin, end = 0.0, cycle.period
        for at in drops:
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
        past = self._past
        for path in self._move([self], [motion], [limit], 1, every=1 if past else 0):
            plate = PlateMotion(motion.times, motion.coefficients)
            self._history = self._history.after(Passage(plate, path, self.state.on_plate), past)

    @staticmethod
    def run_together(
        simulations: Sequence[Simulation], cycles: Sequence[PlateCycle], threads: int
    ) -> None:
        """Do what `run` does, on plates with one rig, in one call on several cores: the same to the
        last bit."""
        plain: dict[tuple[str, ...], list[tuple[Simulation, PlateCycle]]] = {}
        for own, cycle in zip(simulations, cycles, strict=True):
            if own._past or own._feed or own._taken or own._rig.suspension is not None:
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

    @property
    def _past(self) -> float:
        """How much of the past an image may show [s]."""
        camera = self._rig.camera
        shown = camera.exposure_s + camera.readout_s
        anytime = self.disturbances.image_rate > 0 or camera.trigger is not None
        needed = anytime or camera.readout_s > 0
        return self.disturbances.latency + (shown if needed else 0.0)

    def _view(
        self, age: float | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """Return positions over the exposure (s, M, 2), angles (M,), which parts are there, and the
        plate's poses (s, 3), or (b, s, 3) by bands of rows; None if it is at home."""
        state, camera = self.state, self._rig.camera
        exposure = camera.exposure_s if self.disturbances.blur else 0.0
        if self._past and self._history.passages:
            shown = exposure + camera.readout_s
            first = self.disturbances.latency if age is None else age + shown / 2
            return self._past_view(first, exposure, shown)
        later = np.array([0.0, exposure])[:, None]
        path = state.position + later[:, None] * state.velocity
        if self._rig.suspension is None:
            return path, state.angle, state.on_plate, None
        pose = self.plate.pose + later * self.plate.twist
        return path, state.angle, state.on_plate, pose

    def _past_view(
        self, first: float, exposure: float, shown: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the same of an image whose first row began to be exposed `first` [s] ago; from
        then to the end of its last row it is `shown` [s]."""
        count = max(EXPOSURES, 1 + int(np.ceil(shown / LONGEST_STEP_S)))
        time = shown * np.linspace(0, 1, count)
        views = [self._history.ago(first - t) for t in time]
        path, pose = (np.stack([getattr(v, n) for v in views]) for n in ("position", "pose"))
        middle, readout = views[count // 2], self._rig.camera.readout_s
        # Parts that came or were taken since the last cycle are not in its history.
        there = middle.on_plate if first >= time[count // 2] else self.state.on_plate
        if readout == 0:
            return path, middle.angle, there, pose
        row = np.clip(row_delay(self._rig, middle.position) / readout + 0.5, 0, 1)
        begin = readout * np.append(row, (np.arange(BANDS) + 0.5) / BANDS)
        at = begin[:, None] + exposure * np.linspace(0, 1, EXPOSURES)
        parts = len(row)
        seen = np.empty((EXPOSURES, parts, 2))
        for i in range(parts):
            for axis in range(2):
                seen[:, i, axis] = np.interp(at[i], time, path[:, i, axis])
        poses = np.empty((BANDS, EXPOSURES, 3))
        for band in range(BANDS):
            for axis in range(3):
                poses[band, :, axis] = np.interp(at[parts + band], time, pose[:, axis])
        return seen, middle.angle, there, poses


def _check(**values: float) -> None:
    for name, value in values.items():
        low, high = WORLD_RANGES[name]
        if not low <= value <= high:
            raise PlateError(f"{name} is {value:g}, allowed: {low:g} to {high:g}")


def _check_height(rig: Rig, disturbances: Disturbances) -> None:
    """Refuse parts with a height if the camera's place is not known."""
    named = {f"types: {name}: height_m": part.height_m for name, part in rig.types.items()}
    heights = {
        "part_height_m": disturbances.part_height_m,
        "parts: height_m": rig.parts.height_m,
        **named,
    }
    high = [(name, value) for name, value in heights.items() if value > 0]
    if not high or (place := camera_place(rig)) is None:
        if high:
            raise PlateError(
                f"{high[0][0]} is {high[0][1]:g}, allowed: 0, as the rig file gives neither "
                "focal_px nor camera: height_m: the camera's place is not known"
            )
        return
    for name, value in high:
        if value >= place[2]:
            raise PlateError(f"{name} is {value:g}, allowed: below the camera, {place[2]:.3g} m")


def _own_number(seed: int, part_id: str) -> float:
    """Return a number of a part's own, -1 to 1, evenly: the same in each run of a seed."""
    rng = np.random.default_rng([seed, zlib.crc32(part_id.encode())])
    return float(rng.uniform(-1, 1))


def _number(part_id: str) -> int:
    return int(part_id.rpartition("_")[2])
