"""Ids over thousands of images of whole sorts, against the true parts; noise of the drift."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from harness import Result, Table
from harness.loop import Moment, Setup, run
from plate_core import Parts, load_rig, part_class
from plate_core.tasks import load_scenario
from plate_sim import Disturbances, Simulation
from plate_sim.world import NONE
from plate_vision import Tracker, make_vision, observe

FRAMES, DIRTY_FRAMES = 10_000, 2_000
"""Images of the clean world and of each of the others."""

FIRST_SEED = 20_000
"""Of the sorts that are looked at; others than any that were tuned on."""

WORLDS = {
    "clean": NONE,
    "uneven friction": Disturbances(friction_spread=0.1, friction_patches=0.1),
    "5 % of parts missed": Disturbances(missed_parts=0.05),
    "5 % missed, 2 % false": Disturbances(missed_parts=0.05, false_parts=0.02),
}

STILL_S = 20.0
"""How long still parts are looked at, for the noise of their drift [s]."""

STILL_RATE = 30.0
"""Images a second of that."""


@dataclass
class Identities:
    """Compares ids with true names, image by image of one run.

    Attributes
    ----------
    reach : float
        Nearer than this to a true part [m], what is seen is that part.
    near : float
        Distance of two parts of one class that counts as a near pass [m].
    owner : dict
        True name of each id.
    """

    reach: float
    near: float
    owner: dict[str, str] = field(default_factory=dict)
    named: dict[str, str] = field(default_factory=dict)
    count: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("frames", "swaps", "renamed", "ghosts", "near"), 0)
    )
    closest: float = np.inf

    def take(self, parts: Parts, names: tuple[str, ...], position: np.ndarray) -> None:
        """Compare what is seen with true parts `names` at `position` (M, 2) [m]."""
        self.count["frames"] += 1
        self._passes(names, position)
        for name, place in zip(parts.ids, parts.position, strict=True):
            gap = np.linalg.norm(position - place, axis=1)
            true = int(np.argmin(gap))
            if gap[true] > self.reach:
                self.count["ghosts"] += 1
                continue
            self.count["swaps"] += self.owner.setdefault(name, names[true]) != names[true]
            self.count["renamed"] += self.named.setdefault(names[true], name) != name
            self.owner[name], self.named[names[true]] = names[true], name

    def _passes(self, names: tuple[str, ...], position: np.ndarray) -> None:
        kind = np.array([part_class(name) for name in names])
        gap = np.linalg.norm(position[:, None] - position, axis=2)
        pair = np.triu(kind[:, None] == kind, 1)
        self.closest = min(self.closest, float(np.min(gap[pair], initial=np.inf)))
        self.count["near"] += int(np.count_nonzero(gap[pair] < self.near))


def sorts(disturbances: Disturbances, frames: int, first_seed: int) -> Iterator[list[Moment]]:
    """Yield whole runs of `sort_10` until there are enough images."""
    seed = first_seed
    while frames > 0:
        moments = list(run(Setup("sort_10", seed, disturbances=disturbances)))
        yield moments[:frames]
        frames -= len(moments)
        seed += 1


def measure(quick: bool) -> Result:
    """Count swaps of ids in each world, and measure the noise of the drift."""
    rig = load_rig()
    rows = []
    worlds = {"clean": NONE} if quick else WORLDS
    for world, disturbances in worlds.items():
        total = Identities(0.5 * rig.parts.radius_m, 2.5 * rig.parts.radius_m)
        runs, frames = 0, FRAMES if world == "clean" else DIRTY_FRAMES
        for moments in sorts(disturbances, 100 if quick else frames, FIRST_SEED):
            runs += 1
            total = replace(total, owner={}, named={})
            for moment in moments:
                on = moment.world.on_plate
                names = tuple(n for n, there in zip(moment.world.ids, on, strict=True) if there)
                total.take(moment.parts, names, moment.world.position[on])
        rows.append(
            {"world": world, "runs": runs, **total.count, "closest_mm": 1e3 * total.closest}
        )
    noise = drift_noise(2.0 if quick else STILL_S)
    return Result([identity_table(rows), noise_table(noise)], sentences(rows, noise))


def drift_noise(seconds: float) -> dict[str, Any]:
    """Noise of the drift of still parts on the default rig."""
    rig = load_rig()
    simulation = Simulation(rig, load_scenario("sort_10"), FIRST_SEED)
    vision, tracker, drift = make_vision(rig), Tracker(), []
    for k in range(int(seconds * STILL_RATE)):
        image = simulation.capture()
        if image is not None:
            tracker = observe(vision, tracker, image, k / STILL_RATE)
            drift.append(tracker.parts.velocity)
    still = 1e3 * np.array(drift[1:])  # the first image knows no drift
    return {
        "frames": len(still),
        "parts": still.shape[1],
        "rms_mm_s": float(still.std()),
        "worst_mm_s": float(still.std(axis=0).max()),
        "largest_mm_s": float(np.abs(still).max()),
    }


def identity_table(rows: list[dict[str, Any]]) -> Table:
    """Return the table of ids."""
    return Table(
        "identity",
        "ids over images of whole sorts",
        {
            "world": "world", "runs": "runs", "frames": "images", "near": "near passes",
            "closest_mm": "closest centres [mm]", "swaps": "swapped ids",
            "renamed": "new ids of known parts", "ghosts": "ids of nothing",
        },
        rows,
        "sort_10 in the closed loop, image noise on, parts of 8 mm radius. Near "
        "passes: pairs of one class and images in which their centres are within 2.5 radii.",
    )  # fmt: skip


def noise_table(row: dict[str, Any]) -> Table:
    """Return the table of the drift's noise."""
    return Table(
        "drift_noise",
        f"drift of still parts, {STILL_RATE:g} images a second",
        {
            "parts": "parts", "frames": "images", "rms_mm_s": "standard deviation [mm/s]",
            "worst_mm_s": "of the worst part [mm/s]", "largest_mm_s": "largest [mm/s]",
        },
        [row],
        "Default rig and camera noise; the drift is that of the last two images.",
    )  # fmt: skip


def sentences(rows: list[dict[str, Any]], noise: dict[str, Any]) -> list[str]:
    """Sum up."""
    told = [
        f"{r['world']}: {r['swaps']} ids swapped, {r['renamed']} parts named anew in {r['frames']} "
        f"images with {r['near']} near passes"
        for r in rows
    ]
    return [
        *told,
        f"drift of still parts: {noise['rms_mm_s']:.2f} mm/s, worst part {noise['worst_mm_s']:.2f}",
    ]
