"""A process ends with its own exit code also where the middleware does not let go of it."""

import subprocess
import sys

import pytest

from plate_core import ends

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


def test_a_node_that_cannot_be_destroyed_ends_as_it_would_have():
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


def test_one_that_does_not_last_ends_nothing():
    program = """
import time
from plate_core import ends
for _ in range(100):
    with ends(3, within_s=0.05):
        pass
time.sleep(0.2)
"""
    assert subprocess.run([sys.executable, "-c", program], timeout=60).returncode == 0


def test_what_goes_wrong_inside_comes_out():
    with pytest.raises(ValueError, match="wrong"), ends(3):
        raise ValueError("wrong")
