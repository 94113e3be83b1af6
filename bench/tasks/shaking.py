"""Baseline of the feeder: a plate that shakes all parts, takes an image, and shakes again.

Commercial flexible feeders work in this way. Simulator, camera, vision, robot and hopper are the
same as for the project's feeder.

The baseline takes an image while the robot is away and the plate rests. All parts that are ready in
one image are picked one after the other, without a further image. When no ready part is left, the
plate shakes until an image shows a ready part. The baseline starts to shake at the robot's last
grip. The project's feeder moves only after the robot has left the camera's view. The hopper opens
during a shake, by the same rule as for the project's feeder. An image takes 0.2 s for settling,
exposure and evaluation.

There are two kinds of shakes:

- Vibrated: the simulated plate moves in its plane as strongly as the rig allows, slowly in one
  direction and fast in the other. The plate's velocity over time is a Fejer kernel. A shake conveys
  and then stirs. Conveying moves the centre of the parts towards the centre of the pick window,
  along x, then along y. Stirring rotates the plate about two centres on its long axis, one after
  the other (a blinking vortex, which mixes well), in a random direction for each shake. A part that
  leaves over an edge costs only the time until the next drop, because commercial feeders have a
  border. No vibration in the plane spreads resting parts, because the field of mean friction forces
  has no divergence for any centre of rotation.
- Thrown: idealised vertical shakes, better than the shakes of any existing feeder. A shake takes
  0.6 s with settling. Each shake gives all parts new random positions and angles, uniformly
  distributed. The circumscribed discs of the parts do not overlap. Unlike the vibrated baseline,
  these shakes spread the parts.

The vibrated baseline was tuned with 20 discs, a clearance of 6 mm, a robot cycle of 2 s and seeds 0
to 9, for 60 s each. The candidates were 3 times of stirring, 3 fractions of the conveyed distance
and 2 waveforms. `STIR_S`, `CONVEY` and `HARMONICS` are the values with the most parts per minute.
The thrown baseline has no parameters to tune. The published results use other seeds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from plate_bringup.loop import Setup
from plate_bringup.production import Act, Production, Robot, Tally
from plate_core import Parts, PlateCycle, Rig, load_rig, part_class
from plate_core.motion import usage
from plate_core.tasks import FeedTask, free_gap, pick_window, ready_parts
from plate_sim import Move, Simulation, simulate
from plate_vision import Tracker, make_vision, observe
from plate_vision.bare_plate import BARE_IMAGES
from plate_vision.shapes import learn_plate

TICK_S = 0.1
"""Period at which the robot's state is updated while the plate rests [s], as in the project's
loop."""

IMAGE_TICKS, THROW_TICKS = 2, 6
"""Duration of an image with settling and evaluation, and of an idealised shake [`TICK_S`]."""

SAMPLES = 240
"""Number of samples per cycle."""

MAX_CYCLES, COAST_S = 10, 0.5
"""Maximum number of conveying cycles per shake and axis, and maximum time for which parts slide
afterwards [s]."""

TRIES = 2000
"""Maximum number of random positions tried for a thrown part."""


STIR_S, CONVEY = 0.8, 0.5
"""Stirring time per shake [s], and conveyed distance as a fraction of the distance to the pick
window's centre."""

PERIOD_S, HARMONICS = 0.1, 2
"""Period of a cycle [s], and number of harmonics of its velocity."""


def waveform() -> tuple[np.ndarray, np.ndarray]:
    """Return displacement and velocity (SAMPLES,) over a period of 1 s. The motion is slow in one
    direction and fast in the other."""
    t = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    order = np.arange(1, HARMONICS + 1)
    weight = 2 * (1 - order / (HARMONICS + 1))
    velocity = -weight @ np.cos(order[:, None] * t)
    position = -(weight / order) @ np.sin(order[:, None] * t) / (2 * np.pi)
    return position, velocity


def strongest_cycle(rig: Rig, axis: np.ndarray) -> PlateCycle:
    """Return the strongest cycle that the rig allows along an axis (3,) of the plate's pose."""
    position, velocity = (1e-3 * wave[:, None] * axis for wave in waveform())
    cycle = PlateCycle.from_samples(PERIOD_S, position, velocity / PERIOD_S)
    return cycle.scaled(1 / usage(rig, cycle).overall)


