"""The driver as a process on a pseudo-terminal, with the C firmware at its other end, in real time.

The judge is the line: what the driver has written on it; and the current, which is the firmware's.
"""

import contextlib
import os
import signal
import subprocess
import threading
import time
import tty
from types import SimpleNamespace

import numpy as np
import pytest
from shaking import PERIOD, shaking

from plate_core import load_rig
from plate_core.serial_protocol import Commit, Enable, Hello, Reader, State, Stop, parse

rclpy = pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from graph.forks import Fork  # noqa: E402
from graph.processes import executable  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.ros import (  # noqa: E402
    DATA,
    LATCHED,
    cycle_to_msg,
    msg_to_cycle,
    nanoseconds,
    to_time,
)
from plate_driver.safety.node import LATE, LIFE_PERIOD_S, NO_REPLY  # noqa: E402
from plate_driver.status import AT_REST, CHECK_RIG, OFF, UNANSWERED  # noqa: E402
from plate_driver.transports import CALL_AGAIN, CONNECTING  # noqa: E402
from plate_interfaces.msg import DriverStatus  # noqa: E402

RIG = load_rig()
TICK_S = 1e-3
MAX_TICKS = 100
"""On a machine that is too busy, the board's clock stalls from there on."""

NAMESPACE = f"/serial_node_{os.getpid()}"
NODE = "plate_driver.node"
LIFECYCLE = {"configure": 1, "cleanup": 2, "activate": 3, "deactivate": 4}


EMERGENCY, CUT = (f"stopped: {what}; {CHECK_RIG}" for what in ("emergency stop", "power cut"))


def driver(log, namespace: str, *parameters: str) -> Fork:
    words = [str(executable("plate_driver", "driver")), "--ros-args", "-r", f"__ns:={namespace}"]
    words += [word for each in parameters for word in ("-p", each)]
    fork = Fork.start(words, os.environ, log, [NODE])
    assert fork is not None
    return fork


