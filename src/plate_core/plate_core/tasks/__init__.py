"""Scenarios: the parts on the plate, and the task for them.

`load_scenario` reads a scenario file, `check_scenario` compares it with a rig, and
`start_positions` places its parts. The tasks are plain data classes. `SECTIONS` defines the keys of
a scenario file.
"""

from .curves import circle_points
from .edges import behind_wall, edge_warnings
from .feed import (
    MAX_OPEN_S,
    as_picked,
    free_gap,
    pick_problem,
    pick_window,
    ready_parts,
    remaining_rotation,
)
from .keys import CLASSES, SECTIONS, side_name
from .scenario import (
    check_scenario,
    load_scenario,
    read_scenario,
    region_outline,
    scenario_names,
    start_positions,
    target_problem,
)
from .tasks import (
    AssembleTask,
    Bin,
    FeedMode,
    FeedOrder,
    FeedTask,
    FollowTask,
    Hopper,
    MoveTask,
    PartGroup,
    PartTarget,
    PathTask,
    Pick,
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
    "MAX_OPEN_S",
    "SECTIONS",
    "AssembleTask",
    "Bin",
    "FeedMode",
    "FeedOrder",
    "FeedTask",
    "FollowTask",
    "Hopper",
    "MoveTask",
    "PartGroup",
    "PartTarget",
    "PathTask",
    "Pick",
    "Point",
    "Pose",
    "PoseTask",
    "Region",
    "Scenario",
    "Side",
    "SortTask",
    "Task",
    "as_picked",
    "behind_wall",
    "check_scenario",
    "circle_points",
    "edge_warnings",
    "free_gap",
    "load_scenario",
    "pick_problem",
    "pick_window",
    "read_scenario",
    "ready_parts",
    "region_outline",
    "remaining_rotation",
    "scenario_names",
    "side_name",
    "start_positions",
    "target_problem",
]