def conveyed_distances(rig: Rig, cycle: PlateCycle, axis: int) -> np.ndarray:
    """Return the distances (MAX_CYCLES,) [m] that a part moves along an axis in 1, 2, ... cycles,
    until it is at rest again."""
    distances = []
    for count in range(1, MAX_CYCLES + 1):
        position, velocity = np.zeros((1, 2)), np.zeros((1, 2))
        for motion, repeats in ((cycle, count), (PlateCycle.rest(COAST_S), 1)):
            found = simulate(
                motion, position, velocity, rig.friction.mu, rig.friction.gravity, repeats
            )
            position, velocity = found.position[-1], found.velocity[-1]
        distances.append(float(position[0, axis]))
    return np.array(distances)


class Shaker:
    """A plate that shakes and takes images, with its robot.

    Parameters
    ----------
    setup : Setup
        Setup of the run. Its scenario must be a recipe with a hopper.
    cycle_s : float
        Cycle time of the robot [s].
    is_thrown : bool
        Whether the baseline is the thrown baseline, with idealised shakes.
    """

    def __init__(self, setup: Setup, cycle_s: float, is_thrown: bool) -> None:
        recipe = setup.recipe
        self.rig, self.is_thrown = load_rig(recipe.rig), is_thrown
        assert isinstance(recipe.task, FeedTask)
        self.task: FeedTask = recipe.task
        self.simulation = Simulation(
            self.rig, recipe, setup.seed, setup.disturbances, noise=setup.noise
        )
        self.robot, self.tally = Robot.ready(cycle_s), Tally()
        self.listed: list[tuple[float, float, float]] = []
        self.parts = Parts.make((), np.zeros((0, 2)))
        self._requested = self._in_view = False
        self._rng = np.random.default_rng([setup.seed, 7])
        self._rest = PlateCycle.rest(TICK_S)
        self._vision = make_vision(self.rig)
        if self._vision.catalogue is not None:
            bare = np.stack([self.simulation.capture_bare() for _ in range(BARE_IMAGES)])
            self._vision = replace(self._vision, background=learn_plate(bare))
        centre = np.array([self.rig.plate.half[0] / 2, 0.0])
        self._rotations = [strongest_cycle(self.rig, rotation_about(c)) for c in (centre, -centre)]
        self._pushes = [strongest_cycle(self.rig, axis) for axis in np.eye(3)[:2]]
        self._conveyed = [
            conveyed_distances(self.rig, cycle, k) for k, cycle in enumerate(self._pushes)
        ]

    def run(self, time_s: float) -> Production:
        """Run the production for a time [s]."""
        steps = self._cycles()
        while self.tally.time_s < time_s:
            self._perform_robot_actions()
            self._simulate_cycle(next(steps))
        return Production.of(self.tally, self.robot, self.simulation, self.task)

    def _cycles(self) -> Iterator[PlateCycle]:
        """Yield the plate's cycles one after the other. The sequence is endless."""
        while True:
            yield from self._throw_cycles() if self.is_thrown else self._vibration_cycles()
            while self._in_view:
                yield self._rest
            image, stamp = None, self.tally.time_s
            for _ in range(IMAGE_TICKS):
                yield self._rest
                image = self.simulation.capture() if image is None else image
            if image is not None:
                self.parts = observe(self._vision, Tracker(), image, stamp, None).parts
                self.listed = self._grippable_parts()
            # rest while ready parts remain for the robot
            while self.listed or self.robot.pose is not None:
                yield self._rest

    def _grippable_parts(self) -> list[tuple[float, float, float]]:
        """Return the parts that are allowed to be gripped."""
        found = np.zeros(len(self.parts), dtype=bool)
        gap = free_gap(self.parts, self.rig)
        for pick in self.task.picks:
            found |= ready_parts(self.parts, pick, self.task.clearance_m, self.rig, gap)
        rows = np.flatnonzero(found)
        return [(*self.parts.position[i].tolist(), float(self.parts.angle[i])) for i in rows]

    def _open_hopper(self) -> float:
        """Open the hopper if parts are missing. Return the opening time [s]."""
        hopper, count = self.task.hopper, len(self.parts)
        if hopper is None or count >= hopper.least:
            return 0.0
        open_s = (hopper.fill - count) / hopper.rate
        self.simulation.open_hopper(open_s)
        return open_s

    def _throw_cycles(self) -> Iterator[PlateCycle]:
        ticks = max(THROW_TICKS, int(np.ceil(self._open_hopper() / TICK_S)))
        for _ in range(ticks):
            yield self._rest
        state = self.simulation.state
        on_plate = np.flatnonzero(state.on_plate)
        reach = np.array([self.rig.part_type(part_class(state.ids[i])).reach_m for i in on_plate])
        place = random_positions(reach, self.rig.plate.half, self._rng)
        position, angle = state.position.copy(), state.angle.copy()
        position[on_plate] = place
        angle[on_plate] = self._rng.uniform(-np.pi, np.pi, len(on_plate))
        self.simulation.state = replace(state, position=position, angle=angle)

    def _vibration_cycles(self) -> Iterator[PlateCycle]:
        open_s, began = self._open_hopper(), self.tally.time_s
        of_class = [part_class(name) == self.task.picks[0].label for name in self.parts.ids]
        if np.any(of_class):
            low, high = pick_window(self.task.picks[0], self.rig)
            displacement = (low + high) / 2 - self.parts.position[of_class].mean(axis=0)
            for axis, cycle in enumerate(self._pushes):
                far = CONVEY * abs(displacement[axis])
                for _ in range(int(np.searchsorted(self._conveyed[axis], far))):
                    yield cycle if displacement[axis] > 0 else reverse_cycle(cycle)
        for cycle in self._rotations:
            rotation = reverse_cycle(cycle) if self._rng.random() < 0.5 else cycle
            for _ in range(round(STIR_S / 2 / cycle.period)):
                yield rotation
        while self.tally.time_s < began + open_s:
            yield self._rest

    def _perform_robot_actions(self) -> None:
        """Perform the robot's actions that are due."""
        while True:
            before = self.robot
            self.robot, act = before.step(self.tally.time_s)
            if act is Act.REQUEST:
                self._requested = True
            if self._requested and self.listed:
                self.robot = self.robot.after_reply(self.listed[0], self.tally.time_s)
                self._requested = False
            if act is None:
                return
            if act is Act.LEAVE:
                self.simulation.move_robot(Move.AWAY)
                self._in_view = False
            elif act is Act.COME and before.pose is not None:
                self.simulation.move_robot(Move.OVER, *before.pose)
                self._in_view = True
            elif act is Act.GRIP and before.pose is not None:
                result = self.simulation.move_robot(Move.GRIP, *before.pose)
                self.tally.gripped(before, result)
                self.listed = self.listed[1:]

    def _simulate_cycle(self, cycle: PlateCycle) -> None:
        """Simulate a cycle."""
        self.simulation.run(cycle)
        self.tally.time_s += cycle.period


def rotation_about(centre: np.ndarray) -> np.ndarray:
    """Return the axis (3,) [m, m, rad] of small rotations about a point (2,) [m]."""
    return np.array([centre[1], -centre[0], 1.0])


def reverse_cycle(cycle: PlateCycle) -> PlateCycle:
    """Return a cycle with the opposite direction of motion."""
    return cycle.scaled(-1.0)


def random_positions(reach: np.ndarray, half: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return random positions (M, 2) [m] of disjoint discs with the radii `reach` (M,) [m], on a
    plate with half side lengths (2,) [m]. A disc for which no free space is found overlaps
    others."""
    position = np.zeros((len(reach), 2))
    for i, own_reach in enumerate(reach):
        for _ in range(TRIES):
            position[i] = (half - own_reach) * rng.uniform(-1, 1, 2)
            if np.all(np.hypot(*(position[:i] - position[i]).T) >= reach[:i] + own_reach):
                break
    return position
