"""What is asked of the parts: an interval of drift on each axis, and the force that says so."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import Parts, Rig

FRESH = 1.5
"""A request is what the present cycle does if it is at most this many periods old."""


@dataclass(frozen=True)
class DriftRequest:
    """Any drift from `low` to `high`, each (M, 2) [m/s, plate_home], is as good as any other."""

    low: np.ndarray
    high: np.ndarray

    @property
    def centre(self) -> np.ndarray:
        """Middle of the interval (M, 2) [m/s]."""
        return (self.low + self.high) / 2

    def force(
        self, velocity: np.ndarray, rig: Rig, period: float, share_max: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean force over a cycle that leads from the present drift to the wanted.

        F = m (v_wanted - v)/T. Whoever knows v gets v_wanted back, so an error of v, as
        measured, does not matter, as long as the force is within its bound.

        Parameters
        ----------
        velocity : (M, 2)
            Present drift [m/s, plate_home].
        rig : Rig
        period : float
            Length of a cycle, T [s].
        share_max : float
            Greatest component of the force, in mu m g.

        Returns
        -------
        force, tolerance : (M, 2)
            Middle and half width of the wanted force [N].
        """
        gain = rig.parts.mass_kg / period
        bound = share_max * rig.force_unit
        return (
            np.clip(gain * (self.centre - velocity), -bound, bound),
            gain * (self.high - self.low) / 2,
        )


@dataclass(frozen=True)
class Asked:
    """The last request: what drift (M, 2) [m/s, plate_home] was asked of which part, and when.

    `force` (M, 2) [N] is what it took.
    """

    ids: tuple[str, ...] = ()
    drift: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    stamp: float = -np.inf
    force: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def places(self, parts: Parts, t: float, period: float) -> np.ndarray:
        """Where parts (M, 2) [m] seen at t [s] are a cycle later, if they do as they were asked.

        Parts that were not asked go on drifting.
        """
        drift = parts.velocity.copy()
        if t - self.stamp <= FRESH * period:
            row = {part_id: i for i, part_id in enumerate(self.ids)}
            for i, part_id in enumerate(parts.ids):
                if part_id in row:
                    drift[i] = self.drift[row[part_id]]
        return parts.position + period * drift


def stay_within(
    coordinate: np.ndarray, half: float, inner: float, outer: float, speed: float, wander: float
) -> tuple[np.ndarray, np.ndarray]:
    """Leave a coordinate free in the middle, and ask it back near the plate's edges.

    Up to `inner` (share of the half side) any drift within +-wander will do; from there to
    `outer` the interval narrows to one value, and its middle goes from 0 to `speed` inwards.

    Parameters
    ----------
    coordinate : (M,)
        x or y [m, plate_home].
    half : float
        Half side of the plate along it [m].
    inner, outer : float
        Where the edge begins to count, and where it counts fully [share of half].
    speed : float
        Drift asked for at the edge [m/s].
    wander : float
        Drift allowed in the middle [m/s].

    Returns
    -------
    low, high : (M,)
        Interval of drift [m/s].
    """
    edge = nearness(coordinate, half, inner, outer)
    middle = -speed * edge * np.sign(coordinate)
    width = wander * (1 - edge)
    return middle - width, middle + width


def nearness(coordinate: np.ndarray, half: float, inner: float, outer: float) -> np.ndarray:
    """How near an edge is: 0 up to `inner`, 1 from `outer` (shares of half), linear between."""
    return np.clip((np.abs(coordinate) / half - inner) / (outer - inner), 0, 1)
