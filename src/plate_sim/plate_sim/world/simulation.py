"""One run of the world as node and bench see it: images out, plate cycles in."""

from __future__ import annotations

from typing import Any

import numpy as np

from plate_core import PlateCycle, Rig, part_class
from plate_core.tasks import Scenario

from ..camera import NOISE, Camera, part_greys
from ..contacts import INELASTIC, Contacts
from ..plate import PlateMotion, PlateState, realise
from .disturbances import NONE, Disturbances
from .friction_field import FrictionField
from .history import History, Passage
from .state import WorldState
from .step import record_cycle, run_cycle

EXPOSURES = 5
"""Times during an exposure of the past at which parts and plate are looked up: the plate turns
round in no less than 20 ms, an exposure takes a few."""


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
        layout, self._pixel_rng, field, self._image_rng, self._part_rng = np.random.default_rng(
            seed
        ).spawn(5)
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
        self._turned = self.state.angle  # at the start of the last cycle
        self._period = 1.0  # its length

    @property
    def mu(self) -> np.ndarray:
        """True friction coefficients (M,) now."""
        return self._field.friction(self._mu, self.state.position, self.plate.pose)

    def capture(self) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered now; None if it is missed."""
        missed = self._image_rng.random() < self.disturbances.missed_images
        hidden = self._part_rng.random(len(self._grey)) < self.disturbances.missed_parts
        false = self._part_rng.binomial(len(self._grey), self.disturbances.false_parts)
        place = self._rig.plate.half * self._part_rng.uniform(-1, 1, (false, 2))
        grey = self._part_rng.choice(self._grey, false)
        if missed:
            return None
        path, seen, pose = self._view()
        seen = seen & ~hidden
        spots = np.broadcast_to(place, (len(path), false, 2))
        return self._camera.render(
            np.concatenate([path[:, seen], spots], axis=1),
            np.concatenate([self._grey[seen], grey]),
            self._pixel_rng,
            pose=pose,
            angle=np.append(self._angles()[seen], np.zeros(false)) if self._marked else None,
        )

    def _angles(self) -> np.ndarray:
        """Return the angles (M,) [rad] that an image shows; within a cycle taken as linear."""
        share = self.disturbances.latency / self._period
        return self.state.angle + share * (self._turned - self.state.angle)

    def run(self, cycle: PlateCycle | PlateMotion) -> None:
        """Command a cycle, or what a motor controller has played, and move the parts to its end."""
        motion: PlateCycle | PlateMotion = cycle
        mu, ground = self.mu, self.disturbances.ground
        self._turned, self._period = self.state.angle, cycle.period
        if self._rig.suspension is not None:
            motion, self.plate = realise(self._rig, self.plate, cycle)
        world: dict[str, Any] = {"contacts": self._contacts, "ground": ground}
        if self.disturbances.latency == 0:
            self.state = run_cycle(self.state, motion, self._rig, mu, **world)
            return
        self.state, run = record_cycle(self.state, motion, self._rig, mu, **world)
        plate = PlateMotion(motion.times, motion.coefficients)
        self._history = self._history.after(
            Passage(plate, run, self.state.on_plate), self.disturbances.latency
        )

    def _view(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return positions over the exposure (s, M, 2), which parts are there, and the plate's
        poses (s, 3); None if it is at home."""
        state, latency = self.state, self.disturbances.latency
        exposure = self._rig.camera.exposure_s if self.disturbances.blur else 0.0
        if latency > 0 and self._history.passages:
            ages = latency - exposure * np.linspace(0, 1, EXPOSURES)
            views = [self._history.ago(age) for age in ages]
            path, pose = (np.stack([getattr(v, n) for v in views]) for n in ("position", "pose"))
            return path, views[0].on_plate, pose
        later = np.array([0.0, exposure])[:, None]
        path = state.position + later[:, None] * state.velocity
        if self._rig.suspension is None:
            return path, state.on_plate, None
        return path, state.on_plate, self.plate.pose + later * self.plate.twist
