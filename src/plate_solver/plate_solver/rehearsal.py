"""Whether a rig can do a task: it is rehearsed on the solver's own map, before it starts.

A rehearsal is the loop with the real solver and the rig's true limits, but with the solver's
prediction in place of plate and camera: answers come a cycle late, friction differs from part to
part, and parts never touch. What asks for the motions is simpler than the planner.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import pdist

from plate_core import Parts, PlateCycle, PlateError, Rig, Targets, Wanted
from plate_core.motion import usage
from plate_core.tasks import (
    AssembleTask,
    FollowTask,
    PathTask,
    Scenario,
    SortTask,
    region_outline,
    start_positions,
)

from .controller import IDLE_PERIOD, Controller
from .cycle_map import after

REHEARSALS = 3
"""Starts from which a task is rehearsed."""

MOST_CYCLES = 150
"""Of one rehearsal; what is left of the task then is estimated by the speed of its second half."""

UNEVEN = 0.1
"""Standard deviation of the parts' friction [the rig's]."""

BEYOND, GAP = 0.03, 0.5
"""How far into their regions parts are to go [fraction of half the plate], and least distance of
two parts [part radii]."""

LANE_AT, LANE_M, LANE_WEIGHT = 0.25, 0.1, 0.1
"""Parts for opposite sides keep to opposite halves of the plate, beyond this fraction of half its
width; what a metre beside counts for a part with a way as long as the second [m] or longer."""

FULL_WAY_M, LEAST_WAY_M = 0.006, 0.005
"""The longest way counts as if it were so long beside ways over an edge; ways below the second are
no longer stretched so [m]."""

BAND = 0.3
"""A part may stay this near to its place [tolerance]."""

NEAR, GAIN = 0.15, 0.8
"""How near parts are led to the starts of their paths [max_error_m], and which fraction of an error
is corrected in a cycle."""

LACKING, SLOW_DOWN, SPEED_UP, LEAST_PACE = 0.1, 0.7, 0.1, 0.05
"""A cycle that lacks more than this fraction of a path's speed takes the pace down to the second,
others add the third to it; none takes it below the last [-]."""

STILL = 0.5e-3
"""Parts that come nearer more slowly do not come nearer [m/s]."""


class Share(NamedTuple):
    """What motions use of the rig's limits, as fractions of them: medians over the cycles."""

    stroke: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    force: float = 0.0
    heat: float = 0.0

    @property
    def binds(self) -> str:
        """The limit of which most is used."""
        return self._fields[int(np.argmax(self))]


@dataclass(frozen=True)
class Rehearsal:
    """How a task went.

    Attributes
    ----------
    time_s : float
        Until it was done, with what was left after `MOST_CYCLES`; infinite where parts came no
        nearer.
    speed : float
        Mean over the parts until half of all ways was done [m/s].
    lost : bool
        Whether a part left the plate, or was farther from its path than allowed.
    share : Share
    """

    time_s: float
    speed: float
    lost: bool
    share: Share


class Verdict(NamedTuple):
    """Rehearsals of a task from several starts, and the time that it may take [s]."""

    rehearsals: tuple[Rehearsal, ...]
    time_limit_s: float

    @property
    def in_time(self) -> int:
        """How many ended well."""
        return sum(one.time_s <= self.time_limit_s and not one.lost for one in self.rehearsals)

    @property
    def likely(self) -> bool:
        """Whether most did."""
        return 2 * self.in_time > len(self.rehearsals)

    @property
    def time_s(self) -> float:
        """Median of the times [s]."""
        return float(np.median([one.time_s for one in self.rehearsals]))

    @property
    def speed(self) -> float:
        """Median of the parts' speeds [m/s]; not less than 0."""
        return max(float(np.median([one.speed for one in self.rehearsals])), 0.0)

    @property
    def share(self) -> Share:
        """Median of what is used of the limits."""
        return Share(*np.median([one.share for one in self.rehearsals], axis=0))


