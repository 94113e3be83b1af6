"""Commissioning, against drives of somebody else's stack, on a bus in memory, in simulated time."""

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import pytest

from plate_core import PlateError, load_rig
from plate_core.rig import rig_path
from plate_core.serial_protocol import Trouble
from plate_drives.commission import commission, main
from plate_drives.master import Master, trouble_text

pytestmark = pytest.mark.needs("can", "canopen")

NODES = (1, 2, 3, 4)
PLACES = (5000, -70_000, 900_000, 20)
RPDO, SDO = 0x200, 0x600

VALUES = {0x603F: 6, 0x607F: 7, 0x6065: 7}
"""Objects beyond those of the drives of test_cia402.py, with their types."""


class SteppedMaster(Master):
    """The host, which lets the drives live while it waits."""

    def __init__(self, bus, bench):
        super().__init__(bus)
        self.bench = bench

    @property
    def now(self):
        return 1e-3 * self.bench.network.now

    def frames(self, until):
        while True:
            while (message := self._bus.recv(0)) is not None:
                yield message.arbitration_id, bytes(message.data)
            if self.now >= until - 1e-9:
                return
            self.bench.step()

    def send(self, identifier, data=b""):
        self.bench.sent.append((self.now, identifier, bytes(data)))
        if not self.bench.cut:
            super().send(identifier, data)
        self.bench.network.take()


def drive_of(network, node, **of_eds):
    from can_drives import STATUS, Drive
    from canopen.objectdictionary import ODRecord, ODVariable

    class Told(Drive):
        """It also reports its state by SDO."""

        def now(self, index, **_):
            status = STATUS[self.state] & (0xFFFF if self.remote else ~0x200)
            reported = {0x6041: status, 0x6064: round(self.position)}
            return reported.get(index)

    drive = Told(network, node, **of_eds)
    dictionary = drive.object_dictionary
    for index, kind in VALUES.items():
        dictionary.add_object(variable := ODVariable(f"x{index:X}", index))
        variable.data_type, variable.default = kind, 0
    dictionary.add_object(record := ODRecord("limits", 0x607D))
    for sub in (1, 2):
        record.add_member(variable := ODVariable(f"limit {sub}", 0x607D, sub))
        variable.data_type, variable.default = 4, 0
    drive.add_read_callback(drive.now)
    drive.add_write_callback(lambda **_: None)
    return drive


class Bench:
    """Four drives, and a person who looks at the motors and answers."""

    def __init__(self, channel):
        import can
        from can_drives import SteppedNetwork

        self.channel, self.others = channel, []
        self.network = SteppedNetwork(can.Bus(interface="virtual", channel=channel))
        self.drives = [drive_of(self.network, node) for node in NODES]
        for drive, place in zip(self.drives, PLACES, strict=True):
            drive.position = float(place)
            drive.boot()
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.master = SteppedMaster(self.bus, self)
        self.sent, self.asked, self.reached = [], [], []
        self.cut = False
        self.at_step = lambda: None
        self.truth = {1: (1, 1e6), 2: (2, -1e6), 3: (3, 1e6), 4: (4, 1e6)}
        """Of each node: its motor, and counts for a metre along that one's direction."""
        self.answers = {}

    def step(self):
        self.network.pass_ms()
        for drive in self.drives:
            drive.pass_ms()
        self.network.take()
        self.at_step()
        on = [drive for drive in self.drives if drive.state == "enabled"]
        assert len(on) <= 1
        for drive in on:
            place = (drive.position - PLACES[drive.id - 1]) / self.truth[drive.id][1]
            self.reached.append((drive.id, place))

    def ask(self, question, meanwhile):
        """Answer as a person who reads a rule to 10 um, who needs some time."""
        self.asked.append(question)
        for _ in range(10):
            meanwhile()
        on = [drive for drive in self.drives if drive.state == "enabled"]
        for words, answer in self.answers.items():
            if words in question:
                return answer() if callable(answer) else answer
        if "Which motor" in question:
            return str(self.truth[on[0].id][0])
        if "Which distance" in question:
            return f"{1e3 * self.reached[-1][1]:.2f}"
        if "Did the motor move about 1 mm" in question:
            return "no" if abs(self.reached[-1][1]) < 1e-3 else "yes"
        return "yes" if "ype yes" in question else ""

    def run(self, path, only_check=False):
        return commission(path, self.master, only_check, self.ask)

    def only(self, number):
        """Of all motors only this one is moved."""
        self.answers["get current"] = lambda: (
            "yes" if sum("get current" in words for words in self.asked) == number else ""
        )

    def moving(self, happens):
        """Let something happen once a drive has moved 0.2 mm."""

        def look():
            if self.reached and abs(self.reached[-1][1]) > 2e-4:
                self.at_step = lambda: None
                self.when = self.network.now
                happens(self.drives[self.reached[-1][0] - 1])

        self.at_step = look


