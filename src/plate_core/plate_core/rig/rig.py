"""Measured data of one rig, read from a YAML file and checked.

`load_rig` returns a `Rig` with plate, friction, parts, limits, motors and camera. Lengths are in
metres and positions in plate_home.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import RigError, did_you_mean
from ..yaml_fields import Fields, Section, config_path, keys_of, measured, read_yaml, required
from . import keys
from .consistency import check
from .fiducials import Fiducials, read_fiducials
from .lens import Lens
from .motors import Reach, motor_loads, reach
from .part_types import MAX_HEIGHT_M, PART_TYPE, PartType, load_part_types, read_part_types
from .suspension import Suspension, read_suspension

MIN_RADII, WALL_RADII = 0.5, 1.25
"""Distances from the plate's edges, in addition to the motors' stroke [part radii]. The first is
the minimum for the centre of a part, the second is that of the wall, behind which parts stay if
possible. See `EdgeMargin`."""


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

    mu: float = measured("mu", 0.01, 2, "Coefficient of dynamic friction.")
    gravity: float = measured("gravity_mps2", 0.1, 30, "Gravitational acceleration.")

    @property
    def accel(self) -> float:
        """Maximum acceleration of a part by friction, mu g [m/s2]."""
        return self.mu * self.gravity


@dataclass(frozen=True)
class PartFacts:
    """Data of the parts without a type in `types`: identical discs with this mass [kg], radius [m]
    and height above the plate [m]. The height is 0 if the discs are flat, or if it is unknown."""

    mass_kg: float = measured("mass_kg", 1e-6, 10, "Mass of a part.")
    radius_m: float = measured("radius_m", 1e-4, 1, "Radius of a part.")
    height_m: float = measured(
        "height_m", 0, MAX_HEIGHT_M, "Height of a part above the plate; 0: flat or unknown.", 0.0
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
        "stroke_m", 1e-5, 1, "Stroke of each motor from home to either side."
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
        "Maximum continuous RMS force of each motor; half of `force_n` if only `force_n` is given.",
        100.0,
    )
    thermal_time_s: float = measured(
        "thermal_time_s", 0.1, 1e5, "Thermal time constant of a motor's winding.", 60.0
    )
    heat_rise_k: float = measured(
        "heat_rise_k",
        0.1,
        1e3,
        "Temperature rise of a winding above ambient at the continuous force.",
        80.0,
    )
    following_error_m: float = measured(
        "following_error_m",
        0,
        1,
        "Maximum distance of a motor from its setpoint; 0: not checked.",
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
        -1 if the counts decrease in the motor's direction, else 1.
    absolute : bool
        Whether the drive's position is 0 at home. If false, home is the position in which the plate
        hangs freely at the first enable.
    serial : int
        Serial number, object 1018h:04. 0: any.
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
    """A linear motor: its name, the point (x, y) where its shaft meets the plate at rest [m,
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
        Height of the lens above the plate [m]. It is None if the rig file does not give it.
        `camera_place` needs it if the lens is not calibrated.
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


class EdgeMargin(NamedTuple):
    """Required distance of a part's centre from the plate's edges [m].

    Below `least_m`, the part is lost, because the plate can move away under it by the motors'
    stroke, or because the part overhangs the edge. The wall is at the distance `wall_m` from the
    edges. A part behind the wall is safe.
    """

    least_m: float
    wall_m: float


@dataclass(frozen=True)
class Rig:
    """All data of one rig.

    Without a suspension, the plate is rigid and follows its commands exactly. Without fiducials,
    the camera finds the plate only by its edges. Without types, all parts are identical discs.
    """

    plate: Plate
    friction: Friction
    parts: PartFacts
    limits: Limits
    motors: tuple[Motor, ...]
    camera: Camera
    suspension: Suspension | None = None
    fiducials: Fiducials | None = None
    types: Mapping[str, PartType] = field(default_factory=dict, hash=False)

    def part_type(self, name: str) -> PartType:
        """Return a part type, with the rig's default mass and friction if the type has none. An
        unknown type is a disc with the data of `parts`."""
        if name not in self._part_types:
            known = self.types.get(name) or PartType(
                name, radius_m=self.parts.radius_m, symmetry=0, height_m=self.parts.height_m
            )
            self._part_types[name] = replace(
                known,
                mass_kg=self.parts.mass_kg if known.mass_kg is None else known.mass_kg,
                mu=self.friction.mu if known.mu is None else known.mu,
            )
        return self._part_types[name]

    def edge_margin(self, name: str) -> EdgeMargin:
        """Return the required distance of the centre of a part of this type from the plate's edges
        [m]."""
        stroke, reach = self.limits.stroke_m, self.part_type(name).reach_m
        return EdgeMargin(max(stroke + MIN_RADII * reach, reach), stroke + WALL_RADII * reach)

    @cached_property
    def _part_types(self) -> dict[str, PartType]:
        return {}

    @cached_property
    def reach(self) -> Reach:
        """Maximum continuous acceleration of any point of the plate in any direction [m/s2], and
        the key of the limit that determines it."""
        return reach(self)

    @cached_property
    def motor_loads(self) -> np.ndarray:
        """Matrices (3, 4, 3) from pose, twist and acceleration of the plate to motor forces [N]."""
        return motor_loads(self)

    @property
    def gamma(self) -> float:
        """Shaking ratio a_max/(mu g) [-], with a_max from `reach`. It determines how well the plate
        can move parts."""
        return self.reach.accel / self.friction.accel

    @property
    def force_unit(self) -> float:
        """Sliding friction force of one part, mu m g [N]. The solvers use it as the unit of
        force."""
        return self.parts.mass_kg * self.friction.accel


def default_rig_path() -> Path:
    """Return the default rig file: the value of the environment variable PLATE_RIG if it is set,
    otherwise config/rig.yaml."""
    if "PLATE_RIG" in os.environ:
        return Path(os.environ["PLATE_RIG"])
    return config_path("rig.yaml")


def rig_names() -> tuple[str, ...]:
    """Return the names of the rigs in config/rigs."""
    return tuple(sorted(path.stem for path in config_path("rigs").glob("*.yaml")))


def rig_path(name_or_path: str | Path | None = None) -> Path:
    """Return the rig file for an argument of `load_rig`.

    Raises
    ------
    RigError
        If the argument is neither a file nor the name of a rig. The message lists the names.
    """
    text = str(name_or_path or "")
    if not text:
        return default_rig_path()
    if os.path.isfile(text) or text.endswith((".yaml", ".yml")):
        return Path(text)
    names = rig_names()
    if text not in names:
        raise RigError(
            f"rig is {text!r}{did_you_mean(text, names)}, allowed: {', '.join(names)}, or the path "
            "of a .yaml file"
        )
    return config_path("rigs") / f"{text}.yaml"


def load_rig(path: str | Path | None = None) -> Rig:
    """Read a rig file.

    Parameters
    ----------
    path : path, optional
        YAML file, or the name of a file in config/rigs, such as desk. None or empty:
        `default_rig_path()`.

    Returns
    -------
    Rig

    Raises
    ------
    RigError
        If a key is missing or unknown, a value is out of range, or values are inconsistent. The
        message states the key, the value and the allowed values.
    """
    file = rig_path(path)
    rig = read_rig(file)
    try:
        check(rig)
    except RigError as error:
        raise RigError(f"{file.name}: {error}") from None
    return rig


def read_rig(path: Path) -> Rig:
    """Read a rig file like `load_rig`, but do not check whether its values are consistent."""
    fields = read_yaml(path, RigError)
    plate = fields.child("plate").read(Plate)
    rig = Rig(
        plate=plate,
        friction=fields.child("friction").read(Friction),
        parts=fields.child("parts").read(PartFacts),
        limits=_limits(fields.child("limits")),
        motors=_motors(fields.child("motors")),
        camera=_camera(fields.child("camera")),
        suspension=_suspension(fields, plate),
        fiducials=read_fiducials(fields.child("fiducials")) if fields.has("fiducials") else None,
        types=_types(fields, path.parent),
    )
    fields.finish()
    return rig


def _types(fields: Fields, folder: Path) -> Mapping[str, PartType]:
    """Return the part types in a rig file, or in the file that its key `types` names."""
    if not fields.has("types"):
        return {}
    if fields.holds_mapping("types"):
        return read_part_types(fields.child("types"))
    return load_part_types(folder / fields.text("types"))


def _limits(fields: Fields) -> Limits:
    limits = fields.read(Limits)
    if fields.has("force_n") and not fields.has("continuous_force_n"):
        return replace(limits, continuous_force=limits.force / 2)
    return limits


def _suspension(fields: Fields, plate: Plate) -> Suspension | None:
    if not fields.has("suspension"):
        return None
    return read_suspension(fields.child("suspension"), plate.mass_kg, plate.inertia_kgm2)


def _motors(fields: Fields) -> tuple[Motor, ...]:
    names = fields.keys()
    expected = ("motor_1", "motor_2", "motor_3", "motor_4")
    if names != expected:
        raise RigError(
            f"{fields.where}: got {', '.join(names)}, allowed: {', '.join(expected)}, in this order"
        )
    motors = []
    for name in names:
        child = fields.child(name)
        point = child.value(keys.MOTOR["point_m"])
        direction = child.value(keys.MOTOR["direction"])
        length = float(np.hypot(*direction))
        if length < 1e-6:
            raise child.fail("direction", "a vector that is not zero")
        unit = (direction[0] / length, direction[1] / length)
        motors.append(Motor(name, (point[0], point[1]), unit, _drive(child)))
        child.finish()
    return tuple(motors)


def _drive(fields: Fields) -> Drive | None:
    kind = fields.value(keys.MOTOR["drive"])
    if kind == "bridge":
        for key in ("node", "counts_per_m", "turns_per_m", "sign", "home", "serial"):
            if fields.has(key):
                raise fields.fail(key, "only with drive: cia402 or odrive")
        return None
    odrive = kind == "odrive"
    scale = fields.value(required(keys.MOTOR["turns_per_m" if odrive else "counts_per_m"]))
    return Drive(
        fields.value(required(keys.MOTOR["node"])),
        scale * keys.ODRIVE_COUNTS if odrive else scale,
        fields.value(keys.MOTOR["sign"]),
        fields.value(keys.MOTOR["home"]) == "absolute",
        0 if odrive else fields.value(keys.MOTOR["serial"]) or 0,
        kind,
    )


def _camera(fields: Fields) -> Camera:
    width = fields.value(keys.CAMERA["width_px"])
    height = fields.value(keys.CAMERA["height_px"])
    corners = fields.value(keys.CAMERA["corners_px"])
    x, y = corners.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    if abs(area) < 100:
        raise fields.fail("corners_px", "four corners that span at least 100 square pixels")
    camera = Camera(
        width_px=width,
        height_px=height,
        exposure_s=fields.value(keys.CAMERA["exposure_s"]),
        readout_s=fields.value(keys.CAMERA["readout_s"]),
        corners_px=tuple((float(a), float(b)) for a, b in corners),
        lens=_lens(fields, corners),
        trigger=_trigger(fields),
        colour=fields.value(keys.CAMERA["colour"]),
        height_m=fields.value(keys.CAMERA["height_m"]),
    )
    fields.finish()
    return camera


def _trigger(fields: Fields) -> CameraTrigger | None:
    if not any(fields.has(key) for key in ("trigger_phase", "trigger_pulse_s")):
        return None
    phase = fields.value(required(keys.CAMERA["trigger_phase"]))
    return CameraTrigger(phase, fields.value(keys.CAMERA["trigger_pulse_s"]))


def _lens(fields: Fields, corners: np.ndarray) -> Lens | None:
    names = ("focal_px", "centre_px", "distortion", "distortion_model")
    if not any(fields.has(key) for key in names):
        return None
    fx, fy = fields.value(required(keys.CAMERA["focal_px"]))
    cx, cy = fields.value(required(keys.CAMERA["centre_px"]))
    distortion = fields.value(keys.CAMERA["distortion"])
    values = () if distortion is None else tuple(distortion.tolist())
    key = keys.CAMERA["distortion_model"]
    model = fields.text(key.name) if fields.has(key.name) else key.default
    try:
        lens = Lens((float(fx), float(fy)), (float(cx), float(cy)), values, model)
    except RigError as error:
        raise RigError(f"{fields.where}: {error}") from None
    if folded := lens.folds(corners):
        raise RigError(f"{fields.where}: {folded}")
    return lens


SECTIONS = (
    Section("plate", "The plate.", keys_of(Plate)),
    Section("friction", "Coulomb friction between parts and plate.", keys_of(Friction)),
    Section("parts", "Round parts that have no type in `types`.", keys_of(PartFacts)),
    Section("limits", "Limits of the motors and the plate.", keys_of(Limits)),
    keys.MOTOR,
    keys.CAMERA,
    keys.FIDUCIALS,
    keys.SUSPENSION,
    PART_TYPE,
)
"""All sections of a rig file, in the order of the reference."""
