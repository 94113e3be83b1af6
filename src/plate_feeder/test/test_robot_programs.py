"""The robot programs of examples/robots, word for word, served by the feeder over TCP."""

import math
import socket
import threading
from pathlib import Path

import numpy as np
import pytest
from rapid import MOST_RETRIES, Named, Rapid, Record
from robot_language import Robot, Stopped
from scipy.spatial.transform import Rotation
from urscript import Pose, URScript

from plate_core import load_rig
from plate_core.tasks import FeedTask, Pick
from plate_feeder import Feeder, FeedStatus, HandEye, ReadyPart
from plate_feeder.lines import part_text
from plate_feeder.server import RobotServer

ROBOTS = Path(__file__).resolve().parents[3] / "examples/robots"
PROGRAMS = {
    "URScript": (ROBOTS / "feeder.script").read_text(encoding="utf-8"),
    "RAPID": (ROBOTS / "FeederClient.mod").read_text(encoding="utf-8"),
}
TASK = FeedTask(
    picks=(Pick("a_class_of_parts_with_a_long_name", 1, low=(-0.2, -0.2), high=(0.2, 0.2)),),
    clearance_m=0.006, timeout_s=100.0, valid_s=10.0,
)  # fmt: skip
PART = ReadyPart("a_class_of_parts_with_a_long_name_7", 0.0123, -0.0456, math.radians(-100))
HAND_EYE = HandEye("robot_base", angle=math.radians(30), x=0.4, y=-0.2)
Z_M, ABOVE_M = 0.05, 0.1
MOST_SLEEPS = 15
ANSWER_S = 5.0  # real time


class Done(Exception):
    """The program has run as long as a test needs."""


class Cell:
    """The feeder's rules on a plate on which one part is ready, behind the server for robots.

    The plate goes on in cycles of 0.1 s of its own clock while a robot waits for it, or sleeps.
    """

    def __init__(self):
        self.feeder, self.t, self.ready = Feeder(TASK, load_rig("")), 100.0, (PART,)
        self.codes, self.mode, self.mute, self.waiting = [], None, set(), {}
        self.server = RobotServer("127.0.0.1", 0, self.ask, self.feeder.gone)

    def cycle(self):
        self.t += 0.1
        output = self.feeder.step(self.t)
        if output.run:
            status = FeedStatus(self.t, output.order.mode, True, self.ready)
            self.feeder.hear(status, self.t)
        for client, reply in (*output.replies, *self.feeder.step(self.t).replies):
            self.answer(reply, self.waiting.pop(client))

    def asleep(self, seconds):
        for _ in range(round(10 * seconds)):
            self.cycle()

    def ask(self, client, command, answer):
        if command.name in self.mute:
            return
        if command.name == "get_part":
            self.waiting[client] = answer
            reply = self.feeder.get_part(client, timeout_s=command.timeout_s, now=self.t)
        else:
            reply = self.feeder.part_taken(client, command.part, command.taken)
        if reply is not None:
            self.waiting.pop(client, None)
            self.answer(reply, answer)
        while self.waiting:
            self.cycle()

    def answer(self, reply, answer):
        self.codes.append(int(reply.code))
        text = reply.text
        if reply.part is not None:
            text = part_text(HAND_EYE.part(reply.part), reply.valid_until - self.t)
        answer(reply.code, text)


@pytest.fixture
def cell():
    cell = Cell()
    yield cell
    cell.server.close()


