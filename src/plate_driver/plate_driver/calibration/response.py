"""Frequency response of the plate, and correction of commands by its inverse.

A plate on flexures amplifies, delays and couples the commanded motions of x, y and theta. The
response of the plate to a command of frequency f is the complex 3 x 3 matrix H(f). H is computed
from the accelerations that the motors' sensors measure while known cycles are repeated. The command
for a requested motion is H^-1 times this motion. Later measurements correct H by Broyden's update,
which changes only the excited components. The errors decrease with each update, even for motions
that were not measured.

Amplitudes are complex, (k, 3): a(t) = sum over k of Re(A_k exp(2 pi i f_k t)) [m/s2, m/s2, rad/s2].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from plate_core import PlateCycle, PlateError, Rig
from plate_core.motion import motor_state, plate_state

SAMPLES = 512
"""Minimum number of samples per cycle. This number is far more than twice the number of
harmonics."""

KNOTS_PER_WAVE = 3
"""Number of knots per period of the highest harmonic. With this number, the error of the spline is
2e-3 of the harmonic's amplitude, and the tables are small enough for the devices."""

STRESS = 30.0
"""Additional cost of a change at the strongest harmonic of a motion, when a correction is changed
to begin and end at rest. A change at a harmonic that the motion does not contain has the cost 1."""

WEAKEST = 0.02
"""Minimum gain (singular value) of the frequency response H. Smaller values are replaced by this
minimum before H is inverted. This limits the command at frequencies at which the plate hardly
follows."""

SLOW_HZ = 5.0
"""Frequency below which accelerations are computed from positions [Hz], because at such frequencies
positions are more accurate than accelerometers. Below this frequency, the excitation is also
weaker, because the stroke is short."""

FAINT = 1e-3
"""Minimum strength of a harmonic of a command, as a fraction of the strongest harmonic. Weaker
harmonics are not used."""


