"""An interpreter of what a robot program needs of URScript (Universal Robots), from manual 5.11."""

from __future__ import annotations

import contextlib
import math
import re
import socket
from collections.abc import Callable
from typing import Any

import numpy as np
from robot_language import (
    Parser,
    Return,
    Robot,
    Stopped,
    boolean,
    number,
    run,
    text,
    whole,
)
from scipy.spatial.transform import Rotation

WORDS_OF_URSCRIPT = """
    def end while if elif else return local global break continue and or not True False
"""


class Pose(tuple[float, ...]):
    """p[x, y, z, rx, ry, rz]: metres, and a rotation vector in radians."""

    @property
    def turn(self) -> Rotation:
        return Rotation.from_rotvec(self[3:])


def pose(value: Any) -> Pose:
    if not isinstance(value, Pose):
        raise Stopped(f"{value!r} is no pose")
    return value


def pose_trans(a: Pose, b: Pose) -> Pose:
    place = np.add(a[:3], a.turn.apply(b[:3]))
    return Pose((*place.tolist(), *(a.turn * b.turn).as_rotvec().tolist()))


TO_NUM = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def to_num(line: str) -> float:
    if not TO_NUM.fullmatch(line):
        raise Stopped(f"to_num of {line!r}")
    return float(line) if re.search("[.eE]", line) else int(line)


def str_sub(line: str, index: int, length: int = 2**31 - 1) -> str:
    if not 0 <= index <= len(line) or length < 0:
        raise Stopped(f"str_sub({line!r}, {index}, {length}) is out of bounds")
    return line[index : index + length]


