"""Scenarios: read from their files, checked against a rig, and their parts put down."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from ..errors import PlateError, ScenarioError, did_you_mean
from ..parts import MOST_PARTS, part_class
from ..rig import Rig, rig_names
from ..rig.part_types import NAME
from ..rig.polygons import cross, is_simple
from ..yaml_fields import Fields, config_path, read_yaml, required
from . import keys
from .curves import circle_points, spline_points
from .edges import ROUNDING_M, Place, edge_problem, goal_places, nowhere_text
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

SCATTER_GAPS = (5.0, 4.0, 3.0, 2.5)
"""Least distances of scattered centres [part radii]: the first at which all parts find room."""

SCATTER_FRACTION = (0.85, 0.80)
"""Fraction of the half sides (x, y) within which parts are scattered: clear of the edges."""

SCATTER_CLEAR = 1.5
"""And at least so far from the edges [part radii]."""

SCATTER_TRIES, SCATTER_STARTS = 80, 20
"""Tries to place one part, and to place all of them, before they count as too many."""

APART_M = 1e-6
"""Points nearer to each other are the same [m]."""


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
        Name of a file in config/scenarios, without `.yaml`; or the path of any YAML file.

    Returns
    -------
    Scenario

    Raises
    ------
    ScenarioError
        If there is no such scenario (the message lists those there are), a key is missing or
        unknown, or its value is not allowed: the message names key, value and what is allowed.
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
    """Return the scenario of a file in `folder`, or of an action's goal; errors as
    `load_scenario`."""
    parts = tuple(_group(child) for child in fields.children("parts"))
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
            f"{fields.where}: parts: count is 0, allowed: a whole number from 1 to {MOST_PARTS} "
            "(in a task of feed from 0, but one part in all)"
        )
    scenario = Scenario(
        name=name,
        description=fields.value(keys.FILE["description"]),
        parts=parts,
        task=task,
        time_limit_s=fields.value(limit if endless else required(limit)) or math.inf,
        marked=fields.value(keys.FILE["marked"]),
        rig=_rig(fields, folder),
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


def _rig(fields: Fields, folder: Path) -> str:
    """Return the rig as `load_rig` takes it, or nothing."""
    text = fields.value(keys.FILE["rig"])
    if text.endswith((".yaml", ".yml")):
        return str(folder / text)
    if text and text not in rig_names():
        hint = did_you_mean(text, rig_names())
        raise fields.fail("rig", f"{', '.join(rig_names())}, or the path of a .yaml file{hint}")
    return str(text)


def _group(fields: Fields) -> PartGroup:
    label = fields.value(keys.GROUP["class"])
    if not NAME.fullmatch(label):
        raise fields.fail("class", "small letters and digits, as black or nut_m4")
    if fields.one_of("count", "positions_m") == "count":
        group = PartGroup(label, fields.value(keys.GROUP["count"]))
    else:
        position = fields.value(keys.GROUP["positions_m"])
        group = PartGroup(label, len(position), _pairs(position))
    fields.finish()
    return group


def _task(fields: Fields, parts: tuple[PartGroup, ...]) -> Task:
    kinds: dict[str, Callable[[Fields, tuple[PartGroup, ...]], Task]]
    kinds = {
        "sort": _sort, "follow": _follow, "assemble": _assemble, "pose": _pose, "move": _move,
        "feed": read_feed,
    }  # fmt: skip
    task = kinds[fields.value(keys.TASK["kind"])](fields, parts)
    fields.finish()
    return task


def _pairs(array: np.ndarray) -> tuple[Point, ...]:
    """Return the rows of an array (n, 2) as tuples."""
    return tuple((float(x), float(y)) for x, y in array)


def _sort(fields: Fields, parts: tuple[PartGroup, ...]) -> SortTask:
    # Files with two classes and two sides say `sides`.
    child = fields.child("sides" if fields.has("sides") else "regions")
    regions = {group.label: _region(child, group.label) for group in parts}
    child.finish()
    goal = keys.SORT["goal_fraction"]
    if any(isinstance(region, Side) for region in regions.values()):
        goal = required(goal)
    return SortTask(
        regions=regions,
        goal_fraction=fields.value(goal) or 0.0,
        hold_s=fields.value(keys.HOLD),
    )


def _region(fields: Fields, label: str) -> Region:
    if not fields.holds_mapping(label):
        return keys.SIDES[fields.text(label, tuple(keys.SIDES))]
    child = fields.child(label)
    corner = child.value(keys.BIN["bin_m"])
    if not is_simple(corner):
        raise child.fail("bin_m", "at least three corners, in order, of a polygon with an area")
    child.finish()
    return Bin(_pairs(corner))


def _follow(fields: Fields, parts: tuple[PartGroup, ...]) -> FollowTask:
    labels = tuple(group.label for group in parts)
    paths = tuple(_path(child, labels) for child in fields.children("paths"))
    _one_each(fields, "paths", [path.label for path in paths], parts)
    return FollowTask(paths=paths, max_error_m=fields.value(keys.FOLLOW["max_error_m"]))


def _path(fields: Fields, labels: tuple[str, ...]) -> PathTask:
    curve = fields.one_of(*keys.CURVES)
    if curve == "circle":
        closed, waypoint = True, _circle(fields.child("circle"))
    else:
        closed, waypoint = _points(fields, curve)
    profile = _profile(fields)
    path = PathTask(
        label=fields.value(keys.class_key(*labels)),
        waypoint=_pairs(waypoint),
        speed=max(speed for _, speed in profile),
        closed=closed,
        laps=fields.value(required(keys.PATH["laps"])) if closed else 1.0,
        profile=profile if len(profile) > 1 else (),
    )
    fields.finish()
    return path


def _circle(fields: Fields) -> np.ndarray:
    x, y = fields.value(keys.CIRCLE["centre_m"])
    points = circle_points(
        (float(x), float(y)),
        fields.value(keys.CIRCLE["radius_m"]),
        np.radians(fields.value(keys.CIRCLE["start_deg"])),
        fields.value(keys.CIRCLE["turn"]) == "left",
    )
    fields.finish()
    return points


def _points(fields: Fields, key: str) -> tuple[bool, np.ndarray]:
    waypoint = fields.value(keys.PATH[key])
    step = np.hypot(*np.diff(waypoint, axis=0).T)
    if len(waypoint) < 2 or np.min(step) < APART_M:
        raise fields.fail(key, "at least two points, each apart from the next")
    closed = fields.value(required(keys.PATH["closed"]))
    if closed and np.hypot(*(waypoint[-1] - waypoint[0])) < APART_M:
        raise fields.fail(key, "for a closed path, a last point that is not the first")
    if key == "spline_m":
        if len(waypoint) < 3:
            raise fields.fail(key, "at least three points")
        waypoint = spline_points(waypoint, closed)
    return closed, waypoint


def _profile(fields: Fields) -> tuple[tuple[float, float], ...]:
    """Return speeds [m/s] at fractions of a lap; one pair if the speed is the same all the way."""
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
            f"a number, or pairs [fraction of a lap, m/s], fractions growing from 0 to 1, "
            f"speeds from {keys.SLOWEST_MPS:g} to {keys.FASTEST_MPS:g}",
        )
    return _pairs(profile)


def _assemble(fields: Fields, parts: tuple[PartGroup, ...]) -> AssembleTask:
    child = fields.child("places_m")
    labels: list[str] = []
    place: list[Point] = []
    for group in parts:
        points = _pairs(child.array(group.label, (None, 2), -keys.FAR_M, keys.FAR_M))
        labels += [group.label] * len(points)
        place += points
    child.finish()
    _one_each(fields, "places_m", labels, parts)
    return AssembleTask(
        labels=tuple(labels),
        place=tuple(place),
        tolerance_m=fields.value(keys.TOLERANCE),
        hold_s=fields.value(keys.HOLD),
    )


def _pose(fields: Fields, parts: tuple[PartGroup, ...]) -> PoseTask:
    labels = tuple(group.label for group in parts)
    poses = []
    for child in fields.children("poses"):
        label = child.value(keys.class_key(*labels))
        at = child.value(keys.POSES["place_m"])
        place = None if at is None else _pairs(at[None])[0]
        angle = child.value(keys.POSES["angle_deg"])
        poses.append(Pose(label, place, float(np.radians(angle))))
        child.finish()
    _one_each(fields, "poses", [pose.label for pose in poses], parts)
    return PoseTask(
        poses=tuple(poses),
        tolerance_m=fields.value(keys.TOLERANCE),
        tolerance_rad=float(np.radians(fields.value(keys.POSE["tolerance_deg"]))),
        hold_s=fields.value(keys.HOLD),
        anywhere=fields.value(keys.POSE["anywhere"]),
    )


def _move(fields: Fields, parts: tuple[PartGroup, ...]) -> MoveTask:
    labels = [group.label for group in parts]
    targets = []
    for child in fields.children("targets") if fields.has("targets") else ():
        name, angle = child.value(keys.MOVES["id"]), child.value(keys.MOVES["angle_deg"])
        if part_class(name) not in labels or not name.rpartition("_")[2].isdecimal():
            raise child.fail("id", f"a class and a number, such as {labels[0]}_1")
        (place,) = _pairs(child.value(keys.MOVES["place_m"])[None])
        targets.append(PartTarget(name, place, None if angle is None else math.radians(angle)))
        child.finish()
    if len({target.id for target in targets}) < len(targets) or len(targets) > MOST_PARTS:
        raise fields.fail("targets", f"each part once, at most {MOST_PARTS}")
    return MoveTask(
        targets=tuple(targets),
        tolerance_m=fields.value(keys.TOLERANCE),
        tolerance_rad=math.radians(fields.value(keys.MOVE["tolerance_deg"])),
        hold_s=fields.value(keys.HOLD),
        until_canceled=fields.value(keys.MOVE["until_canceled"]),
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


def check_scenario(scenario: Scenario, rig: Rig) -> None:
    """Refuse a scenario of too many parts, or whose positions, paths, regions or places do not fit
    on this rig's plate.

    Raises
    ------
    ScenarioError
        Names the file, the key, the class, and the point and the greatest `|x|` and `|y|` allowed
        for a part's centre; or two points too near each other, or two regions that overlap.
    """
    task = scenario.task
    known = tuple(rig.types) or keys.CLASSES  # with types the detector knows no others
    for group in scenario.parts:
        if group.label not in known:
            raise ScenarioError(
                f"{scenario.where}: parts: class is {group.label!r}"
                f"{did_you_mean(group.label, known)}, allowed with this rig: {', '.join(known)}"
            )
    reach = {group.label: rig.part_type(group.label).reach_m for group in scenario.parts}
    if scenario.count > MOST_PARTS:
        raise ScenarioError(
            f"{scenario.where}: parts: {scenario.count}, allowed: at most {MOST_PARTS} in all"
        )
    for label, part in ((label, rig.part_type(label)) for label in _turned(task)):
        if part.symmetry == 0 and label in rig.types:
            raise ScenarioError(
                f"{scenario.where}: angles of {label} are asked for, allowed: of parts that are "
                "not round (marks are seen only on rigs without types)"
            )
        if part.symmetry == 0 and not scenario.marked:
            raise ScenarioError(
                f"{scenario.where}: marked is false, allowed with angles of {label}: true (a round "
                "part without a mark shows no angle)"
            )
    placed = [("parts: positions_m", g.label, p) for g in scenario.parts for p in g.position or ()]
    goals = goal_places(scenario)
    _check_on_plate(scenario, placed, rig.plate.half, reach)
    _check_apart(scenario, placed, reach, 1.0)
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
        edge = dict.fromkeys(reach, 0.0)  # these may be on it
        _check_on_plate(scenario, corners, rig.plate.half, edge)
        _check_bins(scenario, task, rig)
        _check_regions(scenario, task, rig.plate.half)
    _check_apart(scenario, goals, reach, 1.25 if isinstance(task, AssembleTask) else 1.0)


def target_problem(target: PartTarget, scenario: Scenario, rig: Rig) -> str:
    """Say why a part cannot be asked to come to a target; empty if it can."""
    label = part_class(target.id)
    if label not in scenario.labels:
        known = ", ".join(sorted(set(scenario.labels)))
        return f"{target.id} is of no class of this task, allowed: {known}"
    part = rig.part_type(label)
    if problem := edge_problem(label, target.place, rig):
        return f"place of {target.id} is {problem}"
    if target.angle is None:
        return ""
    if not math.isfinite(target.angle):
        return f"angle of {target.id} is {target.angle:g}, allowed: finite, or none"
    if part.symmetry == 0 and (label in rig.types or not scenario.marked):
        return f"{target.id} is round and shows no angle, allowed: none for it (or a mark: marked)"
    return ""


def _turned(task: Task) -> list[str]:
    """Return the classes whose angles a task asks for."""
    if isinstance(task, FeedTask):
        return [pick.label for pick in task.picks if pick.angle is not None]
    return [pose.label for pose in task.poses] if isinstance(task, PoseTask) else []


def _check_on_plate(
    scenario: Scenario, places: list[Place], half: np.ndarray, reach: Mapping[str, float]
) -> None:
    for key, label, (x, y) in places:
        room = half - reach[label]
        if np.any(np.abs((x, y)) > room + ROUNDING_M):
            raise ScenarioError(
                f"{scenario.where}: {key} of {label} is ({x:g}, {y:g}) m, "
                f"allowed: |x| up to {room[0]:g}, |y| up to {room[1]:g} m on this plate"
            )


def _check_apart(
    scenario: Scenario, places: list[Place], reach: Mapping[str, float], factor: float
) -> None:
    for (key, one, a), (_, other, b) in combinations(places, 2):
        least = factor * (reach[one] + reach[other])
        gap = float(np.hypot(a[0] - b[0], a[1] - b[1]))
        if gap < least - 1e-9:
            raise ScenarioError(
                f"{scenario.where}: {key} of {one} ({a[0]:g}, {a[1]:g}) m and of {other} "
                f"({b[0]:g}, {b[1]:g}) m are {1e3 * gap:.3g} mm apart, allowed: "
                f"{1e3 * least:.3g} mm or more for these parts"
            )


def _check_bins(scenario: Scenario, task: SortTask, rig: Rig) -> None:
    """Refuse a bin whose parts would all lie where they are lost."""
    for label, region in task.regions.items():
        if not isinstance(region, Bin):
            continue
        room = rig.plate.half - rig.edge_margin(label).least_m
        inside = np.array(region.corner)
        for axis in (0, 1):
            inside = _cut(_cut(inside, axis, 1, -room[axis]), axis, -1, -room[axis])
        if not len(inside):
            raise ScenarioError(
                f"{scenario.where}: task: regions: bin_m of {label} is {nowhere_text(label, rig)}"
            )


def _check_regions(scenario: Scenario, task: SortTask, half: np.ndarray) -> None:
    """Refuse a side or corner that has an area in common with the region of another class.

    Two bins in one place are refused by the planner, by the places of their parts.
    """
    for pair in combinations(task.regions, 2):
        # a side first: the other one is cut at its goal lines
        one, other = sorted(pair, key=lambda label: isinstance(task.regions[label], Bin))
        if isinstance(task.regions[one], Bin):
            continue
        outline, inside = (region_outline(task, label, half) for label in (one, other))
        for axis in (0, 1):
            low, high = float(np.min(outline[:, axis])), float(np.max(outline[:, axis]))
            inside = _cut(_cut(inside, axis, 1, low), axis, -1, -high)
        shared = 0.5 * abs(float(np.sum(cross(inside, np.roll(inside, -1, axis=0)))))
        if shared > APART_M:
            words = " and ".join(f"{k} is {_region_text(task, k, half)}" for k in (one, other))
            raise ScenarioError(
                f"{scenario.where}: task: regions: {words}: they share {1e4 * shared:.3g} cm2, "
                "allowed: regions with no area in common"
            )


def region_outline(task: SortTask, label: str, half: np.ndarray) -> np.ndarray:
    """Return the corners (n, 2) [m, plate_home] of a class's region, on a plate of half sides
    (2,) [m]."""
    region, goal = task.regions[label], task.goal_fraction
    if isinstance(region, Bin):
        return np.array(region.corner)
    signs = (region.x, region.y)
    low = [-h if sign <= 0 else goal * h for sign, h in zip(signs, half, strict=True)]
    high = [h if sign >= 0 else -goal * h for sign, h in zip(signs, half, strict=True)]
    (left, bottom), (right, top) = low, high
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])


def _region_text(task: SortTask, label: str, half: np.ndarray) -> str:
    """Return a region in words: `left, x from -0.3 to -0.18, y from ...`."""
    names = (name for name, side in keys.SIDES.items() if side == task.regions[label])
    outline = region_outline(task, label, half)
    (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
    return f"{next(names, 'a bin')} (x from {x0:g} to {x1:g}, y from {y0:g} to {y1:g} m)"


def _cut(polygon: np.ndarray, axis: int, sign: int, least: float) -> np.ndarray:
    """Return what of a polygon (n, 2) has sign * x[axis] >= least (Sutherland and Hodgman 1974)."""
    corners: list[np.ndarray] = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        beyond_a, beyond_b = sign * a[axis] - least, sign * b[axis] - least
        if beyond_a >= 0:
            corners.append(a)
        if (beyond_a >= 0) != (beyond_b >= 0):
            corners.append(a + beyond_a / (beyond_a - beyond_b) * (b - a))
    return np.array(corners).reshape(-1, 2)


def start_positions(
    scenario: Scenario, rig: Rig, rng: np.random.Generator
) -> tuple[tuple[str, ...], np.ndarray]:
    """Place the parts: the given ones where given, the others at random.

    Scattered parts keep the first of `SCATTER_GAPS` that leaves room for all, from all others, and
    are clear of the edges (`SCATTER_FRACTION`, `SCATTER_CLEAR`).

    Parameters
    ----------
    scenario : Scenario
    rig : Rig
    rng : numpy.random.Generator
        Source of the scattered positions.

    Returns
    -------
    labels : tuple of str, length M
        Class of every part.
    position : (M, 2)
        Centres [m, plate_home].

    Raises
    ------
    ScenarioError
        If a given position is off the plate, or there is no room for all parts.
    """
    check_scenario(scenario, rig)
    given = [p for group in scenario.parts for p in group.position or ()]
    half = rig.plate.half
    reach = {group.label: rig.part_type(group.label).reach_m for group in scenario.parts}
    sizes = [
        np.array([reach[g.label] for g in scenario.parts for _ in range(g.count) if wanted(g)])
        for wanted in (lambda g: g.position is not None, lambda g: g.position is None)
    ]
    radius, count = np.concatenate(sizes), len(sizes[1])
    limit = np.array(SCATTER_FRACTION) * half
    limit = np.maximum(np.minimum(limit, half - SCATTER_CLEAR * radius[:, None]), 0)
    taken, most = np.array(given).reshape(-1, 2), 0
    for gap in np.repeat(SCATTER_GAPS, SCATTER_STARTS):
        scattered = _scatter(radius, taken, limit, gap, rng)
        most = max(most, len(scattered))
        if most == count:
            break
    else:
        raise ScenarioError(
            f"{scenario.where}: parts: count: {count} to scatter, allowed: {most}; no more parts "
            f"of up to {1e3 * radius.max():g} mm radius find room, {gap:g} radii apart, on "
            f"{2 * half[0]:g} x {2 * half[1]:g} m; fewer parts, or positions_m"
        )
    rest = iter(scattered)
    rows = [
        group.position[i] if group.position is not None else next(rest)
        for group in scenario.parts
        for i in range(group.count)
    ]
    return scenario.labels, np.array(rows, dtype=float).reshape(-1, 2)


def _scatter(
    radius: np.ndarray, taken: np.ndarray, limit: np.ndarray, gap: float, rng: np.random.Generator
) -> np.ndarray:
    """Throw up to N - T points (k, 2) beside T that are taken, of parts of radii (N,) [m]; each is
    `gap` mean radii from all before it, and within its limits (N, 2) [m]; fewer if one finds no
    room."""
    start = len(taken)
    points = np.vstack([taken, np.zeros((len(radius) - start, 2))])
    for i in range(start, len(radius)):
        for _ in range(SCATTER_TRIES):
            points[i] = rng.uniform(-limit[i], limit[i])
            least = gap * (radius[:i] + radius[i]) / 2
            if np.all(np.hypot(*(points[:i] - points[i]).T) >= least):
                break
        else:
            return points[start:i]
    return points[start:]
