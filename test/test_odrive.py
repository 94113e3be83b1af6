"""The firmware leads ODrives: every frame is judged by the DBC of CANSimple that somebody else
publishes, and by what is on the bus."""

import struct

import numpy as np
import pytest
from device_orders import (
    boot,
    enable,
    live,
    playing,
    ready,
    said_by,
    say,
    spline,
    tell,
    uploaded,
)
from rigid_plate import Plate
from simulated_firmware import compiled_leader

from plate_core import load_rig
from plate_core.rig import Drive as RigDrive
from plate_core.serial_protocol import (
    VERSION,
    DriveTrouble,
    Enable,
    Fault,
    Hello,
    Home,
    State,
    Stop,
    Telemetry,
    Trouble,
)
from plate_sim.device import DeviceLimits

pytestmark = pytest.mark.needs("can", "canopen", "cantools", "odrive_can")

RIG = load_rig()
LIMITS = DeviceLimits.of_rig(RIG)
NODES, SIGNS, TURNS = (1, 2, 3, 62), (1, -1, 1, 1), 25.0
DRIVES = [
    RigDrive(node, TURNS * 2**20, sign, absolute=node == 62, kind="odrive")
    for node, sign in zip(NODES, SIGNS, strict=True)
]
HOMES = (0.5, -7.25, 90.0, 0.0)
"""Where the drives stand at home [turns]."""

PLATE = Plate(RIG, HOMES, TURNS * np.array(SIGNS))

FINE = 1e-5
"""Error of a position [turns]: the resolution of single precision at 90 turns."""


@pytest.fixture(name="leader", scope="module")
def _leader(tmp_path_factory):
    return compiled_leader(tmp_path_factory.mktemp("leader"), DRIVES, "odrive")


@pytest.fixture(name="dbc", scope="module")
def _dbc():
    from can_odrives import messages

    return messages()


@pytest.fixture(name="bench")
def _bench(leader, dbc, request):
    """The firmware, and four drives that are off."""
    from can_drives import CanBench
    from can_odrives import Bus, ODrive

    bench = CanBench(leader, request.node.name, Bus(request.node.name), home_ms=900)
    bench.drives = [ODrive(bench.network, node, dbc) for node in NODES]
    for drive, home in zip(bench.drives, HOMES, strict=True):
        drive.position = home
    yield bench
    bench.end()


def commanded(bench, since=0):
    """Set_Input_Pos: rows of time [ms], motor, place [m], speed [m/s] and torque [Nm], and the
    state that the drive was told last."""
    rows, state = [], dict.fromkeys(NODES, 0)
    for at, identifier, data in bench.sent:
        if identifier & 0x81F == 0x07:
            state[identifier >> 5] = data[0]
        if at >= since and identifier & 0x81F == 0x0C:
            motor = NODES.index(identifier >> 5)
            turns, speed, torque = struct.unpack("<fhh", data)
            scale = TURNS * SIGNS[motor]
            place = (turns - HOMES[motor]) / scale
            rows.append((at, motor, place, 1e-3 * speed / scale, 1e-3 * torque))
            rows[-1] += (state[identifier >> 5],)
    return np.array(rows).reshape(-1, 6)


def states(bench, since=0):
    """Set_Axis_State: time [ms], motor and state."""
    return [
        (at, NODES.index(identifier >> 5), data[0])
        for at, identifier, data in bench.sent
        if at >= since and identifier & 0x81F == 0x07
    ]


def check_bus(bench):
    """No target leaves the limits, or jumps, while there is current."""
    rows = commanded(bench)
    for motor in range(4):
        at, _, place, *_ = rows[(rows[:, 1] == motor) & (rows[:, 5] == 8)].T
        steps = np.diff(place)[np.diff(at) <= 2]
        assert np.max(np.abs(place), initial=0) <= RIG.limits.stroke_m * 1.002 + FINE
        assert np.max(np.abs(steps), initial=0) <= RIG.limits.speed * 2.004e-3 + FINE


# Enable, play


def test_no_drive_has_current_before_an_enable(bench):
    boot(bench)
    live(bench, 300)
    assert [drive.history for drive in bench.drives] == [[]] * 4
    assert {state for *_, state in states(bench)} <= {1}
    reported = said_by(bench, Telemetry)
    assert {t.faults for t in reported} == {Fault.NO_HOME}
    assert {t.stop for t in reported} == {bench.stop}


