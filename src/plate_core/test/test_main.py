"""run_node: a clean start and a clean stop."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("rclpy")

PATIENCE_S = 60
"""Maximum duration of an operation that takes a few seconds, or more on a busy machine [s]."""

NODE = """
import os, signal, sys, time
from rclpy.node import Node
from plate_core import PlateError
from plate_core.ros import run_node

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        if "convert" in sys.argv:
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1)
            except KeyboardInterrupt:  # as rclpy does it while it converts a message
                raise RuntimeError("Unable to convert call argument '0' to Python object") from None
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


STARTER = """
import subprocess, sys
print("node", subprocess.Popen([sys.executable, *sys.argv[1:]]).pid, flush=True)
sys.stdin.readline()
"""

LIFECYCLE = """
from plate_core.ros import NodeOptions, SafeLifecycleNode, run_node

class Ticking(SafeLifecycleNode[NodeOptions]):
    def __init__(self):
        super().__init__("ticking", NodeOptions)

    def configure(self):
        self.managed_timer(0.05, lambda: print("tick", flush=True))

    def release(self):
        print("at rest", flush=True)

run_node(Ticking, NodeOptions)
"""


def start(*words: str, **options) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", NODE, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def test_signals_end_the_program_normally(hears):
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


def test_a_signal_that_rclpy_converts_to_another_error_ends_the_program_normally():
    done = start("convert")
    output, errors = done.communicate(timeout=PATIENCE_S)
    assert (done.returncode, output, errors) == (0, "", "")


def inherited():
    """As of `program &` in a script, and of a starter that holds signals back."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_the_program_with_any_inherited_handlers(hears, number):
    with start(preexec_fn=inherited) as process:
        assert hears(process, "ready")
        process.send_signal(number)
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (0, "")
    assert output.endswith("last words, ROS works: True\n")


def test_a_closed_terminal_does_not_end_a_program_that_ignores_it(hears):
    with start(preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)) as process:
        assert hears(process, "ready")
        process.send_signal(signal.SIGHUP)
        assert all(process.stdout.readline() for _ in range(20))
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0


@pytest.fixture(name="orphan")
def _orphan():
    """A node whose parent was killed: its pid, and the pipe of its output."""
    pids, files = [], contextlib.ExitStack()

    def orphan(program, first_line, *words):
        starter = subprocess.Popen(
            [sys.executable, "-c", STARTER, "-c", program, *words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        pids.append(int(starter.stdout.readline().split()[1]))
        while starter.stdout.readline() != f"{first_line}\n":
            pass
        files.enter_context(starter.stdout)
        files.enter_context(starter.stdin)
        starter.kill()
        starter.wait()
        return pids[-1], starter.stdout

    with files:
        yield orphan
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("program", "first_line", "last"),
    [(NODE, "ready", "last words, ROS works: True\n"), (LIFECYCLE, "tick", "at rest\n")],
    ids=["node", "lifecycle"],
)
def test_a_node_ends_with_the_process_that_started_it(orphan, program, first_line, last):
    _, output = orphan(program, first_line)
    assert output.read().endswith(last)  # until no process has the pipe open


def test_a_node_without_end_with_parent_survives_its_parent(orphan):
    pid, output = orphan(LIFECYCLE, "tick", "--ros-args", "-p", "end_with_parent:=false")
    for _ in range(20):  # ten rounds of the executor and more
        assert output.readline() == "tick\n"
    os.kill(pid, signal.SIGTERM)
    assert output.read().endswith("at rest\n")


def test_wrong_input_causes_a_message_of_one_line_and_exit_code_2():
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
def test_files_that_ros_itself_reads_are_checked(tmp_path, words, message):
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
    assert output.endswith("last words, ROS works: True\n")  # Fast DDS can print something before
