"""Functions for results of agents. The functions check the form of a result, summarise its rows,
and convert values to text.

A result is a dict that can be stored as JSON. For each task, a result contains a row for each
episode and the summary of these rows. A result may come from another person. Therefore, `read`
limits its size, `validate` checks its form, and `shortened` removes control characters from its
texts.
"""

from __future__ import annotations

import json
import re
import reprlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from plate_core import PlateError
from plate_core.files import read_file
from plate_core.intervals import of_median, of_rate

from .isolation import LIMITS
from .tasks import TASKS, WORLDS, chosen

__all__ = ["ROW", "TIMES", "ranges", "read", "summary", "validate"]

TIMES = ("start_ms", "decision_ms", "decision_ms_p99", "wall_ms", "wall_ms_p99")
"""Keys of the computing times in a row. Computing times differ between repetitions of an
episode."""

NUMBERS = ("time_s", "return", "error_mm", "turn_error_deg", "limit_share", *TIMES)
"""Keys of a row whose values are floating-point numbers."""

ROW: dict[str, type] = dict.fromkeys(NUMBERS, float) | {
    "seed": int, "steps": int, "there": int, "dropped": int, "success": bool, "places": str
}  # fmt: skip
"""Keys of a row and the types of their values. If the agent exceeded a limit in the episode, the
row contains zeros, and an additional key `failure` names the limit."""

RESULT: dict[str, type] = {
    "agent": str, "world": str, "commit": str, "sources": str, "versions": dict, "tasks": dict
}  # fmt: skip
"""Keys of a result and the types of their values."""

LATER: dict[str, type] = {"limits": dict, "files": dict}
"""Additional keys of a result and the types of their values. Results of earlier versions of this
module do not contain these keys."""

MAX_NAMES = 10_000
"""Maximum number of versions in a result, and maximum number of an agent's files in a result."""

HUGE, WHOLE = 1e9, 2**128
"""Limits of the numbers in a result. The absolute values of floating-point numbers must be below
`HUGE`, and those of integers below `WHOLE`. Python refuses to print integers with many digits."""

RESULT_BYTES = 64_000_000
"""Maximum size of a file with a result [bytes]. The size is sufficient for 100,000 episodes of 500
bytes each."""

TEXT = 300
"""Maximum length of texts in results, and of error messages from agents [characters]."""


def read(path: Path) -> Any:
    """Return the content of a JSON file of at most `RESULT_BYTES`.

    Raises
    ------
    PlateError
        If the file cannot be read or is not valid JSON. The message contains the name of the file.
    """
    content = read_file(path, RESULT_BYTES)
    try:
        return json.loads(content.decode(), object_pairs_hook=_without_repetition)
    # `json.loads` also raises these errors for huge numbers and deep nesting.
    except (ValueError, RecursionError) as problem:
        raise PlateError(f"{path} is not JSON: {problem}") from problem


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Convert the pairs of a JSON object to a dict. Raise a ValueError if a key occurs twice,
    because a reader of the file could see another value than the program."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("an object has a key twice, allowed: each key once")
    return found


def validate(result: Any) -> None:
    """Check that data has the form of a result of `evaluate`. The keys, the types and the ranges of
    numbers are checked.

    Raises
    ------
    PlateError
        If the data does not have this form. The message contains the place, the value and the
        allowed values.
    """
    earlier = isinstance(result, dict) and not set(LATER) & set(result)
    check_fields("result", result, RESULT if earlier else RESULT | LATER)
    for key in ("versions", "files"):
        texts = result.get(key, {})
        check_fields(f"result: {key}", texts, dict.fromkeys(texts, str))
        if len(texts) > MAX_NAMES:
            raise PlateError(f"result: {key} has {len(texts)} names, allowed: at most {MAX_NAMES}")
    if not earlier:
        check_fields("result: limits", result["limits"], dict.fromkeys(asdict(LIMITS), float))
    for key, form in (("agent", r"[\w.]+(:\w+)?"), ("commit", r"[\w.-]*")):
        if not re.fullmatch(form, result[key]):
            raise PlateError(f"result: {key} is {result[key]!r}, allowed: the form {form}")
    chosen("result: world", result["world"], WORLDS)
    if not result["tasks"]:
        raise PlateError("result: tasks is {}, allowed: one task or more")
    for task, found in result["tasks"].items():
        chosen("result: task", shortened(task), TASKS)
        rows = found.get("rows") if isinstance(found, dict) else None
        if not isinstance(rows, list) or not rows:
            raise PlateError(f"result: {task}: rows is {brief(rows)}, allowed: a list with entries")
        for k, row in enumerate(rows):
            where = f"result: {task}: rows[{k}]"
            failed = isinstance(row, dict) and "failure" in row
            check_row(where, row, ROW | {"failure": str} if failed else ROW)
            if failed and row["success"]:
                raise PlateError(
                    f"{where}: success is True, allowed in a row with a failure: False"
                )
        if len({row["seed"] for row in rows}) < len(rows):
            raise PlateError(f"result: {task}: a seed occurs twice, allowed: each seed once")


