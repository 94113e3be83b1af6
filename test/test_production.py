"""Simulated production: the robot's times, a short run, the peers that shake, and `qualify`."""

import math
import re
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from plate_bringup import qualify
from plate_bringup.loop import Setup
from plate_bringup.production import (
    Act,
    FeederCell,
    Production,
    Robot,
    Tally,
    check_robot,
    filled,
    produce,
)
from plate_core import PlateError, load_rig
from plate_core.motion import usage
from plate_core.tasks import PartGroup, load_scenario
from plate_planner.tasks import FeedReport
from plate_sim import Grip, Simulation
from plate_solver import EFFORT
from tasks.feeding import BASE, run_case
from tasks.shaking import conveyed_distances, strongest_cycle

PLACE = (0.1, 0.0, 0.0)
FEW = {"restarts": 10}


def acts(robot, until, answer_at, step=0.05):
    """Step a robot up to a time. It gets a reply after its request, but not before `answer_at`."""
    found, requested = [], False
    for now in np.arange(0, until, step):
        while True:
            due = robot.due
            robot, act = robot.step(now)
            if act is None:
                break
            found.append((act, due))
            requested = requested or act is Act.REQUEST
        if requested and now >= answer_at - 1e-9:
            robot, requested = robot.after_reply(PLACE, now), False
    return robot, found


def test_a_robot_that_is_answered_at_once_keeps_its_cycle():
    robot, found = acts(Robot(2.0, 0.0), 4.01, 0.0)
    times = {act: [due for a, due in found if a is act] for act in Act}
    assert times[Act.LEAVE] == pytest.approx([0.3, 2.3])
    assert times[Act.REQUEST] == pytest.approx([1.2, 3.2])
    assert times[Act.COME] == pytest.approx([1.7, 3.7])
    assert times[Act.GRIP] == pytest.approx([2.0, 4.0])
    assert robot.since == pytest.approx(4.0)


def test_a_robot_waits_outside_the_view_for_its_answer():
    _, found = acts(Robot(2.0, 0.0), 2.9, 2.5)
    assert [act for act, _ in found] == [Act.LEAVE, Act.REQUEST, Act.COME, Act.GRIP]
    assert [due for _, due in found[2:]] == pytest.approx([2.5, 2.8])
    before = Robot(2.0, 0.0, Act.COME)
    assert before.waited(1.6) == 0
    assert before.waited(2.2) == pytest.approx(0.5)
    assert before.after_reply(PLACE, 2.5).waited(9.0) == pytest.approx(0.8)


def test_a_robot_that_is_refused_requests_again_later():
    robot, _ = Robot(2.0, 0.0, Act.REQUEST).step(1.2)
    assert robot.due == math.inf
    robot = robot.after_reply(None, 1.5)
    assert robot.due == pytest.approx(1.7)


def test_counting_begins_with_the_first_pick(monkeypatch):
    rig = load_rig()
    simulation = Simulation(rig, load_scenario("feed"))
    tally, robot = Tally(), Robot.ready(2.0).after_reply(PLACE, 7.0)
    robot = replace(robot, next=Act.GRIP)
    tally.gripped(robot, Grip(False, error_m=math.inf))
    tally.gripped(robot, Grip(True, error_m=1e-4, error_rad=-0.1))
    first = robot.due
    late = replace(Robot(2.0, first), next=Act.GRIP).after_reply(PLACE, first + 2.2)
    tally.gripped(late, Grip(True, error_m=3e-4, error_rad=0.1))
    tally.time_s = late.due
    task = load_scenario("feed").task
    found = Production.of(tally, Robot(2.0, late.due), simulation, task)
    assert (found.picks, found.failed) == (2, 1)
    monkeypatch.setattr(Simulation, "discharged_classes", Counter(black=2, grey=3))
    gone = Production.of(tally, robot, simulation, task)
    assert (gone.lost, gone.discharged) == (2, 3), "none that is wanted may go to the chute"
    assert found.first_s == pytest.approx(7.3)
    assert found.waiting == pytest.approx(0.5 / 2.5)
    assert found.parts_per_min == pytest.approx(60 / 2.5)
    assert found.error_mm[2] == pytest.approx(0.3)
    assert found.error_deg[0] == pytest.approx(math.degrees(0.1))


