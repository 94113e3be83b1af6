"""Parameters as data: defaults, values of the command line, changes while the node runs."""

from dataclasses import dataclass

import pytest

from plate_core import PlateError

rclpy = pytest.importorskip("rclpy")
from rclpy.parameter import Parameter  # noqa: E402

from plate_core.ros import declare, follow, parameter  # noqa: E402
from plate_core.ros.params import wildcard_parameters  # noqa: E402


@dataclass(frozen=True)
class Options:
    """Parameters of a node for this test."""

    gain: float = parameter(1.0, "Gain [1/s].", 0.0, 10.0, live=True)
    count: int = parameter(3, "Number of parts.", 1, 9, live=True)
    method: str = parameter("fast", "Way to do it.", choices=("fast", "exact"))
    name: str = parameter("", "Any text.")
    on: bool = parameter(True, "Whether it is on.", live=True)


@pytest.fixture(name="make_node")
def _make_node(monkeypatch):
    nodes = []
    monkeypatch.setattr("sys.argv", ["node"])

    def make_node(*assignments: str):
        args = [word for a in assignments for word in ("-p", a)]
        rclpy.init(args=["--ros-args", *args] if args else None)
        nodes.append(rclpy.create_node("parametric"))
        return nodes[-1]

    yield make_node
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


def test_defaults(make_node):
    assert declare(make_node(), Options) == Options()


def test_values_of_the_command_line(make_node):
    node = make_node("gain:=2", "count:=9", "method:=exact", "name:=some", "on:=false")
    assert declare(node, Options) == Options(2.0, 9, "exact", "some", False)


def test_descriptions_are_declared(make_node):
    node = make_node()
    declare(node, Options)
    assert node.describe_parameter("gain").description == "Gain [1/s]."
    assert node.describe_parameter("gain").additional_constraints == "0.0 to 10.0"
    assert node.describe_parameter("method").additional_constraints == "one of fast, exact"
    (limits,) = node.describe_parameter("gain").floating_point_range
    assert (limits.from_value, limits.to_value, limits.step) == (0.0, 10.0, 0.0)
    (limits,) = node.describe_parameter("count").integer_range
    assert (limits.from_value, limits.to_value, limits.step) == (1, 9, 1)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("gain:=10.5", "parameter gain is 10.5, allowed: 0.0 to 10.0"),
        ("gain:=.nan", "parameter gain is nan, allowed: 0.0 to 10.0"),
        ("gain:=fast", "parameter gain is 'fast', allowed: a value of type float"),
        ("count:=0", "parameter count is 0, allowed: 1 to 9"),
        ("count:=2.0", "parameter count is 2.0, allowed: a value of type int"),
        ("count:=true", "parameter count is True, allowed: a value of type int"),
        ("method:=slow", "parameter method is 'slow', allowed: one of fast, exact"),
        ("name:=3", "parameter name is 3, allowed: a value of type str"),
        (
            "cuont:=4",
            "parameter cuont is unknown to parametric (did you mean count?), allowed: gain, count, "
            "method, name, on",
        ),
        ("on:=1", "parameter on is 1, allowed: a value of type bool"),
    ],
)
def test_wrong_values_are_refused(make_node, assignment, message):
    node = make_node(assignment)
    with pytest.raises(PlateError) as caught:
        declare(node, Options)
    assert str(caught.value) == message


FILES = {
    "everyone": "/**: {ros__parameters: {robot_name: ur5, gain: 2.0, nested: {deep: 1}}}",
    "anyone": "/*: {ros__parameters: {robot_name: ur5}}",
    "below": "cell: {'**': {ros__parameters: {robot_name: ur5}}}",
    "here": "/**/parametric: {ros__parameters: {robot_name: ur5}}",
    "there": "/cell/parametric: {ros__parameters: {robot_name: ur5}}",
    "nested": "cell: {parametric: {ros__parameters: {robot_name: ur5}}}",
    "dated": "/**: {ros__parameters: {robot_name: 2026-13-45}}",
    "nothing": "",
}


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["everyone"], {"robot_name", "gain", "nested.deep"}),
        (["anyone", "nothing"], {"robot_name"}),
        (["below"], {"robot_name"}),
        (["dated"], {"robot_name"}),
        (["here"], set()),
        (["anyone", "there"], set()),
        (["nested", "anyone"], set()),
        (["anyone", "robot_name:=ur3"], set()),
        (["anyone", "parametric:robot_name:=ur3"], set()),
    ],
)
def test_names_by_wildcard_alone_may_be_those_of_others(tmp_path, words, names):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    given = [["-p", w] if ":=" in w else ["--params-file", str(tmp_path / w)] for w in words]
    line = [word for pair in given for word in pair]
    assert wildcard_parameters(["node", "--ros-args", *line], "parametric") == names


@pytest.mark.parametrize("section", ["/**", "/**/parametric"])
def test_only_what_names_the_node_is_strict(make_node, capfd, tmp_path, monkeypatch, section):
    file = tmp_path / "robot.yaml"
    file.write_text(f"{section}: {{ros__parameters: {{robot_name: ur5, tool: 3, gain: 2.0}}}}")
    monkeypatch.setattr("sys.argv", ["node", "--ros-args", "--params-file", str(file)])
    node = make_node()
    if section == "/**":
        assert declare(node, Options).gain == 2.0
        (line,) = [line for line in capfd.readouterr().err.splitlines() if "WARN" in line]
        assert line.endswith(
            "parametric ignores parameters that are set for all nodes but unknown to it: "
            "robot_name, tool"
        )
    else:
        with pytest.raises(PlateError, match=r"^parameter robot_name is unknown to parametric,"):
            declare(node, Options)


def test_a_parameter_that_is_not_live_cannot_change(make_node):
    node = make_node("method:=exact")
    declare(node, Options)
    result = node.set_parameters([Parameter("method", value="fast")])[0]
    assert (result.successful, result.reason) == (
        False, "Trying to set a read-only parameter: method.",
    )  # fmt: skip
    assert node.describe_parameter("method").read_only
    assert not node.describe_parameter("gain").read_only
    assert node.get_parameter("method").value == "exact"


def test_changes_while_running(make_node):
    node = make_node()
    changes: list[Options] = []
    keep = follow(node, declare(node, Options), changes.append)
    assert callable(keep)

    def change(name, value):
        return node.set_parameters([Parameter(name, value=value)])[0]

    assert change("gain", 4.0).successful
    assert change("count", 5).successful
    assert changes[-1] == Options(gain=4.0, count=5)
    assert change("gain", 3).successful  # as on the command line
    assert changes[-1].gain == node.get_parameter("gain").value == 3.0
    for name, value, reason in (
        ("gain", 11.0, "Parameter gain out of range Min: 0.0, Max: 10.0, value: 11.0"),
        ("on", "yes", "Wrong parameter type, expected 'Type.BOOL' got 'Type.STRING'"),
        ("method", "exact", "Trying to set a read-only parameter: method."),
    ):
        result = change(name, value)
        assert not result.successful
        assert result.reason == reason
    assert changes[-1] == Options(gain=3.0, count=5)
    assert change("use_sim_time", True).successful  # not ours
