"""Measured facts of one rig, read from a YAML file and checked."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import RigError
from ..yaml_fields import Fields, config_path, measured, read_yaml
from .fiducials import Fiducials, read_fiducials
from .lens import Lens
from .suspension import Suspension, read_suspension


@dataclass(frozen=True)
class Plate:
    """The plate: its sides along x and y at rest [m] and its mass [kg]."""

    length_m: float = measured("length_m", 0.01, 10)
    width_m: float = measured("width_m", 0.01, 10)
    mass_kg: float = measured("mass_kg", 0.001, 1000)

    @property
    def half(self) -> np.ndarray:
        """Half sides (2,) [m]."""
        return np.array([self.length_m / 2, self.width_m / 2])

    @property
    def corners(self) -> np.ndarray:
        """Corners at rest (4, 2) [m, plate_home]: (-x,-y), (+x,-y), (+x,+y), (-x,+y)."""
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.half


@dataclass(frozen=True)
class Friction:
    """Coulomb friction between parts and plate: coefficient [-] and gravity [m/s2]."""

    mu: float = measured("mu", 0.01, 2)
    gravity: float = measured("gravity_mps2", 0.1, 30)

    @property
    def accel(self) -> float:
        """Greatest acceleration that friction gives a part, mu g [m/s2]."""
        return self.mu * self.gravity


@dataclass(frozen=True)
class PartFacts:
    """The parts: round, all alike; mass [kg] and radius [m]."""

    mass_kg: float = measured("mass_kg", 1e-6, 10)
    radius_m: float = measured("radius_m", 1e-4, 1)


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
        Root mean square [N] that a motor bears for ever.
    thermal_time_s : float
        Time constant of a winding's heat [s].
    heat_rise_k : float
        Winding over ambient at the continuous force [K].
    following_error_m : float
        Distance between where a motor is and where it was told to be that is a fault [m]; 0: not
        watched.
    """

    stroke_m: float = measured("stroke_m", 1e-5, 1)
    speed: float = measured("speed_mps", 1e-3, 100)
    accel: float = measured("accel_mps2", 0.1, 1e4)
    force: float = measured("force_n", 1e-3, 1e6, 200.0)
    continuous_force: float = measured("continuous_force_n", 1e-3, 1e6, 100.0)
    thermal_time_s: float = measured("thermal_time_s", 0.1, 1e5, 60.0)
    heat_rise_k: float = measured("heat_rise_k", 0.1, 1e3, 80.0)
    following_error_m: float = measured("following_error_m", 0, 1, 0.0)


@dataclass(frozen=True)
class Motor:
    """A linear motor: name, point where its shaft meets the plate at rest (x, y) [m, plate_home],
    unit direction in which it pushes."""

    name: str
    point: tuple[float, float]
    direction: tuple[float, float]


@dataclass(frozen=True)
class Camera:
    """The camera: image size [px], exposure [s], image points of the plate's corners at rest
    (4 pairs, order of `Plate.corners`) [px] as they are seen; its lens, if that is calibrated."""

    width_px: int
    height_px: int
    exposure_s: float
    corners_px: tuple[tuple[float, float], ...]
    lens: Lens | None = None


@dataclass(frozen=True)
class Rig:
    """All facts of one rig; without a suspension the plate is rigid and does as commanded, without
    fiducials the camera sees only the plate's edges."""

    plate: Plate
    friction: Friction
    parts: PartFacts
    limits: Limits
    motors: tuple[Motor, ...]
    camera: Camera
    suspension: Suspension | None = None
    fiducials: Fiducials | None = None

    @property
    def gamma(self) -> float:
        """Shaking ratio a_max/(mu g) [-]: the number that rules the problem."""
        return self.limits.accel / self.friction.accel

    @property
    def force_unit(self) -> float:
        """Sliding friction of one part, mu m g [N]: the unit of the solvers' forces."""
        return self.parts.mass_kg * self.friction.accel


def default_rig_path() -> Path:
    """Return the rig file to use when none is named.

    That is, in order: the file named by the environment variable PLATE_RIG, the one installed
    with plate_core, the one of the source tree.
    """
    if "PLATE_RIG" in os.environ:
        return Path(os.environ["PLATE_RIG"])
    return config_path("rig.yaml")


