"""Ids over thousands of images, against the true parts; noise of the drift.

Of whole sorts, as the camera sees them; and of a crowd of one type: the loop sorts it to and fro,
then its true paths are seen with parts missed, others that are none, and classes misread.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from harness import Result, Table
from plate_bringup.loop import Moment, Setup, run
from plate_core import Parts, PlateCycle, Rig, load_rig, part_class
from plate_core.tasks import Scenario, SortTask, load_scenario
from plate_driver.setpoints import prepare
from plate_planner import Planner
from plate_planner.estimation import Estimator
from plate_sim import Disturbances, Simulation
from plate_sim.world import NONE
from plate_solver import Controller
from plate_vision import Prediction, Tracker, make_vision, observe
from plate_vision.tracking import update
from tasks.runs import sorting

FRAMES, DIRTY_FRAMES = 10_000, 2_000
"""Images of the clean world and of each of the others."""

FIRST_SEED = 20_000
"""Of the sorts that are looked at; others than any that were tuned on."""

WORLDS = {
    "clean": NONE,
    "uneven friction": Disturbances(friction_spread=0.1, friction_patches=0.1),
    "5 % of parts missed": Disturbances(missed_parts=0.05),
    "5 % missed, 2 % false": Disturbances(missed_parts=0.05, false_parts=0.02),
}

CROWD, CROWD_FRAMES, PATH_FRAMES = 30, 6_000, 600
"""Parts of one type, images of them, and of those how many are of one path of the loop."""

TURN_BACK, SHORTEST_LEG = 0.45, 10
"""The crowd is to sort itself the other way round once this fraction of it has come to its side,
but not before so many cycles: so parts pass each other at speed all the time."""

GOAL = 0.3
"""How far the sides begin from the middle [fraction of the half length]."""

CENTRE_M = 2e-5
"""Scatter of a centre along each axis, as the camera sees it [m]."""

MISSED, FALSE, MISREAD = 0.05, 0.02, 0.03
"""Fractions of the crowd: not seen in an image, seen where nothing is, and seen as of another
class."""

DEFAULT_PERIOD = 0.1
"""Length of a cycle until it is known [s]."""

STILL_S = 20.0
"""How long still parts are looked at, for the noise of their drift [s]."""

STILL_RATE = 30.0
"""Images a second of that."""


@dataclass
class Identities:
    """Compares ids with true names, image by image of one run.

    Attributes
    ----------
    reach : float
        Nearer than this to a true part [m], what is seen is that part.
    near : float
        Distance of two parts of one class that counts as a near pass [m].
    owner : dict
        True name of each id.
    """

    reach: float
    near: float
    owner: dict[str, str] = field(default_factory=dict)
    named: dict[str, str] = field(default_factory=dict)
    count: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("frames", "swaps", "renamed", "ghosts", "near"), 0)
    )
    closest: float = np.inf

    def take(self, parts: Parts, names: tuple[str, ...], position: np.ndarray) -> None:
        """Compare what is seen with true parts `names` at `position` (M, 2) [m]."""
        self.count["frames"] += 1
        self._passes(names, position)
        for name, place in zip(parts.ids, parts.position, strict=True):
            gap = np.linalg.norm(position - place, axis=1)
            true = int(np.argmin(gap))
            if gap[true] > self.reach:
                self.count["ghosts"] += 1
                continue
            self.count["swaps"] += self.owner.setdefault(name, names[true]) != names[true]
            self.count["renamed"] += self.named.setdefault(names[true], name) != name
            self.owner[name], self.named[names[true]] = names[true], name

    def _passes(self, names: tuple[str, ...], position: np.ndarray) -> None:
        kind = np.array([part_class(name) for name in names])
        gap = np.linalg.norm(position[:, None] - position, axis=2)
        pair = np.triu(kind[:, None] == kind, 1)
        self.closest = min(self.closest, float(np.min(gap[pair], initial=np.inf)))
        self.count["near"] += int(np.count_nonzero(gap[pair] < self.near))


def sorts(disturbances: Disturbances, frames: int, first_seed: int) -> Iterator[list[Moment]]:
    """Yield whole runs of `sort_10` until there are enough images."""
    seed = first_seed
    while frames > 0:
        moments = list(run(Setup("sort_10", seed, disturbances=disturbances)))
        yield moments[:frames]
        frames -= len(moments)
        seed += 1


def measure(quick: bool) -> Result:
    """Count swaps of ids in each world, and measure the noise of the drift."""
    rig = load_rig()
    rows = []
    worlds = {"clean": NONE} if quick else WORLDS
    for world, disturbances in worlds.items():
        total = Identities(0.5 * rig.parts.radius_m, 2.5 * rig.parts.radius_m)
        runs, frames = 0, FRAMES if world == "clean" else DIRTY_FRAMES
        for moments in sorts(disturbances, 100 if quick else frames, FIRST_SEED):
            runs += 1
            total = replace(total, owner={}, named={})
            for moment in moments:
                on = moment.world.on_plate
                names = tuple(n for n, there in zip(moment.world.ids, on, strict=True) if there)
                total.take(moment.parts, names, moment.world.position[on])
        rows.append(
            {"world": world, "runs": runs, **total.count, "closest_mm": 1e3 * total.closest}
        )
    noise = drift_noise(2.0 if quick else STILL_S)
    many = crowd(quick)
    tables = [identity_table(rows), crowd_table(many), noise_table(noise)]
    return Result(tables)


@dataclass(frozen=True)
class Instant:
    """The start of one cycle: true parts, and the cycle that begins.

    Attributes
    ----------
    time : float
        [s].
    ids : tuple of str
        Those on the plate.
    position : (M, 2)
        [m].
    cycle : PlateCycle
    """

    time: float
    ids: tuple[str, ...]
    position: np.ndarray
    cycle: PlateCycle


def to_and_fro(rig: Rig, frames: int, seed: int) -> Iterator[Instant]:
    """Yield the starts of cycles of a loop that sorts a crowd one way and then the other; the
    planner is shown the true parts."""
    there, back = (_sort(*sides) for sides in (("black", "grey"), ("grey", "black")))
    uneven = Disturbances(friction_spread=0.1, friction_patches=0.1)
    simulation = Simulation(rig, there, seed, uneven)
    planners = [Planner(rig, scenario) for scenario in (there, back)]
    state = planners[0].start(planners[0].initial())
    controller, running, now, since = Controller(rig, seed=seed), PlateCycle.rest(0.1), 0.0, 0
    last = simulation.state.position
    for _ in range(frames):
        world, on = simulation.state, simulation.state.on_plate
        ids = tuple(name for name, here in zip(world.ids, on, strict=True) if here)
        yield Instant(now, ids, world.position[on], running)
        drift = (world.position - last)[on] / running.period
        last = world.position
        parts = Parts.make(ids, world.position[on], drift, world.angle[on])
        state, wanted, progress = planners[0].plan(state, parts, now)
        answer = controller.answer(wanted, running)
        table, _ = prepare(rig, answer.cycle, round(now * 1e9))
        state = planners[0].hear(state, table.cycle, now)
        simulation.run(running)
        now, running, since = now + running.period, table.cycle, since + 1
        if since >= SHORTEST_LEG and progress.parts_sorted >= TURN_BACK * CROWD:
            planners, since = planners[::-1], 0
            state = planners[0].start(planners[0].initial(state.estimator))


def _sort(left: str, right: str) -> Scenario:
    """Return the task to sort a crowd of two halves."""
    scenario = sorting(CROWD)
    assert isinstance(scenario.task, SortTask)
    regions = scenario.task.regions
    sides = {left: regions["black"], right: regions["grey"]}
    return replace(scenario, task=replace(scenario.task, regions=sides, goal_fraction=GOAL))


def follow_crowd(
    rig: Rig,
    path: list[Instant],
    rng: np.random.Generator,
    total: Identities,
    types: int,
    predict: bool,
) -> None:
    """Follow the parts of a path through images that miss some and show others, and count.

    The planner's filter gets what the tracker makes of them, as in the loop.

    Parameters
    ----------
    rig : Rig
    path : list of Instant
    rng : Generator
        Of what is missed and false.
    total : Identities
        Counts.
    types : int
        1: all look alike; 2: of two classes, which are misread at times.
    predict : bool
        Whether the tracker gets the planner's predictions.
    """
    tracker, estimator = Tracker(), Estimator.of(rig, DEFAULT_PERIOD, None)
    expected: Prediction | None = None
    before: float | None = None
    for instant in path:
        if before is not None:
            estimator = estimator.hear(instant.cycle, before)
        before = instant.time
        place, label = _seen(rig, instant, rng, types)
        known = expected if predict else None
        tracker = update(tracker, instant.time, place, label, expected=known)
        total.take(tracker.parts, instant.ids, instant.position)
        estimator = estimator.update(tracker.parts, instant.time)
        start = estimator.start_of(estimator.parts)
        if start is not None:
            expected = Prediction(estimator.parts.ids, estimator.next_start, start[:, :2])


def _seen(
    rig: Rig, instant: Instant, rng: np.random.Generator, types: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return places (M, 2) [m] and classes (M,) of what an image shows."""
    there = rng.random(len(instant.ids)) >= MISSED
    true = instant.position[there] + CENTRE_M * rng.standard_normal((np.count_nonzero(there), 2))
    false = rng.binomial(len(instant.ids), FALSE)
    place = np.concatenate([true, rig.plate.half * rng.uniform(-1, 1, (false, 2))])
    kind = np.zeros(len(place), dtype=int)
    if types > 1:
        own = np.array([part_class(name) == "grey" for name in instant.ids])[there]
        kind[: len(own)] = own ^ (rng.random(len(own)) < MISREAD)
        kind[len(own) :] = rng.integers(0, types, false)
    order = rng.permutation(len(place))
    return place[order], np.array(["black", "grey"])[kind[order]]


