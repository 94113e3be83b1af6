"""Computes the actual motion of a plate on flexures for a commanded cycle. The module `drive`
describes the model and its symbols.

At the ends of the command's pieces, the deviation z from the command is computed exactly. The
deviation follows z' = A z + b(t) with b(t) = sum_k b_k t^k/k!. Together, z and all b_k form a
linear system without input. The exponential of the matrix of this system advances z by one step
(Higham, Functions of Matrices, section 10.7.4).

Inside a piece, the deviation is approximated by a quintic polynomial. The pose, twist and
acceleration of this polynomial are exact at both ends. If the polynomial differs too much from the
exact state in the middle, the piece is bisected.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import factorial

import numpy as np

from plate_core import PlateCycle, Rig
from plate_core.motion import motor_state, quintic_pieces
from plate_core.rig import Suspension

from .drive import DEGREE, Command, Plant, PlateState, shift_derivatives
from .motion import PlateMotion

POSE_ERROR = 1e-9
"""Maximum error of the approximated pose between knots [m, rad]."""

TWIST_ERROR = 1e-6
"""Maximum error of the approximated twist between knots [m/s, rad/s]. A part that moves with such
an error is displaced by 1 um per second."""

ACCEL_ERROR = 1e-2
"""Maximum error of the approximated acceleration between knots [m/s2, rad/s2]. This error affects
only the time at which a part begins to slip."""

HALVINGS = 16
"""Maximum number of bisections of a piece. With this number, the effect of a motor lag of 1 us is
resolved in pieces of 10 ms."""

STEP_DIGITS = 15
"""Number of decimals to which the lengths of pieces [s] are rounded. The response is computed only
once for pieces of equal length."""


def realise(
    rig: Rig, state: PlateState, cycle: PlateCycle | PlateMotion
) -> tuple[PlateMotion, PlateState]:
    """Compute the actual motion of the plate during a commanded cycle. Return the motion, and the
    state of the plate at the end.

    The motion follows the linear model in `drive`. The motion is exact at the knots and at the end.
    Between the knots, the errors are about `POSE_ERROR`, `TWIST_ERROR` and `ACCEL_ERROR`. The model
    neglects the friction of parts on the plate. The model also neglects the change of the motors'
    lever arms with the rotation of the plate. Without a suspension, the motion is equal to the
    commanded motion.

    Raises
    ------
    PlateError
        If nothing holds the plate in place, or if the servo makes it unstable.
    """
    if rig.suspension is None:
        motion = PlateMotion(cycle.times, cycle.coefficients)
        end = PlateState(motion.pose(motion.period)[0], motion.twist(motion.period)[0], np.zeros(4))
    else:
        plant = _make_plant(rig, rig.suspension)
        command = Command.of(plant, cycle)
        motion, deviation = _simulate_response(plant, command, plant.deviation(state, command))
        end = plant.end(deviation, command)
    return motion, replace(end, overtravel_m=overtravel(rig, motion))


def motor_record(
    rig: Rig, motion: PlateMotion, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sensor values of the motors at times t (n,) [s] of a cycle.

    Returns
    -------
    q, qd, qdd : (n, 4)
        Travel [m], speed [m/s] and acceleration [m/s2].
    """
    return motor_state(rig, motion.pose(t), motion.twist(t), motion.accel(t))


def overtravel(rig: Rig, motion: PlateMotion) -> float:
    """Return the maximum distance by which a motor exceeds its stroke [m]. The travel is checked at
    4 times per piece."""
    t = motion.times[:-1, None] + np.diff(motion.times)[:, None] * np.arange(4) / 4
    travel, _, _ = motor_record(rig, motion, np.append(t, motion.period))
    return max(0.0, float(np.max(np.abs(travel))) - rig.limits.stroke_m)


@lru_cache(maxsize=16)
def _make_plant(rig: Rig, suspension: Suspension) -> Plant:
    return Plant.of(rig, suspension)


@dataclass(frozen=True)
class _Spans:
    """Intervals of time (spans) within the pieces of the command, and the exact deviations at the
    starts and ends of the spans.

    Attributes
    ----------
    piece : (m,)
    offset : (m,)
        Time from the start of the piece to the start of the span [s].
    before, after : (m, n)
        Deviation z at the start and at the end of the span.
    """

    piece: np.ndarray
    offset: np.ndarray
    before: np.ndarray
    after: np.ndarray

    def take(self, rows: np.ndarray) -> _Spans:
        return _Spans(self.piece[rows], self.offset[rows], self.before[rows], self.after[rows])


