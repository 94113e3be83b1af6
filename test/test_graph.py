"""The five nodes as processes, over real topics: tests that need the whole graph."""

import contextlib
import signal
import socket
import time
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from graph import domains
from graph.observer import Observer
from graph.processes import MAX_ENDS, WITHIN_S, Ends, Processes
from graph.session import session
from light_graph import LightOptions
from rcl_interfaces.srv import ListParameters
from rclpy.client import Client
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from record.film import decode_record
from record.judge import check_limits
from sensor_msgs.msg import Image
from short_task import MIDDLE
from trajectory_msgs.msg import JointTrajectory

from plate_bringup import GraphError, RunOptions, load_graph
from plate_core import load_rig
from plate_core.ros import IMAGE, NodeOptions, array_to_image, msg_to_motors, nanoseconds, to_time
from plate_core.tasks import load_scenario
from plate_interfaces.msg import DriverStatus, TaskStatus
from plate_sim.camera import Camera, part_greys
from plate_sim.world import Disturbances, WorldState

ROOT = Path(__file__).resolve().parents[1]
NAMES = ["simulator", "detector", "planner", "solver", "driver"]
GRAPH = {node.name: node for node in RunOptions().nodes(load_graph())}


def tables(record):
    """The plate motions of all motor tables so far."""
    rig = load_rig()
    return [msg_to_motors(rig, deserialize_message(d, JointTrajectory)) for d in record.tables]


def at_rest(cycle):
    return not np.any(cycle.knot_pose) and not np.any(cycle.knot_twist)


def given(file):
    """Parameters in a file of config/, by node."""
    text = (ROOT / "config" / file).read_text(encoding="utf-8")
    return {k.rsplit("/", 1)[-1]: v["ros__parameters"] for k, v in yaml.safe_load(text).items()}


def declared(name):
    """Default of each parameter of a node."""
    module = import_module(GRAPH[name].component.rsplit(".", 1)[0])
    kinds = [k for k in vars(module).values() if isinstance(k, type) and issubclass(k, NodeOptions)]
    (kind,) = (k for k in kinds if k is not NodeOptions)
    return {item.name: item.default for item in fields(kind)}


def test_the_parameter_files_agree_with_the_nodes():
    """Declared defaults; all disturbances; the planner's settings for a camera."""
    named = given("nodes.yaml")
    assert list(named) == NAMES
    for name, values in named.items():
        defaults = declared(name)
        assert values == {key: defaults.get(key) for key in values}, name
    disturbances = {item.name for item in fields(Disturbances)}
    assert disturbances <= named["simulator"].keys()
    for name, values in given("hardware.yaml").items():
        assert values.keys() <= declared(name).keys()
        if name == "planner":
            assert values.keys() <= named[name].keys()


def check_parameters(graph):
    """Nodes have the parameters that they declare, and the parameters of a run."""
    for name in NAMES:
        call = ListParameters, f"{name}/list_parameters", ListParameters.Request()
        known = set(graph.observer.call(*call).result.names)
        assert declared(name).keys() <= known
        assert set(graph.options.parameters(GRAPH[name])) <= known


# The closed loop

SORT_4: dict[str, Any] = {"scenario": "sort_4", "seed": 3, "lockstep": True, "autostart": False}


def by_stamp(record):
    """Motor tables as bytes. One that came twice is the same: on a slow machine the simulator shows
    an image again, and it is answered again."""
    found = {}
    for data in record.tables:
        stamp = nanoseconds(deserialize_message(data, JointTrajectory).header.stamp)
        assert found.setdefault(stamp, data) == data
    return found


