"""Consistency checks of a rig's data: errors for impossible values, warnings for unlikely ones.

The checks find wrong decimal points and values copied from another rig. Examples of such mistakes
are a motor beside the plate, image corners of a plate with another shape, and parts that are one
pixel wide.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..errors import RigError
from .frames import camera_position, fit_homography, part_radius_px
from .keys import ODRIVE_COUNTS
from .rig import Rig
from .sections import Drive

PART_PX = (3.0, 200.0)
"""Range of part radii in the image that the detector can detect [px]."""

FINE_PX = 4.0
"""Radius in the image above which detection is reliable [px]."""

MIN_GAMMA = 5.0
"""Shaking ratio below which tasks take long or fail [-]. docs/hardware.md has measured values."""

CYCLE_HZ = (5.0, 40.0)
"""Lowest and highest frequency in the solvers' cycles [Hz]. The lowest frequency has one period in
a cycle of 0.2 s. The highest frequency has four periods in a cycle of 0.1 s."""

MIN_FOLLOWING_M = 1e-5
"""Minimum value of the limit `following_error_m` [m]. No drive is more accurate, so every motor
would exceed a smaller limit."""

COARSEST_M = 1e-5
"""Distance per position count of a drive above which a warning is given [m]."""

MAX_COUNTS = 2**24
"""Maximum number of counts per stroke. Single precision cannot represent more counts exactly."""

ODRIVE_NODES = 62
"""Maximum node number of an ODrive. The number 63 marks an ODrive without an assigned number."""
ODRIVE_SPEED = 32.767
"""Maximum speed of the feedforward of an ODrive [turns/s]."""

OUTSIDE, BESIDE = 0.5, 0.1
"""Maximum distance of a motor's point from the plate (on a bracket), and the distance above which a
warning is given. Both distances are fractions of the plate's longer side."""

WORST_FIT, GOOD_FIT = 0.15, 0.03
"""Maximum misfit of the image corners, and the misfit above which a warning is given. The misfit is
the relative error of the side lengths, or the cosine of the angle between the sides if this is
larger."""

FOCAL_LENGTHS = np.geomspace(0.4, 20, 80)
"""Focal lengths that are tried if the lens is not calibrated [image widths]."""

STEEP_DEG = 45.0
"""Tilt of the camera above which a warning is given [degrees]. With a larger tilt, distant parts
are detected poorly."""

HEIGHT_ERROR = 0.1
"""Relative difference between two camera heights above which a warning is given: `camera:
height_m`, and the height computed from the lens and the corners."""

PART_FRACTION = (0.5, 0.15)
"""Maximum radius of a part, and the radius above which a warning is given. Both radii are fractions
of half the plate's shorter side. Larger parts cannot move."""


class RigWarning(NamedTuple):
    """An error (`impossible`) or a warning about a rig's data: its subject (motors, camera, parts
    or limits), and a text for the user with name, value and allowed values."""

    about: str
    text: str
    impossible: bool = False


def check(rig: Rig) -> None:
    """Check whether a rig's data are consistent.

    Raises
    ------
    RigError
        If the data contain an error (`RigWarning.impossible`). The message states the key, its
        value and the allowed values.
    """
    for warning in rig_warnings(rig):
        if warning.impossible:
            raise RigError(warning.text)


def rig_warnings(rig: Rig, *about: str) -> list[RigWarning]:
    """Return all errors, then all warnings. If subjects are given, return only errors and warnings
    about these subjects."""
    found = [
        *_check_motors(rig),
        *_check_limits(rig),
        *_check_parts(rig),
        *_check_fiducials(rig),
        *_check_camera(rig),
    ]
    selected = [warning for warning in found if not about or warning.about in about]
    return sorted(selected, key=lambda warning: not warning.impossible)


