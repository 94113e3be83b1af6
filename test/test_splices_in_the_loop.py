"""Cycles that go on from the state of the plate, when answers and reports are late or lost.

Planner, solver and the simulator's player in one process; a camera that is triggered at the start
of each cycle. The planner must never go on believing in a wrong state of the plate: then all its
answers would be refused, and the plate would rest for ever.
"""

from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
import pytest

from plate_bringup.loop import Setup, run
from plate_core import CycleError, Parts, PlateCycle, load_rig
from plate_core.motion import Timeline
from plate_core.tasks import load_scenario
from plate_planner import Planner, PlannerOptions
from plate_sim import Simulation
from plate_sim.plate import check_table
from plate_solver import Controller

RIG = load_rig()
CYCLES = 400
"""Cycles after which a run is given up."""


@dataclass(frozen=True)
class Faults:
    """How often [share of cycles] an answer never comes, comes in the next cycle, or cannot be
    played; a report of a start never comes, comes after the image was answered, or comes again; and
    an image never comes."""

    lost: float = 0.0
    late: float = 0.0
    refused: float = 0.0
    unreported: float = 0.0
    reported_late: float = 0.0
    reported_again: float = 0.0
    unseen: float = 0.0


@dataclass
class Line:
    """The loop, step by step: a step is a cycle of the plate."""

    seed: int = 0
    played: list[PlateCycle] = field(default_factory=list)

    def __post_init__(self):
        four = load_scenario("sort_4")
        two = tuple(replace(group, count=1) for group in four.parts)
        scenario = replace(four, parts=two, task=replace(four.task, goal_fraction=0.5))
        self.planner = Planner(RIG, scenario, PlannerOptions(image_age_s=0.0))
        self.state = self.planner.start(self.planner.initial())
        self.controller = Controller(RIG, "B", self.seed, restarts=5)
        self.simulation = Simulation(RIG, scenario, self.seed)
        self.timeline = Timeline.at_rest()
        self.on_its_way, self.starts = None, []
        self.rng = np.random.default_rng(self.seed)
        self.progress = None

    @property
    def running(self):
        return self.timeline.cycle

    @property
    def now(self):
        return self.timeline.begin

    def report(self, again=False):
        self.starts.append((self.running, self.now))
        for cycle, begin in (self.starts[-1], self.starts[-2:][0]) if again else self.starts[-1:]:
            self.state = self.planner.started(self.state, cycle, begin, triggered=True)

    def take(self, cycle):
        """A table comes to the player."""
        try:
            check_table(RIG, cycle, self.running)
        except CycleError:
            return
        self.timeline = self.timeline.send(cycle)

    def step(self, faults=Faults()):
        drawn = {name: self.rng.random() < fraction for name, fraction in vars(faults).items()}
        if self.on_its_way is not None:
            self.take(self.on_its_way)
            self.on_its_way = None
        reported = not drawn["unreported"]
        if reported and not drawn["reported_late"]:
            self.report(drawn["reported_again"])
        if not drawn["unseen"]:
            self.answer(drawn)
        if reported and drawn["reported_late"]:
            self.report()
        self.simulation.run(self.running)
        self.played.append(self.running)
        self.timeline = self.timeline.next()
        assert self.running.follows(self.played[-1])  # the plate never jumps

    def answer(self, drawn):
        world = self.simulation.state
        parts = Parts.make(world.ids, world.position, world.velocity)
        self.state, request, self.progress = self.planner.plan(self.state, parts, self.now)
        cycle = self.controller.solve(request, self.running).cycle
        if drawn["lost"]:
            return
        late = drawn["late"]
        self.state = self.planner.record_cycle(self.state, cycle, self.now + 0.2 * late, self.now)
        if drawn["refused"]:
            return
        if late:
            self.on_its_way = cycle
        else:
            self.take(cycle)

    def run(self, faults=Faults()):
        while len(self.played) < CYCLES and not self.progress_ended:
            self.step(faults)
        return self.progress

    @property
    def progress_ended(self):
        return self.progress is not None and self.progress.ended


