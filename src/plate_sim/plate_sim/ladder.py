"""The ladder of models, and which rung a scene needs: no more is computed than it takes.

    points   parts that never meet and never turn
    discs    points with rims that touch
    bodies   footprints all over which friction acts, so that parts turn; rims that touch and rub

The cheapest is run first, and its own result tells whether it may stand. Points whose paths stay
further apart than two radii have not met: discs would have moved alike. And what a point neglects
is bounded along its path: a disc's mean friction is less than mu g where its rim slips otherwise
than its centre. With the slip w of the point, the spin c of the plate relative to the disc, and
the difference e of the two models' velocities,

    e' <= |v' - pull| - mu g f(|c| R/(|w| + e)) + mu g q/(|w| + e),   e >= 0,

f being a disc's friction in mu g (`disc_friction`), q = |theta'| times the distance of the two
models' centres, which so feel the surface at different speeds. The first two terms hold because
friction only ever brings velocities closer, the last is of first order. The integral of e bounds
how far apart the centres end. In 4,000 random scenes none was further off than `TOLERANCE` where a
cheaper model was chosen, but for one: with static friction above dynamic, the integrator's step
decided whether a part held (0.06 mm; the points' exact integrator agreed with the bodies).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from plate_core import PlateError

from .disc_friction import disc_force  # numba does not see changes there: delete the cache then
from .friction import STUCK, Trajectory
from .models import BODIES, DISCS, MODELS, POINTS, Outcome, Scene, run_model, samples

TOLERANCE = 5e-5
"""How far off a cheaper model may put a part at the end of a cycle [m]: 2 % of what parts are
usually moved in one, and hardly seen by a camera (0.014 mm of noise from image to image)."""

CHECK_STEP = 2e-4
"""Time between two looks at the cheap model's path [s], at most."""

DIP = 16
"""Pieces of that time where the slip may vanish."""

STILL = 1e-9
"""A rim slower than this [m/s] relative to the plate does not turn against it."""


@dataclass(frozen=True)
class Choice:
    """Which model was used for a cycle, and why.

    Attributes
    ----------
    model : str
        `points`, `discs` or `bodies`.
    reason : str
        In words, with numbers.
    """

    model: str
    reason: str


@dataclass(frozen=True)
class Turning:
    """What M discs, of which only the centres were computed, did besides.

    Attributes
    ----------
    error : (M,)
        Bound of how far off the centres are [m].
    angle, spin : (M,)
        At the end [rad], [rad/s].
    """

    error: np.ndarray
    angle: np.ndarray
    spin: np.ndarray


@dataclass(frozen=True)
class Gap:
    """The least gap [m] that is left along some paths, and between what."""

    size: float
    between: str


def check_model(model: str) -> str:
    """Return a model's name.

    Raises
    ------
    PlateError
        If there is none of that name.
    """
    if model not in MODELS:
        raise PlateError(f"model is {model!r}, allowed: {', '.join(MODELS)}")
    return model


def climb(scene: Scene, record: bool = False) -> tuple[Outcome, Choice]:
    """Run a cycle by the cheapest model that will do.

    Parameters
    ----------
    scene : Scene
    record : bool
        Whether the outcome is to have the motion at every step.

    Raises
    ------
    PlateError
        As `run_model`.
    """
    often, recorded = (0.0, 0.0) if record else (CHECK_STEP, None)
    outcome = run_model(scene, POINTS, often)
    run = _looks(outcome.run) if record else outcome.run
    gap = least_gap(scene, run)
    model, meeting = POINTS, f"{gap.between} stay {1e3 * gap.size:.2g} mm apart"
    if gap.size < 2 * TOLERANCE:
        model, meeting = DISCS, f"{gap.between} may touch"
        if scene.contacts.friction > 0:
            reason = f"{meeting}, and rims that rub turn parts"
            return run_model(scene, BODIES, recorded), Choice(BODIES, reason)
        outcome = run_model(scene, DISCS, often)
        run = _looks(outcome.run) if record else outcome.run
    turned = turning(scene, run)
    error = np.where(outcome.on_plate, turned.error, 0.0)
    worst = int(np.argmax(error)) if len(error) else -1
    if len(error) and error[worst] > TOLERANCE:
        reason = (
            f"{scene.ids[worst]} may end {1e3 * error[worst]:.2g} mm from where it would as a "
            f"point, allowed {1e3 * TOLERANCE:.2g} mm"
        )
        return run_model(scene, BODIES, recorded), Choice(BODIES, reason)
    spin = np.where(outcome.on_plate, turned.spin, 0.0)
    outcome = replace(outcome, angle=turned.angle, spin=spin)
    most = f"friction all over would move none by more than {1e3 * np.max(error, initial=0):.2g} mm"
    return outcome, Choice(model, f"{meeting}; {most}")


def least_gap(scene: Scene, run: Trajectory) -> Gap:
    """Return a lower bound of the gaps between discs, and to walls, along the paths of points."""
    who = np.flatnonzero(scene.on_plate)
    # Between two samples a path may bend off the line, by so much at most
    accel = scene.static_ratio * np.max(scene.limit, initial=0) + np.hypot(*scene.pull)
    bend = accel * float(np.max(np.diff(run.time))) ** 2 / 8
    low, high = _boxes(run.position)
    middle, half = (low + high)[who] / 2, (high - low)[who] / 2 + bend
    gap = Gap(inf, "parts")
    if len(who) > 1:
        gap = _closest(scene, who, middle, half)
    if scene.contacts.walls and len(who):
        wall = _wall_gap(scene, run, who) - bend
        gap = min(gap, Gap(wall, "a part and a wall"), key=lambda g: g.size)
    return gap


