"""The program `plate`, which talks to running nodes where there is no `ros2`."""

import argparse
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rclpy.client import Client  # noqa: E402
from rclpy.task import Future  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from stepped_clock import SteppedExecutor  # noqa: E402

from plate_client.command import main  # noqa: E402
from plate_client.ros import services  # noqa: E402
from plate_client.ros.graph import Graph  # noqa: E402
from plate_client.ros.services import domains_in_use, no_graph_text  # noqa: E402
from plate_core import PlateError  # noqa: E402
from plate_core.ros import DATA, LATCHED, declare, follow, parameter  # noqa: E402
from plate_interfaces.msg import DriverStatus, TaskStatus  # noqa: E402

NAMESPACE = f"/command_test_{os.getpid()}"


@dataclass(frozen=True)
class Options:
    """Of the node that is talked to."""

    gain: float = parameter(0.5, "How much [-]", 0.0, 1.0, live=True)
    seed: int = parameter(3, "Of the noise", 0, 9)


@pytest.fixture
def make(clock, monkeypatch):
    """Function that makes a node of ours by its class and arguments; all have one executor."""
    rclpy.init()
    executor, nodes = SteppedExecutor(clock), []
    monkeypatch.setattr(rclpy, "spin_once", lambda _, timeout_sec: executor.spin_once(timeout_sec))

    def make(name, namespace=NAMESPACE):
        nodes.append(rclpy.create_node(name, namespace=namespace))
        executor.add_node(nodes[-1])
        return nodes[-1]

    make.executor = executor
    yield make
    executor.shutdown()
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


@pytest.fixture
def view(make):
    """Function from a namespace to the command's view of its nodes."""
    made = []

    def make_view(namespace):
        made.append(Graph(namespace))
        make.executor.add_node(made[-1].node)
        return made[-1]

    yield make_view
    for each in made:
        each.node.destroy_node()


@pytest.fixture
def graph(make, view):
    """The command's view of a node `talker`."""
    node, orders = make("talker"), []
    follow(node, declare(node, Options), lambda _: None)

    def answer(request, response):
        orders.append(getattr(request, "data", "home"))
        response.success, response.message = orders[-1] is not False, "so it is"
        return response

    for name in ("home", "emergency_stop"):
        node.create_service(Trigger, name, answer)
    node.create_service(SetBool, "enable", answer)
    node.create_publisher(TaskStatus, "task_status", LATCHED).publish(TaskStatus(text="idle"))
    return view(NAMESPACE)


@pytest.fixture
def program(make, graph):
    """Function that runs the program with these arguments, while the talker answers."""

    def run(*arguments, **options):
        with subprocess.Popen(
            [sys.executable, "-c", *arguments, "--namespace", NAMESPACE],
            stderr=subprocess.PIPE, text=True, **options,
        ) as process:  # fmt: skip
            while process.poll() is None:
                make.executor.settle()
                time.sleep(0.01)
            return process.returncode, *process.communicate()

    return run


def run_command(graph, command, *words):
    names = dict(zip(("node", "name", "value"), (*words, None), strict=False))
    return graph.run(argparse.Namespace(command=command, **names))


def test_services_and_state(graph):
    assert run_command(graph, "home") == "so it is"
    assert run_command(graph, "enable") == "so it is"
    with pytest.raises(PlateError, match="so it is"):  # refused, with the reason
        run_command(graph, "disable")
    with pytest.raises(PlateError, match="no service stop; running nodes: talker"):
        run_command(graph, "stop")
    assert not list(graph.node.clients)
    assert run_command(graph, "state").splitlines() == [
        "driver_status: no message",
        "task_status: idle",
    ]


@pytest.mark.parametrize("ends", ["ready", "stopped: supply"])
def test_enable_waits_until_the_motors_are_ready(make, view, clock, ends):
    """The state can change after the reply, or not at all; then the reason is printed."""
    node = make("driver")
    statuses = node.create_publisher(DriverStatus, "driver_status", LATCHED)
    statuses.publish(DriverStatus(state=DriverStatus.STOPPED, text="stopped: before"))
    state = DriverStatus.READY if ends == "ready" else DriverStatus.STOPPED
    due = []

    def answer(request, response):
        response.success, response.message = True, "enabling: driver_status reports"
        due.extend(
            [DriverStatus(state=DriverStatus.ENABLING), DriverStatus(state=state, text=ends)]
        )
        return response

    node.create_service(SetBool, "enable", answer)
    # As from the driver: its status arrives at the same time as the reply.
    node.create_timer(0.2, lambda: statuses.publish(due.pop(0)) if due else None, clock=clock.clock)
    graph = view(NAMESPACE)
    if ends == "ready":
        assert run_command(graph, "enable") == "ready"
    else:
        with pytest.raises(PlateError, match="not enabled; driver_status: stopped: supply"):
            run_command(graph, "enable")
    assert not [*graph.node.subscriptions, *graph.node.clients]


