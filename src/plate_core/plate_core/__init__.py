"""Code that two or more stages share: rig data, plate motions, tasks, messages, serial protocol.

This package exports the most common names. The modules `rig`, `motion`, `tasks`, `ros`,
`serial_protocol`, `colours`, `driver_status`, `status` and `yaml_fields` export further names.
"""

from .cycle_request import AngleTargets, CycleRequest, Forces, Targets
from .ending import ends, piped
from .errors import CycleError, FrameError, PlateError, RigError, ScenarioError, did_you_mean
from .motion import PlateCycle
from .network import choose_network, memory_problem, node_namespace, ros_domain
from .parts import (
    GROUP,
    MAX_PARTS,
    NAMELESS,
    PLAUSIBLE_AREA,
    UNKNOWN,
    OverlookedThing,
    Parts,
    part_class,
)
from .rig import Rig, load_rig
from .yaml_fields import config_path

__all__ = [
    "GROUP",
    "MAX_PARTS",
    "NAMELESS",
    "PLAUSIBLE_AREA",
    "UNKNOWN",
    "AngleTargets",
    "CycleError",
    "CycleRequest",
    "Forces",
    "FrameError",
    "OverlookedThing",
    "Parts",
    "PlateCycle",
    "PlateError",
    "Rig",
    "RigError",
    "ScenarioError",
    "Targets",
    "choose_network",
    "config_path",
    "did_you_mean",
    "ends",
    "load_rig",
    "memory_problem",
    "node_namespace",
    "part_class",
    "piped",
    "ros_domain",
]
