"""Simulated drives behind the firmware: their motion, and the check of the setpoints on the bus."""

import re
import shutil
import struct

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plate_core import PlateError, load_rig
from plate_core.rig import Drive, Limits
from plate_sim.device import (
    FirmwareOnDesk,
    SetpointCheck,
    SimulatedDrives,
    SimulatedODrives,
    c_header,
)
from plate_sim.device.drives import BANDWIDTH, CYCLE_S, OFF, RPDO, SYNC
from plate_sim.device.limits import DeviceLimits

DRIVES = [Drive(node, 1e6, -1 if node == 2 else 1) for node in (1, 2, 3, 4)]
LIMITS = Limits(0.01, 1.0, 100.0)


def frames(drives, position, word=15):
    """Frames of a master in one cycle: all motors to a position [m]."""
    reported = [
        (RPDO + d.node, struct.pack("<Hi", word, round(d.sign * d.counts_per_m * position) + zero))
        for d, zero in zip(DRIVES, drives.zeros.tolist(), strict=True)
    ]
    return [*reported, (SYNC, b"")]


def enabled():
    drives = SimulatedDrives(DRIVES)
    drives.receive([(0, b"\x82\0"), (0, b"\1\0")])
    for word in (6, 7, 15):
        drives.receive(frames(drives, 0.0, word))
    assert drives.enabled.all()
    return drives


def test_a_drive_follows_the_equation_of_motion():
    drives, places = enabled(), np.cumsum([0, 1e-4, 3e-4, 2e-4, 0, 0, 0, 0])

    def change(t, y):
        k = min(int(t / CYCLE_S), len(places) - 2)
        slope = (places[k + 1] - places[k]) / CYCLE_S
        goal = places[k] + slope * (t - k * CYCLE_S)
        return [y[1], BANDWIDTH**2 * (goal - y[0]) + 2 * BANDWIDTH * (slope - y[1])]

    end = CYCLE_S * (len(places) - 1)
    truth = solve_ivp(change, (0, end), [0, 0], max_step=1e-5, t_eval=np.arange(1, 15) * 1e-3)
    seen = []
    for position in places[1:]:
        drives.receive(frames(drives, position))
        for _ in range(2):
            drives.passed()
            seen.append(drives.motors[:2].copy())
    np.testing.assert_allclose(np.array(seen)[:, :, 1], truth.y.T, atol=2e-6 * BANDWIDTH)
    np.testing.assert_allclose(np.array(seen)[:, 0, 0], truth.y[0], atol=1e-7)


ODRIVES = [Drive(n, 25 * 2.0**20, -1 if n == 2 else 1, kind="odrive") for n in (1, 2, 3, 4)]


def odrive_frames(drives, position, speed=0.0):
    """Frames of a master in one cycle: all motors to a position [m], with their speed [m/s]."""
    return [
        (d.node << 5 | 0x0C, struct.pack("<fhh", turns, round(25e3 * d.sign * speed), 0))
        for d, zero in zip(ODRIVES, drives.zeros.tolist(), strict=True)
        for turns in [25 * d.sign * position + zero / 2**20]
    ]


def test_an_odrive_follows_the_equation_of_motion():
    drives, places, ff = (
        SimulatedODrives(ODRIVES),
        [1e-4, 3e-4, 2e-4, 0, 0],
        [0.1, 0.05, -0.1, 0, 0],
    )
    drives.receive([(d.node << 5 | 7, bytes([8, *[0] * 7])) for d in ODRIVES])
    assert drives.enabled.all()

    def change(t, y, goal, speed):
        return [y[1], BANDWIDTH**2 * (goal - y[0]) + 2 * BANDWIDTH * (speed - y[1])]

    truth = [0.0, 0.0]
    for goal, speed in zip(places, ff, strict=True):
        drives.receive(odrive_frames(drives, goal, speed))
        for _ in range(2):
            drives.passed()
            truth = solve_ivp(change, (0, 1e-3), truth, max_step=1e-5, args=(goal, speed)).y[:, -1]
            np.testing.assert_allclose(drives.motors[0], truth[0], atol=2e-7)
            np.testing.assert_allclose(drives.motors[1], truth[1], atol=2e-7 * BANDWIDTH)