def crowd(quick: bool) -> list[dict[str, Any]]:
    """Count swaps of ids in a crowd: by prediction and by drift, of one type and of two."""
    rig = load_rig()
    frames = 40 if quick else CROWD_FRAMES
    ways = {
        "one type": (1, True),
        f"two types, {100 * MISREAD:g} % misread": (2, True),
        "one type, without predictions": (1, False),
    }
    totals = {way: Identities(0.5 * rig.parts.radius_m, 2.5 * rig.parts.radius_m) for way in ways}
    speeds = []
    for number, seed in enumerate(range(FIRST_SEED, FIRST_SEED + -(-frames // PATH_FRAMES))):
        path = [*to_and_fro(rig, min(PATH_FRAMES, frames), seed)]
        speeds.append(_speed(path))
        for way, (types, predict) in ways.items():
            totals[way] = replace(totals[way], owner={}, named={})
            rng = np.random.default_rng([FIRST_SEED, number])
            follow_crowd(rig, path, rng, totals[way], types, predict)
    speed = 1e3 * float(np.sqrt(np.mean(np.square(speeds))))
    return [
        {
            "world": way, "runs": len(speeds), **total.count, "closest_mm": 1e3 * total.closest,
            "speed_mm_s": speed,
        }
        for way, total in totals.items()
    ]  # fmt: skip


def _speed(path: list[Instant]) -> float:
    """Return the root mean square speed of the parts from image to image [m/s]."""
    ways = []
    for one, after in pairwise(path):
        place = dict(zip(one.ids, one.position, strict=True))
        pairs = zip(after.ids, after.position, strict=True)
        moved = [now - place[name] for name, now in pairs if name in place]
        ways.append(np.array(moved) / (after.time - one.time))
    return float(np.sqrt(np.mean(np.sum(np.concatenate(ways) ** 2, axis=1))))


def drift_noise(seconds: float) -> dict[str, Any]:
    """Noise of the drift of still parts on the default rig."""
    rig = load_rig()
    simulation = Simulation(rig, load_scenario("sort_10"), FIRST_SEED)
    vision, tracker, drift = make_vision(rig), Tracker(), []
    for k in range(int(seconds * STILL_RATE)):
        image = simulation.capture()
        if image is not None:
            tracker = observe(vision, tracker, image, k / STILL_RATE)
            drift.append(tracker.parts.velocity)
    still = 1e3 * np.array(drift[1:])  # the first image knows no drift
    return {
        "frames": len(still),
        "parts": still.shape[1],
        "rms_mm_s": float(still.std()),
        "worst_mm_s": float(still.std(axis=0).max()),
        "largest_mm_s": float(np.abs(still).max()),
    }


def identity_table(rows: list[dict[str, Any]]) -> Table:
    """Return the table of ids."""
    return Table(
        "identity",
        "ids over images of whole sorts",
        {
            "world": "world", "runs": "runs", "frames": "images", "near": "near passes",
            "closest_mm": "closest centres [mm]", "swaps": "swapped ids",
            "renamed": "new ids of known parts", "ghosts": "ids of nothing",
        },
        rows,
        "sort_10 in the closed loop, image noise on, parts of 8 mm radius. Near "
        "passes: pairs of one class and images in which their centres are within 2.5 radii.",
    )  # fmt: skip


def crowd_table(rows: list[dict[str, Any]]) -> Table:
    """Return the table of ids of the crowd."""
    return Table(
        "identity_crowd",
        f"ids of {CROWD} parts sorted to and fro",
        {
            "world": "tracked", "runs": "paths", "frames": "images",
            "speed_mm_s": "speed, RMS [mm/s]", "near": "near passes",
            "closest_mm": "closest centres [mm]", "swaps": "swapped ids",
            "renamed": "new ids of known parts", "ghosts": "ids of nothing",
        },
        rows,
        f"True paths of the loop, 5 images a second; {100 * MISSED:g} % missed, {100 * FALSE:g} % "
        "false.",
    )  # fmt: skip


def noise_table(row: dict[str, Any]) -> Table:
    """Return the table of the drift's noise."""
    return Table(
        "drift_noise",
        f"drift of still parts, {STILL_RATE:g} images a second",
        {
            "parts": "parts", "frames": "images", "rms_mm_s": "standard deviation [mm/s]",
            "worst_mm_s": "of the worst part [mm/s]", "largest_mm_s": "largest [mm/s]",
        },
        [row],
        "Default rig and camera noise; the drift is that of the last two images.",
    )  # fmt: skip