@dataclass(frozen=True)
class Response:
    """Frequency response H of the plate at given frequencies.

    Attributes
    ----------
    frequency : (n,)
        At least four increasing frequencies [Hz].
    matrix : (n, 3, 3)
        Complex ratios of measured to commanded acceleration. Theta is multiplied by `lever`, so
        that all components of an acceleration have the same unit.
    lever : float
        Half the diagonal of the plate [m].

    Raises
    ------
    PlateError
        If a shape is wrong or a value is not finite.
    """

    frequency: np.ndarray
    matrix: np.ndarray
    lever: float

    def __post_init__(self) -> None:
        count = len(self.frequency)
        if self.matrix.shape != (count, 3, 3) or count < 4 or not np.all(np.diff(self.frequency)):
            raise PlateError(
                f"response: number of frequencies is {count} and shape of the matrices is "
                f"{self.matrix.shape}, allowed: at least 4 frequencies, and a 3 x 3 matrix for each"
            )
        finite = np.all(np.isfinite(self.matrix)) and np.all(np.isfinite(self.frequency))
        if not finite or self.frequency[0] <= 0 or np.any(np.diff(self.frequency) <= 0):
            raise PlateError(
                "response: values must be finite, and frequencies above 0 and increasing"
            )

    @classmethod
    def identity(cls, rig: Rig, frequency: np.ndarray) -> Response:
        """Return the response of a plate that follows commands exactly."""
        matrix = np.tile(np.eye(3, dtype=complex), (len(frequency), 1, 1))
        return cls(np.asarray(frequency, dtype=float), matrix, float(np.hypot(*rig.plate.half)))

    @cached_property
    def inverse(self) -> np.ndarray:
        """The inverse H^-1 (n, 3, 3), with singular values of at most 1/`WEAKEST`."""
        u, gain, v = np.linalg.svd(self.matrix)
        gain = np.maximum(gain, WEAKEST)
        return np.asarray(np.conj(v.swapaxes(1, 2)) @ (np.conj(u.swapaxes(1, 2)) / gain[..., None]))

    @cached_property
    def _scale(self) -> np.ndarray:
        return np.array([1.0, 1.0, self.lever])

    def _interpolate(self, matrices: np.ndarray, frequency: np.ndarray) -> np.ndarray:
        """Interpolate matrices in frequency by a cubic spline. At frequency 0, the spline has the
        real part of the first matrix."""
        # SciPy is imported here, because an import at the top would double the start time of the
        # driver.
        from scipy.interpolate import CubicSpline

        below = np.concatenate([matrices[:1].real.astype(complex), matrices])
        return np.asarray(CubicSpline(np.append(0.0, self.frequency), below)(frequency))

    def command(self, cycle: PlateCycle) -> PlateCycle:
        """Return the command for which the plate performs the motion of a cycle.

        Only harmonics up to the highest known frequency are corrected. The command begins and ends
        at rest at home. To achieve this, the correction is changed as little as possible, mainly at
        frequencies at which the plate responds weakly.
        """
        count = int(self.frequency[-1] * cycle.period * (1 + 1e-9))
        if count == 0 or not np.any(cycle.knot_pose):
            return cycle
        frequency = np.arange(count + 1) / cycle.period
        requested = pose_harmonics(cycle, count) * self._scale
        inverse = self._interpolate(self.inverse, frequency)
        more = (np.einsum("kij,kj->ki", inverse, requested) - requested) / self._scale
        strong = np.abs(requested * frequency[:, None] ** 2)
        stress = 1 + STRESS * strong / np.max(strong)
        more = closed_at_rest(frequency, more, stress * self._squared_gains(frequency))
        pieces = max(len(cycle.times) - 1, KNOTS_PER_WAVE * count)
        t = np.linspace(0, cycle.period, pieces + 1)
        added = _evaluate_harmonics(frequency, more, t)
        known = cycle.pose(t), cycle.twist(t), cycle.accel(t)
        states = [old + new for old, new in zip(known, added, strict=True)]
        for state in states:
            state[[0, -1]] = 0.0
        return PlateCycle.from_knots(t, *states)

    def _squared_gains(self, frequency: np.ndarray) -> np.ndarray:
        """Return the squared gain (k, 3) from a command's pose to the plate's acceleration.

        The mean pose (frequency 0) is treated like a motion at the frequency of the plate's
        strongest response, because it changes from cycle to cycle.
        """
        gain = np.sum(np.abs(self._interpolate(self.matrix, frequency)) ** 2, axis=1)
        peak = self.frequency[np.argmax(np.linalg.norm(self.matrix, axis=(1, 2)))]
        rate = 2 * np.pi * np.where(frequency > 0, frequency, peak)
        return np.asarray(np.maximum(gain, FAINT**2) * rate[:, None] ** 4)

    def updated(self, commanded: np.ndarray, measured: np.ndarray, trust: float = 1.0) -> Response:
        """Return the response after Broyden's update with one measurement.

        Parameters
        ----------
        commanded, measured : (n, 3)
            Amplitudes at `frequency`.
        trust : float
            Fraction of the correction that is applied. The fraction should be less than 1 for noisy
            sensors.
        """
        requested, got = commanded * self._scale, measured * self._scale
        power = np.sum(np.abs(requested) ** 2, axis=1)
        miss = got - np.einsum("kij,kj->ki", self.matrix, requested)
        excited = power > FAINT**2 * np.max(power, initial=0.0)
        step = trust * miss[:, :, None] * np.conj(requested)[:, None, :]
        step[excited] /= power[excited, None, None]
        step[~excited] = 0.0
        return replace(self, matrix=self.matrix + step)


