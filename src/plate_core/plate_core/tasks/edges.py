"""Checks of a scenario's positions against the minimum distance from the plate's edges.

The distances are those of `Rig.edge_margin`. The functions return messages for the user.
"""

from __future__ import annotations

import numpy as np

from ..rig import Rig
from .tasks import (
    AssembleTask,
    FollowTask,
    MoveTask,
    Point,
    PoseTask,
    Scenario,
)

ROUNDING_M = 1e-9
"""Tolerance for the rounding of lengths in decimal notation [m]."""

Place = tuple[str, str, Point]
"""A position in a scenario file: the key, the class of the part, and the point (x, y)."""


def goal_places(scenario: Scenario) -> list[Place]:
    """Return the points to which a task moves the centres of parts, and the points at which it
    keeps them."""
    task = scenario.task
    if isinstance(task, FollowTask):
        key = "task: paths"
        return [(key, path.label, point) for path in task.paths for point in path.waypoint]
    if isinstance(task, AssembleTask):
        places = zip(task.labels, task.place, strict=True)
        return [("task: places_m", label, point) for label, point in places]
    if isinstance(task, MoveTask):
        return [
            ("task: targets: place_m", target.id.rpartition("_")[0], target.place)
            for target in task.targets
        ]
    if isinstance(task, PoseTask):
        key = "task: poses: place_m"
        goals = [(key, pose.label, pose.place) for pose in task.poses if pose.place is not None]
        stay = {pose.label for pose in task.poses if pose.place is None and not task.anywhere}
        staying = [group for group in scenario.parts if group.label in stay]
        start = "parts: positions_m"
        return goals + [(start, g.label, point) for g in staying for point in g.position or ()]
    return []


def edge_problem(label: str, point: Point, rig: Rig) -> str:
    """Return the reason why parts of a class cannot be moved to a point [m, plate_home]. Return ""
    if this is possible."""
    min_m = rig.edge_margin(label).min_m
    limit, (x, y) = rig.plate.half - min_m, point
    # For NaN, the following condition is false.
    if abs(x) <= limit[0] + ROUNDING_M and abs(y) <= limit[1] + ROUNDING_M:
        return ""
    to_edge_m = float(np.min(rig.plate.half - np.abs(point)))
    return (
        f"({x:g}, {y:g}) m, {1e3 * to_edge_m:.3g} mm from an edge, allowed: "
        f"|x| up to {limit[0]:g}, |y| up to {limit[1]:g} m on this plate, which is "
        f"{1e3 * min_m:.3g} mm from its edges, "
        f"because the plate moves under the parts by up to {1e3 * rig.limits.stroke_m:g} mm (the "
        "stroke)"
    )


def no_place_text(label: str, rig: Rig) -> str:
    """Return the message for a region into which parts of a class cannot be moved. The caller puts
    "NAME has" before the message."""
    min_m = rig.edge_margin(label).min_m
    limit = rig.plate.half - min_m
    return (
        f"no point that is at least {1e3 * min_m:.3g} mm from all edges of the plate, so parts "
        f"would be lost, allowed: a region that overlaps |x| up to {limit[0]:g}, |y| up to "
        f"{limit[1]:g} m"
    )


def edge_warnings(scenario: Scenario, rig: Rig) -> tuple[str, ...]:
    """Return warnings about positions of a task whose distance from an edge is allowed but less
    than advised (`wall_m` of `EdgeMargin`). For each key and class, only the position nearest to an
    edge is reported."""
    warnings: dict[tuple[str, str], tuple[float, str]] = {}
    for key, label, point in goal_places(scenario):
        wall = rig.edge_margin(label).wall_m
        to_edge_m = float(np.min(rig.plate.half - np.abs(point)))
        if to_edge_m >= min(wall - ROUNDING_M, warnings.get((key, label), (np.inf,))[0]):
            continue
        text = (
            f"{key} of {label} is ({point[0]:g}, {point[1]:g}) m, {1e3 * to_edge_m:.3g} mm from an "
            f"edge, advised: {1e3 * wall:.3g} mm, because a push or a slippery spot may move a "
            "part over the edge"
        )
        warnings[key, label] = to_edge_m, text
    return tuple(text for _, text in warnings.values())


def behind_wall(
    low: np.ndarray, high: np.ndarray, label: str, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """Restrict intervals (..., 2) [m, plate_home] to the safe area of a class. This area begins at
    the distance `wall_m` from the edges. If an interval is outside the area, the result is its
    bound nearest to the area."""
    limit = np.maximum(rig.plate.half - rig.edge_margin(label).wall_m, 0.0)
    return np.maximum(low, np.minimum(-limit, high)), np.minimum(high, np.maximum(limit, low))
