"""The node over real topics and services, in one process."""

import itertools
import re

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from action_msgs.msg import GoalStatus  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from planner_graph import APART, ERROR, IDS, NOT_READY, READY, SORT_4, SORTED, Graph, stale  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from stepped_clock import STEP_S  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from plate_core import OverlookedThing, Parts, PlateCycle, PlateError, load_rig  # noqa: E402
from plate_core.ros import (  # noqa: E402
    DATA,
    LATCHED,
    cycle_to_msg,
    nanoseconds,
    parts_to_msg,
    scenario_to_goal,
    to_time,
)
from plate_core.tasks import load_scenario  # noqa: E402
from plate_interfaces.msg import DriverStatus, FeedOrder, PartForces, TaskStatus  # noqa: E402
from plate_interfaces.srv import MeasureFriction  # noqa: E402
from plate_planner.supervision.inputs import FEEDER_S  # noqa: E402


def test_with_a_camera_that_runs_free_each_cycle_is_answered(graph):
    graph = graph(camera_triggered=False)
    starts = graph.probe.create_publisher(JointTrajectory, "cycle_started", DATA)
    graph.until(starts.get_subscription_count)
    began = []

    def shown(k, images=True):
        """Images in mid-cycle, and the start of a cycle, without a request in between."""
        for t in (100.03, 100.07) if images else ():
            stamp = to_time(round(1e9 * (t + 0.1 * k)))
            graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), stamp))
        stamp = to_time(round(1e9 * (100.1 + 0.1 * k)))
        starts.publish(cycle_to_msg(PlateCycle.rest(0.1), stamp))
        graph.until(lambda: stamp in [msg.header.stamp for msg in graph.forces])
        began.append(stamp)

    graph.image(100.0, APART)  # answered, so that the loop goes on before any cycle begins
    assert "no start of a cycle yet" in graph.refused(SORT_4)[1]
    shown(0)
    handle = graph.send(SORT_4)
    graph.forces.clear()
    began.clear()
    for k in range(1, 8):
        shown(k)
    assert [msg.header.stamp for msg in graph.forces] == began
    assert not graph.forces[0].forces or graph.forces[0].at_start
    requested = graph.forces[-1]
    assert len(requested.forces) == 4
    assert requested.at_start
    assert nanoseconds(requested.start) == nanoseconds(began[-1]) + 100_000_000
    # If no images arrive, nothing is requested once the last one is older than 0.4 s.
    for k in range(8, 14):
        shown(k, images=False)
    assert [len(msg.forces) for msg in graph.forces[-6:]] == [4, 4, 4, 0, 0, 0]
    # Starts that cannot be are no starts, and the same start again puts no answer off.
    wrong = [
        (PlateCycle.rest(0.1), 1100.0),
        (PlateCycle.rest(0.1), 5.0),
        (PlateCycle.rest(1e-9), 101),
    ]
    for cycle, t in wrong:
        starts.publish(cycle_to_msg(cycle, to_time(round(1e9 * t))))
    for _ in range(20):
        starts.publish(cycle_to_msg(PlateCycle.rest(0.1), began[-1]))
    count = len(graph.forces)
    status = graph.until_ended(handle, graph.image_alone)
    assert len(graph.forces) == count
    assert status.reason == TaskStatus.NO_CYCLE
    assert "cycle_started" in status.text


