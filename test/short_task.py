"""Tasks of a few seconds, for tests that run programs."""

from typing import Any

MIDDLE: dict[str, Any] = {
    "description": "Two parts change sides, far from the edges.",
    "parts": [
        {"class": "black", "positions_m": [[-0.1, 0.03]]},
        {"class": "grey", "positions_m": [[0.1, -0.03]]},
    ],
    "task": {
        "kind": "assemble",
        "places_m": {"black": [[0.1, 0.03]], "grey": [[-0.1, -0.03]]},
        "tolerance_m": 0.003,
        "hold_s": 1.0,
    },
    "time_limit_s": 180,
}
"""No part leaves the plate, also where images or answers are late."""


def short_task(way_m: float, time_limit_s: float) -> dict[str, Any]:
    """Return a scenario: one part goes along x."""
    path = {
        "class": "black",
        "waypoints_m": [[0.0, 0.0], [way_m, 0.0]],
        "speed_mps": 0.01,
        "closed": False,
    }
    return {
        "description": f"One part goes {1e3 * way_m:g} mm.",
        "parts": [{"class": "black", "positions_m": [[0.0, 0.0]]}],
        "task": {"kind": "follow", "max_error_m": 0.03, "paths": [path]},
        "time_limit_s": time_limit_s,
    }
