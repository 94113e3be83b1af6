"""The real port: pyserial on a pseudo-terminal. The protocol over it: test/test_serial_path.py."""

import os
import socket
import tty
from pathlib import Path

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.driver_status import DriverReason
from plate_core.serial_protocol import Hello, Reader, parse
from plate_driver.setpoints.motor_table import MotorTable
from plate_driver.transports import Condition, Report
from plate_driver.transports.serial import SerialTransport, knots, open_port

RIG = load_rig()


@pytest.fixture(name="terminal")
def _terminal():
    master, slave = os.openpty()
    tty.setraw(slave)
    ends = [master, slave]
    yield ends
    for end in ends:
        os.close(end)


def test_bytes_pass_in_both_directions_without_blocking(terminal):
    master, slave = terminal
    port = open_port(os.ttyname(slave))
    everything = bytes(range(256))
    assert port.read(100) == b""
    os.write(master, everything)
    assert port.read(1000) == everything
    assert port.write(everything) == 256
    assert os.read(master, 1000) == everything
    port.close()


def test_missing_port_is_reported():
    with pytest.raises(PlateError, match=r"serial port /dev/nowhere is not there$"):
        open_port("/dev/nowhere")
    with pytest.raises(PlateError, match=r"/dev/null is a device, but no serial port, allowed: "):
        open_port("/dev/null")


@pytest.mark.parametrize("kind", ["a file", "a folder", "a FIFO", "a socket"])
def test_something_else_than_a_port_is_named(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)  # a socket's path must be short
    path = Path("port")
    if kind == "a file":
        path.touch()
    elif kind == "a folder":
        path.mkdir()
    elif kind == "a FIFO":
        os.mkfifo(path)
    else:
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(path))
    Path("link").symlink_to(path)
    for name in ("port", "link"):
        with pytest.raises(PlateError, match=f"^serial port {name} is {kind}, allowed: the device"):
            open_port(name)


def test_a_port_is_for_one_program(terminal):
    _, slave = terminal
    port = open_port(os.ttyname(slave))
    with pytest.raises(PlateError, match="is used by another program"):
        open_port(os.ttyname(slave))
    port.close()
    open_port(os.ttyname(slave)).close()


def test_other_end_that_vanishes_is_a_trouble_not_a_crash(terminal):
    master, slave = terminal
    name = os.ttyname(slave)
    transport = SerialTransport(lambda: open_port(name), lambda: 0.0, 1)
    transport.open()
    assert transport.poll() == []
    _, [hello] = Reader().fed(os.read(master, 1000))
    assert isinstance(parse(hello).message, Hello)
    os.close(master)
    os.close(slave)
    terminal.clear()
    transport.poll()
    reported = transport.troubles()
    assert len(reported) == 1
    assert reported[0].startswith("serial port: ")
    transport.poll()
    transport.close()


def test_a_port_that_is_not_there_is_waited_for(terminal, tmp_path):
    """As a lost port: it is reported once, and Hello is sent when the port appears."""
    master, slave = terminal
    link, clock = tmp_path / "port", [0.0]
    transport = SerialTransport(lambda: open_port(str(link)), lambda: clock[0], 1)
    transport.open()
    text = f"serial port {link} is not there: waiting for it"
    reported = []
    for clock[0] in np.arange(0.0, 5.0, 0.05):
        transport.poll()
        reported += transport.troubles()
    assert reported == [text]
    assert transport.report() == Report(Condition.GONE, DriverReason.PORT, text)
    assert transport.enable().failure == text + "; call again"
    link.symlink_to(os.ttyname(slave))
    clock[0] += 0.8
    for _ in range(2):
        transport.poll()
    _, [hello] = Reader().fed(os.read(master, 1000))
    assert isinstance(parse(hello).message, Hello)
    transport.close()


def test_a_device_that_starts_later_is_waited_for(terminal):
    """As a board whose boot loader runs for two seconds. The refused enable is never sent later."""
    master, slave = terminal
    clock = [0.0]
    transport = SerialTransport(lambda: open_port(os.ttyname(slave)), lambda: clock[0], 1)
    transport.open()
    text = "the device has not reported its state yet: waiting for it"
    for clock[0] in np.arange(0.0, 2.0, 0.1):
        transport.poll()
        assert transport.report() == Report(Condition.GONE, DriverReason.NO_ANSWER, text)
        assert transport.enable().failure == text + "; call again"
    _, packets = Reader().fed(os.read(master, 4000))
    assert {type(parse(packet).message) for packet in packets} == {Hello}
    transport.close()


def test_knots_are_the_table():
    pose = 1e-3 * np.random.default_rng(0).normal(size=(8, 3))
    table = MotorTable.of(RIG, PlateCycle.from_samples(0.1, pose), 1)
    made = knots(table)
    np.testing.assert_allclose([k.ticks * 1e-8 for k in made], table.cycle.times, atol=5e-9)
    for name, values in (
        ("position", table.q),
        ("velocity", table.qd),
        ("acceleration", table.qdd),
    ):
        got = np.array([getattr(k, name) for k in made])
        np.testing.assert_allclose(got, values, rtol=1e-7)
        assert np.array_equal(got, got.astype(np.float32))


def test_a_full_line_loses_bytes_and_does_not_block(terminal):
    _, slave = terminal
    port = open_port(os.ttyname(slave))
    chunk = bytes(1000)
    written = [port.write(chunk) for _ in range(200)]
    assert written[0] == len(chunk)
    assert 0 in written  # the kernel can make some room later
    port.close()
