"""Report a rig's capabilities, limits and inconsistencies: `ros2 run plate_core check_rig`.

`python -m plate_core.rig.check_rig FILE` is the same command for computers without ROS.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..ending import piped
from ..errors import PlateError
from .consistency import RigWarning, rig_warnings
from .frames import camera_position
from .keys import ODRIVE_COUNTS
from .motors import PEAK_OVER_RMS
from .rig import Rig
from .rig_file import read_rig, rig_names, rig_path

EXAMPLE_M = 0.005
"""Height of the example part for the reported parallax [m]. Nuts and low caps, for example, have
about this height."""

FREQUENCIES_HZ = (5.0, 10.0, 20.0, 40.0)
"""Frequencies in the table of the report [Hz]. These frequencies cover the range of the solvers'
cycles, `consistency.CYCLE_HZ`."""


class Shake(NamedTuple):
    """The largest allowed sinusoidal motion of the plate: amplitude [m], speed [m/s] and
    acceleration [m/s2] of its fastest point, and the limit that it reaches."""

    travel: float
    speed: float
    accel: float
    limit: str


@piped()
def main() -> None:
    """Run the command line. Exit code 0: consistent, 1: inconsistent, 2: wrong arguments or
    files."""
    parser = argparse.ArgumentParser(
        prog="check_rig", description="Report what a rig can do and check its file."
    )
    parser.add_argument(
        "rig", nargs="?", default="",
        help=f"rig file, or one of {', '.join(rig_names())} (default: the default rig)",
    )  # fmt: skip
    parser.add_argument(
        "--drawing", type=Path, metavar="FILE",
        help="file for a drawing of the rig, .svg or .png (default: NAME_rig.svg or "
        "default_rig.svg in the current folder)",
    )  # fmt: skip
    args = parser.parse_args()
    try:
        path = rig_path(args.rig)
        rig = read_rig(path)
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    found = rig_warnings(rig)
    # Print the report before the drawing is made, because the drawing takes longer.
    print(rig_report(rig, path.name, found), flush=True)
    drawing = args.drawing or Path(f"{path.stem if args.rig else 'default'}_rig.svg")
    try:
        from .drawing import draw  # `draw` is imported here, because matplotlib may be missing

        drawing.parent.mkdir(parents=True, exist_ok=True)
        draw(rig, path.name, drawing)
    except ImportError as error:
        print(f"no drawing: {error}", file=sys.stderr)
    except (OSError, ValueError) as error:
        print(f"error: the drawing cannot be written: {error}", file=sys.stderr)
        sys.exit(2)
    else:
        print(f"drawing: {drawing}")
    sys.exit(1 if any(warning.impossible for warning in found) else 0)


def rig_report(rig: Rig, name: str, warnings: list[RigWarning]) -> str:
    """Return the whole report as lines for a terminal."""
    plate, parts, limits = rig.plate, rig.parts, rig.limits
    lines = [
        f"{name}: plate of {plate.length_m:g} x {plate.width_m:g} m and {plate.mass_kg:g} kg, "
        f"parts of {1e3 * parts.radius_m:g} mm radius and {1e3 * parts.mass_kg:g} g",
        f"shaking ratio Gamma = {rig.gamma:.1f}: the plate can accelerate by "
        f"{rig.reach.accel:.3g} m/s2 in every direction continuously, limited by "
        f"{rig.reach.limit}; parts slide above mu g = {rig.friction.accel:.3g} m/s2",
        f"motors: peak force {limits.force:g} N, continuous force {limits.continuous_force:g} N "
        f"(root mean square; the peaks in a task are {PEAK_OVER_RMS:g} times as large), stroke "
        f"{1e3 * limits.stroke_m:g} mm to either side, speed {limits.speed:g} m/s",
        *_drive_lines(rig),
        *_camera_lines(rig),
        "",
        "short sinusoidal shaking            travel [mm]  speed [m/s]  accel. [m/s2]  limited by",
    ]
    for axis, description in (("x", "along x"), ("y", "along y"), ("theta", "theta, at a corner")):
        for hz in FREQUENCIES_HZ:
            sinusoid = max_sinusoid(rig, axis, hz)
            lines.append(
                f"  {description:20} {hz:4g} Hz  {1e3 * sinusoid.travel:12.3g} "
                f"{sinusoid.speed:12.3g} {sinusoid.accel:14.3g}  {sinusoid.limit}"
            )
    lines.append("")
    for warning in warnings:
        lines.append(f"{'WRONG' if warning.impossible else 'warning'}: {warning.text}")
    if not warnings:
        lines.append("no inconsistencies")
    return "\n".join(lines)


def _drive_lines(rig: Rig) -> Iterator[str]:
    """Yield one line per motor with a drive: the number of its counts or turns for 1 mm along its
    direction."""
    for motor in rig.motors:
        if drive := motor.drive:
            odrive = drive.kind == "odrive"
            scale = 1e-3 * drive.sign * drive.counts_per_m / (ODRIVE_COUNTS if odrive else 1)
            yield (
                f"{motor.name}: {drive.kind}, node {drive.node}: 1 mm along its direction is "
                f"{scale:+g} {'turns' if odrive else 'counts'}"
            )


def _camera_lines(rig: Rig) -> Iterator[str]:
    """Yield lines on the camera's position, and on the parallax of parts without a height in the
    rig file."""
    flat = ", ".join(name for name, part in rig.types.items() if part.height_m == 0)
    if not rig.types and rig.parts.height_m == 0:
        flat = "parts"
    position = camera_position(rig)
    if position is None:
        yield (
            "camera: its position is unknown, because the section camera has neither focal_px nor "
            "height_m, and corners_px have too little perspective. Therefore a part of height h "
            "appears too far from the point below the lens, by r h/(H - h). r is its distance from "
            "this point, and H is the height of the lens above the plate"
        )
        return
    x, y, height = position
    yield f"camera: the lens is {height:.3g} m above the point [{x:.3f}, {y:.3f}] of the plate"
    if flat and height > EXAMPLE_M:
        far = float(np.max(np.hypot(*(rig.plate.corners - position[:2]).T)))
        yield (
            f"camera: height_m is 0 (flat or unknown) for {flat}. If one of them is "
            f"{1e3 * EXAMPLE_M:g} mm high, its measured position is wrong by up to "
            f"{1e3 * far * EXAMPLE_M / (height - EXAMPLE_M):.2g} mm (in the corner that is "
            f"{1e3 * far:.0f} mm from the point below the lens)"
        )


def max_sinusoid(rig: Rig, axis: str, hz: float) -> Shake:
    """Return the largest sinusoidal motion in one coordinate that exceeds no limit except possibly
    the thermal limit.

    The thermal limit depends on the whole motion and is part of `Rig.reach`.
    """
    omega, limits = 2 * np.pi * hz, rig.limits
    pose = np.array([axis == "x", axis == "y", axis == "theta"], dtype=float)
    # For theta, the amplitude is converted to a length by the distance of a corner from the centre
    # [m].
    radius = float(np.hypot(*rig.plate.half)) if axis == "theta" else 1.0
    travel = float(np.max(np.abs(rig.motor_levers @ pose)))
    if travel < 1e-9:
        return Shake(0.0, 0.0, 0.0, "no motor in this direction")
    stiffness, damping, mass = rig.motor_loads
    force = (stiffness - omega**2 * mass + 1j * omega * damping) @ pose
    worst = int(np.argmax(np.abs(force)))
    push, name = float(np.abs(force[worst])), rig.motors[worst].name
    push = max(push, 1e-12)
    sizes = {
        "stroke_m": limits.stroke_m / travel,
        "speed_mps": limits.speed / (omega * travel),
        "accel_mps2": limits.accel / (omega**2 * radius),
        f"force_n of {name}": limits.force / push,
    }
    limit = min(sizes, key=lambda key: sizes[key])
    size = float(sizes[limit]) * radius
    return Shake(size, omega * size, omega**2 * size, limit)


if __name__ == "__main__":
    main()
