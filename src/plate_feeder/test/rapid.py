"""An interpreter of what a robot program needs of RAPID (ABB), from 3HAC050917 and 3HAC050946."""

from __future__ import annotations

import copy
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from robot_language import (
    Parser,
    Return,
    Robot,
    Stopped,
    boolean,
    kind_of,
    run,
    whole,
)
from scipy.spatial.transform import Rotation

LONGEST_STRING = 80  # of RAPID
MOST_RETRIES = 4  # of an instruction in RAPID, if the system parameter is not changed
WORDS_OF_RAPID = """
    alias and backward case connect const default div do else elseif endfor endfunc endif endmodule
    endproc endrecord endtest endtrap endwhile error exit false for from func goto if inout local
    mod module nostepin not noview or pers proc raise readonly record retry return step sysmodule
    test then to trap true trynext undo var viewonly while with xor
"""
STATES = {"SOCKET_CREATED": 1, "SOCKET_CONNECTED": 2, "SOCKET_CLOSED": 5}


class Record:
    """A value of components, such as `pos`."""

    KINDS: ClassVar = {
        "pos": {"x": "num", "y": "num", "z": "num"},
        "orient": {"q1": "num", "q2": "num", "q3": "num", "q4": "num"},
        "confdata": dict.fromkeys(("cf1", "cf4", "cf6", "cfx"), "num"),
        "extjoint": dict.fromkeys((f"eax_{letter}" for letter in "abcdef"), "num"),
        "robtarget": {"trans": "pos", "rot": "orient", "robconf": "confdata", "extax": "extjoint"},
    }

    def __init__(self, kind: str, values: list[Any]) -> None:
        parts = self.KINDS[kind]
        if len(values) != len(parts):
            raise Stopped(f"{kind} of {len(values)} components, allowed: {len(parts)}")
        self.kind = kind
        self.parts = {
            name: fitting(values[i], part) for i, (name, part) in enumerate(parts.items())
        }

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Record) and self.parts == other.parts

    @property
    def numbers(self) -> list[float]:
        return list(self.parts.values())


class RawBytes(bytearray):
    """Up to 1024 bytes; its length is that of what was written."""


class SocketDev:
    """A socket, or None if it is closed."""

    def __init__(self) -> None:
        self.link: socket.socket | str | None = None


class RapidError(Exception):
    """An error that a handler may catch; its name is ERRNO."""


def fitting(value: Any, kind: str) -> Any:
    """Return a value as a variable of this type takes it."""
    if isinstance(value, list) and kind in Record.KINDS:
        return Record(kind, value)
    kind = "num" if kind == "byte" else kind
    if kind_of(value) != kind:
        raise Stopped(f"{value!r} is no {kind}")
    if isinstance(value, str) and len(value) > LONGEST_STRING:
        raise Stopped(f"a string of {len(value)} characters, allowed: {LONGEST_STRING}")
    return copy.deepcopy(value) if isinstance(value, Record) else value


@dataclass
class Variable:
    kind: str
    value: Any

    def set(self, value: Any) -> None:
        self.value = fitting(value, self.kind)


FRESH: dict[str, Callable[[], Any]] = {
    "num": lambda: 0, "byte": lambda: 0, "bool": lambda: False, "string": lambda: "",
    "rawbytes": RawBytes, "socketdev": SocketDev,
    "robtarget": lambda: Record("robtarget", [[0] * 3, [0] * 4, [0] * 4, [0] * 6]),
}  # fmt: skip


@dataclass
class Frame:
    """A routine that runs."""

    variables: dict[str, Variable]
    handler: list[Callable[[Any], None]] | None
    errno: str = ""


class _Retry(Exception):
    pass


class _TryNext(Exception):
    pass


class _Raise(Exception):
    pass