class Program:
    """A robot program, and what its integrator adds, until a test has seen enough."""

    def __init__(self, language, port):
        self.robot, self.language, self.has_part = Robot(port), language, True
        self.most, self.closing = 1, lambda: None  # tries; what happens as the gripper closes
        self.robot.asleep = self.asleep
        self.sleeping, self.sleeps = lambda _: None, MOST_SLEEPS
        routines = {"place": self.place}
        if language == "URScript":
            data = {"Z_PICK": Z_M}
            routines |= {"close_gripper": self.close, "move_off_the_plate": self.leave}
            self.program = URScript(PROGRAMS[language], self.robot, data | routines)
        else:
            # Not where the part is: only configuration and axes are used.
            above = Record("robtarget", [[1, 2, 3], [1, 0, 0, 0], [0, -1, 0, 1], 6 * [9e9]])
            data = {"zPick": 1e3 * Z_M, "pAbovePlate": above, "hasPart": False}
            data |= {name: Named("speeddata", name) for name in ("v200", "v1000")}
            data |= {name: Named("zonedata", name) for name in ("fine", "z10")}
            data |= {"tGripper": Named("tooldata", ""), "wobjRobot": Named("wobjdata", "robot")}
            routines |= {"CloseGripper": self.close, "LeavePlate": self.leave}
            self.program = Rapid(PROGRAMS[language], self.robot, data | routines)

    def run(self, tries=1, sleeps=MOST_SLEEPS):
        self.most, self.sleeps = tries, sleeps
        with pytest.raises(Done):
            self.program.call("Feed" if self.language == "RAPID" else "feed")
        return self.robot.events

    def asleep(self, seconds):
        assert seconds == 1
        self.robot.tell("sleep")
        self.sleeping(seconds)
        self.sleeps -= 1
        if not self.sleeps:
            raise Done

    def close(self):
        self.robot.tell("close")
        self.closing()
        if self.language == "RAPID":
            self.program.globals["haspart"].set(self.has_part)
        return self.has_part

    def leave(self):
        self.robot.tell("leave")
        self.most -= 1
        if self.most < 0:
            raise Done

    def place(self):
        self.robot.tell("place")

    def told(self, kind):
        return [event[1:] for event in self.robot.events if event[0] == kind]


@pytest.fixture(params=["URScript", "RAPID"])
def program(request, cell):
    program = Program(request.param, cell.server.port)
    program.sleeping = cell.asleep
    yield program
    program.robot.switch_off()


def place_of(to):
    """Return position [m] and rotation of a move."""
    if isinstance(to, Pose):
        return np.array(to[:3]), to.turn
    w, x, y, z = to.parts["rot"].numbers
    return np.array(to.parts["trans"].numbers) / 1e3, Rotation.from_quat([x, y, z, w])


def test_the_tool_goes_to_the_part_and_down_and_up(program):
    events = program.run()
    assert program.told("connect") == [("192.168.0.2", 7171)]
    kinds = [event[0] for event in events if event[0] != "connect"]
    assert kinds[:9] == ["send", "move", "move", "close", "move", "leave", "send", "place", "send"]
    # The plate's frame turned and shifted, in complex numbers.
    where = (PART.x + 1j * PART.y) * np.exp(1j * HAND_EYE.angle) + HAND_EYE.x + 1j * HAND_EYE.y
    angle = PART.angle + HAND_EYE.angle
    over, grip, away = (place_of(event[0]) for event in program.told("move")[:3])
    for (place, turn), z in ((over, Z_M + ABOVE_M), (grip, Z_M), (away, Z_M + ABOVE_M)):
        assert place == pytest.approx([where.real, where.imag, z], abs=6e-6)  # mm, two decimals
        assert turn.apply([0, 0, 1]) == pytest.approx([0, 0, -1], abs=1e-9)
        assert turn.apply([1, 0, 0]) == pytest.approx(
            [math.cos(angle), math.sin(angle), 0], abs=1e-4
        )
    if program.language == "RAPID":
        assert [event[1:] for event in program.told("move")[:3]] == [
            ("z10", "robot"), ("fine", "robot"), ("z10", "robot")
        ]  # fmt: skip
        assert program.told("move")[1][0].parts["robconf"].numbers == [0, -1, 0, 1]