def test_current_comes_without_a_jump_once_the_watchdogs_have_bitten(bench):
    boot(bench)
    enable(bench, ms=900)
    assert bench.state == State.READY
    went = "CLOSED_LOOP_CONTROL"
    assert [drive.history for drive in bench.drives] == [[went, went]] * 4
    assert [drive.reason for drive in bench.drives] == [0x1000000] * 4
    rows = commanded(bench)
    assert np.max(np.abs(rows[:, 2])) < FINE  # where they hang
    assert not rows[:, 3:5].any()
    tell(bench, say(300, Stop(1)))
    live(bench, 100)
    enable(bench, 400, ms=900)
    assert [drive.enables for drive in bench.drives] == [3] * 4  # it is tried once


def test_a_drive_without_a_watchdog_is_named_and_none_is_led(bench):
    bench.drives[2].watchdog_ms = np.inf
    boot(bench)
    enable(bench, ms=900)
    assert bench.state == State.OFF
    trouble = said_by(bench, DriveTrouble)[-1]
    assert trouble == DriveTrouble(3, Trouble.NO_WATCHDOG, 0, 0)
    assert "enable_watchdog" in trouble.text
    assert all(drive.state == 1 for drive in bench.drives)
    assert np.max(np.abs(commanded(bench)[:, 2])) < FINE


def test_the_drives_receive_the_table_with_its_speed_and_torque(bench):
    playing(bench, PLATE)
    live(bench, 500)
    check_bus(bench)
    rows, curve = commanded(bench), spline(PLATE.wave(0.004))
    speed, accel = curve.derivative(), curve.derivative(2)
    began = np.min(rows[np.abs(rows[:, 2]) > FINE, 0])
    late = rows[(rows[:, 0] > began + 10) & (rows[:, 0] < began + 400)]

    def miss(shift):
        at = 1e-3 * (late[:, 0] - began + shift) % 0.1
        return np.max(np.abs(curve(at)[np.arange(len(at)), late[:, 1].astype(int)] - late[:, 2]))

    at = 1e-3 * (late[:, 0] - began + min(range(20), key=miss)) % 0.1
    own = np.arange(len(at)), late[:, 1].astype(int)
    assert miss(min(range(20), key=miss)) < FINE / TURNS + 1e-6
    assert np.max(np.abs(speed(at)[own] - late[:, 3])) < 1e-3 / TURNS
    force = (accel(at) @ LIMITS.load.T)[own]
    torque = force * np.array(SIGNS)[own[1]] / (2 * np.pi * TURNS)  # work of a turn
    assert np.max(np.abs(torque)) > 0.05
    assert np.max(np.abs(torque - late[:, 4])) < 2e-3
    errors = [t.following_m for t in said_by(bench, Telemetry)]
    assert 1e-5 < max(errors) < 1e-3


def test_a_power_cut_reaches_the_bus_in_the_same_tick(bench):
    playing(bench, PLATE)
    tell(bench, say(300, Stop(1)))
    before = bench.network.now
    bench.run(1)
    now = [(i, d[0]) for at, i, d in bench.sent if at > before]
    assert now == [(node << 5 | 0x07, 1) for node in NODES]
    bench.run(2)
    assert all(drive.state == 1 for drive in bench.drives)


def test_a_silent_board_is_stopped_by_the_drives_themselves(bench):
    playing(bench, PLATE)
    bench.cut = True
    bench.run(110)
    assert all(drive.state == 1 and drive.reason == 0x1000000 for drive in bench.drives)


def test_a_single_wrong_position_does_not_become_target_or_home(bench):
    boot(bench)
    bench.drives[0].wrong_once = 1.25  # turns: 50 mm
    enable(bench, ms=1500)
    assert bench.drives[0].wrong_once == 0
    assert bench.state == State.READY
    rows = commanded(bench)
    assert np.max(np.abs(rows[rows[:, 5] == 8, 2])) < FINE
    assert max(abs(x) for x in said_by(bench, Telemetry)[-1].position) < FINE


def test_home_is_not_taken_in_a_swing(bench):
    boot(bench)
    for k in range(60):
        if k == 1:
            tell(bench, say(101, Enable(bench.stop)))
        for drive, home in zip(bench.drives, HOMES, strict=True):
            drive.position = home + 0.125 * np.exp(-k / 20) * np.cos(k)
        live(bench, 10)
        assert {drive.state for drive in bench.drives} == {1}
    for drive, home in zip(bench.drives, HOMES, strict=True):
        drive.position = home
    live(bench, 1200)
    assert bench.state == State.READY
    rows = commanded(bench)
    assert np.max(np.abs(rows[rows[:, 5] == 8, 2])) < FINE


# Faults


def lose_heartbeat(bench, drive):
    drive.silent = True


def reset(bench, drive):
    drive.off = True


def quick_reset(bench, drive):
    drive.boot()


def low_voltage(bench, drive):
    drive.disarm("low voltage")


def spinout(bench, drive):
    drive.disarm("spinout", clears=True)