class URScript(Parser):
    """A program: functions by name; `call` runs one.

    Parameters
    ----------
    program : str
    robot : Robot
    given : dict
        What the integrator writes: variables, and functions without arguments.
    """

    SPLIT = re.compile(
        r"(?P<skip>[ \t]+|\#[^\n]*)|(?P<line>\n)|(?P<string>\"[^\"\n]*\")"
        r"|(?P<num>\d+(\.\d*)?([eE]-?\d+)?)"
        r"|(?P<name>[A-Za-z_]\w*)|(?P<sign>==|!=|<=|>=|[-+*/=<>(),:\[\]])"
    )
    LEVELS = (("or",), ("and",), (), ("==", "!=", "<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
    NOT_AT = 2
    WHOLE = True
    KEYWORDS = frozenset(WORDS_OF_URSCRIPT.split())

    def __init__(self, program: str, robot: Robot, given: dict[str, Any] | None = None) -> None:
        super().__init__(program)
        self.robot, self.links = robot, dict[str, socket.socket]()
        self.buffers = dict[str, bytes]()
        self.globals: dict[str, Any] = {"True": True, "False": False, **(given or {})}
        number_, name = number, (text, "socket_0")
        self.known: dict[str, tuple[Callable[..., Any], tuple[Any, ...]]] = {
            "str_find": (str.find, (text, text, (whole, 0))),
            "str_len": (len, (text,)),
            "str_sub": (str_sub, (text, whole, (whole, 2**31 - 1))),
            "str_empty": (lambda line: not line, (text,)),
            "to_num": (to_num, (text,)),
            "d2r": (math.radians, (number_,)),
            "pose_trans": (pose_trans, (pose, pose)),
            "socket_open": (self._open, (text, whole, name)),
            "socket_close": (self._close, (name,)),
            "socket_send_line": (self._send, (text, name)),
            "socket_read_line": (self._read, (name, (number_, 2))),
            "movel": (lambda to: robot.tell("move", to), (pose,)),
            "textmsg": (lambda a, b: robot.tell("message", f"{a}{b}"), (text, (text, ""))),
            "sleep": (robot.sleep, (number_,)),
        }
        run(self._block("end"), {})  # top level: definitions

    def call(self, name: str, *values: Any) -> Any:
        return self._call(name, list(values))

    # Statements

    def _block(self, *ends: str) -> list[Callable[[Any], None]]:
        found = []
        while True:
            while self.kind == "line":
                self.take()
            if self.next in ends or self.kind == "end":
                if self.kind == "end" and "end" not in ends:
                    raise Stopped("syntax: no end")
                return found
            found.append(self._statement())

    def _body(self) -> list[Callable[[Any], None]]:
        self.take(":")
        self.take("\n")
        block = self._block("end")
        if self.kind == "end":
            raise Stopped("syntax: no end")
        self.take("end")
        return block

    def _statement(self) -> Callable[[Any], None]:
        if self.took("def"):
            return self._definition()
        if self.took("while"):
            condition, block = self.expression(), self._body()

            def loop(state: Any) -> None:
                while boolean(condition(state)):
                    run(block, state)

            return loop
        if self.took("if"):
            return self._if()
        if self.took("return"):
            value = self.expression()

            def give(state: Any) -> None:
                raise Return(value(state))

            done: Callable[[Any], None] = give
        elif self.next in ("local", "global") or self.tokens[self.at + 1][1] == "=":
            done = self._assignment()
        else:
            done = self.expression()
        if self.kind != "end":
            self.take("\n")
        return done

    def _definition(self) -> Callable[[Any], None]:
        name, parameters = self.name(), []
        self.take("(")
        while not self.took(")"):
            parameters.append(self.name())
            if self.next != ")":
                self.take(",")
        body = self._body()

        def function(*values: Any) -> Any:
            if len(values) != len(parameters):
                raise Stopped(f"{name} has {len(values)} arguments, allowed: {len(parameters)}")
            try:
                run(body, dict(zip(parameters, values, strict=True)))
            except Return as back:
                return back.value
            return None

        def define(_: Any) -> None:
            if name in self.known or name in self.KEYWORDS:
                raise Stopped(f"{name} is taken")
            self.globals[name] = function

        return define

    def _if(self) -> Callable[[Any], None]:
        branches = []
        word = "elif"
        while word != "end":
            condition = self.expression() if word == "elif" else lambda _: True
            self.take(":")
            self.take("\n")
            branches.append((condition, self._block("elif", "else", "end")))
            word = self.take(*(("elif", "else", "end") if word == "elif" else ("end",)))

        def choose(state: Any) -> None:
            for condition, block in branches:
                if boolean(condition(state)):
                    run(block, state)
                    break

        return choose

    def _assignment(self) -> Callable[[Any], None]:
        scope = self.take() if self.next in ("local", "global") else ""
        name = self.name()
        self.take("=")
        value = self.expression()
        if name in self.KEYWORDS or name in self.known:
            raise Stopped(f"{name} is taken")

        def assign(state: Any) -> None:
            got = value(state)
            if got is None:
                raise Stopped(f"{name} gets no value")
            free = name in self.globals and name not in state
            (self.globals if scope == "global" or (not scope and free) else state)[name] = got

        return assign

    # Expressions

    def term(self) -> Callable[[Any], Any]:
        kind, word = self.kind, self.take()
        if kind == "string":
            return lambda _: word[1:-1]
        if kind == "num":
            constant = to_num(word)
            return lambda _: constant
        if word == "(":
            inner = self.expression()
            self.take(")")
            return inner
        if word == "p" and self.took("["):
            values = self.items("]")
            if len(values) != 6:
                raise Stopped(f"a pose of {len(values)} numbers, allowed: 6")
            return lambda state: Pose(float(number(each(state))) for each in values)
        if kind != "name" or word in self.KEYWORDS - {"True", "False"}:
            raise Stopped(f"syntax: {word!r}")
        if self.took("("):
            values = self.items(")")
            return lambda state: self._call(word, [each(state) for each in values])
        return lambda state: self._value(word, state)

    def _value(self, name: str, state: dict[str, Any]) -> Any:
        for scope in (state, self.globals):
            if name in scope and not callable(scope[name]):
                return scope[name]
        raise Stopped(f"{name} is not declared")

    def _call(self, name: str, values: list[Any]) -> Any:
        if name not in self.known:
            function = self.globals.get(name)
            if not callable(function):
                raise Stopped(f"{name} is no function")
            return function(*values)
        function, wanted = self.known[name]
        least = sum(not isinstance(each, tuple) for each in wanted)
        if not least <= len(values) <= len(wanted):
            raise Stopped(f"{name} has {len(values)} arguments, allowed: {least} to {len(wanted)}")
        defaults = [each[1] for each in wanted[len(values) :]]
        checks = [each[0] if isinstance(each, tuple) else each for each in wanted]
        return function(*(ok(each) for ok, each in zip(checks, values + defaults, strict=True)))

    # Sockets

    def _open(self, address: str, port: int, name: str) -> bool:
        if name in self.links:
            raise Stopped(f"socket {name} is open")
        link = self.robot.connect(address, port)
        if link is not None:
            self.links[name], self.buffers[name] = link, b""
        return link is not None

    def _close(self, name: str) -> None:
        if link := self.links.pop(name, None):
            link.close()

    def _send(self, line: str, name: str) -> bool:
        self.robot.tell("send", line)
        link = self.links.get(name)
        with contextlib.suppress(OSError):
            if link is not None:
                link.sendall(line.encode("ascii") + b"\n")
                return True
        return False

    def _read(self, name: str, longest: float) -> str:
        """A line without its end; empty if it does not come in time, or cannot."""
        while b"\n" not in self.buffers.get(name, b""):
            link = self.links.get(name)
            chunk = self.robot.receive(link, 4096, longest) if link is not None else b""
            if not chunk:
                return ""
            self.buffers[name] += chunk
        line, self.buffers[name] = self.buffers[name].split(b"\n", 1)
        return line.removesuffix(b"\r").decode("ascii")
