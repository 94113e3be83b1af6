"""The chart of the simulator's model of parts. The model omits computations that a scene does not
need, such as collisions of distant parts."""

from __future__ import annotations

from harness import shown
from report.axis import Axis
from report.chart import Drawn
from report.panels import BASELINE, PROJECT, SECOND, THIRD, Panels, Row, Style, group_rows

COLOURS = (PROJECT, BASELINE, SECOND, THIRD, "#8a6d00")
"""Colours of scenes."""

STYLES = {
    method: Style(name, colour, marker, "-")
    for method, name, colour, marker in (
        ("one model", "finite parts, in steps", PROJECT, "o"),
        ("by events", "reference, by events", SECOND, "s"), ("pymunk", "pymunk", BASELINE, "D"),
    )
}  # fmt: skip
"""Appearance of methods."""

MIN_UM = 1e-4
"""Minimum drawn error [um]. Smaller errors are rounding errors, and are drawn at this value."""


def model(rows: list[Row]) -> Drawn:
    """Return the chart of the CPU time and the error of a cycle, by scene and number of parts."""
    panels, ours = Panels(), group_rows([r for r in rows if r["method"] == "one model"], "scene")
    parts, time = Axis("parts", log=True), Axis("CPU time of a cycle [ms]", log=True)
    for scene, scene_rows in group_rows(rows, "scene").items():
        panel = panels.add(scene, parts, time)
        panel.kinds(scene_rows, "method", "parts", "cpu_ms", STYLES, note="error {error_um:.3g} µm")
    error = Axis("error after a cycle [µm]", log=True, minimum=MIN_UM)
    last = panels.add("Error of finite parts", parts, error)
    for (scene, scene_rows), colour in zip(ours.items(), COLOURS, strict=False):
        last.points(scene_rows, "parts", "error_um", Style(f"error, {scene}", colour, "s", "-"))
    largest = [scene_rows[-1] for scene_rows in ours.values()]
    times = ", ".join(f"{r['scene']} {shown(r['cpu_ms'])}" for r in largest)
    return Drawn(
        panels,
        f"CPU time of a cycle with {largest[0]['parts']} parts [ms], by scene: {times}.",
    )
