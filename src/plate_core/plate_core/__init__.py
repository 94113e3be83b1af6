"""What two or more stages share: rig facts, plate motions, tasks, messages, the serial protocol.

Here are the names that everybody needs; the chapters `rig`, `motion`, `tasks`, `ros`,
`serial_protocol`, `colours`, `driver_status`, `status` and `yaml_fields` have the rest.
"""

from .ending import ends, piped
from .errors import CycleError, FrameError, PlateError, RigError, ScenarioError, did_you_mean
from .motion import PlateCycle
from .network import choose_network, ros_domain
from .parts import (
    GROUP,
    MOST_PARTS,
    NAMELESS,
    PLAUSIBLE_AREA,
    UNKNOWN,
    OverlookedThing,
    Parts,
    part_class,
)
from .rig import Rig, load_rig
from .wanted import AngleTargets, Forces, Targets, Wanted
from .yaml_fields import config_path

__all__ = [
    "GROUP",
    "MOST_PARTS",
    "NAMELESS",
    "PLAUSIBLE_AREA",
    "UNKNOWN",
    "AngleTargets",
    "CycleError",
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
    "Wanted",
    "choose_network",
    "config_path",
    "did_you_mean",
    "ends",
    "load_rig",
    "part_class",
    "piped",
    "ros_domain",
]
