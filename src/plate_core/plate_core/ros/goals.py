"""Conversion between scenarios and action goals. Goals are checked in the same way as scenario
files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any
from uuid import uuid4

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import Header
from unique_identifier_msgs.msg import UUID

from plate_interfaces.action import (
    AssembleParts,
    FeedParts,
    FollowPaths,
    MoveParts,
    PoseParts,
    SortParts,
)
from plate_interfaces.msg import FeedOrder as FeedOrderMsg
from plate_interfaces.msg import FeedPick, PartCount, Path, Place, Region, TaskStatus

from ..errors import PlateError, ScenarioError
from ..tasks import (
    AssembleTask,
    Bin,
    FeedMode,
    FeedOrder,
    FeedTask,
    FollowTask,
    MoveTask,
    PathTask,
    Pick,
    PoseTask,
    Scenario,
    SortTask,
    read_scenario,
    side_name,
)
from ..yaml_fields import Fields
from .convert import target_to_msg

REFUSED = (TaskStatus.INVALID_GOAL, TaskStatus.NOT_READY, TaskStatus.BUSY)
"""Reasons for which the planner refuses to start a task."""

ACTIONS: Mapping[str, Any] = {
    "sort_parts": SortParts,
    "follow_paths": FollowPaths,
    "assemble_parts": AssembleParts,
    "pose_parts": PoseParts,
    "move_parts": MoveParts,
    "feed_parts": FeedParts,
}
"""The planner's actions, by name."""

NOWHERE = float("nan")


def action_name(goal: Any) -> str:
    """Return the name of the action that a goal message belongs to."""
    return next(name for name, kind in ACTIONS.items() if isinstance(goal, kind.Goal))


def new_goal_id() -> UUID:
    """Return a new goal id. If a goal is sent twice with the same id, the planner starts it only
    once."""
    return UUID(uuid=list(uuid4().bytes))


def scenario_to_goal(scenario: Scenario) -> tuple[str, Any]:
    """Return the name of the action for a scenario, and its goal."""
    for name, (kind, write, _) in KINDS.items():
        if isinstance(scenario.task, kind):
            limit = scenario.time_limit_s
            goal = ACTIONS[name].Goal(time_limit_s=float(limit) if math.isfinite(limit) else 0.0)
            goal.parts = [PartCount(type=g.label, count=g.count) for g in scenario.parts]
            write(scenario.task, goal)
            if name == "move_parts":
                goal.marked = bool(scenario.marked)
            return name, goal
    raise TypeError(f"there is no action for a {type(scenario.task).__name__}")


def goal_to_scenario(goal: Any) -> Scenario:
    """Return the scenario of a goal. The name of the scenario is the kind of its task.

    Raises
    ------
    ScenarioError
        For the same errors as in `load_scenario`. The message states the key of a scenario file
        that corresponds to the field of the goal, its value and the allowed values.
    """
    name = next(name for name, action in ACTIONS.items() if isinstance(goal, action.Goal))
    kind = name.rpartition("_")[0]
    endless = goal.time_limit_s == 0 and (
        kind == "feed" or (kind == "move" and goal.until_canceled)
    )
    data = {
        "description": name,
        "marked": goal.marked if kind == "move" else kind == "pose",
        "parts": [{"class": part.type, "count": part.count} for part in goal.parts],
        "task": {"kind": kind, **KINDS[name][2](goal)},
        **({} if endless else {"time_limit_s": goal.time_limit_s}),
    }
    return read_scenario(Fields(data, name, ScenarioError), kind)


def _write_sort(task: SortTask, goal: Any) -> None:
    goal.goal_fraction, goal.hold_s = float(task.goal_fraction), float(task.hold_s)
    goal.regions = [
        Region(type=label, polygon=[_point_to_msg(corner) for corner in region.corner])
        if isinstance(region, Bin)
        else Region(type=label, side=side_name(region))
        for label, region in task.regions.items()
    ]


