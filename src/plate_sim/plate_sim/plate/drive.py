"""Model of the plate on its flexures and of the drive of its motors, as one linear system.

    M q'' + C q' + K q = B f,      f_i' = w (g_i u_i - f_i),
    u = B^+ (s_M M c'' + s_C C c' + s_K K c) + k B^T (c - q) + d B^T (c' - q')

q is the pose of the plate, c the commanded pose, f the forces of the motors, and u their setpoints.
B is the matrix that maps these forces to the wrench on the plate at home. B^+ is the least-squares
inverse of B, and w is the bandwidth of the motors. The class `Suspension` defines the other
quantities.

The state z of the system contains the deviation e = q - c and its rate. If the motors have a finite
bandwidth, z also contains the deviation of their forces from the feedforward, f - g B^+ (...). The
state follows z' = A z + b(t), where b is the error of the feedforward. If the feedforward
compensates M, C and K exactly, and if the motors are equal and have no lag, e is exactly 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import factorial, pi

import numpy as np

from plate_core import PlateCycle, PlateError, Rig
from plate_core.rig import Suspension

from .motion import PlateMotion

DEGREE = 5
"""Degree of the polynomials that describe the commanded motion and the forces in each piece."""

HELD = 1e-6
"""Minimum ratio of the slowest to the fastest rate of the system. If the ratio is smaller, neither
the flexures nor the servo hold the plate in place."""


@dataclass(frozen=True)
class PlateState:
    """State of the plate between two cycles.

    Attributes
    ----------
    pose, twist : (3,)
        Pose [m, m, rad] and twist [m/s, m/s, rad/s] of the plate, plate_home.
    force : (4,)
        Forces of the motors [N].
    overtravel_m : float
        Maximum distance by which a motor exceeded its stroke in the last cycle [m]. 0 if no motor
        exceeded it. The simulation has no stops, but a real rig would hit them.

    Raises
    ------
    PlateError
        If a shape is wrong or a value is not finite.
    """

    pose: np.ndarray
    twist: np.ndarray
    force: np.ndarray
    overtravel_m: float = 0.0

    def __post_init__(self) -> None:
        for name, size in (("pose", 3), ("twist", 3), ("force", 4)):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != (size,) or not np.all(np.isfinite(value)):
                raise PlateError(
                    f"plate's {name} is {value.tolist()}, allowed: {size} finite numbers"
                )

    @classmethod
    def at_rest(cls) -> PlateState:
        """Return the state of a plate at home and at rest."""
        return cls(np.zeros(3), np.zeros(3), np.zeros(4))


@dataclass(frozen=True)
class Plant:
    """Plate and drive as a linear system z' = A z + b, see the module. z (n,) is the state, with n
    = 6, or n = 10 if the motors have a lag.

    Attributes
    ----------
    suspension : Suspension
    push : (3, 4)
        Matrix B. Each column contains force and torque on the plate about home per newton of force
        of one motor [N, N, N m].
    """

    suspension: Suspension
    push: np.ndarray

    @classmethod
    def of(cls, rig: Rig, suspension: Suspension) -> Plant:
        """Return the linear system of a rig.

        Raises
        ------
        PlateError
            If neither the flexures nor the servo hold the plate in place, or the servo makes the
            plate unstable.
        """
        plant = cls(suspension, rig.motor_levers.T)
        rates = np.linalg.eigvals(plant.system)
        fastest = np.max(np.abs(rates))
        if np.min(np.abs(rates)) < HELD * fastest:
            raise PlateError(
                f"suspension: stiffness {suspension.stiffness} and servo {suspension.servo} leave "
                "the plate free to drift, required: one of them holds it in x, y and theta"
            )
        if np.max(rates.real) > HELD * fastest:
            raise PlateError(
                f"suspension: servo {suspension.servo} with a motor bandwidth of "
                f"{suspension.motor_bandwidth_hz:g} Hz is unstable: deviations "
                f"grow by the factor e in {1 / np.max(rates.real):.3g} s, allowed: a stable servo"
            )
        return plant

    @property
    def lags(self) -> bool:
        """Whether the motors have a finite bandwidth."""
        return bool(np.isfinite(self.suspension.motor_bandwidth_hz))

    @cached_property
    def gain(self) -> np.ndarray:
        """Gains g of the motors (4,)."""
        return np.array(self.suspension.motor_gain)

    @cached_property
    def matrices(self) -> np.ndarray:
        """Matrices K, C and M (3, 3, 3). The model multiplies K by the pose, C by the first and M
        by the second derivative of the pose."""
        return np.array([getattr(self.suspension, k) for k in ("stiffness", "damping", "mass")])

    @cached_property
    def known(self) -> np.ndarray:
        """Matrices K, C and M, multiplied by the fractions of them that the feedforward compensates
        (3, 3, 3)."""
        return self.matrices * np.array(self.suspension.feedforward[::-1])[:, None, None]

    @cached_property
    def inverse(self) -> np.ndarray:
        """Least-squares inverse B^+ of the matrix B (4, 3)."""
        return np.asarray(np.linalg.pinv(self.push))

    @cached_property
    def mobility(self) -> np.ndarray:
        """Inverse of the mass matrix M (3, 3)."""
        return np.asarray(np.linalg.inv(self.matrices[2]))

    @cached_property
    def servo(self) -> np.ndarray:
        """Matrix (4, 6) that maps the deviations of pose and twist to the servo forces of the
        motors. The forces include the gains of the motors."""
        stiff, damped = (s * self.push.T for s in self.suspension.servo)
        return np.asarray(-self.gain[:, None] * np.concatenate([stiff, damped], axis=1))

    @cached_property
    def system(self) -> np.ndarray:
        """System matrix A (n, n) [1/s]."""
        stiffness, damping, _ = self.matrices
        accel = -self.mobility @ np.concatenate([stiffness, damping], axis=1)
        into = self.mobility @ self.push
        rise = np.concatenate([np.zeros((3, 3)), np.eye(3)], axis=1)
        if not self.lags:
            return np.concatenate([rise, accel + into @ self.servo])
        corner = 2 * pi * self.suspension.motor_bandwidth_hz
        return np.block(
            [[rise, np.zeros((3, 4))], [accel, into], [corner * self.servo, -corner * np.eye(4)]]
        )

    def deviation(self, state: PlateState, command: Command) -> np.ndarray:
        """Convert the state of the plate at the start of a command to the state z (n,) of the
        linear system."""
        pose, twist, force = command.at(0, 0.0)
        parts = [state.pose - pose, state.twist - twist, state.force - self.gain * force]
        return np.concatenate(parts[: 3 if self.lags else 2])

    def end(self, deviation: np.ndarray, command: Command) -> PlateState:
        """Convert the state z (n,) of the linear system at the end of a command to the state of the
        plate."""
        pose, twist, force = command.at(len(command.steps) - 1, command.steps[-1])
        follow = deviation[6:] if self.lags else self.servo @ deviation
        return PlateState(pose + deviation[:3], twist + deviation[3:6], self.gain * force + follow)


@dataclass(frozen=True)
class Command:
    """A commanded cycle and the errors of its feedforward. In each piece of the cycle, both
    quantities are polynomials, which are described by their time derivatives at the start of the
    piece.

    Attributes
    ----------
    times : (k + 1,)
        Ends of the pieces [s].
    pose : (k, 6, 3)
        Commanded pose c and its time derivatives.
    force : (k, 6, 4)
        Feedforward forces of the motors [N], and their time derivatives.
    forcing : (k, 6, n)
        Error b of the feedforward, and its time derivatives.
    """

    times: np.ndarray
    pose: np.ndarray
    force: np.ndarray
    forcing: np.ndarray

    @classmethod
    def of(cls, plant: Plant, cycle: PlateCycle | PlateMotion) -> Command:
        """Convert a cycle to a command for a plant."""
        pose = cycle.coefficients * np.array([factorial(i) for i in range(DEGREE + 1)])[:, None]
        derivatives = [_derivative(pose, order) for order in range(3)]
        needed = sum(d @ m for d, m in zip(derivatives, plant.matrices, strict=True))
        known = sum(d @ m for d, m in zip(derivatives, plant.known, strict=True))
        force = known @ plant.inverse.T
        excess = (force * (plant.gain - 1)) @ plant.push.T + (known - needed)
        rows = [np.zeros_like(pose), excess @ plant.mobility]
        if plant.lags:
            rows.append(-plant.gain * _derivative(force, 1))
        return cls(np.asarray(cycle.times), pose, force, np.concatenate(rows, axis=2))

    @property
    def steps(self) -> np.ndarray:
        """Lengths (k,) of the pieces [s]."""
        return np.diff(self.times)

    def at(self, piece: int, offset: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the commanded pose (3,) and twist (3,), and the feedforward forces (4,). The time
        is `offset` [s] after the start of the piece `piece`."""
        row, offsets = slice(piece, piece + 1), np.array([offset])
        pose = shift_derivatives(self.pose[row], offsets)[0]
        force = shift_derivatives(self.force[row], offsets)[0]
        return pose[0], pose[1], force[0]


def _derivative(derivatives: np.ndarray, order: int) -> np.ndarray:
    """Return the time derivatives of order `order` of polynomials, (k, 6, d). The argument and the
    result contain derivatives at the starts of the pieces."""
    width = derivatives.shape[1]
    return np.pad(derivatives, ((0, 0), (0, order), (0, 0)))[:, order : order + width]


def shift_derivatives(derivatives: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return the time derivatives (m, DEGREE + 1, d) of m polynomials at times that are later by
    `offset` (m,) [s]."""
    order = np.arange(DEGREE + 1)
    # In the Taylor series, derivative j contributes to derivative i at the later time. The exponent
    # of `offset` in this contribution is power[i, j].
    power = order - order[:, None]
    scale = np.array([1 / factorial(p) for p in order])[np.maximum(power, 0)] * (power >= 0)
    return np.asarray((scale * offset[:, None, None] ** np.maximum(power, 0)) @ derivatives)