@pytest.fixture(name="bench")
def _bench(request):
    bench = Bench(request.node.name)
    yield bench
    bench.bus.shutdown()
    for network in (bench.network, *bench.others):
        network.bus.shutdown()


@pytest.fixture(name="rig_file")
def _rig_file(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(rig_path("linear_motors").read_text(encoding="utf-8"), encoding="utf-8")
    return path


def all_off(bench):
    return all(drive.state in ("switch on disabled", "fault") for drive in bench.drives)


# Detection


def test_to_check_only_reads(bench, rig_file, capsys):
    before = rig_file.read_bytes()
    assert bench.run(rig_file, only_check=True) == 0
    assert {(i & 0x780, data[0]) for _, i, data in bench.sent} == {(SDO, 0x40)}
    assert not bench.asked
    assert rig_file.read_bytes() == before
    output = capsys.readouterr().out
    assert "node 3: device type 20192h, vendor 1h, serial 703, position 900000, " in output
    assert "WRONG" not in output


def put(drive, index, sub, value):
    drive.data_store.setdefault(index, {})[sub] = value.to_bytes(4, "little", signed=True)


def deaf(bench):
    bench.network.unsubscribe(SDO + 2)


def other(**of_eds):
    def change(bench):
        bench.drives[1] = bench.drives[1].swap(**of_eds)
        bench.drives[1].boot()

    return change


def in_fault(bench):
    bench.drives[1].state = "fault"
    bench.drives[1].data_store.setdefault(0x603F, {})[0] = b"\x10\x23"


def twice(bench):
    import can
    from can_drives import SteppedNetwork

    second = SteppedNetwork(can.Bus(interface="virtual", channel=bench.channel))
    drive_of(second, 2).boot()
    take = bench.network.take
    bench.network.take = lambda: (take(), second.take())
    bench.others.append(second)


def narrow(bench):
    put(bench.drives[1], 0x607D, 1, -75_000)
    put(bench.drives[1], 0x607D, 2, -65_000)


WRONG = [
    (deaf, "motor_2: node 2 does not answer, nodes on the bus: 1, 3, 4"),
    (other(x1000_0=0x191), "motor_2: node 2 has device type 191h, allowed: profile 402"),
    (other(x6502_0=1), "motor_2: modes 6502h are 1h, required: cyclic synchronous position"),
    (other(without=(0x6007,)), "object 6007h:00 (abort 06020000h, no such object), so it cannot"),
    (in_fault, "motor_2: the drive is in fault (statusword 0218h): error code 2310h (current), "),
    (lambda bench: bench.drives[1].enter("enabled"), "motor_2: the drive has current"),
    (lambda bench: bench.network.send_message(0x80, b""), "bus: another master is on the bus"),
    (twice, "motor_2: two drives have this node number"),
    (narrow, "607Dh are -75 to -65 mm, allowed: 20 mm or more (stroke_m"),
]


@pytest.mark.parametrize(("change", "text"), WRONG)
def test_mismatches_are_reported(bench, rig_file, capsys, change, text):
    change(bench)
    assert bench.run(rig_file, only_check=True) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "WRONG" in line]
    assert text in line


def test_swapped_serial_numbers(bench, rig_file, capsys):
    text = rig_file.read_text(encoding="utf-8")
    for node, serial in ((1, 701), (2, 703)):
        text = text.replace(f"node: {node},", f"node: {node}, serial: {serial},")
    rig_file.write_text(text, encoding="utf-8")
    assert bench.run(rig_file) == 1
    assert not bench.asked  # before it is mended nothing is moved
    output = capsys.readouterr().out
    text = "node 2 has serial 702, allowed: 703; the serial number of the rig file is at node 3"
    assert f"WRONG: motor_2: {text}" in output


# Motions and writing


