"""Write docs/reference.md: all keys of scenario and rig files, from the code that reads them.

python tools/reference.py
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from plate_core import rig, tasks
from plate_core.yaml_fields import Key, Number, Numbers, Section, Whole

PAGE = Path(__file__).resolve().parents[1] / "docs/reference.md"

HEAD = """# All keys of scenario and rig files

Made from the code by `python tools/reference.py`. In brackets: what may stand there, and what
counts where the key is left out; a key without that must be there. What is wrong in a file is
refused with file, key, value and what is allowed.

Coordinates are in `plate_home`: origin at the centre of the plate at rest, x along its long side, y
to the left, angles counter-clockwise from x. How the files are used: [tasks](guide/tasks.md),
[rig](guide/rig.md).
"""


def page() -> str:
    """Return the page."""
    parts = [HEAD, "\n## Scenario files: config/scenarios\n", *_sections(tasks.SECTIONS)]
    parts += ["\n## Rig files: config/rig.yaml\n", *_sections(rig.SECTIONS)]
    return "".join(parts)


def _sections(sections: Iterable[Section]) -> Iterable[str]:
    """Yield the sections of a file; what a key means is said once."""
    told: set[tuple[str, str]] = set()
    for section in sections:
        yield f"\n### `{section.where}`\n\n{section.about}\n\n"
        for key in section.keys:
            meaning = "as above" if (key.name, key.meaning) in told else key.meaning
            told.add((key.name, key.meaning))
            left_out = f"; left out: {_default(key)}" if _default(key) else ""
            yield f"- `{key.name}` ({_what(key)}{left_out}): {meaning}\n"


def _what(key: Key) -> str:
    """Return type, range and unit."""
    unit = "" if key.unit in ("", "-") else f" {key.unit}"
    match key.kind:
        case Number(low, high):
            return f"{low:g} to {high:g}{unit}"
        case Whole(low, high):
            return f"whole number, {low} to {high}{unit}"
        case Numbers(_, low, high):
            size = key.kind.words.split(" numbers")[0]
            return f"{size} numbers, {low:g} to {high:g}{unit}"
    return key.kind.words + (unit and f" [{key.unit}]")


def _default(key: Key) -> str:
    if key.otherwise:
        return key.otherwise
    if key.required:
        return ""
    if isinstance(key.default, str):
        return key.default
    if isinstance(key.default, bool):
        return str(key.default).lower()
    if isinstance(key.default, tuple):
        return ", ".join(f"{number:g}" for number in key.default)
    return f"{key.default:g}"


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0)