def identify_response(
    rig: Rig, frequency: np.ndarray, commanded: np.ndarray, measured: np.ndarray
) -> Response:
    """Return the response that fits several experiments by least squares.

    Parameters
    ----------
    frequency : (n,)
        Frequencies [Hz].
    commanded, measured : (j, n, 3)
        Amplitudes of at least three experiments.

    Raises
    ------
    PlateError
        If the experiments do not excite x, y and theta at all frequencies.
    """
    response = Response.identity(rig, frequency)
    requested = (commanded * response._scale).transpose(1, 2, 0)
    got = (measured * response._scale).transpose(1, 2, 0)
    gain = np.linalg.svd(requested, compute_uv=False)
    if np.any(gain[:, -1] < FAINT * np.max(gain)):
        raise PlateError(
            "the experiments do not move the plate in x, y and theta at every frequency"
        )
    return replace(response, matrix=got @ np.linalg.pinv(requested))


def harmonics(cycle: PlateCycle, count: int) -> np.ndarray:
    """Return amplitudes (count, 3) of a cycle's acceleration at 1, 2, ... times its frequency."""
    rate = 2j * np.pi * np.arange(1, count + 1)[:, None] / cycle.period
    return np.asarray(rate**2 * pose_harmonics(cycle, count)[1:])


def pose_harmonics(cycle: PlateCycle, count: int) -> np.ndarray:
    """Return amplitudes (count + 1, 3) of a cycle's pose. The first amplitude is the mean pose."""
    samples = max(SAMPLES, 4 * count)
    pose = cycle.pose(np.arange(samples) * cycle.period / samples)
    amplitude = 2 / samples * np.fft.rfft(pose, axis=0)[: count + 1]
    amplitude[0] /= 2
    return np.asarray(amplitude)


def fit_harmonics(t: np.ndarray, values: np.ndarray, period: float, count: int) -> np.ndarray:
    """Return amplitudes (count, m) of samples (n, m) at times t (n,) [s] of a periodic motion.

    A constant and the harmonics are fitted by least squares. The intervals between the times can
    differ, and the times need not cover whole periods.

    Raises
    ------
    PlateError
        If the times do not determine the harmonics.
    """
    waves = np.exp(2j * np.pi * np.outer(t / period, np.arange(1, count + 1)))
    columns = np.hstack([np.ones((len(t), 1)), waves.real, -waves.imag])
    solution, _, rank, _ = np.linalg.lstsq(columns, values, rcond=1e-6)
    if rank < columns.shape[1]:
        raise PlateError(
            f"{len(t)} samples determine only {(rank - 1) // 2} harmonics of the period {period:g} "
            f"s, required: {count}"
        )
    return np.asarray(solution[1 : count + 1] + 1j * solution[count + 1 :])


def plate_amplitudes(
    rig: Rig, t: np.ndarray, q: np.ndarray, qdd: np.ndarray, period: float, count: int
) -> np.ndarray:
    """Return amplitudes (count, 3) of the plate's acceleration from the motors' sensors.

    Parameters
    ----------
    t : (n,)
        Times since a cycle's start [s].
    q, qdd : (n, 4)
        Travel [m] and acceleration [m/s2]. The four sensors may contradict each other slightly,
        because of measurement errors.
    """
    nothing = np.zeros_like(q)
    pose, _, _ = plate_state(rig, q, nothing, nothing, tolerance=np.inf)
    # If the plate rotates, the motors' acceleration depends on its twist, which is computed from
    # the poses.
    amplitude = fit_harmonics(t, pose, period, count)
    rate = 2j * np.pi * np.arange(1, count + 1)[:, None] / period
    waves = np.exp(np.outer(t, rate[:, 0]))
    twist = (waves @ (rate * amplitude)).real
    _, qd, _ = motor_state(rig, pose, twist, np.zeros_like(pose))
    _, _, accel = plate_state(rig, q, qd, qdd, tolerance=np.inf)
    slow = np.arange(1, count + 1)[:, None] / period < SLOW_HZ
    return np.where(slow, rate**2 * amplitude, fit_harmonics(t, accel, period, count))