@pytest.fixture(params=["diagnostics", "/diagnostics"])
def starting(make, clock, request):
    """A node `solver` that publishes diagnostics, and a node `mute` that publishes none yet. The
    topic can be shared with another plate."""
    solver, mute = make("solver"), make("mute")
    publisher = solver.create_publisher(DiagnosticArray, request.param, DATA)
    mute.create_publisher(DiagnosticArray, request.param, DATA)
    name, level = solver.get_fully_qualified_name(), DiagnosticStatus.WARN
    status = DiagnosticStatus(level=level, name=name, message="waiting")
    other = DiagnosticStatus(level=level, name="/other/driver", message="disabled")
    msg = DiagnosticArray(status=[status, other])
    solver.create_timer(0.1, lambda: publisher.publish(msg), clock=clock.clock)


@pytest.mark.parametrize(("before", "after"), [("/", ""), ("", ""), ("/", "/")])
def test_slashes_around_a_namespace_do_not_matter(view, before, after):
    written = before + NAMESPACE.strip("/") + after
    assert view(written).node.get_namespace() == NAMESPACE


def test_state_while_nodes_start(graph, starting):
    assert run_command(graph, "state").splitlines()[2:] == [
        "some nodes have sent no message; other nodes may wait for them",
        "  mute: no message yet: the node is starting, or it hangs",
        "  solver: WARN, waiting",
    ]


def test_the_cause_of_a_waiting_goal_is_reported(graph, clock, capsys):
    class Plate:
        def start(self, scenario, waiting):
            for why in ("soon", "no parts yet", "again"):
                waiting(why)
                graph._until(lambda: False, 2.0)

    graph._start(Plate(), None)
    assert capsys.readouterr().out == "  2 s: no parts yet\n"


def test_parameters(graph):
    assert run_command(graph, "get", "talker", "seed") == "3"
    assert run_command(graph, "set", "talker", "gain", "1") == "talker gain: 0.5 -> 1.0"
    lines = run_command(graph, "params").splitlines()
    assert lines[0] == "talker"
    assert "  gain                 1.0            How much [-] (0.0 to 1.0)" in lines
    assert "  seed                 3              Of the noise (0 to 9) [fixed]" in lines


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("talker", "gain", "2"), r"gain out of range Min: 0.0, Max: 1.0, value: 2.0"),
        (("talker", "gain", ""), r"parameter gain of talker is '', allowed: a float"),
        (("talker", "gain", "{a: 1}"), r"parameter gain of talker is '{a: 1}', allowed: a float"),
        (
            ("talker", "gain", "2026-13-45"),
            r"parameter gain of talker is '2026-13-45', allowed: a float",
        ),
        (("talker", "gain", "["), r"parameter gain of talker is '\[', allowed: a float"),
        (("talker", "seed", "4"), r"talker refuses: .*read-only"),
        (("talker", "gian", "1"), r"talker has no parameter 'gian' \(did you mean gain\?\)"),
        (("talk", "gain", "1"), r"'talk' runs \(did you mean talker\?\); running nodes: talker"),
        (("gain", "1"), r"set requires NODE NAME VALUE.*talker"),
    ],
)
def test_invalid_parameters_are_refused(graph, words, message):
    with pytest.raises(PlateError, match=message):
        run_command(graph, "set", *words)


@pytest.mark.parametrize("command", ["disable", "emergency_stop"])
def test_an_urgent_command_waits_for_the_discovery_of_a_node(view, monkeypatch, command):
    alone, seen = view("/nowhere"), []

    def until(condition, timeout_s):
        seen.append(condition())
        return seen[-1]

    monkeypatch.setattr(alone, "_until", until)
    with pytest.raises(PlateError, match=r"no graph runs.*; cut the power by hand$"):
        run_command(alone, command)
    assert seen == [True, False]  # ends after the longer wait, not because no node is visible


@pytest.mark.parametrize(("command", "calls"), [("emergency_stop", 2), ("home", 1)])
def test_a_lost_reply_is_requested_again_if_that_is_harmless(graph, monkeypatch, command, calls):
    sent, call = [], Client.call_async

    def lossy(self, request):
        sent.append(request)
        return call(self, request) if len(sent) == 2 else Future()

    monkeypatch.setattr(Client, "call_async", lossy)
    if calls == 1:
        monkeypatch.setattr(services, "ANSWER_S", 0.1)
        with pytest.raises(PlateError, match="home does not answer"):
            run_command(graph, command)
    else:
        assert run_command(graph, command) == "so it is"
    assert len(sent) == calls