def _check_motors(rig: Rig) -> Iterator[RigWarning]:
    size = 2 * float(np.max(rig.plate.half))
    for motor in rig.motors:
        outside_m = float(np.hypot(*np.maximum(np.abs(motor.point) - rig.plate.half, 0)))
        if outside_m > BESIDE * size:
            x, y = motor.point
            yield RigWarning(
                "motors",
                f"motors: {motor.name}: point_m is [{x:g}, {y:g}], {outside_m:.3g} m outside the "
                f"plate, allowed: |x| up to {rig.plate.half[0]:g}, |y| up to "
                f"{rig.plate.half[1]:g}, or on a bracket up to {OUTSIDE * size:.3g} m outside",
                outside_m > OUTSIDE * size,
            )
    yield from _check_drives(rig)
    scale = np.array([1, 1, float(np.hypot(*rig.plate.half))])
    sizes = np.linalg.svd(rig.motor_levers / scale, compute_uv=False)
    if sizes[-1] < 0.05 * sizes[0]:
        yield RigWarning(
            "motors",
            "motors: with these points and directions, one of the motions x, y and theta requires "
            "more than 20 times the force of another, allowed: motors whose lines of force are "
            "not all parallel and do not all meet in one point",
            bool(sizes[-1] < 1e-3 * sizes[0]),
        )


def _check_drives(rig: Rig) -> Iterator[RigWarning]:
    drives = {motor.name: motor.drive for motor in rig.motors if motor.drive is not None}
    if not drives:
        return
    kinds = {motor.name: motor.drive.kind if motor.drive else "bridge" for motor in rig.motors}
    first, kind = next((name, drive.kind) for name, drive in drives.items())
    for name in [name for name in kinds if kinds[name] != kind][:1]:
        yield RigWarning(
            "motors", f"motors: {name}: drive is {kinds[name]!r}, but {first} has {kind!r}, "
            "allowed: the same for all four motors", True,
        )  # fmt: skip
    if len({drive.absolute for drive in drives.values()}) > 1:
        yield RigWarning(
            "motors", "motors: home is 'here' for some motors and 'absolute' for others, so "
            "home is correct only if the plate hangs there at the first enable; better: the same "
            "for all four motors",
        )  # fmt: skip
    nodes: dict[int, str] = {}
    serials: dict[int, str] = {}
    for name, drive in drives.items():
        if drive.node in nodes:
            yield RigWarning(
                "motors", f"motors: {name}: node is {drive.node}, the same as for "
                f"{nodes[drive.node]}, allowed: a different one for each motor", True,
            )  # fmt: skip
        nodes[drive.node] = name
        if drive.serial in serials:
            yield RigWarning(
                "motors", f"motors: {name}: serial is {drive.serial}, the same as for "
                f"{serials[drive.serial]}, allowed: a different one for each motor", True,
            )  # fmt: skip
        if drive.serial:
            serials[drive.serial] = name
        yield from _check_drive(rig, name, drive)
    alike = len(set(kinds.values())) == 1
    if alike and len({drive.counts_per_m for drive in drives.values()}) > 1:
        key, unit = _scale_key(kind)
        scales = ", ".join(f"{drive.counts_per_m / unit:g}" for drive in drives.values())
        yield RigWarning(
            "motors", f"motors: {key} is {scales} for {', '.join(drives)}; check them, because "
            "drives of the same model usually have equal scales",
        )  # fmt: skip
    if rig.limits.following_error_m == 0:
        yield RigWarning(
            "limits", "limits: following_error_m is 0, so only the drives themselves detect a "
            "drive that does not follow or has lost counts; better: more than 0",
        )  # fmt: skip


def _check_drive(rig: Rig, name: str, drive: Drive) -> Iterator[RigWarning]:
    """Check the node number and the scale of the drive of the motor `name`."""
    odrive = drive.kind == "odrive"
    if odrive and drive.node > ODRIVE_NODES:
        yield RigWarning(
            "motors", f"motors: {name}: node is {drive.node}, allowed for an ODrive: 1 to "
            f"{ODRIVE_NODES}", True,
        )  # fmt: skip
    key, unit = _scale_key(drive.kind)
    scale = drive.counts_per_m / unit
    if odrive and scale * rig.limits.speed > ODRIVE_SPEED:
        yield RigWarning(
            "motors", f"motors: {name}: turns_per_m is {scale:g}, so the drive turns at "
            f"{scale * rig.limits.speed:.3g} turns/s at speed_mps {rig.limits.speed:g}, but "
            f"its feed-forward is limited to {ODRIVE_SPEED:g} turns/s; better: reduce "
            "turns_per_m or speed_mps",
        )  # fmt: skip
    coarse = 1 / drive.counts_per_m
    if coarse > COARSEST_M:
        yield RigWarning(
            "motors", f"motors: {name}: {key} is {scale:g}, so one count is "
            f"{1e6 * coarse:.3g} um, better: {1e6 * COARSEST_M:g} um or less",
        )  # fmt: skip
    if drive.counts_per_m * rig.limits.stroke_m > MAX_COUNTS:
        yield RigWarning(
            "motors", f"motors: {name}: {key} is {scale:g}, but a stroke of "
            f"{rig.limits.stroke_m:g} m requires "
            f"{MAX_COUNTS / unit / rig.limits.stroke_m:g} or less", True,
        )  # fmt: skip