def test_an_image_from_before_the_clock_was_set_back_is_as_old_as_it_may_be(graph, monkeypatch):
    """The clock steps back by 0.3 s, while a message with the last image may be on its way."""
    graph = graph(camera_triggered=False)
    starts = graph.probe.create_publisher(JointTrajectory, "cycle_started", DATA)
    graph.until(starts.get_subscription_count)

    def begin(k):
        """Publish the start of a cycle, 0.1 s after the last image if k is 0. Return the number of
        requested forces."""
        stamp = to_time(graph.clock.ns + round(1e8 * k))
        starts.publish(cycle_to_msg(PlateCycle.rest(0.1), stamp))
        graph.until(lambda: graph.forces and graph.forces[-1].header.stamp == stamp)
        return len(graph.forces[-1].forces)

    def show():
        graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), to_time(graph.clock.ns - 10**8)))

    show()
    begin(-0.5)
    handle = graph.send(SORT_4)
    show()
    assert begin(0) == 4
    show()
    assert begin(0.5) == 4
    graph.clock.steady_ahead_s = 0.3
    assert begin(2) == 0  # 0.3 s old, or 0.6 s
    assert "set back, so the plate rests for about 0.3 s" in graph.planner._health.refusal
    graph.clock.step(0.5)
    show()
    assert begin(0) == 4
    for ahead_s, k in ((1.3, 2), (2.3, 3)):  # the rest is longer than the input timeout
        graph.clock.steady_ahead_s = ahead_s
        show()
        assert begin(k) == 0
    status = graph.until_ended(handle, lambda _: graph.executor.settle())
    assert status.reason == TaskStatus.NO_PARTS
    assert "clock was set back, so the plate rests for about 2.0 s; then start" in status.text


def test_a_task_from_goal_to_done(graph):
    graph = graph()
    assert graph.image(100.0, APART).parts.ids == ()  # idle images are answered too
    handle = graph.send()
    request = graph.image(100.1, APART)
    assert request.parts.ids == IDS
    assert np.all(request.forces.force[:2, 0] < 0)
    assert np.all(request.forces.force[2:, 0] > 0)
    assert np.all(request.targets.high[:2, 0] < 0)
    assert np.all(request.targets.low[2:, 0] > 0)
    for k in range(2, 8):
        request = graph.image(100.0 + 0.1 * k, SORTED)
    assert request.parts.ids == ()
    status, task = graph.result(handle)
    assert (status, task.state, task.reason) == (
        GoalStatus.STATUS_SUCCEEDED, TaskStatus.DONE, TaskStatus.NONE
    )  # fmt: skip
    assert (task.task, task.progress.parts_sorted, task.progress.parts_total) == ("sort", 4, 4)
    assert task.progress.time_s == pytest.approx(0.6)
    assert graph.states[:2] == ["idle", "running"]
    assert re.fullmatch(r"done after \d+\.\d s: \d of \d parts in their regions", graph.states[2])
    assert graph.statuses[-1] == task
    assert len(graph.feedback) >= 7
    assert {each.parts_total for each in graph.feedback} == {4}
    assert graph.feedback[-1].time_s == pytest.approx(0.5)
    graph.until(
        lambda: graph.diagnostics and graph.diagnostics[-1].status[0].message.startswith("done")
    )
    status = graph.diagnostics[-1].status[0]
    values = {item.key: item.value for item in status.values}
    assert values["task"] == "sort"
    assert (values["parts_sorted"], values["parts_total"]) == ("4", "4")
    assert float(values["time_s"]) == pytest.approx(0.6)
    assert "rms_error_m" in values


def test_cancel_ends_the_task(graph):
    graph = graph()
    handle = graph.begin()
    future = handle.cancel_goal_async()
    graph.until(future.done)
    status, task = graph.result(handle)
    assert (status, task.state, task.reason) == (
        GoalStatus.STATUS_CANCELED, TaskStatus.ABORTED, TaskStatus.CANCELED
    )  # fmt: skip
    assert task.text == "aborted after 0.1 s: canceled"
    assert graph.image(0.3, APART).parts.ids == ()
    graph.until(lambda: graph.report()[0] == DiagnosticStatus.WARN)  # no failure
    again = handle.cancel_goal_async()  # of an ended task
    graph.until(again.done)
    assert not again.result().goals_canceling


def test_a_newer_goal_is_refused_or_preempts(graph):
    graph = graph()
    first = graph.begin()
    assert graph.refused() == (
        TaskStatus.BUSY, "the task sort is running: cancel it first, or set the parameter preempt"
    )  # fmt: skip
    graph.planner.set_parameters([Parameter("preempt", value=True)])
    second = graph.send(load_scenario("assemble_8"))
    status, task = graph.result(first)
    assert (status, task.reason) == (GoalStatus.STATUS_ABORTED, TaskStatus.PREEMPTED)
    assert graph.states[-1] == "running"
    graph.stop()
    assert graph.result(second)[1].reason == TaskStatus.STOPPED


