"""Measured facts of one rig: plate, friction, motors, limits, suspension, camera, lens, fiducials.

Also its frames: room (`plate_home`), moving plate, image. A rig file is read by `load_rig`.
"""

from .fiducials import Fiducials
from .frames import (
    camera_pose,
    fit_homography,
    homography,
    project,
    surface_velocity,
    to_home,
    to_image,
    to_plate,
)
from .lens import Lens
from .rig import (
    Camera,
    Friction,
    Limits,
    Motor,
    PartFacts,
    Plate,
    Rig,
    default_rig_path,
    load_rig,
)
from .suspension import Suspension, mass_matrix, modal_matrices

__all__ = [
    "Camera",
    "Fiducials",
    "Friction",
    "Lens",
    "Limits",
    "Motor",
    "PartFacts",
    "Plate",
    "Rig",
    "Suspension",
    "camera_pose",
    "default_rig_path",
    "fit_homography",
    "homography",
    "load_rig",
    "mass_matrix",
    "modal_matrices",
    "project",
    "surface_velocity",
    "to_home",
    "to_image",
    "to_plate",
]
