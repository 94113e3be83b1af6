"""A managed node works only while it is active, and releases everything at clean-up."""

import signal
import subprocess
import sys
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from plate_core import PlateError

rclpy = pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from stepped_clock import SteppedExecutor  # noqa: E402

from plate_core.ros import DATA, NodeOptions, SafeLifecycleNode, parameter, start_nodes  # noqa: E402
from plate_core.status import Finding, Level  # noqa: E402

MAX_S = 60
"""Maximum duration of an operation that takes a moment [s]."""


@dataclass(frozen=True)
class Options(NodeOptions):
    """Of the node of this test."""

    size: int = parameter(3, "What configure reads", 1, 9)
    gain: float = parameter(1.0, "May change at any time", 0.0, 2.0, live=True)


class EchoNode(SafeLifecycleNode[Options]):
    """Publishes each received message again, and ticks."""

    def __init__(self):
        super().__init__("echo", Options)
        self.report(lambda now: Finding(Level.OK, "well"), lambda: {"gain": self.options.gain})
        self.log, self.ticks, self.refuse = [], 0, None

    def configure(self):
        self.log.append(f"configure {self.options.size}")
        self.out = self.managed_publisher(String, "echo", DATA)
        self.managed_subscription(String, "word", self.out.publish, DATA)
        self.managed_service(Trigger, "~/order", self.answer)
        self.timer = self.managed_timer(0.01, self.tick)
        if self.refuse is not None:
            raise self.refuse

    def tick(self):
        self.ticks += 1

    def answer(self, request, response):
        response.success, response.message = True, "done"
        return response

    def begin(self):
        self.log.append("begin")

    def rest(self):
        self.log.append("rest")

    def release(self):
        self.log.append("release")

    def retune(self):
        self.log.append(f"retune {self.options.gain}")


class Peer:
    """The node, and one that talks to it."""

    def __init__(self, clock):
        rclpy.init(args=["--ros-args", "-r", "__ns:=/lifecycle_test"])
        self.echo, self.node = EchoNode(), rclpy.create_node("peer")
        self.executor, self.heard, self.reports = SteppedExecutor(clock), [], []
        for node in (self.echo, self.node):
            self.executor.add_node(node)
        self.node.create_subscription(String, "echo", lambda m: self.heard.append(m.data), DATA)
        self.node.create_subscription(DiagnosticArray, "diagnostics", self._on_report, DATA)
        self.words = self.node.create_publisher(String, "word", DATA)
        self.orders = self.node.create_client(Trigger, "echo/order")
        self.changes = self.node.create_client(ChangeState, "echo/change_state")
        self.asks = self.node.create_client(GetState, "echo/get_state")

    def _on_report(self, msg):
        (status,) = msg.status
        self.reports.append((int.from_bytes(status.level), status.message, len(status.values)))

    def until(self, condition, longest_s=MAX_S):
        clock = self.executor.clock
        end = clock.monotonic() + longest_s
        while not (done := condition()) and clock.monotonic() < end:
            self.executor.spin_once()
        return bool(done)

    def call(self, client, request):
        assert self.until(client.service_is_ready)
        future = client.call_async(request)
        assert self.until(future.done)
        return future.result()

    def change(self, transition):
        request = ChangeState.Request()
        request.transition.label = transition
        return self.call(self.changes, request).success

    def state(self):
        return self.call(self.asks, GetState.Request()).current_state.label

    def set(self, name, value):
        return self.echo.set_parameters_atomically([Parameter(name, value=value)])  # as services

    def echoes(self, word):
        """Whether a word comes back."""
        assert self.until(lambda: self.words.get_subscription_count() == 1)
        self.words.publish(String(data=word))
        return self.until(lambda: word in self.heard, 0.5)

    def wait_for_report(self, *report):
        """Wait for diagnostics with that level, message, and number of values."""
        assert self.until(lambda: self.reports[-1:] == [report]), self.reports[-1:]