def test_drives_are_identified_measured_and_written(bench, rig_file, capsys):
    """Nodes 3 and 4 are swapped, the second motor counts along its direction, and motor_4, at node
    3, by twice as many counts."""
    before = load_rig(rig_file)
    text = rig_file.read_text(encoding="utf-8")
    bench.truth = {1: (1, 1e6), 2: (2, 1e6), 3: (4, 2e6), 4: (3, 1e6)}
    bench.answers = {"The motor is +0.020 mm": "absolute"}
    assert bench.run(rig_file) == 0
    after = load_rig(rig_file)
    drives = [motor.drive for motor in before.motors]
    expected = [
        replace(drives[0], serial=701), replace(drives[1], sign=1, serial=702),
        replace(drives[3], absolute=True, serial=704),
        replace(drives[2], counts_per_m=2e6, serial=703),
    ]  # fmt: skip
    assert [motor.drive for motor in after.motors] == expected
    assert replace(after, motors=before.motors) == before
    changed = rig_file.read_text(encoding="utf-8")
    assert [line.partition("#")[2] for line in changed.splitlines()] == [
        line.partition("#")[2] for line in text.splitlines()
    ]
    assert "motor_2: sign: 1, serial: 702" in capsys.readouterr().out
    # Nothing else has moved, and only by the announced distance.
    assert [drive.enables for drive in bench.drives] == [1] * 4
    assert max(abs(place) for _, place in bench.reached) < 0.55e-3
    assert all_off(bench)
    assert {d.value(0x1016, 1) for d in bench.drives} == {0}  # they do not miss us
    reported = [data for at, i, data in bench.sent if i == RPDO + 2 and data[0] == 15]
    targets = [int.from_bytes(data[2:], "little", signed=True) for data in reported]
    steps = [b - a for a, b in pairwise(targets)]
    assert targets[0] == PLACES[1]
    assert 50 < max(map(abs, steps)) < 1e4 * 1.2 * 6.3e-3  # counts in 10 ms, at 2 Hz
    assert max(abs(b - a) for a, b in pairwise(steps)) < 15  # no jump
    assert (min(targets) - PLACES[1], max(targets) - PLACES[1]) == (-500, 499)  # moved, and swung


def test_without_yes_no_motor_moves(bench, rig_file, capsys):
    before = rig_file.read_bytes()
    bench.answers = {"get current": "y"}
    assert bench.run(rig_file) == 0
    assert [drive.history for drive in bench.drives] == [[]] * 4
    assert not [
        1 for _, i, data in bench.sent if i & 0x780 == SDO and data[0] != 0x40 and any(data[4:])
    ]
    assert rig_file.read_bytes() == before


def test_the_rig_file_is_written_only_after_a_confirmation(bench, rig_file):
    before = rig_file.read_bytes()
    bench.only(1)
    bench.answers["Write this"] = "no"
    assert bench.run(rig_file) == 1
    assert bench.drives[0].enables == 1
    assert rig_file.read_bytes() == before


TROUBLES = [
    (lambda b, d: d.nmt.stop_heartbeat(), "motor_2: the drive does not answer", 320),
    (lambda b, d: d.boot(), "motor_2: the drive was reset", 20),
    (lambda b, d: d.fail(0x8611, 0x20),
     "motor_2: emergency 8611h, error register 20h (following error)", 20),
    (lambda b, d: d.enter("fault"), "motor_2: the drive is in fault (statusword 0218h)", 30),
    (lambda b, d: setattr(d, "mute", True), "motor_2: the drive does not report its position", 50),
    (lambda b, d: d.enter("quick stop"), "motor_2: the drive has left the enabled state", 30),
    (lambda b, d: setattr(d, "remote", False), "motor_2: the drive has left the enabled state", 30),
    (lambda b, d: b.network.send_message(0x80, b""), "bus: another master is on the bus", 20),
    (lambda b, d: twice(b), "motor_2: the drive was reset", 20),
]  # fmt: skip


@pytest.mark.parametrize(("happens", "text", "within_ms"), TROUBLES)
def test_a_trouble_ends_a_motion_and_is_reported(bench, rig_file, capsys, happens, text, within_ms):
    before = rig_file.read_bytes()
    bench.only(2)
    bench.moving(lambda drive: happens(bench, drive))
    assert bench.run(rig_file) == 1
    assert f"error: {text}" in capsys.readouterr().out
    assert all_off(bench)
    commanded = [at for at, i, data in bench.sent if i == RPDO + 2 and data[0] == 15]
    assert 1e3 * commanded[-1] <= bench.when + within_ms
    assert sum(drive.enables for drive in bench.drives) == 1
    assert rig_file.read_bytes() == before


