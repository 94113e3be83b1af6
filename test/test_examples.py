"""The examples do what their docstrings state."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from plate_bringup.loop import Setup, load_planner, run
from plate_core import PlateError, load_rig

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.parametrize("name", ["force_field", "simulate"])
def test_a_script_runs_and_draws(tmp_path, name):
    picture = tmp_path / "picture.png"
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", picture],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    image = cv2.imread(str(picture))
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20  # more than an empty frame
    if name == "force_field":
        assert "success True" in done.stdout


@pytest.mark.parametrize("image_rate", [0.0, 30.0])
def test_a_user_planner_moves_the_parts(tmp_path, domain, image_rate):
    pytest.importorskip("rclpy")
    from graph.observer import Observer
    from graph.processes import Processes, ros_environment
    from graph.session import ANSWER_S, START_S
    from light_graph import LightOptions
    from rclpy.serialization import deserialize_message

    from plate_bringup import load_graph
    from plate_core import part_class
    from plate_core.ros import msg_to_parts
    from plate_interfaces.msg import Parts

    options = LightOptions(
        scenario="sort_4", lockstep=not image_rate, image_rate=image_rate, autostart=False
    )
    nodes = options.nodes(node for node in load_graph() if node.name != "planner")
    own = subprocess.Popen(
        [sys.executable, EXAMPLES / "own_planner.py"], env=os.environ | ros_environment(domain)
    )
    try:
        with (
            Processes(nodes, options, tmp_path, domain) as processes,
            Observer(domain, processes.check) as observer,
        ):
            observer.await_nodes(["planner", *(node.name for node in nodes)], START_S)
            observer.await_answers(ANSWER_S)
            observer.activate_driver()

            def short_of_sides():
                parts = msg_to_parts(deserialize_message(observer.record.truth[-1], Parts))
                assert len(parts) == 4
                side = [-1 if part_class(name) == "black" else 1 for name in parts.ids]
                return np.max(0.6 * load_rig().plate.half[0] - side * parts.position[:, 0])

            assert observer.until(lambda: bool(observer.record.truth), 60)
            begin = short_of_sides()
            assert begin > 0.1
            assert observer.until(lambda: short_of_sides() < begin - 0.01, 120)
    finally:
        own.terminate()
        assert own.wait(20) == 0


def test_a_user_control_law_needs_no_ros(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert load_planner(str(EXAMPLES / "own_planner.py"), load_rig())
    broken = tmp_path / "broken.py"
    broken.write_text("class OwnPlanner\n")
    with pytest.raises(PlateError, match=r"planner .*broken.py cannot be loaded: .*line 1"):
        load_planner(str(broken), load_rig())
    broken.write_text("OwnPlanner = 5\n")
    with pytest.raises(
        PlateError, match=r"planner .*broken.py has no class OwnPlanner with a method"
    ):
        load_planner(str(broken), load_rig())


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("None", "returned a NoneType, allowed: a plate_core.CycleRequest"),
        (
            "CycleRequest.make(parts, np.full((n, 2), np.nan))",
            "force of black_1 is nan, allowed",
        ),
        (
            "CycleRequest.make(parts, torque=np.full(n, np.inf))",
            "torque of black_1 is inf",
        ),
        (
            "CycleRequest.make(parts, tolerance=-np.ones((n, 2)))",
            "black_1 is -1, allowed: 0",
        ),
        (
            "CycleRequest.make(parts, np.zeros((2, n)))",
            r"force has shape \(2, 4\), allowed:",
        ),
    ],
)
def test_invalid_requests_of_a_custom_planner_are_refused(tmp_path, answer, message):
    own = tmp_path / "own.py"
    own.write_text(
        "import numpy as np\nfrom plate_core import CycleRequest\n\n\nclass OwnPlanner:\n"
        "    def __init__(self, rig):\n        pass\n\n"
        f"    def plan(self, parts, t):\n        n = len(parts)\n        return {answer}\n"
    )
    with pytest.raises(PlateError, match=message):
        for _ in run(Setup("sort_4", own_planner=str(own))):
            pass
