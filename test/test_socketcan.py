"""This computer leads drives of somebody else's stack: the firmware's process, tick by tick, on a
bus in memory."""

import contextlib
import errno
import fcntl
import os
import select
import socket
import struct
import sys
import termios
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_firmware import shaking

from plate_core import PlateError, load_rig
from plate_core.driver_status import DriverReason
from plate_core.rig import Drive as RigDrive
from plate_driver.transports import Condition, TransportContext
from plate_drives.lateness import main
from plate_drives.socketcan import (
    HostPort,
    HostTransport,
    build,
    make,
    open_can,
    program_of,
)
from plate_sim.device import DeviceLimits, c_header

pytestmark = pytest.mark.needs("can", "canopen")

RIG = load_rig()
NODES, SCALE = (1, 2, 3, 4), 1e6
DRIVES = [RigDrive(node, SCALE) for node in NODES]
PLACES = (5000, -70_000, 900_000, 20)
RPDO, FRAME = 0x200, struct.Struct("=IB3x8s")


@pytest.fixture(name="program", scope="module")
def _program(tmp_path_factory):
    folder = tmp_path_factory.mktemp("host")
    header = c_header(DeviceLimits.of_rig(RIG), "rig.yaml", DRIVES)
    return build(header, "cia402", folder, "boards/linux/board.c")


class Bench:
    """Drives, bus, process and transport in the same simulated time."""

    def __init__(self, program, name):
        from can_drives import Drive, SteppedNetwork, Wire

        self.program, self.name = program, name
        self.network = SteppedNetwork(Wire(name))
        self.bus = Wire(name)
        self.drives = [Drive(self.network, node) for node in NODES]
        for drive, place in zip(self.drives, PLACES, strict=True):
            drive.position = float(place)
            drive.boot()
        self.passed, self.ticks = os.pipe()
        self.ports = []
        self.ends = []
        self.sent = []
        self.measured = []
        self.transport = HostTransport(self.port, RIG.limits, self.now, 7)

    def now(self):
        return 1e-3 * self.network.now

    def port(self):
        frames, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ends.append(frames)
        port = HostPort(self.program, self.name, lambda _: end, self.passed)
        self.ports.append(port)
        self.frames = frames
        return port

    def waiting(self):
        """Bytes of ticks that the process has not begun."""
        size = bytearray(4)
        fcntl.ioctl(self.passed, termios.FIONREAD, size)
        return any(size)

    def run(self, ms, late=0, polls=True):
        """Let time pass; the first tick comes `late` ms late."""
        for k in range(ms):
            missed = late if k == 0 else 0
            for _ in range(1 + missed):
                self.network.pass_ms()
                for drive in self.drives:
                    drive.pass_ms()
            while (message := self.bus.recv(0)) is not None:
                data = bytes(message.data)
                with contextlib.suppress(BrokenPipeError):
                    self.frames.send(FRAME.pack(message.arbitration_id, len(data), data))
            os.write(self.ticks, struct.pack("=Q", 1 + missed))
            while self.waiting():
                if self.ports[-1]._process.poll() is not None:
                    return
                time.sleep(2e-5)
            while select.select([self.frames], [], [], 0)[0] and (frame := self.frames.recv(16)):
                identifier, size, data = FRAME.unpack(frame)
                self.sent.append((self.network.now, identifier, data[:size]))
                self.network.notify(identifier, bytearray(data[:size]), self.now())
            if polls and k % 2 == 0:
                self.measured += self.transport.poll()

    def ready(self):
        self.transport.open()
        self.run(200)
        order = self.transport.enable()
        self.run(700)
        assert order.done
        assert self.transport.report().condition is Condition.READY

    def targets(self, node):
        """Times [ms] and commanded travels [m] of a drive in operation."""
        rows = [
            (at, *struct.unpack("<Hi", data))
            for at, identifier, data in self.sent if identifier == RPDO + node
        ]  # fmt: skip
        rows = np.array([(at, place) for at, word, place in rows if word == 15])
        return rows[:, 0], (rows[:, 1] - PLACES[node - 1]) / SCALE

    def off(self):
        return all(drive.state == "switch on disabled" for drive in self.drives)

    def close(self):
        self.transport.close()
        os.close(self.ticks)  # there are no more
        for port in self.ports:
            port._process.wait(10)
        self.network.bus.shutdown()
        self.bus.shutdown()
        os.close(self.passed)
        for end in self.ends:
            end.close()


@pytest.fixture(name="bench")
def _bench(program, request):
    bench = Bench(program, request.node.name)
    yield bench
    bench.close()


def test_a_table_is_played_on_the_drives(bench):
    bench.ready()
    table = shaking(0.004)
    bench.transport.send(table, 3)
    bench.run(500)
    playing = [m for m in bench.measured if m.playing is table]
    assert len(playing) > 20
    for node in NODES:
        at, travel = bench.targets(node)
        assert np.max(np.abs(np.diff(travel))) <= RIG.limits.speed * 2e-3
        assert set(np.diff(at)) <= {1, 2, 3}  # a tick's frames are seen in it, or in the next one
        assert abs(np.mean(np.diff(at)) - 2) < 0.01
        expected = np.max(np.abs(table.q[:, node - 1]))
        assert abs(np.max(np.abs(travel)) - expected) < 0.02 * expected
        assert travel[-1] == 0  # it was played three times, and rests
    assert bench.transport.report().condition is Condition.READY
    order = bench.transport.stop(cut=True)
    bench.run(10)
    assert order.done
    assert bench.off()