def test_stop_reports_the_stopped_task(graph):
    graph = graph()
    handle = graph.begin()
    assert graph.image(0.3, APART).parts.ids == IDS
    answer = graph.stop()
    assert (answer.success, answer.message) == (True, "stopped; state before: running")
    assert graph.result(handle)[1].reason == TaskStatus.STOPPED
    assert graph.image(0.4, APART).parts.ids == ()
    aborted = "aborted after 0.2 s: stopped"
    graph.until(lambda: graph.states[-1] == aborted)
    assert graph.stop().message == f"no task runs; the last task: {aborted}"
    graph.until(lambda: graph.states[-1] == "idle")
    # The requests of this task stay published: the driver may have learned its end only from them.
    assert nanoseconds(graph.statuses[-1].header.stamp) == 400_000_000


def test_a_stop_ends_a_measurement_of_friction(graph):
    """It is no task, but moves the plate."""
    graph, calls = graph(), []

    def on_call(request, response):
        calls.append(request.start)
        return response

    graph.probe.create_service(MeasureFriction, "measure_friction", on_call)
    graph.driver = DriverStatus(state=DriverStatus.CALIBRATING, text="calibrating")
    graph.until(graph.planner._friction.service_is_ready)
    graph.until(lambda: graph.driver_text() == "calibrating")
    messages = "no task runs; a friction measurement is canceled, a calibration continues"
    assert graph.stop().message == messages
    graph.until(lambda: calls)
    assert calls == [False]


def test_a_stop_when_no_task_runs_is_reported(graph):
    graph = graph()
    assert graph.stop().message == "no task runs"
    graph.until(lambda: graph.statuses[-1].reason == TaskStatus.STOPPED)
    assert graph.statuses[-1].state == TaskStatus.IDLE
    graph.begin()
    assert graph.statuses[-1].reason == TaskStatus.NONE


def test_missing_parts_are_explained_by_the_detectors_message(graph):
    graph = graph(input_timeout_s=0.3)
    name, message = "/planner_test/detector", "no image yet; check that the camera runs"
    messages = DiagnosticStatus(name=name, message=message)
    graph.others.publish(DiagnosticArray(status=[messages]))
    graph.until(lambda: "detector" in graph.planner._monitor.inputs.reports)
    text = "idle; no parts yet; the detector runs and reports: " + messages.message
    assert graph.report() == (DiagnosticStatus.STALE, text)


def test_a_goal_is_refused_with_the_reason(graph):
    graph = graph(driver=None)
    refused = graph.refused()
    not_ready = TaskStatus.NOT_READY
    text = "the task sort was not started: no driver_status yet; check that the driver runs"
    assert refused == (not_ready, text)
    for status in (*NOT_READY, ERROR, READY):
        graph.driver = status
        graph.until(lambda text=status.text: graph.driver_text() == text)
        if status is not READY:
            why = f"the task sort was not started: driver: {status.text}"
            assert graph.refused() == (not_ready, why)
    text = "the task sort was not started: no parts yet; check that the detector and the camera run"
    assert graph.refused() == (not_ready, text)
    name, goal = scenario_to_goal(SORT_4)
    goal.hold_s = float("nan")
    text = "sort_parts: task: hold_s is nan, allowed: a number from 0 to 60"
    assert graph.refused(None, (name, goal)) == (TaskStatus.INVALID_GOAL, text)
    graph.image(0.0, APART)
    graph.send()
    graph.until(lambda: graph.states == ["idle", "running"])


def test_images_of_another_clock_are_the_reason_why_no_task_starts(graph):
    """A camera whose stamps count from its start, and a driver with the time of day."""
    graph = graph(camera_triggered=False)
    starts = graph.probe.create_publisher(JointTrajectory, "cycle_started", DATA)
    graph.until(starts.get_subscription_count)
    graph.image(12.0, APART)
    starts.publish(cycle_to_msg(PlateCycle.rest(0.1), to_time(1_796_070_000_000_000_000)))
    graph.until(lambda: graph.planner._monitor.inputs.start_refusal)
    reason, text = graph.refused(SORT_4)
    assert reason == TaskStatus.NOT_READY
    assert "refuses the reports of cycle starts: cycle_started: its stamp minus the stamp" in text
    assert "check that all clocks are synchronised" in text


