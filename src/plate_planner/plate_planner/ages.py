"""How old an image is at its stamp: beliefs at several ages, and which the motion bears out.

A camera's latency is seldom known, and parts on the plate move by millimetres in 10 ms. Beliefs
side by side take the images to be of different ages; the one that best foretells the next image is
believed, and the ages draw closer around it until one is left.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts

from .estimation import Belief
from .plate_log import PlateLog

STEPS = np.arange(-2, 3)
"""Ages looked at, in steps from the middle one."""

COARSE_S, FINE_S = 0.025, 0.5e-3
"""First and last distance of neighbouring ages [s]: from 0 to 0.1 s is looked at first; what 0.5 ms
makes is hardly above the camera's noise."""

OLDEST_S = 0.5
"""No image is taken to be older [s]."""

LOOKS, CLEAR, FORGET = 4, 4.0, 0.9
"""An age is chosen after so many images at the least, once the worst age foretells them so many
times worse than the best; what older images tell fades by this factor an image."""

SETTLED = 40
"""Ages that so many images do not tell apart are equally good, and one is kept."""


@dataclass(frozen=True)
class Ages:
    """Beliefs by age.

    Attributes
    ----------
    ages : (A,)
        Rising [s].
    beliefs : tuple of Belief
        One for each age.
    best : int
        Which one is believed.
    misfit : (A,)
        Squared distances of parts from where each belief foretold them [m2], fading.
    looks : int
        Images of a plate in motion since the ages were set.
    """

    ages: np.ndarray
    beliefs: tuple[Belief, ...]
    best: int = 0
    misfit: np.ndarray = field(default_factory=lambda: np.zeros(len(STEPS)))
    looks: int = 0

    @classmethod
    def known(cls, age: float | None) -> Ages:
        """Return beliefs at one age [s], or at several if it is to be found out."""
        ages = COARSE_S * (STEPS - STEPS[0]) if age is None else np.array([age])
        return cls(ages, (Belief(),) * len(ages), misfit=np.zeros(len(ages)))

    @property
    def age(self) -> float:
        """Age that is believed [s]."""
        return float(self.ages[self.best])

    @property
    def found(self) -> bool:
        """Whether the age is known, but for a few milliseconds."""
        return bool(np.ptp(self.ages) < COARSE_S * np.ptp(STEPS))

    @property
    def belief(self) -> Belief:
        """The belief at that age."""
        return self.beliefs[self.best]

    def see(self, log: PlateLog, parts: Parts, t: float, friction_accel: float, most: int) -> Ages:
        """Take in the parts of an image with stamp t [s]; see `Belief.see`."""
        beliefs = tuple(
            belief.see(log, parts, t - age, friction_accel, most)
            for belief, age in zip(self.beliefs, self.ages, strict=True)
        )
        misfit = FORGET * self.misfit + [belief.misfit for belief in beliefs]
        moved = any(np.any(cycle.knot_pose) for _, cycle in log.runs[-2:])
        seen = replace(self, beliefs=beliefs, misfit=misfit, looks=self.looks + moved)
        step = np.ptp(self.ages) / len(STEPS[1:])
        if seen.looks >= LOOKS and np.max(misfit) > CLEAR * np.min(misfit):
            best = int(np.argmin(misfit))
            return seen._closer(best, log, t, friction_accel) if step > FINE_S else seen._one(best)
        return seen._one(self.best) if seen.looks >= SETTLED and 0 < step < COARSE_S else seen

    def _one(self, k: int) -> Ages:
        """Keep one age."""
        return Ages(self.ages[k : k + 1], self.beliefs[k : k + 1], misfit=np.zeros(1))

    def _closer(self, best: int, log: PlateLog, t: float, friction_accel: float) -> Ages:
        """Set the ages anew around the best."""
        step = self.ages[1] - self.ages[0]
        at_end = best == len(STEPS) - 1 or (best == 0 and self.ages[0] > 0)
        step = min(2 * step, COARSE_S) if at_end else max(step / 2, FINE_S)
        middle = np.clip(self.ages[best], -STEPS[0] * step, OLDEST_S - STEPS[-1] * step)
        ages = middle + step * STEPS
        beliefs = []
        for age in ages:
            older = min(int(np.searchsorted(self.ages, age - 1e-9)), len(STEPS) - 1)
            beliefs.append(self.beliefs[older].taken_at(log, t - age, friction_accel))
        nearest = int(np.argmin(np.abs(ages - self.ages[best])))
        return Ages(ages, tuple(beliefs), nearest)
