"""The procedure that learns the plate: three known motions, one by one, and what they do."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from plate_core import PlateCycle, PlateError, Rig
from plate_core.files import draft, read_file
from plate_core.motion import plate_state

from ..transports import Measured
from .response import (
    Response,
    excitation,
    fit_harmonics,
    harmonics,
    identified,
    plate_amplitudes,
    pose_harmonics,
)

PERIOD_S = 1.033
"""Of the motions [s]: harmonics are then 1 Hz apart, finer than a resonance is wide; and samples
every 10 ms fall on other places of each cycle, so that they resolve more than 50 harmonics."""

COUNT = 150
"""Harmonics: up to 145 Hz. Well beyond what motions consist of, to begin and end them at rest."""

ACCEL = 10.0
"""Root mean square of the commanded acceleration [m/s2]: a resonance of 3 % makes some 20 of it."""

SETTLE = 2
"""Cycles until the plate has found its rhythm."""

MEASURE = 6
"""Cycles that are measured then."""

SLOWEST = 4
"""Harmonics that show when a cycle began: up to 3.9 Hz."""

FOLLOWED = 0.2
"""Least fraction of the slow motion that the plate must do; else motors are off, or miswired."""

RESPONSE_BYTES = 32_768
"""Length of a response's file, and more [bytes]."""

MOST_BYTES = 1_000_000
"""Of such a file, if its cycles had many times as many harmonics [bytes]."""

AXES = ("x", "y", "theta")

FILE_ERRORS = (
    OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, BadZipFile, zlib.error,
    PlateError,
)  # fmt: skip
"""What reading a damaged file may raise."""


@dataclass(frozen=True)
class Calibration:
    """A calibration under way.

    Attributes
    ----------
    rig : Rig
    cycles : tuple of PlateCycle
        One for each axis.
    commanded, measured : tuple of (n, 3)
        Amplitudes of the experiments so far.
    """

    rig: Rig
    cycles: tuple[PlateCycle, ...]
    commanded: tuple[np.ndarray, ...] = ()
    measured: tuple[np.ndarray, ...] = ()
    settle: int = SETTLE
    measure: int = MEASURE

    @classmethod
    def start(cls, rig: Rig, seed: int = 0) -> Calibration:
        """Return the calibration at its beginning."""
        rng = np.random.default_rng(seed)
        axes = range(len(AXES))
        return cls(rig, tuple(excitation(rig, k, PERIOD_S, COUNT, ACCEL, rng) for k in axes))

    @property
    def cycle(self) -> PlateCycle | None:
        """The cycle to play now, `settle` times and then `measure` times; None at the end."""
        done = len(self.measured)
        return self.cycles[done] if done < len(self.cycles) else None

    @property
    def duration(self) -> float:
        """Length of one experiment [s]."""
        return (self.settle + self.measure) * PERIOD_S

    @property
    def progress(self) -> str:
        """How far it is, in words."""
        done = len(self.measured)
        if done == len(self.cycles):
            return "done"
        return f"shaking {AXES[done]}, experiment {done + 1} of {len(self.cycles)}"

    def with_experiment(
        self, t: np.ndarray, q: np.ndarray, qdd: np.ndarray, played: PlateCycle | None = None
    ) -> Calibration:
        """Return the calibration after an experiment.

        Parameters
        ----------
        t : (n,)
            Times since a cycle's start [s].
        q, qdd : (n, 4)
            Travel [m] and acceleration [m/s2] that the motors' sensors measured then.
        played : PlateCycle, optional
            What was commanded, if the rig's limits made it less than `cycle`.

        Raises
        ------
        PlateError
            If there are too few samples.
        """
        assert self.cycle is not None
        found = plate_amplitudes(self.rig, t, q, qdd, PERIOD_S, COUNT)
        asked = harmonics(played or self.cycle, COUNT)
        return replace(self, commanded=(*self.commanded, asked), measured=(*self.measured, found))

    @property
    def response(self) -> Response:
        """What was learned, at the end."""
        frequency = np.arange(1, COUNT + 1) / PERIOD_S
        return identified(self.rig, frequency, np.array(self.commanded), np.array(self.measured))


