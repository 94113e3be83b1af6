"""Scenarios as goals: values survive a conversion in both directions, and a wrong goal is refused
like a wrong file."""

import math
from dataclasses import replace

import pytest

from plate_core import PlateError, ScenarioError
from plate_core.tasks import FeedTask, PartTarget, PoseTask, load_scenario, scenario_names

pytest.importorskip("rclpy")
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message, serialize_message

from plate_core.ros import ACTIONS, goal_to_scenario, msg_to_order, scenario_to_goal
from plate_interfaces.msg import FeedOrder, FeedPick, PartCount, Region


def sent(scenario):
    name, goal = scenario_to_goal(scenario)
    return deserialize_message(serialize_message(goal), ACTIONS[name].Goal)


def sort_goal():
    return sent(load_scenario("sort_4"))


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_there_and_back(name):
    scenario = load_scenario(name)
    back = goal_to_scenario(sent(scenario))
    assert back.labels == scenario.labels
    assert back.time_limit_s == scenario.time_limit_s
    again = goal_to_scenario(sent(back))
    assert again == back
    if isinstance(scenario.task, FeedTask):  # the hopper is the feeder's, not the planner's
        assert back.task == replace(scenario.task, hopper=None)
        return
    if not isinstance(scenario.task, PoseTask):  # degrees there and back
        assert back.task == scenario.task
        return
    assert back.task.anywhere == scenario.task.anywhere
    for one, other in zip(back.task.poses, scenario.task.poses, strict=True):
        assert (one.label, one.place) == (other.label, other.place)
        assert one.angle == pytest.approx(other.angle)


def spoilt(change):
    goal = sort_goal()
    change(goal)
    return goal


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda g: setattr(g, "goal_fraction", float("nan")),
            "sort_parts: task: goal_fraction is nan",
        ),
        (lambda g: setattr(g, "parts", []), "parts is .*, allowed: at least one"),
        (lambda g: g.parts.append(PartCount(type="black", count=1)), "each class once"),
        (lambda g: setattr(g, "regions", g.regions[:1]), "grey is missing"),
        (lambda g: g.regions.append(Region(type="black", side="top")), "black occurs twice"),
        (lambda g: setattr(g.regions[0], "side", "lfet"), "black is 'lfet', allowed: one of left"),
        (lambda g: setattr(g.regions[0], "side", ""), "bin_m"),
        (lambda g: g.regions.append(Region(type="red", side="top")), "red"),
    ],
)
def test_a_wrong_goal_is_named(change, message):
    with pytest.raises(ScenarioError, match=message):
        goal_to_scenario(spoilt(change))


def test_a_bin_of_a_goal():
    goal = sort_goal()
    goal.regions[0].side = ""
    goal.regions[0].polygon = [Point(x=0.1, y=0.0), Point(x=0.2, y=0.0), Point(x=0.2, y=0.1)]
    back = goal_to_scenario(goal)
    assert back.task.regions["black"].corner == ((0.1, 0.0), (0.2, 0.0), (0.2, 0.1))


def test_speeds_along_a_path():
    scenario = load_scenario("follow_2")
    path = replace(scenario.task.paths[0], profile=((0.0, 0.01), (1.0, 0.04)))
    task = replace(scenario.task, paths=(path, *scenario.task.paths[1:]))
    back = goal_to_scenario(sent(replace(scenario, task=task)))
    assert back.task.paths[0].profile == path.profile
    _, goal = scenario_to_goal(replace(scenario, task=task))
    goal.paths[0].profile_speeds = [0.01]
    with pytest.raises(ScenarioError, match="2 profile_fractions and 1 profile_speeds"):
        goal_to_scenario(goal)


def move(**changed):
    targets = (PartTarget("black_1", (0.1, 0.0), 1.0), PartTarget("grey_2", (0.0, -0.05)))
    play = load_scenario("play")
    task = replace(play.task, targets=targets, tolerance_rad=0.1)
    return replace(
        play, name="move", description="move_parts", file="move_parts", task=task, **changed
    )


@pytest.mark.parametrize(("limit", "marked"), [(math.inf, True), (60.0, False)])
def test_targets_there_and_back(limit, marked):
    scenario = move(time_limit_s=limit, marked=marked)
    back = goal_to_scenario(sent(scenario))
    assert back == replace(scenario, task=back.task)
    assert back.task.targets[0].angle == pytest.approx(1.0)
    assert back.task.targets[1] == scenario.task.targets[1]
    assert back.task.until_canceled


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g: setattr(g, "until_canceled", False), "time_limit_s is 0.0, allowed"),
        (
            lambda g: setattr(g.targets[0], "id", "red_1"),
            "id is 'red_1', allowed: a class and a num",
        ),
        (lambda g: setattr(g.targets[0], "x", math.inf), "place_m is .*inf"),
        (lambda g: setattr(g.targets[1], "id", "black_1"), "allowed: each part at most once"),
        (lambda g: setattr(g, "targets", 51 * g.targets), "at most 100"),
    ],
)
def test_a_wrong_goal_of_targets_is_named(change, message):
    goal = sent(move())
    change(goal)
    with pytest.raises(ScenarioError, match=message):
        goal_to_scenario(goal)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_window_of_which_a_side_is_no_number_is_not_the_whole_plate(value):
    goal = sent(load_scenario("feed"))
    goal.picks[0].x_min = value
    with pytest.raises(ScenarioError, match=r"window_m is .*(nan|inf)"):
        goal_to_scenario(goal)


def test_an_order_without_a_window_applies_to_the_whole_plate():
    everywhere, window = FeedPick(type="nut"), FeedPick(type="nut", y_max=0.1)
    first, second = msg_to_order(FeedOrder(mode=1, picks=[everywhere, window])).picks
    assert (first.low, first.high) == ((-math.inf, -math.inf), (math.inf, math.inf))
    assert (second.low, second.high) == ((0, 0), (0, 0.1))
    with pytest.raises(PlateError, match="feed_orders: mode is 77, allowed: 0 "):
        msg_to_order(FeedOrder(mode=77))
