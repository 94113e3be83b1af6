"""One push of the plate along x or y for measuring friction, and the slip of a part in this push.

The plate accelerates from rest with the acceleration a over the distance A. Then the plate brakes
with the deceleration k a. Finally the plate returns home so slowly that no part slides. A part on
the plate sticks while a <= mu_s g. At larger accelerations, the part slips by Coulomb's law
(docs/model.md, Friction (1)). Let r = mu g/a. While the plate accelerates, the part slips by (1 -
r) A. At the end of the acceleration, after the time t with A = a t^2/2, the velocities of plate and
part differ by w = (a - mu g) t. This difference decreases at the rate mu g + k a, during which the
part slips by another w^2/(2 (mu g + k a)) = A (1 - r)^2/(r + k). If k a <= mu g, the part then
sticks, and the slip of the whole push is

    s = A (1 - r) (1 + k)/(r + k)

Therefore the smallest a that causes a slip determines static friction, and s determines dynamic
friction. The function `slip` integrates the same law over the commanded motion with its ramps. The
result of `slip` is valid for all a.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle, Rig
from plate_core.motion import usage

BRAKE = 0.4
"""Ratio k of the deceleration to the acceleration. The equation for s is valid for k a <= mu g.
With this ratio, this means accelerations of up to 2.5 mu g."""

RAMP = 0.12
"""Duration of the first ramp of the acceleration, as a fraction of the whole duration of the
acceleration. The ramp is so slow that the motors can follow it."""

STROKE_USED = 0.8
"""Maximum fraction of the motors' stroke that a push uses."""

LIMITS_USED = 0.9
"""Maximum fraction of all limits that a push uses."""

MAX_LENGTH_M = 0.016
"""Maximum length of a push [m]. Such a push moves parts by some millimetres."""

QUINTIC_PEAK = 10 / np.sqrt(3)
"""Peak acceleration of a quintic from rest to rest with unit length and unit duration. The peak is
proportional to the length and inversely proportional to the squared duration."""

FAST_STEPS = 800
"""Number of integration steps in the push."""

SLOW_STEPS = 60
"""Number of integration steps in each slow motion."""


@dataclass(frozen=True)
class Push:
    """A push of the plate.

    Attributes
    ----------
    axis : int
        0: along x, 1: along y.
    sign : int
        Direction of the push along the axis, 1 or -1.
    accel : float
        Maximum acceleration [m/s2].
    cycle : PlateCycle
        Motion from rest at home to the end of the push. The tail of this cycle is the slow return.
    """

    axis: int
    sign: int
    accel: float
    cycle: PlateCycle


def push_length(rig: Rig) -> float:
    """Return the length [m] of a push on this rig."""
    return min(2 * STROKE_USED * rig.limits.stroke_m, MAX_LENGTH_M)


def make_push(rig: Rig, axis: int, sign: int, accel: float, slow: float) -> Push:
    """Return a push of the length `push_length(rig)`.

    Parameters
    ----------
    axis, sign : int
    accel : float
        Maximum acceleration [m/s2].
    slow : float
        Maximum acceleration on the way to the start of the push and back home [m/s2].
    """
    length = push_length(rig)
    unit_t, unit_a = _acceleration_profile()
    unit_v, unit_x = _integrate_twice(unit_t, unit_a)
    scale_s = np.sqrt(length / (accel * unit_x[-1]))
    pause = np.sqrt(QUINTIC_PEAK * length / 2 / slow)
    times = np.concatenate([[0.0], pause + scale_s * unit_t])
    x = np.concatenate([[0.0], -length / 2 + accel * scale_s**2 * unit_x])
    v = np.concatenate([[0.0], accel * scale_s * unit_v])
    a = np.concatenate([[0.0], accel * unit_a])
    v[-1] = a[-1] = 0.0
    times = np.concatenate([times, times[-1:], times[-1:] + pause])
    states = [np.zeros((len(times), 3)) for _ in range(3)]
    for state, values in zip(states, (x, v, a), strict=True):
        state[: len(values), axis] = sign * values
        state[len(values), axis] = sign * values[-1]
    return Push(axis, sign, accel, PlateCycle.from_knots(times, *states))


