"""Compilation of the firmware for CAN drives as a program that runs on this computer."""

from __future__ import annotations

from pathlib import Path

from plate_core import PlateError, load_rig
from plate_core.rig import rig_path
from plate_drives import socketcan
from plate_sim.device import rig_header


def build(rig_file: str, kind: str, folder: Path) -> Path:
    """Compile the firmware with a rig's limits and drives, and return the program.

    `kind` is cia402 or odrive.

    Raises
    ------
    PlateError
        If not all motors of the rig have drives of this kind, or the compilation fails.
    """
    path = rig_path(rig_file)
    has = {motor.drive.kind if motor.drive else "bridge" for motor in load_rig(path).motors}
    if has != {kind}:
        raise PlateError(f"rig {path.name}: its motors have {', '.join(has)}, allowed: {kind}")
    return socketcan.build(rig_header(str(path)), kind, folder, "host/host.c", "host/can.c")