def _scale_key(kind: str) -> tuple[str, float]:
    """Return the key of a drive's scale in the rig file, and the number of counts per unit of this
    scale."""
    return ("turns_per_m", ODRIVE_COUNTS) if kind == "odrive" else ("counts_per_m", 1)


def _check_limits(rig: Rig) -> Iterator[RigWarning]:
    limits, floor = rig.limits, rig.friction.accel
    if limits.accel <= floor:
        yield RigWarning(
            "limits",
            f"limits: accel_mps2 is {limits.accel:g}, allowed: more than mu g = {floor:g} m/s2 "
            "(below it parts never slide)",
            True,
        )
    elif rig.gamma <= 1:
        key = rig.reach.limit.split()[0]
        value = limits.force if key == "force_n" else limits.continuous_force
        yield RigWarning(
            "limits",
            f"limits: {key} is {value:g}, which accelerates a plate of {rig.plate.mass_kg:g} kg by "
            f"{rig.reach.accel:.3g} m/s2 in every direction, allowed: {value / rig.gamma:.3g} or "
            f"more, because parts slide only above mu g = {floor:g} m/s2",
            True,
        )
    elif rig.gamma < MIN_GAMMA:
        yield RigWarning(
            "limits",
            f"limits: shaking ratio Gamma is {rig.gamma:.3g} (limited by {rig.reach.limit}), "
            f"advised: {MIN_GAMMA:g} or more; the plate shakes too little, so tasks take long or "
            "fail",
        )
    if 0 < limits.following_error_m < MIN_FOLLOWING_M:
        yield RigWarning(
            "limits",
            f"limits: following_error_m is {limits.following_error_m:g}, allowed: 0 (no check), "
            f"or {MIN_FOLLOWING_M:g} and more",
            True,
        )
    elif limits.following_error_m >= limits.stroke_m:
        yield RigWarning(
            "limits",
            f"limits: following_error_m is {limits.following_error_m:g}, so a motor that is stuck "
            f"at home is never detected; better: well below stroke_m, {limits.stroke_m:g}",
        )
    if limits.continuous_force > limits.force:
        yield RigWarning(
            "limits",
            f"limits: continuous_force_n is {limits.continuous_force:g}, more than the peak "
            f"force_n of {limits.force:g}; check whether it belongs to other motors",
        )
    yield from _check_speeds(rig)


def _check_speeds(rig: Rig) -> Iterator[RigWarning]:
    """Check whether the stroke and speed limits fit sinusoidal motions in the frequency range of
    the solvers' cycles."""
    limits, floor = rig.limits, rig.friction.accel
    low, high = 2 * np.pi * np.array(CYCLE_HZ)
    for key, value, unit, peak in (
        ("stroke_m", limits.stroke_m, "m", limits.stroke_m * high**2),
        ("speed_mps", limits.speed, "m/s", limits.speed * high),
    ):
        if peak < min(MIN_GAMMA * floor, 0.5 * rig.reach.accel):
            yield RigWarning(
                "limits",
                f"limits: {key} is {value:g} {unit}, which allows {peak:.3g} m/s2 at "
                f"{CYCLE_HZ[1]:g} Hz (the highest frequency in a cycle). Parts slide above mu g = "
                f"{floor:g} m/s2; advised: {MIN_GAMMA * floor * value / peak:.2g} {unit} or more",
                bool(peak <= floor),
            )
    needed = rig.reach.accel / low**2
    if limits.stroke_m > 3 * needed:
        yield RigWarning(
            "limits",
            f"limits: stroke_m is {limits.stroke_m:g}, but cycles use only {needed:.2g} m: their "
            f"lowest frequency is {CYCLE_HZ[0]:g} Hz, and the acceleration is at most "
            f"{rig.reach.accel:.3g} m/s2 (limited by {rig.reach.limit})",
        )


