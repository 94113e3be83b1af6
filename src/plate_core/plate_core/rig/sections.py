"""Sections of a rig file as data classes: plate, friction, parts without a type, limits, motors and
camera. Lengths are in metres and positions in plate_home."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..yaml_fields import measured
from .lens import Lens
from .part_types import MAX_HEIGHT_M


@dataclass(frozen=True)
class Plate:
    """The plate: side lengths along x and y at rest [m], and mass [kg]."""

    length_m: float = measured("length_m", 0.05, 10, "Side length of the plate along x.")
    width_m: float = measured("width_m", 0.05, 10, "Side length of the plate along y.")
    mass_kg: float = measured(
        "mass_kg", 0.001, 1000, "Mass of the plate and of everything that moves with it."
    )

    @property
    def half(self) -> np.ndarray:
        """Half sides (2,) [m]."""
        return np.array([self.length_m / 2, self.width_m / 2])

    @property
    def inertia_kgm2(self) -> float:
        """Moment of inertia of a uniform plate about its centre [kg m2]."""
        return self.mass_kg * (self.length_m**2 + self.width_m**2) / 12

    @property
    def corners(self) -> np.ndarray:
        """Corners at rest (4, 2) [m, plate_home]: (-x,-y), (+x,-y), (+x,+y), (-x,+y)."""
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.half


@dataclass(frozen=True)
class Friction:
    """Coulomb friction between parts and plate: coefficient [-] and gravity [m/s2]."""

    mu: float = measured("mu", 0.01, 2, "Dynamic friction coefficient between parts and plate.")
    gravity: float = measured("gravity_mps2", 0.1, 30, "Gravitational acceleration.")

    @property
    def accel(self) -> float:
        """Maximum acceleration of a part by friction, mu g [m/s2]."""
        return self.mu * self.gravity


@dataclass(frozen=True)
class PartFacts:
    """Data of the parts that have no type in `types`. All these parts are identical discs with this
    mass [kg], radius [m] and height above the plate [m]. The height is 0 if the discs are flat, or
    if the height is unknown."""

    mass_kg: float = measured("mass_kg", 1e-6, 10, "Mass of a round part.")
    radius_m: float = measured("radius_m", 1e-4, 1, "Radius of a round part.")
    height_m: float = measured(
        "height_m",
        0,
        MAX_HEIGHT_M,
        "Height of a round part above the plate. 0 if the part is flat or the height is unknown.",
        0.0,
    )


@dataclass(frozen=True)
class Limits:
    """Limits of the rig.

    Attributes
    ----------
    stroke_m : float
        Maximum travel of each motor from home, to either side [m].
    speed : float
        Maximum speed of each motor [m/s].
    accel : float
        Maximum acceleration of any point of the plate [m/s2].
    force : float
        Peak force of a motor [N].
    continuous_force : float
        Root mean square force that a motor can supply continuously [N].
    thermal_time_s : float
        Thermal time constant of a motor's winding [s].
    heat_rise_k : float
        Temperature rise of the winding above ambient at the continuous force [K].
    following_error_m : float
        Maximum following error of a motor [m]. A larger error is a fault. 0 disables the check.
    """

    stroke_m: float = measured(
        "stroke_m", 1e-5, 1, "Maximum travel of each motor from its home position, to either side."
    )
    speed: float = measured("speed_mps", 1e-3, 100, "Maximum speed of each motor.")
    accel: float = measured(
        "accel_mps2",
        0.1,
        1e4,
        "Maximum acceleration of any point of the plate. Motor forces can limit it further.",
    )
    force: float = measured("force_n", 1e-3, 1e6, "Peak force of each motor.", 200.0)
    continuous_force: float = measured(
        "continuous_force_n",
        1e-3,
        1e6,
        "Maximum RMS force that each motor supplies continuously. If the file contains only "
        "`force_n`, the default is half of it.",
        100.0,
    )
    thermal_time_s: float = measured(
        "thermal_time_s", 0.1, 1e5, "Thermal time constant of a motor's winding.", 60.0
    )
    heat_rise_k: float = measured(
        "heat_rise_k",
        0.1,
        1e3,
        "Temperature rise of a motor's winding above ambient at the continuous force.",
        80.0,
    )
    following_error_m: float = measured(
        "following_error_m",
        0,
        1,
        "Maximum distance of a motor from its setpoint. A larger distance is a fault. 0 disables "
        "the check.",
        0.0,
    )


@dataclass(frozen=True)
class Drive:
    """A motor's drive on a CAN bus.

    Attributes
    ----------
    node : int
        Node number, 1 to 126, for an ODrive 1 to 62.
    counts_per_m : float
        Position counts per metre. One turn of an ODrive has `ODRIVE_COUNTS` (keys.py) counts.
    sign : int
        -1 if the counts decrease in the motor's direction, otherwise 1.
    absolute : bool
        Whether the drive's position is 0 at home. If False, home is the position in which the plate
        hangs freely at the first enable.
    serial : int
        Serial number, object 1018h:04. 0 accepts any serial number.
    kind : str
        cia402 or odrive.
    """

    node: int
    counts_per_m: float
    sign: int = 1
    absolute: bool = False
    serial: int = 0
    kind: str = "cia402"


@dataclass(frozen=True)
class Motor:
    """A linear motor: its name, the point (x, y) at which its shaft meets the plate at rest [m,
    plate_home], the unit vector of its force, and its drive. The drive is None if a bridge of the
    board drives the motor."""

    name: str
    point: tuple[float, float]
    direction: tuple[float, float]
    drive: Drive | None = None


@dataclass(frozen=True)
class CameraTrigger:
    """Trigger of the camera by the motor controller: the phase as a fraction of each cycle, and the
    pulse length [s]."""

    phase: float
    pulse_s: float = 0.002


@dataclass(frozen=True)
class Camera:
    """The camera.

    Attributes
    ----------
    width_px, height_px : int
        Image size [px].
    exposure_s : float
        Exposure time [s].
    corners_px : 4 pairs of float
        Image points of the plate's corners at rest, with lens distortion, in the order of
        `Plate.corners` [px].
    lens : Lens or None
        None if the lens is not calibrated.
    readout_s : float
        Delay between the exposures of the first and the last row [s].
    trigger : CameraTrigger or None
        None if the motor controller does not trigger the camera.
    colour : bool
        Whether the images have colours.
    height_m : float or None
        Height of the lens above the plate [m]. None if the rig file does not give it.
        `camera_position` needs the height if the lens is not calibrated.
    """

    width_px: int
    height_px: int
    exposure_s: float
    corners_px: tuple[tuple[float, float], ...]
    lens: Lens | None = None
    readout_s: float = 0.0
    trigger: CameraTrigger | None = None
    colour: bool = False
    height_m: float | None = None
