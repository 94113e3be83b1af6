"""The view to aim by, as the page gets it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from geometry_msgs.msg import Point

from plate_core.ros import seconds
from plate_interfaces.msg import Aim, AimCheck, LensPictures

from ..scene import Scene

LEVELS = {
    AimCheck.OK: "ok",
    AimCheck.WAIT: "wait",
    AimCheck.WARN: "warn",
    AimCheck.ERROR: "error",
}
STATES = {
    LensPictures.IDLE: "idle",
    LensPictures.TAKING: "taking",
    LensPictures.FITTING: "fitting",
    LensPictures.FITTED: "fitted",
}


def aim_scene(msg: Aim) -> Scene:
    """Return what the detector measured in a picture; places in pixels."""
    lens = msg.lens
    return {
        "kind": "aim", "stamp": seconds(msg.header.stamp), "width": msg.width, "height": msg.height,
        "sharpness": _number(msg.sharpness), "best": _number(msg.sharpness_best),
        "change": _number(msg.sharpness_change), "black": msg.black, "white": msg.white,
        "histogram": [int(count) for count in msg.histogram],
        "part_px": [round(msg.part_px_min, 2), round(msg.part_px_max, 2)],
        "expected": _points(msg.expected), "seen": _points(msg.seen),
        "things": [
            {
                "id": one.id, "x": _number(one.x_px), "y": _number(one.y_px),
                "radius": _number(one.radius_px), "reason": one.reason, "remedy": one.remedy,
            }
            for one in msg.things
        ],
        "checks": [
            {"name": one.name, "level": LEVELS.get(one.level, "error"), "text": one.text}
            for one in msg.checks
        ],
        "home": msg.home, "home_found": msg.home_found,
        "lens": {
            "state": STATES.get(lens.state, "idle"), "kept": lens.kept, "needed": lens.needed,
            "columns": lens.cover_columns, "rows": lens.cover_rows, "cover": list(lens.cover),
            "missing": list(lens.missing), "corners": _points(lens.corners), "text": lens.text,
            "error_px": _number(lens.error_px), "file": lens.file,
        },
    }  # fmt: skip


def _points(points: Sequence[Point]) -> list[list[float]]:
    return [[round(point.x, 2), round(point.y, 2)] for point in points]


def _number(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None