@pytest.mark.parametrize(("unit", "count"), [("mm", 1000.0), ("cm", 100.0)])
def test_parts_in_another_unit_than_metres_are_named(graph, unit, count):
    """Parts of another program. A goal is refused, and a task ends, with this reason."""
    graph = graph()
    hint = f"in {unit}, this position would be on the plate: publish positions in m"
    graph.image(0.0, count * APART)
    graph.until(lambda: graph.planner._monitor.inputs.refusal)
    reason, text = graph.refused()
    assert reason == TaskStatus.NOT_READY
    assert text.startswith("the task sort was not started: the planner refuses the messages")
    assert text.endswith(hint)
    handle = graph.begin(1.0)
    for k in range(30):
        graph.image(2.0 + 0.1 * k, count * APART)
        graph.executor.spin_for(0.1)
    status, task = graph.result(handle)
    assert (status, task.reason) == (GoalStatus.STATUS_ABORTED, TaskStatus.NO_PARTS)
    assert hint in task.text


def test_a_deactivated_planner_ends_the_task_and_refuses_goals(graph):
    graph = graph()
    handle = graph.begin()
    graph.planner.trigger_deactivate()
    status, task = graph.result(handle)
    assert (status, task.reason) == (GoalStatus.STATUS_ABORTED, TaskStatus.STOPPED)
    assert graph.refused() == (TaskStatus.NOT_READY, "the planner is not active")
    graph.planner.trigger_activate()
    graph.until(lambda: graph.states[-1] == "idle")
    graph.until(lambda: graph.planner._monitor.inputs.driver_status)
    graph.begin(1.0)


def test_a_planner_that_is_deactivated_waits_for_the_delivery_of_the_last_status(
    graph, monkeypatch
):
    graph = graph()
    graph.begin()
    statuses, calls = graph.planner._reports._statuses, []
    publish = statuses.publish
    monkeypatch.setattr(statuses, "publish", lambda msg: (calls.append(msg.reason), publish(msg)))
    monkeypatch.setattr(statuses, "wait_for_all_acked", lambda timeout: calls.append("waits"))
    graph.planner.trigger_deactivate()
    assert calls[-2:] == [TaskStatus.STOPPED, "waits"]


@pytest.mark.parametrize("status", NOT_READY, ids=lambda status: status.text)
def test_a_driver_that_is_not_ready_ends_the_task_at_once(graph, status):
    graph = graph()
    handle = graph.begin()
    graph.driver = status
    aborted = f"aborted after 0.1 s: driver: {status.text}"
    graph.until(lambda: graph.states[-1] == aborted)
    assert graph.result(handle)[1].reason == TaskStatus.DRIVER_STOPPED
    assert graph.report() == (DiagnosticStatus.ERROR, aborted)
    assert graph.image(0.5, APART).parts.ids == ()


def test_a_second_driver_is_reported_and_no_task_starts(graph):
    graph = graph(input_timeout_s=30.0)
    graph.image(0.0, APART)
    other = rclpy.create_node("other_driver")
    other.create_publisher(DriverStatus, graph.drivers.topic_name, LATCHED)
    try:
        text = "2 nodes publish driver_status (other_driver, probe), allowed: one"
        graph.until(lambda: graph.planner._monitor.second_publishers())
        assert graph.refused() == (TaskStatus.NOT_READY, f"the task sort was not started: {text}")
        assert text in graph.report()[1]
    finally:
        other.destroy_node()
    graph.until(lambda: not graph.planner._monitor.second_publishers())
    graph.begin(0.1)


