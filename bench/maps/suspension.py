"""Error of the plate's motion on a soft suspension, by natural frequency and solution method."""

from __future__ import annotations

import numpy as np

from maps.grid import Grid, StabilityMap, grid
from plate_core import PlateCycle, Rig, load_rig
from plate_sim import PlateState, realise
from plate_solver import Goal, RotationSolver, SinusoidSolver
from stages.learning import DAMPING, rig_on_flexures
from stages.scenes import random_positions

METHODS = {"sinusoids": SinusoidSolver, "rotations": RotationSolver}
PARTS = (1, 2, 4, 6, 10)
FREQUENCIES_HZ = np.geomspace(20, 320, 11)
DRIFT = 0.01
"""Standard deviation of the requested drifts [m/s]."""

REQUESTS = 3
"""Number of random requests for each cell."""

SEED = 86
SAMPLES = 1024
SETTLED = 4.0
"""Time after which the plate's motion is periodic [time constants of the suspension]."""

LEVEL = 0.5
"""Level of the map's border: relative error of the plate's motion. At this error almost nothing of
a requested force remains."""


def make_motions(rig: Rig, method: str, parts: int, count: int = REQUESTS) -> list[PlateCycle]:
    """Return the plate's motions that a solver finds for random requests."""
    rng = np.random.default_rng([SEED, parts])
    solver = METHODS[method](rig, iterations=24, restarts=1)
    period = solver.steering_period(parts)
    zero, cycles = np.zeros((parts, 2)), []
    for _ in range(count):
        position = random_positions(rig, parts, rng)
        requested = DRIFT * period * rng.normal(size=(parts, 2))
        solver.reset()
        goal = Goal(position, zero, requested, zero, np.full(parts, rig.friction.accel))
        cycles.append(solver.steer(goal, 2e-4 * period, 0.05 * DRIFT * period).cycle)
    return cycles


def twist_lengths(rig: Rig) -> np.ndarray:
    """Return the lengths (3,) that convert a twist (vx, vy, omega) to speeds: 1, 1 and the distance
    of a corner from the centre [m]."""
    return np.array([1.0, 1.0, float(np.hypot(*rig.plate.half))])


def realised_error(rig: Rig, cycle: PlateCycle, frequency: float) -> float:
    """Return the simulated relative error of the plate's velocity: root mean square of the error /
    root mean square of the commanded velocity."""
    real, state = rig_on_flexures(rig, frequency), PlateState.at_rest()
    settling = SETTLED / (DAMPING * 2 * np.pi * frequency)
    for _ in range(1 + int(np.ceil(settling / cycle.period))):
        motion, state = realise(real, state, cycle)
    t = np.arange(SAMPLES) * cycle.period / SAMPLES
    requested = cycle.twist(t) * twist_lengths(rig)
    missed = motion.twist(t) * twist_lengths(rig) - requested
    return float(np.linalg.norm(missed) / np.linalg.norm(requested))


def predicted_error(rig: Rig, cycle: PlateCycle, frequency: float | np.ndarray) -> np.ndarray:
    """Return the error of `realised_error` by theory, for one natural frequency or many (F,) [Hz].

    A drive that only holds the flexures at the commanded position has the transfer function

        H = 1/(1 - r^2 + 2 i z r),    r = f/f_n

    Here f is the frequency of a harmonic, f_n the natural frequency, and z the damping ratio. The
    relative error of a harmonic is |H - 1|. The error of the motion is the root of the weighted
    mean of |H - 1|^2 over its harmonics. The weight of a harmonic is its power in the velocity. All
    motors are assumed equal.
    """
    t = np.arange(SAMPLES) * cycle.period / SAMPLES
    spectrum = np.fft.rfft(cycle.twist(t) * twist_lengths(rig), axis=0)
    power = np.sum(np.abs(spectrum) ** 2, axis=1)
    r = np.arange(len(power)) / cycle.period / np.atleast_1d(frequency)[:, None]
    missed = np.abs(1 / (1 - r**2 + 2j * DAMPING * r) - 1) ** 2
    return np.asarray(np.sqrt(missed @ power / np.sum(power)))


def min_frequency(rig: Rig, cycles: list[PlateCycle]) -> float:
    """Return the frequency [Hz] above which the median of the predicted errors is below the
    level."""
    frequency = np.geomspace(5, 1000, 2000)
    error = np.median([predicted_error(rig, cycle, frequency) for cycle in cycles], axis=0)
    return float(frequency[np.flatnonzero(error >= LEVEL)[-1]])


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig, grids = load_rig(), []
    parts = PARTS[1::2] if quick else PARTS
    frequencies = FREQUENCIES_HZ[::3] if quick else FREQUENCIES_HZ
    for method in METHODS:
        cycles = [make_motions(rig, method, m, 1 if quick else REQUESTS) for m in parts]
        z = [
            [
                float(np.median([realised_error(rig, c, hz) for c in of_parts]))
                for of_parts in cycles
            ]
            for hz in frequencies
        ]
        line = [min_frequency(rig, of_parts) for of_parts in cycles]
        grids.append(grid(parts, frequencies, z, parts, line, method))
    return grids


MAP = StabilityMap(
    key="suspension",
    title="Soft plate: natural frequency and method, without calibration",
    x_label="parts",
    y_label="natural frequency [Hz]",
    z_label="velocity error divided by velocity [-]",
    line_label=f"the root mean square of abs(H - 1) over the motion's harmonics, weighted by their "
    f"power in the velocity, is {LEVEL:g}. H is the transfer function of the soft suspension in "
    "docs/model.md",
    level=LEVEL,
    measure=measure,
    bounds=(0.0, 2.0),
    log="y",
    steps=True,
    finding="A plate with a natural frequency below the line needs a calibration. For rotations, "
    "this frequency is 1.6 to 3.3 times as high as for sinusoids, because their ramps are fast.",
    note="Errors are root mean squares over a cycle in the periodic state. Values are medians of "
    f"{REQUESTS} random requests. The damping ratio is {100 * DAMPING:g} %. The motors differ by "
    "15 % and have a bandwidth of 200 Hz.",
)
