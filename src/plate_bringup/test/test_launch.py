"""The launch files: the actions that they start, with stand-ins of `launch`, and with `launch`
itself if it is installed."""

import re
import subprocess
import sys
import types
from pathlib import Path

import pytest
import yaml

from plate_bringup import GraphError, RunOptions, load_graph
from plate_core import config_path

LAUNCH = Path(__file__).resolve().parents[1] / "launch"
NAMES = ["simulator", "detector", "planner", "solver", "driver"]
ACTIONS = ("DeclareLaunchArgument", "ExecuteProcess", "GroupAction", "LogInfo", "OpaqueFunction")


class Recorded:
    """Stands for any action, and keeps its arguments."""

    def __init__(self, kind, *args, **values):
        self.kind, self.args = kind, args
        self.__dict__ |= values


@pytest.fixture
def stand_in(monkeypatch):
    """Modules that record the requests of a launch file."""

    def module(name, kinds):
        made = types.ModuleType(name)
        for kind in kinds:
            setattr(made, kind, lambda *args, kind=kind, **values: Recorded(kind, *args, **values))
        monkeypatch.setitem(sys.modules, name, made)

    module("launch", ())
    sys.modules["launch"].LaunchDescription = list
    module("launch.actions", (*ACTIONS, "RegisterEventHandler", "Shutdown", "TimerAction"))
    module("launch.event_handlers", ("OnProcessIO",))
    module("launch_ros", ())
    module("launch_ros.actions", ("Node",))
    monkeypatch.delitem(sys.modules, "plate_bringup.actions", raising=False)
    yield
    sys.modules.pop("plate_bringup.actions", None)


def described(file):
    path = LAUNCH / f"{file}.launch.py"
    scope = {"__name__": file, "__file__": str(path)}
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), scope)
    return scope["generate_launch_description"]()


def started(file, outer=(), **given):
    """Actions of a launch file by the name of their node; `given` are its arguments.

    `outer` are files of parameters of actions around it. Nodes have all files in `parameters`, in
    the order in which launch_ros passes them.
    """
    *arguments, start = described(file)
    values = {a.args[0]: a.default_value for a in arguments}
    context = types.SimpleNamespace(launch_configurations=values | given)
    if outer:
        context.launch_configurations["global_params"] = [*outer]
    (group,) = start.function(context)
    first, *actions = group.args[0]
    first.function(context)
    nodes = [action for action in actions if action.kind == "Node"]
    for node in nodes:
        node.parameters = [*context.launch_configurations["global_params"], *node.parameters]
    others = [action for action in actions if action.kind == "ExecuteProcess"]
    return {getattr(node, "name", node.executable): node for node in nodes}, others


def messages(file, **given):
    """The texts that a launch file logs before it starts its nodes."""
    *arguments, start = described(file)
    values = {a.args[0]: a.default_value for a in arguments} | given
    (group,) = start.function(types.SimpleNamespace(launch_configurations=values))
    return [action.msg for action in group.args[0] if action.kind == "LogInfo"]


def in_ros(node, folder, space=""):
    """The values that ROS gives to a node of this name from its files, by rcl's own rule."""
    rclpy = pytest.importorskip("rclpy")
    words = ["--ros-args"]
    for number, given in enumerate(node.parameters):
        path = given
        if isinstance(given, dict):  # as launch_ros does it
            path = folder / f"{node.name}_{number}.yaml"
            own = {f"{space}/{node.name}": {"ros__parameters": given}}
            path.write_text(yaml.safe_dump(own if given else {}), encoding="utf-8")
        words += ["--params-file", str(path)]
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    one = rclpy.create_node(
        node.name, namespace=space, context=context, cli_args=words, use_global_arguments=False,
        automatically_declare_parameters_from_overrides=True, start_parameter_services=False,
    )  # fmt: skip
    values = {name: each.value for name, each in one.get_parameters_by_prefix("").items()}
    one.destroy_node()
    context.try_shutdown()
    return values


