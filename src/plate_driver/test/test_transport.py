"""Transports: where tables go, and which exist."""

import pytest

from plate_core import PlateError, load_rig
from plate_driver.motor_table import MotorTable
from plate_driver.transport import SimTransport, Transport, check_transport


def test_sim_publishes():
    sent: list[MotorTable] = []
    transport: Transport = SimTransport(sent.append)
    table = MotorTable.rest(load_rig(), 0.05, 1)
    transport.open()
    transport.send(table)
    transport.close()
    assert sent == [table]


def test_what_exists_is_allowed():
    check_transport("sim", "")
    check_transport("serial", "/dev/ttyUSB0")


@pytest.mark.parametrize("name", ["can", ""])
def test_others_are_not(name):
    with pytest.raises(PlateError) as caught:
        check_transport(name, "")
    assert str(caught.value) == f"transport is {name!r}, allowed: sim, serial"


def test_serial_needs_a_port():
    with pytest.raises(PlateError, match="port is '', allowed with transport serial: the name"):
        check_transport("serial", "")
