"""The chart of the simulator's one model: no more is computed than a scene needs."""

from __future__ import annotations

from harness import shown
from report.axis import Axis
from report.chart import Drawn
from report.panels import OURS, PEER, SECOND, THIRD, Look, Panels, Row, by

COLOURS = (OURS, PEER, SECOND, THIRD, "#8a6d00")
"""Of scenes."""

LOOKS = {
    name: Look(name, colour, marker, "-")
    for name, colour, marker in (
        ("one model", OURS, "o"), ("by events", SECOND, "s"), ("pymunk", PEER, "D"),
    )
}  # fmt: skip
"""Of methods."""

LEAST_UM = 1e-4
"""Errors below this [um] are rounding, and drawn here."""


def model(rows: list[Row]) -> Drawn:
    """Return what a cycle of the plate costs by scene and number of parts, and its error."""
    panels, ours = Panels(), by([r for r in rows if r["method"] == "one model"], "scene")
    parts, time = Axis("parts", log=True), Axis("core time of a cycle [ms]", log=True)
    for scene, mine in by(rows, "scene").items():
        panel = panels.add(scene, parts, time)
        panel.kinds(mine, "method", "parts", "cpu_ms", LOOKS, note="error {error_um:.3g} µm")
    error = Axis("error after a cycle [µm]", log=True, least=LEAST_UM)
    last = panels.add("Error of the one model", parts, error)
    for (scene, mine), colour in zip(ours.items(), COLOURS, strict=False):
        last.points(mine, "parts", "error_um", Look(f"error, {scene}", colour, "s", "-"))
    most = [mine[-1] for mine in ours.values()]
    told = ", ".join(f"{r['scene']} {shown(r['cpu_ms'])}" for r in most)
    return Drawn(
        panels,
        f"CPU time of a cycle with {most[0]['parts']} parts [ms]: {told}.",
    )