@pytest.mark.parametrize("space", ["", "left", "cell/left"])
def test_arguments_come_before_files_and_files_before_defaults(stand_in, tmp_path, space):
    """Whatever the namespace, and whichever section of a file a value stands in."""
    own, outer = tmp_path / "own.yaml", tmp_path / "outer.yaml"
    place = f"/{space}/" if space else "/"
    sections = {
        own: {f"{place}simulator": {"noise": 3.0, "rate": 3.0}, "/**/driver": {"transport": "no"},
              "/**/simulator": {"seed": 3, "scenario": "no"}},
        outer: {"/**": {"robot_name": "ur5"}, "/**/simulator": {"hold_cycles": 4, "latency": 0.4},
                f"{place}simulator": {"image_rate": 4.0, "noise": 4.0}},
    }  # fmt: skip
    for file, values in sections.items():
        data = {name: {"ros__parameters": each} for name, each in values.items()}
        file.write_text(yaml.safe_dump(data), encoding="utf-8")
    given = {"scenario": "sort_4", "transport": "serial", "rate": "0.5", "namespace": space}
    nodes, _ = started("closed_loop", [str(outer)], params_file=str(own), **given)
    values = in_ros(nodes["simulator"], tmp_path, f"/{space}" if space else "")
    assert values["scenario"] == "sort_4"
    assert (values["rate"], values["seed"], values["noise"]) == (0.5, 3, 3.0)
    assert (values["hold_cycles"], values["latency"], values["image_rate"]) == (4, 0.4, 4.0)
    assert (values["blur"], values["robot_name"]) == (True, "ur5")
    assert values.get("frame_prefix", "") == (f"{space}/" if space else "")
    driver = in_ros(nodes["driver"], tmp_path, f"/{space}" if space else "")
    assert driver["transport"] == "serial"


@pytest.mark.parametrize("space", ["", "cell/left"])
def test_parameters_of_outer_actions_are_for_all_nodes(stand_in, tmp_path, space):
    """Those of SetParameter have the priority of a section `/**`, and nodes can ignore them."""
    own = tmp_path / "own.yaml"
    own.write_text("/**/solver: {ros__parameters: {restarts: 4}}", encoding="utf-8")
    outer = [("method", "rotations"), ("robot_name", "7"), ("seed", 3), ("gains", (1.0, 2.5))]
    given = {"namespace": space, "seed": "5", "params_file": str(own)}
    nodes, _ = started("closed_loop", outer, **given)
    assert not [each for node in nodes.values() for each in node.parameters if type(each) is tuple]
    place = f"/{space}" if space else ""
    values = in_ros(nodes["solver"], tmp_path, place)
    assert (values["method"], values["seed"], values["restarts"]) == ("rotations", 5, 4)
    assert (values["robot_name"], list(values["gains"])) == ("7", [1.0, 2.5])
    assert in_ros(nodes["detector"], tmp_path, place)["seed"] == 3
    files = [yaml.safe_load(Path(path).read_text()) for path in nodes["detector"].parameters[:-2]]
    sections = [name for data in files for name, each in data.items() if "method" in str(each)]
    assert sections == ["/**/solver", "/**"]  # the defaults, and SetParameter