def test_parts_are_sorted_and_the_method_changes_meanwhile(tmp_path):
    rig_file = str(ROOT / "config" / "rig.yaml")
    options = LightOptions(**SORT_4, rig_file=rig_file)
    with session(options, tmp_path / "processes") as graph:
        observer, record = graph.observer, graph.observer.record
        assert graph.nodes == NAMES
        check_parameters(graph)
        graph.begin()
        assert observer.until(lambda: record.last("planner", "parts_sorted", "0") >= "1", 60)
        assert record.last("solver", "method") == "sinusoids"
        graph.processes.signal("simulator", signal.SIGSTOP)  # without images the task waits
        before = by_stamp(record)
        observer.set_parameter("solver", "method", "A")
        with pytest.raises(GraphError, match="parameter method is 'C', allowed: one of "):
            observer.set_parameter("solver", "method", "C")
        assert not record.ended
        graph.processes.signal("simulator", signal.SIGCONT)
        assert observer.until(lambda: record.ended, 60)
        assert observer.until(lambda: record.last("solver", "method") == "rotations", 5)
        assert observer.until(lambda: record.last("planner", "task_state").startswith("done"), 5)
        for name in NAMES:
            graph.processes.signal(name, signal.SIGINT)
    assert graph.processes.exit_codes == dict.fromkeys(NAMES, 0)
    assert record.states[-1].startswith("done")
    rig = load_rig()
    assert decode_record(record, rig).dropped == 0
    check = check_limits(record, rig)
    assert check.tables > 20
    assert check.faults == ()
    assert 0.5 < check.fractions["accel"] <= 1
    check_all_nodes_in_one_process(tmp_path / "one process", before)


def check_all_nodes_in_one_process(folder, before):
    """They sort the parts too, and a seed gives the same run to the last bit."""
    with session(LightOptions(**SORT_4, one_process=True), folder) as graph:
        assert graph.nodes == NAMES
        assert graph.processes.names == ["one_process"]
        graph.begin()
        record = graph.observer.record
        assert graph.observer.until(lambda: record.ended, 60)
    assert graph.processes.exit_codes == {"one_process": 0}
    assert record.states[-1].startswith("done")
    assert check_limits(record, load_rig()).faults == ()
    now = by_stamp(record)
    both = sorted(before.keys() & now.keys())
    assert len(both) > 15
    moving = deserialize_message(before[both[-1]], JointTrajectory)
    assert not at_rest(msg_to_motors(load_rig(), moving))
    assert [before[stamp] for stamp in both] == [now[stamp] for stamp in both]


# Faults


class CameraStandIn:
    """Publishes pictures of a scenario's parts, right ones and wrong ones."""

    def __init__(self, observer, scenario):
        rig, rng = load_rig(), np.random.default_rng(0)
        world = WorldState.of_scenario(load_scenario(scenario), rig, rng)
        grey = part_greys([name.split("_")[0] for name in world.ids])
        self.picture = Camera(rig).render(world.position, grey, rng)
        self.observer = observer
        self.images = observer.node.create_publisher(Image, "image_raw", IMAGE)
        self.published_at = 0.0

    def stream(self, until, timeout_s=10.0, **changes):
        """Publish at 10 Hz until something holds; with changed fields if given."""
        for _ in range(int(10 * timeout_s)):
            self.publish(**changes)
            if self.observer.until(until, 0.1):
                return True
        return False

    def publish(self, **changes):
        msg = array_to_image(changes.pop("picture", self.picture), to_time(time.time_ns()))
        for name, value in changes.items():
            setattr(msg, name, value)
        self.images.publish(msg)
        self.published_at = time.monotonic()

    def pulse(self):
        """Publish at 10 Hz while the observer waits for something else."""
        if time.monotonic() > self.published_at + 0.1:
            self.publish()


WRONG_IMAGES = {
    "encoding is '32FC1', allowed: mono8, bgr8, rgb8": {"encoding": "32FC1"},
    "320 x 240": {"width": 320, "step": 320, "height": 240, "data": bytes(320 * 240)},
    "data has 1000 bytes, allowed: 307200": {"data": bytes(1000)},
}