@dataclass(frozen=True)
class Experiment:
    """An experiment under way, and what the sensors have measured.

    Attributes
    ----------
    calibration : Calibration
    played : PlateCycle or None
        What was sent: the cycle within the rig's limits.
    table : int
        Number of the device's table that plays.
    samples : tuple of (time [s], q (4,), qdd (4,))
        Since it began, by the device's clock: the host's idea of that shifts by milliseconds.
    """

    calibration: Calibration
    played: PlateCycle | None = None
    table: int = 0
    samples: tuple[tuple[float, tuple[float, ...], tuple[float, ...]], ...] = ()

    @property
    def cycle(self) -> PlateCycle:
        """The cycle to play."""
        assert self.calibration.cycle is not None
        return self.calibration.cycle

    def with_sample(self, new: Measured) -> Experiment:
        """Return it with a sample; it begins anew where another table does, or none plays."""
        sample = new.device_s, new.position, new.acceleration
        if new.table == 0 or new.table != self.table:
            return replace(self, table=new.table, samples=())
        return replace(self, samples=(*self.samples, sample))

    @property
    def over(self) -> bool:
        """Whether the table has played long enough."""
        if not self.samples:
            return False
        return self.samples[-1][0] - self.samples[0][0] >= self.calibration.duration

    def finished(self) -> Calibration:
        """Return the calibration after this experiment.

        Raises
        ------
        PlateError
            If there are too few samples, or the plate did not follow.
        """
        time, q, qdd = (np.array(column) for column in zip(*self.samples, strict=True))
        kept = time > time[-1] - self.calibration.measure * PERIOD_S
        time, q, qdd = time[kept] - time[kept][0], q[kept], qdd[kept]
        played = self.played or self.cycle
        time = aligned(self.calibration.rig, played, time, q)
        return self.calibration.with_experiment(time, q, qdd, played)


def aligned(rig: Rig, cycle: PlateCycle, t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return times (n,) since a calibration cycle's start from those of another origin [s].

    The slowest harmonics are followed at once: their phase tells when the cycle began. What the
    motors' own lag delays them by (0.8 ms at 200 Hz) is taken for part of that, so the plate makes
    its motion as much later; its shape is not touched.

    Raises
    ------
    PlateError
        If the plate did something else.
    """
    nothing = np.zeros_like(q)
    pose, _, _ = plate_state(rig, q, nothing, nothing, tolerance=np.inf)
    found = fit_harmonics(t, pose, cycle.period, COUNT)[:SLOWEST]
    asked = pose_harmonics(cycle, SLOWEST)[1:]
    turn = np.sum(found * np.conj(asked), axis=1)
    followed = float(np.sum(np.abs(turn)) / np.sum(np.abs(asked) ** 2))
    if not followed >= FOLLOWED:
        raise PlateError(
            f"calibration: the plate followed {100 * followed:.2g} % of a slow motion, "
            f"allowed: {100 * FOLLOWED:g} % or more"
        )
    omega = 2 * np.pi * np.arange(1, SLOWEST + 1) / cycle.period
    late = -np.angle(turn[0]) / omega[0]
    rest = -np.angle(turn * np.exp(1j * omega * late))
    weight = np.abs(turn) * omega
    return np.asarray(t - late - np.sum(weight * rest) / np.sum(weight * omega))


def check_writable(path: str | Path) -> None:
    """Check that a response can be written to a file, before the plate is shaken for it.

    Raises
    ------
    PlateError
        If it cannot.
    """
    with draft(path, "calibration_file", keeps=False) as file:
        file.write(bytes(RESPONSE_BYTES))


def save_response(path: str | Path, response: Response) -> None:
    """Write a response to a file (numpy's .npz), whole or not at all.

    Raises
    ------
    PlateError
        If that cannot be written.
    """
    with draft(path, "calibration_file") as file:
        np.savez(file, frequency=response.frequency, matrix=response.matrix, lever=response.lever)


def saved_response(path: str | Path) -> Response:
    """Read a response from a file.

    Raises
    ------
    PlateError
        If it is none.
    """
    try:
        with np.load(BytesIO(read_file(path, MOST_BYTES)), allow_pickle=False) as data:
            return Response(data["frequency"], data["matrix"], float(data["lever"]))
    except FILE_ERRORS as error:
        raise PlateError(f"calibration_file {path}: is no calibration ({error})") from None
