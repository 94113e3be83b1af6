"""Data of a chart: its panels, the rows from which they are drawn, and its texts."""

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
    """Result of drawing rows.

    Attributes
    ----------
    panels : Panels
    finding : str
        Conclusion, with numbers.
    default : str
        The project's choice and its reason, if it depends on the rows.
    """

    panels: Panels
    finding: str
    default: str = ""


@dataclass(frozen=True)
class Chart:
    """A chart: a figure that shows the result for one question, with its rows and texts.

    Attributes
    ----------
    key : str
        Name of its files, and of its section in the page.
    letter : str
        Letter of the chart in the list of charts, or empty.
    title, reading : str
        The question, and an explanation of the figure.
    finding : str
        Conclusion, with numbers.
    default : str
        The project's choice and its reason, or an empty text if there is no choice.
    panels : Panels
    sheet : Sheet
        Rows from which the chart is drawn.
    sources : tuple of str
        Measurements of these rows.
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
        """The rows as a table with headings."""
        rows, columns = self.sheet.rows, self.sheet.columns
        heads = {key: columns.get(key, key.replace("_", " ")) for key in rows[0]}
        return pd.DataFrame(rows, dtype=object).rename(columns=heads)


@dataclass(frozen=True)
class Sheet:
    """Rows from which a chart is drawn, all with the same keys. These rows are the chart's table
    and CSV file.

    Attributes
    ----------
    rows : list of dict
    columns : mapping of str to str
        Heading with unit, by key of a row.
    """

    rows: list[Row]
    columns: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, rows: Sequence[Row], columns: dict[str, str]) -> Sheet:
        """Return a sheet in which all rows have the same keys. Keys with headings come first.
        Missing values are None."""
        present = {key for row in rows for key in row}
        keys = [key for key in columns if key in present]
        keys += [key for row in rows for key in row if key not in columns]
        return cls([{key: row.get(key) for key in dict.fromkeys(keys)} for row in rows], columns)

    @classmethod
    def read(cls, path: Path, columns: dict[str, str]) -> Sheet:
        """Read a CSV file that contains the text of the property `csv`.

        Raises
        ------
        PlateError
            If the file does not exist, or is empty.
        """
        if not path.exists():
            raise PlateError(f"there is no measurement, and {path} does not exist")
        with path.open(encoding="utf-8", newline="") as file:
            rows = [{key: value_of(cell) for key, cell in row.items()} for row in DictReader(file)]
        if not rows:
            raise PlateError(f"{path} has no rows")
        return cls(rows, columns)

    @property
    def csv(self) -> str:
        """The rows as CSV text, with their keys in the first line."""
        file = StringIO()
        writer = DictWriter(file, list(self.rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return file.getvalue()


def value_of(cell: str) -> str | bool | float | None:
    """Return the value of a CSV cell: None, a bool, a number or a text."""
    constants = {"": None, "True": True, "False": False}
    if cell in constants:
        return constants[cell]
    for kind in (int, float):
        with suppress(ValueError):
            return kind(cell)
    return cell


def table(data: Data, name: str, key: str) -> Sheet:
    """Return one table of a measurement.

    Raises
    ------
    PlateError
        If the table does not exist, because the measurement is from older code.
    """
    found = [t for t in data[name]["tables"] if t["key"] == key] if name in data else []
    if not found:
        raise PlateError(f"the result of measurement {name} has no table {key!r}; measure it again")
    return Sheet.of(found[0]["rows"], found[0]["columns"])


def column(rows: Sequence[Row], key: str) -> list[Any]:
    """Return the values of a column."""
    return [row[key] for row in rows]


def parts(count: Any) -> str:
    """Return a text such as "1 part" or "2 parts"."""
    return f"{count} part{'s' * (count > 1)}"