class Rapid(Parser):
    """A module; `call` runs a routine. Names are the same in capitals.

    Parameters
    ----------
    program : str
    robot : Robot
    given : dict
        What the integrator writes: data, and procedures without arguments.
    """

    SPLIT = re.compile(
        r"(?P<skip>\s+|![^\n]*)|(?P<string>\"([^\"\n]|\"\")*\")|(?P<num>\d+(\.\d*)?(E[-+]?\d+)?)"
        r"|(?P<name>[A-Za-z]\w*)|(?P<sign>:=|<>|<=|>=|[-+*/=<>(),;:\[\]\\.])"
    )
    LEVELS = (("or",), ("and",), ("=", "<>", "<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
    KEYWORDS = frozenset(WORDS_OF_RAPID.split())

    def __init__(self, program: str, robot: Robot, given: dict[str, Any] | None = None) -> None:
        super().__init__(program)
        self.tokens = [
            (kind, word.lower() if kind == "name" else word) for kind, word in self.tokens
        ]
        self.robot = robot
        self.given = {name.lower(): value for name, value in (given or {}).items()}
        self.routines: dict[str, Callable[..., Any]] = {}
        self.globals = {
            name.lower(): Variable("num", value) for name, value in STATES.items()
        } | {
            name: Variable(kind_of(value), value)
            for name, value in self.given.items()
            if not callable(value)
        }  # fmt: skip
        # Arguments in order; with `!` the routine writes to them, with `=` they are optional.
        self.known: dict[str, tuple[str, Callable[..., Any]]] = {
            "strlen": ("string", len),
            "strpart": ("string num num", self._part),
            "strmatch": ("string num string", self._match),
            "strtoval": ("string num!", self._to_val),
            "orientzyx": ("num num num", _orient_zyx),
            "offs": ("robtarget num num num", _offs),
            "rawbyteslen": ("rawbytes", len),
            "copyrawbytes": ("rawbytes num rawbytes num", _copy_raw),
            "unpackrawbytes": ("rawbytes num any! ascii=num hex1=", _unpack),
            "socketgetstatus": ("socketdev", self._status),
            "socketcreate": ("socketdev", self._create),
            "socketclose": ("socketdev", self._close),
            "socketconnect": ("socketdev string num time=num", self._connect),
            "socketsend": ("socketdev str=string", self._send),
            "socketreceive": ("socketdev str=string! rawdata=rawbytes! time=num", self._receive),
            "movel": ("robtarget speeddata zonedata tooldata wobj=wobjdata", self._move),
            "tpwrite": ("string", lambda line: robot.tell("message", line)),
            "waittime": ("num", robot.sleep),
        }
        self._module()

    def call(self, name: str, *values: Any) -> Any:
        return self.routines[name.lower()](*values)

    # Declarations

    def _module(self) -> None:
        self.take("module")
        taken = {self.name()}
        while self.next == "var":
            name, kind, first = self._variable()
            self._new(name, taken)
            self.globals[name] = Variable(kind, FRESH[kind]())
            if first is not None:
                self.globals[name].set(first(Frame({}, None)))
        while self.next in ("func", "proc"):
            self._routine(taken)
        self.take("endmodule")
        self.take("")

    def _new(self, name: str, taken: set[str]) -> None:
        if name in taken | self.KEYWORDS | set(self.known) | set(FRESH):
            raise Stopped(f"the name {name} is taken")
        taken.add(name)

    def _variable(self) -> tuple[str, str, Any]:
        self.take("var")
        kind, name = self.take(*FRESH), self.name()
        first = self.expression() if self.took(":=") else None
        self.take(";")
        return name, kind, first

    def _routine(self, taken: set[str]) -> None:
        word = self.take()
        kind = self.take(*FRESH) if word == "func" else ""
        name = self.name()
        self._new(name, taken)
        self.take("(")
        own: set[str] = set()
        parameters = []
        while not self.took(")"):
            parameters.append((self.take(*FRESH), self.name()))
            self._new(parameters[-1][1], own)
            if self.next != ")":
                self.take(",")
        variables = []
        while self.next == "var":
            variables.append(self._variable())
            self._new(variables[-1][0], own)
        end = f"end{word}"
        body = self._block("error", end)
        handler = self._block(end) if self.took("error") else None
        self.take(end)

        def routine(*values: Any) -> Any:
            if len(values) != len(parameters):
                raise Stopped(f"{name} has {len(values)} arguments, allowed: {len(parameters)}")
            frame = Frame({}, handler)
            for (of, parameter), value in zip(parameters, values, strict=True):
                frame.variables[parameter] = Variable(of, fitting(value, of))
            for variable, of, first in variables:
                frame.variables[variable] = Variable(of, FRESH[of]())
                if first is not None:
                    frame.variables[variable].set(first(frame))
            try:
                run(body, frame)
            except Return as back:
                if (back.value is None) is bool(kind):
                    raise Stopped(f"{name} returns {back.value!r}") from None
                return fitting(back.value, kind) if kind else None
            if kind:
                raise Stopped(f"{name} ends without RETURN")
            return None

        self.routines[name] = routine

    # Statements

    def _block(self, *ends: str) -> list[Callable[[Any], None]]:
        found = []
        while self.next not in ends:
            found.append(self._statement())
        return found

    def _statement(self) -> Callable[[Any], None]:
        if self.took("while"):
            condition = self.expression()
            self.take("do")
            block = self._block("endwhile")
            self.take("endwhile")

            def loop(frame: Frame) -> None:
                while boolean(condition(frame)):
                    run(block, frame)

            return loop
        if self.took("if"):
            return self._if()
        statement = self._simple()
        self.take(";")
        return lambda frame: self._do(statement, frame)

    def _if(self) -> Callable[[Any], None]:
        branches = [(self.expression(), list[Any]())]
        if not self.took("then"):
            branches[0][1].append(self._statement())
        else:
            branches[0][1].extend(self._block("elseif", "else", "endif"))
            while (word := self.take()) != "endif":
                condition = self.expression() if word == "elseif" else lambda _: True
                if word == "elseif":
                    self.take("then")
                ends = ("elseif", "else", "endif") if word == "elseif" else ("endif",)
                branches.append((condition, self._block(*ends)))

        def choose(frame: Frame) -> None:
            for condition, block in branches:
                if boolean(condition(frame)):
                    run(block, frame)
                    break

        return choose

    def _do(self, statement: Callable[[Any], None], frame: Frame) -> None:
        """Do a statement; if it fails, what the routine's error handler says."""
        for _ in range(MOST_RETRIES + 1):
            try:
                return statement(frame)
            except RapidError as error:
                if frame.handler is None or frame.errno:
                    raise Stopped(f"{error} without an error handler") from None
                frame.errno = str(error)
                try:
                    run(frame.handler, frame)
                except _Retry:
                    continue
                except _TryNext:
                    return None
                except _Raise:
                    raise error from None
                finally:
                    frame.errno = ""
                raise Stopped(f"{error}: the error handler has no end") from None
        raise Stopped("too many retries")

    def _simple(self) -> Callable[[Any], None]:
        ways = {"retry": _Retry, "trynext": _TryNext, "raise": _Raise}
        if self.next in ways:
            way: type[Exception] = ways[self.take()]

            def leave(frame: Frame) -> None:
                raise way if frame.errno else Stopped(f"{way} outside an error handler")

            return leave
        if self.took("exit"):

            def stop(_: Frame) -> None:
                raise Stopped("EXIT")

            return stop
        if self.took("return"):
            value = (lambda _: None) if self.next == ";" else self.expression()

            def give(frame: Frame) -> None:
                raise Return(value(frame))

            return give
        name = self.name()
        if self.next in (":=", "."):
            return self._assignment(name)
        return self._call(name, ";")

    def _assignment(self, name: str) -> Callable[[Any], None]:
        path = []
        while self.took("."):
            path.append(self.name())
        self.take(":=")
        value = self.expression()

        def assign(frame: Frame) -> None:
            variable = self._variable_of(name, frame)
            if not path:
                return variable.set(value(frame))
            record = variable.value
            for part in path[:-1]:
                record = _component(record, part).parts[part]
            parts = _component(record, path[-1]).parts
            parts[path[-1]] = fitting(value(frame), Record.KINDS[record.kind][path[-1]])
            return None

        return assign

    def _variable_of(self, name: str, frame: Frame) -> Variable:
        if name in frame.variables:
            return frame.variables[name]
        if name not in self.globals:
            raise Stopped(f"{name} is not declared")
        return self.globals[name]

    # Expressions

    def joined(self, a: str, b: str) -> str:
        return str(fitting(a + b, "string"))

    def term(self) -> Callable[[Any], Any]:
        kind, word = self.kind, self.take()
        if kind == "string":
            code = re.compile(r"\\(\\|[0-9A-F]{2})")
            line = code.sub(
                lambda found: "\\" if found[1] == "\\" else chr(int(found[1], 16)),
                word[1:-1].replace('""', '"'),
            )
            return lambda _: fitting(line, "string")
        if kind == "num":
            constant = float(word) if re.search("[.E]", word) else int(word)
            return lambda _: constant
        if word in ("true", "false"):
            return lambda _: word == "true"
        if word == "(":
            inner = self.expression()
            self.take(")")
            return inner
        if word == "[":
            values = self.items("]")
            return lambda frame: [each(frame) for each in values]
        if kind != "name" or word in self.KEYWORDS:
            raise Stopped(f"syntax: {word!r}")
        if self.took("("):
            call = self._call(word, ")")
            self.take(")")
            return call
        if word == "errno":
            return lambda frame: frame.errno
        if word.startswith("err_"):
            return lambda _: word.upper()
        path = []
        while self.took("."):
            path.append(self.name())

        def value(frame: Frame) -> Any:
            got = self._variable_of(word, frame).value
            for part in path:
                got = _component(got, part).parts[part]
            return got

        return value

    NOT = "not"

    def _call(self, name: str, end: str) -> Callable[[Any], Any]:
        """Read the arguments of a call up to its end."""
        values: list[tuple[str, str, Any]] = []  # option, variable, expression
        while self.next != end:
            if self.took("\\"):
                option = self.name()
                given = self.took(":=")
            else:
                option, given = "", True
                if values and values[-1][0]:
                    raise Stopped(f"{name}: an argument after an option")
            variable = self.next if self.kind == "name" else ""
            values.append((option, variable, self.expression() if given else None))
            if self.next not in (end, "\\"):
                self.take(",")

        def call(frame: Frame) -> Any:
            if name in self.known:
                return self._known(name, values, frame)
            if any(option for option, _, _ in values):
                raise Stopped(f"{name} has no options")
            arguments = [value(frame) for _, _, value in values]
            if name in self.routines:
                return self.routines[name](*arguments)
            if not callable(self.given.get(name)):
                raise Stopped(f"{name} is no routine")
            return self.given[name](*arguments)

        return call

    def _known(self, name: str, values: list[tuple[str, str, Any]], frame: Frame) -> Any:
        wanted, function = self.known[name]
        plain = [each for each in wanted.split() if "=" not in each]
        options = dict(each.split("=") for each in wanted.split() if "=" in each)
        given = [each for each in values if not each[0]]
        if len(given) != len(plain):
            raise Stopped(f"{name} has {len(given)} arguments, allowed: {len(plain)}")
        arguments, named = [], {}
        for (_, variable, value), kind in zip(given, plain, strict=True):
            arguments.append(self._argument(kind, variable, value, frame))
        for option, variable, value in values:
            if option and (option not in options or option in named):
                raise Stopped(f"{name} \\{option}, allowed: {', '.join(options)}")
            if option:
                if (value is None) is not (options[option] == ""):
                    raise Stopped(f"{name} \\{option}: a value")
                wants = options[option]
                named[option] = not wants or self._argument(wants, variable, value, frame)
        return function(*arguments, **named)

    def _argument(self, kind: str, variable: str, value: Any, frame: Frame) -> Any:
        if kind.endswith("!"):
            written = self._variable_of(variable, frame)
            if kind != "any!" and kind[:-1] != written.kind:
                raise Stopped(f"{variable} is a {written.kind}, allowed: {kind[:-1]}")
            return written
        got = value(frame)
        if kind in ("rawbytes", "socketdev"):
            if kind_of(got) != kind:
                raise Stopped(f"{got!r} is no {kind}")
            return got
        return fitting(got, kind)

    # What is built in

    def _part(self, line: str, position: float, length: float) -> str:
        first, count = whole(position), whole(length)
        if not 1 <= first <= len(line) or count < 0 or first - 1 + count > len(line):
            raise Stopped(f"StrPart({line!r}, {first}, {count}) is outside the string")
        return line[first - 1 : first - 1 + count]

    def _match(self, line: str, position: float, pattern: str) -> int:
        if not 1 <= whole(position) <= len(line) or not pattern:
            raise Stopped(f"StrMatch({line!r}, {position}, {pattern!r})")
        found = line.find(pattern, int(position) - 1)
        return len(line) + 1 if found < 0 else found + 1

    def _to_val(self, line: str, value: Variable) -> bool:
        if ok := re.fullmatch(r"\s*[-+]?\d+(\.\d*)?(E[-+]?\d+)?\s*", line) is not None:
            value.set(float(line))
        return ok

    def _status(self, device: SocketDev) -> int:
        if device.link is None:
            return STATES["SOCKET_CLOSED"]
        return STATES["SOCKET_CREATED" if device.link == "created" else "SOCKET_CONNECTED"]

    def _create(self, device: SocketDev) -> None:
        if device.link is not None:
            raise Stopped("SocketCreate of a socket that is not closed")
        device.link = "created"

    def _close(self, device: SocketDev) -> None:
        if isinstance(device.link, socket.socket):
            device.link.close()
        device.link = None

    def _connect(self, device: SocketDev, address: str, port: float, time: float = 60) -> None:
        if device.link != "created":
            raise RapidError("ERR_SOCK_CLOSED")
        link = self.robot.connect(address, whole(port))
        if link is None:
            self.robot.t += time
            raise RapidError("ERR_SOCK_TIMEOUT")
        device.link = link

    def _send(self, device: SocketDev, *, str: str) -> None:
        self.robot.tell("send", str.removesuffix("\n"))
        if not isinstance(device.link, socket.socket):
            raise RapidError("ERR_SOCK_CLOSED")
        try:
            device.link.sendall(str.encode("latin-1"))
        except OSError:
            raise RapidError("ERR_SOCK_CLOSED") from None

    def _receive(
        self, device: SocketDev, *, str: Any = None, rawdata: Any = None, time: float = 60
    ) -> None:
        if (str is None) is (rawdata is None):
            raise Stopped("SocketReceive needs one of \\Str and \\RawData")
        if not isinstance(device.link, socket.socket):
            raise RapidError("ERR_SOCK_CLOSED")
        data = self.robot.receive(device.link, LONGEST_STRING if str else 1024, time)
        if not data:
            raise RapidError("ERR_SOCK_TIMEOUT" if data is None else "ERR_SOCK_CLOSED")
        if str is not None:
            str.set(data.decode("latin-1"))
        else:
            rawdata.value[:] = data

    def _move(self, to: Record, speed: Any, zone: Any, tool: Any, *, wobj: Any = None) -> None:
        self.robot.tell("move", to, zone.name, wobj and wobj.name)


@dataclass(frozen=True)
class Named:
    """Data of a type of which only the name matters here, such as v1000."""

    kind: str
    name: str


def _component(value: Any, part: str) -> Record:
    if not isinstance(value, Record) or part not in value.parts:
        raise Stopped(f"{value!r} has no component {part}")
    return value


def _orient_zyx(z: float, y: float, x: float) -> Record:
    qx, qy, qz, q = Rotation.from_euler("ZYX", [z, y, x], degrees=True).as_quat().tolist()
    return Record("orient", [q, qx, qy, qz])


def _offs(point: Record, x: float, y: float, z: float) -> Record:
    moved = copy.deepcopy(point)
    place = np.add(point.parts["trans"].numbers, (x, y, z)).tolist()
    moved.parts["trans"] = Record("pos", place)
    return moved


def _copy_raw(source: RawBytes, first: float, to: RawBytes, at: float) -> None:
    i, j = whole(first) - 1, whole(at) - 1
    if not (0 <= i < len(source) and 0 <= j <= len(to)) or j + len(source) - i > 1024:
        raise Stopped(f"CopyRawBytes from {i + 1} to {j + 1} is outside the bytes")
    to[j : j + len(source) - i] = source[i:]


def _unpack(
    raw: RawBytes, first: float, value: Variable, *, ascii: Any = None, hex1: bool = False
) -> None:
    count = 1 if hex1 else whole(ascii)
    data = raw[whole(first) - 1 : int(first) - 1 + count]
    if first < 1 or not 1 <= count <= LONGEST_STRING or len(data) < count:
        raise Stopped(f"UnpackRawBytes of {count} from {first} of {len(raw)}")
    if (ascii is not None) is hex1 or value.kind != ("byte" if hex1 else "string"):
        raise Stopped(f"UnpackRawBytes to a {value.kind}: \\Hex1 is of a byte, \\ASCII of a string")
    value.set(data[0] if hex1 else data.decode("latin-1"))
