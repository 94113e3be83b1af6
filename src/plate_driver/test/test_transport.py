"""Transports: where tables go, which exist, and one from outside."""

import sys

import pytest

from plate_core import PlateError, load_rig
from plate_driver.setpoints.motor_table import MotorTable
from plate_driver.transports import (
    Condition,
    SimTransport,
    Transport,
    TransportContext,
    check_transport,
    make_transport,
)  # fmt: skip
from plate_driver.transports.thread import Latch, TransportThread
from plate_driver.transports.transport import installed

RIG = load_rig()
TABLE = MotorTable.rest(RIG, 0.05, 1)
FOREIGN = """
from plate_core import PlateError
from plate_driver.transports import Condition, Order, Report


class Drives:
    motors, calibrates, max_knots, hold_s = True, False, 100, 2.0

    def __init__(self, context):
        self.context, self.condition, self.log = context, Condition.OFF, []

    def open(self):
        self.log.append("open")

    def poll(self):
        return []

    def report(self):
        return Report(self.condition, values={"bus": "up"})

    def send(self, table, repeats):
        self.log.append(repeats)

    def stop(self, cut=False):
        self.condition = Condition.OFF
        self.log.append("cut" if cut else "stop")
        return Order().complete()

    def enable(self):
        self.condition = Condition.READY
        return Order().complete()

    def home(self):
        return Order().complete("no home here")

    def troubles(self):
        return []

    def values(self):
        return {}

    def close(self):
        self.log.append("close")


def make(context):
    if not context.parameters["port"]:
        raise PlateError("port is '', but transport drives requires a bus")
    return Drives(context)
"""


def context(sent=None, **parameters) -> TransportContext:
    values = {"port": "", "baud": 921_600, "longest_upload_s": 0.5, "streams": False}
    return TransportContext(RIG, (sent if sent is not None else []).append, lambda: 0.0,
                            values | parameters)  # fmt: skip


def test_sim_publishes_and_rests_when_stopped():
    sent: list[MotorTable] = []
    transport: Transport = make_transport("sim", context(sent))
    assert isinstance(transport, SimTransport)
    transport.open()
    assert transport.report().condition is Condition.READY
    moving = MotorTable(7, TABLE.cycle, TABLE.q + 1e-3, TABLE.qd, TABLE.qdd)
    transport.send(moving, 5)
    assert transport.stop().done
    assert transport.report().condition is Condition.OFF
    assert sent[0] is moving
    assert not sent[1].q.any()
    assert (sent[1].stamp_ns, sent[1].cycle.period) == (7, 0.05)
    assert transport.stop(cut=True).done
    assert len(sent) == 2
    assert transport.enable().done
    assert transport.report().condition is Condition.READY


def test_installed_transports_are_allowed():
    assert {"sim", "serial"} <= set(installed())
    check_transport("sim", "")
    check_transport("serial", "/dev/ttyUSB0")


@pytest.mark.parametrize("name", ["can", ""])
def test_other_transports_are_refused(name):
    with pytest.raises(PlateError) as caught:
        check_transport(name, "")
    assert str(caught.value).startswith(f"transport is {name!r}, allowed: serial, sim")
    with pytest.raises(PlateError, match="allowed: serial, sim"):
        make_transport(name, context())


def test_serial_needs_a_port():
    with pytest.raises(PlateError, match="port is '', but transport serial requires the name"):
        check_transport("serial", "")


def test_a_line_too_slow_is_refused_with_the_numbers():
    with pytest.raises(PlateError) as caught:
        make_transport("serial", context(port="/dev/plate", baud=38_400))
    assert str(caught.value) == (
        "baud is 38400, so the upload of a cycle with 64 pieces takes 1.35 s, "
        "allowed: at most 0.5 s (longest_upload_s)"
    )
    make_transport("serial", context(port="/dev/plate", baud=115_200))
    make_transport("serial", context(port="/dev/plate", baud=38_400, longest_upload_s=1.4))


@pytest.fixture(name="outside")
def _outside(tmp_path, monkeypatch):
    """A package that somebody else has installed."""
    (tmp_path / "foreign_drives.py").write_text(FOREIGN, encoding="utf-8")
    info = tmp_path / "foreign_drives-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: foreign-drives\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(
        "[plate_driver.transports]\n"
        "drives = foreign_drives:make\nbroken = foreign_drives:nothing\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    installed.cache_clear()
    yield
    installed.cache_clear()
    sys.modules.pop("foreign_drives", None)


def test_a_transport_from_outside_is_found_and_driven(outside):
    check_transport("drives", "")
    with pytest.raises(PlateError, match="allowed: broken, drives, serial, sim"):
        check_transport("can", "")
    with pytest.raises(PlateError, match="but transport drives requires a bus"):
        make_transport("drives", context())
    with pytest.raises(
        PlateError, match=r"entry point foreign_drives:nothing cannot be loaded: module"
    ):
        make_transport("broken", context())
    transport = make_transport("drives", context(port="bus0"))
    latch = Latch()
    transport.open()
    thread = TransportThread(transport, latch, lambda error: pytest.fail(repr(error)))
    thread.poll()
    assert thread.report.condition is Condition.OFF
    assert thread.enable(latch.number).done
    thread.send(TABLE, 3, latch.number)
    assert thread.stop(cut=True).done
    assert thread.home().failure == "no home here"
    thread.close()
    assert transport.log == ["open", 3, "cut", "stop", "close"]
