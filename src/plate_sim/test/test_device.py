"""The device's surroundings: line, recorder, accidents, pseudo-terminal. The rest: test/."""

import itertools
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import serial
import yaml
from shaking import PERIOD, shaking

from plate_core import CycleError, PlateCycle, PlateError, load_rig  # fmt: skip
from plate_core.motion import motor_state  # fmt: skip
from plate_core.rig import default_rig_path  # fmt: skip
from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Begin,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Knot,
    Knots,
    Message,
    Packet,
    Pulse,
    Reader,
    State,
    Telemetry,
    frame,
    pack,
    parse,
    table_crc,
)
from plate_sim import PlateMotion
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule, Line, LineFaults, PseudoTerminal

RIG = load_rig()
LIMITS = DeviceLimits.of_rig(RIG)


def test_load_gives_the_plate_its_acceleration():
    # Independent: forces B^T-wise on plate give mass times acceleration.
    accel = np.array([3.0, -2.0, 40.0])
    _, _, qdd = motor_state(RIG, np.zeros((1, 3)), np.zeros((1, 3)), accel[None])
    force = LIMITS.load @ qdd[0]
    total, torque = np.zeros(2), 0.0
    for motor, push in zip(RIG.motors, force, strict=True):
        vector = push * np.array(motor.direction)
        total += vector
        torque += motor.point[0] * vector[1] - motor.point[1] * vector[0]
    np.testing.assert_allclose(total, RIG.plate.mass_kg * accel[:2], rtol=1e-6)
    inertia = RIG.plate.mass_kg * (RIG.plate.length_m**2 + RIG.plate.width_m**2) / 12
    assert torque == pytest.approx(inertia * accel[2], rel=1e-6)


def test_load_is_that_of_the_inertia_and_centre_of_mass_in_the_rig_file(tmp_path):
    # Independent: Newton's law for each of four point masses of that inertia about that centre.
    facts = yaml.safe_load(default_rig_path().read_text(encoding="utf-8"))
    centre, inertia = np.array([0.04, -0.02]), 0.11
    facts["suspension"] = {
        "frequency_hz": [35, 35, 35],
        "damping_ratio": [0.03, 0.03, 0.03],
        "feedforward": {"mass": 0, "damping": 0, "stiffness": 1},
        "inertia_kgm2": inertia,
        "centre_of_mass_m": centre.tolist(),
    }
    path = tmp_path / "hung.yaml"
    path.write_text(yaml.safe_dump(facts), encoding="utf-8")
    hung = load_rig(path)
    mass = hung.plate.mass_kg
    places = centre + np.sqrt(inertia / mass) * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    motors = [(np.array(motor.point), np.array(motor.direction)) for motor in hung.motors]
    for accel in np.eye(3) * [5.0, 5.0, 40.0]:
        pulls = mass / 4 * (accel[:2] + accel[2] * np.stack([-places[:, 1], places[:, 0]], 1))
        needed = [*pulls.sum(0), np.sum(places[:, 0] * pulls[:, 1] - places[:, 1] * pulls[:, 0])]
        qdd = [
            way @ (accel[:2] + accel[2] * np.array([-point[1], point[0]])) for point, way in motors
        ]
        force = DeviceLimits.of_rig(hung).load @ qdd
        pushes = [push * way for push, (_, way) in zip(force, motors, strict=True)]
        torque = sum(
            point[0] * push[1] - point[1] * push[0]
            for push, (point, _) in zip(pushes, motors, strict=True)
        )
        np.testing.assert_allclose([*np.sum(pushes, 0), torque], needed, rtol=1e-5, atol=1e-4)
        # A uniform plate on the same flexures would need something else.
        assert np.max(np.abs(LIMITS.load @ qdd - force)) > 0.05


def test_line_has_the_requested_faults():
    data = bytes(range(256)) * 400
    for name, expected in (("dropped", 0.99), ("repeated", 1.01), ("corrupted", 1.0)):
        line = Line(LineFaults(**{name: 0.01}), np.random.default_rng(1))
        line.sent(data, 0.0)
        received = line.arrived(0.0)
        assert len(received) / len(data) == pytest.approx(expected, abs=1e-3)
        assert received != data
    changed = np.frombuffer(received, np.uint8) != np.frombuffer(data, np.uint8)
    assert np.mean(changed) == pytest.approx(0.01, abs=1e-3)


def test_line_takes_its_time():
    line = Line(LineFaults(delay=0.02, baud=10_000), np.random.default_rng(1))
    line.sent(b"12345", 0.0)  # 5 ms
    line.sent(b"6", 0.001)
    assert line.arrived(0.0249) == b""
    assert line.arrived(0.0251) == b"12345"
    assert line.arrived(0.0261) == b"6"
    split = Line(LineFaults(split=1.0), np.random.default_rng(1))
    split.sent(b"123456", 0.0)
    parts = [split.arrived(t) for t in np.arange(0, 0.01, 1e-4)]
    assert len([part for part in parts if part]) == 2
    assert b"".join(parts) == b"123456"
    with pytest.raises(PlateError, match="dropped is 2, allowed: 0 to 1"):
        LineFaults(dropped=2)


