"""When frames were taken, by stamps that scatter: regular cameras, dropped images, gaps."""

import time
from threading import Event

import numpy as np
import pytest
from fake_camera import FakeCamera

from plate_planner.estimation.frame_clock import ACQUIRE, MAX_S, FrameClock
from plate_vision.image_sources import Settings


def clocked(rate, seconds=15.0, scatter=0.005, dropped=0.0, seed=0):
    """Return the clock in the end, and by how much its instants were wrong in the second half."""
    rng = np.random.default_rng(seed)
    clock = FrameClock()
    last = -1.0
    errors = []
    for i in range(int(rate * seconds)):
        if rng.random() >= dropped:
            instant = 3.0 + i / rate
            last = max(instant + scatter * rng.standard_normal(), last + 1e-4)
            clock = clock.tick(last)
            errors.append(clock.instant - instant)
    return clock, np.array(errors[len(errors) // 2 :])


@pytest.mark.parametrize("rate", [5.0, 15.0, 30.0])
@pytest.mark.parametrize("dropped", [0.0, 0.02])
def test_the_scatter_of_stamps_is_taken_out(rate, dropped):
    for seed in range(4):
        clock, errors = clocked(rate, dropped=dropped, seed=seed)
        assert np.sqrt(np.mean(errors**2)) < 0.5 * 0.005
        assert clock.rate == pytest.approx(rate, rel=5e-3)
        assert clock.noise_s == pytest.approx(0.005, rel=0.5)


@pytest.mark.parametrize("rate", [60.0, 120.0])
def test_a_late_stamp_is_not_taken_for_a_dropped_image(rate):
    for seed in range(2):
        _, errors = clocked(rate, seed=seed)
        assert np.mean(np.abs(errors - np.median(errors)) > 0.5 / rate) < 0.02


@pytest.mark.parametrize("rate", [60.0, 120.0])
@pytest.mark.parametrize("scatter", [0.0, 0.002])
def test_dropped_images_do_not_lead_it_astray(rate, scatter):
    for seed in range(2):
        clock, errors = clocked(rate, scatter=scatter, dropped=0.02, seed=seed)
        assert np.mean(np.abs(errors) > 0.5 / rate) < 0.05
        assert clock.rate == pytest.approx(rate, rel=1e-3)


@pytest.mark.parametrize("rate", [15.0, 30.0, 60.0, 120.0])
def test_the_error_of_the_frame_clock_agrees_with_its_deviation(rate):
    squares = []
    for seed in range(4):
        rng, clock, last = np.random.default_rng(seed), FrameClock(), -1.0
        for i in range(int(6 * rate)):
            last = max(i / rate + 0.005 * rng.standard_normal(), last + 1e-4)
            clock = clock.tick(last)
            squares.append(((clock.instant - i / rate) / clock.deviation) ** 2)
    assert 0.4 < np.mean(squares) < 1.5


def test_true_stamps_stay_as_they_are():
    clock, errors = clocked(30.0, scatter=0.0)
    assert np.abs(errors).max() < 1e-6
    assert clock.rate == pytest.approx(30.0, rel=1e-4)


def test_the_stamp_is_used_until_the_frame_interval_is_known_and_after_a_gap():
    clock = FrameClock()
    assert clock.rate == 0
    for k in range(ACQUIRE - 1):
        clock = clock.tick(0.1 * k + 0.003 * (-1) ** k)
        assert clock.instant == clock.stamps[-1]
    assert clock.rate == pytest.approx(10, rel=0.1)
    for stamp in (clock.stamps[-1] + 2 * MAX_S, 0.5):
        clock = clock.tick(stamp)
        assert (clock.instant, clock.rate) == (stamp, 0)


def test_another_rate_is_found():
    clock = FrameClock()
    stamps = np.cumsum(np.concatenate([np.full(60, 1 / 30), np.full(400, 1 / 17)]))
    for stamp in stamps.tolist():
        clock = clock.tick(stamp)
    assert clock.rate == pytest.approx(17, rel=1e-2)
    assert clock.instant == pytest.approx(stamps[-1], abs=2e-3)


def test_the_frame_clock_does_not_diverge():
    """A camera with irregular times that drops every third image: its stamps stay accepted."""
    rng = np.random.default_rng(0)
    clock = FrameClock()
    for k in range(3000):
        if rng.random() < 0.3:
            continue
        stamp = 100 + k / 30 + 0.002 * rng.standard_normal()
        clock = clock.tick(stamp)
        assert abs(clock.instant - stamp) < 0.3


@pytest.mark.parametrize("kernel", [True, False])
def test_the_kernel_s_stamps_are_right_to_a_millisecond(kernel, tmp_path):
    """Of a camera of 60 images a second which arrive 5 to 25 ms late; without these stamps, no."""
    camera, rng = (
        FakeCamera(tmp_path / "video0", {"GREY": {(64, 48): (60,)}}),
        np.random.default_rng(0),
    )
    camera.flags |= 0 if kernel else 0x4000  # copied from elsewhere
    now = [0.0]
    settings = Settings(str(camera.path), 64, 48, 60.0, exposure_us=2000.0)
    source = camera.source(settings, lambda _: None, lambda: now[0])
    source.open()
    clock, errors, began = FrameClock(), [], time.monotonic()
    for k in range(240):
        taken = began + k / 60
        now[0] = taken + rng.uniform(0.005, 0.025)
        camera.show(bytes(64 * 48), taken)
        frame = source.read(Event())
        clock = clock.tick(frame.instant)
        errors.append(clock.instant - taken)
    source.close()
    assert bool(np.abs(errors[ACQUIRE:]).max() < 1e-3) is kernel
