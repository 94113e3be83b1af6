"""The task of move over real topics: targets in, targets in force out."""

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from planner_graph import APART, IDS  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from plate_core.ros import DATA, LATCHED  # noqa: E402
from plate_core.tasks import MoveTask, PartTarget, load_scenario  # noqa: E402
from plate_interfaces.msg import Target, Targets, TaskStatus  # noqa: E402

HERE = PartTarget("black_1", (0.1, 0.05))


def play(*targets):
    """Four parts, until canceled."""
    task = MoveTask(targets, 0.002, 0.05, 0.5, until_canceled=True)
    scenario = load_scenario("sort_4")
    return type(scenario)("move", "", scenario.parts, task, np.inf)


def connected(graph):
    """Publisher of `targets`, and the received messages of `part_targets`."""
    received = []
    graph.probe.create_subscription(Targets, "part_targets", received.append, LATCHED)
    publisher = graph.probe.create_publisher(Targets, "targets", DATA)
    graph.until(lambda: publisher.get_subscription_count() and received)
    return publisher, received


def asked_now(graph, begin_s):
    """The request at the next image. On a busy machine a result can arrive too late for a
    request."""
    for k in range(50):
        request = graph.image(begin_s + 0.1 * k, APART)
        if request.targets is not None:
            return request
    raise AssertionError("nothing is asked")


def ids(msg):
    return [target.id for target in msg.targets]


def test_targets_are_accepted_while_it_runs_and_reported(graph):
    graph = graph()
    publisher, received = connected(graph)
    assert not received[-1].targets
    handle = graph.begin(100.0, play(HERE))
    graph.until(lambda: ids(received[-1]) == ["black_1"])
    assert received[-1].header.frame_id == "plate_home"
    publisher.publish(Targets(targets=[Target(id="grey_2", x=-0.1, y=0.02, angle=np.nan)]))
    graph.until(lambda: ids(received[-1]) == ["black_1", "grey_2"])
    assert np.isnan(received[-1].targets[1].angle)
    requested = asked_now(graph, 100.3)
    aim = (requested.targets.low + requested.targets.high) / 2
    assert aim[IDS.index("grey_2")] == pytest.approx([-0.1, 0.02])
    assert aim[IDS.index("black_1")] == pytest.approx(HERE.place)
    graph.until(lambda: graph.states[-1].startswith("running: 0 of 2 at their targets, "))
    graph.until(handle.cancel_goal_async().done)
    _, status = graph.result(handle)
    assert (status.state, status.reason) == (TaskStatus.ABORTED, TaskStatus.CANCELED)
    assert status.task == "move"
    graph.until(lambda: not received[-1].targets)


def test_targets_that_cannot_be_are_refused_in_the_diagnostics(graph):
    graph = graph()
    publisher, received = connected(graph)

    def refused(msg):
        publisher.publish(msg)
        graph.until(lambda: graph.planner._health.refusal)
        text, graph.planner._health.refusal = graph.planner._health.refusal, ""
        return text

    right = Target(id="grey_1", x=0.1, y=0.0, angle=np.nan)
    assert "no task of kind move runs" in refused(Targets(targets=[right]))
    graph.begin(100.0, play())
    many = [Target(id=f"black_{k}") for k in range(101)]
    assert "101 targets, allowed: at most 100" in refused(Targets(targets=many))
    assert "grey_1 occurs twice" in refused(Targets(targets=[right, right]))
    assert "frame is 'map'" in refused(Targets(header=Header(frame_id="map"), targets=[right]))
    assert not received[-1].targets
    wrong = Target(id="black_7", x=0.0, y=0.0, angle=np.nan)
    off = Target(id="grey_2", x=np.inf, y=0.0, angle=np.nan)
    text = refused(Targets(header=Header(frame_id="plate_home"), targets=[wrong, off, right]))
    assert "black_7 is unknown" in text
    assert "place of grey_2 is (inf, 0) m" in text
    graph.until(lambda: ids(received[-1]) == ["grey_1"])
    publisher.publish(Targets(targets=[wrong]))
    graph.until(lambda: "black_7 is unknown" in graph.planner._health.values(0.0)["refusal"])


def test_random_targets_never_lead_off_the_plate(graph):
    graph = graph()
    graph.begin(100.0, play(HERE))
    rng = np.random.default_rng(0)
    numbers = (0.0, -0.1, 0.1, 0.29, 1e-300, 1e300, np.nan, np.inf, -np.inf, 7.0)
    names = (*IDS, "", "black_", "x" * 5000, "grey_9", "red_1")
    half = graph.planner._rig.plate.half
    for k in range(500):
        targets = []
        for name in rng.choice(names, rng.integers(0, 4)):
            x, y, angle = rng.choice(numbers, 3)
            targets.append(Target(id=str(name), x=x, y=y, angle=angle))
        graph.planner._on_targets(Targets(targets=targets))
        for target in graph.planner._tasks.run.planner.scenario.task.targets:
            assert target.id in IDS
            assert np.all(np.abs(target.place) < half)
        if k % 100 == 0:
            requested = asked_now(graph, 100.3 + k / 200)
            assert set(requested.parts.ids) == set(IDS)
            assert np.all(np.isfinite(requested.targets.low))
