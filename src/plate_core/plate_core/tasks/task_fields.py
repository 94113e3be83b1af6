"""Read the task of a scenario file: what is to be done with the parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ..errors import ScenarioError
from ..yaml_fields import Fields
from .curves import circle_points, spline_points
from .tasks import (
    AssembleTask,
    Bin,
    FollowTask,
    PartGroup,
    PathTask,
    Point,
    Pose,
    PoseTask,
    Region,
    Side,
    SortTask,
    Task,
)

SIDES: Mapping[str, Side] = MappingProxyType(
    {
        "left": Side(-1, 0),
        "right": Side(1, 0),
        "bottom": Side(0, -1),
        "top": Side(0, 1),
        "bottom_left": Side(-1, -1),
        "bottom_right": Side(1, -1),
        "top_left": Side(-1, 1),
        "top_right": Side(1, 1),
    }
)
"""Sides and corners of the plate."""

CURVES = ("waypoints_m", "circle", "spline_m")
"""What a path may be given by: one of these."""

SLOWEST_MPS, FASTEST_MPS = 1e-5, 10.0
"""Speeds along a path [m/s]."""

APART_M = 1e-6
"""Points nearer to each other are the same [m]."""


def read_task(fields: Fields, parts: tuple[PartGroup, ...]) -> Task:
    """Return the task of a scenario with these parts.

    Raises
    ------
    ScenarioError
        If a key is missing or unknown, or its value is not allowed.
    """
    kinds: Mapping[str, Callable[[Fields, tuple[PartGroup, ...]], Task]] = {
        "sort": _sort,
        "follow": _follow,
        "assemble": _assemble,
        "pose": _pose,
    }
    task: Task = kinds[fields.text("kind", tuple(kinds))](fields, parts)
    fields.finish()
    return task


def pairs(array: np.ndarray) -> tuple[Point, ...]:
    """Return the rows of an array (n, 2) as tuples."""
    return tuple((float(x), float(y)) for x, y in array)


def _sort(fields: Fields, parts: tuple[PartGroup, ...]) -> SortTask:
    # Files with two classes and two sides say `sides`.
    child = fields.child("sides" if fields.has("sides") else "regions")
    regions = {group.label: _region(child, group.label) for group in parts}
    child.finish()
    has_side = any(isinstance(region, Side) for region in regions.values())
    return SortTask(
        regions=MappingProxyType(regions),
        goal_fraction=fields.number("goal_fraction", 0, 0.8, None if has_side else 0.0),
        hold_s=fields.number("hold_s", 0, 60),
    )


def _region(fields: Fields, label: str) -> Region:
    if not fields.holds_mapping(label):
        return SIDES[fields.text(label, tuple(SIDES))]
    child = fields.child(label)
    corner = child.array("bin_m", (None, 2), -10, 10)
    if not _is_simple(corner):
        raise child.fail("bin_m", "at least three corners, in order, of a polygon with an area")
    child.finish()
    return Bin(pairs(corner))


def _is_simple(corner: np.ndarray) -> bool:
    """Whether a polygon (n, 2) has an area, and no two of its edges cross."""
    if len(corner) < 3:
        return False
    after = np.roll(corner, -1, axis=0)
    if abs(np.sum(_cross(corner, after))) < APART_M:
        return False
    for i in range(len(corner)):
        for j in range(i + 2, len(corner) - (i == 0)):
            a, b, c, d = corner[i], after[i], corner[j], after[j]
            if (
                _cross(b - a, c - a) * _cross(b - a, d - a) <= 0
                and _cross(d - c, a - c) * _cross(d - c, b - c) <= 0
            ):
                return False
    return True


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _follow(fields: Fields, parts: tuple[PartGroup, ...]) -> FollowTask:
    labels = tuple(group.label for group in parts)
    paths = tuple(_path(child, labels) for child in fields.children("paths"))
    _one_each(fields, "paths", [path.label for path in paths], parts)
    return FollowTask(paths=paths, max_error_m=fields.number("max_error_m", 1e-4, 10))


def _path(fields: Fields, labels: tuple[str, ...]) -> PathTask:
    given = [key for key in CURVES if fields.has(key)]
    if len(given) != 1:
        raise ScenarioError(
            f"{fields.where}: {' and '.join(given) or 'no curve'} given, "
            f"allowed: one of {', '.join(CURVES)}"
        )
    if given[0] == "circle":
        closed, waypoint = True, _circle(fields.child("circle"))
    else:
        closed, waypoint = _points(fields, given[0])
    profile = _profile(fields)
    path = PathTask(
        label=fields.text("class", labels),
        waypoint=pairs(waypoint),
        speed=max(speed for _, speed in profile),
        closed=closed,
        laps=fields.number("laps", 0.01, 1000) if closed else 1.0,
        profile=profile if len(profile) > 1 else (),
    )
    fields.finish()
    return path


def _circle(fields: Fields) -> np.ndarray:
    x, y = fields.array("centre_m", (2,), -10, 10)
    points = circle_points(
        (float(x), float(y)),
        fields.number("radius_m", 1e-4, 10),
        np.radians(fields.number("start_deg", -360, 360, 0.0)),
        fields.text("turn", ("left", "right")) == "left",
    )
    fields.finish()
    return points


def _points(fields: Fields, key: str) -> tuple[bool, np.ndarray]:
    waypoint = fields.array(key, (None, 2), -10, 10)
    step = np.hypot(*np.diff(waypoint, axis=0).T)
    if len(waypoint) < 2 or np.min(step) < APART_M:
        raise fields.fail(key, "at least two points, each apart from the next")
    closed = fields.flag("closed")
    if closed and np.hypot(*(waypoint[-1] - waypoint[0])) < APART_M:
        raise fields.fail(key, "for a closed path, a last point that is not the first")
    if key == "spline_m":
        if len(waypoint) < 3:
            raise fields.fail(key, "at least three points")
        waypoint = spline_points(waypoint, closed)
    return closed, waypoint


def _profile(fields: Fields) -> tuple[tuple[float, float], ...]:
    """Return speeds [m/s] at shares of a lap; one pair if the speed is the same all the way."""
    if not fields.holds_list("speed_mps"):
        return ((0.0, fields.number("speed_mps", SLOWEST_MPS, FASTEST_MPS)),)
    profile = fields.array("speed_mps", (None, 2), 0, FASTEST_MPS)
    share, speed = profile.T
    if (
        len(profile) < 2
        or np.any(np.diff(share) <= 0)
        or (share[0], share[-1]) != (0, 1)
        or np.min(speed) < SLOWEST_MPS
    ):
        raise fields.fail(
            "speed_mps",
            f"a number, or pairs [share of a lap, m/s], shares growing from 0 to 1, "
            f"speeds from {SLOWEST_MPS:g} to {FASTEST_MPS:g}",
        )
    return pairs(profile)


def _assemble(fields: Fields, parts: tuple[PartGroup, ...]) -> AssembleTask:
    child = fields.child("places_m")
    labels: list[str] = []
    place: list[Point] = []
    for group in parts:
        points = pairs(child.array(group.label, (None, 2), -10, 10))
        labels += [group.label] * len(points)
        place += points
    child.finish()
    _one_each(fields, "places_m", labels, parts)
    return AssembleTask(
        labels=tuple(labels),
        place=tuple(place),
        tolerance_m=fields.number("tolerance_m", 1e-4, 1),
        hold_s=fields.number("hold_s", 0, 60),
    )


def _pose(fields: Fields, parts: tuple[PartGroup, ...]) -> PoseTask:
    labels = tuple(group.label for group in parts)
    poses = []
    for child in fields.children("poses"):
        label = child.text("class", labels)
        place = (
            pairs(child.array("place_m", (2,), -10, 10)[None])[0] if child.has("place_m") else None
        )
        poses.append(Pose(label, place, float(np.radians(child.number("angle_deg", -360, 360)))))
        child.finish()
    _one_each(fields, "poses", [pose.label for pose in poses], parts)
    return PoseTask(
        poses=tuple(poses),
        tolerance_m=fields.number("tolerance_m", 1e-4, 1),
        tolerance_rad=float(np.radians(fields.number("tolerance_deg", 0.1, 180))),
        hold_s=fields.number("hold_s", 0, 60),
    )


def _one_each(
    fields: Fields, key: str, labels: Sequence[str], parts: tuple[PartGroup, ...]
) -> None:
    """Refuse a task that has not as many goals of a class as there are parts of it."""
    have = Counter(labels)
    for group in parts:
        if have[group.label] != group.count:
            raise ScenarioError(
                f"{fields.where}: {key} has {have[group.label]} {key.removesuffix('_m')} for class "
                f"{group.label}, allowed: {group.count}, one for each part"
            )