@pytest.fixture(name="peer")
def _peer(clock):
    peer = Peer(clock)
    yield peer
    peer.executor.shutdown()
    peer.echo.destroy_node()
    peer.node.destroy_node()
    rclpy.shutdown()


def entities(node):
    kinds = node.publishers, node.subscriptions, node.services, node.timers
    return [len(list(each)) for each in kinds]


def test_a_node_works_only_while_it_is_active(peer):
    empty = entities(peer.echo)
    peer.wait_for_report(Level.WARN, "unconfigured", 0)
    for life in (1, 2):
        assert peer.change("configure")
        assert peer.state() == "inactive"
        peer.wait_for_report(Level.WARN, "inactive", 0)
        for spell in (1, 2):
            assert not peer.echoes(f"inactive {life} {spell}")
            ticks = peer.echo.ticks
            assert not peer.until(lambda n=ticks: peer.echo.ticks > n, 0.1)
            answer = peer.call(peer.orders, Trigger.Request())
            assert (answer.success, answer.message) == (False, "echo is inactive, allowed: active")
            assert peer.change("activate")
            assert peer.state() == "active"
            peer.wait_for_report(Level.OK, "well", 1)
            assert peer.echoes(f"active {life} {spell}")
            assert peer.until(lambda n=ticks: peer.echo.ticks > n)
            assert peer.call(peer.orders, Trigger.Request()).success
            assert peer.change("deactivate")
        assert peer.change("cleanup")
        assert peer.state() == "unconfigured"
        assert entities(peer.echo) == empty
    spells = ["begin", "rest"] * 2
    assert peer.echo.log == ["configure 3", *spells, "release"] * 2


def test_a_signal_within_a_transition_leaves_nothing(peer, capfd):
    empty = entities(peer.echo)

    def begin():
        raise KeyboardInterrupt

    peer.echo.begin = begin
    with pytest.raises(KeyboardInterrupt):
        start_nodes(peer.echo)
    peer.echo.close()
    assert entities(peer.echo) == empty
    assert "Traceback" not in capfd.readouterr().err


def test_a_publisher_without_a_name_is_not_a_second_node(peer, monkeypatch):
    def publishers(*names):
        found = [SimpleNamespace(node_namespace="/lifecycle_test", node_name=n) for n in names]
        monkeypatch.setattr(peer.echo, "count_publishers", lambda topic: len(found))
        monkeypatch.setattr(peer.echo, "get_publishers_info_by_topic", lambda topic: found)
        return peer.echo.second_publisher("word")

    assert publishers("peer", "_NODE_NAME_UNKNOWN_") == publishers("peer", "peer") == ""
    reported = "2 nodes publish word (other, peer), allowed: one"
    assert publishers("peer", "other") == reported


@pytest.mark.parametrize("before", [(), ("configure",), ("configure", "activate")])
def test_a_node_shuts_down_from_every_state_and_releases_everything(peer, before):
    empty = entities(peer.echo)
    for transition in before:
        assert peer.change(transition)
    assert peer.change("shutdown")
    assert peer.state() == "finalized"
    assert entities(peer.echo) == empty
    assert peer.echo.log[-1] == "release"
    assert peer.echo.log.count("rest") == (1 if "activate" in before else 0)
    for transition in ("configure", "activate", "shutdown"):
        assert not peer.change(transition)
    assert peer.state() == "finalized"


def test_a_transition_that_does_not_fit_the_state_is_refused(peer):
    for allowed, state in (
        ("configure", "unconfigured"), ("activate", "inactive"), ("deactivate", "active"),
        ("cleanup", "inactive"),
    ):  # fmt: skip
        assert peer.state() == state
        fitting = {
            "unconfigured": ("configure",), "inactive": ("activate", "cleanup"),
            "active": ("deactivate",),
        }[state]  # fmt: skip
        for other in {"configure", "activate", "deactivate", "cleanup", "nonsense"} - {*fitting}:
            assert not peer.change(other)
            assert peer.state() == state
        assert peer.change(allowed)


