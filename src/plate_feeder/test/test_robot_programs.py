"""The dialogue of the robot programs in examples/robots, played with the feeder over TCP.

A client sends the commands that a program contains, and reads its numbers by the names that it
contains. Nothing runs the program itself: its text is only checked for words and blocks.
"""

import cmath
import math
import re
import socket
from dataclasses import dataclass
from pathlib import Path

import pytest

from plate_core import load_rig
from plate_core.tasks import FeedTask, Pick
from plate_feeder import Feeder, FeedStatus, HandEye, ReadyPart
from plate_feeder.lines import answer_line, part_text, read_line
from plate_feeder.node import Options
from plate_feeder.server import RobotServer

ROBOTS = Path(__file__).resolve().parents[3] / "examples/robots"
PROGRAMS = {
    "RAPID": (ROBOTS / "FeederClient.mod").read_text(encoding="utf-8"),
    "URScript": (ROBOTS / "feeder.script").read_text(encoding="utf-8"),
}
TASK = FeedTask(
    picks=(Pick("a_class_of_parts_with_a_long_name", 1, low=(-0.2, -0.2), high=(0.2, 0.2)),),
    clearance_m=0.006, timeout_s=100.0, valid_s=10.0,
)  # fmt: skip
PART = ReadyPart("a_class_of_parts_with_a_long_name_7", 0.0123, -0.0456, math.radians(-100))
HAND_EYE = HandEye("robot_base", angle=math.radians(30), x=0.4, y=-0.2)
ANSWER_S = 20.0
"""Longest wait for an answer, in real time [s]."""

RAPID_STRING = 80
"""Characters of a string in RAPID: the program sees no more of a line."""


@dataclass(frozen=True)
class Syntax:
    """What a language needs: comments, blocks, declarations, and known words.

    `known` are the language's words that the programs use, and the names that the integrator adds.
    """

    comment: str
    begins: str
    ends: str
    plain: str
    declares: str
    known: str


SYNTAX = {
    "RAPID": Syntax(
        comment="!",
        begins=r"(MODULE|FUNC|PROC|WHILE|IF)\b(?!.*;$)",
        ends=r"END(MODULE|FUNC|PROC|WHILE|IF)$",
        plain=r".*;$|ELSE$|ERROR$",
        declares=r"(?:MODULE|VAR \w+) (\w+)",
        known="MODULE ENDMODULE FUNC ENDFUNC PROC ENDPROC VAR IF THEN ELSE ENDIF WHILE DO ENDWHILE "
        "RETURN ERROR EXIT NOT TRUE socketdev rawbytes byte string num robtarget trans rot "
        "SocketGetStatus SOCKET_CLOSED SocketCreate SocketConnect SocketSend SocketReceive "
        "SocketClose Str RawData Time CopyRawBytes UnpackRawBytes RawBytesLen Hex1 ASCII StrMatch "
        "StrLen StrToVal StrPart OrientZYX MoveL Offs v1000 v200 z10 fine WObj TPWrite WaitTime "
        "pAbovePlate zPick tGripper wobjRobot hasPart CloseGripper LeavePlate Place",
    ),
    "URScript": Syntax(
        comment="#",
        begins=r"(def|if|while)\b.*:$",
        ends=r"end()$",
        plain=r"else:$|.*[^:;]$",
        declares=r"local (\w+) =",
        known="def local return if else end while True p str_find str_len str_sub str_empty to_num "
        "socket_send_line socket_read_line socket_open socket_close pose_trans movel d2r textmsg "
        "sleep Z_PICK close_gripper move_off_the_plate place",
    ),
}


