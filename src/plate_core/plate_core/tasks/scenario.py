"""Reading of scenario files, checks of a scenario against a rig, and placement of its parts.

`load_scenario` returns a `Scenario`. `check_scenario` refuses a scenario that is impossible on a
rig, such as a scenario with targets beyond the edges. `start_positions` returns the given start
positions, and random start positions for the other parts.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from ..errors import PlateError, ScenarioError, did_you_mean
from ..parts import MAX_PARTS, part_class
from ..rig import Rig, rig_names
from ..rig.part_types import NAME
from ..rig.polygons import is_simple
from ..yaml_fields import Fields, config_path, read_yaml, required
from . import keys
from .curves import circle_points, spline_points
from .edges import ROUNDING_M, Place, edge_problem, goal_places, no_place_text
from .feed import check_feed, read_feed
from .tasks import (
    AssembleTask,
    Bin,
    FeedTask,
    FollowTask,
    MoveTask,
    PartGroup,
    PartTarget,
    PathTask,
    Point,
    Pose,
    PoseTask,
    Region,
    Scenario,
    Side,
    SortTask,
    Task,
)

RANDOM_GAPS = (5.0, 4.0, 3.0, 2.5)
"""Minimum distances between random start positions that are tried one after the other [mean radius
of the two parts]. The first distance with which all parts can be placed is used."""

RANDOM_FRACTION = (0.85, 0.80)
"""Limits of random start positions, as fractions of the plate's half sides (x, y)."""

RANDOM_CLEARANCE = 1.5
"""Minimum distance of random start positions from the edges [part radii]."""

RANDOM_TRIES, RANDOM_STARTS = 80, 20
"""Maximum number of attempts for each minimum distance: to place one part, and to place all
parts."""

APART_M = 1e-6
"""Two points at a shorter distance count as equal [m]."""

SHARED_M2 = 1e-6
"""Maximum overlap of two regions [m2]. An overlap below this value can result from the rounding of
decimal numbers."""


