"""What a chart is: panels, the rows that they are drawn from, and what they say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from csv import DictReader, DictWriter
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from plate_core import PlateError
from report.panels import Panels, Row

Data = Mapping[str, Mapping[str, Any]]
"""Measurements by name, as in their JSON files."""


class Drawn(NamedTuple):
    """What is drawn of rows.

    Attributes
    ----------
    panels : Panels
    finding : str
        What comes out, with numbers.
    default : str
        What we take and why, where that depends on them.
    """

    panels: Panels
    finding: str
    default: str = ""


@dataclass(frozen=True)
class Chart:
    """A figure that answers one question, the rows behind it, and what they say.

    Attributes
    ----------
    key : str
        Name of files and of the place in the page.
    letter : str
        Of the list of charts; may be empty.
    title, reading : str
        The question; how to read the figure.
    finding : str
        What comes out, with numbers.
    default : str
        What we take and why; empty where nothing is to be chosen.
    panels : Panels
    sheet : Sheet
        The rows that it is drawn from.
    sources : tuple of str
        The measurements that these are from.
    """

    key: str
    letter: str
    title: str
    reading: str
    finding: str
    default: str
    panels: Panels
    sheet: Sheet = field(default_factory=lambda: Sheet([]))
    sources: tuple[str, ...] = ()

    @property
    def full_title(self) -> str:
        """The title with its letter."""
        return f"({self.letter}) {self.title}" if self.letter else self.title

    @property
    def frame(self) -> pd.DataFrame:
        """The rows, under their headings."""
        rows, columns = self.sheet.rows, self.sheet.columns
        heads = {key: columns.get(key, key.replace("_", " ")) for key in rows[0]}
        return pd.DataFrame(rows, dtype=object).rename(columns=heads)


@dataclass(frozen=True)
class Sheet:
    """The rows that a chart is drawn from, all with the same keys: its table and its CSV file.

    Attributes
    ----------
    rows : list of dict
    columns : mapping of str to str
        Key of a row -> heading with its unit.
    """

    rows: list[Row]
    columns: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, rows: Sequence[Row], columns: dict[str, str]) -> Sheet:
        """Give all rows the same keys, those that have headings first; None where one had none."""
        there = {key for row in rows for key in row}
        keys = [key for key in columns if key in there]
        keys += [key for row in rows for key in row if key not in columns]
        return cls([{key: row.get(key) for key in dict.fromkeys(keys)} for row in rows], columns)

    @classmethod
    def read(cls, path: Path, columns: dict[str, str]) -> Sheet:
        """Read a CSV file that `write` made.

        Raises
        ------
        PlateError
            If it is not there, or empty.
        """
        if not path.exists():
            raise PlateError(f"not measured, and {path} does not exist")
        with path.open(encoding="utf-8", newline="") as file:
            rows = [{key: value_of(cell) for key, cell in row.items()} for row in DictReader(file)]
        if not rows:
            raise PlateError(f"{path} has no rows")
        return cls(rows, columns)

    @property
    def csv(self) -> str:
        """The rows as text, under their keys."""
        file = StringIO()
        writer = DictWriter(file, list(self.rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return file.getvalue()


def value_of(cell: str) -> str | bool | float | None:
    """Return what a cell of a CSV file was: nothing, a truth, a number or a word."""
    words = {"": None, "True": True, "False": False}
    if cell in words:
        return words[cell]
    for kind in (int, float):
        with suppress(ValueError):
            return kind(cell)
    return cell


def table(data: Data, name: str, key: str) -> Sheet:
    """Return one table of a measurement.

    Raises
    ------
    PlateError
        If it is not there: the measurement is of older code.
    """
    found = [t for t in data[name]["tables"] if t["key"] == key] if name in data else []
    if not found:
        raise PlateError(f"measurement {name} has no table {key!r}: repeat it")
    return Sheet.of(found[0]["rows"], found[0]["columns"])


def column(rows: Sequence[Row], key: str) -> list[Any]:
    """Return the values of a column."""
    return [row[key] for row in rows]


def parts(count: Any) -> str:
    """Return a number of parts in words."""
    return f"{count} part{'s' * (count > 1)}"
