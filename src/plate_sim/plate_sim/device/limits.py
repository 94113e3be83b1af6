"""What the device's motors may do, and what they need for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np

from plate_core import Rig, load_rig
from plate_core.rig import Drive, motor_levers, plate_mass


@dataclass(frozen=True)
class DeviceLimits:
    """Limits of each motor; single precision on the wire and in the firmware.

    Attributes
    ----------
    stroke_m, speed, accel : float
        [m], [m/s], [m/s2].
    force, continuous_force : float
        Peak, and continuous root mean square [N].
    heat_s : float
        Time constant of the winding's heat [s].
    load : (4, 4)
        Forces that the motors need for accelerations of all of them [kg].
    following_m : float
        Following error that is a fault [m]; 0: not watched.
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
        """Return the limits for a rig's plate, the forces of its flexures left out.

        Forces f = B^+ M c'' of least norm push the plate with B; c'' = (B^T)^+ q'' follows from the
        motors' accelerations at home, so the load is B^+ M (B^T)^+. M is the suspension's, with the
        inertia and the centre of mass that it tells, or else that of a uniform plate.
        """
        inverse = np.linalg.pinv(motor_levers(rig).T)
        # Rounded, so that no rounding error of the inverse decides about a limit.
        load = np.round(inverse @ plate_mass(rig) @ inverse.T, 9)
        limits = rig.limits
        return cls(
            limits.stroke_m, limits.speed, limits.accel, limits.force, limits.continuous_force,
            limits.thermal_time_s, load, limits.following_error_m,
        )  # fmt: skip

    @cached_property
    def fit(self) -> np.ndarray:
        """The combination (4,) of travels that is 0 for a rigid plate, 1 at most; float32.

        It is the load's null vector: four travels follow from three coordinates.
        """
        fit = np.linalg.eigh(self.load)[1][:, 0]
        return (fit / np.max(np.abs(fit))).astype(np.float32)


def rig_header(path: str) -> str:
    """Return the C header of a rig file.

    Raises
    ------
    PlateError
        If the file is wrong.
    """
    rig = load_rig(path)
    drives = [motor.drive for motor in rig.motors if motor.drive is not None]
    return c_header(DeviceLimits.of_rig(rig), Path(path).name, drives)


def c_header(limits: DeviceLimits, name: str, drives: Sequence[Drive] = ()) -> str:
    """Return the C header that firmware is built with: `LIMITS`, in single precision, and, where
    motors have drives, `DRIVES`.

    Parameters
    ----------
    limits : DeviceLimits
    name : str
        Of the rig file, for those who read the header.
    drives : sequence of Drive
        Of all motors, or none.
    """
    values = [(field.name, getattr(limits, field.name)) for field in fields(limits)]
    lines = [f"    .{key} = {_literal(np.asarray(value, np.float32))}," for key, value in values]
    return "\n".join([
        f"/* Of {name}, by `python -m plate_sim.device.limits_header`: change that, not this. */",
        "static const Limits LIMITS = {",
        *lines,
        "};",
        *(_drives(drives, limits) if drives else []),
        "",
    ])  # fmt: skip


def _drives(drives: Sequence[Drive], limits: DeviceLimits) -> list[str]:
    """Return C for drives, and of what kind they are."""
    head = ["#define HAS_DRIVES", f"#define HAS_{drives[0].kind.upper()}"]
    made = map(_drive, drives, limits.fit)
    return [*head, "static const Drive DRIVES[MOTORS] = {", *made, "};"]


def _drive(drive: Drive, fit: float) -> str:
    """Return C for a drive."""
    scale = _literal(np.asarray(drive.counts_per_m, np.float32))
    absolute = str(drive.absolute).lower()
    values = (drive.node, scale, drive.sign, absolute, f"{drive.serial}u", f"{fit!s}f")
    return f"    {{{', '.join(map(str, values))}}},"


def _literal(value: np.ndarray) -> str:
    """Return C for an array or a number; the shortest decimals that give the same float."""
    if value.ndim == 0:
        return f"{value[()]!s}f"
    inner = [_literal(part) for part in value]
    if value.ndim == 1:
        return "{" + ", ".join(inner) + "}"
    return "{\n" + "".join(f"        {part},\n" for part in inner) + "    }"
