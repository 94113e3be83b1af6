"""A process ends with its own exit code, even if the middleware does not release it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from plate_core import ends, piped

NODE = """
import ctypes
from rclpy.node import Node
from plate_core import PlateError
from plate_core.ros import NodeOptions, SafeLifecycleNode, run_node

class Stuck(SafeLifecycleNode[NodeOptions]):
    def __init__(self):
        super().__init__("stuck", NodeOptions)

    def configure(self):
        raise PlateError("refused")

    def rest(self):
        print("rested", flush=True)

    def release(self):
        print("released", flush=True)

    def destroy_node(self):
        self.close()
        ctypes.PyDLL(None).sleep(1000)  # with Python's lock held

run_node(Stuck)
"""


def test_a_node_that_cannot_be_destroyed_keeps_its_exit_code():
    pytest.importorskip("rclpy")
    done = subprocess.run([sys.executable, "-c", NODE], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout.split()[-1]) == (2, "released")
    assert done.stderr.splitlines() == ["error: refused"]


@pytest.mark.parametrize("code", [0, 1, 130])
def test_a_context_that_lasts_ends_the_process(code):
    program = f"""
import ctypes
from plate_core import ends
with ends({code}, within_s=0.05):
    ctypes.PyDLL(None).sleep(1000)
"""
    assert subprocess.run([sys.executable, "-c", program], timeout=60).returncode == code


def test_a_short_block_leaves_no_timer_that_ends_the_process():
    def timers():
        return Path("/proc/self/timers").read_text(encoding="ascii").count("\nClockID: ")

    before = timers()
    with ends(3, within_s=1000.0):
        assert timers() == before + 1
    assert timers() == before


def test_an_exception_inside_the_block_is_raised():
    with pytest.raises(ValueError, match="wrong"), ends(3):
        raise ValueError("wrong")


PRINTS = """
import sys, time
from plate_core import piped

@piped()
def main():
    try:
        print("first", flush=True)
        sys.stdin.readline()  # until nobody reads any more
        {rest}
    finally:
        print("tidied up", file=sys.stderr)

main()
"""


@pytest.mark.parametrize(
    ("rest", "code"),
    [
        ("print('second', flush=True)", 141),
        ("print('second')", 141),
        ("print('second'); sys.exit(3)", 141),
        ("pass", 0),
        ("sys.exit(3)", 3),
    ],
)
def test_a_program_with_unread_output_ends_without_an_error(rest, code):
    read, write = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", PRINTS.format(rest=rest)],
        stdin=subprocess.PIPE, stdout=write, stderr=subprocess.PIPE, text=True,
    ) as program:  # fmt: skip
        os.close(write)
        with os.fdopen(read) as output:
            assert output.readline() == "first\n"
        _, errors = program.communicate("go on\n", timeout=60)
    assert program.returncode == code
    assert errors == "tidied up\n"


def test_another_broken_pipe_is_a_defect():
    with pytest.raises(BrokenPipeError), piped():
        raise BrokenPipeError
