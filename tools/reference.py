"""Write docs/reference.md: all keys of scenario and rig files, from the code that reads them.

python tools/reference.py
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable
from pathlib import Path

from plate_core import rig, tasks
from plate_core.yaml_fields import Choice, Key, Number, Numbers, Section, Whole

PAGE = Path(__file__).resolve().parents[1] / "docs/reference.md"

MAX_LISTED = 10
"""Maximum number of choices that the page lists for a key. Messages about a wrong choice list all
choices."""

KIND = re.compile(r"task, kind: \w+")
"""Pattern of the heading of the section on one kind of task."""

HEAD = """# All keys of scenario and rig files

`python tools/reference.py` generates this page. Brackets contain the type, the allowed range, the
unit and the default of a key. A key without a default is required.

A point [x, y] is given in metres in the frame `plate_home`, from -10 to 10 m. The origin of this
frame is the centre of the plate at rest. The axis x points along the plate's long side, and y to
the left. Angles are counter-clockwise from x. The pages [tasks](guide/tasks.md) and
[rig](guide/rig.md) contain examples.
"""


def page() -> str:
    """Return the text of the page."""
    parts = [HEAD, "\n## Scenario files: config/scenarios\n", *_section_lines(tasks.SECTIONS)]
    parts += ["\n## Rig files: config/rig.yaml\n", *_section_lines(rig.SECTIONS)]
    return "".join(parts)


def _section_lines(sections: Iterable[Section]) -> Iterable[str]:
    """Yield the sections of a file. Keys that several kinds of task share are in the section
    `task`."""
    sections = tuple(sections)
    kinds: dict[Key, list[str]] = {}
    for section in sections:
        if KIND.fullmatch(section.where):
            for key in section.keys:
                kinds.setdefault(key, []).append(section.where.split()[-1])
    shared = {key: names for key, names in kinds.items() if len(names) > 1 and key.required}
    for section in sections:
        yield f"\n### `{section.where}`\n\n{section.about}\n"
        for key in section.keys:
            if not (KIND.fullmatch(section.where) and key in shared):
                details = _key_type_text(key) + _default_text(key)
                yield f"\n- `{key.name}` ({details}): {key.meaning}\n"
        if section.where == "task":
            for key, names in shared.items():
                details = f"{_key_type_text(key)}; for {', '.join(names)}"
                yield f"\n- `{key.name}` ({details}): {key.meaning}\n"


def _key_type_text(key: Key) -> str:
    """Return the type, the range and the unit of a key as text."""
    unit = "" if key.unit in ("", "-") else f" {key.unit}"
    match key.kind:
        case Choice(choices) if len(choices) > MAX_LISTED:
            return f"a name such as {choices[0]}"
        case Number(low, high):
            return f"{low:g} to {high:g}{unit}"
        case Whole(low, high):
            return f"whole number, {low} to {high}{unit}"
        case Numbers((2,), _, 10.0) if key.unit == "m":
            return "a point [x, y]"
        case Numbers((None, 2), _, 10.0) if key.unit == "m":
            return "a list of points [x, y]"
        case Numbers(_, low, high):
            size = key.kind.description.split(" numbers")[0]
            return f"{size} numbers, {low:g} to {high:g}{unit}"
    return key.kind.description + (unit and f" [{key.unit}]")


def _default_text(key: Key) -> str:
    """Return the default of a key, or the condition under which it is required."""
    if key.otherwise.startswith(("or ", "required ", "not required ")):
        return f"; {key.otherwise}"
    if key.otherwise:
        return f"; default: {key.otherwise}"
    if key.required:
        return ""
    if isinstance(key.default, bool):
        return f"; default: {str(key.default).lower()}"
    if isinstance(key.default, tuple):
        return "; default: " + ", ".join(f"{number:g}" for number in key.default)
    return f"; default: {key.default if isinstance(key.default, str) else f'{key.default:g}'}"


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0)