@pytest.fixture(scope="module")
def short():
    """Some seconds of our feeder."""
    return produce(Setup(BASE.recipe, 3, effort=FEW), 2.0, 12.0)


def test_a_short_production_picks_parts_at_the_reported_places(short):
    assert short.picks >= 4
    assert short.failed == short.lost == short.discharged == 0
    assert short.error_mm[2] < 0.5
    assert not short.refused
    assert 0 <= short.waiting < 0.5


def test_a_production_is_repeated_by_its_seed():
    one, again = (produce(Setup(BASE.recipe, 3, effort=FEW), 1.0, 4.0) for _ in range(2))
    assert one.picks > 1
    assert replace(again, cpu=0.0) == replace(one, cpu=0.0)


def test_parts_are_neither_made_nor_forgotten():
    """All that the hopper has dropped is on the plate, was picked, or has left over the chute."""
    cells = []
    recipe = filled(load_scenario("feed"), 10)
    found = produce(Setup(recipe, 1, effort=FEW), 1.0, 8.0, note=cells.append)
    simulation = cells[-1].simulation
    numbers = {
        label: max(
            (int(i.rpartition("_")[2]) for i in simulation.state.ids if i.startswith(label)),
            default=0,
        )
        for label in ("black", "grey")
    }
    there = int(np.count_nonzero(simulation.state.on_plate))
    assert there + found.picks + found.lost + found.discharged >= sum(numbers.values())
    assert there <= 2 * 10


def test_a_crowd_on_its_way_to_the_chute_does_not_block_requested_parts():
    """Three black ones stand before it, with 22 grey ones behind them."""
    black = ((273, 59), (280, -87), (279, 103))
    grey = (
        (278, 38), (265, 89), (280, 132), (264, 119), (251, -74), (269, 20), (273, -5), (269, -71),
        (253, -96), (232, -84), (252, 17), (231, -66), (267, -131), (224, -45), (243, -4),
        (199, -130), (191, -55), (213, -7), (213, 19), (162, 35), (145, 19), (152, 95),
    )  # fmt: skip
    recipe = load_scenario("feed")
    groups = tuple(
        PartGroup(label, len(places), tuple((x / 1e3, y / 1e3) for x, y in places))
        for label, places in (("black", black), ("grey", grey))
    )
    recipe = replace(recipe, parts=groups, task=replace(recipe.task, hopper=None))
    found = produce(Setup(recipe, 1, effort=FEW), 2.0, 8.0)
    assert found.picks >= 2
    assert found.lost == 0


def test_a_hopper_that_is_opened_over_a_full_plate_does_not_end_a_production():
    """The camera may see fewer parts than there are."""
    recipe, rig = load_scenario("feed"), load_rig()
    crowd = replace(recipe, parts=(PartGroup("black", 100), PartGroup("grey", 0)))
    cell, simulation = FeederCell(recipe.task, rig, 2.0), Simulation(rig, crowd)
    cell.act(simulation, 0.0)
    cell.order(FeedReport(0.0, seen={"black": 5}), 0.1)
    assert len(simulation.state.ids) == 100


def test_recipes_that_cannot_be_filled_are_refused():
    with pytest.raises(PlateError, match="'sort_4', allowed: a scenario of kind feed"):
        filled(load_scenario("sort_4"), 10)
    for fill in (2, 101):  # of 3 that must be ready, as a recipe's file is refused
        with pytest.raises(PlateError, match=f"fill is {fill}, allowed: 3 .* to 100"):
            filled(load_scenario("feed"), fill)
    assert filled(load_scenario("feed"), 5).task.hopper.least == 4  # 12 of 15


