"""Tasks of a few seconds, for tests that run programs."""

from dataclasses import replace
from typing import Any

from plate_core.tasks import Scenario, load_scenario

FEW_STARTS = {"restarts": 10}
"""Options of the solver in a tested loop: a quarter of the default searches is sufficient."""

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
"""Scenario in which no part leaves the plate, even if images or results are late."""


def with_few(name: str, count: int = 1) -> Scenario:
    """Return a scenario of the project with `count` parts of each class."""
    scenario = load_scenario(name)
    return replace(scenario, parts=tuple(replace(g, count=count) for g in scenario.parts))


def short_task(way_m: float, time_limit_s: float) -> dict[str, Any]:
    """Return a scenario in which one part moves along x."""
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