@pytest.mark.parametrize("has_part", [True, False])
def test_a_part_that_is_taken_and_one_that_is_not(program, cell, has_part):
    program.has_part = has_part
    program.run()
    report = "part_taken ok" if has_part else "part_taken failed"
    assert program.told("send")[:3] == [("get_part 30",), (report,), ("get_part 30",)]
    assert len(program.told("place")) == cell.feeder.quantity().taken == has_part
    assert set(cell.codes) == {200}


def test_no_part_in_time_is_told_and_asked_again(program, cell):
    cell.ready = ()

    def come(seconds):
        cell.asleep(seconds)
        cell.ready = (PART,)

    program.sleeping = come
    program.run()
    assert cell.codes[:3] == [504, 200, 200]
    (line,) = program.told("message")[0]
    assert line.removeprefix("feeder: ").startswith("504 no part was ready within 30 s: ")
    assert len(program.told("message")) == len(program.told("connect")) == 1


def test_a_stopped_plate_is_told_and_asked_again_until_it_goes_on(program, cell):
    cell.feeder.stop("somebody has pressed the button, which is a long reason to write down")

    def resume(seconds):
        cell.asleep(seconds)
        if cell.codes == [503, 503]:
            cell.feeder.resume()

    program.sleeping = resume
    program.run()
    assert cell.codes[:3] == [503, 503, 200]
    (line,) = program.told("message")[0]
    assert line.removeprefix("feeder: ").startswith("503 stopped until a person calls resume_")
    if program.language == "RAPID":
        assert len(line) == 80  # no string is longer


def test_without_an_answer_in_time_it_asks_again_on_a_new_connection(program, cell):
    program.robot.real_s = 0.1
    cell.mute = {"get_part"}

    def speak(seconds):
        program.robot.real_s = ANSWER_S
        cell.mute = set()
        cell.asleep(seconds)

    program.sleeping = speak
    program.run()
    assert program.robot.t == 35 + 1
    assert program.told("message")[0][0].endswith("no answer")
    assert len(program.told("connect")) == 2
    assert program.told("place")


def test_a_report_without_an_answer_does_not_mix_up_the_answers(program, cell):
    cell.mute = {"part_taken"}

    def hurry():
        program.robot.real_s = 0.1

    def speak(seconds):
        program.robot.real_s = ANSWER_S
        cell.mute = set()
        cell.asleep(seconds)

    program.closing, program.sleeping = hurry, speak
    program.run()
    # The part is kept until the end of its time, since the robot may stand over the plate.
    first = cell.codes.index(200, 1)
    assert cell.codes[0] == 200
    assert cell.codes[1:first] == (first - 1) * [409]
    assert 9 <= first - 1 <= 11
    assert program.told("message")[0][0].removeprefix("feeder: ").startswith("409 ")


def test_a_lost_connection_is_made_anew(program, cell):
    port = cell.server.port

    def crash():
        program.closing = lambda: None
        cell.server.close()
        cell.waiting.clear()

    def back(seconds):
        if len(program.told("sleep")) == 3:
            cell.server = RobotServer("127.0.0.1", port, cell.ask, cell.feeder.gone)
        cell.asleep(seconds)

    program.closing, program.sleeping = crash, back
    program.run(tries=1)
    lines = [line.removeprefix("feeder: ") for (line,) in program.told("message")]
    lost = lines.count("no answer")
    assert 2 <= lost <= 4
    assert lines[:lost] == lost * ["no answer"]
    assert {line[:4] for line in lines[lost:]} == {"409 "}
    assert len(program.told("connect")) >= 3
    assert len(program.told("close")) == 2