class Board:
    """The firmware behind a pseudo-terminal, in a thread of its own."""

    def __init__(self, program) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self.slave, self.port = slave, os.ttyname(slave)
        self.process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.begin, self.ticks, self.lost = time.monotonic(), 0, 0
        self.state = State.OFF
        self.current = False
        self.travel = 0.0
        self.setpoints = 0
        self.heard: list[object] = []
        self._reader, self.dead = Reader(), False
        self.came = b""
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self) -> None:
        while not self.ended.wait(0.004):
            self.serve()

    def serve(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self.came += os.read(self.master, 100_000)
        due = round((time.monotonic() - self.begin) / TICK_S) - self.ticks - self.lost
        self.lost += max(0, due - MAX_TICKS)
        due = min(due, MAX_TICKS)
        if due <= 0:
            return
        data, self.came = self.came, b""
        self._reader, packets = self._reader.fed(data)
        self.heard += [parse(packet).message for packet in packets]
        order = "" if self.dead or not data else f"rx {data.hex()}\n"
        # In the last tick: a board does not receive bytes that are not sent yet.
        self.process.stdin.write(f"run {(due - 1) * 1000}\n{order}run 1000\n")
        self.process.stdin.flush()
        self.ticks += due
        runs = 2
        for line in iter(self.process.stdout.readline, ""):
            kind, *words = line.split()
            if kind == "tx" and not self.dead:
                with contextlib.suppress(BlockingIOError):
                    os.write(self.master, bytes.fromhex(words[0]))
            elif kind == "at":
                self.setpoints += 1
                self.travel = max(self.travel, *(abs(float(w)) for w in words[1:5]))
            elif kind == "drive":
                self.current = bool(int(words[1]))
            elif kind == "state":
                self.state = State(int(words[0]))
                runs -= 1
                if not runs:
                    return

    def count(self, kind) -> int:
        return sum(isinstance(message, kind) for message in self.heard)

    def close(self) -> None:
        self.ended.set()
        self.thread.join(20)
        self.process.stdin.close()
        self.process.stdout.read()
        self.process.stdout.close()
        self.process.wait(10)
        os.close(self.master)
        os.close(self.slave)


class Bench:
    """A driver process at a board, and a node that speaks to it."""

    def __init__(self, board: Board, log) -> None:
        self.board, self.log = board, log
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("peer", context=self.context, namespace=NAMESPACE)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.texts: list[str] = []
        self.status = DriverStatus()
        self.states: list[JointState] = []
        self.setpoints: list[JointTrajectory] = []
        self.starts: list[JointTrajectory] = []
        self.reports: list[DiagnosticStatus] = []
        listen = self.node.create_subscription
        listen(DriverStatus, "driver_status", self.on_status, LATCHED)
        listen(JointTrajectory, "cycle_started", self.starts.append, DATA)
        listen(JointState, "motor_states", self.states.append, DATA)
        listen(JointTrajectory, "motor_setpoints", self.setpoints.append, DATA)
        listen(DiagnosticArray, "diagnostics", lambda m: self.reports.append(m.status[0]), DATA)
        self.cycles = self.node.create_publisher(JointTrajectory, "plate_cycle", DATA)
        client = self.node.create_client
        self.clients = {
            name: client(Trigger, name) for name in ("emergency_stop", "cut_power", "home")
        }
        self.enabler = client(SetBool, "enable")
        from lifecycle_msgs.srv import ChangeState

        self.changer = client(ChangeState, "driver/change_state")
        self.stamp = 0

    def on_status(self, msg: DriverStatus) -> None:
        self.status = msg
        if self.texts[-1:] != [msg.text]:
            self.texts.append(msg.text)

    def off(self) -> bool:
        """Whether the motors are off, and a status was received since `texts` was cleared."""
        return bool(self.texts) and self.status.state in (
            DriverStatus.DISABLED, DriverStatus.STOPPED,
        )  # fmt: skip

    def start(self, *parameters: str) -> None:
        words = ["transport:=serial", f"port:={self.board.port}", "state_rate:=50.0"]
        self.log.unlink(missing_ok=True)
        self.process = driver(self.log, NAMESPACE, *words, *parameters)

    def until(self, condition, seconds: float = 30.0) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)
            if condition():
                return True
        return False

    def tells(self, text: str, seconds: float = 30.0) -> None:
        assert self.until(lambda: self.texts and self.texts[-1] == text, seconds), self.texts

    def call(self, client, request):
        assert client.wait_for_service(timeout_sec=20.0)
        future = client.call_async(request)
        assert self.until(future.done), "no answer"
        return future.result()

    def stop(self, name: str = "emergency_stop"):
        return self.call(self.clients[name], Trigger.Request())

    def stopped(self, name: str = "emergency_stop"):
        """Stop with one call. On a busy computer the device may confirm later than a call waits;
        the driver continues, and reports the confirmation."""
        answer = self.stop(name)
        assert answer.success or answer.message == UNANSWERED, answer.message
        self.wait(LIFE_PERIOD_S)
        assert self.until(lambda: self.status.reason != DriverStatus.STOP_UNANSWERED)

    def enable(self, value: bool = True):
        """Call enable. A driver that stalled on a busy computer refuses calls for 0.5 s."""
        for _ in range(5):
            answer = self.call(self.enabler, SetBool.Request(data=value))
            if answer.message != LATE:
                break
            self.wait(0.5)
        return answer

    def ready(self) -> bool:
        """Whether the motors are ready. Enable them if they are off. On a busy computer, the device
        may stop because it receives nothing from the driver."""
        if self.status.state in (DriverStatus.DISABLED, DriverStatus.STOPPED):
            self.enable()
        return self.status.state == DriverStatus.READY

    def change(self, name: str) -> None:
        request = type(self.changer.srv_type.Request())()
        request.transition.id = LIFECYCLE[name]
        assert self.call(self.changer, request).success

    def send(self) -> None:
        self.stamp = time.time_ns()
        self.cycles.publish(cycle_to_msg(shaking(0.001), to_time(self.stamp)))

    def moving(self) -> None:
        """Enable, and send cycles until the plate plays them."""
        self.send_until(lambda: self.board.state is State.PLAYING)

    def send_until(self, condition) -> None:
        """Send cycles until a condition holds, and enable the motors whenever they are off.

        On a busy computer the last stop may be reported late, the device may stop because it
        receives nothing from the driver, and a short motion may be missing in the reports."""
        assert self.until(lambda: self.cycles.get_subscription_count() > 0)

        def holds() -> bool:
            if self.status.state in (DriverStatus.DISABLED, DriverStatus.STOPPED):
                self.enable()
            self.send()
            self.wait(PERIOD)
            return bool(condition())

        assert self.until(holds), self.texts

    def rests(self) -> bool:
        """Whether the driver reports that the plate rests. On a busy computer the device may have
        stopped because it received nothing from the driver. The motors are then enabled again. If
        the last cycle arrived too late and was refused, another one is sent."""
        if self.status.state in (DriverStatus.DISABLED, DriverStatus.STOPPED):
            self.enable()
        if "refused" in self.reports[-1].message:
            self.send()
            self.wait(1.0)  # until the next report
        return bool(self.reports[-1].message == AT_REST)

    def send_in_vain(self) -> None:
        for _ in range(10):
            self.send()
            self.wait(PERIOD)

    def wait(self, seconds: float) -> None:
        self.until(lambda: False, seconds)

    def end(self, number: int = signal.SIGTERM) -> str:
        self.process.send_signal(number)
        self.process.wait(30)
        return self.log.read_text(encoding="utf-8")

    def close(self) -> None:
        # Not killed at once: where one that is killed held a lock of shared memory, Fast DDS makes
        # that anew, and crashes who leaves meanwhile: the process of the tests.
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.end()
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(30)
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(name="bench")
def _bench(program, tmp_path):
    board = Board(program)
    bench = Bench(board, tmp_path / "driver.log")
    yield bench
    bench.close()
    board.close()


