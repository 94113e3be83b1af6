"""Shared memory that killed processes leave is removed, and none that is in use."""

import os
import subprocess
import sys
import time

import pytest

rclpy = pytest.importorskip("rclpy")

from shared_memory import FOLDER, remove_leftovers  # noqa: E402

NODE = [
    sys.executable, "-c",
    "import rclpy; rclpy.init(); node = rclpy.create_node('short'); print(flush=True); input()",
]  # fmt: skip


def segments(pid):
    """Names of the segments that a process holds the locks of."""
    held = (os.readlink(fd.path) for fd in os.scandir(f"/proc/{pid}/fd") if fd.is_symlink())
    locks = [path for path in held if path.startswith(f"{FOLDER}/fastrtps_")]
    return {os.path.basename(path).removesuffix("_el") for path in locks if "_port" not in path}


def age(names):
    """Have the locks of segments seem to be of two minutes ago."""
    then = time.time() - 120
    for name in names:
        os.utime(FOLDER / f"{name}_el", (then, then))


def test_only_what_a_killed_process_left_is_removed():
    nodes = [
        subprocess.Popen(NODE, stdin=subprocess.PIPE, stdout=subprocess.PIPE) for _ in range(2)
    ]
    try:
        for node in nodes:
            node.stdout.readline()
        killed, alive = (segments(node.pid) for node in nodes)
        nodes[0].kill()
        nodes[0].wait()
        remove_leftovers()  # of a minute ago at least
        young = {name for name in killed | alive if (FOLDER / name).exists()}
        age(killed | alive)
        remove_leftovers()
        left = {name for name in killed | alive if (FOLDER / name).exists()}
    finally:
        for node in nodes:
            node.kill()
            node.communicate()
    assert killed
    assert alive
    assert young == killed | alive
    assert left == alive
    remove_leftovers()
    assert not any((FOLDER / name).exists() for name in alive)