def closed_at_rest(frequency: np.ndarray, amplitude: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Change amplitudes (k, 3) of a pose so that it begins at rest at home, at minimum cost.

    Parameters
    ----------
    frequency : (k,)
        Frequencies of the amplitudes [Hz]. The frequency 0 belongs to the mean.
    cost : (k, 3)
        Weight of the squared change.

    For each coordinate, the real and imaginary parts x of the amplitudes determine pose, twist and
    acceleration at the start, A x. The change d minimises the weighted sum of squares d^T W d under
    the condition A (x + d) = 0. With V = W^-1, the solution is d = -V A^T (A V A^T)^-1 A x.
    """
    rate = 2 * np.pi * frequency
    # `real` and `imag` (3, k) convert the real and imaginary parts of the amplitudes to pose, twist
    # and acceleration at the start of the cycle.
    real = np.stack([np.ones_like(rate), np.zeros_like(rate), -(rate**2)])
    imag = np.stack([np.zeros_like(rate), -rate, np.zeros_like(rate)])
    start_map = np.hstack([real, imag])  # the matrix A
    new = np.array(amplitude)
    for axis in range(3):
        inverse_weight = np.tile(1 / cost[:, axis], 2)
        start = start_map @ np.concatenate([amplitude[:, axis].real, amplitude[:, axis].imag])
        # The rows are scaled, because pose and acceleration differ by many orders of magnitude.
        scale = np.diag(1 / np.sqrt(np.sum(start_map**2 * inverse_weight, axis=1)))
        normal = scale @ (start_map * inverse_weight) @ start_map.T @ scale
        multiplier = np.linalg.solve(normal, scale @ start)
        change = -inverse_weight * (start_map.T @ scale @ multiplier)
        new[:, axis] += change[: len(rate)] + 1j * change[len(rate) :]
    return new


def make_excitation(
    rig: Rig, axis: int, period: float, count: int, accel: float, rng: np.random.Generator
) -> PlateCycle:
    """Return a cycle that shakes one axis at all harmonics and begins at rest.

    All harmonics above `SLOW_HZ` have the same amplitude of the acceleration. All harmonics below
    `SLOW_HZ` have the same amplitude of the pose.

    Parameters
    ----------
    axis : int
        0: x, 1: y, 2: theta.
    accel : float
        Root mean square of the acceleration [m/s2]. For theta, `accel` is the acceleration of the
        plate's corners.
    rng : numpy.random.Generator
        Generator for the phases. The phases are random, because a motion with equal phases would
        have one high peak.
    """
    frequency = np.arange(count + 1) / period
    rate = 2 * np.pi * np.maximum(frequency, frequency[1])[:, None]
    amplitude = np.zeros((count + 1, 3), dtype=complex)
    phases = np.exp(2j * np.pi * rng.random(count))
    slowest = np.maximum(rate[1:, 0], 2 * np.pi * SLOW_HZ)
    amplitude[1:, axis] = accel * np.sqrt(2 / count) * phases / slowest**2
    if axis == 2:
        amplitude /= float(np.hypot(*rig.plate.half))
    amplitude = closed_at_rest(frequency, amplitude, np.tile(rate**4, 3))
    t = np.linspace(0, period, KNOTS_PER_WAVE * count + 1)
    states = _evaluate_harmonics(frequency, amplitude, t)
    for state in states:
        state[[0, -1]] = 0.0
    return PlateCycle.from_knots(t, *states)


def _evaluate_harmonics(
    frequency: np.ndarray, amplitude: np.ndarray, t: np.ndarray
) -> list[np.ndarray]:
    """Return pose, twist and acceleration (n, 3) at times t (n,) from pose amplitudes (k, 3)."""
    rate = 2j * np.pi * frequency[:, None]
    waves = np.exp(np.outer(t, rate[:, 0]))
    return [(waves @ (amplitude * rate**order)).real for order in range(3)]