def test_no_task_starts_by_a_clock_of_two_nodes(graph):
    graph = graph(input_timeout_s=30.0, use_sim_time=True)
    graph.image(0.0, APART)
    others = [rclpy.create_node(name) for name in ("gazebo", "simulator")]
    try:
        for node in others:
            node.create_publisher(Clock, graph.planner.resolve_topic_name("/clock"), DATA)
        text = "2 nodes publish /clock (gazebo, simulator), allowed: one"
        graph.until(lambda: graph.planner._monitor.second_publishers())
        assert graph.refused() == (TaskStatus.NOT_READY, f"the task sort was not started: {text}")
        graph.until(lambda: text in graph.report()[1])
        assert graph.report()[1].count(text) == 1
    finally:
        for node in others:
            node.destroy_node()
    graph.until(lambda: not graph.planner._monitor.second_publishers())
    graph.begin(0.1)


def test_a_second_planner_of_the_same_name_ends_the_task(graph):
    graph = graph(input_timeout_s=30.0)
    handle = graph.begin()
    twin = rclpy.create_node("planner")
    forces = twin.create_publisher(PartForces, "part_forces", DATA)
    try:
        graph.until(lambda: forces.get_subscription_count() == 2)
        for k in range(3, 7):
            forces.publish(PartForces())
            stamp = to_time(100_000_000 * k)
            graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), stamp))
            graph.until(lambda stamp=stamp: stamp in [msg.header.stamp for msg in graph.forces])
        _, task = graph.result(handle)
        assert task.reason == TaskStatus.RIVAL
        text = "two nodes with the same name publish part_forces (planner), allowed: one"
        assert text in task.text
    finally:
        twin.destroy_node()


def test_an_error_of_the_driver_may_pass_but_not_stay(graph):
    graph = graph(input_timeout_s=30.0)  # no images come here
    graph.begin()
    graph.driver = ERROR
    graph.until(lambda: graph.planner._monitor.inputs.error_since is not None)
    graph.driver = READY
    graph.until(lambda: graph.planner._monitor.inputs.error_since is None)
    assert graph.states[-1] == "running"
    graph.driver = ERROR
    graph.until(lambda: graph.states[-1].endswith(": driver: error: the device does not answer"))


def test_motors_that_were_stopped_and_enabled_again_end_the_task(graph):
    """Other nodes may not have received the stop in between."""
    graph = graph()
    handle = graph.begin()
    enabled_again = DriverStatus(state=DriverStatus.READY, text="ready", enabled_at=to_time(1))
    graph.driver = enabled_again
    task = graph.result(handle)[1]
    assert task.reason == TaskStatus.DRIVER_STOPPED
    assert task.text.endswith(": driver: the motors were stopped and enabled again")


def test_a_driver_status_with_invalid_codes_is_refused(graph):
    graph = graph()
    graph.begin()
    for wrong in (DriverStatus(state=99), DriverStatus(state=DriverStatus.READY, reason=200)):
        graph.drivers.publish(wrong)
    graph.until(lambda: "driver_status: reason is 200, allowed: 0 to 19" in graph.report()[1])
    assert graph.states[-1] == "running"


class Silenced(Graph):
    """A graph with a running task, fed with images except where the test takes something away."""

    def feed(self, until, what=lambda: None):
        for k in range(3, 200):
            what()
            if until():
                return
            self.image_and_pause(k)
        raise AssertionError(f"it did not end: {self.states}")


@pytest.fixture
def silenced(clock):
    graph = Silenced(clock, input_timeout_s=0.5)
    graph.begin()
    yield graph
    graph.close()


def test_without_parts_the_task_ends_without_any_image(silenced):
    silenced.until(lambda: silenced.states[-1] != "running")
    assert silenced.states[-1].startswith("aborted after 0.1 s: no parts for ")
    assert silenced.states[-1].endswith("check that the detector and the camera run")
    silenced.until(lambda: silenced.report()[0] == DiagnosticStatus.ERROR)
    # A stop acknowledges the failure. Then diagnostics report only missing inputs.
    silenced.stop()
    silenced.until(lambda: silenced.states[-1] == "idle")
    silenced.until(lambda: silenced.report()[0] == DiagnosticStatus.STALE)


