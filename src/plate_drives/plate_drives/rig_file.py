"""Functions that change the drives in a rig file. The rest of the file stays unchanged, including
comments."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from plate_core.rig import Drive, edit_rig, load_rig

Drives = Mapping[str, Drive]
"""New properties of drives, by the names of their motors."""


def differences(old: Drive, new: Drive) -> dict[str, str]:
    """Return the keys of a rig file whose values differ between two drives. Each key is mapped to
    the text of the value in `new`."""
    values = {
        "node": str(new.node), "counts_per_m": re.sub(r"e\+?0*", "e", f"{new.counts_per_m:.6g}"),
        "sign": str(new.sign), "home": "absolute" if new.absolute else "here",
        "serial": str(new.serial),
    }  # fmt: skip
    names = ("node", "counts_per_m", "sign", "absolute", "serial")
    pairs = zip(names, values.items(), strict=True)
    return {key: value for n, (key, value) in pairs if getattr(old, n) != getattr(new, n)}


def write(path: Path, drives: Drives) -> None:
    """Write new properties of drives into a rig file. If an error occurs, the file stays unchanged.

    Raises
    ------
    PlateError
        If the file cannot be written, or the new file would not contain these drives.
    """
    motors = [replace(m, drive=drives.get(m.name, m.drive)) for m in load_rig(path).motors]
    old = {m.name: m.drive for m in load_rig(path).motors if m.drive is not None}
    values: dict[tuple[str, ...], dict[str, str]] = {
        ("motors", name): differences(old[name], drive) for name, drive in drives.items()
    }
    edit_rig(path, values, lambda rig: list(rig.motors) == motors)
