"""One run of the world as node and bench see it: images out, plate cycles in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from plate_core import PlateCycle, PlateError, Rig, part_class
from plate_core.rig import row_delay
from plate_core.tasks import Scenario

from ..camera import NOISE, Camera, part_greys
from ..contacts import INELASTIC, Contacts
from ..plate import PlateMotion, PlateState, realise
from .disturbances import NONE, Disturbances
from .friction_field import FrictionField
from .history import History, Passage
from .state import WorldState
from .step import record_cycle, run_cycle

EXPOSURES, LONGEST_STEP_S = 5, 3e-3
"""Least number of times during an image at which parts and plate are looked up, and the greatest
distance between two [s]: the plate turns round in no less than 20 ms."""

WORLD_RANGES = {"noise": (0.0, 50.0), "mu_scale": (0.1, 10.0)}
"""Of a simulation: allowed values."""

FINEST_STAMP_S = 1e-4
"""Least distance of two stamps [s]."""

BANDS = 8
"""Bands of rows in which a rolling shutter shows the plate's edges."""


@dataclass(frozen=True)
class Shot:
    """An image of a camera that runs free: the middle of its exposure, its stamp, and when it is
    delivered [s]."""

    middle: float
    stamp: float
    delivered: float


class Simulation:
    """A scenario's parts on a rig's plate.

    Parameters
    ----------
    rig : Rig
        What all stages believe of the rig; with a suspension the plate does not quite obey.
    scenario : Scenario
        Gives the parts.
    seed : int
        Of all chance; what one kind of disturbance draws does not depend on the others.
    disturbances : Disturbances
        What is unlike the rig's facts.
    noise : float
        Standard deviation of a pixel [grey values].
    mu_scale : float
        True friction over the rig's.
    contacts : Contacts

    Raises
    ------
    PlateError
        If noise or mu_scale is out of range.
    """

    def __init__(
        self,
        rig: Rig,
        scenario: Scenario,
        seed: int = 0,
        disturbances: Disturbances = NONE,
        *,
        noise: float = NOISE,
        mu_scale: float = 1.0,
        contacts: Contacts = INELASTIC,
    ) -> None:
        for name, value in (("noise", noise), ("mu_scale", mu_scale)):
            low, high = WORLD_RANGES[name]
            if not low <= value <= high:
                raise PlateError(f"{name} is {value:g}, allowed: {low:g} to {high:g}")
        if disturbances.image_rate > 0 and rig.camera.trigger is not None:
            raise PlateError(
                f"image_rate is {disturbances.image_rate:g} with a trigger_phase, allowed: 0, "
                "as the rig file has the motor controller trigger the camera"
            )
        layout, self._pixel_rng, field, self._image_rng, self._part_rng, self._stamp_rng = (
            np.random.default_rng(seed).spawn(6)
        )
        self.state = WorldState.of_scenario(scenario, rig, layout)
        self.plate = PlateState.at_rest()
        self.disturbances = disturbances
        self._rig, self._contacts = rig, contacts
        self._mu = rig.friction.mu * mu_scale
        self._field = FrictionField.draw(disturbances, len(self.state.ids), field)
        self._camera = Camera(rig, noise)
        self._grey = part_greys([part_class(name) for name in self.state.ids])
        self._history = History()
        self._marked = scenario.marked

    @property
    def mu(self) -> np.ndarray:
        """True friction coefficients (M,) now."""
        return self._field.friction(self._mu, self.state.position, self.plate.pose)

    def shots(self, begin: float) -> Iterator[Shot]:
        """Yield the images of a camera that runs free, from `begin` [s] on, without end."""
        camera, world, rng = self._rig.camera, self.disturbances, self._stamp_rng
        interval, last = 1 / max(world.image_rate, 1e-9), -np.inf
        shown = camera.exposure_s + camera.readout_s
        middle = begin + interval * rng.random()
        while True:
            jitter = world.stamp_jitter * rng.standard_normal()
            # A camera's driver stamps images in the order in which they come.
            last = max(middle + world.latency + jitter, last + FINEST_STAMP_S)
            yield Shot(middle, last, middle + max(world.latency, shown / 2))
            middle += interval

    def capture(self, age: float | None = None) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered now; None if it is missed.

        `age` is the time since the middle of its exposure [s]; if None its exposure began
        `latency` ago.
        """
        missed = self._image_rng.random() < self.disturbances.missed_images
        hidden = self._part_rng.random(len(self._grey)) < self.disturbances.missed_parts
        false = self._part_rng.binomial(len(self._grey), self.disturbances.false_parts)
        place = self._rig.plate.half * self._part_rng.uniform(-1, 1, (false, 2))
        grey = self._part_rng.choice(self._grey, false)
        if missed:
            return None
        path, angle, seen, pose = self._view(age)
        seen = seen & ~hidden
        spots = np.broadcast_to(place, (len(path), false, 2))
        return self._camera.render(
            np.concatenate([path[:, seen], spots], axis=1),
            np.concatenate([self._grey[seen], grey]),
            self._pixel_rng,
            pose=pose,
            angle=np.append(angle[seen], np.zeros(false)) if self._marked else None,
        )

    def run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Command a cycle, or what a motor controller has played, and move the parts to its end."""
        motion: PlateCycle | PlateMotion = cycle
        mu, ground = self.mu, self.disturbances.ground
        if self._rig.suspension is not None:
            motion, self.plate = realise(self._rig, self.plate, cycle)
        world: dict[str, Any] = {"contacts": self._contacts, "ground": ground}
        if not self._past:
            self.state = run_cycle(self.state, motion, self._rig, mu, **world)
            return
        self.state, run = record_cycle(self.state, motion, self._rig, mu, **world)
        plate = PlateMotion(motion.times, motion.coefficients)
        self._history = self._history.after(Passage(plate, run, self.state.on_plate), self._past)

    @property
    def _past(self) -> float:
        """How much of the past an image may show [s]."""
        camera = self._rig.camera
        shown = camera.exposure_s + camera.readout_s
        anytime = self.disturbances.image_rate > 0 or camera.trigger is not None
        needed = anytime or camera.readout_s > 0
        return self.disturbances.latency + (shown if needed else 0.0)

    def _view(
        self, age: float | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """Return positions over the exposure (s, M, 2), angles (M,), which parts are there, and the
        plate's poses (s, 3), or (b, s, 3) by bands of rows; None if it is at home."""
        state, camera = self.state, self._rig.camera
        exposure = camera.exposure_s if self.disturbances.blur else 0.0
        if self._past and self._history.passages:
            shown = exposure + camera.readout_s
            first = self.disturbances.latency if age is None else age + shown / 2
            return self._past_view(first, exposure, shown)
        later = np.array([0.0, exposure])[:, None]
        path = state.position + later[:, None] * state.velocity
        if self._rig.suspension is None:
            return path, state.angle, state.on_plate, None
        pose = self.plate.pose + later * self.plate.twist
        return path, state.angle, state.on_plate, pose

    def _past_view(
        self, first: float, exposure: float, shown: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the same of an image whose first row began to be exposed `first` [s] ago; from
        then to the end of its last row it is `shown` [s]."""
        count = max(EXPOSURES, 1 + int(np.ceil(shown / LONGEST_STEP_S)))
        time = shown * np.linspace(0, 1, count)
        views = [self._history.ago(first - t) for t in time]
        path, pose = (np.stack([getattr(v, n) for v in views]) for n in ("position", "pose"))
        middle, readout = views[count // 2], self._rig.camera.readout_s
        if readout == 0:
            return path, middle.angle, middle.on_plate, pose
        row = np.clip(row_delay(self._rig, middle.position) / readout + 0.5, 0, 1)
        begin = readout * np.append(row, (np.arange(BANDS) + 0.5) / BANDS)
        at = begin[:, None] + exposure * np.linspace(0, 1, EXPOSURES)
        parts = len(row)
        seen = np.empty((EXPOSURES, parts, 2))
        for i in range(parts):
            for axis in range(2):
                seen[:, i, axis] = np.interp(at[i], time, path[:, i, axis])
        poses = np.empty((BANDS, EXPOSURES, 3))
        for band in range(BANDS):
            for axis in range(3):
                poses[band, :, axis] = np.interp(at[parts + band], time, pose[:, axis])
        return seen, middle.angle, middle.on_plate, poses
