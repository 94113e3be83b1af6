"""Data for the view in which a user aims the camera."""

from __future__ import annotations

from collections.abc import Sequence

from geometry_msgs.msg import Point

from plate_core.ros import seconds
from plate_interfaces.msg import Aim, AimCheck, LensPictures

from ..scene import Scene
from .values import finite_or_none, state_names

LEVELS = state_names(AimCheck, "OK", "WAIT", "WARN", "ERROR")
STATES = state_names(LensPictures, "IDLE", "TAKING", "FITTING", "FITTED")


def aim_scene(msg: Aim) -> Scene:
    """Convert the detector's measurements in a picture to a message for the page. Positions are in
    pixels."""
    lens = msg.lens
    return {
        "kind": "aim", "stamp": seconds(msg.header.stamp), "width": msg.width, "height": msg.height,
        "sharpness": finite_or_none(msg.sharpness), "best": finite_or_none(msg.sharpness_best),
        "change": finite_or_none(msg.sharpness_change), "black": msg.black, "white": msg.white,
        "histogram": [int(count) for count in msg.histogram],
        "part_px": [round(msg.part_px_min, 2), round(msg.part_px_max, 2)],
        "expected": _point_lists(msg.expected), "seen": _point_lists(msg.seen),
        "things": [
            {
                "id": item.id, "x": finite_or_none(item.x_px), "y": finite_or_none(item.y_px),
                "radius": finite_or_none(item.radius_px), "reason": item.reason,
                "remedy": item.remedy,
            }
            for item in msg.things
        ],
        "checks": [
            {"name": item.name, "level": LEVELS.get(item.level, "error"), "text": item.text}
            for item in msg.checks
        ],
        "home": msg.home, "home_found": msg.home_found,
        "lens": {
            "state": STATES.get(lens.state, "idle"), "kept": lens.kept, "needed": lens.needed,
            "columns": lens.cover_columns, "rows": lens.cover_rows, "cover": list(lens.cover),
            "missing": list(lens.missing), "corners": _point_lists(lens.corners), "text": lens.text,
            "error_px": finite_or_none(lens.error_px), "file": lens.file,
        },
    }  # fmt: skip


def _point_lists(points: Sequence[Point]) -> list[list[float]]:
    return [[round(point.x, 2), round(point.y, 2)] for point in points]