def turning(scene: Scene, run: Trajectory) -> Turning:
    """Return how discs turned whose centres moved as points, and the error of moving them so."""
    pose, twist = scene.motion.pose(run.time), scene.motion.twist(run.time)
    out = np.column_stack([np.zeros(len(scene.ids)), scene.angle, scene.spin])
    _turn(
        run.time, pose, twist, run.position, run.velocity, scene.limit, scene.pull, scene.radius,
        out,
    )  # fmt: skip
    return Turning(out[:, 0], out[:, 1], out[:, 2])


def _looks(run: Trajectory) -> Trajectory:
    """Return of a motion at every step what would have been recorded each `CHECK_STEP`."""
    rows = samples(len(run.time) - 1, run.time[1] - run.time[0], CHECK_STEP)
    return Trajectory(run.time[rows], run.position[rows], run.velocity[rows])


def _closest(scene: Scene, who: np.ndarray, middle: np.ndarray, half: np.ndarray) -> Gap:
    """Return the least gap between discs whose centres stay in boxes (m, 2), m > 1 [m]."""
    reach = 2 * scene.radius + 2 * float(np.max(np.hypot(*half.T)))
    tree = cKDTree(middle)
    pairs = tree.query_pairs(reach + 2 * TOLERANCE, output_type="ndarray")
    if not len(pairs):
        near = tree.query(middle, 2)
        first = int(np.argmin(near[0][:, 1]))
        pairs = np.array([[first, near[1][first, 1]]])
    i, j = pairs.T
    apart = np.maximum(np.abs(middle[i] - middle[j]) - half[i] - half[j], 0)
    gap = np.hypot(*apart.T) - 2 * scene.radius
    k = int(np.argmin(gap))
    first, second = sorted((scene.ids[who[i[k]]], scene.ids[who[j[k]]]))
    return Gap(float(gap[k]), f"{first} and {second}")


def _wall_gap(scene: Scene, run: Trajectory, who: np.ndarray) -> float:
    pose = scene.motion.pose(run.time)
    c, s = np.cos(pose[:, None, 2]), np.sin(pose[:, None, 2])
    x, y = np.moveaxis(run.position[:, who] - pose[:, None, :2], 2, 0)
    along, across = np.abs(c * x + s * y), np.abs(c * y - s * x)
    beyond = np.maximum(along - scene.half[0], across - scene.half[1])
    return float(-np.max(beyond) - scene.radius)


@njit(cache=True, nogil=True, error_model="numpy")
def _boxes(path):
    """Return the corners low and high (M, 2) of boxes around paths (k, M, 2)."""
    low, high = path[0].copy(), path[0].copy()
    for k in range(1, len(path)):
        for i in range(path.shape[1]):
            for d in range(2):
                low[i, d] = min(low[i, d], path[k, i, d])
                high[i, d] = max(high[i, d], path[k, i, d])
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(time, pose, twist, path, speed, limit, pull, radius, out):
    """Carry error [m], angle [rad] and spin [rad/s], the columns of out (M, 3), to the end."""
    for i in range(path.shape[1]):
        mug, angle, spin = limit[i], out[i, 1], out[i, 2]
        off, fast = 0.0, 0.0  # of the centre [m], [m/s]
        ux, uy = _slip(pose, twist, path, speed, 0, i)
        for k in range(1, len(time)):
            h = time[k] - time[k - 1]
            wx, wy = _slip(pose, twist, path, speed, k, i)
            none = STUCK * mug * h + STILL
            least = sqrt(min(ux * ux + uy * uy, wx * wx + wy * wy))
            change = sqrt((wx - ux) ** 2 + (wy - uy) ** 2)
            felt, pieces = mug, 1 if change < least else DIP
            if least <= none and change <= none:  # it sticks: friction is what it takes
                ax = (speed[k, i, 0] - speed[k - 1, i, 0]) / h - pull[0]
                ay = (speed[k, i, 1] - speed[k - 1, i, 1]) / h - pull[1]
                felt, pieces = min(mug, sqrt(ax * ax + ay * ay)), 1
            dt = h / pieces
            for piece in range(1, pieces + 1):
                share = piece / pieces
                sx, sy = ux + share * (wx - ux), uy + share * (wy - uy)
                turn = twist[k - 1, 2] + share * (twist[k, 2] - twist[k - 1, 2])
                slip, rim = sqrt(sx * sx + sy * sy), radius * abs(turn - spin)
                force, torque = 1.0, 0.0
                if rim > STILL:
                    _, torque = disc_force(slip, rim)
                    force, _ = disc_force(slip + fast, rim)
                aside = abs(turn) * off
                blur = min(1.0, aside / (slip + fast)) if aside > 0 and slip + fast > 0 else 0.0
                fast = max(0.0, fast + dt * (felt - mug * (force - blur)))
                off += dt * fast
                # Inertia m R^2/2: the torque mu m g R gives 2 mu g/R, and holds once it can
                push = min(2 * mug / radius * torque * dt, abs(turn - spin))
                before = spin
                spin += push if turn > spin else -push
                angle += 0.5 * dt * (before + spin)
            ux, uy = wx, wy
        out[i, 0], out[i, 1], out[i, 2] = off, angle, spin


@njit(cache=True, nogil=True, error_model="numpy")
def _slip(pose, twist, path, speed, k, i):
    """Velocity of the surface under part i less its own, at sample k: equation (2)."""
    turn = twist[k, 2]
    return (
        twist[k, 0] - turn * (path[k, i, 1] - pose[k, 1]) - speed[k, i, 0],
        twist[k, 1] + turn * (path[k, i, 0] - pose[k, 0]) - speed[k, i, 1],
    )
