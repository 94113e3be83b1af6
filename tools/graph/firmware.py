"""The firmware for drives, built for this computer."""

from __future__ import annotations

import subprocess
from pathlib import Path

from plate_core import PlateError, load_rig
from plate_core.rig import rig_path
from plate_sim.device import rig_header

FOLDER = Path(__file__).resolve().parents[2] / "firmware"
SOURCES = ("*.c", "drives/axes.c", "host/host.c", "host/can.c")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")


def build(rig_file: str, kind: str, folder: Path) -> Path:
    """Compile the firmware with a rig's limits and drives; returns the program.

    `kind` is cia402 or odrive.

    Raises
    ------
    PlateError
        If the rig's motors have no drives of that kind, or it cannot be compiled.
    """
    path = rig_path(rig_file)
    has = {motor.drive.kind if motor.drive else "bridge" for motor in load_rig(path).motors}
    if has != {kind}:
        raise PlateError(f"rig {path.name}: its motors have {', '.join(has)}, allowed: {kind}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "limits_rig.h").write_text(rig_header(str(path)), encoding="utf-8")
    program = folder / "plate"
    sources = sorted(
        str(source) for pattern in (*SOURCES, f"drives/{kind}.c") for source in FOLDER.glob(pattern)
    )
    command = ["cc", *FLAGS, f"-I{folder}", "-o", str(program), *sources, "-lm"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except OSError as error:
        raise PlateError(f"the firmware cannot be compiled: cc: {error.strerror}") from None
    if done.returncode:
        raise PlateError(f"the firmware cannot be compiled: {done.stderr.strip()}")
    return program