def load_rig(path: str | Path | None = None) -> Rig:
    """Read a rig file.

    Parameters
    ----------
    path : path, optional
        YAML file; `default_rig_path()` if None or empty.

    Returns
    -------
    Rig

    Raises
    ------
    RigError
        If a key is missing, unknown, or its value is out of range: the message names the key, the
        value and what is allowed.
    """
    fields = read_yaml(path or default_rig_path(), RigError)
    plate = fields.child("plate").read(Plate)
    rig = Rig(
        plate=plate,
        friction=fields.child("friction").read(Friction),
        parts=fields.child("parts").read(PartFacts),
        limits=fields.child("limits").read(Limits),
        motors=_motors(fields.child("motors")),
        camera=_camera(fields.child("camera")),
        suspension=_suspension(fields, plate),
        fiducials=read_fiducials(fields.child("fiducials")) if fields.has("fiducials") else None,
    )
    fields.finish()
    if rig.gamma <= 1:
        raise RigError(
            f"limits: accel_mps2 is {rig.limits.accel:g}, allowed: more than mu g = "
            f"{rig.friction.accel:g} m/s2 (below that parts never slide)"
        )
    return rig


def _suspension(fields: Fields, plate: Plate) -> Suspension | None:
    if not fields.has("suspension"):
        return None
    sides = (plate.length_m, plate.width_m)
    return read_suspension(fields.child("suspension"), plate.mass_kg, sides)


def _motors(fields: Fields) -> tuple[Motor, ...]:
    names = fields.keys()
    expected = ("motor_1", "motor_2", "motor_3", "motor_4")
    if names != expected:
        raise RigError(f"motors: got {', '.join(names)}, allowed: {', '.join(expected)}")
    motors = []
    for name in names:
        child = fields.child(name)
        point = child.array("point_m", (2,), -10, 10)
        direction = child.array("direction", (2,), -1, 1)
        length = float(np.hypot(*direction))
        if length < 1e-6:
            raise child.fail("direction", "a vector that is not zero")
        child.finish()
        motors.append(
            Motor(name, (point[0], point[1]), (direction[0] / length, direction[1] / length))
        )
    rows = [
        (m.direction[0], m.direction[1], m.point[0] * m.direction[1] - m.point[1] * m.direction[0])
        for m in motors
    ]
    if np.linalg.matrix_rank(np.array(rows), tol=1e-3) < 3:
        raise RigError(
            "motors: their directions and points cannot move the plate in x, y and theta"
        )
    return tuple(motors)


def _camera(fields: Fields) -> Camera:
    width = fields.integer("width_px", 16, 16384)
    height = fields.integer("height_px", 16, 16384)
    corners = fields.array("corners_px", (4, 2), -16384, 32768)
    x, y = corners.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    if abs(area) < 100:
        raise fields.fail("corners_px", "four corners that span at least 100 square pixels")
    camera = Camera(
        width_px=width,
        height_px=height,
        exposure_s=fields.number("exposure_s", 0, 0.1),
        corners_px=tuple((float(a), float(b)) for a, b in corners),
        lens=_lens(fields, width, height),
    )
    fields.finish()
    return camera


def _lens(fields: Fields, width: int, height: int) -> Lens | None:
    if not any(fields.has(key) for key in ("focal_px", "centre_px", "distortion")):
        return None
    fx, fy = fields.array("focal_px", (2,), 1, 1e6)
    cx, cy = fields.array("centre_px", (2,), -1e6, 1e6)
    distortion = [0.0] * 5
    if fields.has("distortion"):
        distortion = fields.array("distortion", (5,), -100, 100).tolist()
    k1, k2, p1, p2, k3 = distortion
    lens = Lens((float(fx), float(fy)), (float(cx), float(cy)), (k1, k2, p1, p2, k3))
    across, down = np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 33)
    image = np.stack(np.meshgrid(across, down), axis=-1)
    if not np.all(np.isfinite(lens.straighten(image))):
        raise fields.fail("distortion", "one that does not fold the image")
    return lens
