"""The firmware leads drives of CiA 402 over CANopen: judged by somebody else's stack, `canopen`,
and by what is on the bus."""

import struct

import drive_troubles as troubles
import numpy as np
import pytest
from device_orders import (
    HELLO,
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
from drive_troubles import SYNC
from rigid_plate import Plate
from simulated_firmware import compiled_leader

from plate_core import load_rig
from plate_core.driver_status import DriverReason
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
from plate_driver.transports import Condition, SerialTransport

pytestmark = pytest.mark.needs("can", "canopen")

RIG = load_rig()
NODES, SIGNS, SCALE = (1, 2, 3, 5), (1, -1, 1, 1), 1e6
DRIVES = [RigDrive(node, SCALE, sign) for node, sign in zip(NODES, SIGNS, strict=True)]
DRIVES[3] = RigDrive(5, SCALE, 1, absolute=True, serial=705)
HOMES = (5000, -70_000, 2**31 - 20_000, 0)
"""Where the drives stand at home [counts]: the third one near the end of its range."""

PLATE = Plate(RIG, HOMES, SCALE * np.array(SIGNS))

RPDO = 0x200
FOLLOWED_MS = 12


@pytest.fixture(name="leader", scope="module")
def _leader(tmp_path_factory):
    return compiled_leader(tmp_path_factory.mktemp("leader"), DRIVES, "cia402")


@pytest.fixture(name="bench")
def _bench(leader, request):
    """The firmware, and four drives that are off."""
    from can_drives import CanBench, Drive

    bench = CanBench(leader, request.node.name)
    bench.drives = [Drive(bench.network, node) for node in NODES]
    for drive, home in zip(bench.drives, HOMES, strict=True):
        drive.position = float(home)
    yield bench
    bench.end()


def commanded(bench, since=0):
    """Controlword and target of each RPDO: rows of time [ms], motor, word, target."""
    rows = []
    for at, identifier, data in bench.sent:
        if at >= since and identifier - RPDO in NODES:
            word, target = struct.unpack("<Hi", data)
            rows.append((at, NODES.index(identifier - RPDO), word, target))
    return np.array(rows).reshape(-1, 4)


def travel(rows, motor):
    """Times [ms] and commanded positions of a motor [m]."""
    own = rows[(rows[:, 1] == motor) & (rows[:, 2] == 15)]
    return own[:, 0], (own[:, 3] - HOMES[motor]) / (SCALE * SIGNS[motor])


def check_bus(bench, since=0):
    """No target leaves the limits, or jumps, while there is current."""
    rows = commanded(bench, since)
    for motor in range(4):
        at, place = travel(rows, motor)
        steps = np.diff(place)[np.diff(at) <= 2]
        assert np.max(np.abs(place), initial=0) <= RIG.limits.stroke_m * 1.002 + 1 / SCALE
        assert np.max(np.abs(steps), initial=0) <= RIG.limits.speed * 2.004e-3 + 1 / SCALE


# Set up, enable, play


def test_drives_are_set_up_and_nothing_has_current_before_an_enable(bench):
    boot(bench)
    live(bench, 300)
    assert [drive.nmt.state for drive in bench.drives] == ["OPERATIONAL"] * 4
    assert [drive.history for drive in bench.drives] == [[]] * 4
    assert set(commanded(bench)[:, 2]) == {0}
    for drive in bench.drives:
        assert [(v.index, v.length) for v in drive.rpdo[1].map] == [(0x6040, 16), (0x607A, 32)]
        assert [(v.index, v.length) for v in drive.tpdo[1].map] == [(0x6041, 16), (0x6064, 32)]
        assert drive.value(0x6060) == 8
        assert drive.value(0x1401, 1) >> 31 == drive.value(0x1801, 1) >> 31 == 1
        assert drive.value(0x1016, 1) == 127 << 16 | 150
    reported = said_by(bench, Telemetry)
    assert {t.faults for t in reported} == {Fault.NO_HOME}
    assert {t.stop for t in reported} == {bench.stop}  # to be set up is no stop


def test_current_comes_by_the_states_of_the_standard_and_without_a_jump(bench):
    boot(bench)
    places = [drive.position for drive in bench.drives]
    enable(bench)
    assert bench.state == State.READY
    for drive in bench.drives:
        assert drive.history == ["ready", "switched on", "enabled"]
    for motor, place in enumerate(places):
        reported = [row[3] for row in commanded(bench) if row[1] == motor and row[2] == 15]
        assert set(reported) == {place}
    check_bus(bench)


TRANSITIONS = [  # number, from, to; by this controlword, or by the drive itself; where that ends
    (0, "start", "not ready", None, "not ready"),
    (1, "not ready", "switch on disabled", None, "switch on disabled"),
    (2, "switch on disabled", "ready", 6, "enabled"),
    (3, "ready", "switched on", 7, "enabled"),
    (4, "switched on", "enabled", 15, "enabled"),
    (5, "enabled", "switched on", None, "switch on disabled"),
    (6, "switched on", "ready", None, "switched on"),
    (7, "ready", "switch on disabled", 0, "switch on disabled"),
    (8, "enabled", "ready", None, "switch on disabled"),
    (9, "enabled", "switch on disabled", 0, "switch on disabled"),
    (10, "switched on", "switch on disabled", 0, "switch on disabled"),
    (11, "enabled", "quick stop", None, "switch on disabled"),
    (12, "quick stop", "switch on disabled", 0, "switch on disabled"),
    (13, "enabled", "fault reaction", None, "fault reaction"),
    (14, "fault reaction", "fault", None, "fault"),
    (15, "fault", "switch on disabled", 0x80, "switch on disabled"),
    (16, "quick stop", "enabled", None, "switch on disabled"),
]


@pytest.mark.parametrize(("number", "before", "after", "word", "ends"), TRANSITIONS)
def test_each_transition_of_the_state_machine(bench, number, before, after, word, ends):
    drive = bench.drives[1]
    boot(bench)
    places = [each.position for each in bench.drives]
    drive.holds = before
    if number in (2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13):
        enable(bench, ms=450)
    elif number:
        drive.enter(before)
    assert drive.state == before or not number
    if word is None:
        drive.enter(after)
    elif word:
        drive.holds = ""
    else:
        tell(bench, say(300, Stop(1)))
    live(bench, 1200 if number == 15 else 50)
    assert drive.state == ends
    assert word is None or (before, after, word) in drive.asked
    others = {each.state for each in bench.drives if each is not drive}
    assert others == {"enabled" if ends in ("enabled", "switched on") else "switch on disabled"}
    assert [each.position for each in bench.drives] == places
    check_bus(bench)


def test_an_enable_waits_for_drives_that_are_not_there_yet(bench):
    bench.run(5)
    tell(bench, HELLO)
    tell(bench, say(101, Enable(bench.stop)))
    bench.run(200)
    for drive in bench.drives[:3]:
        drive.boot()
    live(bench, 400)
    assert bench.state == State.HOMING
    assert all(drive.history == [] for drive in bench.drives)  # all of them, or none
    bench.drives[3].boot()
    live(bench, 900)
    assert bench.state == State.READY
    check_bus(bench)


def test_drives_that_are_not_there_are_named(bench):
    bench.run(5)
    tell(bench, HELLO)
    bench.drives[0].boot()
    live(bench, 1200)
    assert Fault(bench.faults) == Fault.HARDWARE | Fault.NO_HOME
    assert said_by(bench, DriveTrouble)[-1].text == "motor_2: the drive does not answer"


def test_the_drives_receive_the_table_and_follow(bench):
    playing(bench, PLATE)
    live(bench, 500)
    check_bus(bench)
    rows = commanded(bench)
    curve = spline(PLATE.wave(0.004))
    moving = [travel(rows, m) for m in range(4)]
    began = min(at[np.flatnonzero(np.abs(place) > 2e-6)[0]] for at, place in moving)
    late = []
    for motor, (at, place) in enumerate(moving):
        inside = (at > began + 10) & (at < began + 400)

        def miss(shift, motor=motor, at=at[inside], place=place[inside]):
            expected = curve(1e-3 * (at - began + shift) % 0.1)[..., motor]
            return float(np.max(np.abs(expected - place)))

        best = min(range(8), key=miss)
        assert miss(best) <= 1.5 / SCALE  # of rounding
        late.append(best)
    assert len(set(late)) == 1
    for drive, motor in zip(bench.drives, range(4), strict=True):
        assert drive.enables == 1
        assert abs(travel(commanded(bench), motor)[1][-1]) < 0.0041
    errors = [t.following_m for t in said_by(bench, Telemetry)]
    assert 1e-5 < max(errors) < 1e-3  # of the drives' lag, not of the bus's delay


def test_after_a_host_timeout_the_drives_stop_at_home(bench):
    playing(bench, PLATE)
    bench.run(1200)
    assert (bench.state, Fault(bench.faults)) == (State.OFF, Fault.HOST_SILENT)
    assert [drive.state for drive in bench.drives] == ["switch on disabled"] * 4
    for drive, home in zip(bench.drives, HOMES, strict=True):
        assert abs(drive.position - home) <= 2
    check_bus(bench)


def test_a_power_cut_reaches_the_bus_in_the_same_tick(bench):
    playing(bench, PLATE)
    tell(bench, say(300, Stop(1)))
    before = bench.network.now
    bench.run(1)
    now = [(i, d) for at, i, d in bench.sent if at > before]
    assert [i for i, _ in now] == [*(RPDO + node for node in NODES), SYNC]
    assert {d[:2] for i, d in now if i != SYNC} == {b"\0\0"}
    bench.run(3)
    assert [drive.state for drive in bench.drives] == ["switch on disabled"] * 4


def test_a_silent_board_is_stopped_by_the_drives_themselves(bench):
    playing(bench, PLATE)
    bench.cut = True
    bench.run(200)
    assert all(drive.state == "quick stop" for drive in bench.drives)


@pytest.mark.parametrize("at", ["switch on disabled", "ready", "switched on", "enabled"])
def test_a_single_wrong_position_does_not_become_target_or_home(bench, at):
    boot(bench)
    bench.drives[0].wrong_once = at, 50_000
    places = [drive.position for drive in bench.drives]
    enable(bench, ms=1000)
    assert bench.drives[0].wrong_once is None
    assert bench.state == State.READY
    for motor, place in enumerate(places):
        reported = {row[3] for row in commanded(bench) if row[1] == motor and row[2] == 15}
        assert reported == {place}
    assert max(abs(x) for x in said_by(bench, Telemetry)[-1].position) < 1e-5


def test_home_is_not_taken_in_a_swing(bench):
    boot(bench)
    for k in range(60):
        if k == 1:  # in the swing
            tell(bench, say(101, Enable(bench.stop)))
        for drive, home in zip(bench.drives, HOMES, strict=True):
            drive.position = home + 5000 * np.exp(-k / 20) * np.cos(k)
        live(bench, 10)
        assert {drive.state for drive in bench.drives} == {"switch on disabled"}
    for drive, home in zip(bench.drives, HOMES, strict=True):
        drive.position = float(home)
    live(bench, 900)
    assert bench.state == State.READY
    for motor in range(4):
        assert set(travel(commanded(bench), motor)[1]) == {0}


def test_a_reset_board_sends_no_target_before_it_knows_one(bench):
    playing(bench, PLATE, 0.008)
    since = bench.network.now
    bench.order("reset")
    bench.run(20)
    sent = [(identifier, data) for at, identifier, data in bench.sent if at > since]
    assert not [1 for identifier, _ in sent if identifier - RPDO in NODES]
    for node in NODES:
        cut = sent.index((0x600 + node, bytes.fromhex("2b40600000000000")))
        assert cut < sent.index((0, bytes([0x82, node])))
    assert all(drive.state == "switch on disabled" for drive in bench.drives)
    live(bench, 300)
    check_bus(bench)


# Faults


FAULTS = [
    (troubles.lose_heartbeat, Trouble.SILENT, 0, Fault.HARDWARE),
    (troubles.reset, Trouble.RESET, 0, Fault.HARDWARE),
    (troubles.emergency, Trouble.EMERGENCY, 0x8611, Fault.FOLLOWING),
    (troubles.low_voltage, Trouble.EMERGENCY, 0x3220, Fault.SUPPLY),
    (troubles.jam, Trouble.ASTRAY, range(3000, 5000), Fault.FOLLOWING),  # um
    (troubles.mute, Trouble.NO_POSITION, 0, Fault.HARDWARE),
    (troubles.doubled, Trouble.TWICE, 0, Fault.HARDWARE),
    (troubles.entered("switched on"), Trouble.LEFT, 0x233, Fault.HARDWARE),
    (troubles.entered("quick stop"), Trouble.LEFT, 0x217, Fault.HARDWARE),
    (troubles.entered("fault reaction"), Trouble.FAULT, 0x21F, Fault.HARDWARE),
    (troubles.pre_operational, Trouble.NOT_OPERATIONAL, 127, Fault.HARDWARE),
    (troubles.second_master, Trouble.OTHER_MASTER, 0, Fault.HARDWARE),
    (troubles.other_client, Trouble.OTHER_MASTER, 0, Fault.HARDWARE),
    (troubles.other_heartbeat, Trouble.OTHER_MASTER, 0, Fault.HARDWARE),
    (troubles.short_emergency, Trouble.EMERGENCY, 0x2310, Fault.HARDWARE),
    (troubles.local, Trouble.LEFT, 0x37, Fault.HARDWARE),
    (troubles.bus_off, Trouble.BUS_OFF, 0, Fault.HARDWARE),
]
DELAYS_MS = {troubles.lose_heartbeat: 203, troubles.jam: 40, troubles.bus_off: 60}
"""Maximum delay from a trouble to the end of the current [ms]; others: `FOLLOWED_MS`."""


@pytest.mark.parametrize(("trouble", "kind", "code", "fault"), FAULTS)
def test_a_fault_switches_all_currents_off_and_is_reported(bench, trouble, kind, code, fault):
    playing(bench, PLATE, 0.008)
    drive, stop, since = bench.drives[1], bench.stop, bench.network.now
    trouble(bench, drive)
    live(bench, 250)
    assert bench.state == State.OFF
    assert bench.stop != stop
    assert fault in Fault(bench.faults)
    words = commanded(bench, since)
    off = words[words[:, 2] == 0][0, 0]
    assert off - since <= DELAYS_MS.get(trouble, FOLLOWED_MS)
    assert 15 not in words[words[:, 0] > off, 2]
    assert all(d.state != "enabled" for d in bench.drives)
    reports = said_by(bench, DriveTrouble)
    motor = 0 if kind in (Trouble.OTHER_MASTER, Trouble.BUS_OFF) else 2
    assert {(t.motor, t.kind) for t in reports} == {(motor, kind)}
    assert {t.code for t in reports} <= set(code if trouble is troubles.jam else [code])
    check_bus(bench)


def test_a_plate_that_jams_keeps_its_home(bench):
    playing(bench, PLATE, 0.008)
    for drive in bench.drives:
        drive.jammed = True
    live(bench, 250)
    assert (bench.state, bench.faults) == (State.OFF, Fault.FOLLOWING)
    assert said_by(bench, DriveTrouble)[-1].kind == Trouble.ASTRAY


def test_a_drive_that_is_stopped_by_nmt_loses_its_current_at_once(bench):
    playing(bench, PLATE, 0.008)
    troubles.stopped(bench, bench.drives[1])
    live(bench, 20)
    assert all(drive.state == "switch on disabled" for drive in bench.drives)


def test_a_drive_that_boots_with_current_is_cut(bench):
    playing(bench, PLATE, 0.008)
    drive = bench.drives[1]
    drive.nmt.state = "INITIALISING"
    drive.nmt.state = "PRE-OPERATIONAL"  # it obeys no PDO, and holds on
    live(bench, 20)
    assert all(drive.state == "switch on disabled" for drive in bench.drives)


@pytest.mark.parametrize("trouble", [troubles.emergency, troubles.bus_off])
def test_after_a_fault_a_person_enables_again(bench, trouble):
    playing(bench, PLATE)
    trouble(bench, bench.drives[1])
    live(bench, 2600)
    assert all(drive.enables == 1 for drive in bench.drives)  # nothing moves unasked
    assert bench.state == State.OFF
    enable(bench, 400)
    assert (bench.state, bench.faults) == (State.READY, 0)
    assert all(drive.enables == 2 for drive in bench.drives)
    for drive, home in zip(bench.drives, HOMES, strict=True):
        assert abs(drive.position - home) <= 2  # the same home
    check_bus(bench)


@pytest.mark.parametrize(
    "trouble",
    [troubles.reset, troubles.lose_heartbeat, troubles.stopped, troubles.moved_in_bus_off],
)
def test_a_person_confirms_home_if_it_may_be_lost(bench, trouble):
    playing(bench, PLATE)
    trouble(bench, bench.drives[1])
    live(bench, 2600)
    enable(bench, 400)
    assert bench.state == State.OFF
    assert all(drive.enables == 1 for drive in bench.drives)
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(0, Trouble.HOME_LOST, 0, 0)
    places = [round(drive.position) for drive in bench.drives]
    tell(bench, say(500, Home()))
    bench.run(5)
    enable(bench, 501)
    assert (bench.state, bench.faults) == (State.READY, 0)
    rows = commanded(bench)
    reported = [rows[rows[:, 1] == motor][-1, 3] for motor in range(4)]
    assert reported == [*places[:3], 0]


@pytest.mark.parametrize("ms", [500, 1500, 2100])  # before we reset it, after that, after twice
def test_a_drive_that_lost_power_has_another_zero(bench, ms):
    """Also if it begins at the very number that it had: it counts from where it then is."""
    ready(bench)
    drive = bench.drives[1]
    drive.deaf = True
    drive.nmt.stop_heartbeat()
    drive.enter("switch on disabled")
    live(bench, ms)
    drive.boot()
    live(bench, 400)
    assert said_by(bench, DriveTrouble)[-1].motor in (0, 2)
    assert Fault.NO_HOME in Fault(bench.faults)
    live(bench, 1200)
    enable(bench, 400)
    assert bench.state == State.OFF
    assert [each.enables for each in bench.drives] == [1] * 4


@pytest.mark.parametrize("place", [2**31 - 5000, -(2**31) + 5000])
def test_counts_that_end_within_the_stroke_are_refused(bench, place):
    bench.drives[2].position = float(place)
    boot(bench)
    enable(bench)
    assert bench.state == State.OFF
    code = place % 2**32
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(3, Trouble.RANGE, 0, code)
    assert all(drive.state == "switch on disabled" for drive in bench.drives)


def test_stops_in_each_tick_do_not_suppress_the_heartbeat(bench):
    ready(bench)
    since = bench.network.now
    for k in range(300):
        tell(bench, say(300 + k, Stop(1)))
        bench.run(1)
    beats = [at for at, identifier, _ in bench.sent if identifier == 0x77F and at > since]
    assert max(np.diff([since, *beats])) <= 50


def test_a_drive_whose_fault_stays_is_not_enabled(bench):
    playing(bench, PLATE)
    bench.drives[2].holds = "fault"
    bench.drives[2].fail(0x4210)
    live(bench, 2500)
    enable(bench, 400)
    assert bench.state == State.OFF
    assert all(drive.enables == 1 for drive in bench.drives)
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(3, Trouble.EMERGENCY, 1, 0x4210)


@pytest.mark.parametrize("pushed", [0, 5000])
def test_a_drive_that_keeps_its_current_is_reset(bench, pushed):
    ready(bench)
    bench.drives[0].keeps = True
    tell(bench, say(300, Stop(1)))
    live(bench, 10)
    bench.drives[0].jammed, bench.drives[0].slip = True, pushed
    live(bench, 140)
    assert [drive.state for drive in bench.drives] == ["switch on disabled"] * 4
    assert (0, bytes([0x81, NODES[0]])) in [frame[1:] for frame in bench.sent]
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(1, Trouble.KEEPS, 0, 0x237)


def test_a_drive_that_does_not_go_into_operation_is_named(bench):
    boot(bench)
    bench.drives[3].holds = "switched on"
    enable(bench)
    assert bench.state == State.HOMING
    live(bench, 4700)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(4, Trouble.NOT_ENABLED, 0, 0x233)
    assert [drive.state for drive in bench.drives] == ["switch on disabled"] * 4


WRONG = [
    ({"x1000_0": 0x191}, Trouble.WRONG_DRIVE, 0x1000, 0x191),  # an I/O module
    ({"x6502_0": 0x1}, Trouble.WRONG_DRIVE, 0x6502, 0x1),
    ({"x1018_4": 701}, Trouble.WRONG_DRIVE, 0x1018, 701),  # swapped with another
    ({"without": (0x6007,)}, Trouble.REFUSED, 0x6007, 0x06020000),
    ({"without": (0x60C2,)}, Trouble.REFUSED, 0x60C2, 0x06020000),
]


@pytest.mark.parametrize(("of_eds", "kind", "index", "code"), WRONG)
def test_a_wrong_drive_is_named_and_none_gets_current(bench, of_eds, kind, index, code):
    bench.drives[3] = bench.drives[3].swap(**of_eds)
    boot(bench)
    enable(bench)
    assert bench.state == State.OFF
    assert all(drive.history == [] for drive in bench.drives)
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(4, kind, index, code)


def test_two_drives_of_one_number_get_no_current(bench):
    from can_drives import Drive, SteppedNetwork, Wire

    network = SteppedNetwork(Wire(bench.channel))
    other, take = Drive(network, NODES[1]), bench.network.take
    bench.network.take = lambda: (network.take(), take())
    other.deaf = False
    boot(bench)
    enable(bench)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(2, Trouble.TWICE, 0, 0)
    assert all(drive.history == [] for drive in [*bench.drives, other])
    network.bus.shutdown()


def test_each_object_that_a_drive_refuses_is_named(bench):
    boot(bench)
    requests = [data[1:4] for _, identifier, data in bench.sent if identifier == 0x600 + NODES[3]]
    objects = {(int.from_bytes(data[:2], "little"), data[2]) for data in requests}
    assert len(objects) == 28
    objects.remove((0x605A, 0))  # there is another way
    drive = bench.drives[3]
    for each in bench.drives[:3]:
        each.deaf = True
    for number, sub in sorted(objects):
        drive.refuses, bench.written = (number, sub), b""
        bench.order("reset")
        bench.run(100)
        reported = said_by(bench, DriveTrouble)[-1]
        assert reported == DriveTrouble(4, Trouble.REFUSED, number, 0x08000020)
        assert drive.nmt.state != "OPERATIONAL"
    assert drive.history == []


@pytest.mark.parametrize(("first", "second", "turns"), [(0, 1, True), (2, 3, True), (0, 2, False)])
def test_swapped_drives_are_noticed_once_their_motors_differ(bench, first, second, turns):
    order = [0, 1, 2, 3]
    order[first], order[second] = second, first
    bench.drives = [bench.drives[k] for k in order]
    ready(bench)
    bench.plate = Plate(RIG, PLATE.homes[order], PLATE.counts[order])
    for data in uploaded(7, PLATE.wave(0.006 if turns else 0.009, turns), 200, 90):
        tell(bench, data)
    live(bench, 150)
    assert bench.state == State.OFF
    if turns:
        assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(0, Trouble.CROOKED, 0, 0)
    else:
        assert Fault(bench.faults) == Fault.FOLLOWING


@pytest.mark.parametrize("stopped", [False, True])
def test_a_drive_that_loses_counts_is_noticed_by_the_others(bench, stopped):
    ready(bench)
    bench.plate = PLATE
    if stopped:
        tell(bench, say(300, Stop(1)))
        live(bench, 50)
    drive, stop = bench.drives[0], bench.stop
    while bench.stop == stop and drive.slip < 5000:
        drive.slip += 40
        live(bench, 5)
    assert 2900 < drive.slip < 3600  # following_error_m of the rig is 3 mm
    live(bench, 50)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(0, Trouble.CROOKED, 0, 0)
    live(bench, 1200)
    enable(bench, 400)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1].kind == Trouble.HOME_LOST
    tell(bench, say(500, Home()))
    bench.run(5)
    enable(bench, 501)
    assert (bench.state, bench.faults) == (State.READY, 0)
    check_bus(bench)


