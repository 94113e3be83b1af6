"""`make demo` as a stranger would use it."""

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from importlib.util import find_spec
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from demo import arguments
from graph.demo import demo as run
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
MARK = "PLATE_TEST_RUN"


def demo(*words, mark="", **options):
    return subprocess.Popen(
        [sys.executable, str(ROOT / "tools" / "demo.py"), *words],
        env=os.environ | {MARK: mark},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def marked(mark):
    """Processes that were started by a run, by what is in their environment."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"{MARK}={mark}".encode() in path.read_bytes():
                found.append(int(path.parent.name))
        except OSError:
            continue  # it has ended, or is not ours
    return found


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scenario", "sort_3"], "scenario is 'sort_3', allowed: assemble_8, coin_circle"),
        (["--method", "C"], "method is 'C', allowed: A, B, rotations, sinusoids"),
        (["--transport", "usb"], "transport is 'usb', allowed: serial, sim"),
        (["--transport", "serial", "--lockstep"], "lockstep with transport serial, allowed: sim"),
        (["--domain", "500"], "domain is 500, allowed: 0 to 101"),
    ],
)
def test_wrong_arguments_are_one_line_and_start_nothing(
    tmp_path, monkeypatch, capsys, words, message
):
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["demo.py", *words, "--out", str(out)])
    assert run(arguments()) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith(f"demo: {message}")
    assert errors.count("\n") == 1
    assert not out.exists()


def test_the_program_ends_with_the_code_of_the_run(tmp_path):
    with demo("--seed", "-1", "--out", str(tmp_path / "out")) as process:
        output, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert output == ""
    assert errors == "demo: seed is -1, allowed: 0 to 2147483647\n"


def test_a_run_leaves_results_and_pictures(tmp_path):
    mark = uuid.uuid4().hex
    (tmp_path / "demo.gif").write_text("of an earlier run")
    words = ["--scenario", "follow_2", "--method", "B", "--lockstep", "--out", str(tmp_path)]
    records = find_spec("rosbags") is not None  # where ROS is installed, ros2 bag records
    with demo(*words, *(["--record"] if records else []), mark=mark) as process:
        output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, output + errors
    assert errors == ""
    assert marked(mark) == []
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["scenario"], result["method"], result["transport"]) == (
        "follow_2",
        "sinusoids",
        "sim",
    )
    assert result["success"] is True
    assert result["dropped"] == 0
    assert result["nodes"] == ["simulator", "detector", "planner", "solver", "driver"]
    assert set(result["exit_codes"].values()) == {0}
    assert result["setpoints_within_limits"] is True
    assert result["motor_setpoints"] >= result["cycles"] > 100
    assert result["rms_error_m"] < 0.002
    assert result["time_s"] == pytest.approx(14.1, abs=1)
    with Image.open(tmp_path / "strip.png") as strip:
        assert min(strip.size) > 600
    with Image.open(tmp_path / "demo.gif") as animation:
        assert 50 < animation.n_frames <= 100
    assert (tmp_path / "demo.gif").stat().st_size < 6e6
    if records:
        check_bag(tmp_path / "bag", result)


def check_bag(folder, result):
    from rosbags.rosbag2 import Reader

    with Reader(folder) as bag:
        said = {c.topic: (c.msgtype, c.msgcount) for c in bag.connections}
    assert said["/motor_setpoints"] == (
        "trajectory_msgs/msg/JointTrajectory",
        pytest.approx(result["motor_setpoints"], abs=3),
    )
    assert said["/image_raw"][1] > 100
    assert said["/task_state"][1] >= 2  # latched: what was said before we listened, too


def test_an_interrupt_leaves_nothing_running(tmp_path):
    mark = uuid.uuid4().hex
    words = ["--scenario", "sort_4", "--out", str(tmp_path), "--no-pictures"]
    with demo(*words, mark=mark, start_new_session=True) as process:
        for line in process.stdout:
            if "parts sorted" in line:
                break
        assert len(marked(mark)) == 6
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)  # impatience
        output, _ = process.communicate(timeout=30)
        assert time.monotonic() - began < 10
    assert process.returncode == 130
    assert output.endswith("demo: SIGINT, all nodes are stopped\n")
    assert marked(mark) == []
    assert not (tmp_path / "result.json").exists()


def test_a_kill_leaves_nothing_running(tmp_path):
    mark = uuid.uuid4().hex
    words = ["--scenario", "sort_4", "--out", str(tmp_path), "--no-pictures"]
    with demo(*words, mark=mark, start_new_session=True) as process:
        for line in process.stdout:
            if "nodes seen" in line:
                break
        process.kill()
        process.communicate(timeout=30)
    until = time.monotonic() + 10
    while marked(mark) and time.monotonic() < until:
        time.sleep(0.1)
    assert marked(mark) == []


def test_a_node_that_dies_is_named_and_its_log_is_shown(tmp_path):
    mark = uuid.uuid4().hex
    words = ["--scenario", "sort_4", "--out", str(tmp_path), "--no-pictures"]
    with demo(*words, mark=mark) as process:
        for line in process.stdout:
            if "parts sorted" in line:
                break
        for pid in marked(mark):
            if "plate_planner" in Path(f"/proc/{pid}/cmdline").read_text():
                os.kill(pid, signal.SIGKILL)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "demo: planner was ended by SIGKILL" in errors
    assert "task sort_4: running" in errors
    assert "log: " in errors
    assert marked(mark) == []
