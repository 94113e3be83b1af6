"""The node over real topics and services, in one process."""

import re
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import MultiDOFJointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from plate_core import Parts, PlateCycle, PlateError, load_rig  # noqa: E402
from plate_core.ros import DATA, LATCHED, cycle_to_msg, msg_to_wanted, parts_to_msg, to_time  # noqa: E402
from plate_planner.node import PlannerNode  # noqa: E402

IDS = ("black_1", "black_2", "grey_1", "grey_2")
APART = np.array([[-0.05, -0.05], [-0.05, 0.05], [0.05, -0.05], [0.05, 0.05]])
SORTED = APART * [4.5, 1.0]


class Graph:
    """The planner and a probe that speaks to it: also as the driver, whose state is said again and
    again while `driver` is not empty, and as the solver, while `answering`."""

    def __init__(self, driver="ready", **parameters):
        args = ["--ros-args", "-r", "__ns:=/planner_test"]
        for name, value in ({"scenario": "sort_4"} | parameters).items():
            args += ["-p", f"{name}:={value}"]
        rclpy.init(args=args)
        try:
            self.planner = PlannerNode()
        except BaseException:
            rclpy.try_shutdown()
            raise
        self.probe = rclpy.create_node("probe")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.planner)
        self.executor.add_node(self.probe)
        self.forces, self.states, self.diagnostics = [], [], []
        self.driver, self.answering, self.cycle = driver, True, PlateCycle.rest(0.1)
        self.parts = self.probe.create_publisher(MultiDOFJointState, "parts", DATA)
        listen = self.probe.create_subscription
        self.drivers = self.probe.create_publisher(String, "driver_state", LATCHED)
        self.cycles = self.probe.create_publisher(JointTrajectory, "plate_cycle", DATA)
        self.others = self.probe.create_publisher(DiagnosticArray, "diagnostics", DATA)
        self.probe.create_timer(0.2, self.say)
        listen(MultiDOFJointState, "part_forces", self.on_forces, DATA)
        listen(String, "task_state", lambda msg: self.states.append(msg.data), LATCHED)
        listen(DiagnosticArray, "diagnostics", self.on_diagnostics, DATA)
        self.clients = {name: self.probe.create_client(Trigger, name) for name in ("start", "stop")}
        # The latched state arrives on its own, which shows that the two have found each other.
        self.until(lambda: self.states and self.parts.get_subscription_count())
        self.until(lambda: self.planner.count_subscribers("part_forces"))
        self.until(lambda: not driver or self.planner._inputs.driver_state.known)

    def say(self):
        if self.driver:
            self.drivers.publish(String(data=self.driver))

    def on_forces(self, msg):
        self.forces.append(msg)
        if self.answering:
            self.answer()

    def answer(self):
        """As the solver does."""
        self.cycles.publish(cycle_to_msg(self.cycle, self.forces[-1].header.stamp))

    def on_diagnostics(self, msg):
        if msg.status[0].name.endswith("planner"):
            self.diagnostics.append(msg)

    def report(self):
        """The next diagnostics: level and message."""
        count = len(self.diagnostics)
        self.until(lambda: len(self.diagnostics) > count)
        status = self.diagnostics[-1].status[0]
        return status.level, status.message

    def begin(self, stamp_s=0.0):
        """Start, and show all parts until the task has begun."""
        self.image(stamp_s, APART)
        answer = self.call("start")
        assert answer.success, answer.message
        for k in (1, 2):
            self.image(stamp_s + 0.1 * k, APART)

    def until(self, true):
        for _ in range(2000):
            if true():
                return
            self.executor.spin_once(timeout_sec=0.01)
        raise AssertionError("it did not come")

    def call(self, name):
        self.until(self.clients[name].service_is_ready)
        future = self.clients[name].call_async(Trigger.Request())
        self.until(future.done)
        return future.result()

    def image(self, stamp_s, position, ids=IDS):
        """Publish parts and return the planner's answer."""
        count = len(self.forces)
        stamp = to_time(round(stamp_s * 1e9))
        self.parts.publish(parts_to_msg(Parts.make(ids, position), stamp))
        self.until(lambda: len(self.forces) > count)
        assert self.forces[-1].header.stamp == stamp
        return msg_to_wanted(self.forces[-1])

    def close(self):
        self.executor.shutdown()
        self.probe.destroy_node()
        self.planner.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def graph():
    made = []

    def make(**parameters):
        while made:
            made.pop().close()
        made.append(Graph(**parameters))
        return made[-1]

    yield make
    for item in made:
        item.close()


