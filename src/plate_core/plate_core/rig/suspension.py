"""Model of a real rig's suspension and motors, for plates that do not follow their commands
exactly.

The model consists of the mass, damping and stiffness matrices of the plate on its flexures, and of
the feedforward, gain, bandwidth and position control of the motors.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

import numpy as np

from ..errors import RigError
from ..yaml_fields import Fields, required
from .keys import SUSPENSION

Matrix = tuple[tuple[float, float, float], ...]

ASYMMETRY = 1e-6
"""Maximum asymmetry of a matrix, as a fraction of its largest entry."""


@dataclass(frozen=True)
class Suspension:
    """Model of the plate on its flexures, and of the motors with their control.

    The symmetric matrices (3, 3) act on the pose x, y, theta [m, m, rad] in plate_home. A matrix
    that is not diagonal couples the degrees of freedom.

    Attributes
    ----------
    mass : matrix
        Mass matrix [kg, kg m, kg m2], positive definite.
    damping, stiffness : matrix
        Matrices of the flexures [N s/m, ...] and [N/m, ...], positive semidefinite.
    feedforward : (3,)
        Fractions of the inertial, damping and stiffness forces of the commanded motion that the
        drive supplies as feedforward. (1, 1, 1) compensates all forces, (1, 0, 0) the forces of a
        free rigid plate, and (0, 0, 1) the forces of flexures without mass.
    motor_gain : (4,)
        Actual force of each motor divided by its commanded force.
    motor_bandwidth_hz : float
        Corner frequency of the motors' first-order lag [Hz]. inf means no lag.
    servo : (2,)
        Stiffness [N/m] and damping [N s/m] of each motor's position controller.
    """

    mass: Matrix
    damping: Matrix
    stiffness: Matrix
    feedforward: tuple[float, float, float]
    motor_gain: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    motor_bandwidth_hz: float = inf
    servo: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("mass", "damping", "stiffness"):
            matrix = np.array(getattr(self, name), dtype=float)
            object.__setattr__(self, name, _check_matrix(name, matrix))
        for name, size in (("feedforward", 3), ("motor_gain", 4), ("servo", 2)):
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != (size,) or not np.all(np.isfinite(values) & (values >= 0)):
                raise RigError(
                    f"suspension: {name} is {getattr(self, name)!r}, "
                    f"allowed: {size} numbers, 0 or more"
                )
            object.__setattr__(self, name, tuple(values.tolist()))
        if not self.motor_bandwidth_hz > 0:
            raise RigError(
                f"suspension: motor_bandwidth_hz is {self.motor_bandwidth_hz!r}, allowed: above 0"
            )


def _check_matrix(name: str, matrix: np.ndarray) -> Matrix:
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        raise RigError(f"suspension: {name} is {matrix.tolist()!r}, allowed: 3 x 3 finite numbers")
    size = float(np.max(np.abs(matrix)))
    if np.max(np.abs(matrix - matrix.T)) > ASYMMETRY * size:
        raise RigError(f"suspension: {name} is {matrix.tolist()!r}, allowed: a symmetric matrix")
    matrix = (matrix + matrix.T) / 2
    min_eigenvalue = float(np.min(np.linalg.eigvalsh(matrix)))
    if min_eigenvalue < -1e-12 * size or (name == "mass" and min_eigenvalue <= 0):
        kind = "positive definite" if name == "mass" else "positive semidefinite"
        raise RigError(
            f"suspension: {name} has the eigenvalue {min_eigenvalue:.3g}, allowed: a {kind} matrix"
        )
    return tuple(tuple(row) for row in matrix.tolist())


def mass_matrix(
    mass_kg: float, inertia_kgm2: float, centre_of_mass_m: tuple[float, float] = (0.0, 0.0)
) -> Matrix:
    """Return the mass matrix of a plate for its pose at home.

    Parameters
    ----------
    inertia_kgm2 : float
        Moment of inertia about the centre of mass [kg m2].
    centre_of_mass_m : (2,)
        Centre of mass at rest [m, plate_home].
    """
    x, y = centre_of_mass_m
    return (
        (mass_kg, 0.0, -mass_kg * y),
        (0.0, mass_kg, mass_kg * x),
        (-mass_kg * y, mass_kg * x, inertia_kgm2 + mass_kg * (x * x + y * y)),
    )


def modal_matrices(
    mass: Matrix, frequency_hz: np.ndarray, damping_ratio: np.ndarray
) -> tuple[Matrix, Matrix]:
    """Return damping and stiffness (3, 3) of flexures that do not couple x, y and theta.

    Parameters
    ----------
    frequency_hz, damping_ratio : (3,)
        Natural frequency [Hz] and damping ratio of x, y and theta. Each value applies to a motion
        in one coordinate while the other two coordinates are held at 0.
    """
    diagonal = np.diag(np.array(mass))
    omega = 2 * pi * np.asarray(frequency_hz)
    damping = np.diag(2 * np.asarray(damping_ratio) * omega * diagonal)
    stiffness = np.diag(omega**2 * diagonal)
    return _check_matrix("damping", damping), _check_matrix("stiffness", stiffness)


def read_suspension(fields: Fields, mass_kg: float, inertia_kgm2: float) -> Suspension:
    """Return the suspension that a rig file describes.

    Parameters
    ----------
    mass_kg, inertia_kgm2 : float
        Mass [kg] and moment of inertia [kg m2] of the plate. The moment of inertia is used only if
        the file has none.

    Raises
    ------
    RigError
        If a key is missing or unknown, or its value is out of range.
    """
    given = fields.value(SUSPENSION["inertia_kgm2"])
    inertia = inertia_kgm2 if given is None else given
    centre = tuple(map(float, fields.value(SUSPENSION["centre_of_mass_m"])))
    mass = mass_matrix(mass_kg, inertia, (centre[0], centre[1]))
    if fields.has("stiffness") or fields.has("damping"):
        damping = _read_matrix(fields, "damping")
        stiffness = _read_matrix(fields, "stiffness")
    else:
        damping, stiffness = modal_matrices(
            mass,
            fields.value(required(SUSPENSION["frequency_hz"])),
            fields.value(required(SUSPENSION["damping_ratio"])),
        )
    known = fields.child("feedforward")
    supplied = [known.number(key, 0, 2) for key in ("mass", "damping", "stiffness")]
    known.finish()
    gain = tuple(map(float, fields.value(SUSPENSION["motor_gain"])))
    bandwidth = fields.value(SUSPENSION["motor_bandwidth_hz"])
    stiff, damped = 0.0, 0.0
    if fields.has("servo"):
        servo = fields.child("servo")
        stiff, damped = servo.number("stiffness_npm", 0, 1e7), servo.number("damping_nspm", 0, 1e5)
        servo.finish()
    fields.finish()
    return Suspension(
        mass, damping, stiffness, (supplied[0], supplied[1], supplied[2]),
        (gain[0], gain[1], gain[2], gain[3]), bandwidth, (stiff, damped),
    )  # fmt: skip


def _read_matrix(fields: Fields, key: str) -> Matrix:
    return _check_matrix(key, fields.value(required(SUSPENSION[key])))