@pytest.mark.parametrize("slow", ["", "switched on"])  # motor_4, which the others wait for
def test_a_drive_with_another_zero_under_current_is_named(bench, slow):
    boot(bench)
    bench.drives[1].leap = 240_000  # a turn
    bench.drives[3].holds = slow
    enable(bench)
    assert (bench.state, bench.faults & Fault.FOLLOWING) == (State.OFF, Fault.FOLLOWING)
    reported = said_by(bench, DriveTrouble)[-1]
    assert (reported.motor, reported.kind) == (2, Trouble.ASTRAY)
    at, _ = travel(commanded(bench), 1)
    assert at[-1] - at[0] <= 6
    assert all(each.state == "switch on disabled" for each in bench.drives)


def test_a_drive_with_another_zero_at_a_second_enable_has_lost_home(bench):
    ready(bench)
    tell(bench, say(300, Stop(1)))
    live(bench, 50)
    bench.plate = PLATE
    drive = bench.drives[2]
    drive.leap, drive.lag_ms = 5500, 20  # which the others cannot tell: its weight is a half
    enable(bench, 350)
    drive.leap = 0
    live(bench, 1200)
    enable(bench, 400)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1].kind == Trouble.HOME_LOST
    assert [each.enables for each in bench.drives] == [2] * 4  # not led to a wrong home