def test_nodes_use_simulated_time_exactly_if_the_simulator_publishes_it(stand_in, tmp_path):
    own = tmp_path / "own.yaml"

    def clocks(values="{}", **given):
        own.write_text(f"/**/simulator: {{ros__parameters: {values}}}", encoding="utf-8")
        outer = [("use_sim_time", True)] if given.pop("outer", False) else []
        nodes, _ = started("closed_loop", outer, params_file=str(own), **given)
        return {
            name: in_ros(nodes[name], tmp_path)["use_sim_time"] for name in ("detector", "driver")
        }

    real, simulated = (dict.fromkeys(("detector", "driver"), flag) for flag in (False, True))
    for given in ({}, {"rate": "1"}, {"values": "{rate: 1.0, simulated_time: false, x: 2}"}):
        assert clocks(**given) == clocks(outer=True, **given) == real
    for given in ({"rate": "2"}, {"lockstep": "true"}, {"values": "{rate: 2.0}"},
                  {"values": "{simulated_time: true}"}):  # fmt: skip
        assert clocks(**given) == clocks(outer=True, **given) == simulated
    assert clocks("{rate: 2.0}", rate="1") == real
    own.write_text("/**: {ros__parameters: {use_sim_time: true}}", encoding="utf-8")
    nodes, _ = started("closed_loop", params_file=str(own), namespace="left")
    assert in_ros(nodes["solver"], tmp_path, "/left")["use_sim_time"] is False
    (text,) = messages("closed_loop", params_file=str(own))
    assert text.startswith("warning: use_sim_time is ignored, because the simulation runs in real")
    assert messages("closed_loop", params_file=str(own), rate="2") == []
    own.write_text("/**: {ros__parameters: {use_sim_time: false}}", encoding="utf-8")
    assert messages("closed_loop", params_file=str(own)) == []
    own.write_text("/**: {ros__parameters: {use_sim_time: true}}", encoding="utf-8")
    nodes, _ = started("hardware", params_file=str(own))
    assert in_ros(nodes["solver"], tmp_path)["use_sim_time"] is True  # a bag may be played