def _simulate_response(
    plant: Plant, command: Command, deviation: np.ndarray
) -> tuple[PlateMotion, np.ndarray]:
    """Compute the motion for the initial deviation `deviation` (n,). Return the motion, and the
    deviation (n,) at its end."""
    steps, kind = np.unique(np.round(command.steps, STEP_DIGITS), return_inverse=True)
    transitions = step_responses(plant.system, steps)[kind]
    ends = [deviation]
    for piece in range(len(kind)):
        inputs = command.forcing[piece : piece + 1]
        ends.append(advance(transitions[piece : piece + 1], ends[-1][None], inputs)[0])
    z = np.array(ends)
    spans = _Spans(np.arange(len(kind)), np.zeros(len(kind)), z[:-1], z[1:])
    kept = []
    for level in range(HALVINGS):
        half = step_responses(plant.system, steps / 2 ** (level + 1))[kind[spans.piece]]
        inputs = shift_derivatives(command.forcing[spans.piece], spans.offset)
        middle = advance(half, spans.before, inputs)
        step = command.steps[spans.piece] / 2**level
        rough = _is_inaccurate(plant, command, spans, middle, step)
        kept.append(spans.take(~rough))
        spans = _halve_spans(spans.take(rough), middle[rough], step[rough] / 2)
        if not len(spans.piece):
            break
    kept.append(spans)
    return _join_spans(plant, command, kept), z[-1]


def step_responses(system: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the matrices that compute one step of the system z' = A z + b(t) with a polynomial
    input b.

    Parameters
    ----------
    system : (n, n)
        System matrix A [1/s].
    steps : (u,)
        Lengths of the steps [s].

    Returns
    -------
    (u, n, (DEGREE + 2) n)
        One matrix per step length. The matrix maps the state and the derivatives of the input,
        stacked in one vector, to the state after the step.
    """
    from scipy.linalg import expm  # SciPy takes 0.2 s to import, and few plates have a suspension

    size = len(system)
    exponent = np.kron(np.eye(DEGREE + 2, k=1), np.eye(size))
    exponent[:size, :size] = system
    return np.asarray(expm(exponent * steps[:, None, None])[:, :size])


def advance(response: np.ndarray, state: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Return the states (m, n) after one step.

    Parameters
    ----------
    response : (m, n, (DEGREE + 2) n)
        Matrix from `step_responses` for the step length of each state.
    state : (m, n)
    derivatives : (m, DEGREE + 1, n)
        Derivatives of the input at the start of the step.
    """
    inputs = np.concatenate([state[:, None], derivatives], axis=1)
    return np.asarray((response @ inputs.reshape(len(state), -1, 1))[..., 0])


def _is_inaccurate(
    plant: Plant, command: Command, spans: _Spans, middle: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """Return for each span (m,) whether its quintic polynomial differs too much from the exact
    state `middle` (m, n) in the middle of the span.

    Let h be the length of the span and t the time since its start. The error of the pose is
    proportional to (t (h - t))^3. Therefore, the maximum error of the twist is not in the middle.
    The maximum error of the twist is 3.4 times the maximum error of the pose, divided by h.
    """
    h = step[:, None]
    p, q = spans.before[:, :3], spans.after[:, :3]
    v, w = spans.before[:, 3:6], spans.after[:, 3:6]
    accels = [
        _deviation_accel(plant, command, spans.piece, spans.offset + fraction * step, z)
        for fraction, z in ((0.0, spans.before), (0.5, middle), (1.0, spans.after))
    ]
    pose = (p + q) / 2 + 5 / 32 * h * (v - w) + h**2 / 64 * (accels[0] + accels[2])
    accel = 3 / 2 * (w - v) / h - (accels[0] + accels[2]) / 4
    miss = np.max(np.abs(pose - middle[:, :3]), axis=1)
    miss_accel = np.max(np.abs(accel - accels[1]), axis=1)
    return (miss > POSE_ERROR) | (3.44 * miss > TWIST_ERROR * step) | (miss_accel > ACCEL_ERROR)


def _deviation_accel(
    plant: Plant, command: Command, piece: np.ndarray, offset: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """Return the second time derivative (m, 3) of the deviation of the pose."""
    forcing = shift_derivatives(command.forcing[piece], offset)[:, 0, 3:6]
    return np.asarray(z @ plant.system[3:6].T + forcing)


def _halve_spans(spans: _Spans, middle: np.ndarray, half: np.ndarray) -> _Spans:
    """Cut m spans in the middle. `middle` (m, n) is the deviation z in the middle of each span.
    `half` (m,) [s] is half the length of each span."""
    return _Spans(
        np.concatenate([spans.piece, spans.piece]),
        np.concatenate([spans.offset, spans.offset + half]),
        np.concatenate([spans.before, middle]),
        np.concatenate([middle, spans.after]),
    )


def _join_spans(plant: Plant, command: Command, kept: list[_Spans]) -> PlateMotion:
    """Join spans, which may have any order, to one motion. The motion is the command plus the
    deviation."""
    names = ("piece", "offset", "before", "after")
    spans = _Spans(*(np.concatenate([getattr(part, name) for part in kept]) for name in names))
    spans = spans.take(np.lexsort((spans.offset, spans.piece)))
    last = np.array([len(command.steps) - 1])
    piece = np.concatenate([spans.piece, last])
    offset = np.concatenate([spans.offset, command.steps[last]])
    z = np.concatenate([spans.before, spans.after[-1:]])
    accel = _deviation_accel(plant, command, piece, offset, z)
    times = np.concatenate([command.times[spans.piece] + spans.offset, command.times[-1:]])
    deviation = quintic_pieces(times, z[:, :3], z[:, 3:6], accel)
    powers = np.array([1 / factorial(i) for i in range(DEGREE + 1)])[:, None]
    return PlateMotion(
        times, shift_derivatives(command.pose[spans.piece], spans.offset) * powers + deviation
    )
