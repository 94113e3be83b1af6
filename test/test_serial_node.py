"""The driver node on a pseudo-terminal, with the C firmware at its other end, in real time."""

import os
import subprocess
import time
import tty

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_core.serial_protocol import State

rclpy = pytest.importorskip("rclpy")
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.ros.convert import cycle_to_msg, nanoseconds, to_time  # noqa: E402
from plate_core.ros.qos import DATA  # noqa: E402
from plate_driver.node import DriverNode  # noqa: E402

RIG = load_rig()
PERIOD = 0.1
TICK_S = 1e-3
DOMAIN = 1 + (37 * os.getpid() + 5) % 99


def shaking(amplitude: float) -> PlateCycle:
    """Cycle that starts at rest; amplitude [m]."""
    t = np.arange(48) * PERIOD / 48
    wave = np.sin(np.pi * t / PERIOD) ** 4 * np.sin(4 * np.pi * t / PERIOD)
    cycle = PlateCycle.from_samples(PERIOD, amplitude * np.outer(wave, [1, 1, 0]))
    twist, accel = cycle.knot_twist.copy(), cycle.knot_accel.copy()
    twist[[0, -1]] = accel[[0, -1]] = 0
    return PlateCycle.from_knots(cycle.times, cycle.knot_pose, twist, accel)


class Board:
    """The firmware behind a pseudo-terminal; `serve` lets it catch up with the clock."""

    def __init__(self, program) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self.slave, self.port = slave, os.ttyname(slave)
        self.process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.begin, self.ticks = time.monotonic(), 0
        self.states: list[State] = []
        self.travel = 0.0

    def serve(self) -> None:
        due = round((time.monotonic() - self.begin) / TICK_S) - self.ticks
        if due <= 0:
            return
        try:
            order = f"rx {os.read(self.master, 100_000).hex()}\n"
        except BlockingIOError:
            order = ""
        self.process.stdin.write(f"{order}run {due * 1000}\n")
        self.process.stdin.flush()
        self.ticks += due
        for line in iter(self.process.stdout.readline, ""):
            kind, *words = line.split()
            if kind == "tx":
                os.write(self.master, bytes.fromhex(words[0]))
            elif kind == "at":
                self.travel = max(self.travel, *(abs(float(w)) for w in words[1:5]))
            elif kind == "state":
                self.states.append(State(int(words[0])))
                return

    def close(self) -> None:
        self.process.stdin.close()
        self.process.stdout.read()
        self.process.stdout.close()
        self.process.wait(10)
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture(name="board")
def _board(program):
    board = Board(program)
    yield board
    board.close()


@pytest.mark.parametrize("streams", ["false", "true"])
def test_cycles_reach_the_board_and_telemetry_the_graph(board, streams):
    words = [f"streams:={streams}"]
    words += ["transport:=serial", f"port:={board.port}", "state_rate:=50.0", "hold_cycles:=1000"]
    arguments = ["--ros-args", *(w for p in words for w in ("-p", p)), "-r", "__ns:=/serial_node"]
    rclpy.init(args=arguments, domain_id=DOMAIN)
    executor = SingleThreadedExecutor()
    driver, peer = DriverNode(), rclpy.create_node("peer")
    states: list[JointState] = []
    setpoints: list[JointTrajectory] = []
    peer.create_subscription(JointState, "motor_states", states.append, DATA)
    peer.create_subscription(JointTrajectory, "motor_setpoints", setpoints.append, DATA)
    cycles = peer.create_publisher(JointTrajectory, "plate_cycle", DATA)
    for node in (driver, peer):
        executor.add_node(node)

    def until(condition, seconds: float = 10.0) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            board.serve()
            executor.spin_once(timeout_sec=0.001)
            if condition():
                return True
        return False

    try:
        assert until(lambda: cycles.get_subscription_count() and len(states) > 2)
        assert states[-1].name == [motor.name for motor in RIG.motors]
        assert not any(states[-1].position)
        cycles.publish(cycle_to_msg(shaking(0.001), to_time(1_000)))
        assert until(lambda: any(any(s.position) for s in states)), board.states[-1:]
        assert nanoseconds(setpoints[-1].header.stamp) == 1_000
        assert until(lambda: any(np.max(np.abs(s.effort)) > 1.0 for s in states))  # m/s2
        assert until(lambda: board.travel > 5e-4)
        stamps = [nanoseconds(s.header.stamp) for s in states]
        assert stamps == sorted(stamps)
        assert abs(stamps[-1] * 1e-9 - time.time()) < 5
        assert board.states[-1] is State.PLAYING
        assert board.travel < 2e-3
        # The end of the driver is the end of the motion.
        driver.destroy_node()
        assert until(lambda: board.states[-1] is State.OFF)
    finally:
        executor.shutdown()
        peer.destroy_node()
        rclpy.shutdown()
