"""What two or more stages share: rig facts, frames, plate cycles, kinematics, messages."""

from .cycle import PlateCycle
from .errors import CycleError, PlateError, RigError, ScenarioError
from .parts import PartSet
from .rig import Rig, load_rig

__all__ = [
    "CycleError",
    "PartSet",
    "PlateCycle",
    "PlateError",
    "Rig",
    "RigError",
    "ScenarioError",
    "load_rig",
]