@dataclass(frozen=True)
class State:
    """What an answer can know of M parts.

    Attributes
    ----------
    labels : tuple of str
        Classes.
    position : (M, 2)
        At the start of the running cycle [m, plate_home].
    next_position, next_velocity : (M, 2)
        At its end, if friction is as in the rig file [m], [m/s].
    period : float
        Its length [s].
    plate : (3, 3)
        State of the plate at its end.
    """

    labels: tuple[str, ...]
    position: np.ndarray
    next_position: np.ndarray
    next_velocity: np.ndarray
    period: float
    plate: np.ndarray

    def wanted(self, **what: Any) -> Wanted:
        """Return a request for the next cycle."""
        ids = tuple(f"{name}_{k}" for k, name in enumerate(self.labels))
        start = np.hstack([self.next_position, self.next_velocity])
        return Wanted.make(Parts.make(ids, self.position), start=start, plate=self.plate, **what)


class Rules(Protocol):
    """What a task asks of its parts."""

    @property
    def hold_s(self) -> float:
        """How long it is to stay done [s]."""

    def ask(self, state: State) -> tuple[Wanted, np.ndarray]:
        """Return what is wanted in the next cycle, and the ways that are left (M,) [m]; infinite
        where a part has failed."""


def judge_task(rig: Rig, scenario: Scenario, rehearsals: int = REHEARSALS) -> Verdict:
    """Rehearse a task from several starts.

    Raises
    ------
    PlateError
        If the scenario does not fit on the plate.
    """
    done = tuple(rehearse(rig, scenario, seed) for seed in range(rehearsals))
    return Verdict(done, scenario.time_limit_s)


def rehearse(rig: Rig, scenario: Scenario, seed: int) -> Rehearsal:
    """Rehearse a task once, by Method B; the seed scatters parts and makes friction uneven.

    Raises
    ------
    PlateError
        If the scenario does not fit on the plate, or is not rehearsed: angles, moving.
    """
    rng = np.random.default_rng(seed)
    labels, position = start_positions(scenario, rig, rng)
    spread = 1 + UNEVEN * np.clip(rng.standard_normal(len(labels)), -2, 2)
    rules, controller = rules_of(scenario, rig), Controller(rig, seed=seed)
    cycle, velocity = PlateCycle.rest(IDLE_PERIOD), np.zeros_like(position)
    left: list[np.ndarray] = []
    times: list[float] = [0.0]
    shares: list[Share] = []
    while True:
        expected = after(cycle, position, velocity, rig.friction.accel)
        wanted, to_go = rules.ask(State(labels, position, *expected, cycle.period, cycle.state(-1)))
        left.append(np.where(np.isfinite(to_go), to_go, 0.0))
        lost = bool(np.any(np.abs(position) > rig.plate.half)) or not np.all(np.isfinite(to_go))
        if lost or not np.any(to_go) or len(left) > MOST_CYCLES:
            return _summed(np.array(left), np.array(times), shares, rules.hold_s, lost)
        answer = controller.answer(wanted, cycle).cycle
        position, velocity = after(cycle, position, velocity, spread * rig.friction.accel)
        times.append(times[-1] + cycle.period)
        shares.append(share_of(rig, answer))
        cycle = answer if answer.follows(cycle) or cycle.tail is None else cycle.tail


def _summed(
    left: np.ndarray, times: np.ndarray, shares: list[Share], hold_s: float, lost: bool
) -> Rehearsal:
    """Sum up the ways (n, M) [m] that were left at times (n,) [s]."""
    total, going = np.sum(left, axis=1), max(int(np.count_nonzero(left[0])), 1)
    half, middle, last = int(np.argmax(total <= total[0] / 2)), len(times) // 2, times[-1]
    half = half if total[half] <= total[0] / 2 else len(times) - 1
    speed = (total[0] - total[half]) / going / max(times[half], IDLE_PERIOD)
    time = last + hold_s
    if total[-1] > 0:
        rate = (total[middle] - total[-1]) / max(last - times[middle], IDLE_PERIOD)
        time = time + total[-1] / rate if rate > going * STILL else np.inf
    share = Share(*np.median(shares, axis=0)) if shares else Share()
    return Rehearsal(float(time), float(speed), lost, share)


