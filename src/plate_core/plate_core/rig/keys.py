"""Definitions of the keys of a rig file, except keys that are simple numbers.

Each key has a type, a range and a meaning. The readers check values by these definitions, and
docs/reference.md is generated from them.
"""

from __future__ import annotations

from ..yaml_fields import Choice, Flag, Key, Number, Numbers, Section, Sign, Table, Whole
from .lens import MODELS

MAX_XY = 10.0
"""Maximum magnitude of a coordinate [m]."""

ODRIVE_COUNTS = 2**20
"""Number of counts that this project uses for one turn of an ODrive. An ODrive itself measures its
position in turns."""

STIFFEST = 1e9
"""Maximum entry of a stiffness or damping matrix [N/m, N s/m, ...]. A flexure with a larger value
is practically rigid."""

MOTOR = Section(
    "motors, motor_1 to motor_4",
    "Properties of one linear motor.",
    (
        Key(
            "point_m", Numbers((2,), -MAX_XY, MAX_XY), "Point at which the motor's shaft "
            "meets the plate at rest.",
        ),
        Key(
            "direction", Numbers((2,), -1, 1), "Direction [x, y] of the motor's force at a "
            "positive setpoint. The length of this vector has no effect, but must not be 0.",
        ),
        Key(
            "drive", Choice(("bridge", "cia402", "odrive")), "Type of the amplifier: an H-bridge "
            "on the motor controller's board, a CiA 402 drive on CANopen, or an ODrive on CAN. It "
            "must be the same for all motors.", "bridge",
        ),
        Key(
            "node", Whole(1, 126), "Node number of the drive on the bus. The maximum for an ODrive "
            "is 62.",
            None, "required except with `drive: bridge`",
        ),
        Key(
            "counts_per_m", Number(1e3, 1e9), "Number of counts of the drive's position (object "
            "6064h) per metre of travel.", None,
            "required with `drive: cia402`",
        ),
        Key(
            "turns_per_m", Number(0.1, 1e4), "Number of turns of the drive per metre of "
            "travel. For a linear motor: number of pole pairs per metre.", None,
            "required with `drive: odrive`",
        ),
        Key(
            "sign", Sign(), "-1 if the drive's position decreases along `direction`, otherwise 1.",
            1,
        ),
        Key(
            "home", Choice(("here", "absolute")), "Home position of the motor. here: the "
            "position at the first enable. absolute: position 0 of the drive.", "here",
        ),
        Key(
            "serial", Whole(1, 2**32 - 1), "Serial number of a CiA 402 drive (object "
            "1018h:04). If the key is given, a drive with another number is refused.", None,
            "any number",
        ),
    ),
)  # fmt: skip

CAMERA = Section(
    "camera",
    "The camera: its images, its lens, and the position of the plate in the images.",
    (
        Key("width_px", Whole(16, 16384), "Width of the camera's images."),
        Key("height_px", Whole(16, 16384), "Height of the camera's images."),
        Key("exposure_s", Number(0, 0.1), "Exposure time of each image."),
        Key(
            "readout_s", Number(0, 0.1), "Delay between the exposures of the first and the last "
            "row (rolling shutter).", 0.0,
        ),
        Key("colour", Flag(), "Whether the camera's images have colour.", False),
        Key(
            "height_m", Number(0.01, 100), "Height of the lens above the plate. It corrects the "
            "positions of parts with a height.", None, "computed from `focal_px` or `corners_px`",
        ),
        Key(
            "trigger_phase", Number(0, 0.999), "Fraction of each cycle at which the motor "
            "controller triggers the camera.", None, "no trigger; the camera is free-running",
        ),
        Key(
            "trigger_pulse_s", Number(0.001, 0.008), "Length of the trigger pulse, a multiple of "
            "1 ms.", 0.002,
        ),
        Key(
            "corners_px", Numbers((4, 2), -16384, 32768), "Pixel coordinates of the corners "
            "(-x,-y), (+x,-y), (+x,+y), (-x,+y) of the plate at rest, in images whose lens "
            "distortion is not removed.",
        ),
        Key(
            "focal_px", Numbers((2,), 10, 1e6), "Focal lengths fx, fy: entries of the matrix K in "
            "`camera_info`.", None, "a lens without distortion",
        ),
        Key(
            "centre_px", Numbers((2,), -1e6, 1e6), "Principal point cx, cy: entries of the matrix "
            "K in `camera_info`.", None, "required with `focal_px`",
        ),
        Key(
            "distortion", Numbers((None,), -1e6, 1e6), "Distortion coefficients: the array D in "
            "`camera_info`, in OpenCV's order k1, k2, p1, p2, k3, ... (equidistant: k1 to k4).",
            None, "zeros",
        ),
        Key(
            "distortion_model", Choice(tuple(MODELS)), "Name of the distortion model, "
            "as in `camera_info`.", "plumb_bob",
        ),
    ),
)  # fmt: skip