def test_images_that_do_not_fit_leave_the_plate_at_rest(tmp_path, domain):
    nodes = [node for node in GRAPH.values() if node.on_hardware]
    with (
        Processes(nodes, LightOptions(scenario="sort_4"), tmp_path, domain) as processes,
        Observer(domain, processes.check) as observer,
    ):
        observer.await_nodes(NAMES[1:], 120)
        camera = CameraStandIn(observer, "sort_4")
        record = observer.record

        def moves():
            return bool(record.tables) and not at_rest(tables(record)[-1])

        def started():
            """Without images, the inputs of the task would be overdue at its start on a busy
            machine."""
            observer.pulses.append(camera.pulse)
            try:
                observer.start(load_scenario("sort_4"), 0.0)
            except GraphError:
                return False
            finally:
                observer.pulses.remove(camera.pulse)
            record.tasks.clear()
            record.tables.clear()
            return True

        def answered():
            """A task that starts before the first answer to a good image ends at once, because its
            inputs are overdue."""
            before = record.answers
            return camera.stream(lambda: record.answers > before + 1)

        for message, changes in WRONG_IMAGES.items():
            assert answered(), "good images are answered without a task too"
            assert camera.stream(started), "the task starts while good images come"
            assert camera.stream(moves), "good images move the plate"
            assert camera.stream(
                lambda m=message: record.ended and m in processes.log("detector").read_text(),
                **changes,
            ), "wrong ones are named, and the task ends"
            assert "images refused" in record.states[-1] or "no parts for" in record.states[-1]
        assert answered()
        assert camera.stream(started), "and good ones are enough to start again"
        assert camera.stream(moves)
    assert processes.exit_codes == dict.fromkeys(NAMES[1:], 0)


def test_a_node_that_is_deactivated_ends_the_task_and_works_again_when_it_is_activated(
    tmp_path, monkeypatch
):
    options = LightOptions(scenario=str(tmp_path / "middle.yaml"), autostart=False)
    Path(options.scenario).write_text(yaml.safe_dump(MIDDLE), encoding="utf-8")
    with session(options, tmp_path, pictures=False) as graph:
        observer, record = graph.observer, graph.observer.record
        graph.free()
        for name, topic in (("solver", "plate_cycle"), ("detector", "parts")):
            record.tasks.clear()
            observer.start(graph.scenario)
            record.tables.clear()
            assert observer.until(lambda: any(not at_rest(c) for c in tables(record)[-1:]), 30)
            observer.change_state(name, "deactivate")
            assert observer.until(lambda: record.ended, 30)
            assert f": no {topic} for " in record.states[-1]
            assert record.states[-1].endswith(f"the {name} runs and reports: inactive")
            assert observer.until(
                lambda: "the plate rests" in record.diagnostics["driver"][-1].text, 30
            )
            observer.change_state(name, "activate")
            observer.await_answers(30)
        observer.change_state("simulator", "deactivate")
        assert any(silent(observer) for _ in range(10))  # messages on their way still arrive
        lose_the_first_answer(monkeypatch)  # as DDS may
        observer.change_state("simulator", "activate")
        assert observer.until(lambda: record.truth, 30)
    assert graph.processes.exit_codes == dict.fromkeys(NAMES, 0)


def silent(observer):
    observer.record.truth.clear()
    return not observer.until(lambda: observer.record.truth, 1.0)


def lose_the_first_answer(monkeypatch):
    call, calls = Client.call_async, []

    def call_async(client, request):
        calls.append(call(client, request))
        return calls[-1] if len(calls) > 1 else Future()

    monkeypatch.setattr(Client, "call_async", call_async)


def test_a_task_does_not_begin_after_a_stop_by_another_client(tmp_path):
    """Else an enable would clear an emergency stop that a person has made."""
    link = str(tmp_path / "device")
    options = RunOptions(scenario="sort_4", transport="serial", autostart=False, link=link)
    with session(options, tmp_path, pictures=False) as graph:
        observer, record = graph.observer, graph.observer.record
        observer.trigger("stop")

        def reason(received):  # the first status may arrive after the reply
            return None if received is None else received.reason

        assert observer.until(lambda: reason(record.status) == TaskStatus.STOPPED, 10)
        with pytest.raises(GraphError, match="before the task began by the service stop"):
            graph.begin()
        assert not record.ready
        record.status = None
        observer.change_state("driver", "configure")
        with contextlib.suppress(GraphError):  # on a busy computer, the device confirms it later
            observer.trigger("emergency_stop")
        assert observer.until(lambda: reason(record.driver) == DriverStatus.EMERGENCY_STOP, 10)
        with pytest.raises(GraphError, match="began, driver: inactive: emergency stop; look at"):
            graph.begin()
    assert record.tables == []