def test_a_production_begins_with_unwanted_parts_of_the_recipe():
    recipe = load_scenario("feed")
    placed = PartGroup("black", 2, ((0.0, 0.0), (0.1, 0.0)))
    found = filled(replace(recipe, parts=(placed, PartGroup("grey", 8))), 10)
    assert found.parts == (PartGroup("black", 1), PartGroup("grey", 8))


def test_a_robot_may_not_stand_over_the_plate_for_longer_than_its_part_is_reserved():
    recipe = load_scenario("feed")
    with pytest.raises(PlateError, match=r"valid_s is 1 s, allowed: at least 1.1 s.* 2 s"):
        produce(Setup(replace(recipe, task=replace(recipe.task, valid_s=1.0))), 2.0, 1.0)
    asks, leaves = (acts(Robot(2.0, 0.0), 3.0, 0.0)[1][k][1] for k in (1, 4))
    check_robot(replace(recipe.task, valid_s=leaves - asks + 1e-9), 2.0)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_shake_conveys_parts_as_strongly_as_the_rig_allows(axis):
    rig, along = load_rig(), np.eye(3)[axis]
    cycle = strongest_cycle(rig, along)
    assert usage(rig, cycle).overall == pytest.approx(1.0, abs=1e-6)
    ways = conveyed_distances(rig, cycle, axis)
    assert np.all(np.diff(ways) > 0)
    assert ways[0] > 1e-3
    back = conveyed_distances(rig, cycle.scaled(-1.0), axis)
    assert back == pytest.approx(-ways, abs=1e-4)


@pytest.mark.parametrize("method", ["vibrated", "thrown"])
def test_a_peer_picks_parts_too(method):
    found = run_case(BASE, method, 3, 30.0)
    assert found["picks"] >= 4
    assert found["failed"] == 0
    assert found["error_mm"][2] < 0.5


def qualified(monkeypatch, *words):
    monkeypatch.setitem(EFFORT["sinusoids"], "restarts", FEW["restarts"])
    monkeypatch.setattr(sys, "argv", ["qualify", *words])
    with pytest.raises(SystemExit) as end:
        qualify.main()
    return end.value.code


def test_qualify_prints_a_table_and_writes_a_page(monkeypatch, capsys, tmp_path):
    page = tmp_path / "feed.html"
    words = ["--recipe", "feed", "--minutes", "0.1", "--seeds", "1", "--fill", "4,8"]
    assert qualified(monkeypatch, *words, "--robot-cycle", "1", "--page", str(page)) == 0
    output = capsys.readouterr()
    lines = [line for line in output.out.splitlines() if re.match(r"\s*\d+  ", line)]
    assert [line.split()[0] for line in lines] == ["4", "8"]
    assert sum("<- best fill" in line for line in lines) == 1
    best = next(line.split() for line in lines if "best" in line)
    assert float(best[1]) >= 0.99 * max(float(line.split()[1]) for line in lines)
    assert output.err.count("parts per minute") == 2
    text = page.read_text(encoding="utf-8")
    assert f"Best fill: {best[0]} parts" in text
    assert "<svg" in text
    assert text.count("<tr") == 3


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--recipe", "sort_4"], "recipe is 'sort_4', allowed: a scenario of kind feed"),
        (["--recipe", "feeed"], "did you mean feed?"),
        (["--recipe", "feed", "--fill", "0"], "fill is 0, allowed: 1 to 100"),
        (["--recipe", "feed", "--fill", "5,x"], "fill is x, allowed: 1 to 100"),
        (["--recipe", "feed", "--robot-cycle", "nan"], "robot-cycle is nan, allowed: 0.2 to 60"),
        (["--recipe", "feed", "--page", "/nowhere/a.html"], "allowed: a file in an existing"),
        (["--recipe", "feed", "--page", "/"], "page is /, allowed: a file in an existing folder"),
        (["--recipe", "feed_bars", "--rig", "desk"], "class is 'bar', allowed with this rig"),
    ],
)
def test_qualify_reports_errors(monkeypatch, capsys, words, problem):
    assert qualified(monkeypatch, *words) == 2
    assert problem in capsys.readouterr().err
