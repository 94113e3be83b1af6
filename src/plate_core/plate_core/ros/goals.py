"""Scenarios as goals of actions, and back. A goal is checked as a scenario file is."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from geometry_msgs.msg import Point

from plate_interfaces.action import AssembleParts, FollowPaths, PoseParts, SortParts
from plate_interfaces.msg import PartCount, Path, Place, Region

from ..errors import ScenarioError
from ..tasks import (
    AssembleTask,
    Bin,
    FollowTask,
    PathTask,
    PoseTask,
    Scenario,
    SortTask,
    read_scenario,
    side_name,
)
from ..yaml_fields import Fields

ACTIONS: Mapping[str, Any] = {
    "sort_parts": SortParts,
    "follow_paths": FollowPaths,
    "assemble_parts": AssembleParts,
    "pose_parts": PoseParts,
}
"""The planner's actions, by name."""

NOWHERE = float("nan")


def scenario_to_goal(scenario: Scenario) -> tuple[str, Any]:
    """Return the name of the action that does a scenario, and the goal to send."""
    for name, (kind, write, _) in KINDS.items():
        if isinstance(scenario.task, kind):
            goal = ACTIONS[name].Goal(time_limit_s=float(scenario.time_limit_s))
            goal.parts = [PartCount(type=g.label, count=g.count) for g in scenario.parts]
            write(scenario.task, goal)
            return name, goal
    raise TypeError(f"no action does a {type(scenario.task).__name__}")


def goal_to_scenario(goal: Any) -> Scenario:
    """Return the scenario of a goal, named by the kind of its task.

    Raises
    ------
    ScenarioError
        As `load_scenario` does: names the key of a scenario file that the goal's field stands for,
        its value and what is allowed.
    """
    name = next(name for name, action in ACTIONS.items() if isinstance(goal, action.Goal))
    kind = name.partition("_")[0]
    data = {
        "description": name,
        "marked": kind == "pose",
        "parts": [{"class": part.type, "count": part.count} for part in goal.parts],
        "task": {"kind": kind, **KINDS[name][2](goal)},
        "time_limit_s": goal.time_limit_s,
    }
    return read_scenario(Fields(data, name, ScenarioError), kind)


def _write_sort(task: SortTask, goal: Any) -> None:
    goal.goal_fraction, goal.hold_s = float(task.goal_fraction), float(task.hold_s)
    goal.regions = [
        Region(type=label, polygon=[_point(at) for at in region.corner])
        if isinstance(region, Bin)
        else Region(type=label, side=side_name(region))
        for label, region in task.regions.items()
    ]


def _read_sort(goal: Any) -> dict[str, Any]:
    _each_once("regions", [region.type for region in goal.regions])
    regions = {
        region.type: region.side or {"bin_m": [[at.x, at.y] for at in region.polygon]}
        for region in goal.regions
    }
    sides = any(region.side for region in goal.regions)
    return {
        "regions": regions,
        "hold_s": goal.hold_s,
        **({"goal_fraction": goal.goal_fraction} if sides or goal.goal_fraction else {}),
    }


def _write_follow(task: FollowTask, goal: Any) -> None:
    goal.max_error_m = float(task.max_error_m)
    goal.paths = [_path(path) for path in task.paths]


def _path(path: PathTask) -> Path:
    return Path(
        type=path.label,
        waypoints=[_point(at) for at in path.waypoint],
        closed=path.closed,
        laps=float(path.laps),
        speed=float(path.speed),
        profile_fractions=[float(at) for at, _ in path.profile],
        profile_speeds=[float(speed) for _, speed in path.profile],
    )


def _read_follow(goal: Any) -> dict[str, Any]:
    return {"paths": [_read_path(path) for path in goal.paths], "max_error_m": goal.max_error_m}


def _read_path(path: Path) -> dict[str, Any]:
    at, speed = list(path.profile_fractions), list(path.profile_speeds)
    if len(at) != len(speed):
        raise ScenarioError(
            f"follow_paths: {len(at)} profile_fractions and {len(speed)} profile_speeds, "
            "allowed: as many"
        )
    return {
        "class": path.type,
        "waypoints_m": [[point.x, point.y] for point in path.waypoints],
        "closed": path.closed,
        "speed_mps": [list(pair) for pair in zip(at, speed, strict=True)] or path.speed,
        **({"laps": path.laps} if path.closed else {}),
    }


def _write_assemble(task: AssembleTask, goal: Any) -> None:
    goal.tolerance_m, goal.hold_s = float(task.tolerance_m), float(task.hold_s)
    goal.places = [
        Place(type=label, x=float(x), y=float(y))
        for label, (x, y) in zip(task.labels, task.place, strict=True)
    ]


def _read_assemble(goal: Any) -> dict[str, Any]:
    places: dict[str, list[list[float]]] = {}
    for place in goal.places:
        places.setdefault(place.type, []).append([place.x, place.y])
    return {"places_m": places, "tolerance_m": goal.tolerance_m, "hold_s": goal.hold_s}


def _write_pose(task: PoseTask, goal: Any) -> None:
    goal.tolerance_m, goal.hold_s = float(task.tolerance_m), float(task.hold_s)
    goal.tolerance_rad = float(task.tolerance_rad)
    for pose in task.poses:
        x, y = pose.place or (NOWHERE, NOWHERE)
        goal.poses.append(Place(type=pose.label, x=float(x), y=float(y), angle=float(pose.angle)))


def _read_pose(goal: Any) -> dict[str, Any]:
    return {
        "poses": [
            {
                "class": pose.type,
                "angle_deg": math.degrees(pose.angle),
                **(
                    {}
                    if math.isnan(pose.x) and math.isnan(pose.y)
                    else {"place_m": [pose.x, pose.y]}
                ),
            }
            for pose in goal.poses
        ],
        "tolerance_m": goal.tolerance_m,
        "tolerance_deg": math.degrees(goal.tolerance_rad),
        "hold_s": goal.hold_s,
    }


KINDS: Mapping[str, tuple[type, Callable[[Any, Any], None], Callable[[Any], dict[str, Any]]]] = {
    "sort_parts": (SortTask, _write_sort, _read_sort),
    "follow_paths": (FollowTask, _write_follow, _read_follow),
    "assemble_parts": (AssembleTask, _write_assemble, _read_assemble),
    "pose_parts": (PoseTask, _write_pose, _read_pose),
}
"""By action: the task, and how it becomes a goal and back."""


def _point(at: tuple[float, float]) -> Point:
    return Point(x=float(at[0]), y=float(at[1]))


def _each_once(what: str, labels: list[str]) -> None:
    again = next((label for label in labels if labels.count(label) > 1), None)
    if again is not None:
        raise ScenarioError(f"{what}: {again} stands twice, allowed: each type once")