def faults(language, text):
    """Return lines with open brackets or texts, without their end, or with unknown words."""
    syntax = SYNTAX[language]
    lines = [
        re.sub(r'"[^"]*"', "0", line).partition(syntax.comment)[0] for line in text.split("\n")
    ]
    lines = [line.strip() for line in lines if line.strip()]
    known = set(syntax.known.split())
    for line in lines:
        known.update(re.findall(syntax.declares, line))
        if re.match("FUNC|PROC|def", line):  # its own name, and those of its arguments
            known.update(re.findall(r"\w+", line))
    found, blocks = [], []
    for line in lines:
        words = set(re.findall(r"\b[A-Za-z_]\w*", line)) - {"A"}
        closed = all(line.count(one) == line.count(other) for one, other in ("()", "[]"))
        fine = closed and '"' not in line and words <= known
        if begun := re.match(syntax.begins, line):
            blocks.append(begun[1])
        elif ended := re.match(syntax.ends, line):
            fine &= bool(blocks) and blocks.pop().startswith(ended[1])
        else:
            fine &= bool(re.match(syntax.plain, line))
        found += [] if fine else [line]
    return found + blocks


@pytest.mark.parametrize("language", PROGRAMS)
def test_a_program_is_well_formed(language):
    assert faults(language, PROGRAMS[language]) == []


@pytest.mark.parametrize(
    ("language", "right", "wrong"),
    [
        ("RAPID", "ENDIF", ""), ("RAPID", "ENDIF", "ENDWHILE"),
        ("RAPID", "WaitTime 1;", "WaitTime 1"), ("RAPID", "StrLen(name)", "StrLen(name"),
        ("RAPID", "TPWrite", "TPWrit"),
        ("RAPID", '"no answer"', '"no answer'), ("RAPID", "VAR robtarget at;", ""),
        ("URScript", "  end\n", ""), ("URScript", "True:", "True"),
        ("URScript", "place()", "plaec()"),
        ("URScript", "sleep(1)", "sleep(1"), ("URScript", '"no answer"', '"no answer'),
        ("URScript", "local at = ", ""), ("URScript", "sleep(1)", "sleep(1);"),
    ],
)  # fmt: skip
def test_a_fault_in_a_program_is_found(language, right, wrong):
    broken = PROGRAMS[language].replace(right, wrong)
    assert broken != PROGRAMS[language]
    assert faults(language, broken)


class Cell:
    """The feeder's rules on a plate with one ready part, behind the server for robots.

    The plate moves on in cycles of 0.1 s of its own clock while a robot waits for it, or pauses.
    """

    def __init__(self):
        self.feeder, self.t, self.ready = Feeder(TASK, load_rig("")), 100.0, (PART,)
        self.waiting = {}
        self.server = RobotServer("127.0.0.1", 0, self.ask, self.feeder.gone)

    def cycle(self):
        self.t += 0.1
        output = self.feeder.step(self.t)
        if output.run:
            status = FeedStatus(self.t, output.order.mode, True, self.ready)
            self.feeder.hear(status, self.t)
        for client, reply in (*output.replies, *self.feeder.step(self.t).replies):
            self.answer(reply, self.waiting.pop(client))

    def pause(self, seconds):
        for _ in range(round(10 * seconds)):
            self.cycle()

    def ask(self, client, command, answer):
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
        text = reply.text
        if reply.part is not None:
            text = part_text(HAND_EYE.part(reply.part), reply.valid_until - self.t)
        answer(reply.code, text)


class Robot:
    """The words of a program, and a client that uses them."""

    def __init__(self, program):
        said = re.findall(r'\bask\("([^"]+)", (\d+)\)', program, re.IGNORECASE)
        self.patience_s = {command: float(seconds) for command, seconds in said}
        self.get_part, self.taken, self.failed = self.patience_s
        self.names = re.findall(r'\bnumber\(line, "([^"]+)"\)', program, re.IGNORECASE)
        (self.done,) = re.findall(r'"(\d+ )"', program)
        (self.pause_s,) = map(float, re.findall(r"(?:WaitTime |sleep\()(\d+)", program))
        self.link = self.file = None

    def connect(self, port):
        self.link = socket.create_connection(("127.0.0.1", port), timeout=ANSWER_S)
        self.file = self.link.makefile("rb")

    def close(self):
        if self.link is not None:
            self.file.close()
            self.link.close()

    def ask(self, command):
        self.link.sendall(command.encode() + b"\n")
        return self.file.readline().decode()[:RAPID_STRING]

    def numbers(self, line):
        """Return the numbers after `names`, each up to the next space."""
        begins = [line.index(name) + len(name) for name in self.names]
        return [float(line[at : line.index(" ", at)]) for at in begins]