def test_the_current_of_a_jammed_motor_is_switched_off(bench, rig_file, capsys, monkeypatch):
    monkeypatch.setattr("plate_drives.axis.ASTRAY_M", 2e-4)
    text = rig_file.read_text(encoding="utf-8")
    rig_file.write_text(text.replace("following_error_m: 0.003", "following_error_m: 0"))
    bench.only(2)
    bench.moving(lambda drive: setattr(drive, "jammed", True))
    assert bench.run(rig_file) == 1
    assert "error: motor_2: does not follow; following error is 0.2" in capsys.readouterr().out
    assert all_off(bench)
    assert "quick stop" not in bench.drives[1].history  # it would not follow that either


def test_a_drive_with_another_zero_under_current_is_switched_off(bench, rig_file, capsys):
    drive = bench.drives[1]
    drive.leap = 24_000  # a turn
    bench.only(2)
    assert bench.run(rig_file) == 1
    assert "error: motor_2: does not follow; following error is 24 mm, allowed: 3" in (
        capsys.readouterr().out
    )
    assert len(bench.reached) <= 20  # ms with current: two bus cycles
    assert drive.history[3:] == ["switch on disabled"]


def test_a_motor_that_does_not_move_is_reported(bench, rig_file, capsys):
    """Though that is less than following_error_m."""
    bench.drives[0].jammed = True
    bench.only(1)
    assert bench.run(rig_file) == 1
    output = capsys.readouterr().out
    assert "motor_1: travel measured by the drive is +0.000 mm, allowed: at least 0.25 mm" in output
    assert all_off(bench)


def test_while_a_drive_keeps_its_current_no_other_one_gets_any(bench, rig_file, capsys):
    def keep(drive):
        drive.keeps, drive.boot = True, lambda: None

    bench.moving(keep)
    assert bench.run(rig_file) == 1
    output = capsys.readouterr().out
    assert "error: motor_1: the drive does not switch its current off" in output
    assert output.count("error: motor_1: the drive has current") == 3  # of the others' turns
    assert [drive.enables for drive in bench.drives] == [1, 0, 0, 0]


def test_serial_numbers_that_are_no_numbers_are_left_out(bench, rig_file):
    """All drives of a manufacturer can report the same number."""
    before = load_rig(rig_file).motors[1].drive
    for drive in bench.drives:
        put(drive, 0x1018, 4, 1)
    bench.truth[2] = (2, 1e6)
    assert bench.run(rig_file) == 0
    assert load_rig(rig_file).motors[1].drive == replace(before, sign=1)


def test_a_scale_that_is_far_too_great_ends_it_in_time(bench, rig_file, capsys):
    bench.truth[1] = (1, 1e3)  # of 1e6 in the file: 0.5 mm would be half a metre
    bench.only(1)
    assert bench.run(rig_file) == 1
    assert "error: counts_per_m is 1e+06 and probably too large, because" in capsys.readouterr().out
    assert max(abs(place) for _, place in bench.reached) < 10e-3
    assert all_off(bench)