def _check_parts(rig: Rig) -> Iterator[RigWarning]:
    radius, half = rig.parts.radius_m, float(np.min(rig.plate.half))
    if radius > PART_FRACTION[1] * half:
        limit = PART_FRACTION[0] * half
        yield RigWarning(
            "parts",
            f"parts: radius_m is {radius:g} on a plate whose shorter side is {2 * half:g} m, "
            f"allowed: up to {limit:.3g}, advised: up to {PART_FRACTION[1] * half:.2g}, so that "
            "several parts can pass each other",
            radius > limit,
        )
    masses = {name: part.mass_kg or 0.0 for name, part in rig.types.items()}
    heaviest = max(masses, key=lambda name: masses[name], default="")
    where, mass = "parts", rig.parts.mass_kg
    if heaviest and masses[heaviest] > mass:
        where, mass = f"types: {heaviest}", masses[heaviest]
    if mass > 0.1 * rig.plate.mass_kg:
        yield RigWarning(
            "parts",
            f"{where}: mass_kg is {mass:g} on a plate of {rig.plate.mass_kg:g} kg, advised: a "
            "tenth of that or less, because the model neglects the parts' forces on the plate",
        )


def _check_fiducials(rig: Rig) -> Iterator[RigWarning]:
    if rig.fiducials is None:
        return
    outside = np.abs(rig.fiducials.corners) > rig.plate.half + 1e-6
    for row in np.flatnonzero(np.any(outside, axis=(1, 2))):
        x, y = rig.fiducials.centres[row]
        limit = rig.plate.half - rig.fiducials.side_m / 2
        yield RigWarning(
            "camera",
            f"fiducials: centre_m: marker_{rig.fiducials.numbers[row]} is [{x:g}, {y:g}], not "
            f"completely on the plate, allowed: |x| up to {limit[0]:g}, |y| up to {limit[1]:g} for "
            f"markers of {rig.fiducials.side_m:g} m",
            True,
        )


def _check_camera(rig: Rig) -> Iterator[RigWarning]:
    corners = np.array(rig.camera.corners_px)
    if rig.camera.lens is not None and rig.camera.lens.bends:
        corners = rig.camera.lens.straighten(corners)
        if not np.all(np.isfinite(corners)):
            # Some corners are outside the lens's field of view, so the other checks are impossible.
            return
    wrong = _check_corner_order(corners) or _check_corner_shape(rig, corners)
    if wrong is not None:
        yield wrong
        if wrong.impossible:
            return
    yield from _check_image(rig)
    yield from _check_part_size(rig)
    yield from _check_heights(rig)


def _check_heights(rig: Rig) -> Iterator[RigWarning]:
    """Check the camera's height against its lens and corners, and the parts' heights against the
    camera's height."""
    position = camera_position(rig)
    if position is None:
        return
    given, height = rig.camera.height_m, float(position[2])
    lens = rig.camera.lens
    if given is not None and lens is not None and abs(given - height) > HEIGHT_ERROR * height:
        yield RigWarning(
            "camera",
            f"camera: height_m is {given:g}, but focal_px and corners_px give {height:.3g} m, "
            f"which is used; allowed: {height:.3g}, or no height_m",
        )
    parts = {f"types: {name}": part.height_m for name, part in rig.types.items()}
    for where, value in {"parts": rig.parts.height_m, **parts}.items():
        if value > height / 2:
            yield RigWarning(
                "parts",
                f"{where}: height_m is {value:g}, but the camera is {height:.3g} m above the "
                f"plate, allowed: up to {height / 2:.3g} (half of this height)",
                True,
            )


def _check_corner_order(corners: np.ndarray) -> RigWarning | None:
    """Check that the corners (4, 2) [px] form a convex quadrilateral, and that a camera above the
    plate sees them in this order. Return None if so."""
    sides = np.roll(corners, -1, axis=0) - corners
    after = np.roll(sides, -1, axis=0)
    crosses = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
    if np.all(crosses < 0):
        return None
    order = "are in mirrored order" if np.all(crosses > 0) else "are no convex quadrilateral"
    return RigWarning(
        "camera",
        f"camera: corners_px {order}, allowed: the pixels of (-x,-y), (+x,-y), (+x,+y), (-x,+y) in "
        "this order, as seen from above (pixel rows count downwards)",
        True,
    )


