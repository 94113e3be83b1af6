"""Method A: minimum separation of two parts, by the number of centres of rotation."""

from __future__ import annotations

import numpy as np

from maps.grid import Grid, StabilityMap, grid
from plate_core import Rig, load_rig
from plate_solver import manipulability
from plate_solver.library import REACH, Library

LEVEL = 0.1
"""Guaranteed force that counts as sufficient [mu m g]. Tasks that sort ten parts need about this
force."""

GRIDS = ((4, 2), (6, 3), (8, 4), (12, 6), (17, 9), (24, 13), (30, 16), (48, 26))
"""Numbers of centres along and across the plate. The solver's library has 30 x 16."""

SEPARATIONS_M = 1e-3 * np.geomspace(1, 200, 13)

SEED = 81
PAIRS = 15
"""Number of random pairs for each cell."""


def spacing(rig: Rig, centres: int) -> float:
    """Return the distance between neighbouring centres [m], if they are spread as in the
    library."""
    sides = 2 * np.multiply(REACH, rig.plate.half)
    return float(np.sqrt(np.prod(sides) / centres))


def min_separation(rig: Rig, centres: float) -> float:
    """Return the separation d [m] below which the force `LEVEL` cannot be guaranteed.

    Let a centre of rotation be at the distance r from both parts. Its arms are the lines to the
    parts. Let b be the angle between an arm and the line through both parts. The two directions of
    motion differ by the angle between the arms, d sin(b)/r. Half of this difference separates the
    parts. The component of this half along the line between the parts is d sin(2 b)/(4 r), at most
    d/(4 r). A second centre on the other side cancels the common part of the forces and separates
    the parts by the same amount again. The centres are a grid with the spacing h, so the nearest
    centres are at r = h. Hence force = d/(4 h) for d < h. Section 3.1.5 of the paper only states
    that parts near each other are difficult.
    """
    return 4 * LEVEL * spacing(rig, int(centres))


def guaranteed_force(rig: Rig, library: Library, separation: float, pairs: int) -> float:
    """Return the guaranteed force of two parts [mu m g]: the median of `manipulability` over random
    positions."""
    rng = np.random.default_rng(SEED)
    forces = []
    for _ in range(pairs):
        angle, middle = rng.uniform(0, 2 * np.pi), rng.uniform(-0.6, 0.6, 2) * rig.plate.half
        arm = separation / 2 * np.array([np.cos(angle), np.sin(angle)])
        forces.append(
            manipulability(rig, np.array([middle - arm, middle + arm]), library).weakest_force
        )
    return float(np.median(forces))


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig = load_rig()
    spread = GRIDS[::3] if quick else GRIDS
    separations = SEPARATIONS_M[::2] if quick else SEPARATIONS_M
    centres = [columns * rows for columns, rows in spread]
    libraries = [Library.around(rig.plate.half, *sides) for sides in spread]
    z = [
        [guaranteed_force(rig, library, d, 4 if quick else PAIRS) for library in libraries]
        for d in separations
    ]
    line = np.geomspace(centres[0], centres[-1], 20).round()
    minima = [1e3 * min_separation(rig, n) for n in line]
    return [grid(centres, 1e3 * separations, z, line, minima)]


MAP = StabilityMap(
    key="separation",
    title="Two parts close together: their distance and the number of centres, Method A",
    x_label="centres of rotation",
    y_label="distance of the two parts [mm]",
    z_label="guaranteed force [mu mg]",
    line_label=f"distance = 4 · {LEVEL:g} · spacing of the centres",
    level=LEVEL,
    measure=measure,
    bounds=(0.0, 0.4),
    log="xy",
    finding="The nearer two parts are to each other, the smaller is the guaranteed force that can "
    "separate them. A library with more centres of rotation increases this force.",
    note=f"Values are medians of {PAIRS} random pairs. The force is the root mean square over both "
    "parts.",
)
