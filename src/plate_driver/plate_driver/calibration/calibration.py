"""Calibration procedure. The calibration plays a known motion along each of x, y and theta, and
computes the plate's frequency response from the motors' sensors. The inputs are sensor samples. The
outputs are the cycles to play and a `Response`, which is stored in a .npz file."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import numpy as np

from plate_core import PlateCycle, PlateError, Rig
from plate_core.files import draft, read_file
from plate_core.motion import plate_state

from ..transports import Measured
from .response import (
    Response,
    fit_harmonics,
    harmonics,
    identify_response,
    make_excitation,
    plate_amplitudes,
    pose_harmonics,
)

PERIOD_S = 1.033
"""Period of the motions [s]. With this period, the harmonics are 1 Hz apart, which is less than the
width of a resonance. The period is not a multiple of the sample interval of 10 ms. Therefore the
samples of different cycles have different phases. Together, the samples resolve more than 50
harmonics."""

COUNT = 150
"""Number of harmonics. The highest harmonic has 145 Hz, far more than the frequencies in the
solvers' motions. Corrected motions need this margin to begin and end at rest."""

ACCEL = 10.0
"""Root mean square of the commanded acceleration [m/s2]. At a resonance with 3 % damping, the
actual acceleration of the plate reaches about 20 m/s2."""

SETTLE = 2
"""Number of plays of a cycle before the measurement. After these plays, the motion is periodic."""

MEASURE = 6
"""Number of plays of a cycle during the measurement."""

SLOWEST = 4
"""Number of harmonics, up to 3.9 Hz, from which the start time of a cycle is computed."""

FOLLOWED = 0.2
"""Minimum ratio of the measured to the commanded amplitude of the plate's slow motion. If the ratio
is smaller, motors are off or wired wrongly."""

RESPONSE_BYTES = 32_768
"""Upper estimate of the size of a response file [bytes]."""

MAX_BYTES = 1_000_000
"""Maximum size of a response file that is read [bytes]. This size is sufficient for files with many
more harmonics."""

AXES = ("x", "y", "theta")

FILE_ERRORS = (
    OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, MemoryError, BadZipFile,
    zlib.error, PlateError,
)  # fmt: skip
"""Exceptions that can occur when a damaged file is read."""


@dataclass(frozen=True)
class Calibration:
    """A running calibration.

    Attributes
    ----------
    rig : Rig
    cycles : tuple of PlateCycle
        One cycle per axis.
    commanded, measured : tuple of (n, 3)
        Amplitudes of the acceleration in the completed experiments.
    settle, measure : int
        `settle` is the number of plays of a cycle until the motion is periodic. `measure` is the
        number of further plays for the measurement.
    """

    rig: Rig
    cycles: tuple[PlateCycle, ...]
    commanded: tuple[np.ndarray, ...] = ()
    measured: tuple[np.ndarray, ...] = ()
    settle: int = SETTLE
    measure: int = MEASURE

    @classmethod
    def start(cls, rig: Rig, seed: int = 0) -> Calibration:
        """Return a new calibration."""
        rng = np.random.default_rng(seed)
        axes = range(len(AXES))
        return cls(rig, tuple(make_excitation(rig, k, PERIOD_S, COUNT, ACCEL, rng) for k in axes))

    @property
    def cycle(self) -> PlateCycle | None:
        """The cycle to play now. The cycle is played `settle` times until the motion is periodic,
        then `measure` times for the measurement. None after the last experiment."""
        done = len(self.measured)
        return self.cycles[done] if done < len(self.cycles) else None

    @property
    def duration(self) -> float:
        """Length of one experiment [s]."""
        return (self.settle + self.measure) * PERIOD_S

    @property
    def progress(self) -> str:
        """Progress as text."""
        done = len(self.measured)
        if done == len(self.cycles):
            return "done"
        return f"experiment {done + 1} of {len(self.cycles)}: shaking the plate in {AXES[done]}"

    def with_experiment(
        self, t: np.ndarray, q: np.ndarray, qdd: np.ndarray, played: PlateCycle | None = None
    ) -> Calibration:
        """Return the calibration after an experiment.

        Parameters
        ----------
        t : (n,)
            Times since a cycle's start [s].
        q, qdd : (n, 4)
            Travel [m] and acceleration [m/s2] measured by the motors' sensors.
        played : PlateCycle, optional
            Commanded cycle, if `cycle` was scaled down to the rig's limits. Default: `cycle`.

        Raises
        ------
        PlateError
            If there are too few samples.
        """
        assert self.cycle is not None
        amplitudes = plate_amplitudes(self.rig, t, q, qdd, PERIOD_S, COUNT)
        requested = harmonics(played or self.cycle, COUNT)
        return replace(
            self, commanded=(*self.commanded, requested), measured=(*self.measured, amplitudes)
        )

    @property
    def response(self) -> Response:
        """The plate's response. The result is available at the end of the calibration."""
        frequency = np.arange(1, COUNT + 1) / PERIOD_S
        return identify_response(
            self.rig, frequency, np.array(self.commanded), np.array(self.measured)
        )


