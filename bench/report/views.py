"""The chart of scenes as real cameras see them: what is detected, and how well."""

from __future__ import annotations

from report.axis import Axis
from report.chart import Drawn
from report.panels import OURS, PEER, Look, Panels, Row

LEAST_MM = 0.01
"""Errors below this are the noise of a pixel, and drawn here [mm]."""

WELL_PERCENT = 99.0
"""Of the parts: fewer are named."""

NOW, BEFORE = Look("now", OURS, "o"), Look("before", PEER, "x")


def scenes(rows: list[Row]) -> Drawn:
    """Return the fraction detected and the error of places by scene, before and now."""
    panels, names = Panels(), tuple(row["scene"] for row in reversed(rows))
    y = Axis("", names=names)
    share = panels.add("Detected", Axis("parts [%]", limits=(-5, 105)), y)
    error = panels.add("Error", Axis("RMS of places [mm]", log=True, least=LEAST_MM), y)
    note = "{false} false, worst {worst_mm} mm"
    at = [row | {"rms_mm": _least(row["rms_mm"])} for row in rows]
    at = [row | {"before_rms_mm": _least(row["before_rms_mm"])} for row in at]
    share.points(at, "detected_percent", "scene", NOW, note=note)
    share.points(at, "before_detected_percent", "scene", BEFORE)
    error.points(at, "rms_mm", "scene", NOW, note=note)
    error.points(at, "before_rms_mm", "scene", BEFORE)
    lost = [r for r in rows if r["detected_percent"] < WELL_PERCENT]
    silent = [r["scene"] for r in lost if r["told"] and not _all(r["told"])]
    was = sum((r["before_detected_percent"] or 0) >= WELL_PERCENT for r in rows)
    named = ", ".join(f"{r['scene']} ({r['detected_percent']:.0f} %)" for r in lost)
    return Drawn(
        panels,
        f"{WELL_PERCENT:g} % and more are detected in {len(rows) - len(lost)} of {len(rows)} "
        f"scenes, before in {was}; not in: {named or 'none'}. Losses that the detector does not "
        f"report: {', '.join(silent) or 'none'}.",
    )


def _least(value: float | None) -> float | None:
    return None if value is None else max(value, LEAST_MM)


def _all(told: str) -> bool:
    """Whether `a of b` means all."""
    part, _, whole = told.partition(" of ")
    return part == whole