def share_of(rig: Rig, cycle: PlateCycle) -> Share:
    """Return what a motion uses of the rig's limits."""
    used, limits = usage(rig, cycle), rig.limits
    return Share(
        used.stroke_m / limits.stroke_m,
        used.speed / limits.speed,
        used.accel / limits.accel,
        used.force / limits.force,
        float(np.sqrt(np.max(used.thermal_load))),
    )


def rules_of(scenario: Scenario, rig: Rig) -> Rules:
    """Return the rules of a task.

    Raises
    ------
    PlateError
        If the task is not rehearsed.
    """
    task = scenario.task
    if isinstance(task, SortTask):
        return Regions(rig, task)
    if isinstance(task, FollowTask):
        return Paths.of(rig, task)
    if isinstance(task, AssembleTask):
        return Places(rig, task.labels, np.array(task.place), task.tolerance_m, task.hold_s)
    raise PlateError("tasks of angles, and of targets that may change, are not rehearsed")


@dataclass(frozen=True)
class Places:
    """Parts to places (P, 2) [m], one of its class to each."""

    rig: Rig
    names: tuple[str, ...]
    place: np.ndarray
    tolerance_m: float
    hold_s: float

    def ask(self, state: State) -> tuple[Wanted, np.ndarray]:
        """Ask for the places; see `Rules`."""
        aim = self.place[self.match(state)]
        way, band = aim - state.position, BAND * self.tolerance_m
        far = np.hypot(*way.T)
        wanted = _towards(self.rig, state, aim - band, aim + band, way, gap_m=self.gap_m)
        return wanted, np.where(far > self.tolerance_m, far, 0.0)

    @property
    def gap_m(self) -> float:
        """Least distance of two parts' rims: no more than between two places [m]."""
        least = float(np.min(pdist(self.place), initial=np.inf)) - 2 * self.rig.parts.radius_m
        return max(min(GAP * self.rig.parts.radius_m, least - 2 * BAND * self.tolerance_m), 0.0)

    def match(self, state: State) -> np.ndarray:
        """Return the row of each part's place (M,): least sum of squared ways."""
        cost = np.sum((state.position[:, None] - self.place) ** 2, axis=-1)
        other = np.array(state.labels)[:, None] != np.array(self.names)
        return np.asarray(linear_sum_assignment(cost + 1e3 * other)[1])


@dataclass
class Regions:
    """Parts to the boxes about their regions.

    `hand` tells which way they swirl: 1 where those for the right pass above those for the left, -1
    where below; 0 as long as that is open.
    """

    rig: Rig
    task: SortTask
    hand: float = 0.0

    @property
    def hold_s(self) -> float:
        """As the task says [s]."""
        return self.task.hold_s

    def ask(self, state: State) -> tuple[Wanted, np.ndarray]:
        """Ask for the regions, and for lanes on the way to opposite sides; see `Rules`."""
        half, place = self.rig.plate.half, state.position
        outline = [region_outline(self.task, name, half) for name in state.labels]
        low, high = (np.array([end(box, axis=0) for box in outline]) for end in (np.min, np.max))
        to_go = np.hypot(*(place - np.clip(place, low, high)).T)
        inner = np.minimum(BEYOND * half, (high - low) / 4)
        low, high = low + inner, high - inner
        way = np.clip(place, low, high) - place
        side = np.sign(low + high)[:, 0] * (high - low > 1.5 * half)[:, 1]
        opposite = np.any(side > 0) and np.any(side < 0)
        lane = LANE_WEIGHT * opposite * np.minimum(np.abs(way[:, 0]) / LANE_M, 1) * np.abs(side)
        self.hand = self.hand or (1.0 if np.sum(way[:, 0] * place[:, 1]) >= 0 else -1.0)
        upper, lower = (lane > 0) & (self.hand * side > 0), (lane > 0) & (self.hand * side < 0)
        low[upper, 1], high[lower, 1] = LANE_AT * half[1], -LANE_AT * half[1]
        return _towards(self.rig, state, low, high, way, lane), to_go


