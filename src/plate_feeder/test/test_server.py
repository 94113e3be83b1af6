"""The server over real sockets, with a stub in place of the feeder."""

import contextlib
import random
import re
import socket
import struct
import time

import pytest

from plate_core import PlateError
from plate_feeder import Code
from plate_feeder import server as module
from plate_feeder.lines import MAX_LINE, WAITING
from plate_feeder.server import MAX_ANSWERS, MAX_CLIENTS, MAX_WAITING, RobotServer

LONG_S = 20.0
"""Longest wait of a test [s]."""

ANSWER = re.compile(rb"[245]\d\d [ -~]+\r\n")


class Stub:
    """Replies at once, except to commands that wait: to those when a test releases them."""

    def __init__(self):
        self.commands, self.waiting, self.disconnected = [], [], set()
        self.robots, self.mute, self.prompt = [], False, False
        self.server = RobotServer("127.0.0.1", 0, self.ask, self.disconnected.add)

    def ask(self, client, command, answer):
        self.commands.append(command.name)
        if command.name in WAITING and not self.prompt:
            self.waiting.append((client, answer))
        elif not self.mute:
            answer(Code.DONE, command.name)

    def connect(self):
        self.robots.append(Robot(self.server.port))
        return self.robots[-1]

    def leave(self):
        """Close all clients."""
        while self.robots:
            self.robots.pop().close()

    def close(self):
        self.server.close()
        assert not self.server._thread.is_alive()


