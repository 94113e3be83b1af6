"""Measured facts of one rig: plate, friction, motors, limits, suspension, camera, lens, fiducials.

Also its frames: room (`plate_home`), moving plate, image. A rig file is read by `load_rig`;
`SECTIONS` are its keys.
"""

from .consistency import CYCLE_HZ, LEAST_GAMMA, PART_PX, Doubt, doubts
from .fiducials import Fiducials
from .frames import (
    camera_pose,
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
from .lens import Lens
from .motors import PEAK_OVER_RMS, Reach, motor_levers, motor_reach, plate_mass
from .rig import (
    SECTIONS,
    Camera,
    CameraTrigger,
    Friction,
    Limits,
    Motor,
    PartFacts,
    Plate,
    Rig,
    default_rig_path,
    load_rig,
    rig_names,
    rig_path,
)
from .suspension import Suspension, mass_matrix, modal_matrices

__all__ = [
    "CYCLE_HZ",
    "LEAST_GAMMA",
    "PART_PX",
    "PEAK_OVER_RMS",
    "SECTIONS",
    "Camera",
    "CameraTrigger",
    "Doubt",
    "Fiducials",
    "Friction",
    "Lens",
    "Limits",
    "Motor",
    "PartFacts",
    "Plate",
    "Reach",
    "Rig",
    "Suspension",
    "camera_pose",
    "default_rig_path",
    "doubts",
    "fit_homography",
    "home_pose",
    "homography",
    "load_rig",
    "mass_matrix",
    "modal_matrices",
    "motor_levers",
    "motor_reach",
    "part_radius_px",
    "plate_mass",
    "project",
    "rig_names",
    "rig_path",
    "row_delay",
    "surface_velocity",
    "to_home",
    "to_image",
    "to_plate",
]
