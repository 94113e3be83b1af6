"""Text protocol for robots over TCP. A command is one line, and its reply is one line with a
code."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from plate_core import PlateError, did_you_mean

from .codes import Code
from .interface import Quantity, ReadyPart

MAX_LINE = 256
"""Maximum length of a robot's line [bytes]."""

MAX_ANSWER = 250
"""Maximum length of a reply line [characters]. A longer reply is cut off at the end of a word."""

NUMBER = re.compile(r"[-+.\d]")
"""First character of a number. The names of classes and the ids of parts do not begin with these
characters."""

SECONDS = re.compile(r"\d{1,6}(\.\d{1,6})?")

COMMANDS: Mapping[str, str] = {
    "get_part": "[class] [timeout_s]",
    "prepare_part": "[class]",
    "part_taken": "[id] [ok|failed]",
    "part_quantity": "",
    "purge": "[timeout_s]",
    "state": "",
    "help": "",
}
"""Commands and their arguments."""

WAITING = ("get_part", "purge")
"""Commands that may get their reply much later."""


class LineError(PlateError):
    """A line from a robot is not a valid command. `code` is the reply code for this error."""

    def __init__(self, code: Code, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class Command:
    """A command of a robot.

    Attributes
    ----------
    name : str
        Name of the command, one of `COMMANDS`.
    label : str
        Class of the part. Empty if the line contains no class.
    part : str
        Id of the part. Empty if the line contains no id.
    timeout_s : float
        Timeout of the command [s]. 0 if the line contains no timeout.
    taken : bool
        Whether the robot reports that the pick has succeeded.
    """

    name: str
    label: str = ""
    part: str = ""
    timeout_s: float = 0.0
    taken: bool = True


def read_line(line: bytes) -> Command:
    """Convert a line from a robot to a command. `line` does not contain the end of the line.

    Raises
    ------
    LineError
        If the line is invalid. The message contains the error and the allowed values.
    """
    if len(line) > MAX_LINE:
        raise LineError(Code.BAD_LINE, f"line has {len(line)} bytes, allowed: up to {MAX_LINE}")
    text = line.decode("ascii", "replace")
    if not text.isascii() or not text.replace("\t", " ").isprintable():
        raise LineError(Code.BAD_LINE, "the line is not plain text, allowed: printable ASCII")
    name, *rest = text.split() or [""]
    name = name.lower()
    if name not in COMMANDS:
        near = did_you_mean(name, COMMANDS)
        raise LineError(
            Code.UNKNOWN_COMMAND, f"command is {name!r}{near}, allowed: {', '.join(COMMANDS)}"
        )
    timeout_s, taken = 0.0, True
    if name in WAITING and rest and NUMBER.match(rest[-1]):
        timeout_s = _read_seconds(rest.pop())
    elif name == "part_taken" and rest and rest[-1].lower() in ("ok", "failed"):
        taken = rest.pop().lower() == "ok"
    word = ""
    if rest and ("[class]" in COMMANDS[name] or "[id]" in COMMANDS[name]):
        word = rest.pop(0)
    if rest:
        usage = f"{name} {COMMANDS[name]}".strip()
        raise LineError(Code.BAD_ARGUMENT, f"argument {rest[0]!r} is unexpected, allowed: {usage}")
    if name == "part_taken":
        return Command(name, part=word, taken=taken)
    return Command(name, label=word, timeout_s=timeout_s)


def _read_seconds(word: str) -> float:
    if not SECONDS.fullmatch(word):
        raise LineError(Code.BAD_ARGUMENT, f"timeout_s is {word!r}, allowed: a number such as 2.5")
    return float(word)


def answer_line(code: Code, text: str) -> bytes:
    """Return the reply to a command as one line: the code and the text."""
    plain = " ".join(text.encode("ascii", "replace").decode().split())
    line = f"{code:d} {plain}"
    if len(line) > MAX_ANSWER:  # cut the line at a space, because a cut number would be wrong
        line = line[: MAX_ANSWER + 1].rpartition(" ")[0]
    return line.encode() + b"\r\n"


def part_text(part: ReadyPart, valid_s: float) -> str:
    """Return a part's place in the robot's frame [mm, degrees] and its validity [s], as text."""
    degrees = math.degrees(math.remainder(part.angle, 2 * math.pi))
    return (
        f"x={_format_number(1e3 * part.x)} y={_format_number(1e3 * part.y)} "
        f"angle={_format_number(degrees)} "
        f"id={part.id} class={part.label} valid_s={valid_s:.1f}"
    )


def quantity_text(quantity: Quantity) -> str:
    """Convert the numbers of parts to text. The number of parts on the plate is also given for each
    class."""
    counts = {
        "seen": sum(quantity.seen.values()), "ready": quantity.ready, "taken": quantity.taken,
        "discharged": quantity.discharged, "lost": quantity.lost, **quantity.seen,
    }  # fmt: skip
    return " ".join(f"{name}={count}" for name, count in counts.items())


def help_text() -> str:
    """Return all commands and their arguments as text."""
    return "; ".join(f"{name} {usage}".strip() for name, usage in COMMANDS.items())


def _format_number(value: float) -> str:
    # adding 0.0 changes -0.0 to 0.0, so the text is never -0.00
    return f"{round(value, 2) + 0.0:.2f}"
