"""A node continues if nobody reads its console, and its log arrives if somebody does."""

import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

PIPE_BYTES = 4096
"""Capacity of the console's pipe: the minimum of Linux."""

LINES = 100
"""More than it holds."""

PROGRAM = """
import sys
from pathlib import Path
from plate_core.ros import NodeOptions, SafeLifecycleNode, run_node

class Talker(SafeLifecycleNode[NodeOptions]):
    def __init__(self):
        super().__init__("talker", NodeOptions)

    def begin(self):
        for number in range(int(sys.argv[1])):
            self.get_logger().warning(f"line {number} " + 80 * "x")
        Path(sys.argv[2]).touch()

run_node(Talker)
"""


@contextmanager
def talker(lines, file):
    command = [sys.executable, "-X", "faulthandler", "-c", PROGRAM, str(lines), str(file)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, pipesize=PIPE_BYTES) as node:
        try:
            yield node
        finally:
            node.kill()


def appears(file, seconds=60.0):
    end = time.monotonic() + seconds
    while not file.exists() and time.monotonic() < end:
        time.sleep(0.05)
    return file.exists()


def test_an_unread_console_does_not_block_a_node(tmp_path):
    with talker(LINES, tmp_path / "said") as node:
        assert appears(tmp_path / "said")
        node.send_signal(signal.SIGINT)
        assert node.wait(60) == 0  # its last words are not waited for either


def test_all_log_lines_arrive_in_order_even_the_last(tmp_path):
    with talker(20, tmp_path / "said") as node:
        assert appears(tmp_path / "said")
        node.send_signal(signal.SIGINT)
        _, output = node.communicate(timeout=60)
    assert [word for word in output.split() if word.isdigit()] == [str(n) for n in range(20)]


def test_a_crash_reports_its_location(tmp_path):
    with talker(1, tmp_path / "said") as node:
        assert appears(tmp_path / "said")
        node.send_signal(signal.SIGABRT)
        _, output = node.communicate(timeout=60)
    assert node.returncode == -signal.SIGABRT
    assert "Fatal Python error: Aborted" in output
    assert "in run_node" in output


def test_a_node_without_a_console_works(tmp_path):
    """A file that it opens must not get the number of stderr either."""
    words = [sys.executable, "-c", PROGRAM, "20", str(tmp_path / "said")]
    with subprocess.Popen(["bash", "-c", 'exec "$@" <&- >&- 2>&-', "bash", *words]) as node:
        try:
            assert appears(tmp_path / "said")
            opened = [Path(f"/proc/{node.pid}/fd/{number}").readlink() for number in (0, 1)]
            assert opened == [Path("/dev/null")] * 2
            node.send_signal(signal.SIGINT)
            assert node.wait(60) == 0
        finally:
            node.kill()
