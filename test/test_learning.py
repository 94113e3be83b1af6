"""The driver learns the simulated plate: 35 Hz, damping 3 %, motors that differ by 15 %."""

import os

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_driver.calibration import Calibration, Response, harmonics, save_response, saved_response
from plate_driver.setpoints import prepare
from stages.learning import Plate, harmonics_error, random_cycle, rig_on_flexures

RIG = load_rig()
HUNG = rig_on_flexures(RIG)


def steady_error(cycle: PlateCycle, command: PlateCycle) -> float:
    """Error of the harmonics of a cycle, once its command has been repeated for 2.4 s."""
    return harmonics_error(HUNG, cycle, command) / 100


@pytest.fixture(name="learned", scope="module")
def _learned() -> tuple[Response, int]:
    """The response after a calibration, and how many experiments that took."""
    plate, calibration, count = Plate(HUNG, 0), Calibration.start(RIG), 0
    while calibration.cycle is not None:
        plate.play(calibration.cycle, calibration.settle)
        calibration = calibration.with_experiment(
            *plate.read(calibration.cycle, calibration.measure)
        )
        count += 1
    return calibration.response, count


def test_errors_fall_from_over_a_half_to_below_two_per_cent(learned):
    response, experiments = learned
    assert experiments <= 10
    for seed in range(5):  # none of them was seen in the calibration
        cycle = random_cycle(seed)
        assert steady_error(cycle, cycle) > 0.5
        assert steady_error(cycle, response.command(cycle)) < 0.02


def test_a_new_cycle_every_200_ms_is_right_too(learned):
    response, _ = learned
    reported, corrected = Plate(HUNG, 0), Plate(HUNG, 0)
    t = np.linspace(0, 0.2, 400)
    miss = np.zeros(2)
    size = 0.0
    for seed in range(20):
        cycle = random_cycle(100 + seed)
        speed = cycle.twist(t)
        size += np.sum(speed[:, :2] ** 2)
        for k, (plate, command) in enumerate(
            ((reported, cycle), (corrected, response.command(cycle)))
        ):
            miss[k] += np.sum((plate.play(command).twist(t) - speed)[:, :2] ** 2)
    raw, left = np.sqrt(miss / size)
    assert raw > 0.5
    assert left < 0.1


def test_later_measurements_correct_the_response(learned):
    """Cycles that are repeated, each a new one: a plate that has become 10 % softer is found."""
    frequency = np.arange(1, 30) / 0.2
    exact = learned[0]._interpolate(learned[0].matrix, frequency)
    response = Response(frequency, 1.1 * exact, learned[0].lever)
    assert steady_error(random_cycle(7), response.command(random_cycle(7))) > 0.08
    t = np.arange(512) * 0.2 / 512
    for seed in range(200, 208):
        command = response.command(random_cycle(seed))
        motion = Plate(HUNG, 0).play(command, 12)
        got = 2 / 512 * np.fft.rfft(motion.accel(t), axis=0)[1:30]
        response = response.updated(harmonics(command, 29), got)
    assert steady_error(random_cycle(7), response.command(random_cycle(7))) < 0.04


def test_commands_begin_at_rest_and_keep_the_limits(learned):
    response, _ = learned
    for seed in range(3):
        cycle = random_cycle(seed).scaled(10)
        assert response.command(cycle).starts_at_rest
        table, scaled = prepare(RIG, cycle, 0, correction=response.command)
        assert np.max(np.abs(table.q)) <= RIG.limits.stroke_m
        assert scaled.factor < 1
        np.testing.assert_allclose(
            table.cycle.knot_pose, response.command(scaled.cycle).knot_pose, atol=2e-6
        )


def test_a_response_is_kept_in_a_file(learned, tmp_path):
    path = tmp_path / "response.npz"
    save_response(path, learned[0])
    again = saved_response(path)
    np.testing.assert_array_equal(again.matrix, learned[0].matrix)
    np.testing.assert_array_equal(again.frequency, learned[0].frequency)


def test_a_full_disk_leaves_the_old_file_whole(learned, tmp_path, monkeypatch):
    path = tmp_path / "response.npz"
    save_response(path, learned[0])
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(before[:1000])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(PlateError, match=r"response\.npz: cannot be written .*No space left"):
        save_response(path, learned[0])
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("kept", [0.0, 0.001, 0.01, 0.5, 0.99])
def test_a_damaged_file_is_refused_with_a_message_of_one_line(learned, tmp_path, kept):
    path = tmp_path / "response.npz"
    save_response(path, learned[0])
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(PlateError, match=r"response\.npz: not a valid calibration") as caught:
        saved_response(path)
    assert "\n" not in str(caught.value)


def test_a_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "response.npz"
    for content in ({"frequency": np.arange(3)}, {"frequency": 1.0, "matrix": 2.0, "lever": 3.0}):
        np.savez(path, **content)
        with pytest.raises(PlateError, match="not a valid calibration"):
            saved_response(path)
    np.savez_compressed(path, frequency=np.zeros(20_000_000), matrix=2.0, lever=3.0)
    with pytest.raises(PlateError, match=r"160\d+ bytes, allowed: up to 1000000"):
        saved_response(path)
    path.write_bytes(b"hello")
    with pytest.raises(PlateError, match="not a valid calibration"):
        saved_response(path)
    path.unlink()
    os.mkfifo(path)  # a pipe without a writer
    with pytest.raises(PlateError, match=r"not a valid calibration .*is a FIFO, allowed: a reg"):
        saved_response(path)