def _read_sort(goal: Any) -> dict[str, Any]:
    _check_unique("regions", [region.type for region in goal.regions])
    regions = {
        region.type: region.side or {"bin_m": [[corner.x, corner.y] for corner in region.polygon]}
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
    goal.paths = [_path_to_msg(path) for path in task.paths]


def _path_to_msg(path: PathTask) -> Path:
    return Path(
        type=path.label,
        waypoints=[_point_to_msg(waypoint) for waypoint in path.waypoint],
        closed=path.closed,
        laps=float(path.laps),
        speed=float(path.speed),
        profile_fractions=[float(fraction) for fraction, _ in path.profile],
        profile_speeds=[float(speed) for _, speed in path.profile],
    )


def _read_follow(goal: Any) -> dict[str, Any]:
    return {"paths": [_read_path(path) for path in goal.paths], "max_error_m": goal.max_error_m}


def _read_path(path: Path) -> dict[str, Any]:
    fractions, speed = list(path.profile_fractions), list(path.profile_speeds)
    if len(fractions) != len(speed):
        raise ScenarioError(
            f"follow_paths: {len(fractions)} profile_fractions and {len(speed)} profile_speeds, "
            "allowed: equal numbers"
        )
    return {
        "class": path.type,
        "waypoints_m": [[point.x, point.y] for point in path.waypoints],
        "closed": path.closed,
        "speed_mps": [list(pair) for pair in zip(fractions, speed, strict=True)] or path.speed,
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
    goal.tolerance_rad, goal.anywhere = float(task.tolerance_rad), bool(task.anywhere)
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
        "anywhere": goal.anywhere,
        "tolerance_m": goal.tolerance_m,
        "tolerance_deg": math.degrees(goal.tolerance_rad),
        "hold_s": goal.hold_s,
    }


def _write_move(task: MoveTask, goal: Any) -> None:
    goal.tolerance_m, goal.hold_s = float(task.tolerance_m), float(task.hold_s)
    goal.tolerance_rad, goal.until_canceled = float(task.tolerance_rad), bool(task.until_canceled)
    goal.targets = [target_to_msg(target) for target in task.targets]


def _read_move(goal: Any) -> dict[str, Any]:
    return {
        "targets": [
            {
                "id": target.id,
                "place_m": [target.x, target.y],
                **({} if math.isnan(target.angle) else {"angle_deg": math.degrees(target.angle)}),
            }
            for target in goal.targets
        ],
        "tolerance_m": goal.tolerance_m,
        "tolerance_deg": math.degrees(goal.tolerance_rad),
        "hold_s": goal.hold_s,
        "until_canceled": goal.until_canceled,
    }


def _write_feed(task: FeedTask, goal: Any) -> None:
    goal.picks = [pick_to_msg(pick) for pick in task.picks]
    goal.clearance_m = float(task.clearance_m)
    goal.chute = "" if task.chute is None else side_name(task.chute)


def _read_feed(goal: Any) -> dict[str, Any]:
    picks = []
    for msg in goal.picks:
        pick = msg_to_pick(msg)
        given = [*pick.low, *pick.high]
        picks.append(
            {
                "class": pick.label,
                "ready": pick.ready,
                **({} if all(map(math.isinf, given)) else {
                    "window_m": [list(pick.low), list(pick.high)]
                }),
                **({} if pick.angle is None else {
                    "angle_deg": math.degrees(pick.angle),
                    "tolerance_deg": math.degrees(pick.tolerance_rad),
                }),
            }
        )  # fmt: skip
    return {
        "picks": picks,
        "clearance_m": goal.clearance_m,
        **({"chute": goal.chute} if goal.chute else {}),
    }


def pick_to_msg(pick: Pick) -> FeedPick:
    """Convert a pick to a message."""
    return FeedPick(
        type=pick.label,
        ready=pick.ready,
        x_min=float(pick.low[0]), x_max=float(pick.high[0]),
        y_min=float(pick.low[1]), y_max=float(pick.high[1]),
        angle=NOWHERE if pick.angle is None else float(pick.angle),
        tolerance_rad=float(pick.tolerance_rad),
    )  # fmt: skip


def msg_to_pick(msg: FeedPick) -> Pick:
    """Convert a message to a pick, without checks. If all values of the window are zero, the window
    is the whole plate."""
    low, high = (msg.x_min, msg.y_min), (msg.x_max, msg.y_max)
    if not any((*low, *high)):
        low, high = (-math.inf, -math.inf), (math.inf, math.inf)
    angle = None if math.isnan(msg.angle) else msg.angle
    return Pick(msg.type, msg.ready, low, high, angle, msg.tolerance_rad)


def order_to_msg(order: FeedOrder, stamp: Time) -> FeedOrderMsg:
    """Convert the order for a feed task to a message. `stamp` is the present time."""
    return FeedOrderMsg(
        header=Header(stamp=stamp),
        mode=int(order.mode),
        hidden=order.hidden,
        picks=[pick_to_msg(pick) for pick in order.picks],
    )


def msg_to_order(msg: FeedOrderMsg) -> FeedOrder:
    """Convert a message to the order for a feed task.

    Raises
    ------
    PlateError
        If the mode is unknown.
    """
    if msg.mode not in tuple(FeedMode):
        known = ", ".join(f"{mode.value} ({mode.name})" for mode in FeedMode)
        raise PlateError(f"feed_orders: mode is {msg.mode}, allowed: {known}")
    return FeedOrder(FeedMode(msg.mode), tuple(map(msg_to_pick, msg.picks)), msg.hidden)


KINDS: Mapping[str, tuple[type, Callable[[Any, Any], None], Callable[[Any], dict[str, Any]]]] = {
    "sort_parts": (SortTask, _write_sort, _read_sort),
    "follow_paths": (FollowTask, _write_follow, _read_follow),
    "assemble_parts": (AssembleTask, _write_assemble, _read_assemble),
    "pose_parts": (PoseTask, _write_pose, _read_pose),
    "move_parts": (MoveTask, _write_move, _read_move),
    "feed_parts": (FeedTask, _write_feed, _read_feed),
}
"""Data of each action: class of its task, function that converts a task to a goal, and function
that converts a goal to the data of a task."""


def _point_to_msg(point: tuple[float, float]) -> Point:
    return Point(x=float(point[0]), y=float(point[1]))


def _check_unique(what: str, labels: list[str]) -> None:
    double = next((label for label in labels if labels.count(label) > 1), None)
    if double is not None:
        raise ScenarioError(f"{what}: {double} occurs twice, allowed: each type once")
