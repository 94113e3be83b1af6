"""Reversed axes of the image, by the motion of the parts."""

import numpy as np
import pytest

from plate_core import Parts
from plate_planner.supervision import Agreement

IDS = tuple(f"grey_{k}" for k in range(1, 6))
WORDS = "the image is mirrored or rotated"


@pytest.fixture
def rng():
    return np.random.default_rng(20261130)


def after(rng, cycles, sign, *, scale=1.0, noise=0.2e-3, length=3e-3, late=0.0):
    """Return the agreement after cycles in which the parts move by `scale` times the prediction
    along each axis, with the signs (2,) of the image's axes."""
    agreement = Agreement()
    position = rng.uniform(-0.1, 0.1, (len(IDS), 2))
    for k in range(cycles):
        move = rng.normal(0, length, position.shape)
        seen = Parts.make(IDS, position)
        agreement = agreement.expecting(seen, IDS, position + move, 0.1 * k + 0.1)
        position = position + move * scale * np.array(sign) + rng.normal(0, noise, position.shape)
        agreement = agreement.seeing(Parts.make(IDS, position), 0.1 * k + 0.1 + late)
    return agreement


@pytest.mark.parametrize("sign", [(-1, 1), (1, -1), (-1, -1)])
def test_reversed_axes_are_named(rng, sign):
    agreement = after(rng, 6, sign)
    assert np.sign(agreement.correlation).tolist() == list(sign)
    assert WORDS in agreement.explained("grey_1 left the plate")
    assert agreement.explained("grey_1 left the plate").endswith("; grey_1 left the plate")


@pytest.mark.parametrize("options", [{}, {"scale": 0.5}, {"scale": 1.5}, {"noise": 2e-3}])
def test_wrong_friction_and_noise_are_no_reversed_axes(rng, options):
    assert after(rng, 20, (1, 1), **options).explained("why") == "why"


def test_uncertain_displacements_are_not_compared(rng):
    for cycles, options in (
        (2, {}),  # too few displacements
        (20, {"length": 0.1e-3}),  # too short
        (20, {"length": 0.2}),  # a hand
        (20, {"late": 0.05}),  # no image at the predicted time
    ):
        assert after(rng, cycles, (-1, -1), **options).text == ""
    gone = Agreement().expecting(Parts.make(IDS, np.zeros((5, 2))), IDS[:2], np.ones((2, 2)), 1.0)
    assert len(gone.seeing(Parts.make(IDS[3:], np.ones((2, 2))), 1.0).moves) == 0