def _towards(
    rig: Rig, state: State, low: np.ndarray, high: np.ndarray, way: np.ndarray,
    lane: np.ndarray | None = None, gap_m: float | None = None,
) -> Wanted:  # fmt: skip
    """Ask parts with ways (M, 2) [m] into intervals (M, 2) [m]; lane (M,) is what y counts, gap_m
    the least distance of their rims, None as usual."""
    longest = max(float(np.max(np.hypot(*way.T))), LEAST_WAY_M)
    weight = np.full_like(low, FULL_WAY_M / longest)
    if lane is not None:
        weight[:, 1] = np.where(lane > 0, lane, weight[:, 1])
    return state.wanted(
        targets=Targets(low, high, weight, GAP * rig.parts.radius_m if gap_m is None else gap_m)
    )


@dataclass
class Paths:
    """Parts along paths at a common pace, which is less where parts fall behind.

    Attributes
    ----------
    starts : Places
        Where parts are led first.
    task : FollowTask
    pace, time_s : float
        Speed of the references [their paths'], and how far they are on them [s at full speed].
    match : (M,) or None
        Row of each part's path; None as long as parts are led.
    aim : (M, 2)
        Where the running cycle is to leave the parts [m].
    """

    starts: Places
    task: FollowTask
    pace: float = 1.0
    time_s: float = 0.0
    match: np.ndarray | None = None
    aim: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    hold_s = 0.0

    @classmethod
    def of(cls, rig: Rig, task: FollowTask) -> Paths:
        """Begin a task."""
        names = tuple(path.label for path in task.paths)
        begin = np.array([path.waypoint[0] for path in task.paths])
        return cls(Places(rig, names, begin, NEAR * task.max_error_m, 0.0), task)

    def ask(self, state: State) -> tuple[Wanted, np.ndarray]:
        """Ask for the drift that keeps parts with their references; see `Rules`."""
        paths, rig = self.task.paths, self.starts.rig
        if self.match is None:
            wanted, to_go = self.starts.ask(state)
            if np.any(to_go):
                return wanted, to_go + [_length(path) for path in paths]
            self.match, self.aim = self.starts.match(state), state.next_position
        speed = np.array([paths[k].speed for k in self.match])
        missed = np.hypot(*(state.next_position - self.aim).T)
        lacking = np.max(missed / (state.period * speed))
        error = np.max(np.hypot(*(state.next_position - self._reference(self.time_s)).T))
        faster = (
            max(self.pace * SLOW_DOWN, LEAST_PACE) if lacking > LACKING else self.pace + SPEED_UP
        )
        room = (0.5 - error / self.task.max_error_m) / (0.5 - NEAR)
        self.pace = float(np.clip(room, 0, min(1.0, faster)))
        now, done_s = self._reference(self.time_s), self.time_s
        self.time_s += self.pace * state.period
        way = self._reference(self.time_s) - now + GAIN * (now - state.next_position)
        self.aim = state.next_position + way
        gain = rig.parts.mass_kg / state.period**2
        left = np.array([max(_length(paths[k]) - done_s * paths[k].speed, 0.0) for k in self.match])
        if error > self.task.max_error_m:
            left[:] = np.inf
        return state.wanted(force=gain * way, period=state.period), left

    def _reference(self, time_s: float) -> np.ndarray:
        """Return where the parts (M, 2) [m] are to be."""
        match = np.zeros(0, dtype=int) if self.match is None else self.match
        paths = [self.task.paths[k] for k in match]
        return np.array([_point(path, time_s * path.speed) for path in paths])


def _length(path: PathTask) -> float:
    """Return the length of all laps of a path [m]."""
    return path.laps * float(_corners(path)[1][-1])


def _point(path: PathTask, way: float) -> tuple[float, float]:
    """Return where one is after a way [m]: x, y [m]."""
    corner, arc = _corners(path)
    at = min(way, _length(path))
    at = at % arc[-1] if path.closed else at
    return float(np.interp(at, arc, corner[:, 0])), float(np.interp(at, arc, corner[:, 1]))


def _corners(path: PathTask) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a lap (n, 2) [m], and the ways up to them (n,) [m]."""
    corner = np.array([*path.waypoint, *path.waypoint[: int(path.closed)]])
    return corner, np.append(0.0, np.cumsum(np.hypot(*np.diff(corner, axis=0).T)))