def estop(bench, drive):
    drive.disarm("estop")


def estop_by_another(bench, drive):
    bench.network.send_message(drive.node << 5 | 0x02, b"")


def jam(bench, drive):
    bench.plate, drive.jammed = None, True


def mute(bench, drive):
    drive.mute = True


def second_master(bench, drive):
    bench.network.send_message(drive.node << 5 | 0x0C, bytes(8))


def no_number(bench, drive):
    bench.plate = None
    drive.position = float("nan")


def far(bench, drive):
    bench.plate, drive.jammed = None, True
    drive.position = 2500.0


def bus_off(bench, drive):
    bench.order("busoff")


FAULTS = [  # fault; the report about motor 2, or 0 for the bus; maximum time [ms]
    (lose_heartbeat, 2, Trouble.SILENT, 0, Fault.HARDWARE, 175),
    (reset, 2, Trouble.NO_POSITION, 0, Fault.HARDWARE, 12),
    (quick_reset, 2, Trouble.ERROR, 0, Fault.HARDWARE, 25),
    (low_voltage, 2, Trouble.ERROR, 0x200, Fault.SUPPLY, 25),
    (spinout, 2, Trouble.ERROR, 0x4000000, Fault.HARDWARE, 25),
    (estop, 2, Trouble.ERROR, 0x2000000, Fault.HARDWARE, 25),
    (estop_by_another, 0, Trouble.OTHER_MASTER, 0, Fault.HARDWARE, 4),
    (jam, 2, Trouble.ASTRAY, range(3000, 5000), Fault.FOLLOWING, 40),  # um
    (mute, 2, Trouble.NO_POSITION, 0, Fault.HARDWARE, 12),
    (no_number, 2, Trouble.NO_POSITION, 0, Fault.HARDWARE, 12),
    (far, 2, Trouble.NO_POSITION, 0, Fault.HARDWARE, 12),
    (second_master, 0, Trouble.OTHER_MASTER, 0, Fault.HARDWARE, 4),
    (bus_off, 0, Trouble.BUS_OFF, 0, Fault.HARDWARE, 4),
]


@pytest.mark.parametrize(("trouble", "motor", "kind", "code", "fault", "most_ms"), FAULTS)
def test_a_fault_switches_all_currents_off_and_is_reported(
    bench, trouble, motor, kind, code, fault, most_ms
):
    playing(bench, PLATE, 0.008)
    stop, since = bench.stop, bench.network.now
    trouble(bench, bench.drives[1])
    live(bench, 250)
    assert bench.state == State.OFF
    assert bench.stop != stop
    assert fault in Fault(bench.faults)
    reported = states(bench, since)
    assert {state for *_, state in reported} == {1}
    assert {m for at, m, _ in reported if at <= since + most_ms} == {0, 1, 2, 3}
    assert all(d.state == 1 for d in bench.drives if not d.off)
    found = said_by(bench, DriveTrouble)
    assert (found[-1].motor, found[-1].kind) == (motor, kind)
    assert found[-1].code in (code if trouble is jam else [code])
    check_bus(bench)


@pytest.mark.parametrize("trouble", [low_voltage, bus_off])
def test_after_a_fault_a_person_enables_again(bench, trouble):
    playing(bench, PLATE)
    before = [drive.enables for drive in bench.drives]
    trouble(bench, bench.drives[1])
    live(bench, 2600)
    assert [drive.enables for drive in bench.drives] == before  # nothing moves unasked
    assert bench.state == State.OFF
    if trouble is bus_off:  # it may have been reset: a person sets home
        enable(bench, 399, ms=900)
        assert bench.state == State.OFF
        assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(0, Trouble.HOME_LOST, 0, 0)
        tell(bench, say(400, Home()))
        bench.run(5)
    enable(bench, 401, ms=1200)
    assert (bench.state, bench.faults) == (State.READY, 0)


def test_a_reset_while_it_is_off_loses_home(bench):
    ready(bench)
    tell(bench, say(300, Stop(1)))
    live(bench, 100)
    drive = bench.drives[0]
    drive.off = True
    live(bench, 50)
    drive.boot()
    drive.position = 0.0  # it counts from here
    live(bench, 2500)
    assert Fault.NO_HOME in Fault(bench.faults)
    enable(bench, 400, ms=900)
    assert bench.state == State.OFF
    tell(bench, say(401, Home()))
    bench.run(5)
    enable(bench, 402, ms=900)
    assert (bench.state, bench.faults) == (State.READY, 0)
    assert abs(drive.position) < FINE  # and stays


def test_messages_of_the_drive_are_reported(bench):
    playing(bench, PLATE)
    bench.drives[1].disarm("low voltage")
    live(bench, 100)
    words = said_by(bench, DriveTrouble)[-1].text
    assert words == "motor_2: errors of the drive: DC_BUS_UNDER_VOLTAGE (00000200h)"