def test_a_task_from_start_to_done(graph):
    graph = graph()
    assert graph.image(100.0, APART).parts.ids == ()  # idle images are answered too
    answer = graph.call("start")
    assert (answer.success, answer.message) == (
        True,
        "sort_4 starts as soon as all 4 parts are seen",
    )
    refused = graph.call("start")
    assert (refused.success, refused.message) == (False, "sort_4 is running; call stop first")
    asked = graph.image(100.1, APART)
    assert asked.parts.ids == IDS
    assert np.all(asked.force[:2, 0] < 0)
    assert np.all(asked.force[2:, 0] > 0)
    assert np.all(asked.tolerance > 0)
    for k in range(2, 8):
        asked = graph.image(100.0 + 0.1 * k, SORTED)
    assert asked.parts.ids == ()
    graph.until(lambda: graph.states[-1].startswith("done"))
    assert graph.states[:2] == ["idle", "running"]
    assert re.fullmatch(r"done after \d+\.\d s: \d of \d parts in their regions", graph.states[2])
    graph.until(
        lambda: graph.diagnostics and graph.diagnostics[-1].status[0].message.startswith("done")
    )
    status = graph.diagnostics[-1].status[0]
    values = {item.key: item.value for item in status.values}
    assert status.hardware_id == "sort_4"
    assert (values["parts_sorted"], values["parts_total"]) == ("4", "4")
    assert float(values["time_s"]) == pytest.approx(0.6)
    assert "rms_error_m" in values


def test_stop_says_what_was_stopped(graph):
    graph = graph(autostart=True)
    assert graph.image(0.0, APART).parts.ids == ()
    graph.until(lambda: graph.states[-1] == "running")
    assert graph.image(0.1, APART).parts.ids == IDS
    answer = graph.call("stop")
    assert (answer.success, answer.message) == (True, "sort_4 stopped, was running")
    assert graph.image(0.2, APART).parts.ids == ()
    aborted = "aborted after 0.0 s: stopped"
    graph.until(lambda: graph.states[-1] == aborted)
    assert graph.call("stop").message == f"sort_4 stopped, was {aborted}"
    graph.until(lambda: graph.states[-1] == "idle")


def test_a_start_is_refused_with_the_reason(graph):
    graph = graph(driver="")
    assert graph.call("start").message == (
        "sort_4 is not started: no driver_state yet: does the driver run?"
    )
    for state in ("stopped: emergency stop; look at the rig, then call enable", "disabled"):
        graph.driver = state
        graph.until(lambda state=state: graph.planner._inputs.driver_state.text == state)
        answer = graph.call("start")
        assert (answer.success, answer.message) == (
            False,
            f"sort_4 is not started: driver: {state}",
        )
    graph.driver = "ready"
    graph.until(lambda: graph.planner._inputs.driver_state.text == "ready")
    assert graph.call("start").message == (
        "sort_4 is not started: no parts yet: does the detector run, does the camera?"
    )
    busy = DiagnosticStatus(name="/a/solver", message="compiling kernels for 3 s")
    graph.others.publish(DiagnosticArray(status=[busy]))
    graph.until(lambda: "solver" in graph.planner._inputs.reports)
    assert graph.call("start").message == (
        "sort_4 is not started: the solver is compiling kernels for 3 s"
    )
    done = DiagnosticStatus(name="/a/solver", message="waiting for part_forces")
    graph.others.publish(DiagnosticArray(status=[done]))
    graph.until(lambda: "waiting" in graph.planner._inputs.reports["solver"].message)
    graph.image(0.0, APART)
    assert graph.call("start").success
    assert graph.states == ["idle", "running"]


def test_it_starts_by_itself_once_and_only_when_the_driver_is_ready(graph):
    graph = graph(driver="inactive", autostart=True)
    graph.image(0.0, APART)
    graph.until(lambda: graph.diagnostics)
    assert graph.states == ["idle"]
    graph.driver = "ready"
    graph.until(lambda: graph.states[-1] == "running")
    graph.driver = "stopped"
    graph.until(lambda: graph.states[-1] == "aborted: driver: stopped")
    graph.driver = "ready"
    graph.until(lambda: graph.planner._inputs.driver_state.text == "ready")
    graph.image(0.1, APART)
    graph.report()
    assert graph.states[-1] == "aborted: driver: stopped"


@pytest.mark.parametrize(
    "state",
    [
        "stopped: emergency stop; look at the rig, then call enable",
        "disabled",
        "braking",
        "inactive",
    ],
)
def test_a_driver_that_is_not_ready_ends_the_task_at_once(graph, state):
    graph = graph()
    graph.begin()
    graph.driver = state
    aborted = f"aborted after 0.1 s: driver: {state}"
    graph.until(lambda: graph.states[-1] == aborted)
    assert graph.report() == (
        DiagnosticStatus.ERROR,
        f"{aborted}; driver: {state}",
    )
    assert graph.image(0.5, APART).parts.ids == ()


