"""The dialogue of the robot programs in examples/robots, played with the feeder over TCP.

A client sends the commands that a program contains, and reads its numbers by the names that it
contains. Nothing runs the program itself.
"""

import cmath
import math
import re
import socket
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


class Cell:
    """The feeder's rules on a plate with one ready part, behind the server for robots.

    The plate moves on in cycles of 0.1 s of its own clock while a robot waits for it, or pauses.
    """

    def __init__(self):
        self.feeder, self.t, self.ready = Feeder(TASK, load_rig("")), 100.0, (PART,)
        self.waiting = {}
        self.server = RobotServer("127.0.0.1", 0, self.ask, self.feeder.remove_client)

    def cycle(self):
        self.t += 0.1
        output = self.feeder.step(self.t)
        if output.run:
            status = FeedStatus(self.t, output.order.mode, True, self.ready)
            self.feeder.receive_status(status, self.t)
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
        reported = re.findall(r'\bask\("([^"]+)", (\d+)\)', program, re.IGNORECASE)
        self.patience_s = {command: float(seconds) for command, seconds in reported}
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
