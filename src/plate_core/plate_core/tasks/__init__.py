"""Scenarios: which parts are on the plate, and what is to be done with them.

`load_scenario` reads one, `start_positions` places its parts; the tasks are plain data.
`SECTIONS` are the keys of a scenario file.
"""

from .curves import circle_points
from .keys import CLASSES, SECTIONS, side_name
from .scenario import (
    check_scenario,
    load_scenario,
    read_scenario,
    region_outline,
    scenario_names,
    start_positions,
)
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
    Scenario,
    Side,
    SortTask,
    Task,
)

__all__ = [
    "CLASSES",
    "SECTIONS",
    "AssembleTask",
    "Bin",
    "FollowTask",
    "PartGroup",
    "PathTask",
    "Point",
    "Pose",
    "PoseTask",
    "Region",
    "Scenario",
    "Side",
    "SortTask",
    "Task",
    "check_scenario",
    "circle_points",
    "load_scenario",
    "read_scenario",
    "region_outline",
    "scenario_names",
    "side_name",
    "start_positions",
]