def test_ctrl_c_brakes_and_switches_off(bench, rig_file, capsys):
    def ctrl_c(drive):
        raise KeyboardInterrupt

    before = rig_file.read_bytes()
    bench.moving(ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        bench.run(rig_file)
    assert bench.drives[0].history[3:5] == ["quick stop", "switch on disabled"]
    assert all_off(bench)
    assert "all drives are switched off" in capsys.readouterr().out
    assert rig_file.read_bytes() == before


def test_a_drive_stops_by_itself_if_the_bus_is_cut(bench, rig_file, capsys):
    bench.only(1)
    bench.moving(lambda drive: setattr(bench, "cut", True))
    assert bench.run(rig_file) == 1
    assert bench.drives[0].history[-1] == "quick stop"  # by itself
    assert "motor_1 may still have current" in capsys.readouterr().out


def test_a_drive_that_cannot_end_its_quick_stop_lets_go_at_once(bench, rig_file):
    bench.drives[0].refuses = (0x605A, 0)
    bench.only(1)
    bench.moving(lambda drive: setattr(bench, "cut", True))
    assert bench.run(rig_file) == 1
    assert bench.drives[0].enables == 1
    assert bench.drives[0].history[-1] == "switch on disabled"  # by itself


def test_an_unanswered_question_releases_the_motor(bench, rig_file, capsys, monkeypatch):
    monkeypatch.setattr("plate_drives.commission.ANSWER_S", 0.5)
    ask = bench.ask

    def asked(question, meanwhile):
        while "Which distance" in question:
            meanwhile()
        return ask(question, meanwhile)

    bench.ask = asked
    bench.only(1)
    assert bench.run(rig_file) == 1
    assert "error: no answer was typed within 0.5 s" in capsys.readouterr().out
    assert all_off(bench)


def test_a_late_host_slows_the_motion_without_a_jump(bench, rig_file):
    bench.only(1)
    bench.answers["Which motor"] = "none"
    bench.moving(lambda drive: [bench.step() for _ in range(100)])
    assert bench.run(rig_file) == 1
    synced = [1e3 * at for at, identifier, _ in bench.sent if identifier == 0x80]
    gaps = [b - a for a, b in pairwise(synced)]
    assert max(gaps) >= 100
    assert min(gaps) >= 5
    reported = [data for _, i, data in bench.sent if i == RPDO + 1 and data[0] == 15]
    targets = [int.from_bytes(data[2:], "little", signed=True) for data in reported]
    steps = [b - a for a, b in pairwise(targets)]
    assert max(abs(b - a) for a, b in pairwise(steps)) < 15


def test_a_motor_at_the_end_of_its_range_stays_off(bench, rig_file, capsys):
    put(bench.drives[0], 0x607D, 1, -20_000)
    put(bench.drives[0], 0x607D, 2, PLACES[0] + 400)
    bench.only(1)
    assert bench.run(rig_file) == 1
    assert bench.drives[0].history == []
    assert "position is 5000, allowed: at least 500 counts from the ends" in capsys.readouterr().out


# The command


def test_answers_may_be_piped():
    code = """
from plate_drives.commission import ask
print([ask("a?", int), ask("b?", int)])
ask("c?", int)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], input="yes\n 3.5\n", capture_output=True, text=True
    )
    assert done.stdout == "a? b? ['yes', '3.5']\nc? "
    assert "PlateError: no answer" in done.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["linear_motors", "--bus", "nosuch"],
            "CAN bus nosuch can0 does not open (Unknown interface",
        ),
        (["desk"], "motors: drive is bridge, allowed in this program: cia402"),
        (["odrives"], "motors: drive is odrive, allowed in this program: cia402"),
        (["nosuch"], "rig is 'nosuch', allowed: desk"),
    ],
)
def test_a_failed_start_is_reported(capsys, monkeypatch, words, text):
    monkeypatch.setattr(sys, "argv", ["commission", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert f"error: {text}" in capsys.readouterr().err


def test_an_adapter_that_is_pulled_out_is_reported(capsys, monkeypatch):
    class Gone:
        def send(self, *_, **__):
            raise OSError("no such device")

        shutdown = send

    monkeypatch.setattr("plate_drives.commission.open_bus", lambda *_: Gone())
    monkeypatch.setattr(sys, "argv", ["commission", "linear_motors"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert "error: the CAN bus does not accept a frame (no such device)" in capsys.readouterr().err


def test_lost_arbitration_is_no_error_of_the_bus():
    import can

    def error(bits):
        return can.Message(arbitration_id=bits, is_error_frame=True, is_extended_id=False)

    class Bus:
        beat = can.Message(arbitration_id=0x701, data=b"\x05", is_extended_id=False)
        frames = (error(0x002), beat, error(0x004))

        def recv(self, _):
            frame, *self.frames = self.frames
            return frame

    frames = Master(Bus()).frames(float("inf"))
    assert next(frames) == (0x701, b"\x05")
    with pytest.raises(PlateError, match="error on the CAN bus"):
        next(frames)


def test_a_negative_code_is_reported_as_the_drive_sends_it():
    assert "is FFFFFFFFh" in trouble_text(2, Trouble.WRONG_DRIVE, 0x6061, -1)


def test_a_missing_python_can_is_reported(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "can", None)
    monkeypatch.setattr(sys, "argv", ["commission", "linear_motors"])
    with pytest.raises(SystemExit):
        main()
    assert "error: python-can is not installed: pip install python-can" in capsys.readouterr().err


def test_an_empty_bus(capsys, monkeypatch):
    words = ["commission", "linear_motors", "--bus", "virtual", "--channel", "empty"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 1
    output = capsys.readouterr().out
    assert output.startswith(
        "no node answers on the bus\nWRONG: motor_1: node 1 does not answer, nodes on the bus: none"
    )