@pytest.mark.parametrize("language", PROGRAMS)
@pytest.mark.parametrize(
    ("piece", "size"), [(1, 128), (7, 128), (81, 128), (300, 128), (300, 84), (300, 83), (300, 82)]
)
def test_an_answer_that_comes_in_pieces(language, piece, size):
    """TCP is a stream: a line may be cut anywhere."""
    line = b"200 x=-1234.56 y=-5.60 angle=-112.30 valid_s=10.0 class="
    lines = [line.ljust(size - 2, b"c") + b"\r\n", b"200 is taken\r\n"]
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        link, _ = server.accept()
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for line in lines:
            link.recv(100)
            for at in range(0, len(line), piece):
                link.sendall(line[at : at + piece])
                threading.Event().wait(0.0003)
        link.recv(100)
        link.close()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    program = Program(language, server.getsockname()[1])
    program.run(sleeps=1)
    program.robot.switch_off()
    thread.join()
    server.close()
    place, turn = place_of(program.told("move")[1][0])
    assert place == pytest.approx([-1.23456, -0.0056, Z_M])
    assert math.degrees(turn.as_euler("ZYX")[0]) == pytest.approx(-112.3)
    assert program.told("place")


# The interpreters, by the manuals' examples


def urscript(line, **given):
    program = f"def main():\n  return {line}\nend\n"
    return URScript(program, Robot(0), given).call("main")


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ('str_find("Hello World!", "o")', 4),
        ('str_find("Hello World!", "o", 5)', 7),
        ('str_find("Hello World!", "lorem")', -1),
        ('str_len("Hello")', 5),
        ('str_sub("0123456789abcdefghij", 5, 3)', "567"),
        ('str_sub("0123456789abcdefghij", 15)', "fghij"),
        ('str_sub("0123456789abcdefghij", 10, 15)', "abcdefghij"),
        ('str_empty("")', True),
        ('to_num("10")', 10),
        ('to_num("-2.5E-5")', -2.5e-5),
        ('to_num(" .36")', 0.36),
        ("1 + 2 * 3 - 4.0 / 2", 5.0),
        ("not 1 == 2 and (2 > 1 or False)", True),
        ("d2r(180)", math.pi),
    ],
)
def test_urscript(line, value):
    got = urscript(line)
    assert got == value
    assert type(got) is type(value)


def test_pose_trans_is_the_manuals():
    got = urscript("pose_trans(p[0.2, 0.5, 0.1, 1.57, 0, 0], p[0.2, 0.5, 0.6, 1.57, 0, 0])")
    assert list(got) == pytest.approx([0.4, -0.0996, 0.60048, 3.14, 0, 0], abs=1e-4)


@pytest.mark.parametrize(
    "line",
    [
        'to_num("200 is")', 'to_num("")', 'str_sub("abc", 4, 1)', 'str_sub("abc", 1, -1)',
        "nothing", "nothing(1)", 'str_len(5)', "str_len()", '"a" + "b"', '"a" == 1', "1 / 2",
        'd2r("1")', "p[1, 2, 3]", "movel([1])", "not 1", '1 + True', "1 +", "main", "end",
    ],
)  # fmt: skip
def test_urscript_stops(line):
    with pytest.raises(Stopped):
        urscript(line)


def test_scopes_of_urscript():
    program = """
def main():
  global a = 1
  b = 2
  def inner(c):
    a = a + c
    local b = 5
    return b
  end
  if inner(2) == 6:
    b = 9
  elif a == 3:
    b = b + 1
  else:
    b = 7
  end
  while a < 10:
    a = a + 1
  end
  return a * 100 + b
end
"""
    assert URScript(program, Robot(0)).call("main") == 1003
    for wrong in (
        "  if 1:\n    a = 1\n  end",
        "  a = 1",
        "  def str_len(a):\n  end",
        "  while True:",
    ):
        with pytest.raises(Stopped):
            URScript(f"def main():\n{wrong}\n  return a\n", Robot(0)).call("main")
    with pytest.raises(Stopped, match="arguments"):
        URScript("def f(a):\n  return a\nend\n", Robot(0)).call("f")


def rapid(kind, line):
    program = f"""
MODULE Test
  VAR socketdev device;
  FUNC {kind} Main()
    VAR num found;
    RETURN {line};
  ENDFUNC
ENDMODULE"""
    return Rapid(program, Robot(0)).call("main")


