"""Change values in a rig file and leave all else as it was, comments too."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from ..errors import PlateError
from ..files import draft
from .rig import Rig, load_rig

Values = Mapping[tuple[str, ...], Mapping[str, str]]
"""New values as they are written, by key, by the keys that lead to their mapping."""


def edit_rig(path: Path, values: Values, expected: Callable[[Rig], bool]) -> None:
    """Change values of a rig file: all of them or none; keys that are missing are added.

    Parameters
    ----------
    path : Path
    values : Values
        Such as `{("friction",): {"mu": "0.31"}}`.
    expected : callable
        Whether the changed file says what it should.

    Raises
    ------
    PlateError
        If the file cannot be written, or would not be a rig file that says so.
    """
    path = path.resolve()  # where a link leads
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise PlateError(f"rig file {path}: cannot be read ({error})") from None
    with draft(path, "rig file") as file:
        file.write(edited(text, values).encode())
        file.flush()
        shutil.copymode(path, file.name)
        try:
            if not expected(load_rig(file.name)):
                raise PlateError("it would say something else")
        except PlateError as error:
            raise PlateError(f"{path} stays as it was, change it by hand: {error}") from None


def edited(text: str, values: Values) -> str:
    """Return a rig file's text with other values; keys that are missing stand behind the others of
    their mapping, in its style."""
    root: Any = yaml.compose(text, yaml.SafeLoader)
    edits = []  # from, to, what stands there then
    for keys, new in values.items():
        mapping = root
        for key in keys:
            mapping = _item(mapping, key)
        last_key, last = mapping.value[-1]
        indent = " " * last_key.start_mark.column
        for key, value in new.items():
            old = _item(mapping, key)
            if old is not None:
                edits.append((_start(mapping, key), _end(old), f": {value}"))
            elif mapping.flow_style:
                edits.append((last.end_mark.index, last.end_mark.index, f", {key}: {value}"))
            else:  # below the last one, and the comment behind it
                at = text.find("\n", _end(last))
                at = len(text) if at < 0 else at
                edits.append((at, at, f"\n{indent}{key}: {value}"))
    done, parts = 0, []
    for start, end, value in sorted(edits, key=lambda edit: edit[0]):
        parts += [text[done:start], value]
        done = end
    return "".join(parts) + text[done:]


def _start(mapping: Any, key: str) -> int:
    """Return where a key of a mapping ends: a block begins on the next line."""
    return int(next(name for name, _ in mapping.value if name.value == key).end_mark.index)


def _end(node: Any) -> int:
    """Return where a node's text ends: that of a block ends with its last value, not at the next
    key."""
    while not isinstance(node, yaml.ScalarNode) and node.value and not node.flow_style:
        last = node.value[-1]
        node = last[1] if isinstance(last, tuple) else last
    return int(node.end_mark.index)


def _item(node: Any, key: str) -> Any:
    """Return the node of a key in a mapping; None: it is missing."""
    return next((value for name, value in node.value if name.value == key), None)
