"""Computes the limits of the device's motors from a rig, and writes them to a C header for the
firmware.

`DeviceLimits` contains the limits of stroke, speed, acceleration and force. The class also contains
a matrix that maps the motors' accelerations to their forces. The emulator and a real board use the
same values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np

from plate_core import Rig, load_rig
from plate_core.rig import Drive


@dataclass(frozen=True)
class DeviceLimits:
    """Limits of the motors. The limits have single precision, as in the protocol and the firmware.

    Attributes
    ----------
    stroke_m, speed, accel : float
        Limits of stroke [m], speed [m/s] and acceleration [m/s2].
    force, continuous_force : float
        Peak force, and continuous (root mean square) force [N].
    heat_s : float
        Thermal time constant of the winding [s].
    load : (4, 4)
        Matrix that maps the motors' accelerations to their forces [kg].
    following_m : float
        Following error above which a fault is raised [m]. 0 disables the check.
    """

    stroke_m: float
    speed: float
    accel: float
    force: float
    continuous_force: float
    heat_s: float
    load: np.ndarray
    following_m: float = 0.0

    @classmethod
    def of_rig(cls, rig: Rig) -> DeviceLimits:
        """Return the limits of a rig. The load matrix does not include the forces of the flexures.

        Let M be the inertia matrix of the plate, c'' its acceleration, and B the matrix that maps
        the motor forces f to the wrench on the plate. The forces of minimum norm with B f = M c''
        are f = B^+ M c''. At home, the plate's acceleration follows from the accelerations q'' of
        the motors by c'' = (B^T)^+ q''. Therefore, the load matrix is B^+ M (B^T)^+. M contains the
        inertia and the centre of mass of the suspension. If there is no suspension, the plate is
        assumed to be uniform.
        """
        inverse = np.linalg.pinv(rig.motor_levers.T)
        # The values are rounded to nine decimals. Without this rounding, errors of `inverse` could
        # decide whether a motion exactly at a limit is allowed.
        load = np.round(inverse @ rig.plate_mass @ inverse.T, 9)
        limits = rig.limits
        return cls(
            limits.stroke_m, limits.speed, limits.accel, limits.force, limits.continuous_force,
            limits.thermal_time_s, load, limits.following_error_m,
        )  # fmt: skip

    @cached_property
    def rigid_weights(self) -> np.ndarray:
        """Coefficients (4,) of a weighted sum of the travels of the four motors. If the plate is
        rigid, the sum is 0. The type of the coefficients is float32, and their maximum magnitude is
        1.

        The coefficients are a null vector of `load`. A null vector exists because the four travels
        depend on only three coordinates of the plate.
        """
        weight = np.linalg.eigh(self.load)[1][:, 0]
        return (weight / np.max(np.abs(weight))).astype(np.float32)


def rig_header(path: str) -> str:
    """Return the C header with the limits of a rig file.

    Raises
    ------
    PlateError
        If the file is invalid.
    """
    rig = load_rig(path)
    drives = [motor.drive for motor in rig.motors if motor.drive is not None]
    return c_header(DeviceLimits.of_rig(rig), Path(path).name, drives)


def c_header(limits: DeviceLimits, name: str, drives: Sequence[Drive] = ()) -> str:
    """Return a C header for the firmware. The header defines `LIMITS` in single precision, and
    `DRIVES` if the motors have drives.

    Parameters
    ----------
    limits : DeviceLimits
    name : str
        Name of the rig file, for a comment in the header.
    drives : sequence of Drive
        Drives of all motors. Empty if the motors have no drives.
    """
    values = [(field.name, getattr(limits, field.name)) for field in fields(limits)]
    lines = [
        f"    .{key} = {_literal_code(np.asarray(value, np.float32))}," for key, value in values
    ]
    return "\n".join([
        f"/* Generated from {name} by `python -m plate_sim.device.limits_header`; do not edit. */",
        "static const Limits LIMITS = {",
        *lines,
        "};",
        *(_drives_code(drives, limits) if drives else []),
        "",
    ])  # fmt: skip


def _drives_code(drives: Sequence[Drive], limits: DeviceLimits) -> list[str]:
    """Return the C code that defines the drives and their kind."""
    head = ["#define HAS_DRIVES", f"#define HAS_{drives[0].kind.upper()}"]
    made = map(_drive_code, drives, limits.rigid_weights)
    return [*head, "static const Drive DRIVES[MOTORS] = {", *made, "};"]


def _drive_code(drive: Drive, weight: float) -> str:
    """Return the C code of one drive."""
    scale = _literal_code(np.asarray(drive.counts_per_m, np.float32))
    absolute = str(drive.absolute).lower()
    values = (drive.node, scale, drive.sign, absolute, f"{drive.serial}u", f"{weight!s}f")
    return f"    {{{', '.join(map(str, values))}}},"


def _literal_code(value: np.ndarray) -> str:
    """Return C code for an array or a number. The code contains the shortest decimal numbers that
    give the same values of the type float."""
    if value.ndim == 0:
        return f"{value[()]!s}f"
    inner = [_literal_code(part) for part in value]
    if value.ndim == 1:
        return "{" + ", ".join(inner) + "}"
    return "{\n" + "".join(f"        {part},\n" for part in inner) + "    }"
