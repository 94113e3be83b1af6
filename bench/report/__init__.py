"""Charts of the measurements: as a page, as pictures and in `docs/results.md`.

`CHARTS` names every chart; `made` draws them, `write_report` and `write_results` write them down.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

from plate_core import PlateError
from report.chart import Chart, Data
from report.forces import force_map, inversion, learning, rotations
from report.loop import control, tracking
from report.model import model
from report.page import write_report
from report.results import write_results
from report.solver import options, solver, steering
from report.stability import STABILITY
from report.world import cost, sim, vision

__all__ = ["CHARTS", "made", "write_report", "write_results"]

CHARTS: tuple[tuple[Callable[[Data], Chart], tuple[str, ...]], ...] = (
    (force_map, ("force_map",)),
    (solver, ("solver",)),
    (options, ("options",)),
    (steering, ("steering",)),
    (rotations, ("rotations",)),
    (inversion, ("inversion",)),
    (sim, ("sim", "bodies")),
    (model, ("model",)),
    (vision, ("vision",)),
    (control, ("control",)),
    (tracking, ("tracking",)),
    (cost, ("stages", "sim")),
    (learning, ("learning",)),
    *((make, ("stability",)) for make in STABILITY),
)
"""Every chart, and the measurements that it is drawn from."""


def made(data: Data) -> Iterator[Chart]:
    """Yield all charts for which there are measurements; the others are told."""
    for make, names in CHARTS:
        try:
            if names[0] not in data:
                raise PlateError(f"measurement {names[0]} is not there")
            yield make(data)
        except PlateError as error:
            print(f"left out a chart: {error}", file=sys.stderr)