DICTIONARIES = (
    *(f"{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "ARUCO_ORIGINAL", "APRILTAG_16H5", "APRILTAG_25H9", "APRILTAG_36H10", "APRILTAG_36H11",
    "ARUCO_MIP_36H12",
)  # fmt: skip
"""Sets of markers: OpenCV's names without DICT_. Older versions of OpenCV lack the last set."""

FIDUCIALS = Section(
    "fiducials (optional)",
    "Markers on the plate. If they are given, the detector computes the frame `plate_home` from "
    "their positions in the image. Then a rough value of `corners_px` is enough.",
    (
        Key("dictionary", Choice(DICTIONARIES), "OpenCV's name of a set of ArUco markers."),
        Key("side_m", Number(0.001, 1), "Side length of a marker's black square."),
        Key(
            "centre_m", Table("for each of 4 to 16 markers [x, y], as marker_0: [0.1, 0.1]"),
            "Centres of the markers on the plate. The upper sides of the markers point towards +y.",
        ),
    ),
)  # fmt: skip

SUSPENSION = Section(
    "suspension (optional)",
    "Dynamics of the flexures that suspend the plate, and of the motors. Without this section, the "
    "plate moves exactly as commanded.",
    (
        Key(
            "frequency_hz", Numbers((3,), 0, 1e3), "Natural frequencies of the plate in x, y "
            "and theta. For each of them, the other two coordinates are fixed.", None,
            "or `stiffness`",
        ),
        Key(
            "damping_ratio", Numbers((3,), 0, 2), "Damping ratios of the oscillations in x, y "
            "and theta.", None,
            "or `damping`",
        ),
        Key(
            "stiffness", Numbers((3, 3), -STIFFEST, STIFFEST), "Stiffness matrix of the "
            "flexures for x, y and theta [N/m, N, N m/rad].", None, "or `frequency_hz`",
        ),
        Key(
            "damping", Numbers((3, 3), -STIFFEST, STIFFEST), "Damping matrix of the "
            "flexures for x, y and theta [N s/m, N s, N m s/rad].", None, "or `damping_ratio`",
        ),
        Key(
            "inertia_kgm2", Number(1e-9, 1e6), "Moment of inertia of the plate about its "
            "centre of mass.",
            None, "the value of a uniform plate",
        ),
        Key(
            "centre_of_mass_m", Numbers((2,), -MAX_XY, MAX_XY), "Position of the plate's "
            "centre of mass at rest.", (0.0, 0.0),
        ),
        Key("feedforward", Table("mass, damping and stiffness, each from 0 to 2"), "Fractions "
            "of the inertial, damping and spring forces that the drives supply as feed-forward."),
        Key(
            "motor_gain", Numbers((4,), 0.1, 3), "Actual force of each motor divided by the "
            "commanded force.",
            (1.0, 1.0, 1.0, 1.0),
        ),
        Key(
            "motor_bandwidth_hz", Number(1, 1e4), "Corner frequency of the first-order lag with "
            "which the motors' forces follow the commands.", float("inf"), "no lag",
        ),
        Key(
            "servo", Table("stiffness_npm from 0 to 1e7, damping_nspm from 0 to 1e5"), "Stiffness "
            "[N/m] and damping [N s/m] of each motor's position servo.",
            None, "no position servo",
        ),
    ),
)  # fmt: skip