def scenario_names() -> tuple[str, ...]:
    """Return the names of the scenarios in config/scenarios."""
    try:
        folder = config_path("scenarios")
    except PlateError as problem:
        raise ScenarioError(str(problem)) from None
    return tuple(sorted(path.stem for path in folder.glob("*.yaml")))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    name_or_path : str or path
        Name of a file in config/scenarios, without `.yaml`, or the path of a YAML file.

    Returns
    -------
    Scenario

    Raises
    ------
    ScenarioError
        If the scenario does not exist, a key is missing or unknown, or a value is not allowed. The
        message states the key, the value and the allowed values, or lists the available scenarios.
    """
    text = str(name_or_path)
    if text.endswith((".yaml", ".yml")):
        path = Path(text)
    else:
        names = scenario_names()
        if text not in names:
            raise ScenarioError(
                f"scenario is {text!r}{did_you_mean(text, names)}, allowed: {', '.join(names)}, or "
                "the path of a .yaml file"
            )
        path = config_path("scenarios") / f"{text}.yaml"
    return read_scenario(read_yaml(path, ScenarioError), path.stem, path.parent)


def read_scenario(fields: Fields, name: str, folder: Path = Path()) -> Scenario:
    """Return the scenario of a file in `folder`, or of an action's goal. The function raises the
    same errors as `load_scenario`."""
    parts = tuple(_read_group(child) for child in fields.children("parts"))
    if not parts:
        raise fields.fail("parts", "at least one group of parts")
    labels = [group.label for group in parts]
    if len(set(labels)) < len(labels):
        raise fields.fail("parts", keys.ALL_DIFFERENT)
    task, limit = _task(fields.child("task"), parts), keys.FILE["time_limit_s"]
    feeds = isinstance(task, FeedTask)
    endless = feeds or (isinstance(task, MoveTask) and task.until_canceled)
    if not all(group.count for group in parts) and not (feeds and any(g.count for g in parts)):
        raise ScenarioError(
            f"{fields.where}: parts: count is 0, allowed: a whole number from 1 to {MAX_PARTS} "
            "(a feed task also allows 0, but not for all groups)"
        )
    scenario = Scenario(
        name=name,
        description=fields.value(keys.FILE["description"]),
        parts=parts,
        task=task,
        time_limit_s=fields.value(limit if endless else required(limit)) or math.inf,
        marked=fields.value(keys.FILE["marked"]),
        rig=_read_rig(fields, folder),
        file=fields.where,
    )
    if not isinstance(scenario.task, FollowTask | FeedTask) and (
        scenario.task.hold_s >= scenario.time_limit_s
    ):
        raise ScenarioError(
            f"{fields.where}: task: hold_s is {scenario.task.hold_s:g}, allowed: less than "
            f"time_limit_s, which is {scenario.time_limit_s:g}"
        )
    fields.finish()
    return scenario


def _read_rig(fields: Fields, folder: Path) -> str:
    """Return the rig in the form that `load_rig` accepts. Return "" if no rig is given."""
    text = fields.value(keys.FILE["rig"])
    if text.endswith((".yaml", ".yml")):
        return str(folder / text)
    if text and text not in rig_names():
        hint = did_you_mean(text, rig_names())
        raise fields.fail("rig", f"{', '.join(rig_names())}, or the path of a .yaml file{hint}")
    return str(text)


def _read_group(fields: Fields) -> PartGroup:
    label = fields.value(keys.GROUP["class"])
    if not NAME.fullmatch(label):
        raise fields.fail("class", "lower-case letters, digits and _, such as black or nut_m4")
    if fields.one_of("count", "positions_m") == "count":
        group = PartGroup(label, fields.value(keys.GROUP["count"]))
    else:
        position = fields.value(keys.GROUP["positions_m"])
        group = PartGroup(label, len(position), _to_pairs(position))
    fields.finish()
    return group


def _task(fields: Fields, parts: tuple[PartGroup, ...]) -> Task:
    kinds: dict[str, Callable[[Fields, tuple[PartGroup, ...]], Task]]
    kinds = {
        "sort": _read_sort, "follow": _read_follow, "assemble": _read_assemble,
        "pose": _read_pose, "move": _read_move, "feed": read_feed,
    }  # fmt: skip
    task = kinds[fields.value(keys.TASK["kind"])](fields, parts)
    fields.finish()
    return task


def _to_pairs(array: np.ndarray) -> tuple[Point, ...]:
    """Return the rows of an array (n, 2) as tuples."""
    return tuple((float(x), float(y)) for x, y in array)


def _read_sort(fields: Fields, parts: tuple[PartGroup, ...]) -> SortTask:
    # Scenario files that sort two classes to two sides of the plate use the key `sides`.
    child = fields.child("sides" if fields.has("sides") else "regions")
    regions = {group.label: _read_region(child, group.label) for group in parts}
    child.finish()
    goal = keys.SORT["goal_fraction"]
    if any(isinstance(region, Side) for region in regions.values()):
        goal = required(goal)
    return SortTask(
        regions=regions,
        goal_fraction=fields.value(goal) or 0.0,
        hold_s=fields.value(keys.HOLD),
    )


def _read_region(fields: Fields, label: str) -> Region:
    if not fields.holds_mapping(label):
        return keys.SIDES[fields.text(label, tuple(keys.SIDES))]
    child = fields.child(label)
    corner = child.value(keys.BIN["bin_m"])
    if not is_simple(corner):
        raise child.fail(
            "bin_m",
            "at least three corners in order around a polygon with an area and no crossing edges",
        )
    child.finish()
    return Bin(_to_pairs(corner))


def _read_follow(fields: Fields, parts: tuple[PartGroup, ...]) -> FollowTask:
    labels = tuple(group.label for group in parts)
    paths = tuple(_read_path(child, labels) for child in fields.children("paths"))
    _check_goal_counts(fields, "paths", [path.label for path in paths], parts)
    return FollowTask(paths=paths, max_error_m=fields.value(keys.FOLLOW["max_error_m"]))


def _read_path(fields: Fields, labels: tuple[str, ...]) -> PathTask:
    curve = fields.one_of(*keys.CURVES)
    if curve == "circle":
        closed, waypoint = True, _read_circle(fields.child("circle"))
    else:
        closed, waypoint = _read_points(fields, curve)
    profile = _read_speed_profile(fields)
    path = PathTask(
        label=fields.value(keys.class_key(*labels)),
        waypoint=_to_pairs(waypoint),
        speed=max(speed for _, speed in profile),
        closed=closed,
        laps=fields.value(required(keys.PATH["laps"])) if closed else 1.0,
        profile=profile if len(profile) > 1 else (),
    )
    fields.finish()
    return path


def _read_circle(fields: Fields) -> np.ndarray:
    x, y = fields.value(keys.CIRCLE["centre_m"])
    points = circle_points(
        (float(x), float(y)),
        fields.value(keys.CIRCLE["radius_m"]),
        np.radians(fields.value(keys.CIRCLE["start_deg"])),
        fields.value(keys.CIRCLE["turn"]) == "left",
    )
    fields.finish()
    return points


def _read_points(fields: Fields, key: str) -> tuple[bool, np.ndarray]:
    waypoint = fields.value(keys.PATH[key])
    step = np.hypot(*np.diff(waypoint, axis=0).T)
    if len(waypoint) < 2 or np.min(step) < APART_M:
        raise fields.fail(key, "at least two points, each different from the next")
    closed = fields.value(required(keys.PATH["closed"]))
    if closed and np.hypot(*(waypoint[-1] - waypoint[0])) < APART_M:
        raise fields.fail(key, "for a closed path, a last point that differs from the first")
    if key == "spline_m":
        if len(waypoint) < 3:
            raise fields.fail(key, "at least three points")
        waypoint = spline_points(waypoint, closed)
    return closed, waypoint


def _read_speed_profile(fields: Fields) -> tuple[tuple[float, float], ...]:
    """Return the speed profile: pairs of a fraction of a lap and the speed at this fraction [m/s].
    A single pair means a constant speed."""
    if not fields.holds_list("speed_mps"):
        return ((0.0, fields.value(keys.PATH["speed_mps"])),)
    profile = fields.array("speed_mps", (None, 2), 0, keys.FASTEST_MPS)
    fraction, speed = profile.T
    if (
        len(profile) < 2
        or np.any(np.diff(fraction) <= 0)
        or (fraction[0], fraction[-1]) != (0, 1)
        or np.min(speed) < keys.SLOWEST_MPS
    ):
        raise fields.fail(
            "speed_mps",
            "a number, or pairs [fraction of a lap, m/s] with fractions that increase from 0 to "
            f"1, and speeds from {keys.SLOWEST_MPS:g} to {keys.FASTEST_MPS:g}",
        )
    return _to_pairs(profile)


def _read_assemble(fields: Fields, parts: tuple[PartGroup, ...]) -> AssembleTask:
    child = fields.child("places_m")
    labels: list[str] = []
    place: list[Point] = []
    for group in parts:
        points = _to_pairs(child.array(group.label, (None, 2), -keys.MAX_XY, keys.MAX_XY))
        labels += [group.label] * len(points)
        place += points
    child.finish()
    _check_goal_counts(fields, "places_m", labels, parts)
    return AssembleTask(
        labels=tuple(labels),
        place=tuple(place),
        tolerance_m=fields.value(keys.TOLERANCE),
        hold_s=fields.value(keys.HOLD),
    )


def _read_pose(fields: Fields, parts: tuple[PartGroup, ...]) -> PoseTask:
    labels = tuple(group.label for group in parts)
    poses = []
    for child in fields.children("poses"):
        label = child.value(keys.class_key(*labels))
        values = child.value(keys.POSES["place_m"])
        place = None if values is None else _to_pairs(values[None])[0]
        angle = child.value(keys.POSES["angle_deg"])
        poses.append(Pose(label, place, float(np.radians(angle))))
        child.finish()
    _check_goal_counts(fields, "poses", [pose.label for pose in poses], parts)
    return PoseTask(
        poses=tuple(poses),
        tolerance_m=fields.value(keys.TOLERANCE),
        tolerance_rad=float(np.radians(fields.value(keys.POSE["tolerance_deg"]))),
        hold_s=fields.value(keys.HOLD),
        anywhere=fields.value(keys.POSE["anywhere"]),
    )


def _read_move(fields: Fields, parts: tuple[PartGroup, ...]) -> MoveTask:
    labels = [group.label for group in parts]
    targets = []
    for child in fields.children("targets") if fields.has("targets") else ():
        name, angle = child.value(keys.MOVES["id"]), child.value(keys.MOVES["angle_deg"])
        if part_class(name) not in labels or not name.rpartition("_")[2].isdecimal():
            raise child.fail("id", f"a class and a number, such as {labels[0]}_1")
        (place,) = _to_pairs(child.value(keys.MOVES["place_m"])[None])
        targets.append(PartTarget(name, place, None if angle is None else math.radians(angle)))
        child.finish()
    if len({target.id for target in targets}) < len(targets) or len(targets) > MAX_PARTS:
        raise fields.fail("targets", f"each part at most once, at most {MAX_PARTS} targets")
    return MoveTask(
        targets=tuple(targets),
        tolerance_m=fields.value(keys.TOLERANCE),
        tolerance_rad=math.radians(fields.value(keys.MOVE["tolerance_deg"])),
        hold_s=fields.value(keys.HOLD),
        until_canceled=fields.value(keys.MOVE["until_canceled"]),
    )


def _check_goal_counts(
    fields: Fields, key: str, labels: Sequence[str], parts: tuple[PartGroup, ...]
) -> None:
    """Raise an error if the number of goals of a class differs from its number of parts."""
    have = Counter(labels)
    for group in parts:
        if have[group.label] != group.count:
            raise ScenarioError(
                f"{fields.where}: {key} has {have[group.label]} {key.removesuffix('_m')} for class "
                f"{group.label}, allowed: {group.count}, one for each part"
            )


def check_scenario(scenario: Scenario, rig: Rig) -> None:
    """Check a scenario against a rig: number and classes of the parts, angles, positions, paths
    and regions.

    Raises
    ------
    ScenarioError
        If the scenario is impossible on this rig. The message states the file, the key, the class,
        the impossible value and the allowed values.
    """
    task = scenario.task
    # If the rig file defines part types, the detector recognises only these types.
    known = tuple(rig.types) or keys.CLASSES
    for group in scenario.parts:
        if group.label not in known:
            raise ScenarioError(
                f"{scenario.where}: parts: class is {group.label!r}"
                f"{did_you_mean(group.label, known)}, allowed with this rig: {', '.join(known)}"
            )
    reach = {group.label: rig.part_type(group.label).reach_m for group in scenario.parts}
    if scenario.count > MAX_PARTS:
        raise ScenarioError(
            f"{scenario.where}: parts: their number is {scenario.count}, allowed: at most "
            f"{MAX_PARTS}"
        )
    for label, part in ((label, rig.part_type(label)) for label in _classes_with_angles(task)):
        if part.symmetry == 0 and label in rig.types:
            raise ScenarioError(
                f"{scenario.where}: angles of {label} are given, allowed: angles of parts that "
                "are not round (a round part shows its angle only by a mark, and marks are "
                "detected only if the rig file defines no types)"
            )
        if part.symmetry == 0 and not scenario.marked:
            raise ScenarioError(
                f"{scenario.where}: marked is false, but angles of {label} require marked: true (a "
                "round part without a mark shows no angle)"
            )
    placed = [("parts: positions_m", g.label, p) for g in scenario.parts for p in g.position or ()]
    goals = goal_places(scenario)
    _check_places_on_plate(scenario, placed, rig.plate.half, reach)
    _check_places_apart(scenario, placed, reach, 1.0)
    if isinstance(task, MoveTask):
        for target in task.targets:
            if problem := target_problem(target, scenario, rig):
                raise ScenarioError(f"{scenario.where}: task: targets: {problem}")
    for key, label, point in goals:
        if problem := edge_problem(label, point, rig):
            raise ScenarioError(f"{scenario.where}: {key} of {label} is {problem}")
    if isinstance(task, FeedTask):
        check_feed(task, scenario.where, rig)
    if isinstance(task, FollowTask | MoveTask | FeedTask):
        return
    if isinstance(task, SortTask):
        corners = [
            ("task: regions: bin_m", label, point)
            for label, region in task.regions.items()
            if isinstance(region, Bin)
            for point in region.corner
        ]
        # Corners of bins may be on the plate's edge, so no margin is required for them.
        edge = dict.fromkeys(reach, 0.0)
        _check_places_on_plate(scenario, corners, rig.plate.half, edge)
        _check_bins(scenario, task, rig)
        _check_regions(scenario, task, rig.plate.half)
    _check_places_apart(scenario, goals, reach, 1.25 if isinstance(task, AssembleTask) else 1.0)


def target_problem(target: PartTarget, scenario: Scenario, rig: Rig) -> str:
    """Return the reason why a target of a part is impossible. Return "" if the target is
    possible."""
    label = part_class(target.id)
    if label not in scenario.labels:
        known = ", ".join(sorted(set(scenario.labels)))
        return f"class of {target.id} is not in this task, allowed: {known}"
    part = rig.part_type(label)
    if problem := edge_problem(label, target.place, rig):
        return f"place of {target.id} is {problem}"
    if target.angle is None:
        return ""
    if not math.isfinite(target.angle):
        return f"angle of {target.id} is {target.angle:g}, allowed: finite, or none"
    if part.symmetry == 0 and (label in rig.types or not scenario.marked):
        return f"angle of {target.id} is given, but this part is round, which requires marked: true"
    return ""


def _classes_with_angles(task: Task) -> list[str]:
    """Return the classes for which a task requests angles."""
    if isinstance(task, FeedTask):
        return [pick.label for pick in task.picks if pick.angle is not None]
    return [pose.label for pose in task.poses] if isinstance(task, PoseTask) else []


def _check_places_on_plate(
    scenario: Scenario, places: list[Place], half: np.ndarray, reach: Mapping[str, float]
) -> None:
    for key, label, (x, y) in places:
        limit = half - reach[label]
        if np.any(np.abs((x, y)) > limit + ROUNDING_M):
            raise ScenarioError(
                f"{scenario.where}: {key} of {label} is ({x:g}, {y:g}) m, "
                f"allowed: |x| up to {limit[0]:g}, |y| up to {limit[1]:g} m on this plate"
            )


def _check_places_apart(
    scenario: Scenario, places: list[Place], reach: Mapping[str, float], factor: float
) -> None:
    for (key, one, a), (_, other, b) in combinations(places, 2):
        min_gap = factor * (reach[one] + reach[other])
        gap = float(np.hypot(a[0] - b[0], a[1] - b[1]))
        if gap < min_gap - 1e-9:
            raise ScenarioError(
                f"{scenario.where}: {key} of {one} ({a[0]:g}, {a[1]:g}) m and of {other} "
                f"({b[0]:g}, {b[1]:g}) m are {1e3 * gap:.3g} mm apart, allowed: "
                f"{1e3 * min_gap:.3g} mm or more for these parts"
            )


def _check_bins(scenario: Scenario, task: SortTask, rig: Rig) -> None:
    """Raise an error if every point of a bin is too near to the plate's edges, so that parts at
    these points are lost."""
    # Shapely is imported here, so that the stop command does not wait for this import.
    from shapely import Polygon, box

    for label, region in task.regions.items():
        if not isinstance(region, Bin):
            continue
        limit = rig.plate.half - rig.edge_margin(label).min_m
        if np.any(limit < 0) or not Polygon(region.corner).intersects(box(*-limit, *limit)):
            raise ScenarioError(
                f"{scenario.where}: task: regions: bin_m of {label} has {no_place_text(label, rig)}"
            )


def _check_regions(scenario: Scenario, task: SortTask, half: np.ndarray) -> None:
    """Raise an error if a side or corner overlaps the region of another class.

    This function does not compare two bins with each other. The planner refuses two bins if the
    positions of their parts overlap.
    """
    from shapely import Polygon

    for pair in combinations(task.regions, 2):
        if all(isinstance(task.regions[label], Bin) for label in pair):
            continue
        first, second = (Polygon(region_outline(task, label, half)) for label in pair)
        shared = first.intersection(second).area
        if shared > SHARED_M2:
            text = " and ".join(f"{k} is {_region_text(task, k, half)}" for k in pair)
            raise ScenarioError(
                f"{scenario.where}: task: regions: {text}: they overlap by {1e4 * shared:.3g} cm2, "
                "allowed: regions that do not overlap"
            )


def region_outline(task: SortTask, label: str, half: np.ndarray) -> np.ndarray:
    """Return the corners (n, 2) [m, plate_home] of the region of a class. `half` (2,) are the half
    sides of the plate [m]."""
    region, goal = task.regions[label], task.goal_fraction
    if isinstance(region, Bin):
        return np.array(region.corner)
    signs = (region.x, region.y)
    low = [-h if sign <= 0 else goal * h for sign, h in zip(signs, half, strict=True)]
    high = [h if sign >= 0 else -goal * h for sign, h in zip(signs, half, strict=True)]
    (left, bottom), (right, top) = low, high
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])


def _region_text(task: SortTask, label: str, half: np.ndarray) -> str:
    """Return a description of a region, such as `left (x from -0.3 to -0.18, y from ...)`."""
    names = (name for name, side in keys.SIDES.items() if side == task.regions[label])
    outline = region_outline(task, label, half)
    (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
    return f"{next(names, 'a bin')} (x from {x0:g} to {x1:g}, y from {y0:g} to {y1:g} m)"


def start_positions(
    scenario: Scenario, rig: Rig, rng: np.random.Generator
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the start positions of all parts. Parts without a given position get a random
    position.

    The minimum distance between a random position and all other parts is the first value in
    `RANDOM_GAPS` with which all parts can be placed. `RANDOM_FRACTION` and `RANDOM_CLEARANCE`
    determine the minimum distances from the edges.

    Parameters
    ----------
    scenario : Scenario
    rig : Rig
    rng : numpy.random.Generator
        Source of the random positions.

    Returns
    -------
    labels : tuple of str, length M
        Class of every part.
    position : (M, 2)
        Centres [m, plate_home].

    Raises
    ------
    ScenarioError
        If the scenario is impossible on this rig, or the plate has no space for all parts.
    """
    check_scenario(scenario, rig)
    given = [p for group in scenario.parts for p in group.position or ()]
    half = rig.plate.half
    reach = {group.label: rig.part_type(group.label).reach_m for group in scenario.parts}
    sizes = [
        np.array([reach[g.label] for g in scenario.parts for _ in range(g.count) if included(g)])
        for included in (lambda g: g.position is not None, lambda g: g.position is None)
    ]
    radius, count = np.concatenate(sizes), len(sizes[1])
    limit = np.array(RANDOM_FRACTION) * half
    limit = np.maximum(np.minimum(limit, half - RANDOM_CLEARANCE * radius[:, None]), 0)
    taken, max_count = np.array(given).reshape(-1, 2), 0
    for gap in np.repeat(RANDOM_GAPS, RANDOM_STARTS):
        scattered = _random_positions(radius, taken, limit, gap, rng)
        max_count = max(max_count, len(scattered))
        if max_count == count:
            break
    else:
        raise ScenarioError(
            f"{scenario.where}: parts: count is {count} at random positions, allowed: at most "
            f"{max_count}. More parts with radii of up to {1e3 * radius.max():g} mm do not fit on "
            f"{2 * half[0]:g} x {2 * half[1]:g} m with {gap:g} radii between their centres. Use "
            "fewer parts or positions_m"
        )
    rest = iter(scattered)
    rows = [
        group.position[i] if group.position is not None else next(rest)
        for group in scenario.parts
        for i in range(group.count)
    ]
    return scenario.labels, np.array(rows, dtype=float).reshape(-1, 2)


def _random_positions(
    radius: np.ndarray, taken: np.ndarray, limit: np.ndarray, gap: float, rng: np.random.Generator
) -> np.ndarray:
    """Return up to N - T random points (k, 2) [m], in addition to the T points `taken` (T, 2).

    `radius` (N,) are the radii of all parts [m]. The distance between two points is at least `gap`
    times the mean radius of the two parts. Each point is within its `limit` (N, 2) [m]. If no
    position is found for a part, only the points before it are returned.
    """
    start = len(taken)
    points = np.vstack([taken, np.zeros((len(radius) - start, 2))])
    for i in range(start, len(radius)):
        for _ in range(RANDOM_TRIES):
            points[i] = rng.uniform(-limit[i], limit[i])
            min_gap = gap * (radius[:i] + radius[i]) / 2
            if np.all(np.hypot(*(points[:i] - points[i]).T) >= min_gap):
                break
        else:
            return points[start:i]
    return points[start:]