@pytest.mark.parametrize(
    ("kind", "line", "value"),
    [
        ("num", 'StrMatch("Robotics", 1, "bo")', 3),
        ("num", 'StrMatch("Robotics", 4, "bo")', 9),  # length and one: not found
        ("string", 'StrPart("Robotics", 1, 5)', "Robot"),
        ("num", 'strlen("Robotics")', 8),
        ("num", 'StrLen("\\0A" + "\\41""\\\\")', 4),
        ("bool", 'StrToVal("3.85", found) AND found = 3.85', True),
        ("bool", 'StrToVal("x", found)', False),
        ("num", "1 + 2 * 3 - 4 / 2", 5),
        ("bool", "NOT 1 = 1 AND 2 < 1", True),  # NOT is looser than AND
        ("num", "SocketGetStatus(device)", 5),
    ],
)
def test_rapid(kind, line, value):
    assert rapid(kind, line) == value


TURNS = """
MODULE T
  PROC P()
    VAR robtarget a;
    a.rot := OrientZYX(%g, %g, %g);
    See a;
  ENDPROC
ENDMODULE"""


@pytest.mark.parametrize("angles", [(30, 0, 180), (20, -50, 70)])
def test_orient_zyx_turns_about_z_then_the_new_y_then_the_new_x(angles):
    seen = []
    Rapid(TURNS % angles, Robot(0), {"see": seen.append}).call("p")
    z, y, x = (np.radians(angle) for angle in angles)
    about_z, about_y, about_x = map(Rotation.from_rotvec, ([0, 0, z], [0, y, 0], [x, 0, 0]))
    error = about_z * about_y * about_x * place_of(seen[0])[1].inv()
    assert error.magnitude() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    "line",
    [
        'StrPart("abc", 0, 1)', 'StrPart("abc", 2, 3)', 'StrMatch("abc", 4, "a")', "nothing",
        "StrLen(1)", 'StrLen("a", 1)', 'StrLen("a" \\b)', '"a" + 1', '1 + "a"', '"a"', "TRUE",
        f'StrLen("{41 * "a"}" + "{40 * "a"}")', "[1, 2]", "found.x", "Bad()x", "1 = 1",
    ],
)  # fmt: skip
def test_rapid_stops(line):
    with pytest.raises(Stopped):
        rapid("num", line)


@pytest.mark.parametrize(
    "program",
    [
        "MODULE Feeder VAR num feeder; ENDMODULE",  # names are the same in capitals
        "MODULE T VAR num to; ENDMODULE",
        "MODULE T VAR pos a; ENDMODULE",
        "MODULE T PROC P() ENDPROC PROC p() ENDPROC ENDMODULE",
        "MODULE T PROC P() x := 1 ENDPROC ENDMODULE",
        "MODULE T",
    ],
)
def test_modules_that_do_not_load(program):
    with pytest.raises(Stopped):
        Rapid(program, Robot(0))


@pytest.mark.parametrize(
    ("handler", "seen"),
    [
        ("TRYNEXT;", [1, 2]),
        ("RETURN;", [1]),
        ("RETRY;", None),  # again and again, and stops
        ("RAISE;", None),  # nobody else catches it
        ("", None),
        ("IF ERRNO = ERR_SOCK_CLOSED TRYNEXT;", [1, 2]),
        ("IF ERRNO = ERR_SOCK_TIMEOUT TRYNEXT;", None),
    ],
)
def test_error_handlers(handler, seen):
    program = f"""
MODULE T
  VAR socketdev device;
  PROC P()
    See 1;
    SocketSend device \\Str:="a";
    See 2;
  ERROR
    {handler}
  ENDPROC
ENDMODULE"""
    got, robot = [], Robot(0)
    module = Rapid(program, robot, {"see": got.append})
    if seen is None:
        with pytest.raises((Stopped, Exception), match=r"ERR_SOCK_CLOSED|retries"):
            module.call("p")
        assert len(robot.events) == (MOST_RETRIES + 1 if handler == "RETRY;" else 1)
    else:
        module.call("p")
        assert got == seen