def moving(cycles):
    return [cycle.knot_pose.any() for cycle in cycles]


def test_without_faults_the_plate_continues_from_cycle_to_cycle():
    line = Line()
    assert line.run().phase == "done"
    moves = np.array(moving(line.played))
    first, last = np.flatnonzero(moves)[[0, -1]]
    assert np.all(moves[first : last + 1])
    tails = [k for k, cycle in enumerate(line.played) if not cycle.tail and cycle.knot_pose.any()]
    assert tails in ([], [last])  # the plate comes to rest once


@pytest.mark.parametrize("name", list(vars(Faults())))
def test_with_each_fault_the_task_continues(name):
    line = Line(seed=1)
    progress = line.run(replace(Faults(), **{name: 0.3}))
    assert progress.phase == "done", progress.text


@pytest.mark.parametrize("seed", range(3))
def test_after_any_faults_the_plate_continues_after_a_tail_and_a_rest(seed):
    line = Line(seed)
    fractions = dict(
        zip(vars(Faults()), np.random.default_rng(seed).uniform(0, 0.5, 7), strict=True)
    )
    fractions["unseen"] /= 3
    while len(line.played) < CYCLES and not line.progress_ended:
        for _ in range(12):
            if not line.progress_ended:
                line.step(Faults(**fractions))
        begin = len(line.played)
        for _ in range(8):
            if not line.progress_ended and line.state.task.active:
                line.step()
        calm = line.played[begin:]
        held = line.state.task.held(line.state.estimator.stamp, line.planner.limits)
        if len(calm) == 8 and not held and line.state.task.met_since is None:
            assert all(moving(calm[3:])), "still at rest"
            assert all(cycle.tail for cycle in calm[5:]), "no cycle goes on from the one before"
    assert line.progress.phase == "done", line.progress.text


def test_reports_that_come_again_change_nothing():
    line, again = Line(seed=5), Line(seed=5)
    line.run()
    again.run(Faults(reported_again=1.0))
    assert again.now == line.now
    for one, other in zip(again.played, line.played, strict=True):
        assert np.array_equal(one.knot_pose, other.knot_pose)


def test_a_player_without_reports_gets_cycles_from_rest_to_rest():
    line = Line(seed=2)
    assert line.run(Faults(unreported=1.0)).phase == "done"
    assert all(cycle.starts_at_rest and cycle.tail is None for cycle in line.played)


def test_a_driver_that_stops_reporting_gets_cycles_from_rest():
    line = Line(seed=3)
    while sum(moving(line.played)) < 4:
        line.step()
    assert line.running.tail is not None
    begin = len(line.played)
    assert line.run(Faults(unreported=1.0)).phase == "done"
    after = line.played[begin + 3 :]
    assert all(cycle.starts_at_rest and cycle.tail is None for cycle in after[1:])
    assert sum(moving(after)) > 3


@pytest.mark.parametrize("put", [-100.0, -0.35, 5.0])
def test_clocks_that_are_set_cost_a_tail_and_a_rest(put):
    line = Line(seed=4)
    while sum(moving(line.played)) < 4:
        line.step()
    line.timeline = replace(line.timeline, begin=line.now + put)
    begin = len(line.played)
    for _ in range(8):
        line.step()
    assert all(moving(line.played[begin + 5 :]))
    assert all(cycle.tail for cycle in line.played[begin + 6 :])
    assert line.run().phase == "done"


@pytest.mark.parametrize(("scenario", "rests"), [("sort_10", False), ("sort_50", True)])
def test_a_crowd_is_moved_from_rest_to_rest(scenario, rests):
    moments = islice(run(Setup(scenario, effort={"iterations": 2, "restarts": 0})), 8)
    assert all(moment.result.cycle.closes for moment in moments) == rests