def check_row(where: str, row: Any, kinds: dict[str, type]) -> None:
    """Raise an error unless `row` has exactly the keys of `kinds`, with values of their types. The
    seed and the computing times must not be negative."""
    check_fields(where, row, kinds)
    for key in ("seed", *TIMES):
        if row[key] < 0:
            raise PlateError(f"{where}: {key} is {row[key]}, allowed: 0 or more")


def check_fields(where: str, found: Any, kinds: dict[str, type]) -> None:
    """Raise an error unless `found` is a dict with exactly the keys of `kinds` and with values of
    their types. Numbers must be finite, and texts must be printable."""
    if not isinstance(found, dict) or set(found) != set(kinds):
        has = shortened(", ".join(map(str, found))) if isinstance(found, dict) else brief(found)
        raise PlateError(f"{where} has {has}, allowed: {', '.join(kinds)}")
    for key, kind in kinds.items():
        value = found[key]
        # The comparison is False for NaN, so NaN is refused.
        number = type(value) in (int, float) and abs(value) < HUGE
        fits = number if kind is float else type(value) is kind
        allowed = f"a number below {HUGE:g}" if kind is float else kind.__name__
        if fits and kind is int and not abs(value) < WHOLE:
            fits, allowed = False, "an integer below 2**128"
        if fits and kind is str and not (len(value) <= TEXT and value.isprintable()):
            fits, allowed = False, f"up to {TEXT} printable characters"
        if not fits:
            raise PlateError(f"{where}: {key} is {brief(value)}, allowed: {allowed}")


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise the episodes of a task."""
    good = [row["time_s"] for row in rows if row["success"]]
    ended = [row for row in rows if "failure" not in row] or rows
    spent = [row["decision_ms"] for row in ended]
    found = {
        "episodes": len(rows),
        "success": len(good) / len(rows),
        "success_interval": of_rate(len(good), len(rows)),
        "return": float(np.mean([row["return"] for row in rows])),
        "dropped": sum(row["dropped"] for row in rows),
        "decision_ms": float(np.median(spent)),
        "decision_ms_interval": of_median(spent),
        "wall_ms": float(np.median([row["wall_ms"] for row in ended])),
    }
    if good:
        found |= {"time_s": float(np.median(good)), "time_s_interval": of_median(good)}
    return found | {"rows": rows}


def line(task: str, found: dict[str, Any]) -> str:
    """Return the summary of a task as one line of text."""
    low, high = (100 * bound for bound in found["success_interval"])
    took = f"{found['time_s']:6.1f} s" if "time_s" in found else "     - s"
    return (
        f"{task:12s} {100 * found['success']:4.0f} % ({low:.0f} to {high:.0f})  {took}  return "
        f"{found['return']:6.2f}  dropped {found['dropped']}  {found['decision_ms']:.1f} ms each"
    )


def ranges(seeds: list[int]) -> str:
    """Convert ascending seeds to a text that contains ranges `FIRST:END`."""
    ends = [k for k in range(1, len(seeds)) if seeds[k] > seeds[k - 1] + 1]
    # The NumPy type `object` permits integers of any size.
    runs = np.split(np.array(seeds, object), ends)
    return ", ".join(f"{run[0]}:{run[-1] + 1}" if len(run) > 1 else f"{run[0]}" for run in runs)


def brief(value: Any) -> str:
    """Convert a value of a result to a short text for a message."""
    return shortened(reprlib.repr(value))


def shortened(text: str) -> str:
    """Shorten a text that comes from an agent or a result to one line of at most `TEXT` printable
    characters. Control characters are replaced by question marks, because they could overwrite
    other lines of a terminal."""
    line = " ".join(text[: 2 * TEXT].split())
    return printable(line if len(line) <= TEXT else f"{line[:TEXT]}...")


def printable(text: str) -> str:
    """Replace each character of a text that is not printable by a question mark."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