def test_an_odrive_without_messages_disarms():
    drives = SimulatedODrives(ODRIVES)
    drives.receive([(d.node << 5 | 7, bytes([8, *[0] * 7])) for d in ODRIVES])
    beats = [frame for _ in range(121) for frame in drives.passed()]
    assert not drives.enabled.any()
    assert beats[-1][1] == struct.pack("<IBBBB", 1 << 24, 1, 0, 0, 0)


def test_the_check_sees_setpoints_of_odrives_beyond_limits():
    drives = SimulatedODrives(ODRIVES)
    check = SetpointCheck(ODRIVES, drives.zeros, LIMITS)
    for position in (0.0, 0.0021, 0.0042):
        check.receive(odrive_frames(drives, position), True)
    assert check.fractions[1] == pytest.approx(1.05, rel=1e-3)


def test_only_the_states_in_order_give_current():
    drives = SimulatedDrives(DRIVES)
    drives.receive(frames(drives, 0.0))
    assert not drives.enabled.any()  # not operational
    drives.receive([(0, b"\1\0"), *frames(drives, 0.0)])
    assert not drives.enabled.any()
    drives = enabled()
    drives.receive(frames(drives, 0.0, 0))
    answers = drives.receive([(SYNC, b"")])
    assert [struct.unpack("<Hi", data)[0] for _, data in answers] == [OFF] * 4


@pytest.mark.parametrize(
    ("places", "share", "value"),
    [
        ([0, 0.0101], 0, 1.01),
        ([0, 0.0021, 0.0042], 1, 1.05),
        ([0, 0.0, 0.00044], 2, 1.1),
    ],
)
def test_the_check_measures_setpoints_beyond_the_limits(places, share, value):
    drives = enabled()
    check = SetpointCheck(DRIVES, drives.zeros, LIMITS)
    for position in places:
        check.receive(frames(drives, position), True)
    assert check.fractions[share] == pytest.approx(value, rel=1e-3)
    before = check.fractions.copy()
    check.receive(frames(drives, 1.0), False)  # without current nothing counts
    assert (check.fractions == before).all()


def test_a_header_has_the_drives():
    drives = [Drive(7, 2e5, -1), Drive(8, 3e5, absolute=True, serial=2**32 - 1), *DRIVES[2:]]
    text = c_header(DeviceLimits.of_rig(load_rig()), "rig.yaml", drives)
    assert "static const Drive DRIVES[MOTORS] = {\n    {7, 200000.0f, -1, false, 0u, " in text
    assert "    {8, 300000.0f, 1, true, 4294967295u, " in text
    weights = [float(value) for value in re.findall(r"u, (\S+)f\},", text)]
    for x, y, turn in np.eye(3):  # of the plate
        travel = [
            m.direction[0] * (x - turn * m.point[1]) + m.direction[1] * (y + turn * m.point[0])
            for m in load_rig().motors
        ]
        assert np.dot(weights, travel) == pytest.approx(0, abs=1e-6)
    assert max(map(abs, weights)) == 1
    assert "DRIVES" not in c_header(DeviceLimits.of_rig(load_rig()), "rig.yaml")


def test_a_rig_without_drives_and_a_missing_program_are_reported():
    with pytest.raises(PlateError, match="motors have no drives, allowed: `drive: cia402`"):
        FirmwareOnDesk("/bin/true", load_rig())
    with pytest.raises(PlateError, match="firmware is '/no/such': "):
        FirmwareOnDesk("/no/such", load_rig("linear_motors"))
    ended = FirmwareOnDesk(shutil.which("true"), load_rig("linear_motors"))
    ended._process.wait(10)
    with pytest.raises(PlateError, match="the firmware has ended"):
        ended.tick()
    ended.close()