@pytest.mark.parametrize("refusal", [PlateError("size is 3, allowed: 4"), ValueError("a defect")])
def test_a_failed_configure_cleans_up_reports_why_and_can_be_repeated(peer, refusal):
    empty = entities(peer.echo)
    for _ in (1, 2):
        peer.echo.refuse = refusal
        assert not peer.change("configure")
        assert peer.state() == "unconfigured"
        assert entities(peer.echo) == empty
        peer.wait_for_report(Level.ERROR, f"unconfigured: {refusal}", 0)
    peer.echo.refuse = None
    assert peer.change("configure")
    peer.wait_for_report(Level.WARN, "inactive", 0)
    assert peer.change("activate")
    assert peer.echoes("well")


def test_a_parameter_that_configure_reads_can_change_while_the_node_is_inactive(peer):
    assert peer.set("size", 4).successful
    assert peer.change("configure")
    assert peer.set("size", 5).successful
    assert peer.echo.options.size == 4  # the configured values are in force
    assert peer.change("activate")
    result = peer.set("size", 6)
    assert not result.successful
    assert result.reason == (
        "parameter size is only read when echo is configured, allowed: changes while the node is "
        "not active"
    )
    assert peer.set("gain", 0.5).successful
    assert peer.echo.options == Options(size=4, gain=0.5)
    for transition in ("deactivate", "cleanup", "configure"):
        assert peer.change(transition)
    assert peer.echo.options == Options(size=5, gain=0.5)
    assert [line for line in peer.echo.log if line[0] in "cr"] == [
        "configure 4", "retune 0.5", "rest", "release", "configure 5",
    ]  # fmt: skip
    read_only = {name: peer.echo.describe_parameter(name).read_only for name in ("size", "gain")}
    assert read_only == {"size": False, "gain": False}
    assert not peer.set("autostart", False).successful
    assert peer.echo.describe_parameter("autostart").read_only


def test_a_value_that_a_parameter_has_is_accepted_in_any_state(peer):
    """As of `ros2 param load` with all that `ros2 param dump` has written."""
    names = [name for name in peer.echo.get_parameters_by_prefix("") if name != "size"]
    for transition in ("configure", "activate"):
        assert peer.change(transition)
        present = [peer.echo.get_parameter(name) for name in ("size", *names)]
        assert len(present) > 5
        for item in present:
            assert peer.set(item.name, item.value).successful, item.name
        for other in ([], [Parameter("gain", value=0.5)]):
            assert peer.echo.set_parameters_atomically([*present, *other]).successful
    assert peer.echo.options.gain == 0.5
    assert not peer.echo.set_parameters_atomically(
        [*present, Parameter("size", value=6)]
    ).successful
    assert peer.set("gain", 1).successful
    assert peer.set("gain", 1).successful  # as 1.0, which it has


@pytest.mark.parametrize(
    ("rig_file", "hardware"), [("", "default"), ("desk", "desk"), ("/somewhere/mine.yaml", "mine")]
)
def test_diagnostics_name_the_rig(peer, rig_file, hardware):
    received = []
    peer.node.create_subscription(
        DiagnosticArray, "diagnostics", lambda msg: received.append(msg.status[0].hardware_id), 10
    )
    assert peer.set("rig_file", rig_file).successful
    assert peer.until(lambda: received[-1:] == [hardware])


def test_a_parameter_that_it_does_not_have_is_named_and_the_nearest(peer):
    result = peer.set("gian", 0.5)
    assert not result.successful
    assert result.reason.startswith(
        "parameter gian is unknown to echo (did you mean gain?), allowed: rig_file, frame_prefix, "
    )
    assert "use_sim_time" not in result.reason