def test_cycles_reach_the_board_and_telemetry_the_graph(bench):
    board = bench.board
    bench.start("hold_cycles:=2")  # so that the next cycle begins before the plate rests
    bench.tells(OFF)
    assert bench.until(lambda: len(bench.states) > 2)
    assert bench.states[-1].name == [motor.name for motor in RIG.motors]
    assert (board.count(Enable), board.setpoints, board.current) == (0, 0, False)
    bench.send()  # nothing moves unasked
    bench.wait(1.0)
    assert (board.count(Enable), board.count(Commit), board.setpoints) == (0, 0, 0)
    lost = board.lost
    bench.send_until(lambda: any(any(s.position) for s in bench.states))
    bench.send_until(lambda: any(np.max(np.abs(s.effort)) > 1.0 for s in bench.states))  # m/s2
    stamps = [nanoseconds(s.header.stamp) for s in bench.states]
    assert stamps == sorted(stamps)
    assert abs(stamps[-1] * 1e-9 - time.time()) < 5
    bench.send_until(lambda: board.travel > 5e-4)
    assert board.travel < 2e-3
    # Starts of cycles: of rest before, one after the other, and of the sent cycles.
    bench.send_until(lambda: sum(msg_to_cycle(s).knot_pose.any() for s in bench.starts) > 1)
    begins = np.array([nanoseconds(s.header.stamp) for s in bench.starts])
    moved = np.array([msg_to_cycle(s).knot_pose.any() for s in bench.starts])
    assert not moved[0]
    # On a busy computer, a stop shifts the starts, and so does a board whose clock stalls. If a
    # cycle arrives late, the plate rests before this cycle.
    if board.lost == lost:
        assert np.all(np.diff(begins) > 0)
    if board.count(Enable) == 1 and board.lost == lost:
        steps = np.diff(begins)[moved[1:] & moved[:-1]] * 1e-9 / PERIOD
        assert np.all(np.abs(steps - np.round(steps)) < 0.1), steps
    assert nanoseconds(bench.setpoints[-1].header.stamp) <= bench.stamp
    # Without cycles the plate rests, with current. Without a task that is normal.
    ended = bench.until(lambda: bench.rests() and board.state is State.READY)
    assert ended, (bench.reports[-1].message, bench.texts, board.state)
    assert bench.reports[-1].level == DiagnosticStatus.OK
    values = {v.key: v.value for v in bench.reports[-1].values}
    assert {"device_state", "faults", "stop", "following_error_mm", "device_load",
            "round_trip_ms", "device_thermal_load"} <= set(values)  # fmt: skip
    assert bench.texts[-1] == "ready"
    # And goes on with the next one, which needs no enable, unless the motors were off meanwhile.
    enables, before = board.count(Enable), len(bench.texts)
    bench.moving()
    assert board.count(Enable) == enables or set(bench.texts[before:]) - {"ready"}
    assert "Traceback" not in bench.end()
    assert board.count(Stop) >= 1
    assert bench.until(lambda: board.state is State.OFF)
    assert not board.current