def test_a_drives_own_messages_are_reported(bench):
    bench.ready()
    bench.drives[1].fail(0x8611, 0x20)
    bench.run(30)
    report = bench.transport.report()
    assert (report.condition, report.reason) == (Condition.OFF, DriverReason.FOLLOWING)
    assert (
        report.text == "following: motor_2: emergency 8611h, error register 20h (following error)"
    )


def test_late_setpoints_brake_the_plate_and_prevent_an_enable(bench):
    """3 mm at 1 m/s: 3 ms."""
    bench.ready()
    bench.transport.send(shaking(0.004), 20)
    bench.run(120)
    bench.run(40, late=2)
    assert bench.transport.report().condition is Condition.READY
    bench.run(1000, late=5)
    report = bench.transport.report()
    assert (report.condition, report.reason) == (Condition.OFF, DriverReason.OTHER)
    assert report.text.startswith("setpoints were 5.0 ms late, allowed: 3.0 ms (following_error")
    assert bench.off()
    for node in NODES:
        at, travel = bench.targets(node)
        passed_ms = np.maximum(np.diff(at), 2)
        assert np.max(np.abs(np.diff(travel)) / passed_ms) <= 1e-3 * RIG.limits.speed
    order = bench.transport.enable()
    assert order.failure == report.text
    bench.transport._late_ms = 0.0  # as after some time
    bench.transport.values()
    order = bench.transport.enable()
    bench.run(700)
    assert order.done


def test_the_timeout_of_a_silent_host_is_detected(bench):
    bench.ready()
    bench.transport.send(shaking(0.004), 20)
    bench.run(120)
    bench.run(1200, polls=False)
    assert bench.off()
    assert abs(bench.targets(1)[1][-1]) < 1e-5  # braked along its path, and home


def test_an_enable_that_came_while_the_process_stood_still_is_not_carried_out(bench):
    bench.transport.open()
    bench.run(400)
    assert not bench.transport.enable().failure
    bench.run(200, late=1000, polls=False)
    assert [drive.enables for drive in bench.drives] == [0] * 4


def test_a_process_leads_a_bus_alone_and_ends_with_the_drives_off(bench):
    bench.ready()
    bench.transport.send(shaking(0.004), 20)
    bench.run(120)
    bench.transport.close()
    with pytest.raises(PlateError, match=f"{bench.name} is still in use by another driver process"):
        bench.port()
    bench.run(1500, polls=False)
    assert bench.off()
    assert bench.ports[0]._process.wait(10) == 0
    bench.port().close()


def context(rig, port="can0"):
    return TransportContext(rig, lambda _: None, lambda: 0.0, {"port": port})


def test_rigs_that_socketcan_cannot_drive_are_refused():
    rig = load_rig("linear_motors")
    free = replace(rig, camera=replace(rig.camera, trigger=None))
    unwatched = replace(free, limits=replace(free.limits, following_error_m=0))
    for wrong, port, text in (
        (free, "", "port is '', but socketcan requires a CAN interface, such as can0"),
        (rig, "can0", "trigger_phase is given, but socketcan requires a free-running"),
        (unwatched, "can0", "following_error_m is 0, but socketcan requires a value above 0"),
        (RIG, "can0", "drive is bridge, but socketcan requires cia402 or odrive"),
    ):
        with pytest.raises(PlateError, match=text):
            make(context(wrong, port))


