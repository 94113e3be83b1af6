"""The driver learns the simulated plate: 35 Hz, damping 3 %, motors that differ by 15 %."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_core.suspension import Suspension, mass_matrix, modal_matrices
from plate_driver.calibration import Calibration, save_response, saved_response
from plate_driver.learning import Response, harmonic_error, harmonics, settled
from plate_driver.motor_table import prepare
from plate_sim.drive import PlateState
from plate_sim.suspension import motor_record, realise

RIG = load_rig()
MASS = mass_matrix(RIG.plate.mass_kg, 0.075, (0.01, -0.005))  # off-centre: the axes are coupled
DAMPING, STIFFNESS = modal_matrices(MASS, np.full(3, 35.0), np.full(3, 0.03))
HUNG = replace(
    RIG,
    suspension=Suspension(MASS, DAMPING, STIFFNESS, (0, 0, 1), (1.15, 0.85, 1.15, 0.85), 200.0),
)
SAMPLE_S = 0.01
NOISE = 0.2
"""Of the accelerometers [m/s2]."""


def wanted(seed: int, count: int = 8, period: float = 0.2) -> PlateCycle:
    """A random motion of some harmonics that begins at rest."""
    rng = np.random.default_rng(seed)
    frequency = np.arange(count + 1) / period
    rate = 2 * np.pi * np.maximum(frequency, frequency[1])[:, None]
    amplitude = rng.normal(size=(count + 1, 3, 2)) @ [1, 1j] * [1, 1, 2] / rate**2
    amplitude[0] = 0
    amplitude = settled(frequency, amplitude, np.tile(rate**4, 3))
    t = np.linspace(0, period, 65)
    waves = np.exp(2j * np.pi * np.outer(t, frequency))
    spin = 2j * np.pi * frequency[:, None]
    states = [(waves @ (amplitude * spin**order)).real for order in range(3)]
    size = 30 / np.max(np.abs(states[2]))  # m/s2, rad/s2
    for state in states:
        state *= size
        state[[0, -1]] = 0
    return PlateCycle.from_knots(t, *states)


class Bench:
    """The simulated plate, and noisy sensors at its motors that are read every 10 ms."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.state = PlateState.at_rest()

    def play(self, cycle: PlateCycle, cycles: int = 1):
        for _ in range(cycles):
            motion, self.state = realise(HUNG, self.state, cycle)
        return motion

    def read(self, cycle: PlateCycle, cycles: int):
        begin, time, q, qdd = self.rng.uniform(0, SAMPLE_S), [], [], []
        for k in range(cycles):
            motion, late = self.play(cycle), begin - k * cycle.period
            t = late + SAMPLE_S * np.arange(2000)
            t = t[(t >= 0) & (t < cycle.period)]
            travel, _, accel = motor_record(HUNG, motion, t)
            time.append(t)
            q.append(travel)
            qdd.append(accel + NOISE * self.rng.normal(size=accel.shape))
        return tuple(np.concatenate(a) for a in (time, q, qdd))


def steady_error(cycle: PlateCycle, command: PlateCycle) -> float:
    """Error of the harmonics of a cycle, once its command has been repeated for 2.4 s."""
    bench, count = Bench(), 8
    motion = bench.play(command, 12)
    t = np.arange(512) * cycle.period / 512
    got = 2 / 512 * np.fft.rfft(motion.accel(t), axis=0)[1 : count + 1]
    return harmonic_error(harmonics(cycle, count), got, float(np.hypot(*RIG.plate.half)))


@pytest.fixture(name="learned", scope="module")
def _learned() -> tuple[Response, int]:
    """The response after a calibration, and how many experiments that took."""
    bench, calibration, count = Bench(), Calibration.begun(RIG), 0
    while calibration.cycle is not None:
        bench.play(calibration.cycle, calibration.settle)
        calibration = calibration.heard(*bench.read(calibration.cycle, calibration.measure))
        count += 1
    return calibration.response, count


def test_errors_fall_from_over_a_half_to_below_two_per_cent(learned):
    response, experiments = learned
    assert experiments <= 10
    for seed in range(5):  # none of them was seen in the calibration
        cycle = wanted(seed)
        assert steady_error(cycle, cycle) > 0.5
        assert steady_error(cycle, response.command(cycle)) < 0.02


def test_a_new_cycle_every_200_ms_is_right_too(learned):
    response, _ = learned
    told, corrected = Bench(), Bench()
    t = np.linspace(0, 0.2, 400)
    miss = np.zeros(2)
    size = 0.0
    for seed in range(20):
        cycle = wanted(100 + seed)
        speed = cycle.twist(t)
        size += np.sum(speed[:, :2] ** 2)
        for k, (bench, command) in enumerate(((told, cycle), (corrected, response.command(cycle)))):
            miss[k] += np.sum((bench.play(command).twist(t) - speed)[:, :2] ** 2)
    raw, left = np.sqrt(miss / size)
    assert raw > 0.5
    assert left < 0.1


def test_what_is_measured_later_corrects_it(learned):
    """Cycles that are repeated, each a new one: a plate that has become 10 % softer is found."""
    frequency = np.arange(1, 30) / 0.2
    exact = learned[0]._at(learned[0].matrix, frequency)
    response = Response(frequency, 1.1 * exact, learned[0].lever)
    assert steady_error(wanted(7), response.command(wanted(7))) > 0.08
    t = np.arange(512) * 0.2 / 512
    for seed in range(200, 208):
        command = response.command(wanted(seed))
        motion = Bench().play(command, 12)
        got = 2 / 512 * np.fft.rfft(motion.accel(t), axis=0)[1:30]
        response = response.learned(harmonics(command, 29), got)
    assert steady_error(wanted(7), response.command(wanted(7))) < 0.04


def test_commands_begin_at_rest_and_keep_the_limits(learned):
    response, _ = learned
    for seed in range(3):
        cycle = wanted(seed).scaled(10)
        assert response.command(cycle).starts_at_rest
        table, fit = prepare(RIG, cycle, 0, correction=response.command)
        assert np.max(np.abs(table.q)) <= RIG.limits.stroke_m
        assert fit.factor < 1
        np.testing.assert_allclose(
            table.cycle.knot_pose, response.command(fit.cycle).knot_pose, atol=2e-6
        )


def test_a_response_is_kept_in_a_file(learned, tmp_path):
    path = tmp_path / "response.npz"
    save_response(path, learned[0])
    again = saved_response(path)
    np.testing.assert_array_equal(again.matrix, learned[0].matrix)
    np.testing.assert_array_equal(again.frequency, learned[0].frequency)
