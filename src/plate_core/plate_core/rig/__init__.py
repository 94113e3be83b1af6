"""Measured data of one rig: plate, friction, motors, limits, suspension, camera, lens, fiducials,
part types and their polygons.

The package also converts between three frames: world-fixed (`plate_home`), moving plate, and image.
`load_rig` reads a rig file, and `SECTIONS` defines the keys of the file.
"""

from .consistency import CYCLE_HZ, MIN_GAMMA, PART_PX, RigWarning, rig_warnings
from .edit import edit_rig
from .fiducials import Fiducials
from .frames import (
    camera_pose,
    camera_position,
    fit_homography,
    home_pose,
    homography,
    part_radius_px,
    project,
    row_delay,
    surface_velocity,
    to_home,
    to_image,
    to_plate,
)
from .keys import ODRIVE_COUNTS
from .lens import MODELS as LENS_MODELS
from .lens import Lens, lens_of_matrix
from .measured import unmeasured
from .motors import PEAK_OVER_RMS, Reach
from .part_types import (
    MAX_CORNERS,
    MAX_HEIGHT_M,
    MAX_HOLES,
    PART_TYPE,
    PartType,
    load_part_types,
    read_part_types,
)
from .polygons import is_simple, moments
from .rig import EdgeMargin, Rig
from .rig_file import SECTIONS, default_rig_path, load_rig, rig_names, rig_path
from .sections import Camera, CameraTrigger, Drive, Friction, Limits, Motor, PartFacts, Plate
from .suspension import Suspension, mass_matrix, modal_matrices

__all__ = [
    "CYCLE_HZ",
    "LENS_MODELS",
    "MAX_CORNERS",
    "MAX_HEIGHT_M",
    "MAX_HOLES",
    "MIN_GAMMA",
    "ODRIVE_COUNTS",
    "PART_PX",
    "PART_TYPE",
    "PEAK_OVER_RMS",
    "SECTIONS",
    "Camera",
    "CameraTrigger",
    "Drive",
    "EdgeMargin",
    "Fiducials",
    "Friction",
    "Lens",
    "Limits",
    "Motor",
    "PartFacts",
    "PartType",
    "Plate",
    "Reach",
    "Rig",
    "RigWarning",
    "Suspension",
    "camera_pose",
    "camera_position",
    "default_rig_path",
    "edit_rig",
    "fit_homography",
    "home_pose",
    "homography",
    "is_simple",
    "lens_of_matrix",
    "load_part_types",
    "load_rig",
    "mass_matrix",
    "modal_matrices",
    "moments",
    "part_radius_px",
    "project",
    "read_part_types",
    "rig_names",
    "rig_path",
    "rig_warnings",
    "row_delay",
    "surface_velocity",
    "to_home",
    "to_image",
    "to_plate",
    "unmeasured",
]
