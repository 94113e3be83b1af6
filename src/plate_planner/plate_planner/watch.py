"""What the planner makes of the images: where the parts are, and where its answer finds them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts, PlateCycle, Rig, part_class
from plate_core.tasks import Scenario

from .ages import Ages
from .estimation import Belief, carried
from .plate_log import PlateLog

COAST = 5
"""Images for which a part that is not seen is carried on: as long as vision keeps its name."""


@dataclass(frozen=True)
class Watch:
    """The parts as last seen, and the plate's motion since.

    Attributes
    ----------
    friction_accel, mass : float
        mu g of the rig [m/s2], and of a part [kg].
    stamp : float
        Of the last image [s].
    seen : Parts
        As vision saw them.
    log : PlateLog
    ages : Ages
        Beliefs, by how old an image is at its stamp.
    """

    friction_accel: float
    mass: float
    stamp: float = 0.0
    seen: Parts = field(default_factory=lambda: Parts.make((), np.zeros((0, 2))))
    log: PlateLog = field(default_factory=PlateLog)
    ages: Ages = field(default_factory=lambda: Ages.known(0.0))

    def hear(self, cycle: PlateCycle, arrival: float) -> Watch:
        """Take in a cycle that was sent to the plate, and when [s, the time of the stamps]."""
        return replace(self, log=self.log.hear(cycle, arrival))

    def look(self, parts: Parts, t: float) -> Watch:
        """Take in one image: its parts and its stamp [s]."""
        log = self.log.advance(t)
        ages = self.ages.see(log, parts, t, self.friction_accel, COAST)
        return replace(self, stamp=t, seen=parts, log=log, ages=ages)

    @property
    def belief(self) -> Belief:
        """What is known of the parts."""
        return self.ages.belief

    @property
    def parts(self) -> Parts:
        """The parts at the stamp; as they were seen, as long as the plate's motion is not known."""
        if not self.log.known:
            return self.seen
        return self.belief.parts(self.log, self.stamp, self.friction_accel, self.mass)

    def surprise(self, ids: tuple[str, ...]) -> np.ndarray:
        """Drift (K, 2) [m/s] that parts have beyond what is foretold; 0 while that is not known."""
        if not (self.log.known and self.ages.found):
            return np.zeros((len(ids), 2))
        row = {name: i for i, name in enumerate(self.belief.ids)}
        return self.belief.surprise[[row[name] for name in ids]]

    def ahead(self, ids: tuple[str, ...]) -> np.ndarray | None:
        """Where parts will be (K, 2) [m] when the answer to the last image begins to act.

        None as long as the plate's motion is not known.
        """
        if not self.log.known:
            return None
        row = {name: i for i, name in enumerate(self.belief.ids)}
        state = self.belief.mean[[row[name] for name in ids]]
        return carried(self.log, state, self.belief.time, self.log.end, self.friction_accel)[:, :2]


def on_plate(parts: Parts, rig: Rig) -> Parts:
    """Leave out parts whose centre is beyond the plate's edge: they have fallen off."""
    keep = np.all(np.abs(parts.position) <= rig.plate.half, axis=1)
    if np.all(keep):
        return parts
    return parts.take(np.flatnonzero(keep))


def missing_parts(scenario: Scenario, known: tuple[str, ...], parts: Parts) -> tuple[str, ...]:
    """Name the parts of the scenario that are not there, by id where it is `known`."""
    there = Counter(part_class(i) for i in parts.ids)
    names: list[str] = []
    for label, wanted in Counter(scenario.labels).items():
        short = wanted - there[label]
        if short <= 0:
            continue
        gone = [i for i in known if part_class(i) == label and i not in parts.ids]
        names += gone[:short] if len(gone) >= short else [f"{short} of {wanted} {label} parts"]
    return tuple(names)


def warm_up() -> None:
    """Compile the motion model before the first image comes."""
    part = Parts.make(("part_1",), np.zeros((1, 2)))
    watch = Watch(1.0, 1.0).look(part, 0.0).hear(PlateCycle.rest(0.1), 0.0)
    watch.look(part, 0.1).ahead(part.ids)