def test_an_error_of_a_node_in_a_shared_process_names_the_node(tmp_path, domain):
    options = RunOptions(method="C", one_process=True)
    with Processes(GRAPH.values(), options, tmp_path, domain) as processes:
        assert processes.wait("one_process", 60) == 2
        *_, line = processes.log("one_process").read_text().splitlines()
    assert line.startswith("error: solver: parameter method is 'C', allowed: one of ")


BROKEN = "parts: [{class: black, count: 2}\ntask: ]"
WRONG_INPUT = [
    ("simulator", {"scenario": "sort_3"}, "scenario is 'sort_3' (did you mean sort_"),
    ("simulator", {"scenario": "broken.yaml"}, "broken.yaml: broken YAML at line "),
    ("simulator", {"seed": -1}, "parameter seed is -1, allowed: 0 to 2147483647"),
    ("solver", {"method": "C"}, "parameter method is 'C', allowed: one of "),
    ("driver", {"transport": "can"}, "transport is 'can', allowed: "),
    ("detector", {"rig_file": "none.yaml"}, "none.yaml: no such file"),
]


@pytest.mark.parametrize(("name", "changes", "message"), WRONG_INPUT)
def test_wrong_input_causes_a_message_of_one_line_and_exit_code_2(
    tmp_path, domain, monkeypatch, name, changes, message
):
    (tmp_path / "broken.yaml").write_text(BROKEN)
    monkeypatch.chdir(tmp_path)
    options = RunOptions(**changes)
    with Processes([GRAPH[name]], options, tmp_path, domain) as processes:
        assert processes.wait(name, 30) == 2
        lines = processes.log(name).read_text().splitlines()
        with pytest.raises(GraphError, match=f"{name} ended with exit code 2"):
            processes.check()
    assert len(lines) == 1
    assert message in lines[0]


def test_the_device_ends_after_the_driver_which_has_it_brake(tmp_path, domain):
    options = RunOptions(transport="serial")
    nodes = [node for node in options.nodes(load_graph()) if node.name in ("driver", "device")]
    pids, there = {node.name: tmp_path / f"{node.name}.pid" for node in nodes}, tmp_path / "there"
    ends = {
        "driver": f"sleep 0.3; kill -0 $(cat {pids['device']}) && touch {there}; exit 0",
        "device": "exit 0",
    }
    prefix = {
        name: [
            "sh",
            "-c",
            f"trap '{end}' INT; echo $$ > {pids[name]}; while :; do sleep 0.02; done",
        ]
        for name, end in ends.items()
    }
    with Processes(nodes, options, tmp_path, domain, prefix) as processes:
        while not all(pid.exists() and pid.read_text() for pid in pids.values()):
            time.sleep(0.02)
        assert processes.stop() == dict.fromkeys(processes.names, 0)
    assert there.exists()


def test_a_page_that_ends_again_and_again_is_given_up_but_not_one_that_seldom_does():
    last = MAX_ENDS - 1
    for period_s, given_up in ((WITHIN_S / last, True), (1.01 * WITHIN_S / last, False)):
        ends = Ends()
        reported = [ends.too_many(period_s * k) for k in range(3 * MAX_ENDS)]
        assert not any(reported[:last])
        assert reported[last:] == [given_up] * (len(reported) - last)


# The stored results of a run


def test_images_can_be_thinned_without_losing_beginning_or_end():
    from graph.observer import Thinned

    kept = Thinned(max_count=8)
    for k in range(100):
        kept.add(k)
        assert len(kept.items) < 8
    assert kept.items[0] == 0
    assert kept.items[-1] > 80
    assert len(set(np.diff(kept.items))) == 1


def test_an_occupied_domain_is_not_assigned(monkeypatch):
    monkeypatch.setattr(domains, "DOMAINS", range(102, 106))  # no other subscriber gets these
    with contextlib.ExitStack() as stack, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        first = [stack.enter_context(domains.own_domain()) for _ in range(2)]
        free = sorted({102, 103, 104, 105} - set(first))
        with contextlib.suppress(OSError):  # a real participant may have it
            other.bind(("", 7410 + 250 * free[0]))
        assert stack.enter_context(domains.own_domain()) == free[1]
        with pytest.raises(RuntimeError, match="all ROS domains from 102 to 105"):
            stack.enter_context(domains.own_domain())
    with domains.own_domain():
        pass
