"""The list of nodes, and the parameters that a run gives them."""

import pytest

from plate_bringup import GraphError, RunOptions, load_graph
from plate_bringup.graph import SERIAL_ANSWER_S, SERIAL_HANDOVER_S
from plate_core import PlateError

NAMES = ["simulator", "detector", "planner", "solver", "driver"]
GRAPH = {node.name: node for node in RunOptions().nodes(load_graph())}


def test_the_list_of_nodes_is_checked(tmp_path):
    path = tmp_path / "graph.yaml"
    node = "{name: a, package: p, executable: e, component: m.C, on_hardware: true}"
    path.write_text(f"nodes: [{node}]")
    assert load_graph(path)[0].package == "p"
    path.write_text(f"nodes: [{node}, {node}]")
    with pytest.raises(GraphError, match="each name once"):
        load_graph(path)
    path.write_text("nodes: [{name: a, package: p, executable: e, component: m.C}]")
    with pytest.raises(PlateError, match="on_hardware is missing"):
        load_graph(path)


def test_with_simulated_time_all_other_nodes_use_it():
    kinds = ({"lockstep": True}, {"rate": 2.0}, {"simulated_time": True})
    for options in (RunOptions(**kind) for kind in kinds):
        follows = [n for n in NAMES if options.parameters(GRAPH[n]).get("use_sim_time")]
        assert follows == NAMES[1:]
    assert all("use_sim_time" not in RunOptions().parameters(node) for node in GRAPH.values())


def test_each_transport_has_its_nodes():
    listed = load_graph()
    names = {
        words: [node.name for node in RunOptions(**dict(words)).nodes(listed)]
        for words in (
            (("transport", "sim"),),
            (("transport", "serial"),),
            (("transport", "serial"), ("port", "/dev/ttyUSB0")),
        )
    }
    sim, serial, hardware = names.values()
    assert sim == NAMES
    assert serial == [NAMES[0], "device", *NAMES[1:]]
    assert hardware == NAMES[1:]
    options = RunOptions(transport="serial", link="/tmp/x")
    given = {node.name: options.parameters(node) for node in listed}
    assert given["driver"]["port"] == given["device"]["link"] == "/tmp/x"
    assert given["simulator"]["driven_by"] == "device"


def test_a_camera_may_run_free_and_over_a_serial_line_starts_are_reported():
    def planner(**options):
        return RunOptions(**options).parameters(GRAPH["planner"])

    assert "camera_triggered" not in planner()
    assert planner(image_rate=30.0)["camera_triggered"] is False
    assert "answer_s" not in planner(image_rate=30.0)
    assert planner(transport="serial") == {
        "camera_triggered": False, "answer_s": SERIAL_ANSWER_S, "lockstep": False,
    }  # fmt: skip
    solver = RunOptions(transport="serial").parameters(GRAPH["solver"])
    assert solver["handover_s"] == SERIAL_HANDOVER_S
    assert RunOptions(image_rate=30.0).parameters(GRAPH["simulator"])["image_rate"] == 30


def test_hardware_is_not_replaced_by_simulated_nodes():
    options = RunOptions(transport="serial", hardware=True)
    assert [node.name for node in options.nodes(load_graph())] == NAMES[1:]
    assert "port" not in options.parameters(GRAPH["driver"])


def test_a_real_camera_replaces_the_simulator_but_not_the_board():
    listed = load_graph()
    camera = {"camera": "/dev/video0", "transport": "serial"}
    names = [node.name for node in RunOptions(**camera).nodes(listed)]
    assert names == ["device", "camera", *NAMES[1:]]
    names = [node.name for node in RunOptions(**camera, port="/dev/ttyACM0").nodes(listed)]
    assert names == ["camera", *NAMES[1:]]
    (node,) = (node for node in listed if node.name == "camera")
    given = RunOptions(**camera, rig_file="desk").parameters(node)
    assert given == {"device": "/dev/video0", "rig_file": "desk"}


def test_options_that_were_not_chosen_are_left_as_the_file_has_them():
    options = RunOptions(scenario="sort_6")
    given = {name: options.parameters(node, {"scenario"}) for name, node in GRAPH.items()}
    assert given["simulator"] == {"scenario": "sort_6"}
    assert given["planner"] == given["solver"] == given["driver"] == given["detector"] == {}
