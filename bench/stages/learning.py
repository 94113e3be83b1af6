"""Learning the plate's response: error of realised harmonics.

The simulated plate has a suspension with a natural frequency of 35 Hz and 3 % damping, and an
off-centre mass. The forces of its motors are 15 % too large or too small, with a bandwidth of 200
Hz. Sensors are read every 10 ms, with noise. The learning procedure does not use the cycles with
which the error is evaluated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from harness import Result, Table
from plate_core import PlateCycle, Rig, load_rig
from plate_core.rig import Suspension, mass_matrix, modal_matrices
from plate_driver.calibration import (
    COUNT,
    PERIOD_S,
    Calibration,
    Response,
    closed_at_rest,
    harmonics,
)
from plate_sim import PlateState, motor_record, realise

HZ = 35.0
DAMPING = 0.03
MISMATCH = 0.15
BANDWIDTH_HZ = 200.0
SAMPLE_S = 0.01
NOISE = 0.2
"""Standard deviation of the noise of an accelerometer [m/s2]."""

PERIOD, HARMONICS = 0.2, 8
CYCLES = 10
"""Number of evaluated cycles. The plate repeats each cycle until its motion is periodic."""

TRUST = 0.3
"""Fraction of the correction of the response (Broyden's method) that is applied after each
experiment, except after the three calibration experiments."""

MAX_EXPERIMENTS = 10
"""Number of experiments: three calibration experiments, then further experiments. The response is
evaluated before the first experiment and after each experiment."""


def measure(quick: bool) -> Result:
    """Learn the response, and evaluate it before the first experiment and after each experiment."""
    rig = load_rig()
    rows = iteration_rows(rig, 3 if quick else CYCLES)
    facts = {"hz": HZ, "damping": 100 * DAMPING, "mismatch": 100 * MISMATCH, "noise": NOISE}
    facts |= {"sample": 1e3 * SAMPLE_S, "trust": TRUST}
    return Result([Table.of("learning", rows, **facts)])


def rig_on_flexures(rig: Rig, frequency: float = HZ) -> Rig:
    """Return the rig on flexures of a natural frequency [Hz], with unequal motors and an off-centre
    mass."""
    mass = mass_matrix(rig.plate.mass_kg, 0.075, (0.01, -0.005))
    damping, stiffness = modal_matrices(mass, np.full(3, frequency), np.full(3, DAMPING))
    gain = (1 + MISMATCH, 1 - MISMATCH) * 2
    return replace(
        rig, suspension=Suspension(mass, damping, stiffness, (0, 0, 1), gain, BANDWIDTH_HZ)
    )


def random_cycle(seed: int) -> PlateCycle:
    """Return a random motion of eight harmonics that begins at rest, up to 30 m/s2."""
    rng = np.random.default_rng(seed)
    frequency = np.arange(HARMONICS + 1) / PERIOD
    rate = 2 * np.pi * np.maximum(frequency, frequency[1])[:, None]
    amplitude = rng.normal(size=(HARMONICS + 1, 3, 2)) @ [1, 1j] * [1, 1, 2] / rate**2
    amplitude[0] = 0
    amplitude = closed_at_rest(frequency, amplitude, np.tile(rate**4, 3))
    t = np.linspace(0, PERIOD, 8 * HARMONICS + 1)
    rotation = 2j * np.pi * frequency[:, None]
    waves = np.exp(np.outer(t, rotation[:, 0]))
    states = [(waves @ (amplitude * rotation**order)).real for order in range(3)]
    size = 30 / np.max(np.abs(states[2]))
    for state in states:
        state *= size
        state[[0, -1]] = 0
    return PlateCycle.from_knots(t, *states)


class Plate:
    """The simulated plate and the sensors at its motors."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self.rig, self.rng, self.state = rig, np.random.default_rng(seed), PlateState.at_rest()

    def play(self, cycle: PlateCycle, times: int = 1) -> Any:
        """Play a cycle, and return the last motion."""
        for _ in range(times):
            motion, self.state = realise(self.rig, self.state, cycle)
        return motion

    def read(self, cycle: PlateCycle, times: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Play a cycle `times` times. Return the times since the start of a play (n,), and two
        arrays of sensor values (n, 4)."""
        begin, parts = self.rng.uniform(0, SAMPLE_S), []
        for k in range(times):
            motion = self.play(cycle)
            t = begin + SAMPLE_S * np.arange(times * cycle.period / SAMPLE_S + 1)
            t -= k * cycle.period
            t = t[(t >= 0) & (t < cycle.period)]
            q, _, qdd = motor_record(self.rig, motion, t)
            parts.append((t, q, qdd + NOISE * self.rng.normal(size=qdd.shape)))
        t, q, qdd = (np.concatenate(column) for column in zip(*parts, strict=True))
        return t, q, qdd


def harmonics_error(rig: Rig, cycle: PlateCycle, command: PlateCycle) -> float:
    """Return the error of the harmonics [%] if the plate repeats a cycle until its motion is
    periodic."""
    motion = Plate(rig, 0).play(command, 12)
    t = np.arange(512) * cycle.period / 512
    got = 2 / 512 * np.fft.rfft(motion.accel(t), axis=0)[1 : HARMONICS + 1]
    lever = float(np.hypot(*rig.plate.half))
    scale, target = np.array([1.0, 1.0, lever]), harmonics(cycle, HARMONICS)
    return 100 * float(np.linalg.norm((got - target) * scale) / np.linalg.norm(target * scale))


def evaluation_row(rig: Rig, iteration: int, response: Response, cycles: int) -> dict[str, Any]:
    """Return a row with the errors of cycles that the learning procedure does not use."""
    tries = [random_cycle(1000 + k) for k in range(cycles)]
    errors = [harmonics_error(rig, cycle, response.command(cycle)) for cycle in tries]
    return {"iteration": iteration, "median": float(np.median(errors)), "most": max(errors)}


def iteration_rows(rig: Rig, cycles: int) -> list[dict[str, Any]]:
    """Return a row for each iteration."""
    real = rig_on_flexures(rig)
    plate, calibration = Plate(real, 1), Calibration.start(rig)
    frequency = np.arange(1, COUNT + 1) / PERIOD_S
    response = Response.identity(rig, frequency)
    rows = [evaluation_row(real, 0, response, cycles)]
    while calibration.cycle is not None:
        plate.play(calibration.cycle, calibration.settle)
        read = plate.read(calibration.cycle, calibration.measure)
        calibration = calibration.with_experiment(*read)
        response = response.updated(calibration.commanded[-1], calibration.measured[-1])
        rows.append(evaluation_row(real, len(rows), response, cycles))
    response = calibration.response
    while len(rows) <= MAX_EXPERIMENTS:
        again = Calibration.start(rig, seed=len(rows))
        cycle = again.cycles[len(rows) % 3]
        again = replace(again, cycles=(cycle,))
        plate.play(cycle, again.settle)
        again = again.with_experiment(*plate.read(cycle, again.measure))
        response = response.updated(again.commanded[0], again.measured[0], TRUST)
        rows.append(evaluation_row(real, len(rows), response, cycles))
    return rows