@dataclass(frozen=True)
class Experiment:
    """A running experiment, and its sensor samples.

    Attributes
    ----------
    calibration : Calibration
    played : PlateCycle or None
        Sent cycle, scaled to the rig's limits. None before the cycle was sent.
    table : int
        Number of the device's table that plays.
    samples : tuple of (time [s], q (4,), qdd (4,))
        Samples since the experiment's start. The times of the samples are on the device's clock,
        because the conversion to host time varies by milliseconds.
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
        """Return the experiment with one more sample. If another table or no table plays, the
        experiment restarts."""
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
        """Return the calibration with the result of this experiment.

        Raises
        ------
        PlateError
            If there are too few samples, or the plate did not follow.
        """
        time, q, qdd = (np.array(column) for column in zip(*self.samples, strict=True))
        kept = time > time[-1] - self.calibration.measure * PERIOD_S
        time, q, qdd = time[kept] - time[kept][0], q[kept], qdd[kept]
        played = self.played or self.cycle
        time = align_times(self.calibration.rig, played, time, q)
        return self.calibration.with_experiment(time, q, qdd, played)


def align_times(rig: Rig, cycle: PlateCycle, t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Convert times (n,) [s] with any origin to times since the start of a calibration cycle [s].

    The plate follows the slowest harmonics almost without delay, so their phase gives the start of
    the cycle. The estimated start includes the delay of the motors (0.8 ms if their bandwidth is
    200 Hz). Therefore corrected motions are late by this delay, but their shape is correct.

    Raises
    ------
    PlateError
        If the plate did not follow the cycle.
    """
    nothing = np.zeros_like(q)
    pose, _, _ = plate_state(rig, q, nothing, nothing, tolerance=np.inf)
    amplitudes = fit_harmonics(t, pose, cycle.period, COUNT)[:SLOWEST]
    requested = pose_harmonics(cycle, SLOWEST)[1:]
    product = np.sum(amplitudes * np.conj(requested), axis=1)
    followed = float(np.sum(np.abs(product)) / np.sum(np.abs(requested) ** 2))
    if not followed >= FOLLOWED:
        raise PlateError(
            f"calibration: the plate performs {100 * followed:.2g} % of a slow commanded motion, "
            f"allowed: {100 * FOLLOWED:g} % or more"
        )
    omega = 2 * np.pi * np.arange(1, SLOWEST + 1) / cycle.period
    late = -np.angle(product[0]) / omega[0]
    rest = -np.angle(product * np.exp(1j * omega * late))
    weight = np.abs(product) * omega
    return np.asarray(t - late - np.sum(weight * rest) / np.sum(weight * omega))


def check_writable(path: str | Path) -> None:
    """Check that a response can be written to a file, before the experiments start.

    Raises
    ------
    PlateError
        If the file cannot be written.
    """
    with draft(path, "calibration_file", keeps=False) as file:
        file.write(bytes(RESPONSE_BYTES))


def save_response(path: str | Path, response: Response) -> None:
    """Write a response to a file (numpy's .npz) atomically.

    Raises
    ------
    PlateError
        If the file cannot be written.
    """
    with draft(path, "calibration_file") as file:
        np.savez(file, frequency=response.frequency, matrix=response.matrix, lever=response.lever)


def saved_response(path: str | Path) -> Response:
    """Read a response from a file.

    Raises
    ------
    PlateError
        If the file is not a valid response.
    """
    try:
        content = read_file(path, MAX_BYTES)
        with ZipFile(BytesIO(content)) as packed:
            size = sum(entry.file_size for entry in packed.infolist())
        # check the unpacked size, because a small file can contain a much larger array
        if size > MAX_BYTES:
            raise PlateError(f"its unpacked size is {size} bytes, allowed: up to {MAX_BYTES}")
        with np.load(BytesIO(content), allow_pickle=False) as data:
            return Response(data["frequency"], data["matrix"], float(data["lever"]))
    except FILE_ERRORS as error:
        raise PlateError(f"calibration_file {path}: not a valid calibration ({error})") from None