@pytest.fixture
def cell():
    cell = Cell()
    yield cell
    cell.server.close()


@pytest.fixture(params=PROGRAMS)
def robot(request, cell):
    robot = Robot(PROGRAMS[request.param])
    robot.connect(cell.server.port)
    yield robot
    robot.close()


@pytest.mark.parametrize("language", PROGRAMS)
def test_a_program_connects_to_the_default_port_and_outwaits_the_feeder(language):
    assert f'"192.168.0.2", {Options().port}' in PROGRAMS[language]
    robot = Robot(PROGRAMS[language])
    commands = {line: read_line(line.encode()) for line in robot.patience_s}
    assert [command.name for command in commands.values()] == [
        "get_part",
        "part_taken",
        "part_taken",
    ]
    assert [commands[line].taken for line in (robot.taken, robot.failed)] == [True, False]
    for line, seconds in robot.patience_s.items():
        assert seconds >= commands[line].timeout_s + 5


@pytest.mark.parametrize("has_part", [True, False])
def test_the_program_finds_the_part_and_reports_it(robot, cell, has_part):
    line = robot.ask(robot.get_part)
    assert line.startswith(robot.done)
    place = cmath.rect(1, HAND_EYE.angle) * complex(PART.x, PART.y) + complex(
        HAND_EYE.x, HAND_EYE.y
    )
    angle = math.degrees(PART.angle + HAND_EYE.angle)
    expected = [1e3 * place.real, 1e3 * place.imag, angle]
    assert robot.numbers(line) == pytest.approx(expected, abs=6e-3)  # two decimals
    assert robot.ask(robot.taken if has_part else robot.failed).startswith(robot.done)
    assert cell.feeder.quantity().taken == has_part
    cell.pause(robot.pause_s)  # a younger image shows a part there
    assert robot.ask(robot.get_part).startswith(robot.done)


def test_numbers_of_any_size_lie_within_a_string_of_rapid():
    part = ReadyPart(60 * "c", -9.99999, -9.99999, math.radians(-179.99))
    line = answer_line(200, part_text(part, 3600.0)).decode()[:RAPID_STRING]
    for program in PROGRAMS.values():
        assert Robot(program).numbers(line) == [-9999.99, -9999.99, -179.99]


def test_no_part_in_time_is_refused_and_the_next_request_gets_one(robot, cell):
    cell.ready = ()
    began = cell.t
    line = robot.ask(robot.get_part)
    assert line.startswith("504 ")
    assert not line.startswith(robot.done)
    assert cell.t - began == pytest.approx(read_line(robot.get_part.encode()).timeout_s, abs=0.3)
    cell.ready = (PART,)
    assert robot.ask(robot.get_part).startswith(robot.done)


def test_a_stopped_plate_refuses_until_a_person_resumes_it(robot, cell):
    cell.feeder.stop("somebody has pressed the button")
    for _ in range(2):
        assert robot.ask(robot.get_part).startswith("503 ")
        cell.pause(robot.pause_s)
    cell.feeder.resume()
    assert robot.ask(robot.get_part).startswith(robot.done)


def test_after_a_new_connection_the_reserved_part_blocks_until_its_time_ends(robot, cell):
    """The robot that has reserved the part may still stand over the plate."""
    assert robot.ask(robot.get_part).startswith(robot.done)
    robot.close()
    robot.connect(cell.server.port)
    refused = 0
    while (line := robot.ask(robot.get_part)).startswith("409 "):
        cell.pause(robot.pause_s)
        refused += 1
    assert refused * robot.pause_s == pytest.approx(TASK.valid_s, abs=1)
    assert line.startswith(robot.done)
