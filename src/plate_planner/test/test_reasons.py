"""Each reason why a task ends, provoked through the node."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from planner_graph import APART, IDS, NOT_READY, SORT_4, SORTED, stale  # noqa: E402

from plate_core.ros import (  # noqa: E402
    NEWEST,
    scenario_to_goal,
)
from plate_core.tasks import load_scenario  # noqa: E402
from plate_interfaces.msg import Parts as PartsMsg  # noqa: E402
from plate_interfaces.msg import TaskStatus  # noqa: E402
from plate_planner.ros import STATES  # noqa: E402
from plate_planner.supervision import Reason  # noqa: E402

PROVOKE = {}
"""By reason: a function that takes one which makes a `Graph`, has a task end for this reason, and
returns the goal's last status."""


def provokes(reason):
    def keep(provoke):
        PROVOKE[reason] = provoke
        return provoke

    return keep


@provokes(Reason.NONE)
def provoke_none(make):
    graph = make()
    handle = graph.begin()
    return graph.until_ended(handle, lambda k: graph.image(0.1 * k, SORTED))


@provokes(Reason.TIME_LIMIT)
def provoke_time_limit(make):
    graph = make()
    handle = graph.begin(scenario=replace(SORT_4, time_limit_s=1.0))
    return graph.until_ended(handle, lambda k: graph.image(0.1 * k, APART))


@provokes(Reason.NO_PROGRESS)
def provoke_no_progress(make):
    graph = make(stuck_timeout_s=1.0)
    handle = graph.begin()
    return graph.until_ended(handle, lambda k: graph.image(0.1 * k, APART))


@provokes(Reason.TOO_FAR_OFF)
def provoke_too_far_off(make):
    graph, ids = make(), ("black_1", "black_2")
    start = np.array([[-0.22, -0.06], [0.09, 0.08]])
    graph.image(0.0, start, ids)
    handle = graph.send(load_scenario("follow_2"))
    for k in (1, 2, 3):
        graph.image(0.1 * k, start, ids)
    return graph.until_ended(handle, lambda k: graph.image(0.1 * k, start + [0.04, 0], ids))


@provokes(Reason.PART_LEFT)
def provoke_part_left(make):
    graph = make(unseen_timeout_s=0.1)
    graph.answering = False  # else the planner carries the part on
    handle = graph.begin()
    graph.image(0.3, [*APART[:3], [0.297, 0.0]])
    return graph.until_ended(handle, lambda k: graph.image(0.1 * k, APART[:3], IDS[:3]))


@provokes(Reason.PART_UNSEEN)
def provoke_part_unseen(make):
    graph = make(unseen_timeout_s=0.1)
    graph.answering = False
    handle = graph.begin()
    return graph.until_ended(handle, lambda k: graph.image(0.1 * k, APART[:3], IDS[:3]))


@provokes(Reason.PARTS_MISSING)
def provoke_parts_missing(make):
    graph = make(start_timeout_s=0.3)
    graph.image(0.0, APART[:3], IDS[:3])
    handle = graph.send()
    return graph.until_ended(handle, lambda k: graph.image(0.1 * k, APART[:3], IDS[:3]))


@provokes(Reason.NO_CYCLE)
def provoke_no_cycle(make):
    graph = make(input_timeout_s=0.5)
    handle = graph.begin()
    graph.answering = False
    return graph.until_ended(handle, graph.image_and_pause)


@provokes(Reason.NO_DRIVER)
def provoke_no_driver(make):
    graph = make(input_timeout_s=0.5)
    handle = graph.begin()
    graph.driver = None
    return graph.until_ended(handle, graph.image_and_pause)


@provokes(Reason.CUT_OFF)
def provoke_cut_off(make):
    graph = make(input_timeout_s=0.5)
    handle = graph.begin()

    def go_on(k):
        graph.others.publish(stale("simulator", "no motor table for 1.5 s"))
        graph.image_and_pause(k)

    return graph.until_ended(handle, go_on)


AT_ONCE = {
    Reason.CANCELED: lambda graph, handle: handle.cancel_goal_async(),
    Reason.PREEMPTED: lambda graph, handle: graph.send(),
    Reason.STOPPED: lambda graph, handle: graph.stop(),
    Reason.NO_PARTS: lambda graph, handle: None,
    Reason.DRIVER_STOPPED: lambda graph, handle: setattr(graph, "driver", NOT_READY[0]),
    Reason.STOOD_STILL: lambda graph, handle: graph.clock.step(1.0),
}
"""Events that end a running task without another image."""


def provoke_at_once(make, reason):
    graph = make(preempt=True, input_timeout_s=0.5)
    handle = graph.begin()
    AT_ONCE[reason](graph, handle)
    return graph.result(handle)[1]


PROVOKE.update((reason, partial(provoke_at_once, reason=reason)) for reason in AT_ONCE)


@provokes(Reason.INVALID_GOAL)
def provoke_invalid_goal(make):
    name, goal = scenario_to_goal(SORT_4)
    goal.regions = []
    graph = make()
    return graph.result(graph.send(None, (name, goal)))[1]


@provokes(Reason.NOT_READY)
def provoke_not_ready(make):
    graph = make(driver=None)
    return graph.result(graph.send())[1]


@provokes(Reason.BUSY)
def provoke_busy(make):
    graph = make()
    graph.begin()
    return graph.result(graph.send())[1]


@provokes(Reason.RIVAL)
def provoke_rival(make):
    graph = make()
    handle = graph.begin()
    other = rclpy.create_node("other_detector")
    other.create_publisher(PartsMsg, graph.parts.topic_name, NEWEST)
    try:
        status = graph.until_ended(handle, graph.image_and_pause)
    finally:
        other.destroy_node()
    assert status.text.endswith("2 nodes publish parts (other_detector, probe), allowed: one")
    return status


@pytest.mark.parametrize("reason", Reason, ids=lambda reason: reason.name)
def test_every_reason_can_be_provoked(graph, reason):
    task = PROVOKE[reason](graph)
    assert (Reason(task.reason), bool(task.text)) == (reason, True)


def test_reasons_and_states_are_those_of_the_message():
    names = [name for name in dir(TaskStatus) if not name.startswith("_")]
    codes = {name: code for name in names if type(code := getattr(TaskStatus, name)) is int}
    states = {phase.name: code for phase, code in STATES.items()}
    assert codes == {reason.name: int(reason) for reason in Reason} | states