def test_the_clock_changes_while_the_node_is_not_active(peer):
    refused = (
        "parameter use_sim_time changes the clock of echo, allowed: changes while the node is "
        "not active"
    )
    clock, listens = peer.echo.get_clock(), peer.node.count_subscribers

    def set_atomically(**values):
        expected = [Parameter(name, value=value) for name, value in values.items()]
        return peer.echo.set_parameters_atomically(expected)

    assert peer.change("configure")
    for simulated in (True, False, True):
        assert peer.set("use_sim_time", simulated).successful
        assert clock.ros_time_is_active is simulated
        assert peer.change("activate")
        for result in (
            peer.set("use_sim_time", not simulated),
            set_atomically(gain=0.5, use_sim_time=not simulated),
        ):
            assert (result.successful, result.reason) == (False, refused)
        assert clock.ros_time_is_active is simulated
        assert (clock.now().nanoseconds == 0) is simulated  # /clock has no publisher
        assert peer.until(lambda n=simulated: listens("/clock") == n)
        assert peer.echo.get_parameter("use_sim_time").value is simulated
        assert peer.echo.options.gain == 1.0
        assert peer.change("deactivate")


def test_a_missing_or_second_source_of_simulated_time_is_reported(peer):
    other = rclpy.create_node("other")
    try:
        assert peer.set("use_sim_time", True).successful
        assert peer.change("configure")
        assert peer.change("activate")
        peer.wait_for_report(
            Level.WARN, "well; use_sim_time is true, but no node publishes /clock", 1
        )
        peer.node.create_publisher(Clock, "/clock", DATA)
        peer.wait_for_report(Level.OK, "well", 1)
        clock = other.create_publisher(Clock, "/clock", DATA)
        several = "2 nodes publish /clock (other, peer), allowed: one"
        peer.wait_for_report(Level.WARN, f"well; {several}", 1)
        assert peer.echo.second_clock() == several
        other.destroy_publisher(clock)
        peer.wait_for_report(Level.OK, "well", 1)
        assert peer.change("deactivate")
        assert peer.set("use_sim_time", False).successful
        other.create_publisher(Clock, "/clock", DATA)
        assert peer.until(lambda: peer.echo.count_publishers("/clock") == 2)
        assert (peer.echo.second_clock(), peer.echo.clock_problem()) == ("", "")
    finally:
        other.destroy_node()


def test_nodes_are_started_in_order_and_a_refusal_has_a_reason(peer):
    peer.echo.refuse = PlateError("size is 3, allowed: 4")
    with pytest.raises(PlateError, match="size is 3, allowed: 4"):
        start_nodes(peer.echo)
    assert peer.state() == "unconfigured"
    peer.echo.refuse = None
    start_nodes(peer.echo)
    assert peer.state() == "active"


PROGRAM = """
import sys, time
from plate_core.ros import NodeOptions, SafeLifecycleNode, run_node

class SlowNode(SafeLifecycleNode[NodeOptions]):
    def __init__(self):
        super().__init__("slow", NodeOptions)
        self.create_timer(0.01, self.tick)
        self.triggered = False

    def tick(self):
        if not (self.active or self.triggered):
            self.triggered = True
            self.trigger_configure()
        elif self.active:
            self.triggered = True
            print("active", flush=True)

    def configure(self):
        print("configuring", flush=True)
        for _ in range(0 if "quick" in sys.argv else 6000):
            time.sleep(0.01)  # a signal that comes just before a sleep is seen after it

    def release(self):
        print("released", flush=True)

run_node(SlowNode)
"""


@pytest.mark.parametrize("words", [(), ("--ros-args", "-p", "autostart:=false")])
def test_a_signal_ends_a_configure_that_takes_long(hears, words):
    """At the start, and ordered by somebody else."""
    command = [sys.executable, "-c", PROGRAM, *words]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert hears(process, "configuring")
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=30)  # less than it would take
    assert process.returncode == 0
    assert "released" in output


def test_by_itself_a_program_gets_active(hears):
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "quick"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert hears(process, "configuring")
        assert hears(process, "active")
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=MAX_S)
    assert process.returncode == 0