def max_accel(rig: Rig, slow: float) -> float:
    """Return the maximum acceleration of a push within the rig's limits [m/s2]."""
    accel = LIMITS_USED * rig.limits.accel
    # usage of the limits is nearly proportional to the acceleration or to its square root
    for _ in range(8):
        worst = max(
            usage(rig, make_push(rig, axis, 1, accel, slow).cycle).overall for axis in (0, 1)
        )
        if worst <= LIMITS_USED:
            break
        accel *= (LIMITS_USED / worst) ** 2 if worst < 2 else 0.5
    return float(accel)


def slip(push: Push, mu: np.ndarray, hold: np.ndarray | float, gravity: float) -> np.ndarray:
    """Return the slips (m,) of parts in a push [m]. A slip is positive if it is opposite to the
    direction of the push.

    Parameters
    ----------
    push : Push
    mu : (m,)
        Coefficient of dynamic friction.
    hold : (m,) or float
        Maximum acceleration at which a part at rest on the plate does not slide, mu_s g [m/s2].
        Values below mu g are replaced by mu g.
    gravity : float
        Gravitational acceleration [m/s2].
    """
    cycle, tail = push.cycle, push.cycle.tail
    assert tail is not None
    start = float(cycle.times[1])
    t = np.concatenate(
        [
            np.linspace(0, start, SLOW_STEPS, endpoint=False),
            np.linspace(start, cycle.period, FAST_STEPS + 1),
        ]
    )
    back = np.linspace(0, tail.period, 2 * SLOW_STEPS + 1)
    t = np.concatenate([t, cycle.period + back[1:]])
    plate = push.sign * np.concatenate(
        [cycle.twist(t[: -2 * SLOW_STEPS])[:, push.axis], tail.twist(back[1:])[:, push.axis]]
    )
    grip = np.asarray(mu, dtype=float) * gravity
    hold = np.maximum(hold, grip)
    step = np.diff(t)[:, None]
    max_change, held = grip * step, np.abs(np.diff(plate))[:, None] <= hold * step
    v, stuck, speed = np.zeros_like(grip), np.ones(grip.shape, bool), [np.zeros_like(grip)]
    # Each NumPy operation takes microseconds, even with few parts. Therefore the loop contains only
    # operations that depend on the previous step.
    for after, change, holds in zip(plate[1:], max_change, held, strict=True):
        rides = stuck & holds
        v = np.where(rides, after, v + np.minimum(np.maximum(after - v, -change), change))
        stuck = rides | (v == after)
        speed.append(v)
    return -0.5 * np.sum(step * (np.array(speed[:-1]) + speed[1:]), axis=0)


def _acceleration_profile() -> tuple[np.ndarray, np.ndarray]:
    """Return times and accelerations of a push from rest to rest. The accelerations are between 1
    and -`BRAKE`, and linear between these times."""
    gain, cross, lose = RAMP, RAMP * (1 + BRAKE), RAMP * BRAKE
    held = 1.0 - RAMP
    # `positive` is the velocity at the time when the acceleration becomes zero. Braking must reduce
    # the velocity by the same value.
    positive = gain / 2 + held + cross / (1 + BRAKE) / 2
    braking = (positive - BRAKE * (cross * BRAKE / (1 + BRAKE) + lose) / 2) / BRAKE
    times = np.cumsum([0.0, gain, held, cross, braking, lose])
    return times, np.array([0.0, 1.0, 1.0, -BRAKE, -BRAKE, 0.0])


def _integrate_twice(t: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return velocity and position at times t (k,), for an acceleration a (k,) that is linear
    between these times."""
    dt = np.diff(t)
    v = np.concatenate([[0.0], np.cumsum(dt * (a[:-1] + a[1:]) / 2)])
    x = np.concatenate([[0.0], np.cumsum(dt * v[:-1] + dt**2 * (2 * a[:-1] + a[1:]) / 6)])
    return v, x
