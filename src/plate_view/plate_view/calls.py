"""The equivalent terminal call for each command of a browser. The page's log shows these calls."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from .commands import Command

SERVICES = {
    "emergency_stop": ("/emergency_stop", "std_srvs/srv/Trigger"),
    "cut_power": ("/cut_power", "std_srvs/srv/Trigger"),
    "stop": ("/stop", "std_srvs/srv/Trigger"),
    "enable": ("/enable", "std_srvs/srv/SetBool"),
    "learn_plate": ("/detector/learn_plate", "std_srvs/srv/Trigger"),
    "teach": ("/detector/teach", "std_srvs/srv/Trigger"),
    "find_home": ("/detector/find_home", "std_srvs/srv/Trigger"),
    "save_home": ("/detector/save_home", "std_srvs/srv/Trigger"),
    "take_lens_pictures": (
        "/detector/take_lens_pictures",
        "plate_interfaces/srv/TakeLensPictures",
    ),
    "fit_lens": ("/detector/fit_lens", "std_srvs/srv/Trigger"),
    "save_lens": ("/detector/save_lens", "std_srvs/srv/Trigger"),
    "measure_friction": ("/measure_friction", "plate_interfaces/srv/MeasureFriction"),
    "write_friction": ("/write_friction", "std_srvs/srv/Trigger"),
    "reset": ("/simulator/reset", "std_srvs/srv/Trigger"),
    "place": ("/simulator/place_part", "plate_interfaces/srv/PlacePart"),
    "remove": ("/simulator/remove_part", "plate_interfaces/srv/RemovePart"),
}
"""Name and type of the called service, for each command that calls exactly one service."""


def call_text(command: Command) -> str:
    """Return the terminal command that has the same effect as a command of a browser."""
    values = command.values
    match command.name:
        case "cancel" | "stop" | "emergency_stop" | "cut_power":
            return f"plate {command.name}"
        case "enable":
            return "plate enable" if values["on"] else "plate disable"
        case "start" if values["scenario"] is not None:
            return f"plate goal {values['scenario']}"
        case "set":
            return f"plate set {values['node']} {values['name']} {_quote(values['value'])}"
        case "parameters":
            return f"plate params {values['node']}"
        case "move":
            return "ros2 topic pub --once /targets plate_interfaces/msg/Targets " + _yaml_flow(
                {"targets": values["targets"]}
            )
        case "teach":
            return (
                f"plate set detector teach_name {_quote(values['name'])} && "
                "ros2 service call /detector/teach std_srvs/srv/Trigger"
            )
        case "reset" if values["seed"] is not None:
            return (
                f"plate set simulator seed {values['seed']} && "
                "ros2 service call /simulator/reset std_srvs/srv/Trigger"
            )
        case "place" | "remove" | "take_lens_pictures" | "measure_friction":
            service, kind = SERVICES[command.name]
            given = {key: value for key, value in values.items() if value is not None}
            return f"ros2 service call {service} {kind} {_yaml_flow(given)}"
        case name if name in SERVICES:
            service, kind = SERVICES[name]
            return f"ros2 service call {service} {kind}"
        case name:
            return name


def goal_text(action: str, kind: str, goal: Mapping[str, Any]) -> str:
    """Return the terminal command that sends a goal of an action."""
    return f"ros2 action send_goal /{action} plate_interfaces/action/{kind} {_yaml_flow(goal)}"


def _quote(value: Any) -> str:
    return shlex.quote(str(value).lower() if isinstance(value, bool) else str(value))


def _yaml_flow(value: Mapping[str, Any] | Sequence[Any]) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False)
    return shlex.quote(text.strip())
