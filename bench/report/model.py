"""The chart of the simulator's one model: no more is computed than a scene needs."""

from __future__ import annotations

from harness import shown
from report.axis import Axis
from report.chart import Chart, Row, by, column
from report.panels import OURS, PEER, SECOND, THIRD, Panels

COLOURS = (OURS, PEER, SECOND, THIRD, "#8a6d00")
"""Of scenes."""

LOOKS = {"one model": (OURS, "o", "-"), "by events": (SECOND, "s", "-"), "pymunk": (PEER, "D", "-")}
"""Colour, marker and line of methods."""

LEAST_UM = 1e-4
"""Errors below this [um] are rounding, and drawn here."""


def model(rows: list[Row]) -> Chart:
    """Return what a cycle of the plate costs by scene and number of parts, and its error."""
    panels, ours = Panels(), [r for r in rows if r["method"] == "one model"]
    for scene, mine in by(rows, "scene").items():
        panel = panels.add(
            scene, Axis("parts", log=True), Axis("core time of a cycle [ms]", log=True)
        )
        for method, these in by(mine, "method").items():
            notes = [f"error {shown(r['error_um'])} µm" for r in these]
            panel.points(
                method, column(these, "parts"), column(these, "cpu_ms"), *LOOKS[method],
                notes=notes,
            )  # fmt: skip
    last = panels.add(
        "Error of the one model",
        Axis("parts", log=True),
        Axis("error after a cycle [µm]", log=True),
    )
    for (scene, mine), colour in zip(by(ours, "scene").items(), COLOURS, strict=False):
        last.points(
            f"error, {scene}", column(mine, "parts"), column(mine, "error_um", LEAST_UM), colour,
            "s", "-",
        )  # fmt: skip
    most = [mine[-1] for mine in by(ours, "scene").values()]
    told = ", ".join(f"{r['scene']} {shown(r['cpu_ms'])}" for r in most)
    return Chart(
        "model", "c", "Simulator: no more is computed than a scene needs",
        "A cycle of the plate of 100 ms. By events is the judge, points that neither meet nor "
        "turn.",
        f"One model, {most[0]['parts']} parts, core time of a cycle [ms]: {told}.",
        "The one model.",
        panels,
    )  # fmt: skip
