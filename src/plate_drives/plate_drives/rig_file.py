"""Change values of motors in a rig file and leave all else as it was, comments too."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from plate_core import PlateError
from plate_core.files import draft
from plate_core.rig import Drive, load_rig

Drives = Mapping[str, Drive]
"""New drives by the names of their motors."""


def differences(old: Drive, new: Drive) -> dict[str, str]:
    """Return the keys of a rig file whose values differ, with the new ones as they are written."""
    values = {
        "node": str(new.node), "counts_per_m": re.sub(r"e\+?0*", "e", f"{new.counts_per_m:.6g}"),
        "sign": str(new.sign), "home": "absolute" if new.absolute else "here",
        "serial": str(new.serial),
    }  # fmt: skip
    names = ("node", "counts_per_m", "sign", "absolute", "serial")
    pairs = zip(names, values.items(), strict=True)
    return {key: value for n, (key, value) in pairs if getattr(old, n) != getattr(new, n)}


def write(path: Path, drives: Drives) -> None:
    """Give motors of a rig file other drives: all of it or nothing.

    Raises
    ------
    PlateError
        If the file cannot be written, or would not be a rig file that says so.
    """
    path = path.resolve()  # where a link leads
    motors = [replace(m, drive=drives.get(m.name, m.drive)) for m in load_rig(path).motors]
    old = {m.name: m.drive for m in load_rig(path).motors if m.drive is not None}
    text = path.read_text(encoding="utf-8")
    values = {name: differences(old[name], drive) for name, drive in drives.items()}
    with draft(path, "rig file") as file:
        file.write(_edited(text, values).encode())
        file.flush()
        shutil.copymode(path, file.name)
        try:
            if list(load_rig(file.name).motors) != motors:
                raise PlateError("it would say something else")
        except PlateError as error:
            raise PlateError(f"{path} stays as it was, change it by hand: {error}") from None


def _edited(text: str, values: Mapping[str, Mapping[str, str]]) -> str:
    """Return the file's text with other values; keys that are missing are added."""
    motors = _item(yaml.compose(text, yaml.SafeLoader), "motors")
    edits = []  # from, to, what stands there then
    for name, keys in values.items():
        motor = _item(motors, name)
        last_key, last = motor.value[-1]
        for key, value in keys.items():
            old = _item(motor, key)
            if old is not None:
                edits.append((old.start_mark.index, old.end_mark.index, value))
            elif motor.flow_style:
                edits.append((last.end_mark.index, last.end_mark.index, f", {key}: {value}"))
            else:  # above the last one, which may have a comment behind it
                at, indent = last_key.start_mark.index, " " * last_key.start_mark.column
                edits.append((at, at, f"{key}: {value}\n{indent}"))
    for start, end, value in sorted(edits, reverse=True):
        text = text[:start] + value + text[end:]
    return text


def _item(node: Any, key: str) -> Any:
    """Return the node of a key in a mapping; None: it is missing."""
    return next((value for name, value in node.value if name.value == key), None)
