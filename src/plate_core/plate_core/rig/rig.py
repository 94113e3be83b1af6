"""Measured facts of one rig, read from a YAML file and checked."""

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

LEAST_RADII, WALL_RADII = 0.5, 1.25
"""How much further than the motors' stroke from the plate's edges the centre of a part is to be led
at least, and the wall that parts keep behind wherever they can [part radii]."""


@dataclass(frozen=True)
class Plate:
    """The plate: its sides along x and y at rest [m] and its mass [kg]."""

    length_m: float = measured("length_m", 0.05, 10, "Side of the plate along x.")
    width_m: float = measured("width_m", 0.05, 10, "Side of the plate along y.")
    mass_kg: float = measured(
        "mass_kg", 0.001, 1000, "Mass of the plate with all that moves with it."
    )

    @property
    def half(self) -> np.ndarray:
        """Half sides (2,) [m]."""
        return np.array([self.length_m / 2, self.width_m / 2])

    @property
    def inertia_kgm2(self) -> float:
        """Moment of inertia about its centre, if it is uniform [kg m2]."""
        return self.mass_kg * (self.length_m**2 + self.width_m**2) / 12

    @property
    def corners(self) -> np.ndarray:
        """Corners at rest (4, 2) [m, plate_home]: (-x,-y), (+x,-y), (+x,+y), (-x,+y)."""
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.half


@dataclass(frozen=True)
class Friction:
    """Coulomb friction between parts and plate: coefficient [-] and gravity [m/s2]."""

    mu: float = measured("mu", 0.01, 2, "Coefficient of dynamic friction.")
    gravity: float = measured("gravity_mps2", 0.1, 30, "Gravity.")

    @property
    def accel(self) -> float:
        """Greatest acceleration that friction gives a part, mu g [m/s2]."""
        return self.mu * self.gravity


@dataclass(frozen=True)
class PartFacts:
    """The parts that are of no type of `types`: round, all alike; mass [kg], radius [m] and height
    above the plate [m], 0 if they are flat or their height is unknown."""

    mass_kg: float = measured("mass_kg", 1e-6, 10, "Mass of a part.")
    radius_m: float = measured("radius_m", 1e-4, 1, "Radius of a part.")
    height_m: float = measured(
        "height_m", 0, MAX_HEIGHT_M, "Height of a part above the plate; 0: flat, or unknown.", 0.0
    )


@dataclass(frozen=True)
class Limits:
    """What the rig can do: stroke [m] to either side and speed [m/s] of each motor,
    acceleration [m/s2] of any point of the plate, force [N] of each motor and its heat.

    Attributes
    ----------
    stroke_m, speed, accel : float
    force : float
        Peak force of a motor [N].
    continuous_force : float
        Root mean square [N] that a motor bears continuously.
    thermal_time_s : float
        Time constant of a winding's heat [s].
    heat_rise_k : float
        Winding over ambient at the continuous force [K].
    following_error_m : float
        Distance of a motor from its setpoint that is a fault [m]; 0: not watched.
    """

    stroke_m: float = measured(
        "stroke_m", 1e-5, 1, "How far each motor can go from home, to either side."
    )
    speed: float = measured("speed_mps", 1e-3, 100, "Greatest speed of each motor.")
    accel: float = measured(
        "accel_mps2",
        0.1,
        1e4,
        "Greatest acceleration of any point of the plate; less where motors lack the force.",
    )
    force: float = measured(
        "force_n", 1e-3, 1e6, "Greatest force of each motor, for a moment.", 200.0
    )
    continuous_force: float = measured(
        "continuous_force_n",
        1e-3,
        1e6,
        "Root mean square force that each motor bears continuously; half of `force_n` where only "
        "that is given.",
        100.0,
    )
    thermal_time_s: float = measured(
        "thermal_time_s", 0.1, 1e5, "Time constant of the heat of a motor's winding.", 60.0
    )
    heat_rise_k: float = measured(
        "heat_rise_k",
        0.1,
        1e3,
        "How much warmer than the air a winding is at the continuous force.",
        80.0,
    )
    following_error_m: float = measured(
        "following_error_m",
        0,
        1,
        "Distance of a motor from its setpoint that is a fault; 0: not watched.",
        0.0,
    )