def again(bench: Bench) -> None:
    bench.stopped()
    bench.stopped("cut_power")


def lifecycle(bench: Bench) -> None:
    for change in ("deactivate", "activate"):
        bench.change(change)


def anew(bench: Bench) -> None:
    for change in ("deactivate", "cleanup", "configure", "activate"):
        bench.change(change)


def ended(number: int):
    def end(bench: Bench) -> None:
        bench.end(number)
        bench.texts.clear()
        bench.start()
        assert bench.until(bench.off)

    end.__name__ = signal.Signals(number).name
    return end


def homed(bench: Bench) -> None:
    """On a busy computer, the reply of the driver does not wait for that of the device, or the
    driver refuses calls after a stall."""
    answer = bench.call(bench.clients["home"], Trigger.Request())
    assert answer.success or answer.message in (NO_REPLY, LATE), answer.message


WAYS = [again, lifecycle, anew, ended(signal.SIGINT), ended(signal.SIGTERM),
        ended(signal.SIGKILL), homed]  # fmt: skip


def test_no_input_clears_a_stop(bench):
    board = bench.board
    bench.start()
    bench.tells(OFF)
    bench.moving()
    for way in WAYS:
        bench.stopped()
        bench.tells(EMERGENCY)
        assert not board.current
        enables, setpoints = board.count(Enable), board.setpoints
        way(bench)
        bench.send_in_vain()
        assert board.count(Enable) == enables, way
        assert (board.current, board.setpoints) == (False, setpoints), way
        assert bench.off(), (way, bench.texts)
        bench.moving()  # a person enables: once on the line, whatever repetitions
        assert board.current


def test_the_end_of_the_driver_during_a_motion_stops_the_plate_until_an_enable(bench):
    board = bench.board
    bench.start()
    bench.tells(OFF)
    for way in (lifecycle, ended(signal.SIGTERM), ended(signal.SIGKILL)):
        bench.moving()
        enables, stops = board.count(Enable), board.count(Stop)
        bench.texts.clear()
        way(bench)
        assert bench.until(lambda: not board.current)
        assert bench.until(bench.off)
        bench.send_in_vain()
        assert (board.count(Enable), board.current) == (enables, False), way
        assert bench.off(), (way, bench.texts)
        if way.__name__ != "SIGKILL":
            assert board.count(Stop) > stops  # it reported it, and did not leave it to the device


def test_kinds_of_stop_and_a_device_that_does_not_answer(bench):
    board = bench.board
    bench.start()
    bench.tells(OFF)
    bench.moving()
    bench.stopped("cut_power")
    assert not board.current
    assert Stop(1) in board.heard
    bench.tells(CUT)
    before = len(bench.texts)
    bench.moving()
    assert not [text for text in bench.texts[before:] if "power cut" in text]  # only once
    assert bench.enable(False).success
    # Where a busy computer lets the line fall silent meanwhile, the device has stopped as well.
    assert bench.until(lambda: bench.texts[-1] == OFF or "host silent" in bench.texts[-1])
    assert bench.until(lambda: not board.current)
    bench.moving()
    # Its cable is cut: no device acknowledges, and the reply states this.
    board.dead = True
    answer = bench.stop()
    assert (answer.success, answer.message) == (False, UNANSWERED)
    assert bench.until(lambda: bench.status.state == DriverStatus.ERROR)
    assert bench.status.reason == DriverStatus.STOP_UNANSWERED
    assert bench.until(lambda: bench.reports[-1].level == DiagnosticStatus.ERROR)
    assert not bench.enable().success
    assert bench.until(lambda: not board.current)  # the device's own watchdog
    board.dead = False
    bench.tells(EMERGENCY)
    bench.wait(1.0)
    assert not board.current


