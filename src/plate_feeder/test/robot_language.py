"""What interpreters of robots' languages have in common: a parser of expressions, and a robot.

They are stricter than the robots: what they do not know, a wrong type, an undeclared name, or an
error that the manual leaves open stops the program (`Stopped`), and no error handler catches that.
Socket functions are those of a `Robot`; its moves and messages are events.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


class Stopped(Exception):
    """The program has stopped with an error."""


class Return(Exception):
    def __init__(self, value: Any = None) -> None:
        self.value = value


@dataclass
class Robot:
    """What a program does; time passes when it sleeps or waits in vain.

    `port` is a server's on this machine, whatever address the program names; `real_s` bounds the
    wait for an answer in real time.
    """

    port: int
    real_s: float = 5.0
    t: float = 0.0
    events: list[tuple[Any, ...]] = field(default_factory=list)
    asleep: Callable[[float], None] = lambda _: None
    links: list[socket.socket] = field(default_factory=list)

    def tell(self, *event: Any) -> None:
        self.events.append(event)

    def sleep(self, seconds: float) -> None:
        self.t += seconds
        self.asleep(seconds)

    def connect(self, address: str, port: int) -> socket.socket | None:
        self.tell("connect", address, port)
        try:
            self.links.append(socket.create_connection(("127.0.0.1", self.port), self.real_s))
        except OSError:
            return None
        return self.links[-1]

    def switch_off(self) -> None:
        while self.links:
            self.links.pop().close()

    def receive(self, link: socket.socket, size: int, longest: float) -> bytes | None:
        """Return what has come, empty if the connection is gone, None if nothing comes in time."""
        link.settimeout(min(longest, self.real_s) if longest > 0 else self.real_s)
        try:
            return link.recv(size)
        except TimeoutError:
            self.t += longest
            return None
        except OSError:
            return b""


class Parser:
    """Tokens, and expressions by precedence. Parts of a program become functions of its state."""

    SPLIT: re.Pattern[str]
    LEVELS: tuple[tuple[str, ...], ...]  # of two operands, the loosest first

    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text):
            match = self.SPLIT.match(text, at)
            if not match:
                raise Stopped(f"syntax: {text[at : at + 30]!r}")
            if match.lastgroup != "skip":
                self.tokens.append((str(match.lastgroup), match.group()))
            at = match.end()
        self.tokens.append(("end", ""))
        self.at = 0

    @property
    def next(self) -> str:
        return self.tokens[self.at][1]

    @property
    def kind(self) -> str:
        return self.tokens[self.at][0]

    def take(self, *allowed: str) -> str:
        """Take a token of these, or of any text."""
        word = self.next
        if allowed and word not in allowed:
            before = " ".join(text for _, text in self.tokens[max(self.at - 8, 0) : self.at])
            raise Stopped(f"syntax: {word!r} after {before!r}, allowed: {allowed}")
        self.at += 1
        return word

    def took(self, word: str) -> bool:
        if found := self.next == word and self.kind != "string":
            self.at += 1
        return found

    def name(self) -> str:
        if self.kind != "name":
            raise Stopped(f"syntax: {self.next!r}, allowed: a name")
        return self.take()

    def expression(self, level: int = 0) -> Callable[[Any], Any]:
        if level == len(self.LEVELS):
            return self.unary()
        if level == self.NOT_AT and self.took(self.NOT):
            operand = self.expression(level + 1)
            return lambda state: not boolean(operand(state))
        left = self.expression(level + 1)
        while self.next in self.LEVELS[level] and self.kind != "string":
            sign, right = self.take(), self.expression(level + 1)
            left = self.binary(sign, left, right)
        return left

    NOT, NOT_AT = "not", 0
    WHOLE = False  # some numbers are integers, and divided differently

    def binary(self, sign: str, left: Any, right: Any) -> Callable[[Any], Any]:
        return lambda state: self.calculate(sign, left(state), lambda: right(state))

    def calculate(self, sign: str, a: Any, later: Callable[[], Any]) -> Any:
        if sign.lower() in ("and", "or"):  # the second is not looked at in vain
            if boolean(a) is (sign.lower() == "or"):
                return a
            return boolean(later())
        b = later()
        if sign in ("==", "=", "!=", "<>"):
            if kind_of(a) != kind_of(b):
                raise Stopped(f"{a!r} {sign} {b!r}: not of one type")
            return (a == b) is (sign in ("==", "="))
        if sign == "+" and isinstance(a, str) and isinstance(b, str):
            return self.joined(a, b)
        number(a), number(b)
        if sign == "/" and (b == 0 or (self.WHOLE and type(a) is type(b) is int)):
            raise Stopped(f"{a!r} / {b!r}: of integers, or by 0")
        return {
            "+": lambda: a + b, "-": lambda: a - b, "*": lambda: a * b, "/": lambda: a / b,
            "<": lambda: a < b, ">": lambda: a > b, "<=": lambda: a <= b, ">=": lambda: a >= b,
        }[sign]()  # fmt: skip

    def joined(self, a: str, b: str) -> str:
        raise Stopped(f"{a!r} + {b!r}: texts are joined by str_cat")

    def unary(self) -> Callable[[Any], Any]:
        if self.took("-"):
            operand = self.unary()
            return lambda state: -number(operand(state))
        return self.term()

    def term(self) -> Callable[[Any], Any]:
        raise NotImplementedError

    def items(self, end: str) -> list[Callable[[Any], Any]]:
        found = []
        while not self.took(end):
            found.append(self.expression())
            if self.next != end:
                self.take(",")
        return found


def kind_of(value: Any) -> str:
    """Its type's name, in small letters."""
    kinds = {int: "num", float: "num", str: "string"}
    return str(getattr(value, "kind", kinds.get(type(value), type(value).__name__.lower())))


def boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise Stopped(f"{value!r} is no boolean")
    return value


def number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Stopped(f"{value!r} is no number")
    return value


def whole(value: Any) -> int:
    if number(value) != int(value):
        raise Stopped(f"{value!r} is no integer")
    return int(value)


def text(value: Any) -> str:
    if not isinstance(value, str):
        raise Stopped(f"{value!r} is no string")
    return value


def run(block: list[Callable[[Any], None]], state: Any) -> None:
    for statement in block:
        statement(state)