@dataclass(frozen=True)
class Drive:
    """A motor's drive on a CAN bus.

    Attributes
    ----------
    node : int
        1 to 126; of an ODrive to 62.
    counts_per_m : float
        Counts of its position for a metre; of an ODrive, `ODRIVE_COUNTS` of keys.py in a turn.
    sign : int
        -1 where it counts against the motor's direction, else 1.
    absolute : bool
        Whether its position is 0 at home; if not, home is where the plate hangs.
    serial : int
        Object 1018h:04; 0: any.
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
    """A linear motor: name, point where its shaft meets the plate at rest (x, y) [m, plate_home],
    unit direction in which it pushes; and its drive, unless a bridge of the board drives it."""

    name: str
    point: tuple[float, float]
    direction: tuple[float, float]
    drive: Drive | None = None


@dataclass(frozen=True)
class CameraTrigger:
    """The line by which the motor controller triggers the camera: at which fraction of each cycle,
    and for how long it is high [s]."""

    phase: float
    pulse_s: float = 0.002


@dataclass(frozen=True)
class Camera:
    """The camera: image size [px], exposure [s], image points of the plate's corners at rest
    (4 pairs, order of `Plate.corners`) [px] as they are seen; its lens, if that is calibrated; and
    by how much its last row is exposed later than its first [s]; what triggers it, if that is the
    motor controller; whether it sees colours; and the height of its lens above the plate [m], if
    the rig file gives it: `camera_place` needs it where the lens is not calibrated."""

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
    """How far from the plate's edges the centre of a part is to be [m].

    Nearer than `least_m` it is lost: the plate moves away under it by the motors' stroke, or a
    part of it is off the plate. Behind the wall, `wall_m` from the edges, it is safe.
    """

    least_m: float
    wall_m: float


@dataclass(frozen=True)
class Rig:
    """All facts of one rig; without a suspension the plate is rigid and does as commanded, without
    fiducials the camera sees only the plate's edges, without types parts are round and alike."""

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
        """Return a type of part with its mass and friction; one that is not in `types` is round, as
        `parts` says."""
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
        """Return how far from the plate's edges the centre of a part of this type is to be [m]."""
        stroke, reach = self.limits.stroke_m, self.part_type(name).reach_m
        return EdgeMargin(max(stroke + LEAST_RADII * reach, reach), stroke + WALL_RADII * reach)

    @cached_property
    def _part_types(self) -> dict[str, PartType]:
        return {}

    @cached_property
    def reach(self) -> Reach:
        """What acceleration any point of the plate can have in any direction continuously, and
        what limits it: the rig file, or the motors."""
        return reach(self)

    @cached_property
    def motor_loads(self) -> np.ndarray:
        """The motors' forces for pose, twist and acceleration of the plate (3, 4, 3) [N/...]."""
        return motor_loads(self)

    @property
    def gamma(self) -> float:
        """Shaking ratio a_max/(mu g) [-], the number that rules the problem: a_max is `reach`."""
        return self.reach.accel / self.friction.accel

    @property
    def force_unit(self) -> float:
        """Sliding friction of one part, mu m g [N]: the unit of the solvers' forces."""
        return self.parts.mass_kg * self.friction.accel


def default_rig_path() -> Path:
    """Return the rig file to use when none is named.

    That is the one named by the environment variable PLATE_RIG, or else config/rig.yaml.
    """
    if "PLATE_RIG" in os.environ:
        return Path(os.environ["PLATE_RIG"])
    return config_path("rig.yaml")


def rig_names() -> tuple[str, ...]:
    """Return the names of the rigs in config/rigs."""
    return tuple(sorted(path.stem for path in config_path("rigs").glob("*.yaml")))


def rig_path(name_or_path: str | Path | None = None) -> Path:
    """Return the file of a rig that is named, or the default one: as `load_rig`.

    Raises
    ------
    RigError
        If it is neither a file nor the name of one: the message lists those there are.
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
        YAML file, or the name of one in config/rigs, such as desk; `default_rig_path()` if None or
        empty.

    Returns
    -------
    Rig

    Raises
    ------
    RigError
        If a key is missing, unknown, or its value is out of range, or facts contradict each other:
        the message names the key, the value and what is allowed.
    """
    file = rig_path(path)
    rig = read_rig(file)
    try:
        check(rig)
    except RigError as error:
        raise RigError(f"{file.name}: {error}") from None
    return rig


def read_rig(path: Path) -> Rig:
    """Read a rig file as `load_rig`, but do not hold its facts against each other."""
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
    """Return the part types that stand in a rig file, or in a file beside it."""
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
    Section("parts", "Parts of no type in `types`: round, all alike.", keys_of(PartFacts)),
    Section("limits", "What the motors and the plate can do.", keys_of(Limits)),
    keys.MOTOR,
    keys.CAMERA,
    keys.FIDUCIALS,
    keys.SUSPENSION,
    PART_TYPE,
)
"""All of a rig file, in the order of the reference."""