def test_a_missing_compiler_is_reported(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(PlateError, match="the firmware cannot be compiled: cc: No such file"):
        build("", "odrive", tmp_path / "out", "boards/linux/board.c")
    (tmp_path / "cc").write_text("#!/bin/sh\necho broken >&2; exit 1\n")
    (tmp_path / "cc").chmod(0o755)
    with pytest.raises(PlateError, match="the firmware cannot be compiled: broken"):
        build("", "odrive", tmp_path / "out", "boards/linux/board.c")


def test_an_interface_that_is_pulled_out_ends_the_process_and_is_waited_for(bench):
    bench.ready()
    bench.frames.close()
    os.write(bench.ticks, struct.pack("=Q", 1))
    assert bench.ports[0]._process.wait(10) == 1
    for _ in range(2):  # its earlier output, and its end
        bench.transport.poll()
    report = bench.transport.report()
    assert (report.condition, report.reason) == (Condition.GONE, DriverReason.PORT)
    for _ in range(1000):
        bench.network.pass_ms()
        for drive in bench.drives:
            drive.pass_ms()
        while bench.bus.recv(0):
            pass
    assert "enabled" not in {drive.state for drive in bench.drives}  # they miss us
    bench.transport.poll()  # it is there again
    bench.run(300)
    report = bench.transport.report()
    assert (report.condition, report.reason) == (Condition.OFF, DriverReason.DEVICE_RESET)


def test_a_drive_that_keeps_its_current_is_reset_before_the_process_ends(bench):
    bench.ready()
    bench.drives[1].keeps = True
    bench.transport.close()
    bench.run(1500, polls=False)
    assert bench.ports[0]._process.wait(10) == 0
    assert bench.off()
    assert (0, bytes([0x81, 2])) in [(identifier, data) for _, identifier, data in bench.sent]


def test_an_interface_that_is_down_is_reported(monkeypatch):
    class Down:
        """As a raw socket that is bound to it."""

        def __init__(self, *_):
            pass

        def bind(self, _):
            pass

        def getsockopt(self, *_):
            return errno.ENETDOWN

    monkeypatch.setattr(socket, "socket", Down)
    with pytest.raises(PlateError, match=r"can0 does not open .*Network is down"):
        open_can("can0")


def test_a_program_without_permission_is_reported(program, tmp_path):
    copy = tmp_path / "plate"
    copy.write_bytes(program.read_bytes())
    near, far = socket.socketpair()
    with near, pytest.raises(PlateError, match=r"does not start \(Permission denied\)"):
        HostPort(copy, "nowhere", lambda _: far)


def test_missing_space_for_the_program_is_reported(monkeypatch, tmp_path):
    rig = load_rig("odrives")
    rig = replace(rig, limits=replace(rig.limits, speed=0.123))  # one that was not built yet
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    with pytest.raises(PlateError, match=r"cannot be compiled: .*No such file"):
        program_of(rig)


def test_a_bus_that_is_not_there_is_waited_for(program):
    transport = HostTransport(lambda: HostPort(program, "can77"), RIG.limits, lambda: 0.0, 7)
    transport.open()
    report = transport.report()
    assert (report.condition, report.reason) == (Condition.GONE, DriverReason.PORT)
    assert report.text.startswith("CAN interface can77 does not open (")
    assert report.text.endswith(": waiting for it")


CYCLE_S = 2e-3


def late_error(late_s):
    """How far a drive's own setpoint is from where it would be without lateness, RMS and most [m].

    The motion is a sinusoid at speed and acceleration of the limits; each SYNC comes by up to
    `late_s` late, evenly spread. From there the drive goes on to its new target in a straight line
    over a cycle, and stands until the next SYNC."""
    rate = RIG.limits.accel / RIG.limits.speed
    due = CYCLE_S * np.arange(5000)
    came = np.maximum.accumulate(due + np.random.default_rng(0).uniform(0, late_s, len(due)))
    target = RIG.limits.speed / rate * np.sin(rate * (due + CYCLE_S))
    times = np.arange(0.1, due[-1] - 0.1, CYCLE_S / 20)

    def commanded(sync):
        place = np.zeros(len(sync) + 1)  # where it is when each SYNC comes
        for k, step in enumerate(np.diff(sync, append=sync[-1] + CYCLE_S)):
            place[k + 1] = place[k] + (target[k] - place[k]) * min(step / CYCLE_S, 1)
        last = np.searchsorted(sync, times, side="right") - 1
        return place[last] + (target - place[:-1])[last] * np.minimum(
            (times - sync[last]) / CYCLE_S, 1
        )

    error = commanded(came) - commanded(due)
    return np.sqrt(np.mean(error**2)), np.max(np.abs(error))


def test_a_late_setpoint_causes_an_error_of_speed_times_delay():
    """By which the transport judges how late setpoints may be."""
    assert late_error(0.0) == (0.0, 0.0)
    for late_s in (1e-4, 1e-3, 5e-3):
        rms, max_error = late_error(late_s)
        assert 0.95 < max_error / (RIG.limits.speed * late_s) < 1.001
        # The mean square of a delay that is even from 0 to `late_s` is a third of its square.
        assert rms == pytest.approx(RIG.limits.speed / np.sqrt(2) * late_s / np.sqrt(3), rel=0.12)


def test_a_process_without_output_is_no_measurement(monkeypatch, capsys):
    monkeypatch.setattr("plate_drives.lateness.program_of", lambda _: "/bin/false")
    monkeypatch.setattr(sys, "argv", ["lateness", "linear_motors", "--seconds", "0.3"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert "the process that controls the drives has ended" in capsys.readouterr().err


def test_a_process_that_has_ended_is_no_broken_pipe():
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with near, far:
        port = HostPort(Path("/bin/false"), "ended", lambda _: far.dup())
        os.waitid(os.P_PID, port._process.pid, os.WEXITED | os.WNOWAIT)
        with pytest.raises(OSError, match="the process that controls the drives has ended"):
            port.write(b"a")
        port.close()


def test_the_delay_of_setpoints_is_reported(program, monkeypatch, capsys):
    monkeypatch.setattr("plate_drives.lateness.program_of", lambda _: program)
    monkeypatch.setattr(sys, "argv", ["lateness", "linear_motors", "--seconds", "0.2"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code in (0, 1)
    output = capsys.readouterr().out
    assert output.startswith("maximum delay of setpoints in each 10 ms: median ")
    assert "; allowed: 3.00 ms\n" in output