def test_a_repeated_image_counts_as_no_new_parts(silenced):
    for _ in range(20):
        silenced.parts.publish(parts_to_msg(Parts.make(IDS, APART), to_time(200_000_000)))
        silenced.executor.spin_for(STEP_S)
    assert ": no new parts for " in silenced.states[-1]


@pytest.mark.parametrize("lasts", [True, False])
def test_an_error_of_the_detector_ends_the_task_if_it_lasts(silenced, lasts):
    """Parts come as before, but their places are wrong."""
    wrong, right = stale("detector", "the camera was moved"), stale("detector", "all images used")
    wrong.status[0].level, right.status[0].level = DiagnosticStatus.ERROR, DiagnosticStatus.OK
    images = itertools.count()

    def report():
        silenced.others.publish(wrong if lasts or next(images) % 8 == 0 else right)

    if lasts:
        silenced.feed(lambda: silenced.states[-1] != "running", report)
        assert silenced.states[-1].endswith(": detector: the camera was moved")
    else:
        silenced.feed(lambda: next(images) > 60, report)
        assert silenced.states[-1] == "running"


@pytest.mark.parametrize("namespace", ["/left/", "/", "/planner_test/deep/", "planner_test/", ""])
def test_diagnostics_of_other_plates_and_packages_do_not_end_the_task(silenced, namespace):
    """All of them can share one topic."""
    other = stale("driver", "no message", namespace)
    other.status[0].level = DiagnosticStatus.ERROR
    images = itertools.count()
    silenced.feed(lambda: next(images) > 60, lambda: silenced.others.publish(other))
    assert silenced.states[-1] == "running"
    assert "driver" not in silenced.planner._monitor.inputs.reports


def test_a_feed_continues_without_a_feeder_but_not_after_the_loss_of_one(graph):
    graph, images = graph(), itertools.count(3)
    orders = graph.probe.create_publisher(FeedOrder, "feed_orders", DATA)
    graph.until(orders.get_subscription_count)
    handle = graph.begin(scenario=load_scenario("feed"))
    end = graph.clock.monotonic() + FEEDER_S + 0.5
    while graph.clock.monotonic() < end:
        graph.image_and_pause(next(images))
    assert graph.states[-1].startswith("running")
    orders.publish(FeedOrder(mode=FeedOrder.REST, hidden=True))
    graph.until(lambda: graph.planner._tasks.run.planner.scenario.task.order.hidden)
    task = graph.until_ended(handle, lambda _: graph.image_and_pause(next(images)))
    assert (task.state, task.reason) == (TaskStatus.ABORTED, TaskStatus.CUT_OFF)
    assert ": no feed_orders for 1." in task.text
    # Orders that came before a task count nothing for it.
    graph.send(load_scenario("feed"))
    graph.until(lambda: graph.states[-1].startswith("running"))
    for _ in range(5):
        graph.image_and_pause(next(images))
    assert graph.states[-1].startswith("running")


def test_a_goal_that_was_sent_while_the_planner_stood_still_is_not_begun(graph):
    graph = graph(input_timeout_s=30.0)
    graph.image(0.0, APART)
    graph.planner._monitor._standstill._checked -= 2.0
    reason, text = graph.refused()
    assert (reason, text) == (
        TaskStatus.NOT_READY, "the planner was stalled: send the goal again"
    )  # fmt: skip
    graph.until(lambda: not graph.planner._monitor._standstill.is_late(graph.clock.monotonic()))
    graph.begin(0.1)


