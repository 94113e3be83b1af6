"""What the nodes share of ROS: messages, QoS, parameters, diagnostics, markers, start and end.

Nothing else outside the nodes imports ROS.
"""

from .convert import (
    array_to_image,
    camera_to_info,
    cycle_to_msg,
    driver_status_to_msg,
    image_to_array,
    motors_to_msg,
    msg_to_cycle,
    msg_to_driver_status,
    msg_to_knots,
    msg_to_motors,
    msg_to_parts,
    msg_to_targets,
    msg_to_wanted,
    nanoseconds,
    parts_to_msg,
    pose_to_msg,
    seconds,
    target_to_msg,
    targets_to_msg,
    to_time,
    trajectory_to_msg,
    wanted_to_msg,
)
from .diagnostics import DIAGNOSTICS_PERIOD_S, Diagnostics, Report, msg_to_reports
from .executor import NodeExecutor
from .frames import FRAME, camera_to_msg, plate_to_msg
from .goals import (
    ACTIONS,
    goal_to_scenario,
    msg_to_order,
    msg_to_pick,
    new_goal_id,
    order_to_msg,
    pick_to_msg,
    scenario_to_goal,
)
from .lifecycle import NodeOptions, SafeLifecycleNode, start_nodes
from .main import run_node, run_nodes
from .markers import centres_to_msg, forces_to_msg, scene_to_msg
from .params import declare, follow, parameter
from .qos import CALLS, CAMERA, DATA, IMAGE, LATCHED, NEWEST, TRANSFORMS
from .unlocked import UnlockedSubscription, deserialized

__all__ = [
    "ACTIONS",
    "CALLS",
    "CAMERA",
    "DATA",
    "DIAGNOSTICS_PERIOD_S",
    "FRAME",
    "IMAGE",
    "LATCHED",
    "NEWEST",
    "TRANSFORMS",
    "Diagnostics",
    "NodeExecutor",
    "NodeOptions",
    "Report",
    "SafeLifecycleNode",
    "UnlockedSubscription",
    "array_to_image",
    "camera_to_info",
    "camera_to_msg",
    "centres_to_msg",
    "cycle_to_msg",
    "declare",
    "deserialized",
    "driver_status_to_msg",
    "follow",
    "forces_to_msg",
    "goal_to_scenario",
    "image_to_array",
    "motors_to_msg",
    "msg_to_cycle",
    "msg_to_driver_status",
    "msg_to_knots",
    "msg_to_motors",
    "msg_to_order",
    "msg_to_parts",
    "msg_to_pick",
    "msg_to_reports",
    "msg_to_targets",
    "msg_to_wanted",
    "nanoseconds",
    "new_goal_id",
    "order_to_msg",
    "parameter",
    "parts_to_msg",
    "pick_to_msg",
    "plate_to_msg",
    "pose_to_msg",
    "run_node",
    "run_nodes",
    "scenario_to_goal",
    "scene_to_msg",
    "seconds",
    "start_nodes",
    "target_to_msg",
    "targets_to_msg",
    "to_time",
    "trajectory_to_msg",
    "wanted_to_msg",
]
