"""The pose of the plate in the frame of the robot. The pose is fitted to points of the plate that
the robot's tool has touched."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from plate_core import PlateError
from plate_core.yaml_fields import Key, List, Numbers, Section, Text, read_yaml

from .interface import ReadyPart

MAX_RESIDUAL_M = 1e-3
"""Maximum residual of a point [m]. The residual is the distance of a measured point from its place
according to the fitted pose. A larger residual indicates that a point was measured incorrectly."""

MIN_BASE_M = 0.05
"""Minimum extent of the points on the plate [m]. If the points are closer to each other, they do
not determine the angle of the plate accurately."""

MAX_M = 10.0
"""Maximum absolute value of a coordinate in a hand-eye file [m]."""

FILE = Section(
    "hand-eye file",
    "Frame of the robot, defined by points whose coordinates are known in both frames.",
    (
        Key("frame", Text("a name"), "Name of the robot's frame, whose z axis points up."),
        Key(
            "points", List(), "Two or more points. With three or more, a wrong point can be found."
        ),
    ),
)

POINT = Section(
    "points[]",
    "One point with its coordinates in both frames.",
    (
        Key(
            "plate_m",
            Numbers((2,), -MAX_M, MAX_M),
            "The point on the plate at rest [x, y], in plate_home.",
        ),
        Key("robot_m", Numbers((2,), -MAX_M, MAX_M), "The same point [x, y] in the robot's frame."),
    ),
)


class HandEyeError(PlateError):
    """The points in a hand-eye file do not determine the pose of the plate."""


@dataclass(frozen=True)
class HandEye:
    """Pose of the plate in the frame of the robot: a rotation followed by a translation.

    Attributes
    ----------
    frame : str
    angle : float
        Angle of the plate's x axis in this frame [rad].
    x, y : float
        Centre of the plate in this frame [m].
    residual_m : float
        Maximum distance of a measured point from its place according to this pose [m].
    """

    frame: str = "plate_home"
    angle: float = 0.0
    x: float = 0.0
    y: float = 0.0
    residual_m: float = 0.0

    def part(self, part: ReadyPart) -> ReadyPart:
        """Transform the pose of a part from the frame plate_home to this frame."""
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        covariance = part.covariance
        if covariance[0] >= 0:  # a negative value means that the covariance is unknown
            rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            turned = rotation @ np.reshape(covariance, (3, 3)) @ rotation.T
            covariance = tuple(turned.ravel().tolist())
        return replace(
            part,
            x=cos * part.x - sin * part.y + self.x,
            y=sin * part.x + cos * part.y + self.y,
            angle=math.remainder(part.angle + self.angle, 2 * math.pi),
            covariance=covariance,
        )


def load_hand_eye(path: str | Path) -> HandEye:
    """Read a hand-eye file. docs/guide/feeder.md describes its format.

    Raises
    ------
    HandEyeError
        If the file is invalid. The message contains the name of the file, the key, its value and
        the allowed values.
    """
    fields = read_yaml(path, HandEyeError)
    frame = fields.value(FILE["frame"])
    children = fields.children("points")
    plate = [child.value(POINT["plate_m"]) for child in children]
    robot = [child.value(POINT["robot_m"]) for child in children]
    for section in (*children, fields):
        section.finish()
    try:
        return fit_hand_eye(frame, np.reshape(plate, (-1, 2)), np.reshape(robot, (-1, 2)))
    except HandEyeError as error:
        raise HandEyeError(f"{path}: {error}") from None


def fit_hand_eye(frame: str, plate: np.ndarray, robot: np.ndarray) -> HandEye:
    """Return the rigid motion that maps one set of points to another with the least squared error.

    Parameters
    ----------
    frame : str
        Name of the frame of `robot`.
    plate, robot : (N, 2)
        Coordinates of the same points on the plate and in the frame of the robot [m].

    Raises
    ------
    HandEyeError
        If there are too few points, the points are too close to each other, or the residual is too
        large.

    Notes
    -----
    With the points p and q as complex numbers, relative to their means, the best rotation in the
    plane has the angle of sum(conj(p) q) (Horn 1987, J. Opt. Soc. Am. A 4(4), 629-642, in three
    dimensions).
    """
    count = len(plate)
    if count < 2:
        raise HandEyeError(f"number of points is {count}, allowed: 2 or more")
    p, q = plate @ (1, 1j), robot @ (1, 1j)
    base = float(np.max(np.abs(p[:, None] - p)))
    if base < MIN_BASE_M:
        raise HandEyeError(
            f"largest distance between two points on the plate is {1e3 * base:.1f} mm, allowed: "
            f"{1e3 * MIN_BASE_M:g} mm or more"
        )
    residuals, rotation, shift = _fit_rigid_motion(p, q)
    worst = int(np.argmax(residuals))
    if not residuals[worst] <= MAX_RESIDUAL_M:
        mirrored, *_ = _fit_rigid_motion(p.conj(), q)
        hint = "; mirrored points would fit, so z of the robot's frame may point down"
        raise HandEyeError(
            f"residual of points[{worst}] is {1e3 * residuals[worst]:.2f} mm, "
            f"allowed: {1e3 * MAX_RESIDUAL_M:g} mm"
            + (hint if np.max(mirrored) <= MAX_RESIDUAL_M else "")
        )
    angle = float(np.angle(rotation))
    return HandEye(frame, angle, shift.real, shift.imag, float(residuals[worst]))


def _fit_rigid_motion(p: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, complex, complex]:
    """Return the residuals (N,) [m], the rotation as a complex number of magnitude 1, and the
    translation as a complex number [m]."""
    rotation = np.sum((p - p.mean()).conj() * (q - q.mean()))
    rotation = rotation / max(abs(rotation), np.finfo(float).tiny)
    shift = q.mean() - rotation * p.mean()
    return np.abs(rotation * p + shift - q), complex(rotation), complex(shift)