def test_an_error_of_the_driver_may_pass_but_not_stay(graph):
    graph = graph(input_timeout_s=30.0)  # no images come here
    graph.begin()
    graph.driver = "error: the device does not answer"
    graph.until(lambda: graph.planner._inputs.error_since is not None)
    graph.driver = "ready"
    graph.until(lambda: graph.planner._inputs.error_since is None)
    assert graph.states[-1] == "running"
    graph.driver = "error: the device does not answer"
    graph.until(lambda: graph.states[-1].endswith(": driver: error: the device does not answer"))


def stale(name, message):
    status = DiagnosticStatus(level=DiagnosticStatus.STALE, name=f"/a/{name}", message=message)
    return DiagnosticArray(status=[status])


class Silenced(Graph):
    """A graph with a running task, fed with images except where the test takes something away."""

    def feed(self, until, what=lambda: None):
        for k in range(3, 200):
            what()
            if until():
                return
            self.image(0.1 * k, APART)
            end = time.monotonic() + 0.05
            while time.monotonic() < end:
                self.executor.spin_once(timeout_sec=0.01)
        raise AssertionError(f"it did not end: {self.states}")


@pytest.fixture
def silenced():
    graph = Silenced(input_timeout_s=0.5)
    graph.begin()
    yield graph
    graph.close()


def test_without_parts_the_task_ends_without_any_image(silenced):
    silenced.until(lambda: silenced.states[-1] != "running")
    assert silenced.states[-1].startswith("aborted after 0.1 s: no parts for 0.")
    assert silenced.states[-1].endswith("does the detector run, does the camera?")
    silenced.until(lambda: silenced.report()[0] == DiagnosticStatus.ERROR)
    # A stop acknowledges it; then diagnostics only tell what is missing.
    silenced.call("stop")
    silenced.until(lambda: silenced.states[-1] == "idle")
    silenced.until(lambda: silenced.report()[0] == DiagnosticStatus.STALE)


def test_the_same_image_again_and_again_is_no_news(silenced):
    def again():
        silenced.parts.publish(parts_to_msg(Parts.make(IDS, APART), to_time(200_000_000)))
        silenced.executor.spin_once(timeout_sec=0.01)
        return silenced.states[-1] != "running"

    silenced.until(again)
    assert ": no parts for " in silenced.states[-1]


def test_a_solver_that_does_not_answer_ends_the_task(silenced):
    silenced.answering = False
    silenced.feed(lambda: silenced.states[-1] != "running")
    assert ": no plate_cycle for 0." in silenced.states[-1]
    assert silenced.states[-1].endswith("does the solver run?")


def test_a_driver_that_falls_silent_ends_the_task(silenced):
    silenced.driver = ""
    silenced.feed(lambda: silenced.states[-1] != "running")
    assert ": no driver_state for 0." in silenced.states[-1]


def test_a_node_of_the_loop_that_misses_its_input_ends_the_task(silenced):
    silenced.feed(
        lambda: silenced.states[-1] != "running",
        lambda: [
            silenced.others.publish(stale("camera_driver", "no coffee")),
            silenced.others.publish(stale("simulator", "no motor table for 1.5 s")),
        ],
    )
    assert silenced.states[-1].endswith(": simulator: no motor table for 1.5 s")


def test_a_planner_that_stood_still_does_not_go_on(silenced):
    time.sleep(1.0)
    why = "aborted after 0.1 s: the planner itself stood still for"
    silenced.until(lambda: silenced.states[-1].startswith(why))


def test_a_failure_tells_its_reason(graph):
    graph = graph(autostart=True, unseen_timeout_s=0.1)
    graph.answering = False  # else the planner carries the part on
    for t in (0.9, 1.0):
        graph.image(t, APART)
    for t in (1.1, 1.2, 1.3):
        graph.image(t, APART[:3], IDS[:3])
    graph.until(lambda: graph.states[-1].startswith("lost part after 0.3 s: grey_2 was seen last"))


def test_forces_are_drawn_for_those_who_look(graph):
    graph, drawn = graph(), []
    graph.probe.create_subscription(MarkerArray, "markers", drawn.append, DATA)
    graph.until(lambda: graph.planner._markers.get_subscription_count())
    graph.begin(1.0)
    asked = graph.image(1.3, APART)
    graph.until(lambda: len(drawn) >= 4)
    unit = load_rig().force_unit
    assert np.abs(asked.force).max() > 0.01 * unit
    for marker, place, force in zip(
        drawn[-1].markers, asked.parts.position, asked.force, strict=True
    ):
        assert (marker.ns, marker.header.frame_id) == ("forces", "plate_home")
        tail, tip = marker.points
        assert (tail.x, tail.y) == tuple(place)
        assert np.allclose([tip.x - tail.x, tip.y - tail.y], 0.1 * force / unit)


