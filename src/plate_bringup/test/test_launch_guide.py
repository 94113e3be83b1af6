"""The launch file of docs/guide/launch.md: the actions that it starts, with stand-ins of `launch`,
and with `launch` itself if it is installed; and its file of parameters."""

import json
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest
import yaml

from plate_bringup import RunOptions, load_graph

ROOT = Path(__file__).resolve().parents[3]
GUIDE = (ROOT / "docs/guide/launch.md").read_text(encoding="utf-8")
FILE, PARAMETERS = (
    re.search(rf"```{kind}\n(.*?)```", GUIDE, re.DOTALL)[1] for kind in ("python", "yaml")
)
NAMES = {node.name for node in RunOptions().nodes(load_graph())}


class StandIn(types.ModuleType):
    """A module that has every name: a callable that keeps its arguments."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *args, **values: types.SimpleNamespace(kind=name, args=args, **values)


def test_the_guide_includes_existing_files_with_valid_arguments(monkeypatch):
    for name in ("launch", "launch.actions", "launch.event_handlers", "launch.substitutions",
                 "launch_ros", "launch_ros.actions", "launch_ros.substitutions"):  # fmt: skip
        monkeypatch.setitem(sys.modules, name, StandIn(name))
    monkeypatch.delitem(sys.modules, "plate_bringup.actions", raising=False)
    from plate_bringup.actions import CHOICES, argument_descriptions

    scope = {}
    exec(compile(FILE, "cell.launch.py", "exec"), scope)
    description = scope["generate_launch_description"]()
    del sys.modules["plate_bringup.actions"]
    groups = [each for each in description.args[0] if each.kind == "GroupAction"]
    assert len(groups) == 2
    for group in groups:
        push, _, include = group.args[0]
        assert push.args[0] in ("cell/left", "cell/right")
        ((_, folder, file),) = include.args[0].args
        assert (ROOT / "src/plate_bringup" / folder / file).exists()
        arguments = dict(include.launch_arguments)
        assert arguments.keys() <= argument_descriptions(hardware=False).keys()
        assert all(value in CHOICES.get(name, [value]) for name, value in arguments.items())


RUN = """
import json, sys, rclpy
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch import LaunchDescription
from launch_ros.actions import Node

def execute(self, context):
    self._perform_substitutions(context)
    words = ["--ros-args"]
    for value, is_file in self._Node__expanded_parameter_arguments or ():
        words += ["--params-file", value] if is_file else []
    space, _, name = self.node_name.rpartition("/")
    ros = rclpy.Context()
    rclpy.init(args=[], context=ros)
    node = rclpy.create_node(
        name, namespace=space, context=ros, cli_args=words, use_global_arguments=False,
        automatically_declare_parameters_from_overrides=True, start_parameter_services=False,
    )
    given = {key: one.value for key, one in node.get_parameters_by_prefix("").items()}
    node.destroy_node()
    ros.try_shutdown()
    remaps = [":=".join(pair) for pair in self.expanded_remapping_rules or ()]
    remaps += [":=".join(pair) for pair in context.launch_configurations.get("ros_remaps", ())]
    print(json.dumps([self.node_name, given, remaps]), flush=True)

Node.execute = execute
service = LaunchService(noninteractive=True)
include = IncludeLaunchDescription(
    PythonLaunchDescriptionSource(sys.argv[1]),
    launch_arguments=[word.split(":=") for word in sys.argv[2:]],
)
service.include_launch_description(LaunchDescription([include]))
sys.exit(service.run())
"""


def read_launch(file, *arguments):
    """Read a launch file by RUN. Return the parameters and remappings of each node."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(file), *arguments],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('["')]
    return {name: (given, remaps) for name, given, remaps in lines}


@pytest.mark.needs("launch_ros")
def test_launch_starts_both_plates_and_the_robot(tmp_path):
    file = tmp_path / "cell.launch.py"
    file.write_text(FILE)
    nodes = read_launch(file, "port:=/dev/robot", "views:=2", "scenaro:=x")
    assert nodes.keys() == {
        "/cell/arm",
        *(f"/cell/left/{name}" for name in NAMES | {"page"}),
        *(f"/cell/right/{name}" for name in NAMES | {"device"}),
    }
    assert nodes["/cell/arm"][0]["port"] == "/dev/robot"
    assert "seed" not in nodes["/cell/arm"][0]
    for name, (given, remaps) in nodes.items():
        side = name.split("/")[2]
        if side != "arm":
            assert given["frame_prefix"] == f"cell/{side}/"
            assert "ground_truth:=truth" in remaps
    assert nodes["/cell/left/simulator"][0]["scenario"] == "sort_4"
    assert nodes["/cell/right/driver"][0]["port"] == "/tmp/plate_device_cell_right"
    assert "port" not in nodes["/cell/left/driver"][0]


@pytest.mark.needs("launch_ros")
def test_an_including_launch_file_passes_the_parameters_to_the_nodes(tmp_path):
    """Arguments win over it, and it wins over the defaults."""
    (tmp_path / "own.yaml").write_text(PARAMETERS)
    outer = f"            SetParametersFromFile({str(tmp_path / 'own.yaml')!r}),\n"
    file = tmp_path / "cell.launch.py"
    include = "            IncludeLaunchDescription("
    text = FILE.replace(include, outer + include)
    text = text.replace("import Node, ", "import Node, SetParametersFromFile, ")
    file.write_text(text.replace('view="true"', 'seed="7"'))
    nodes = {name: given for name, (given, _) in read_launch(file).items()}
    for side in ("left", "right"):
        assert nodes[f"/cell/{side}/solver"]["method"] == "rotations"
        assert nodes[f"/cell/{side}/planner"]["robot_name"] == "ur5"
    assert nodes["/cell/left/detector"]["gate_m"] == 0.02
    assert nodes["/cell/right/detector"].get("gate_m") != 0.02
    assert (nodes["/cell/left/solver"]["seed"], nodes["/cell/left/simulator"]["seed"]) == (7, 7)
    assert nodes["/cell/right/simulator"]["scenario"] == "assemble_8"


def test_the_parameters_of_the_guide_exist_in_the_nodes():
    from plate_solver.node import Options as SolverOptions
    from plate_vision.node import DetectorParameters

    read = yaml.safe_load(PARAMETERS)
    names = {key.rpartition("/")[2]: [*value["ros__parameters"]] for key, value in read.items()}
    assert set(names["solver"]) <= SolverOptions.__dataclass_fields__.keys()
    assert set(names["detector"]) <= DetectorParameters.__dataclass_fields__.keys()
    assert names["**"] == ["robot_name"]


@pytest.mark.needs("launch_ros")
def test_parameters_of_outer_actions_are_no_options_of_the_command_lines(tmp_path):
    """A node would refuse an option that is for another node."""
    outer = "            SetParameter('method', 'rotations'), SetParameter('robot_name', 'ur5'),\n"
    file = tmp_path / "cell.launch.py"
    include = "            IncludeLaunchDescription("
    text = FILE.replace(include, outer + include)
    file.write_text(text.replace("import Node, ", "import Node, SetParameter, "))
    nodes = {
        name: given for name, (given, _) in read_launch(file).items()
    }  # RUN reads the files only
    assert "method" not in nodes.pop("/cell/arm")
    for given in nodes.values():
        assert (given["method"], given["robot_name"]) == ("rotations", "ur5")
