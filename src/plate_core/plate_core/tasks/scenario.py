"""Scenarios: which parts are on the plate, where they start, and what is to be done with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import PlateError, ScenarioError
from ..rig import Rig
from ..yaml_fields import Fields, config_path, read_yaml
from .task_fields import pairs, read_task
from .tasks import (
    AssembleTask,
    Bin,
    FollowTask,
    PartGroup,
    Point,
    PoseTask,
    Scenario,
    SortTask,
    Task,
)

MIN_SEPARATION_M = 0.04
"""Least distance of scattered centres [m]: five radii of the default parts."""

SCATTER_SHARE = (0.85, 0.80)
"""Share of the half sides (x, y) within which parts are scattered: clear of the edges."""

SCATTER_TRIES = 80
"""Tries to place one part, and to place all of them, before a scenario counts as too crowded."""


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
                f"scenario is {text!r}, allowed: {', '.join(names)}, or the path of a .yaml file"
            )
        path = config_path("scenarios") / f"{text}.yaml"
    fields = read_yaml(path, ScenarioError)
    parts = tuple(_group(child) for child in fields.children("parts"))
    if not parts:
        raise fields.fail("parts", "at least one group of parts")
    labels = [group.label for group in parts]
    if len(set(labels)) < len(labels):
        raise fields.fail("parts", "each class once")
    scenario = Scenario(
        name=path.stem,
        description=fields.text("description"),
        parts=parts,
        task=read_task(fields.child("task"), parts),
        time_limit_s=fields.number("time_limit_s", 0.1, 1e5),
        marked=fields.has("marked") and fields.flag("marked"),
    )
    if isinstance(scenario.task, PoseTask) and not scenario.marked:
        raise ScenarioError(
            f"{fields.where}: marked is false, allowed with a task of poses: true (a round part "
            "without a mark shows no angle)"
        )
    fields.finish()
    return scenario


def check_scenario(scenario: Scenario, rig: Rig) -> None:
    """Refuse a scenario whose positions, paths, bins or places are not on this rig's plate.

    Raises
    ------
    ScenarioError
        Names the class, the point and the greatest `|x|` and `|y|` allowed for a part's centre; or
        the two places that are too near each other.
    """
    room = rig.plate.half - rig.parts.radius_m
    points = [(g.label, "position", p) for g in scenario.parts for p in g.position or ()]
    points += _task_points(scenario.task)
    _check_points(scenario, points, room)
    if isinstance(scenario.task, SortTask):
        _check_points(scenario, _bin_points(scenario.task), rig.plate.half)
    if isinstance(scenario.task, AssembleTask):
        _check_apart(scenario, np.array(scenario.task.place), 2.5 * rig.parts.radius_m)


def _task_points(task: Task) -> list[tuple[str, str, Point]]:
    """Class, kind and place of the points where the task wants centres of parts."""
    if isinstance(task, FollowTask):
        return [(path.label, "waypoint", point) for path in task.paths for point in path.waypoint]
    if isinstance(task, AssembleTask):
        return [(c, "place", point) for c, point in zip(task.labels, task.place, strict=True)]
    if isinstance(task, PoseTask):
        return [(pose.label, "place", pose.place) for pose in task.poses if pose.place is not None]
    return []


def _bin_points(task: SortTask) -> list[tuple[str, str, Point]]:
    """Class, kind and place of the corners of bins; these may be on the plate's edges."""
    return [
        (label, "corner of the bin", point)
        for label, region in task.regions.items()
        if isinstance(region, Bin)
        for point in region.corner
    ]


def _check_points(
    scenario: Scenario, points: list[tuple[str, str, Point]], room: np.ndarray
) -> None:
    for label, kind, point in points:
        if np.any(np.abs(point) > room):
            raise ScenarioError(
                f"scenario {scenario.name}: {kind} of {label} is ({point[0]:g}, {point[1]:g}) m, "
                f"allowed: |x| up to {room[0]:g}, |y| up to {room[1]:g} m on this plate"
            )


def _check_apart(scenario: Scenario, place: np.ndarray, least: float) -> None:
    gap = np.hypot(*(place[:, None] - place[None]).transpose(2, 0, 1))
    gap[np.diag_indices(len(place))] = np.inf
    if np.min(gap) < least - 1e-9:
        i, j = divmod(int(np.argmin(gap)), len(place))
        raise ScenarioError(
            f"scenario {scenario.name}: places {i} and {j} are "
            f"{np.min(gap):g} m apart, allowed: {least:g} m or more for these parts"
        )


def start_positions(
    scenario: Scenario, rig: Rig, rng: np.random.Generator
) -> tuple[tuple[str, ...], np.ndarray]:
    """Place the parts: the given ones where given, the others at random.

    Scattered parts keep `MIN_SEPARATION_M` from all others and stay within `SCATTER_SHARE` of the
    plate's half sides.

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
    limit = np.array(SCATTER_SHARE) * rig.plate.half
    count = sum(group.count for group in scenario.parts if group.position is None)
    for _ in range(SCATTER_TRIES):
        scattered = _scatter(count, np.array(given).reshape(-1, 2), limit, rng)
        if scattered is not None:
            break
    else:
        raise ScenarioError(
            f"scenario {scenario.name}: {count} parts to scatter, allowed: as many as fit "
            f"{MIN_SEPARATION_M:g} m apart on {2 * limit[0]:g} x {2 * limit[1]:g} m"
        )
    rest = iter(scattered)
    rows = [
        group.position[i] if group.position is not None else next(rest)
        for group in scenario.parts
        for i in range(group.count)
    ]
    return scenario.labels, np.array(rows, dtype=float).reshape(-1, 2)


def _scatter(
    count: int, taken: np.ndarray, limit: np.ndarray, rng: np.random.Generator
) -> np.ndarray | None:
    """Throw `count` points (count, 2), each clear of all before it; None if one finds no room."""
    start = len(taken)
    points = np.vstack([taken, np.zeros((count, 2))])
    for i in range(start, start + count):
        for _ in range(SCATTER_TRIES):
            points[i] = rng.uniform(-limit, limit)
            if np.all(np.hypot(*(points[:i] - points[i]).T) >= MIN_SEPARATION_M):
                break
        else:
            return None
    return points[start:]


def _group(fields: Fields) -> PartGroup:
    label = fields.text("class")
    if not label.isidentifier() or label.rsplit("_", 1)[-1].isdigit():
        raise fields.fail("class", "a plain word such as black, without a number")
    if fields.has("positions_m") == fields.has("count"):
        raise fields.fail("positions_m", "a list of [x, y] in m, or count in its place, not both")
    if fields.has("count"):
        group = PartGroup(label, fields.integer("count", 1, 100))
    else:
        position = fields.array("positions_m", (None, 2), -10, 10)
        group = PartGroup(label, len(position), pairs(position))
    fields.finish()
    return group