@pytest.fixture
def asked_of_the_next_image(graph):
    """Function to the forces (4, 2) for an image that comes after the answer to the one before, or
    earlier."""

    def ask(late):
        node = graph(lockstep=True)
        t = np.arange(64) / 64 * 0.1
        node.cycle = PlateCycle.from_samples(
            0.1, 2e-3 * np.outer(np.sin(20 * np.pi * t), [1, 0, 0])
        )
        node.begin(1.0)
        node.until(lambda: not node.planner._open)
        node.answering = not late
        node.image(1.3, APART)
        node.until(lambda: node.planner._open is late)
        count, stamp = len(node.forces), to_time(1_400_000_000)
        node.parts.publish(parts_to_msg(Parts.make(IDS, APART + 1e-3), stamp))
        if late:
            node.until(lambda: node.planner._early is not None)
            assert len(node.forces) == count
            node.answer()
        node.until(lambda: len(node.forces) > count)
        assert node.forces[count].header.stamp == stamp
        return msg_to_wanted(node.forces[count]).force

    return ask


def test_in_lockstep_it_does_not_matter_who_hears_a_cycle_first(asked_of_the_next_image):
    in_time = asked_of_the_next_image(late=False)
    np.testing.assert_array_equal(asked_of_the_next_image(late=True), in_time)
    assert np.any(in_time)


def test_in_lockstep_the_task_begins_with_the_second_image(graph):
    # One of the two hears first that the driver is ready: the planner, or the simulator by a table.
    graph = graph(driver="inactive", lockstep=True, autostart=True)
    for _ in range(2):
        assert graph.image(1.0, APART).parts.ids == ()
    graph.until(lambda: not graph.planner._open)
    count = len(graph.forces)
    graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), to_time(1_100_000_000)))
    graph.until(lambda: graph.planner._early is not None)
    graph.report()
    assert len(graph.forces) == count
    graph.driver = "ready"
    graph.until(lambda: len(graph.forces) > count)
    assert msg_to_wanted(graph.forces[-1]).parts.ids == IDS


def test_in_lockstep_a_solver_that_does_not_answer_ends_the_task(graph):
    graph = graph(lockstep=True, input_timeout_s=0.5)
    graph.begin()
    graph.until(lambda: not graph.planner._open)
    graph.answering = False
    graph.image(0.3, APART)
    count = len(graph.forces)
    graph.parts.publish(parts_to_msg(Parts.make(IDS, APART), to_time(400_000_000)))
    graph.until(lambda: len(graph.forces) > count)  # the loop goes on when the solver does
    graph.until(lambda: graph.states[-1] != "running")
    assert ": no plate_cycle for " in graph.states[-1]
    assert msg_to_wanted(graph.forces[-1]).parts.ids == ()


def test_a_wrong_message_is_answered_with_rest(graph):
    graph = graph(autostart=True)
    graph.image(0.0, APART)
    assert graph.image(0.1, APART * [np.nan, 1]).parts.ids == ()
    assert graph.image(0.2, APART, ("black_1", "black_1", "grey_1", "grey_2")).parts.ids == ()
    assert graph.image(0.3, APART).parts.ids == IDS


def test_gains_change_while_it_runs_and_wrong_ones_are_refused(graph):
    graph = graph(autostart=True, drift_max=0.01)
    graph.image(0.0, APART)
    slow = graph.image(0.1, APART)
    ok, bad, fixed = graph.planner.set_parameters(
        [Parameter("drift_max", value=v) for v in (0.02, 5.0)]
        + [Parameter("scenario", value="sort_6")]
    )
    assert ok.successful
    assert (bad.successful, bad.reason) == (
        False,
        "parameter drift_max is 5.0, allowed: 0.0005 to 0.2",
    )
    assert not fixed.successful
    fast = graph.image(0.2, APART)
    assert fast.force[:, 0] == pytest.approx(2 * slow.force[:, 0])


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"scenario": "sort_11"}, r"scenario is 'sort_11' .did you mean"),
        ({"drift_max": 1.0}, r"parameter drift_max is 1.0, allowed: 0.0005 to 0.2"),
        ({"rig_file": "nowhere.yaml"}, r"nowhere.yaml: no such file"),
    ],
)
def test_wrong_parameters_are_refused_at_start(parameters, message):
    with pytest.raises(PlateError, match=message):
        Graph(**parameters)
