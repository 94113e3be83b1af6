"""The bare plate's brightness, where parts hide it, against the brightness that was drawn."""

import cv2
import numpy as np
import pytest

from plate_vision import ImageError, make_region
from plate_vision._kernels import bare
from plate_vision.plate import fit_light
from plate_vision.plate.light import check_complete, light_problem

X_PX, Y_PX = np.meshgrid(np.arange(40, 600, 20), np.arange(110, 380, 20))


@pytest.fixture
def region(corners_px):
    return make_region((640, 480), corners_px)


def truth(x, y):
    """The shading `slope` on a plate of 220 grey levels."""
    return 220 * (1 + 0.05 * (2 * x / 639 - 1) - 0.03 * (2 * y / 479 - 1))


def seen(plate):
    """The fitted brightness at the same pixels."""
    return np.vectorize(lambda x, y: bare(plate.light, x, y))(X_PX, Y_PX)


@pytest.mark.parametrize("count", [0, 100])
def test_parts_do_not_darken_the_plate(draw, region, rng, count):
    """A hundred grey parts and their edges, which are hardly darker than the plate."""
    centre = np.stack([X_PX.ravel(), Y_PX.ravel()], axis=1)
    centre = centre[rng.permutation(len(centre))[:count]]
    frame = draw(centre, ["grey"] * count, rng)
    plate = fit_light(frame, region, 60)
    assert np.abs(seen(plate) - truth(X_PX, Y_PX)).max() < 0.6


def test_a_dark_background_does_not_change_the_fitted_light(draw, rng):
    """Also if the place of the plate is not given."""
    plate = fit_light(draw([], [], rng), make_region((640, 480)), 60)
    assert np.abs(seen(plate) - truth(X_PX, Y_PX)).max() < 1.5


def test_without_light_there_is_no_plate(draw, region, rng):
    assert fit_light(draw([], [], rng, light=0.2), region, 60) is None
    assert fit_light(np.zeros((480, 640), np.uint8), region, 0) is None


def test_a_plate_that_is_too_dark_beside_a_bright_room_is_named(draw, region, rng):
    frame = draw([], [], rng)
    assert light_problem(frame, 60, region) is None
    frame[region.usable] //= 8
    frame[~region.usable] = 200
    assert light_problem(frame, 60) is None
    assert light_problem(frame, 60, region, plate_found=True) is None
    assert "no plate of at least 60 grey levels is visible" in light_problem(frame, 60, region)


def test_an_overexposed_plate_is_named(draw, region, rng):
    frame = draw([], [], rng)
    for fraction, overexposed in ((0.1, False), (0.3, True)):
        burnt = frame.copy()
        x0, _, x1, _ = region.box
        burnt[:, x0 : round(x0 + fraction * (x1 - x0))] = 255
        problem = str(light_problem(burnt, 60, region))
        assert ("% of the plate is overexposed" in problem) is overexposed
    frame[~region.usable] = 255
    assert light_problem(frame, 60, region) is None


def test_images_without_their_last_rows_are_refused(draw, region, rng):
    """A plate that lies elsewhere, also before a black ground, is not such an image."""
    whole = draw([], [], rng)
    x0, y0, x1, y1 = region.box
    middle = (y0 + y1) // 2
    for shape in (whole, np.dstack([whole] * 3)):
        check_complete(shape, region)
        for rest in (0, 200):  # the last transmitted row may be incomplete
            lost = shape.copy()
            lost[middle + 1 :] = 0
            lost[middle, rest or 640 :] = 0
            with pytest.raises(ImageError, match=f"the last {479 - middle} rows are black"):
                check_complete(lost, region)
    for ground in (0, 20):
        for blur in (0.5, 1.0):
            moved = np.full((480, 640), ground, np.uint8)
            moved[: (y0 + middle) // 2, x0:x1] = 220
            moved = cv2.GaussianBlur(moved, (0, 0), blur)
            check_complete(moved, region)
    check_complete(np.zeros((480, 640), np.uint8), region)  # no light: `light_problem` reports it
    check_complete(np.full((1, 1), 9, np.uint8), make_region((1, 1)))
