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
        raise CommandError(f"do is {_shorten(name)}, allowed: {', '.join(COMMANDS)}")
    if role is not Role.OPERATOR and name not in FOR_ALL:
        raise CommandError(f"{name} is allowed only for operators, but this page is read only")
    data.pop("number", None)
    readers = COMMANDS[name]
    strange = sorted(data.keys() - readers.keys())
    if strange:
        allowed = ", ".join(readers) or "no further keys"
        raise CommandError(f"key of {name} is {_shorten(strange[0])}, allowed: {allowed}")
    values = {key: read(f"{name}: {key}", data.get(key)) for key, read in readers.items()}
    return Command(name, number, values)


def number_of(data: Any) -> int:
    """Return the number of a command. Return -1 if the command has no number."""
    number = data.get("number") if isinstance(data, dict) else None
    if isinstance(number, int) and not isinstance(number, bool) and 0 <= number <= MAX_ABS:
        return number
    return -1


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:40] + "..."


def _value_error(where: str, value: Any, allowed: str) -> CommandError:
    return CommandError(f"{where} is {_shorten(value)}, allowed: {allowed}")


def _read_flag(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise _value_error(where, value, "true or false")
    return value


def _read_number(where: str, value: Any) -> float:
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    if not (numeric and abs(value) <= MAX_ABS):
        raise _value_error(where, value, f"a number up to {MAX_ABS:g}")
    return float(value)


def _read_integer(where: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**31:
        raise _value_error(where, value, f"a whole number from 0 to {2**31 - 1}")
    return value


def _read_text(where: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT or not value.isprintable():
        raise _value_error(where, value, f"a text of 1 to {MAX_TEXT} printable characters")
    return value


def _optional(read: Reader) -> Reader:
    return lambda where, value: None if value is None else read(where, value)


def _read_parameter_value(where: str, value: Any) -> bool | int | float | str:
    """Check the value of a parameter."""
    if isinstance(value, str):
        return value if not value else _read_text(where, value)
    if isinstance(value, bool | int):
        return (
            value if isinstance(value, bool) or abs(value) < 2**63 else _read_number(where, value)
        )
    return _read_number(where, value)


def _read_list(where: str, value: Any, min_count: int, max_count: int) -> list[Any]:
    if not isinstance(value, list) or not min_count <= len(value) <= max_count:
        raise _value_error(where, value, f"a list of {min_count} to {max_count}")
    return value


def _read_targets(where: str, value: Any) -> list[dict[str, Any]]:
    targets = []
    for item in _read_list(where, value, 1, MAX_PARTS):
        if not isinstance(item, dict) or not item.keys() <= {"id", "x", "y", "angle"}:
            raise _value_error(where, item, "id, x, y and angle")
        angle = item.get("angle")
        targets.append(
            {
                "id": _read_text(where, item.get("id")),
                "x": _read_number(where, item.get("x")),
                "y": _read_number(where, item.get("y")),
                "angle": math.nan if angle is None else _read_number(where, angle),
            }
        )
    return targets


def _read_points(where: str, value: Any) -> list[tuple[float, float]]:
    points = []
    for item in _read_list(where, value, 2, MAX_POINTS):
        x, y = _read_list(where, item, 2, 2)
        points.append((_read_number(where, x), _read_number(where, y)))
    return points


def _read_mapping(where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _value_error(where, value, "an object")
    return value


COMMANDS: Mapping[str, Mapping[str, Reader]] = {
    "emergency_stop": {},
    "cut_power": {},
    "stop": {},
    "cancel": {},
    "enable": {"on": _read_flag},
    "start": {"scenario": _optional(_read_text), "task": _optional(_read_mapping)},
    "move": {"targets": _read_targets, "dragging": _optional(_read_flag)},
    "follow": {"id": _read_text, "points": _read_points, "speed": _read_number,
               "closed": _read_flag},
    "set": {"node": _read_text, "name": _read_text, "value": _read_parameter_value},
    "parameters": {"node": _read_text},
    "place": {"id": _optional(_read_text), "type": _optional(_read_text),
              "x": _read_number, "y": _read_number, "angle": _read_number},
    "remove": {"id": _read_text},
    "reset": {"seed": _optional(_read_integer)},
    "learn_plate": {},
    "teach": {"name": _read_text},
    "find_home": {},
    "save_home": {},
    "take_lens_pictures": {
        "on": _read_flag, "columns": _optional(_read_integer), "rows": _optional(_read_integer),
        "square_m": _optional(_read_number), "marker_m": _optional(_read_number),
    },
    "fit_lens": {},
    "save_lens": {},
    "measure_friction": {"start": _read_flag},
    "write_friction": {},
    "watch": {"image": _read_flag, "field": _read_flag, "camera": _optional(_read_flag)},
    "replay": {"playing": _optional(_read_flag), "seek": _optional(_read_number),
               "rate": _optional(_read_number)},
}  # fmt: skip
"""Arguments of each command, with the functions that check them."""

FOR_ALL = ("watch", "parameters", "replay")
"""Commands that change nothing in the ROS graph. Viewers may also send these commands."""

URGENT = ("emergency_stop", "cut_power", "stop")
"""Commands that stop the plate. These commands are executed before all other commands. A browser
may send any number of stop commands."""