class Robot:
    """A client."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=LONG_S)
        self.file = self.socket.makefile("rb")

    def send(self, data):
        with contextlib.suppress(OSError):  # the server may have closed the connection
            self.socket.sendall(data)

    def line(self):
        """Return a reply. It is empty if the server has closed the connection."""
        try:
            return self.file.readline()
        except ConnectionError:
            return b""

    def lines(self):
        return list(iter(self.line, b""))

    def say(self, text):
        self.send(text.encode() + b"\n")
        return self.line()

    def close(self):
        self.file.close()
        self.socket.close()


def until(condition):
    end = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.fixture
def stub():
    stub = Stub()
    yield stub
    stub.leave()
    until(lambda: not stub.server.clients)
    assert stub.connect().say("help").startswith(b"200 ")  # it lives, whatever has been
    stub.leave()
    stub.close()


@pytest.fixture
def robot(stub):
    return stub.connect()


def test_each_command_is_answered_by_one_line(robot):
    assert robot.say("state") == b"200 state\r\n"
    assert robot.say("nonsense").startswith(b"404 ")
    assert robot.say("get_part x y z").startswith(b"422 ")
    assert b"part_quantity" in robot.say("help")


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_any_end_of_line(robot, end):
    robot.send(end.join([b"state", b"part_quantity", b""]))
    assert robot.line() == b"200 state\r\n"
    assert robot.line() == b"200 part_quantity\r\n"


def test_a_line_may_come_byte_by_byte(robot):
    for byte in b"state\n":
        robot.send(bytes([byte]))
        time.sleep(0.002)
    assert robot.line() == b"200 state\r\n"


def test_commands_wait_for_the_one_before_and_too_many_are_refused(stub, robot):
    robot.send(b"get_part\n")
    until(lambda: stub.waiting)
    robot.send(b"state\n" * (MAX_WAITING + 2))
    other = stub.connect()
    assert other.say("state") == b"200 state\r\n"  # others need not wait
    time.sleep(0.1)
    assert stub.commands == ["get_part", "state"]
    stub.waiting.pop()[1](Code.DONE, "a part")
    got = [robot.line() for _ in range(MAX_WAITING + 3)]
    assert got[0] == b"200 a part\r\n"
    assert got[1 : MAX_WAITING + 1] == MAX_WAITING * [b"200 state\r\n"]
    assert [line[:4] for line in got[MAX_WAITING + 1 :]] == 2 * [b"429 "]


def test_a_client_that_disconnects_while_it_waits_is_reported(stub):
    robot = stub.connect()
    robot.send(b"get_part\n")
    until(lambda: stub.waiting)
    client, answer = stub.waiting.pop()
    robot.close()
    until(lambda: stub.disconnected)
    assert stub.disconnected == {client}
    answer(Code.DONE, "too late")


def test_a_client_that_only_sends_is_still_answered(robot, monkeypatch):
    """`printf 'state\\n' | nc localhost 7171`"""
    monkeypatch.setattr(module, "LAST_S", LONG_S)
    robot.send(b"state\nhelp\n")
    robot.socket.shutdown(socket.SHUT_WR)
    assert [line[:4] for line in robot.lines()] == 2 * [b"200 "]


def test_too_long_a_line_ends_the_connection(robot):
    robot.send(b"x" * (MAX_LINE + 1))
    assert [line[:4] for line in robot.lines()] == [b"400 "]


def test_an_incomplete_line_is_refused_after_a_timeout(stub, robot, monkeypatch):
    monkeypatch.setattr(module, "LINE_S", 0.2)
    robot.send(b"sta")
    assert robot.line().startswith(b"400 ")
    assert robot.line() == b""


def test_a_silent_client_is_disconnected_after_a_long_time(stub, monkeypatch):
    waiting = stub.connect()
    assert waiting.say("state").startswith(b"200 ")
    monkeypatch.setattr(module, "IDLE_S", 0.3)  # after the next line of this client
    waiting.send(b"get_part\n")
    assert stub.connect().line() == b""
    time.sleep(0.5)
    stub.waiting.pop()[1](Code.DONE, "a part")  # that one was not silent: it waited
    assert waiting.line() == b"200 a part\r\n"


def test_a_client_that_reads_no_replies_is_disconnected(stub, monkeypatch):
    monkeypatch.setattr(module, "SENT_S", 0.3)
    robot = stub.connect()
    robot.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    end = time.monotonic() + LONG_S
    robot.socket.settimeout(0.1)
    while not stub.disconnected and time.monotonic() < end:
        with contextlib.suppress(OSError):
            robot.socket.sendall(b"help\n")
    assert stub.disconnected


def test_a_missing_reply_of_the_feeder_is_reported_to_the_robot(stub, robot, monkeypatch):
    monkeypatch.setattr(module, "ANSWER_S", 0.2)
    stub.mute = True
    assert robot.say("state").startswith(b"500 ")


def test_a_web_page_cannot_command(stub, robot):
    robot.send(b"POST / HTTP/1.1\r\nHost: localhost:7171\r\n\r\nget_part\n")
    assert robot.lines() == []
    assert stub.commands == []


def test_the_number_of_clients_is_limited(stub):
    robots = [stub.connect() for _ in range(MAX_CLIENTS)]
    assert {robot.say("state") for robot in robots} == {b"200 state\r\n"}
    late = stub.connect()
    assert [line[:4] for line in late.lines()] == [b"429 "]
    robots.pop().close()
    until(lambda: stub.server.clients < MAX_CLIENTS)
    assert stub.connect().say("state") == b"200 state\r\n"


@pytest.mark.parametrize("seed", range(6))
def test_random_bytes_get_one_reply_per_line_or_end_the_connection(stub, seed, monkeypatch):
    """Each line that is not empty is answered by one line, or the connection is closed."""
    monkeypatch.setattr(module, "LAST_S", LONG_S)
    stub.prompt = True
    rng = random.Random(seed)
    words = [b"get_part", b"state", b"purge", b"part_taken", b"help", b"black_1", b"ok", b"-1",
             b"\xff\x00", b"9" * 40, b"\t"]  # fmt: skip
    for _ in range(12):
        robot = stub.connect()
        data = b""
        for _ in range(rng.randrange(1, 40)):
            if rng.random() < 0.5:
                data += b" ".join(rng.choices(words, k=rng.randrange(1, 4)))
            else:
                data += rng.randbytes(rng.randrange(1, 100))
            data += rng.choice([b"\n", b"\r\n", b"\r"])
        if rng.random() < 0.3:
            data += 300 * b"e"
        sent = [line for line in data.replace(b"\r", b"\n").split(b"\n") if line]
        for at in range(0, len(data), size := rng.randrange(1, 2000)):
            robot.send(data[at : at + size])
        robot.socket.shutdown(socket.SHUT_WR)
        got = robot.lines()
        assert all(ANSWER.fullmatch(line) for line in got)
        assert len(got) == len(sent)
    until(lambda: not stub.server.clients)


@pytest.mark.parametrize("seed", range(3))
def test_clients_that_die_anywhere(stub, seed):
    rng = random.Random(seed)
    for _ in range(60):
        robot = stub.connect()
        robot.send(b"state\nget_part\nstate\nget_part"[: rng.randrange(30)])
        if rng.random() < 0.5:
            time.sleep(0.01 * rng.random())
        if rng.random() < 0.5:  # as a process that is killed
            robot.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        robot.close()
        while stub.waiting and rng.random() < 0.5:
            stub.waiting.pop(0)[1](Code.NO_PART, "none")
    until(lambda: not stub.server.clients)


def test_a_flood_of_lines_does_not_grow(stub, robot):
    robot.send(b"get_part\n")
    until(lambda: stub.waiting)
    robot.send(b"state\n" * 100_000)
    until(lambda: stub.disconnected)
    got = robot.lines()
    assert len(got) <= MAX_ANSWERS + 2


def test_waiting_requests_are_answered_before_the_server_closes():
    stub = Stub()
    robot = stub.connect()
    robot.send(b"get_part\n")
    until(lambda: stub.waiting)
    stub.waiting.pop()[1](Code.STOPPED, "deactivated")
    stub.close()
    assert robot.lines() == [b"503 deactivated\r\n"]
    with pytest.raises(ConnectionRefusedError):
        stub.connect()
    stub.leave()


def test_a_port_that_is_taken_is_refused(stub):
    with pytest.raises(PlateError, match=str(stub.server.port)):
        RobotServer("127.0.0.1", stub.server.port, stub.ask, stub.disconnected.add)
    with pytest.raises(PlateError, match=r"192\.0\.2\.1"):
        RobotServer("192.0.2.1", 0, stub.ask, stub.disconnected.add)
