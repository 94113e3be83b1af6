"""One cycle of the plate by each model of the ladder: the same scene in, the same outcome out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np

from plate_core import PlateCycle

from .bodies import STEP as BODY_STEP
from .bodies import run_bodies
from .contacts import Contacts, check_found, motion_of, run_discs
from .footprint import Footprint, disc
from .friction import STEP, Trajectory, default_steps
from .plate_motion import PlateMotion

AUTO, POINTS, DISCS, BODIES = "auto", "points", "discs", "bodies"
"""Names of the models; `auto`: the cheapest that will do (`ladder`)."""

MODELS = (AUTO, POINTS, DISCS, BODIES)


@dataclass(frozen=True)
class Scene:
    """M round parts at the start of a cycle, and all that moves them. Frame: plate_home.

    Attributes
    ----------
    ids : tuple of str
        Names of the parts.
    motion : PlateCycle or PlateMotion
        Of the plate, one cycle.
    limit : (M,)
        mu g [m/s2].
    pull : (2,)
        Acceleration without friction [m/s2].
    static_ratio : float
        Static over dynamic friction.
    radius : float
        Of all parts [m].
    half : (2,)
        Half sides of the plate [m].
    contacts : Contacts
    step : float or None
        Longest integration step [s]; None: the model's own.
    position, velocity : (M, 2)
        [m], [m/s].
    angle, spin : (M,)
        [rad], [rad/s].
    on_plate : (M,)
        Which parts are there.
    """

    ids: tuple[str, ...]
    motion: PlateCycle | PlateMotion
    limit: np.ndarray
    pull: np.ndarray
    static_ratio: float
    radius: float
    half: np.ndarray
    contacts: Contacts
    step: float | None
    position: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    on_plate: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """What became of a scene: its parts at the cycle's end, and their motion at every step.

    Attributes as of `Scene`; `run` has no samples unless they were asked for.
    """

    position: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    on_plate: np.ndarray
    run: Trajectory


def run_model(scene: Scene, model: str, record: float | None = None) -> Outcome:
    """Run one cycle by `points`, `discs` or `bodies`; the first two keep angles as they are.

    Parameters
    ----------
    scene : Scene
    model : str
    record : float, optional
        Time [s] from one sample to the next, at most; 0: every step. None: no samples.

    Raises
    ------
    PlateError
        If a state is not finite, or parts that may touch overlap at the start.
    """
    if model == BODIES:
        return _bodies(scene, record)
    return _round(scene, 0.0 if model == POINTS else scene.radius, record)


def _round(scene: Scene, radius: float, record: float | None) -> Outcome:
    """Run parts whose centres feel the friction; with radius 0 they never meet."""
    contacts, count = scene.contacts, len(scene.ids)
    steps = default_steps(scene.motion, STEP if scene.step is None else scene.step)
    step = scene.motion.period / steps
    rows = samples(steps, step, record)
    path, speed = np.empty((2, len(rows), count, 2))
    position, velocity, on_plate = (
        np.array(a, order="C") for a in (scene.position, scene.velocity, scene.on_plate)
    )
    found = run_discs(
        *motion_of(scene.motion), steps, 1, scene.limit, scene.pull, scene.static_ratio, radius,
        scene.half, contacts.restitution, contacts.friction, contacts.walls, position, velocity,
        on_plate, path, speed,
    )  # fmt: skip
    check_found(found, scene.ids, scene.radius)
    spin = np.where(on_plate, scene.spin, 0.0)
    return Outcome(
        position, velocity, scene.angle, spin, on_plate, Trajectory(rows * step, path, speed)
    )


def _bodies(scene: Scene, record: float | None) -> Outcome:
    """Run discs on which friction acts all over."""
    end, on_plate, path = run_bodies(
        scene.motion, _footprint(scene.radius), scene.limit, scene.pull, scene.static_ratio,
        scene.contacts, scene.half, scene.position, scene.angle, scene.velocity, scene.spin,
        scene.on_plate, BODY_STEP if scene.step is None else scene.step, 1, record is not None,
        scene.ids,
    )  # fmt: skip
    steps = max(1, len(path.time) - 1)
    rows = samples(steps, scene.motion.period / steps, record)
    run = Trajectory(path.time[rows], path.position[rows], path.velocity[rows])
    return Outcome(end.position, end.velocity, end.angle, end.spin, on_plate, run)


def samples(steps: int, step: float, record: float | None) -> np.ndarray:
    """Return the numbers of the steps, of `step` [s] each, whose state is recorded."""
    if record is None:
        return np.arange(0)
    fewest = ceil(steps / max(1, int(record / step + 1e-9)))
    every = ceil(steps / fewest)
    return np.append(np.arange(0, steps, every), steps)


@lru_cache(maxsize=8)
def _footprint(radius: float) -> Footprint:
    return disc(radius)
