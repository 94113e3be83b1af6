"""The slope and direction of shadows' edges, against plain numpy."""

import numpy as np
import pytest

from plate_vision import _kernels

HALFWAY, MIN_SEEN = (0.3, 0.7), 4
"""As in shadows.hpp."""


def scene(rng, count=6, shape=(40, 60)):
    """Return random arguments, of patches of all kinds: of one side only, and without a bound."""
    labels = np.zeros(shape, np.int32)
    for k in range(1, count):
        labels[5 : 5 + 6 * k, 10 * k - 8 : 10 * k] = k
    away = rng.integers(0, 60, shape).astype(np.uint8)
    around = rng.integers(0, 60, shape).astype(np.uint8)
    like = rng.random(shape) < 0.7
    like[labels == 2] = False
    like[labels == 3], away[labels == 3] = True, 5
    bound = np.full(count, 40, np.float32)
    bound[4] = 0
    level = np.full(count, 30, np.float32)
    return away, around, like, rng.random(shape).astype(np.float32), labels, bound, level


def in_numpy(away, around, like, slope, labels, bound, level):
    count = len(bound)
    fade, way = np.zeros(count), np.zeros((count, 2))
    for k in 1 + np.flatnonzero(bound[1:]):  # 0 is outside
        inside = labels == k
        light = inside & like & (away < bound[k])
        edge = inside & like & (around <= bound[k])
        edge &= (HALFWAY[0] * level[k] < away) & (away < HALFWAY[1] * level[k])
        if np.count_nonzero(edge) >= MIN_SEEN:
            fade[k] = np.mean(slope[edge])
        dark = inside & ~light
        if light.any() and dark.any():
            apart = np.argwhere(light).mean(axis=0) - np.argwhere(dark).mean(axis=0)
            way[k] = apart[::-1] / np.hypot(*apart)
    return fade, way


@pytest.mark.parametrize("seed", range(3))
def test_it_is_that_of_plain_numpy(seed):
    given = scene(np.random.default_rng(seed))
    fade, way = np.zeros(len(given[5]), np.float32), np.zeros((len(given[5]), 2))
    _kernels.find_fade(*given, fade, way)
    expected = in_numpy(*given)
    np.testing.assert_allclose(fade, expected[0], rtol=1e-5)
    np.testing.assert_allclose(way, expected[1], rtol=1e-9)
    assert np.hypot(*way.T) == pytest.approx([0, 1, 0, 0, 0, 1])