def test_any_service_that_takes_nothing_can_be_called(graph):
    def call(service):
        return graph.run(argparse.Namespace(command="call", service=service))

    assert call("home") == call(f"{graph.node.get_namespace()}/home") == "so it is"
    with pytest.raises(PlateError, match="no service talker/teach; running nodes: talker"):
        call("talker/teach")
    with pytest.raises(PlateError, match="service is 'a b', allowed: words of letters"):
        call("a b")


def test_commands_report_a_missing_graph(graph, view):
    alone = view("/nowhere")
    for command in ("home", "state", "params", "cancel", "set"):
        words = (
            rf"no graph runs in namespace /nowhere; namespaces .* {graph.node.get_namespace()}[,;]"
        )
        with pytest.raises(PlateError, match=words) as refused:
            run_command(alone, command)
        assert "cut the power" not in str(refused.value)  # nothing was to be stopped
    assert int(os.environ.get("ROS_DOMAIN_ID", "0")) in domains_in_use()


@pytest.mark.parametrize(
    ("others", "end"),
    [({5}, "=5"), ({5, 9}, "of your graph)"), ({0}, "0")],
)
def test_a_domain_is_recommended_only_where_it_can_be_no_other(monkeypatch, others, end):
    """The next command may be an enable."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    monkeypatch.setattr("plate_client.ros.services.domains_in_use", lambda: others)
    node = SimpleNamespace(
        get_namespace=lambda: "/", get_node_names_and_namespaces=lambda: [("arm", "/")]
    )
    assert no_graph_text(node).endswith(end)


@pytest.mark.parametrize(
    ("domain", "words", "message", "code"),
    [
        (
            "abc",
            ["state"],
            "plate: ROS_DOMAIN_ID is 'abc', allowed: a whole number from 0 to 232\n",
            1,
        ),
        ("-1", ["cut_power"], "plate: ROS_DOMAIN_ID is '-1', allowed", 1),
        ("999", ["state"], "plate: ROS_DOMAIN_ID is '999', allowed", 1),
        ("", ["state", "--namespace", "a b"], "plate: namespace is 'a b', allowed", 1),
        ("", ["goal", "/nowhere.yaml"], "plate: /nowhere.yaml: no such file\n", 2),
    ],
)
def test_a_wrong_command_line_gives_a_message_of_one_line(domain, words, message, code):
    program = "from plate_client.command import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, *words], env=os.environ | {"ROS_DOMAIN_ID": domain},
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert (done.returncode, done.stderr[: len(message)]) == (code, message)
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("command", "code"), [("emergency_stop", 0), ("disable", 1)])
def test_a_stop_waits_for_no_import_that_it_does_not_need(program, command, code):
    text = """
import sys
from plate_client.command import main
try:
    main()
finally:
    print({"scipy", "plate_core.ros", "plate_core.tasks", "rclpy.action"} & {*sys.modules})
"""
    returned, output, errors = program(text, command, stdout=subprocess.PIPE)
    assert returned == code
    assert "so it is" in output + errors
    assert output.splitlines()[-1] == "set()"


def test_a_stop_needs_no_log_file(program, monkeypatch):
    """As on a full disk."""
    monkeypatch.setenv("ROS_LOG_DIR", "/proc/none")
    text = "from plate_client.command import main; main()"
    returned, output, errors = program(text, "emergency_stop", stdout=subprocess.PIPE)
    assert (returned, output, errors) == (0, "so it is\n", "")


def test_a_closed_output_pipe_is_no_error(program):
    reader, writer = os.pipe()
    os.close(reader)
    text = "from plate_client.command import main; main()"
    returned, _, errors = program(text, "emergency_stop", stdout=writer)
    os.close(writer)
    assert (returned, errors) == (128 + signal.SIGPIPE, "")


def test_an_interrupt_during_imports_causes_a_message_of_one_line():
    program = """
import os, signal, sys
from plate_client.command import main
class Finder:
    def find_spec(self, name, *rest):
        if name == "rclpy":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program, "state"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (130, "plate: interrupted\n")


def test_an_unknown_command_lists_a_similar_command(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["plate", "enabel"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert (
        "command is 'enabel' (did you mean enable?), allowed: stop, enable"
        in capsys.readouterr().err
    )