def test_names_of_errors_are_those_of_the_dbc(dbc):
    choices = dbc[0x01].get_signal_by_name("Axis_Error").choices
    for value, name in choices.items():
        words = DriveTrouble(1, Trouble.ERROR, 0, value).text
        assert words == f"motor_1: errors of the drive: {name} ({value:08X}h)" or value == 0


def test_a_drive_whose_errors_stay_is_not_enabled(bench):
    ready(bench)
    bench.drives[2].stuck = True
    bench.drives[2].disarm("low voltage")
    live(bench, 2500)
    enables = [drive.enables for drive in bench.drives]
    enable(bench, 400, ms=900)
    assert bench.state == State.OFF
    assert [drive.enables for drive in bench.drives] == enables


def test_a_drive_that_does_not_go_into_operation_is_named(bench):
    boot(bench)
    bench.drives[3].stuck = True
    enable(bench, ms=900)
    assert bench.state == State.HOMING
    live(bench, 4400)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(4, Trouble.NOT_ENABLED, 0, 1)


def test_a_drive_that_keeps_its_current_gets_an_estop(bench):
    ready(bench)
    bench.drives[0].keeps = True
    tell(bench, say(300, Stop(1)))
    live(bench, 200)
    assert bench.drives[0].history[-1] == "ESTOP"
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(1, Trouble.KEEPS, 0, 8)


def test_a_wrong_firmware_is_named_and_none_gets_current(bench):
    bench.drives[3].protocol = 1
    boot(bench)
    enable(bench, ms=900)
    assert bench.state == State.OFF
    assert all(drive.history == [] for drive in bench.drives)
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(4, Trouble.WRONG_DRIVE, 0, 1)


def test_two_drives_of_one_number_get_no_current(bench, dbc):
    from can_odrives import ODrive

    bench.drives.append(ODrive(bench.network, NODES[1], dbc))
    boot(bench)
    enable(bench, ms=900)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(2, Trouble.TWICE, 0, 0)
    assert all(drive.history == [] for drive in bench.drives)


UNDOING = {
    "the same enable again": lambda b: tell(b, say(101, Enable(b.old))),
    "an enable for the stop before": lambda b: tell(b, say(420, Enable(b.old))),
    "a new session": lambda b: tell(b, say(99, Hello(VERSION, 78))),
    "a table": lambda b: [tell(b, data) for data in uploaded(8, PLATE.wave(0.002), 430, 9)],
    "home": lambda b: tell(b, say(440, Home())),
    "a drive's reset": lambda b: b.drives[0].boot(),
    "a drive that goes into operation by itself": lambda b: vars(b.drives[2]).update(state=8),
    "an error that passes": lambda b: b.drives[1].disarm("spinout"),
    "a setpoint of another": lambda b: b.network.send_message(1 << 5 | 12, bytes(8)),
    "a state told by another": lambda b: b.network.send_message(1 << 5 | 7, bytes([8, *[0] * 7])),
    "bus off": lambda b: b.order("busoff"),
    "the board's reset": lambda b: b.order("reset"),
}


def test_no_message_clears_a_stop(bench):
    ready(bench)
    bench.old = bench.stop
    tell(bench, say(300, Stop(1)))
    bench.run(30)
    since = bench.network.now + 1
    for way in UNDOING.values():
        way(bench)
        live(bench, 150)
        assert bench.state == State.OFF
        assert {state for *_, state in states(bench, since)} <= {1}
        assert all(drive.state == 1 for drive in bench.drives)


def test_30_000_frames_of_noise_never_enable_the_motors(bench):
    playing(bench, PLATE, 0.008)
    since, enables = bench.network.now, [drive.enables for drive in bench.drives]
    bench.disturb(30_000, np.add.outer(np.array(NODES) << 5, range(32)).ravel())
    assert {state for *_, state in states(bench, since)} == {1}
    assert [drive.enables for drive in bench.drives] == enables
    assert all(drive.state == 1 for drive in bench.drives)
    check_bus(bench)


# How full the bus is


def test_four_axes_leave_room_on_the_bus(bench):
    from can_drives import frame_bits

    playing(bench, PLATE, 0.009)
    live(bench, 500)
    bits: dict[int, int] = {}
    for at, identifier, data in bench.both:
        bits[at // 2] = bits.get(at // 2, 0) + frame_bits(identifier, data)
    late = [count for cycle, count in bits.items() if cycle > 500]
    assert max(late) <= 0.95 * 2000  # bits of 2 ms at 1 Mbit/s
    assert np.median(late) > 0.45 * 2000
