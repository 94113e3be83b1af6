"""Faint patches that the detector does not see are counted."""

import numpy as np
import pytest
from shown_text import says

from plate_core import load_rig
from plate_core.status import Level
from plate_vision import make_vision
from plate_vision.faint import faint_finding, faint_patches

VISION = make_vision(load_rig())
PLACES = np.array([[x, y] for x in (120.0, 240.0, 360.0, 480.0) for y in (180.0, 240.0, 300.0)])
NOBODY = np.zeros((0, 2))
RADIUS_PX, MARGIN_PX = VISION.options.radius_px, 10.0


def look(image, taken=NOBODY):
    return faint_patches(image, VISION.region, RADIUS_PX, taken, MARGIN_PX)


def spots(contrast, places=PLACES, radius=8.0):
    """Draw discs that differ from the plate by a number of grey levels."""

    def extra(image):
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        for cx, cy in places:
            image[np.hypot(x - cx, y - cy) <= radius] -= contrast

    return extra


@pytest.mark.parametrize(
    ("contrast", "noise"), [(3.0, 1.0), (5.0, 2.0), (-5.0, 2.0), (10.0, 8.0), (30.0, 20.0)]
)
def test_faint_discs_are_counted_far_below_the_noise(draw, rng, contrast, noise):
    image = draw([], [], rng, noise=noise, extra=spots(contrast))
    found, seen = look(image)
    assert len(PLACES) - 1 <= len(found) <= len(PLACES)
    away = np.hypot(*(found[:, None] - PLACES).transpose(2, 0, 1))
    assert np.max(np.min(away, axis=1)) < 4
    assert seen == pytest.approx(abs(contrast), rel=0.25)


@pytest.mark.parametrize("shading", ["flat", "slope", "vignette"])
@pytest.mark.parametrize("noise", [0.0, 2.0, 20.0])
def test_a_bare_plate_has_no_faint_patches(draw, rng, shading, noise):
    assert len(look(draw([], [], rng, noise=noise, shading=shading))[0]) == 0


def test_detected_parts_and_their_shadows_are_no_faint_patches(draw, rng):
    image = draw(PLACES, ["grey"] * len(PLACES), rng, radius=8.0, extra=spots(20, PLACES + 5))
    assert len(look(image, PLACES)[0]) == 0


def test_stripes_and_large_shadows_are_no_faint_patches(draw, rng):
    def extra(image):
        image[150:330, 200:204] -= 10  # a line
        image[150:330, 380:470] -= 10  # a shadow of something above

    assert len(look(draw([], [], rng, extra=extra))[0]) == 0


def test_the_edge_of_a_displaced_plate_is_no_faint_patch(draw, rng, corners_px):
    for way in ([9.0, 0.0], [-9.0, 5.0], [0.0, 9.0]):
        assert len(look(draw([], [], rng, corners=corners_px + way))[0]) == 0


def test_the_finding_warns_if_they_are_many():
    assert faint_finding(0, 0.0, 0) is None
    assert faint_finding(1, 4.5, 10).level == Level.OK
    found = faint_finding(3, 4.52, 10)
    assert found.level == Level.WARN
    assert says(found.message, "3 faint patches", "4.5 grey levels", "more light")
    assert faint_finding(1, 4.5, 0).level == Level.WARN