def test_an_absolute_zero_that_cannot_be_is_refused(bench):
    bench.drives[3].position = 7000.0  # where the other three have home
    boot(bench)
    enable(bench)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(0, Trouble.CROOKED, 0, 0)
    assert {row[3] for row in commanded(bench) if row[1] == 3 and row[2] == 15} <= {7000}


def test_a_drive_that_does_not_take_the_mode_on_is_refused(bench):
    bench.drives[3].stuck_mode = True
    boot(bench)
    enable(bench)
    assert bench.state == State.OFF
    assert said_by(bench, DriveTrouble)[-1] == DriveTrouble(4, Trouble.WRONG_DRIVE, 0x6061, 0)


@pytest.mark.parametrize("without", [(), (0x605A,)])
def test_a_drive_that_cannot_end_its_quick_stop_lets_go_at_once(bench, without):
    bench.drives[0] = bench.drives[0].swap(without=without)
    bench.drives[0].refuses = (0x605A, 0)
    ready(bench)
    bench.cut = True
    bench.run(200)
    states = [drive.state for drive in bench.drives]
    assert states == ["switch on disabled", *["quick stop"] * 3]


UNDOING = {  # the first ones while nothing else is wrong
    "the same enable again": lambda b: tell(b, say(101, Enable(b.old))),
    "an enable for the stop before": lambda b: tell(b, say(420, Enable(b.old))),
    "a new session": lambda b: tell(b, say(99, Hello(VERSION, 78))),
    "a table": lambda b: [tell(b, data) for data in uploaded(8, PLATE.wave(0.002), 430, 9)],
    "home": lambda b: tell(b, say(440, Home())),
    "a drive's reset": lambda b: b.drives[0].boot(),
    "all drives' reset": lambda b: [drive.boot() for drive in b.drives],
    "a drive that goes into operation by itself": lambda b: b.drives[2].enter("enabled"),
    "a fault's reset": lambda b: b.drives[1].fail(0x2310),
    "NMT start by another": lambda b: b.network.send_message(0, b"\1\0"),
    "a controlword by another": lambda b: b.network.send_message(RPDO + 1, b"\x0f\0\0\0\0\0"),
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
        assert set(commanded(bench, since)[:, 2]) <= {0, 0x80}
        assert all(drive.state != "enabled" for drive in bench.drives)


def test_100_000_frames_of_noise_never_enable_the_motors(bench):
    playing(bench, PLATE, 0.008)
    since = bench.network.now
    kinds = [0, SYNC, 0x180, RPDO, 0x580, 0x600, 0x700]
    bench.disturb(100_000, np.add.outer(kinds, NODES).ravel())
    words = commanded(bench, since)
    off = words[words[:, 2] == 0][0, 0]
    assert set(words[words[:, 0] > off, 2]) <= {0, 0x80}
    assert all(drive.enables == 1 and drive.state != "enabled" for drive in bench.drives)
    check_bus(bench)


# The host's report


class Port:
    """The firmware's line, as the driver's transport has it."""

    def __init__(self, bench):
        self.bench, self.read_bytes = bench, 0

    def read(self, size):
        start, self.read_bytes = self.read_bytes, len(self.bench.written)
        return self.bench.written[start:]

    def write(self, data):
        tell(self.bench, data)
        return len(data)

    def close(self):
        pass


@pytest.mark.parametrize(
    ("trouble", "reason", "text"),
    [
        (troubles.emergency, DriverReason.FOLLOWING, "following: motor_2: emergency 8611h, error"),
        (troubles.reset, DriverReason.HARDWARE, "hardware: motor_2: the drive was reset"),
    ],
)
def test_the_driver_reports_the_axis_and_the_drives_message(bench, trouble, reason, text):
    transport = SerialTransport(lambda: Port(bench), lambda: 1e-3 * bench.network.now, 7)

    def passed(ms):
        for _ in range(0, ms, 5):
            bench.run(5)
            transport.poll()

    boot(bench)
    transport.open()
    passed(200)
    order = transport.enable()
    passed(700)
    assert order.done
    assert transport.report().condition is Condition.READY
    trouble(bench, bench.drives[1])
    passed(100)
    report = transport.report()
    assert (report.condition, report.reason) == (Condition.OFF, reason)
    assert report.text.startswith(text)


# How full the bus is


def test_crc_of_a_frame_is_that_of_the_catalogue():
    from can_drives import crc15

    assert crc15("".join(f"{byte:08b}" for byte in b"123456789")) == 0x059E


def test_four_axes_fill_half_of_the_bus(bench):
    from can_drives import frame_bits

    playing(bench, PLATE, 0.009)
    live(bench, 500)
    bits: dict[int, int] = {}
    for at, identifier, data in bench.both:
        size = len(data)
        own = frame_bits(identifier, data)
        assert 47 + 8 * size <= own <= 47 + 8 * size + (34 + 8 * size - 1) // 4
        bits[at // 2] = bits.get(at // 2, 0) + own
    late = [count for cycle, count in bits.items() if cycle > 400]
    assert max(late) <= 0.65 * 2000  # bits of 2 ms at 1 Mbit/s
    assert np.median(late) > 0.3 * 2000