class Host:
    """Sends the given packets, and heartbeats. Keeps the device's packets and setpoints."""

    def __init__(self, accidents: FaultSchedule | None = None) -> None:
        self.setpoints: list[np.ndarray | None] = []
        see = lambda now, at: self.setpoints.append(at)  # noqa: E731
        self.emulator = Emulator(LIMITS, 5, accidents, see)
        self.messages: list[Message] = []
        self.stretches = []
        self._reader, self._number = Reader(), 0

    def say(self, message: Message) -> None:
        self._number += 1
        data = frame(pack(Packet(self._number, message)))
        self.emulator.to_device.sent(data, self.emulator.now)

    def wait(self, seconds: float) -> None:
        for tick in range(round(seconds * 1e3)):
            if tick % 50 == 0:
                self.say(Heartbeat(1))
            self.stretches += self.emulator.tick()
            data = self.emulator.to_host.arrived(self.emulator.now)
            self._reader, packets = self._reader.fed(data)
            self.messages += [parse(p).message for p in packets]

    def begin(self) -> None:
        self.say(Hello(VERSION, 9))
        self.wait(0.01)
        self.enable()
        self.wait(0.9)

    def enable(self) -> None:
        self.say(Enable(self.emulator.device.stops))

    def upload(self, cycle: PlateCycle, table: int) -> None:
        motors = motor_state(RIG, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
        rows = np.float32(np.stack(motors, axis=1)).tolist()
        ticks = np.round(cycle.times * 1e8).astype(int).tolist()
        knots = [Knot(k, *map(tuple, row)) for k, row in zip(ticks, rows, strict=True)]
        self.say(Begin(table, len(knots), table_crc(knots)))
        for first in range(0, len(knots), 4):
            self.say(Knots(table, first, tuple(knots[first : first + 4])))
            self.wait(0.003)  # for the time that the line would take
        self.say(Commit(table, 50))

    @property
    def state(self) -> State:
        return self.emulator.state

    @property
    def faults(self) -> Fault:
        return self.emulator.faults


def test_the_record_of_played_motion_has_no_gap():
    host = Host()
    host.begin()
    first, second = shaking(0.001), shaking(0.002)
    host.upload(first, 1)
    host.wait(0.25)
    host.upload(second, 2)
    host.wait(0.5)
    # No gap and no overlap, from the beginning on
    edges = [(s.start, s.end) for s in host.stretches]
    assert edges[0][0] == 0
    np.testing.assert_allclose([a for a, _ in edges[1:]], [b for _, b in edges[:-1]], atol=1e-9)
    tables = [s.table for s in host.stretches if s.table]
    assert tables[:3] == [1, 1, 1]
    assert tables[-1] == 2
    for stretch in host.stretches:
        if stretch.table:
            motion = PlateMotion.of_motors(RIG, stretch.times, stretch.motors)
            requested = {1: first, 2: second}[stretch.table]
            t = np.linspace(0, PERIOD, 77)
            np.testing.assert_allclose(motion.pose(t), requested.pose(t), atol=2e-7)


def test_a_brake_is_recorded_as_it_was():
    host = Host()
    host.begin()
    host.upload(shaking(0.002), 1)
    host.wait(0.333)
    host.emulator.to_device.sent(b"\0", 0)
    for _ in range(1200):  # the host falls silent
        host.stretches += host.emulator.tick()
    assert (host.state, host.faults) == (State.OFF, Fault.HOST_SILENT)
    ends = [(s.start, s.end, s.motors) for s in host.stretches]
    for (_, _, before), (_, _, after) in itertools.pairwise(ends):
        np.testing.assert_allclose(after[0, :2], before[-1, :2], atol=2e-6)
    assert np.max(np.abs(ends[-1][2])) < 1e-6
    # Between its knots, too, a stretch is where the device has commanded.
    for stretch in host.stretches:
        motion = PlateMotion.of_motors(RIG, stretch.times, stretch.motors)
        times = np.arange(np.ceil(stretch.start * 1e3 + 1e-6), stretch.end * 1e3).astype(int)
        for tick in times[::5]:
            at = host.setpoints[tick - 1]
            if at is not None:
                pose = motion.pose(tick * 1e-3 - stretch.start)
                q, _, _ = motor_state(RIG, pose, np.zeros((1, 3)), np.zeros((1, 3)))
                np.testing.assert_allclose(q[0], at[0], atol=5e-6)


def test_reset_forgets_all_and_the_plate_glides_home():
    host = Host()
    host.begin()
    host.upload(shaking(0.004), 1)
    host.wait(0.33)
    boot = host.emulator.device.boot
    host.emulator.reset()
    host.wait(0.5)
    assert host.emulator.device.boot != boot
    assert (host.state, host.faults) == (State.OFF, Fault.NO_HOME)
    last = host.stretches[-1].motors[-1]
    assert np.max(np.abs(last[0])) < 1e-6
    peak = max(np.max(np.abs(s.motors[:, 0])) for s in host.stretches)
    assert peak <= RIG.limits.stroke_m
    host.begin()
    assert host.state is State.READY


def test_a_brown_out_stops_the_motors_until_an_enable():
    host = Host(replace(FaultSchedule(), brown_out_every=1.5))
    host.begin()
    assert host.state is State.READY
    host.wait(0.6)
    assert (host.state, host.faults) == (State.OFF, Fault.SUPPLY)
    host.wait(0.4)
    assert host.state is State.OFF
    host.enable()
    host.wait(0.6)
    assert (host.state, host.faults) == (State.READY, Fault.NONE)
    assert any(isinstance(m, Telemetry) and m.faults & Fault.SUPPLY for m in host.messages)


def test_a_jammed_plate_causes_a_fault():
    host = Host()
    host.begin()
    host.upload(shaking(0.003), 1)
    host.wait(0.25)
    host.emulator.jam()
    host.wait(0.1)
    assert (host.state, host.faults) == (State.OFF, Fault.FOLLOWING)
    errors = [m.following_m for m in host.messages if isinstance(m, Telemetry)]
    assert max(errors) > LIMITS.following_m
    host.emulator.jam(False)
    host.wait(0.1)
    host.enable()
    host.wait(0.6)
    assert (host.state, host.faults) == (State.READY, Fault.NONE)


def test_the_search_for_home_takes_its_time():
    for seconds in (0.0, 1.0):
        emulator = Emulator(LIMITS, homing_s=seconds)
        host = Host()
        host.emulator = emulator
        host.say(Hello(VERSION, 9))
        host.wait(0.01)
        host.enable()
        host.wait(seconds + 0.45)
        assert host.state is State.HOMING
        host.wait(0.1)
        assert host.state is State.READY


def test_the_board_holds_what_the_device_has_not_read():
    host = Host()
    host.begin()
    for _ in range(300):
        host.say(Heartbeat(7))  # 4 kB at once, of which it holds 2
    host.wait(0.2)
    reported = [m for m in host.messages if isinstance(m, Pulse) and m.host_ns == 7]
    assert 100 < len(reported) < 200


def test_motion_of_motors_is_checked():
    times, motors = np.array([0.0, 0.1]), np.zeros((2, 3, 4))
    assert PlateMotion.of_motors(RIG, times, motors).period == 0.1
    for bad_times, bad_motors in (
        (times, np.full((2, 3, 4), np.nan)),
        (times[::-1], motors),
        (times, motors + [[[0], [0], [0]], [[1], [0], [0]]] * np.array([1, 0, 0, 0])),
    ):
        with pytest.raises(CycleError):
            PlateMotion.of_motors(RIG, bad_times, bad_motors)


def test_terminal_is_a_serial_port_that_can_be_unplugged(tmp_path):
    link = tmp_path / "port"
    terminal = PseudoTerminal(link)
    terminal.plug()
    port = serial.Serial(str(link), 921_600, timeout=1, exclusive=True)
    port.write(b"\0all\xff bytes\r\n")
    assert terminal.read() == b"\0all\xff bytes\r\n"
    terminal.write(b"and back\n")
    assert port.read(9) == b"and back\n"
    terminal.unplug()
    assert not os.path.lexists(link)
    with pytest.raises(OSError):
        port.read(1)
    port.close()
    terminal.plug()
    assert terminal.plugged
    terminal.unplug()
    link.write_text("mine")
    with pytest.raises(PlateError, match="which is a file"):
        terminal.plug()
    terminal.close()


HOLD = """
import sys
from plate_sim.device.pty import PseudoTerminal
terminal = PseudoTerminal(sys.argv[1])
terminal.plug()
print("plugged", flush=True)
sys.stdin.read()
"""


def test_a_second_device_does_not_take_the_port_of_a_running_one(tmp_path):
    """Also while the first device is disconnected. A killed device leaves a link without a
    claim."""
    link, other = tmp_path / "port", tmp_path / "folder" / ".." / "port"
    (tmp_path / "folder").mkdir()
    command = [sys.executable, "-c", HOLD, str(link)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"plugged\n"
        port = os.readlink(link)
        second = PseudoTerminal(other)
        with pytest.raises(PlateError, match="which another simulated device uses, allowed: a na"):
            second.plug()
        assert os.readlink(link) == port
        holder.kill()
    assert os.path.lexists(link)
    second.plug()
    second.unplug()
    third = PseudoTerminal(link)
    with pytest.raises(PlateError, match="another simulated device"):
        third.plug()
    second.close()
    third.plug()
    third.close()
    assert not os.path.lexists(link)