def _check_corner_shape(rig: Rig, corners: np.ndarray) -> RigWarning | None:
    """Check that a camera with square pixels can see this plate's corners at the given image
    points. Return None if so."""
    misfit, tilt = _corner_misfit(rig, corners, rig.plate.corners)
    if misfit > GOOD_FIT:
        length, width = rig.plate.length_m, rig.plate.width_m
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
        ratio = (sides[0] + sides[2]) / (sides[1] + sides[3])
        turned = np.roll(corners, 1, axis=0)
        other = _corner_misfit(rig, turned, rig.plate.corners)[0] < min(GOOD_FIT, misfit / 3)
        hint = "; they would fit if the last pair came first" if other else ""
        return RigWarning(
            "camera",
            f"camera: corners_px show a plate with a side ratio of {ratio:.3g}, but the plate has "
            f"{length:g} x {width:g} m: {100 * misfit:.0f} % error, allowed: up to "
            f"{100 * WORST_FIT:g} %; check that they belong to this plate, and their order{hint}",
            misfit > WORST_FIT,
        )
    if np.degrees(tilt) > STEEP_DEG:
        return RigWarning(
            "camera",
            f"camera: its tilt from the vertical is {np.degrees(tilt):.0f} degrees by corners_px, "
            f"advised: up to {STEEP_DEG:g}",
        )
    return None


def _corner_misfit(rig: Rig, corners: np.ndarray, plate: np.ndarray) -> tuple[float, float]:
    """Return the misfit between the image corners (4, 2) [px] and an image of the plate's rectangle
    [-], and the tilt of the camera [rad].

    Let K be the camera matrix, and H the homography from the plate to the image. The first two
    columns of K^-1 H are the plate's axes times a common scale. Therefore these columns must have
    equal lengths and be orthogonal. If K is unknown, the best focal length of `FOCAL_LENGTHS` is
    used, and the principal point is assumed in the middle of the image.
    """
    camera = rig.camera
    view = fit_homography(plate, corners)
    if camera.lens is not None:
        matrices = [camera.lens.matrix]
    else:
        middle = (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
        matrices = [
            np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1.0]])
            for f in FOCAL_LENGTHS * camera.width_px
        ]
    best = (np.inf, 0.0)
    for matrix in matrices:
        x, y = np.linalg.solve(matrix, view)[:, :2].T
        long, wide = np.linalg.norm(x), np.linalg.norm(y)
        misfit = max(abs(np.log(long / wide)), abs(x @ y) / (long * wide))
        normal = np.cross(x, y)
        tilt = np.arccos(min(1.0, abs(normal[2]) / np.linalg.norm(normal)))
        best = min(best, (float(misfit), float(tilt)))
    return best


def _check_image(rig: Rig) -> Iterator[RigWarning]:
    size = np.array([rig.camera.width_px, rig.camera.height_px])
    corners = np.array(rig.camera.corners_px)
    out = np.any((corners < -0.5) | (corners > size - 0.5), axis=1)
    if np.any(out):
        row = int(np.flatnonzero(out)[0])
        middle = corners.mean(axis=0)
        yield RigWarning(
            "camera",
            f"camera: corners_px[{row}] is [{corners[row, 0]:g}, {corners[row, 1]:g}], outside the "
            f"image of {size[0]} x {size[1]} px, so parts there are not visible, advised: all "
            "four corners inside the image",
            bool(np.any((middle < 0) | (middle > size - 1)) or np.sum(out) > 2),
        )


def _check_part_size(rig: Rig) -> Iterator[RigWarning]:
    low, high = PART_PX
    radius_px = part_radius_px(rig)
    if radius_px < FINE_PX:
        need = rig.parts.radius_m * low / radius_px
        yield RigWarning(
            "camera",
            f"parts: radius_m is {rig.parts.radius_m:g}, which is {radius_px:.3g} px in the image, "
            f"allowed: {low:g} to {high:g} px, advised: {FINE_PX:g} px or more; move the camera "
            f"nearer, use images {rig.camera.width_px * FINE_PX / radius_px:.0f} px wide, or use "
            f"parts with a radius of {need:.2g} m or more",
            radius_px < low,
        )
    elif radius_px > high:
        yield RigWarning(
            "camera",
            f"parts: radius_m is {rig.parts.radius_m:g}, which is {radius_px:.4g} px in the image, "
            f"allowed: {low:g} to {high:g} px; use a smaller image or smaller parts",
            True,
        )
