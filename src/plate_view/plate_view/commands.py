"""Commands of browsers. The commands are parsed and checked before they are executed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from plate_core import MAX_PARTS, PlateError

from .access import Role

MAX_TEXT = 200
"""Maximum number of characters of a name or a value."""

MAX_ABS = 1e10
"""Maximum magnitude of a number in a command. The maximum is larger than a stamp of the wall clock,
which is about 1.8e9 s."""

MAX_POINTS = 2000
"""Maximum number of points of a drawn path."""


class CommandError(PlateError):
    """A command of a browser is invalid, or the role of the browser does not permit it."""


@dataclass(frozen=True)
class Command:
    """One command of a browser.

    Attributes
    ----------
    name : str
        Name, such as `stop`.
    number : int
        Number that the browser gave to the command. The reply contains this number.
    values : mapping
        Checked arguments of the command.
    """

    name: str
    number: int
    values: Mapping[str, Any]


Reader = Callable[[str, Any], Any]


def read_command(text: str | bytes, role: Role) -> Command:
    """Parse and check a command.

    Raises
    ------
    CommandError
        If the command is not valid. The error message contains the wrong value and the allowed
        values. `number_of` returns the number of the command for the reply.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        raise CommandError("message is not JSON, allowed: a JSON object") from None
    if not isinstance(data, dict):
        raise CommandError(f"message is a {type(data).__name__}, allowed: an object")
    number, name = number_of(data), data.pop("do", None)
    if not isinstance(name, str) or name not in COMMANDS:
        raise CommandError(f"do is {_short(name)}, allowed: {', '.join(COMMANDS)}")
    if role is not Role.OPERATOR and name not in FOR_ALL:
        raise CommandError(f"{name} is allowed only for operators, but this page is read only")
    data.pop("number", None)
    readers = COMMANDS[name]
    strange = sorted(data.keys() - readers.keys())
    if strange:
        allowed = ", ".join(readers) or "no further keys"
        raise CommandError(f"key of {name} is {_short(strange[0])}, allowed: {allowed}")
    values = {key: read(f"{name}: {key}", data.get(key)) for key, read in readers.items()}
    return Command(name, number, values)


def number_of(data: Any) -> int:
    """Return the number of a command. Return -1 if the command has no number."""
    number = data.get("number") if isinstance(data, dict) else None
    if isinstance(number, int) and not isinstance(number, bool) and 0 <= number <= MAX_ABS:
        return number
    return -1


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:40] + "..."


def _wrong(where: str, value: Any, allowed: str) -> CommandError:
    return CommandError(f"{where} is {_short(value)}, allowed: {allowed}")


def _flag(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise _wrong(where, value, "true or false")
    return value


def _number(where: str, value: Any) -> float:
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    if not (numeric and abs(value) <= MAX_ABS):
        raise _wrong(where, value, f"a number up to {MAX_ABS:g}")
    return float(value)


def _whole(where: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**31:
        raise _wrong(where, value, f"a whole number from 0 to {2**31 - 1}")
    return value


def _text(where: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT or not value.isprintable():
        raise _wrong(where, value, f"a text of 1 to {MAX_TEXT} printable characters")
    return value


def _maybe(read: Reader) -> Reader:
    return lambda where, value: None if value is None else read(where, value)


def _value(where: str, value: Any) -> bool | int | float | str:
    """Check the value of a parameter."""
    if isinstance(value, str):
        return value if not value else _text(where, value)
    if isinstance(value, bool | int):
        return value if isinstance(value, bool) or abs(value) < 2**63 else _number(where, value)
    return _number(where, value)


def _list(where: str, value: Any, min_count: int, max_count: int) -> list[Any]:
    if not isinstance(value, list) or not min_count <= len(value) <= max_count:
        raise _wrong(where, value, f"a list of {min_count} to {max_count}")
    return value


def _targets(where: str, value: Any) -> list[dict[str, Any]]:
    targets = []
    for each in _list(where, value, 1, MAX_PARTS):
        if not isinstance(each, dict) or not each.keys() <= {"id", "x", "y", "angle"}:
            raise _wrong(where, each, "id, x, y and angle")
        angle = each.get("angle")
        targets.append(
            {
                "id": _text(where, each.get("id")),
                "x": _number(where, each.get("x")),
                "y": _number(where, each.get("y")),
                "angle": math.nan if angle is None else _number(where, angle),
            }
        )
    return targets


def _points(where: str, value: Any) -> list[tuple[float, float]]:
    points = []
    for each in _list(where, value, 2, MAX_POINTS):
        x, y = _list(where, each, 2, 2)
        points.append((_number(where, x), _number(where, y)))
    return points


def _mapping(where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _wrong(where, value, "an object")
    return value


COMMANDS: Mapping[str, Mapping[str, Reader]] = {
    "emergency_stop": {},
    "cut_power": {},
    "stop": {},
    "cancel": {},
    "enable": {"on": _flag},
    "start": {"scenario": _maybe(_text), "task": _maybe(_mapping)},
    "move": {"targets": _targets, "dragging": _maybe(_flag)},
    "follow": {"id": _text, "points": _points, "speed": _number, "closed": _flag},
    "set": {"node": _text, "name": _text, "value": _value},
    "parameters": {"node": _text},
    "place": {"id": _maybe(_text), "type": _maybe(_text), "x": _number, "y": _number,
              "angle": _number},
    "remove": {"id": _text},
    "reset": {"seed": _maybe(_whole)},
    "learn_plate": {},
    "teach": {"name": _text},
    "find_home": {},
    "save_home": {},
    "take_lens_pictures": {"on": _flag, "columns": _maybe(_whole), "rows": _maybe(_whole),
                           "square_m": _maybe(_number), "marker_m": _maybe(_number)},
    "fit_lens": {},
    "save_lens": {},
    "measure_friction": {"start": _flag},
    "write_friction": {},
    "watch": {"image": _flag, "field": _flag, "camera": _maybe(_flag)},
    "replay": {"playing": _maybe(_flag), "seek": _maybe(_number), "rate": _maybe(_number)},
}  # fmt: skip
"""Arguments of each command, with the functions that check them."""

FOR_ALL = ("watch", "parameters", "replay")
"""Commands that change nothing in the ROS graph. Viewers may also send these commands."""

URGENT = ("emergency_stop", "cut_power", "stop")
"""Commands that stop the plate. These commands are executed before all other commands. A browser
may send any number of stop commands."""