def test_an_order_of_a_second_publisher_is_not_executed(graph, monkeypatch):
    graph = graph(input_timeout_s=30.0)
    monkeypatch.setattr(
        graph.planner._monitor, "second_publishers", str
    )  # it may have ended before it is named
    orders = graph.probe.create_publisher(FeedOrder, "feed_orders", DATA)
    graph.until(orders.get_subscription_count)
    graph.begin(scenario=load_scenario("feed"))
    stranger = rclpy.create_node("stranger")
    foreign = stranger.create_publisher(FeedOrder, "feed_orders", DATA)
    came, modes = [], set()
    received = graph.probe.create_subscription(FeedOrder, "feed_orders", came.append, DATA)

    def in_force():
        order = graph.planner._tasks.run.planner.scenario.task.order
        modes.add(order.mode)
        return order

    try:
        graph.until(lambda: foreign.get_subscription_count() == 2)
        orders.publish(FeedOrder(mode=FeedOrder.REST))
        graph.until(lambda: in_force().mode == FeedOrder.REST)
        modes.clear()
        foreign.publish(FeedOrder(mode=FeedOrder.PURGE))
        graph.until(lambda: in_force() and FeedOrder.PURGE in [each.mode for each in came])
        orders.publish(FeedOrder(mode=FeedOrder.REST, hidden=True))
        graph.until(lambda: in_force().hidden)
    finally:
        graph.probe.destroy_subscription(received)
        stranger.destroy_node()
    assert modes == {FeedOrder.REST}


def test_forces_are_drawn_if_there_are_subscribers(graph):
    graph, drawn = graph(), []
    graph.probe.create_subscription(MarkerArray, "markers", drawn.append, DATA)
    graph.until(lambda: graph.planner._markers.get_subscription_count())
    graph.begin(1.0)
    request = graph.image(1.3, APART)
    graph.until(lambda: len(drawn) >= 3)
    unit = load_rig().force_unit
    assert np.abs(request.forces.force).max() > 0.01 * unit
    for marker, position, force in zip(
        drawn[-1].markers, request.parts.position, request.forces.force, strict=True
    ):
        assert (marker.ns, marker.header.frame_id) == ("forces", "plate_home")
        tail, tip = marker.points
        assert (tail.x, tail.y) == tuple(position)
        assert np.allclose([tip.x - tail.x, tip.y - tail.y], 0.1 * force / unit)


def test_a_wrong_message_is_answered_with_rest(graph):
    graph = graph()
    graph.begin()
    assert graph.image(0.3, APART * [np.nan, 1]).parts.ids == ()
    assert graph.image(0.4, APART, ("black_1", "black_1", "grey_1", "grey_2")).parts.ids == ()
    assert graph.image(0.5, APART).parts.ids == IDS


def test_gains_change_while_it_runs_and_wrong_ones_are_refused(graph):
    graph = graph(kp=0.2)
    graph.image(0.0, APART)
    ok, bad, fixed = graph.planner.set_parameters(
        [Parameter("kp", value=v) for v in (0.4, 5.0)] + [Parameter("stuck_timeout_s", value=5.0)]
    )
    assert ok.successful
    assert not bad.successful
    assert "kp out of range Min: 0.0, Max: 2.0, value: 5.0" in bad.reason
    assert not fixed.successful
    assert graph.planner.options.planner().follow.kp == 0.4


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"scenario": "sort_11"}, r"parameter scenario is unknown to planner"),
        ({"kp": 3.0}, r"parameter kp is 3.0, allowed: 0.0 to 2.0"),
        ({"rig_file": "nowhere.yaml"}, r"nowhere.yaml: no such file"),
    ],
)
def test_wrong_parameters_are_refused_at_start(clock, parameters, message):
    with pytest.raises(PlateError, match=message):
        Graph(clock, **parameters)


def test_a_task_reports_what_else_the_image_shows(graph):
    graph, seen = graph(), Parts.make(IDS, APART)

    def show(stamp_s, things):
        count = len(graph.forces)
        graph.parts.publish(parts_to_msg(seen, to_time(round(1e9 * stamp_s)), overlooked=things))
        graph.until(lambda: len(graph.forces) > count)

    graph.begin()
    for k in range(3, 9):
        show(0.1 * k, (OverlookedThing(0.0, 0.02, 0.009, "misfit"),))
    graph.report()
    level, message = graph.report()
    assert level == DiagnosticStatus.WARN
    assert "sort moves 4 parts: the image shows 1 undetected object (misfit" in message
    for k in range(9, 15):
        show(0.1 * k, ())
    graph.report()
    assert "the image shows" not in graph.report()[1]