def test_a_driver_waits_for_a_device_that_starts_later(bench):
    """A call of enable in the meantime is refused, and has no effect when the device starts."""
    board = bench.board
    board.dead = True
    bench.start()
    bench.tells(f"error: {CONNECTING.text}")
    assert bench.status.reason == DriverStatus.NO_ANSWER
    answer = bench.enable()
    assert not answer.success
    assert answer.message.endswith(CALL_AGAIN)  # on a busy computer the first Hello has timed out
    board.dead = False
    bench.tells(OFF)
    bench.wait(1.0)
    assert (board.count(Enable), board.current) == (0, False)
    bench.moving()


def test_a_driver_waits_for_its_port(bench, tmp_path):
    board, link = bench.board, tmp_path / "port"
    terminal, board.port = board.port, str(link)
    bench.start()
    waits = f"error: serial port {link} is not there: waiting for it"
    bench.tells(waits)
    assert bench.status.reason == DriverStatus.PORT
    assert bench.until(lambda: bench.reports and bench.reports[-1].message == waits)
    assert bench.reports[-1].level == DiagnosticStatus.ERROR
    answer = bench.enable()
    assert (answer.success, answer.message) == (
        False, waits.removeprefix("error: ") + CALL_AGAIN
    )  # fmt: skip
    answer = bench.stop()
    assert (answer.success, answer.message) == (False, UNANSWERED)
    link.symlink_to(terminal)
    bench.tells(EMERGENCY)
    assert board.count(Stop) >= 1
    bench.wait(1.0)
    assert (board.count(Enable), board.current) == (0, False)
    bench.moving()
    # It is the same for one that vanishes in mid-run.
    link.unlink()
    board.dead = True  # as a port that is pulled out
    assert bench.until(lambda: bench.texts[-1] == waits), bench.texts
    board.dead = False
    link.symlink_to(terminal)
    bench.tells("stopped: host silent; look at the rig, then call enable")
    assert bench.end().count(waits.removeprefix("error: ")) == 2  # each time once


def test_a_stop_in_every_lifecycle_state_reaches_the_device(bench):
    board = bench.board
    bench.start("autostart:=false")
    bench.tells("unconfigured")
    bench.stopped()
    assert board.count(Stop) >= 1
    bench.change("configure")
    stops = board.count(Stop)
    bench.stopped()
    assert board.count(Stop) > stops
    bench.change("activate")
    bench.tells(EMERGENCY)
    bench.moving()


def test_the_port_is_for_one_driver(bench):
    bench.start()
    bench.tells(OFF)
    bench.moving()
    hellos = bench.board.count(Hello)
    log = bench.log.with_name("second.log")
    second = driver(log, "/second", "transport:=serial", f"port:={bench.board.port}")
    waits = f"serial port {bench.board.port} is used by another program: waiting for it"
    assert bench.until(lambda: log.exists() and waits in log.read_text(encoding="utf-8"))
    second.send_signal(signal.SIGTERM)
    second.wait(30)
    assert bench.board.count(Hello) == hellos
    bench.moving()  # again, where a busy machine has let the line fall silent meanwhile


def test_an_interrupt_of_all_processes_is_not_reported_as_a_failure_of_the_device(tmp_path):
    """As with Ctrl-C in a terminal with a launch file. The simulated device outlives the driver."""
    port = str(tmp_path / "port")
    words = [str(executable("plate_sim", "device")), "--ros-args", "-r", f"__ns:={NAMESPACE}"]
    module = "plate_sim.device.node"
    device = Fork.start([*words, "-p", f"link:={port}"], os.environ, tmp_path / "log", [module])
    bench = Bench(SimpleNamespace(port=port), tmp_path / "driver.log")
    try:
        bench.start()
        bench.tells(OFF)
        assert bench.until(bench.ready), bench.texts
        device.send_signal(signal.SIGINT)
        bench.wait(0.2)  # the driver continues
        assert UNANSWERED not in bench.end(signal.SIGINT)
        device.wait(30)
        assert not os.path.lexists(port)
    finally:
        bench.close()
        device.send_signal(signal.SIGKILL)
        device.wait(30)
