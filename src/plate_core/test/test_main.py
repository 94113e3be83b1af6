"""run_node: a clean start and a clean stop."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("rclpy")

PATIENCE_S = 60
"""A bound on what takes a few seconds, more when the machine is busy [s]."""

NODE = """
import sys, time
from rclpy.node import Node
from plate_core import PlateError
from plate_core.ros import run_node

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        if "refuse" in sys.argv:
            raise PlateError("size is 3, allowed: 1 to 2")
        self.create_timer(0.01, self.tick)

    def tick(self):
        if "break" in sys.argv:
            raise RuntimeError("a defect")
        print("ready", flush=True)

    def destroy_node(self):
        time.sleep(0.2)
        print("last words, ROS works:", self.context.ok(), flush=True)
        super().destroy_node()

run_node(Talker)
"""


def start(*words: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", NODE, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_signals_end_it_in_peace(hears):
    with start() as process:
        assert hears(process, "ready")
        process.send_signal(signal.SIGINT)
        time.sleep(0.25)  # the teardown is under way
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    assert output.endswith("last words, ROS works: True\n")
    assert errors == ""


def test_wrong_input_is_one_line_and_code_2():
    with start("refuse") as process:
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert errors == "error: size is 3, allowed: 1 to 2\n"


def test_a_broken_parameter_file_is_no_defect(tmp_path):
    file = tmp_path / "wrong.yaml"
    file.write_text("nodes:\n  - {name: talker}\n")
    with start("--ros-args", "--params-file", str(file)) as process:
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert errors.splitlines()[-1].startswith("error: ")
    assert str(file) in errors.splitlines()[-1]
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--params-file", "{fifo}"), "{fifo}: is a FIFO, allowed: a regular file up to 0.25 MB"),
        (("-p", "use_sim_time:=maybe"), "expecting type 'BOOL': use_sim_time"),
    ],
)
def test_what_ros_reads_by_itself_is_checked_too(tmp_path, words, message):
    fifo = tmp_path / "wrong.yaml"
    os.mkfifo(fifo)
    with start("--ros-args", *(word.format(fifo=fifo) for word in words)) as process:
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert errors.startswith("error: ")
    assert errors.endswith(f"{message.format(fifo=fifo)}\n")


def test_a_defect_is_a_traceback_and_code_1():
    with start("break") as process:
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "RuntimeError: a defect" in errors
    assert output.endswith("last words, ROS works: True\n")  # Fast DDS may say something before
