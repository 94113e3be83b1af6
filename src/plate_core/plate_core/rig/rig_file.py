"""Reading of rig files: selection of the file, definition of its keys, and conversion to a `Rig`.

`load_rig` reads a file and checks whether its values are consistent. `SECTIONS` defines its keys.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import RigError, did_you_mean
from ..yaml_fields import Fields, Section, config_path, keys_of, read_yaml, required
from . import keys
from .consistency import check
from .fiducials import read_fiducials
from .lens import Lens
from .part_types import PART_TYPE, PartType, load_part_types, read_part_types
from .rig import Rig
from .sections import (
    Camera,
    CameraTrigger,
    Drive,
    Friction,
    Limits,
    Motor,
    PartFacts,
    Plate,
)
from .suspension import Suspension, read_suspension


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
        limits=_read_limits(fields.child("limits")),
        motors=_read_motors(fields.child("motors")),
        camera=_read_camera(fields.child("camera")),
        suspension=_read_suspension(fields, plate),
        fiducials=read_fiducials(fields.child("fiducials")) if fields.has("fiducials") else None,
        types=_read_types(fields, path.parent),
    )
    fields.finish()
    return rig


def _read_types(fields: Fields, folder: Path) -> Mapping[str, PartType]:
    """Return the part types in a rig file, or in the file that its key `types` names."""
    if not fields.has("types"):
        return {}
    if fields.holds_mapping("types"):
        return read_part_types(fields.child("types"))
    return load_part_types(folder / fields.text("types"))


def _read_limits(fields: Fields) -> Limits:
    limits = fields.read(Limits)
    if fields.has("force_n") and not fields.has("continuous_force_n"):
        return replace(limits, continuous_force=limits.force / 2)
    return limits


def _read_suspension(fields: Fields, plate: Plate) -> Suspension | None:
    if not fields.has("suspension"):
        return None
    return read_suspension(fields.child("suspension"), plate.mass_kg, plate.inertia_kgm2)


def _read_motors(fields: Fields) -> tuple[Motor, ...]:
    names = fields.keys()
    expected = ("motor_1", "motor_2", "motor_3", "motor_4")
    if names != expected:
        raise RigError(
            f"{fields.where}: keys are {', '.join(names)}, allowed: {', '.join(expected)} in this "
            "order"
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
        motors.append(Motor(name, (point[0], point[1]), unit, _read_drive(child)))
        child.finish()
    return tuple(motors)


def _read_drive(fields: Fields) -> Drive | None:
    kind = fields.value(keys.MOTOR["drive"])
    if kind == "bridge":
        for key in ("node", "counts_per_m", "turns_per_m", "sign", "home", "serial"):
            if fields.has(key):
                raise fields.fail(key, "this key only with drive: cia402 or odrive")
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


def _read_camera(fields: Fields) -> Camera:
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
        lens=_read_lens(fields, corners),
        trigger=_read_trigger(fields),
        colour=fields.value(keys.CAMERA["colour"]),
        height_m=fields.value(keys.CAMERA["height_m"]),
    )
    fields.finish()
    return camera


def _read_trigger(fields: Fields) -> CameraTrigger | None:
    if not any(fields.has(key) for key in ("trigger_phase", "trigger_pulse_s")):
        return None
    phase = fields.value(required(keys.CAMERA["trigger_phase"]))
    return CameraTrigger(phase, fields.value(keys.CAMERA["trigger_pulse_s"]))


def _read_lens(fields: Fields, corners: np.ndarray) -> Lens | None:
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
    Section("plate", "Size and mass of the plate.", keys_of(Plate)),
    Section("friction", "Coulomb friction between parts and plate.", keys_of(Friction)),
    Section("parts", "Properties of round parts that have no type in `types`.", keys_of(PartFacts)),
    Section("limits", "Limits of the motors and the plate.", keys_of(Limits)),
    keys.MOTOR,
    keys.CAMERA,
    keys.FIDUCIALS,
    keys.SUSPENSION,
    PART_TYPE,
)
"""All sections of a rig file, in the order of docs/reference.md."""
