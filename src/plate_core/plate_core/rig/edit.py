"""Changes of values in a rig file. All other text in the file stays unchanged, including comments.

The YAML parser gives the position of each value, and only the characters of the value are replaced.
The changed file is read and checked before it replaces the old file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from ..errors import PlateError, RigError
from ..files import YAML_BYTES, draft, read_file
from ..yaml_fields import parse_yaml
from .rig import Rig
from .rig_file import load_rig

Values = Mapping[tuple[str, ...], Mapping[str, str]]
"""New values as text. The outer key is the path to a mapping in the file. The inner key is a key of
this mapping."""


def edit_rig(path: Path, values: Values, expected: Callable[[Rig], bool]) -> None:
    """Change values of a rig file. Missing keys are added. If the change of a value fails, the file
    stays unchanged.

    Parameters
    ----------
    path : Path
    values : Values
        New values, such as `{("friction",): {"mu": "0.31"}}`.
    expected : callable
        Function that returns whether the rig in the changed file has the expected values.

    Raises
    ------
    PlateError
        If the file is not YAML, does not have the mappings in `values`, or cannot be written. The
        error is also raised if the changed file is not a rig file, or `expected` returns False for
        the changed rig.
    """
    path = path.resolve()  # if the file is a symbolic link, change its target
    content = read_file(path, YAML_BYTES)
    parse_yaml(content, path, RigError)
    text = content.decode()
    with draft(path, "rig file") as file:
        file.write(edit_text(text, values).encode())
        file.flush()
        try:
            if not expected(load_rig(file.name)):
                raise PlateError("after the change, the file would not contain the new values")
        except PlateError as error:
            raise PlateError(f"{path} was not changed, edit it by hand: {error}") from None


def edit_text(text: str, values: Values) -> str:
    """Return a rig file's text with new values. Missing keys are added at the end of their mapping,
    in the style of this mapping.

    Raises
    ------
    RigError
        If a mapping is missing or empty.
    """
    root: Any = yaml.compose(text, yaml.SafeLoader)
    edits = []  # replacements in the text: start index, end index, new text
    for keys, new in values.items():
        mapping = root
        for key in keys:
            mapping = _find_value(mapping, key)
        if not isinstance(mapping, yaml.MappingNode) or not mapping.value:
            raise RigError(f"rig file: {', '.join(keys)} is missing or empty, expected a mapping")
        last_key, last = mapping.value[-1]
        indent = " " * last_key.start_mark.column
        for key, value in new.items():
            old = _find_value(mapping, key)
            if old is not None:
                edits.append((_value_start(mapping, key), _node_end(old), f": {value}"))
            elif mapping.flow_style:
                edits.append((last.end_mark.index, last.end_mark.index, f", {key}: {value}"))
            else:  # insert the new text after the line of the last item
                line_end = text.find("\n", _node_end(last))
                line_end = len(text) if line_end < 0 else line_end
                edits.append((line_end, line_end, f"\n{indent}{key}: {value}"))
    done, parts = 0, []
    for start, end, value in sorted(edits, key=lambda edit: edit[0]):
        parts += [text[done:start], value]
        done = end
    return "".join(parts) + text[done:]


def _value_start(mapping: Any, key: str) -> int:
    """Return the position at which the text of a value begins: the end of its key. A block value
    begins on the next line."""
    return int(next(name for name, _ in mapping.value if name.value == key).end_mark.index)


def _node_end(node: Any) -> int:
    """Return the position at which the text of a node ends. The text of a block ends with its last
    value, not at the next key."""
    while not isinstance(node, yaml.ScalarNode) and node.value and not node.flow_style:
        last = node.value[-1]
        node = last[1] if isinstance(last, tuple) else last
    return int(node.end_mark.index)


def _find_value(node: Any, key: str) -> Any:
    """Return the node of a key in a mapping. Return None if the key or the mapping is missing."""
    if not isinstance(node, yaml.MappingNode):
        return None
    return next((value for name, value in node.value if name.value == key), None)