def test_a_file_may_take_the_prefix_of_frames_away(stand_in, tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text('/**: {ros__parameters: {frame_prefix: ""}}', encoding="utf-8")
    nodes, _ = started("closed_loop", params_file=str(own), namespace="left")
    assert in_ros(nodes["detector"], tmp_path, "/left")["frame_prefix"] == ""


@pytest.mark.parametrize(
    ("file", "names", "files"),
    [
        ("closed_loop", NAMES, ["nodes.yaml"]),
        ("hardware", NAMES[1:], ["nodes.yaml", "hardware.yaml"]),
    ],
)
def test_launch_files_start_the_same_list(stand_in, file, names, files):
    nodes, others = started(file, method="rotations")
    assert list(nodes) == names
    assert others == []
    listed = {node.name: node for node in load_graph()}
    for name, node in nodes.items():
        assert (node.package, node.executable) == (listed[name].package, listed[name].executable)
        assert [Path(path).name for path in node.parameters[:-1]] == files
        expected = {"method": "rotations"} if name == "solver" else {}
        assert node.parameters[-1] == expected  # omitted arguments have the values of the files


def test_arguments_become_parameters_topics_and_a_recorder(stand_in, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.touch()
    given = {"port": "/dev/ttyS9", "image_topic": "/eye", "record": "true", "seed": "3"}
    nodes, (recorder,) = started("hardware", params_file=str(mine), method="rotations", **given)
    assert nodes["driver"].parameters[-1] == {"port": "/dev/ttyS9"}
    assert nodes["solver"].parameters[-1] == {"method": "rotations", "seed": 3}
    assert nodes["detector"].parameters[-2] == str(mine)
    assert nodes["detector"].remappings == [("image_raw", "/eye")]
    assert recorder.cmd[:3] == ["ros2", "bag", "record"]
    with pytest.raises(GraphError, match=r"params_file none\.yaml: no such file"):
        started("hardware", params_file="none.yaml")


def test_a_camera_by_name_is_started_and_unmeasured_values_are_reported(stand_in):
    nodes, _ = started("hardware", camera="/dev/video0", image_topic="/eye")
    assert list(nodes) == ["camera", *NAMES[1:]]
    assert nodes["camera"].parameters[-1] == {"device": "/dev/video0"}
    assert nodes["camera"].remappings == [("image_raw", "/eye")]


def test_rig_of_the_scenario_is_taken_where_none_is_given(stand_in, tmp_path):
    def rigs(file, **given):
        nodes, _ = started(file, scenario="follow_2_desk", **given)
        return {node.parameters[-1].get("rig_file") for node in nodes.values()}

    mine = tmp_path / "mine.yaml"
    mine.write_text("/**/solver: {ros__parameters: {method: rotations}}", encoding="utf-8")
    assert rigs("closed_loop") == {"desk"}
    assert rigs("closed_loop", rig_file="my_rig.yaml") == {"my_rig.yaml"}
    assert rigs("closed_loop", params_file=str(mine)) == {"desk"}
    mine.write_text("/**: {ros__parameters: {rig_file: washers}}", encoding="utf-8")
    assert rigs("closed_loop", params_file=str(mine)) == {None}
    assert rigs("closed_loop", outer=[str(mine)]) == {None}  # of SetParametersFromFile
    both = rigs("closed_loop", params_file=str(mine), rig_file="my_rig.yaml")
    assert both == {"my_rig.yaml"}
    assert rigs("closed_loop", outer=[("rig_file", "washers")]) == {None}  # of SetParameter
    assert rigs("closed_loop", outer=[("seed", 3)]) == {"desk"}
    deep, alias = b"[" * 3000, b"/**: &all {ros__parameters: {rig_file: washers}, below: *all}"
    beyond = b'"\\UFFFFFFFF"'
    for text in (b"[", b"\xff", b"", b"- rig_file", deep, alias, beyond):  # the nodes refuse it
        mine.write_bytes(text)
        assert rigs("closed_loop", params_file=str(mine)) == {"desk"}
    # In ROS, a date that does not exist is a text.
    mine.write_text("/**: {ros__parameters: {rig_file: washers, day: 2026-13-45}}")
    assert rigs("closed_loop", params_file=str(mine)) == {None}


@pytest.mark.parametrize("space", ["", "left", "cell/left"])
@pytest.mark.parametrize(
    "section",
    ["/**", "/*", "/**/solver", "/*/solver", "solver", "/left/solver", "left: {'*': ",
     "left: {solver: ", "cell/left/solver", "/cell/*/solver", "/cell/**", "/*/*/solver",
     "/right/**", "/**/left/*", "sol"],
)  # fmt: skip
def test_a_parameter_file_sets_the_rig_of_the_nodes_that_its_sections_match(
    stand_in, tmp_path, section, space
):
    own = tmp_path / "own.yaml"
    below = "{ros__parameters: {rig_file: washers}}"
    text = f"{section}{below}}}" if "{" in section else f"{section}: {below}"
    own.write_text(text, encoding="utf-8")
    given = {"scenario": "follow_2_desk", "params_file": str(own), "namespace": space}
    nodes, _ = started("closed_loop", **given)
    added = {node.parameters[-1].pop("rig_file", None) for node in nodes.values()}
    of_file = in_ros(nodes["solver"], tmp_path, f"/{space}" if space else "").get("rig_file")
    assert (of_file, added) in [("washers", {None}), (None, {"desk"})]


def test_unmeasured_facts_are_those_of_the_rig_that_the_nodes_use(stand_in, tmp_path):
    def facts(**given):
        return messages("hardware", **given)

    own, rig = tmp_path / "own.yaml", tmp_path / "rig.yaml"
    text = config_path("rig.yaml").read_text(encoding="utf-8")
    assert "{mu: 0.25," in text
    rig.write_text(text.replace("{mu: 0.25,", "{mu: 0.3125,"), encoding="utf-8")
    own.write_text(f"/**: {{ros__parameters: {{rig_file: {rig}}}}}", encoding="utf-8")
    assert any("mu is 0.25" in fact for fact in facts())
    assert not any("mu is" in fact for fact in facts(rig_file=str(rig)))
    assert facts(params_file=str(own)) == facts(rig_file=str(rig))
    own.write_text("/**: {ros__parameters: {seed: 1}}", encoding="utf-8")
    assert facts(params_file=str(own)) == facts()


@pytest.mark.parametrize("by_path", [False, True])
@pytest.mark.parametrize(
    ("file", "name", "words"),
    [
        ("closed_loop", "scenaro", r"is 'scenaro' \(did you mean scenario\?\), allowed: scenario"),
        ("hardware", "image_topc", r"is 'image_topc' \(did you mean image_topic\?\), allowed: "),
        ("closed_loop", "port", r"is 'port' \(an argument of hardware\.launch\.py\), allowed: "),
        ("hardware", "lockstep", r"is 'lockstep' \(an argument of closed_loop\.launch.*, allowed:"),
        ("closed_loop", "zoom", r"is 'zoom', allowed: scenario, .*rig_fi"),
    ],
)
def test_an_unknown_argument_of_the_started_launch_file_is_refused(
    stand_in, monkeypatch, file, name, words, by_path
):
    path = (
        [str(LAUNCH / f"{file}.launch.py")] if by_path else ["plate_bringup", f"{file}.launch.py"]
    )
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", *path, "seed:=3", f"{name}:=x"])
    with pytest.raises(GraphError, match=f"^launch argument {words}"):
        started(file, seed="3", **{name: "x"})


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [("seed", "x", "an integer"), ("seed", "1.5", "an integer"), ("rate", "fast", "a number")],
)
def test_an_invalid_number_is_refused_by_name(stand_in, name, text, kind):
    with pytest.raises(GraphError, match=f"^launch argument {name} is '{text}', allowed: {kind}$"):
        started("closed_loop", **{name: text})


def test_flags_can_have_the_case_of_python(stand_in):
    given = {"lockstep": "True", "view": "True", "autostart": "False", "record": "False"}
    nodes, others = started("closed_loop", **given)
    assert nodes["simulator"].parameters[-2]["lockstep"] is True
    assert "page" in nodes
    assert {"autostart": False} in nodes["solver"].parameters
    assert not others
    nodes, others = started("closed_loop", one_process="True", record="True")
    assert (list(nodes), len(others)) == (["one_process"], 1)
    choices = {a.args[0]: a.choices for a in described("closed_loop")[:-1]}
    assert all(text in choices[name] for name, text in given.items())


def test_names_that_are_similar_to_an_argument_are_reported(stand_in):
    others = {"port": "/dev/robot", "rig": "ur5", "name": "x", "ros_namespace": "/cell"}
    assert messages("closed_loop", **others) == []
    (text,) = messages("closed_loop", scenaro="sort_4")
    hint = "has no argument 'scenaro' and ignores it (did you mean scenario?)"
    assert text == f"warning: closed_loop.launch.py {hint}"


def test_sections_that_are_probably_meant_for_the_nodes_are_reported(stand_in, tmp_path):
    own = tmp_path / "own.yaml"

    def reports(section, **given):
        own.write_text(f"{section}: {{ros__parameters: {{seed: 1}}}}", encoding="utf-8")
        return [text.partition("own.yaml: ")[2] for text in
                messages("closed_loop", params_file=str(own), **given)]  # fmt: skip

    for section in ("solver", "/solver"):
        assert reports(section) == []
        hint = "does not match the node /left/solver, allowed: /**/solver or /left/solver"
        assert reports(section, namespace="left") == [f"the section /solver {hint}"]
    for section in ("/**/solvr", "/left/solvr", "solvr"):
        (text,) = reports(section, namespace="left")
        assert text.startswith("no node has the name 'solvr' of the section ")
        assert text.endswith(" (did you mean solver?)")
    for section in ("/**", "/*", "/**/solver", "/left/solver", "/right/solver", "arm", "/left/arm"):
        assert reports(section, namespace="left") == []


def test_a_recorder_has_a_bag_of_its_own_and_reports_its_end(stand_in):
    bags = []
    for space in ("left", "cell/left", "right"):
        _, (recorder,) = started("closed_loop", record="true", namespace=space)
        assert recorder.cmd[-2] == "--output"
        bags.append(re.fullmatch(r"rosbag2(_\d+){3}-\d\d_\d\d_\d\d_(.*)", recorder.cmd[-1])[2])
    assert bags == ["left", "cell_left", "right"]
    running, over = (types.SimpleNamespace(is_shutdown=flag) for flag in (False, True))
    ended = types.SimpleNamespace(returncode=2)
    (reported,) = recorder.on_exit(ended, running)
    assert "no messages are recorded any more: the recorder ended with exit code 2" in reported.msg
    assert recorder.on_exit(ended, over) is None


OTHERS = {
    "use_rviz": "true", "ros_namespace": "/cell", "port": "/dev/robot", "views": "2",
    "image_topc": "/eye", "param_file": "x", "scenaro": "y",
}  # fmt: skip
"""Arguments of a launch file that includes ours, or of others that it includes."""


@pytest.mark.parametrize("own", ["mine.launch.py", "closed_loop.launch.py"])
def test_an_including_launch_file_may_have_other_arguments(stand_in, monkeypatch, tmp_path, own):
    (tmp_path / own).touch()  # a namesake of ours is another file
    words = [f"{name}:={value}" for name, value in OTHERS.items()]
    for path in ([str(tmp_path / own)], ["my_package", own]):
        monkeypatch.setattr(sys, "argv", ["ros2", "launch", *path, *words])
        nodes, _ = started("closed_loop", scenario="sort_6", **OTHERS)
        assert list(nodes) == NAMES


@pytest.mark.parametrize(
    ("pushed", "own", "space"),
    [
        (None, "/left/", "left"),
        (None, "left", "left"),
        ("/cell", None, "cell"),
        ("/cell", "left", "cell/left"),
        ("/cell/one", "/left", "left"),
    ],
)
def test_frames_and_the_serial_link_follow_a_namespace(stand_in, pushed, own, space):
    given = {"ros_namespace": pushed} if pushed else {}
    given |= {"namespace": own} if own else {}
    nodes, _ = started("closed_loop", transport="serial", **given)
    for file in {node.parameters[1] for node in nodes.values()}:
        read = yaml.safe_load(Path(file).read_text(encoding="utf-8"))
        assert {name.removeprefix("/**/") for name in read} == nodes.keys()
        prefix = {"ros__parameters": {"frame_prefix": f"{space}/"}}
        assert all(own == prefix for own in read.values())
    link = f"{RunOptions().link}_{space.replace('/', '_')}"
    assert nodes["device"].parameters[-1]["link"] == link
    assert nodes["driver"].parameters[-1]["port"] == link
    assert {node.namespace for node in nodes.values()} == {own or ""}  # launch_ros puts it together
    nodes, _ = started("closed_loop", one_process="true", scenario="sort_4", **given)
    sections = [yaml.safe_load(Path(f).read_text()) for f in nodes["one_process"].parameters]
    assert sections[1]["/**/solver"]["ros__parameters"] == {"frame_prefix": f"{space}/"}
    assert sections[-1][f"/{space}/simulator"]["ros__parameters"] == {"scenario": "sort_4"}


def test_all_nodes_in_one_process_have_the_same_parameters(stand_in):
    given = {"scenario": "sort_6", "seed": "3"}
    apart, _ = started("closed_loop", **given)
    together, _ = started("closed_loop", one_process="true", **given)
    (process,) = together.values()
    assert (process.package, process.executable) == ("plate_bringup", "one_process")
    assert process.arguments == NAMES
    read = yaml.safe_load(Path(process.parameters[-1]).read_text(encoding="utf-8"))
    assert {name.removeprefix("/"): v["ros__parameters"] for name, v in read.items()} == {
        name: node.parameters[-1] for name, node in apart.items() if node.parameters[-1]
    }


def test_nodes_that_another_program_starts_wait(stand_in):
    for given, waits in (
        ({}, False),
        ({"autostart": "true"}, False),
        ({"autostart": "false"}, True),
    ):
        nodes, _ = started("closed_loop", **given)
        waiting = {name for name, node in nodes.items() if {"autostart": False} in node.parameters}
        assert waiting == (set(NAMES) if waits else set())


def test_few_values_are_choices(stand_in):
    choices = {a.args[0]: a.choices for a in described("closed_loop")[:-1]}
    assert choices["method"] == ["", "rotations", "sinusoids"]
    assert choices["view"] == ["", "true", "false", "True", "False"]
    assert choices["transport"] == ["", "sim", "serial"]
    assert choices["scenario"] is None
    # On hardware there may be transports of others.
    assert {a.args[0]: a.choices for a in described("hardware")[:-1]}["transport"] is None


def end_of(node, code, context=None):
    """The actions after the end of a node with an exit code."""
    context = context or types.SimpleNamespace(is_shutdown=False)
    return node.on_exit(types.SimpleNamespace(returncode=code), context)


def test_the_end_of_a_node_stops_the_others_and_its_last_output_is_shown(stand_in, tmp_path):
    nodes, _ = started("closed_loop")
    running, over = (types.SimpleNamespace(is_shutdown=flag) for flag in (False, True))
    reported, shutdown = end_of(nodes["solver"], 0)
    assert reported.msg == shutdown.reason == "solver ended with exit code 0: "
    assert shutdown.kind == "Shutdown"
    for code in (0, 2):
        assert end_of(nodes["solver"], code, over) is None
    (timer,) = end_of(nodes["solver"], 2)
    (fail,) = timer.actions
    with pytest.raises(GraphError, match=r"^solver ended with exit code 2: $"):
        fail.function(running)
    assert fail.function(over) is None


def test_the_last_line_is_that_of_either_stream(stand_in):
    *arguments, start = described("closed_loop")
    values = {a.args[0]: a.default_value for a in arguments}
    (group,) = start.function(types.SimpleNamespace(launch_configurations=values))
    listens = [each.args[0] for each in group.args[0] if each.kind == "RegisterEventHandler"]
    node = next(listen.target_action for listen in listens if listen.target_action.name == "solver")
    for listen in (each for each in listens if each.target_action is node):
        for stream, text in (("on_stderr", b"one\n"), ("on_stdout", b"two\nthree\n\n")):
            getattr(listen, stream)(types.SimpleNamespace(text=text))
            reported, _ = end_of(node, 0)
            assert reported.msg.endswith(text.decode().split()[-1])


def test_the_driver_talks_to_the_simulated_device(stand_in):
    nodes, _ = started("closed_loop", transport="serial")
    link = RunOptions().link
    assert list(nodes) == ["simulator", "device", *NAMES[1:]]
    assert nodes["driver"].parameters[-1] == {"transport": "serial", "port": link}
    assert nodes["device"].parameters[-1] == {"link": link}
    assert nodes["simulator"].parameters[-1] == {"driven_by": "device"}


RUN = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

arguments = [word.split(":=") for word in sys.argv[2:]]
service = LaunchService(noninteractive=True)
source = PythonLaunchDescriptionSource(sys.argv[1])
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)])
)
sys.exit(service.run())
"""


def launch(*arguments):
    """Run closed_loop.launch.py until it ends."""
    command = [sys.executable, "-c", RUN, str(LAUNCH / "closed_loop.launch.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.needs("launch_ros")
@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("scenario:=sort_3", "scenario is 'sort_3' (did you mean "),
        ("method:=C", "method"),
        ("params_file:=none.yaml", "params_file none.yaml: no such file"),
        ("scenaro:=sort_4", "launch argument is 'scenaro' (did you mean scenario?)"),
    ],
)
def test_launch_itself_ends_with_the_reason(argument, message):
    done = launch(argument)
    assert done.returncode == 1
    assert message in done.stdout + done.stderr


@pytest.mark.needs("launch_ros")
def test_launch_fails_if_a_node_fails():
    done = launch("one_process:=true", "rig_file:=none")
    assert done.returncode == 1
    message = "one_process ended with exit code 2: error: simulator: rig is 'none', allowed:"
    assert message in done.stdout + done.stderr
