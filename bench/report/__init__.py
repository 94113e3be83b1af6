"""Charts of the measurements: as a page, as pictures and in `docs/results.md`.

`CHARTS` lists all charts. `made` draws the charts, and `write_report` and `write_results` write
them to files.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import yaml

from maps.stability import MAPS
from plate_core import PlateError
from report.chart import Chart, Data, Drawn, Sheet, table
from report.documents import fill_documents, names
from report.feeding import feeding
from report.forces import force_map, learning
from report.loop import cameras, drives, rigs, tracking
from report.model import model
from report.page import write_report
from report.panels import Row
from report.results import read_facts, write_results
from report.solver import options, solver, solver_rows
from report.stability import chart_of, rows_of, texts_of
from report.world import cost, cost_rows, sim, sim_rows, vision

__all__ = [
    "CHARTS", "fill_documents", "made", "names", "read_facts", "write_report", "write_results",
]  # fmt: skip


class Entry(NamedTuple):
    """Definition of a chart: key, function that draws it from rows, function that extracts the rows
    from measurements, and names of these measurements."""

    key: str
    draw: Callable[[list[Row]], Drawn]
    rows: Callable[[Data], Sheet]
    sources: tuple[str, ...]


def table_entry(
    draw: Callable[[list[Row]], Drawn], key: str, measurement: str = "", name: str = ""
) -> Entry:
    """Return the entry of a chart whose rows are one table of a measurement. By default, the
    measurement and the table have the same name as the chart."""
    source = measurement or key
    return Entry(key, draw, lambda data: table(data, source, name or key), (source,))


CHARTS: tuple[Entry, ...] = (
    table_entry(force_map, "force_map"),
    Entry("solver", solver, solver_rows, ("solver",)),
    table_entry(options, "options"),
    Entry("sim", sim, sim_rows, ("sim", "bodies")),
    table_entry(model, "model"),
    table_entry(vision, "vision"),
    table_entry(tracking, "tracking"),
    table_entry(cameras, "cameras", "free_running"),
    table_entry(drives, "drives"),
    table_entry(rigs, "rigs"),
    Entry("cost", cost, cost_rows, ("stages", "sim")),
    table_entry(learning, "learning"),
    table_entry(feeding, "feeding"),
    *(
        Entry(
            f"stability_{key}",
            partial(chart_of, stability_map=stability_map),
            partial(rows_of, stability_map=stability_map),
            ("stability",),
        )
        for key, stability_map in MAPS.items()
    ),
)
"""Definitions of all charts."""

TEXTS: dict[str, dict[str, str]] = {
    **yaml.safe_load(Path(__file__).with_name("charts.yaml").read_text(encoding="utf-8")),
    **{f"stability_{key}": texts_of(stability_map) for key, stability_map in MAPS.items()},
}
"""Texts of each chart by its key: `title`, `reading`, and for most charts `letter` and
`default`."""


def made(data: Data, folder: Path, columns: Mapping[str, dict[str, str]]) -> list[Chart]:
    """Draw all charts from measurements, or from CSV files if measurements are missing.

    A chart without a measurement and without a CSV file is omitted, and a message is printed on
    stderr.

    Parameters
    ----------
    data : mapping
        Measurements by name, as in their JSON files.
    folder : path
        Folder of the CSV files of earlier measurements.
    columns : mapping
        Headings of each chart's CSV file by column, by the key of the chart.
    """
    charts, old = [], []
    for chart in CHARTS:
        measured = all(name in data for name in chart.sources)
        try:
            if measured:
                sheet = chart.rows(data)
            else:
                sheet = Sheet.read(folder / f"{chart.key}.csv", columns.get(chart.key, {}))
            panels, finding, default = chart.draw(sheet.rows)
        except PlateError as error:
            print(f"chart {chart.key} is omitted: {error}", file=sys.stderr)
        except KeyError as key:
            why = f"its stored rows have no column {key}"
            print(f"chart {chart.key} is omitted: {why}", file=sys.stderr)
        else:
            texts = {"letter": "", "default": default} | TEXTS[chart.key]
            charts.append(
                Chart(
                    chart.key,
                    **texts,
                    finding=finding,
                    panels=panels,
                    sheet=sheet,
                    sources=chart.sources,
                )
            )
            old += [chart.key] * (not measured)
    if old:
        text = f"charts without a new measurement, drawn from {folder}"
        print(f"{text}: {', '.join(old)}", file=sys.stderr)
    return charts
