"""Definitions of the keys of a rig file, except the plain numbers of `rig.py`: type, range and
meaning (docs/reference.md)."""

from __future__ import annotations

from ..yaml_fields import Choice, Flag, Key, Number, Numbers, Section, Sign, Table, Whole
from .lens import MODELS

FAR_M = 10.0
"""Maximum magnitude of a coordinate [m]."""

ODRIVE_COUNTS = 2**20
"""Number of counts that this project uses for one turn of an ODrive, whose unit is turns."""

STIFFEST = 1e9
"""Maximum entry of a stiffness or damping matrix [N/m, N s/m, ...]. A larger one means rigid."""

MOTOR = Section(
    "motors, motor_1 to motor_4",
    "A linear motor: where its shaft meets the plate, and the way it pushes.",
    (
        Key(
            "point_m", Numbers((2,), -FAR_M, FAR_M), "Where the shaft meets the plate at rest "
            "[x, y].",
        ),
        Key(
            "direction", Numbers((2,), -1, 1), "The way it pushes when its setpoint is positive "
            "[x, y]; of any length but 0.",
        ),
        Key(
            "drive", Choice(("bridge", "cia402", "odrive")), "A bridge of the board, a "
            "drive of CiA 402 on CANopen, or an ODrive on CAN; the same for all four.", "bridge",
        ),
        Key(
            "node", Whole(1, 126), "Number of its drive on the bus; up to 62 for an ODrive.",
            None, "needed with a drive",
        ),
        Key(
            "counts_per_m", Number(1e3, 1e9), "Counts of a cia402 drive's position (6064h).", None,
            "needed with it",
        ),
        Key(
            "turns_per_m", Number(0.1, 1e4), "Turns of an ODrive's position, with a linear motor "
            "pairs of poles.", None, "needed with it",
        ),
        Key(
            "sign", Sign(), "-1 where the drive counts against `direction`, else 1.", 1,
        ),
        Key(
            "home", Choice(("here", "absolute")), "here: home is where the plate hangs at the "
            "first enable. absolute: the drive's position is 0 at home.", "here",
        ),
        Key(
            "serial", Whole(1, 2**32 - 1), "Of a cia402 drive (object 1018h:04), which is then "
            "looked at.", None, "any",
        ),
    ),
)  # fmt: skip

CAMERA = Section(
    "camera",
    "The camera: its images, where the plate is in them, and its lens.",
    (
        Key("width_px", Whole(16, 16384), "Width of an image."),
        Key("height_px", Whole(16, 16384), "Height of an image."),
        Key("exposure_s", Number(0, 0.1), "Exposure time."),
        Key(
            "readout_s", Number(0, 0.1), "Rolling shutter: the last row is exposed this much later "
            "than the first.", 0.0,
        ),
        Key("colour", Flag(), "Whether it sees colours.", False),
        Key(
            "height_m", Number(0.01, 100), "Height of the lens above the plate. Parts with a "
            "height need it if `focal_px` is missing.", None, "not known",
        ),
        Key(
            "trigger_phase", Number(0, 0.999), "The motor controller triggers the camera at this "
            "fraction of each cycle.", None, "the camera runs free",
        ),
        Key(
            "trigger_pulse_s", Number(0.001, 0.008), "Length of its pulse, in whole ms.", 0.002,
        ),
        Key(
            "corners_px", Numbers((4, 2), -16384, 32768), "Images of the plate's corners at rest, "
            "as seen: (-x,-y), (+x,-y), (+x,+y), (-x,+y).",
        ),
        Key(
            "focal_px", Numbers((2,), 1, 1e6), "Focal lengths fx, fy of the lens: of K in "
            "camera_info.", None, "a lens that does not bend lines",
        ),
        Key(
            "centre_px", Numbers((2,), -1e6, 1e6), "Principal point cx, cy: of K in camera_info.",
            None, "needed with `focal_px`",
        ),
        Key(
            "distortion", Numbers((None,), -1e6, 1e6), "D in camera_info. plumb_bob: k1, k2, p1, "
            "p2[, k3]; rational_polynomial: k1, k2, p1, p2, k3[, k4, k5, k6[, s1, s2, s3, s4[, "
            "tau_x, tau_y]]]; equidistant: k1, k2, k3, k4.", None, "zeros",
        ),
        Key(
            "distortion_model", Choice(tuple(MODELS)), "distortion_model in camera_info.",
            "plumb_bob",
        ),
    ),
)  # fmt: skip

DICTIONARIES = (
    *(f"{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "ARUCO_ORIGINAL", "APRILTAG_16H5", "APRILTAG_25H9", "APRILTAG_36H10", "APRILTAG_36H11",
    "ARUCO_MIP_36H12",
)  # fmt: skip
"""Sets of markers, with OpenCV's names without DICT_. Older OpenCV versions lack the last one."""

FIDUCIALS = Section(
    "fiducials (may be left out)",
    "Markers on the plate: the camera finds plate_home by them; `corners_px` may then be a guess.",
    (
        Key("dictionary", Choice(DICTIONARIES), "Set of ArUco markers, by OpenCV's name."),
        Key("side_m", Number(0.001, 1), "Side of a marker's black square."),
        Key(
            "centre_m", Table("for each of 4 to 16 markers [x, y], as marker_0: [0.1, 0.1]"),
            "Centres of the markers on the plate, their upper sides towards +y.",
        ),
    ),
)  # fmt: skip

SUSPENSION = Section(
    "suspension (may be left out: the plate is rigid and does as commanded)",
    "How the plate hangs, and how its motors push.",
    (
        Key(
            "frequency_hz", Numbers((3,), 0, 1e3), "Natural frequencies of x, y and theta, each "
            "with the others held.", None, "or `stiffness`",
        ),
        Key("damping_ratio", Numbers((3,), 0, 2), "And their damping.", None, "or `damping`"),
        Key(
            "stiffness", Numbers((3, 3), -STIFFEST, STIFFEST), "Stiffness matrix of x, y "
            "and theta [N/m, N, N m/rad].", None, "or `frequency_hz`",
        ),
        Key(
            "damping", Numbers((3, 3), -STIFFEST, STIFFEST), "Damping matrix [N s/m, N s, "
            "N m s/rad].", None, "or `damping_ratio`",
        ),
        Key(
            "inertia_kgm2", Number(1e-9, 1e6), "Of the plate about its centre of mass.",
            None, "that of a uniform plate",
        ),
        Key(
            "centre_of_mass_m", Numbers((2,), -FAR_M, FAR_M), "At rest [x, y].", (0.0, 0.0),
        ),
        Key("feedforward", Table("mass, damping and stiffness, each from 0 to 2"), "Shares of "
            "these forces that the drive supplies in advance."),
        Key(
            "motor_gain", Numbers((4,), 0.1, 3), "Force of each motor over the force asked of it.",
            (1.0, 1.0, 1.0, 1.0),
        ),
        Key(
            "motor_bandwidth_hz", Number(1, 1e4), "Corner of the motors' first-order lag.",
            float("inf"), "no lag",
        ),
        Key(
            "servo", Table("stiffness_npm from 0 to 1e7, damping_nspm from 0 to 1e5"), "Stiffness "
            "[N/m] and damping [N s/m] with which each motor holds its own setpoint.",
            None, "none",
        ),
    ),
)  # fmt: skip
