"""The node in lockstep with the image source, and cycles that start from a moving plate."""

import operator
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from planner_graph import APART, IDS  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from stepped_clock import STEP_S  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core import Parts, PlateCycle  # noqa: E402
from plate_core.ros import DATA, cycle_to_msg, msg_to_request, parts_to_msg, to_time  # noqa: E402
from plate_interfaces.msg import TaskStatus  # noqa: E402

STATE = np.array([[1e-3, 0, 0], [0.02, 0, 0], [0, 0, 0]])
KNOTS = np.stack([np.zeros((3, 3)), STATE, STATE, np.zeros((3, 3))], axis=1)
LEAVES = PlateCycle.from_knots(np.array([0.0, 0.1, 0.1, 0.15]), *KNOTS)
"""A cycle that ends in a state of the plate, with a tail."""


@pytest.fixture
def reported(graph):
    """Return a function that sends three images to the node and returns the planner's requests. The
    plate is in motion after the first image. `order` is the order of the messages `cycle`, `start`
    and `parts`. `at_once`: all three messages wait, as on a busy computer."""

    def ask(order, lockstep=True, at_once=False):
        node = graph(lockstep=lockstep)
        requested, node.reporting = [], False
        starts = node.starts if lockstep else node.probe.create_publisher(
            JointTrajectory, "cycle_started", DATA
        )  # fmt: skip
        node.until(starts.get_subscription_count)

        def begin(t, cycle):
            starts.publish(cycle_to_msg(cycle, to_time(round(1e9 * t))))

        begin(1.0, node.cycle)
        node.image(1.0, APART)
        node.until(lambda: not node.planner._lockstep.unanswered)
        node.send()
        for t in (1.1, 1.2):
            begin(t, node.cycle)
            node.image(t, APART)
            node.until(lambda: not node.planner._lockstep.unanswered)
        node.cycle, node.answering = LEAVES, False
        begin(1.3, PlateCycle.rest(0.1))
        requested.append(node.image(1.3, APART))
        for t in (1.4, 1.5):
            count, stamp = len(node.forces), to_time(round(1e9 * t))
            publish = {
                "cycle": node.answer,
                "start": lambda t=t: begin(t, LEAVES if t == 1.4 else LEAVES.tail),
                "parts": lambda stamp=stamp: node.parts.publish(
                    parts_to_msg(Parts.make(IDS, APART + 1e-3), stamp)
                ),
            }
            for what in order:
                publish[what]()
                if not at_once:
                    node.executor.spin_for(STEP_S)
            if at_once:
                time.sleep(AT_ONCE_S)
            node.until(lambda count=count: len(node.forces) > count)
            assert node.forces[count].header.stamp == stamp
            requested.append(msg_to_request(node.forces[count]))
        return requested

    return ask


AT_ONCE_S = 0.05
"""Maximum time in which threads of the middleware deliver three messages [s]."""

ORDERS = [("cycle", "start", "parts"), ("parts", "cycle", "start"), ("start", "parts", "cycle")]
"""Each of the three comes last once; the others are in test_lockstep.py."""


@pytest.mark.parametrize("order", ORDERS[1:], ids="-".join)
def test_in_lockstep_the_order_of_messages_does_not_matter(reported, order):
    for one, other in zip(reported(order), reported(ORDERS[0]), strict=True):
        for name in ("forces.force", "forces.tolerance", "start", "plate"):
            value = operator.attrgetter(name)
            np.testing.assert_array_equal(value(one), value(other))
        np.testing.assert_array_equal(one.parts.velocity, other.parts.velocity)


@pytest.mark.parametrize(
    ("order", "lockstep", "at_once"),
    [
        (ORDERS[0], True, False),
        (ORDERS[0], False, False),
        *((each, False, True) for each in ORDERS),
    ],
)
def test_the_plate_continues_from_its_reported_state(reported, order, lockstep, at_once):
    first, second, third = reported(order, lockstep, at_once)
    assert np.array_equal(first.plate, np.zeros((3, 3)))
    assert np.array_equal(second.plate, STATE)
    assert np.array_equal(third.plate, np.zeros((3, 3)))


@pytest.fixture
def at_once(clock):
    """Function that waits until something is true, while the nodes' time stands."""

    def wait(graph, condition):
        begun = clock.ns
        for _ in range(500):
            graph.executor.settle()
            if condition():
                break
            time.sleep(0.002)  # for threads of the middleware
        assert condition()
        assert clock.ns == begun

    return wait


@pytest.mark.parametrize("last", ["cycle", "start", "parts"])
def test_in_lockstep_an_image_is_planned_at_once_when_the_last_message_came(graph, at_once, last):
    graph = graph(lockstep=True)
    graph.begin(1.0)
    graph.answering = False
    graph.image(1.3, APART)
    count, stamp = len(graph.forces), to_time(1_400_000_000)
    publish = {
        "cycle": graph.answer,
        "start": lambda: graph.starts.publish(cycle_to_msg(graph.cycle, stamp)),
        "parts": lambda: graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), stamp)),
    }
    for name in publish:
        if name != last:
            publish[name]()
            graph.executor.spin_for(STEP_S)
    assert len(graph.forces) == count
    publish[last]()
    at_once(graph, lambda: len(graph.forces) > count)
    assert msg_to_request(graph.forces[-1]).parts.ids == IDS


def test_in_lockstep_a_player_that_does_not_report_is_not_waited_for_twice(graph):
    graph = graph(lockstep=True, input_timeout_s=0.5)
    graph.reporting = False
    graph.image(1.0, APART)
    assert not graph.planner._lockstep.starts_required
    graph.until(lambda: not graph.planner._lockstep.unanswered)
    graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), to_time(1_100_000_000)))
    graph.until(lambda: graph.planner._lockstep.image_waits)
    graph.send()
    graph.until(lambda: len(graph.forces) == 2)
    for k in range(2, 10):
        assert graph.image(1.0 + 0.1 * k, APART).plate is None
    assert graph.states[-1] == "running"


def test_in_lockstep_an_image_of_the_task_before_is_answered_by_rest(graph):
    """The driver lets no other answer through, and the image would come again for ever."""
    graph = graph(lockstep=True)
    graph.planner.set_parameters([Parameter("preempt", value=True)])
    first = graph.begin()
    assert graph.image(1.0, APART).parts.ids == IDS
    graph.until(lambda: not graph.planner._lockstep.unanswered)
    graph.report()
    graph.send()
    assert graph.result(first)[1].reason == TaskStatus.PREEMPTED
    assert graph.image(1.0, APART).parts.ids == ()
    assert graph.image(1.1, APART).parts.ids == IDS


def test_in_lockstep_a_solver_that_does_not_answer_ends_the_task(graph):
    graph = graph(lockstep=True, input_timeout_s=0.5)
    graph.begin()
    graph.until(lambda: not graph.planner._lockstep.unanswered)
    graph.answering = False
    graph.image(0.3, APART)
    count = len(graph.forces)
    graph.starts.publish(cycle_to_msg(graph.cycle, to_time(400_000_000)))
    graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), to_time(400_000_000)))
    graph.until(lambda: len(graph.forces) > count)  # the loop goes on when the solver does
    graph.until(lambda: graph.states[-1] != "running")
    assert ": no plate_cycle for " in graph.states[-1]
    assert msg_to_request(graph.forces[-1]).parts.ids == ()
