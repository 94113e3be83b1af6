"""Areas, sides, edges and directions of shadows, against plain numpy."""

import numpy as np
import pytest

from plate_vision import _kernels
from plate_vision.shapes.shadows import LIGHTER, find_sides, remove_shadows

HALFWAY, MIN_SEEN, DARKEST, MIN_UNIFORM, DARKER = (0.3, 0.7), 4, 0.45, 12, 0.3
"""As in shadows.hpp."""
EVEN = 0.3
"""As in segmentation.hpp."""


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
def test_the_fade_kernel_agrees_with_numpy(seed):
    given = scene(np.random.default_rng(seed))
    fade, way = np.zeros(len(given[5]), np.float32), np.zeros((len(given[5]), 2))
    _kernels.find_fade(*given, fade, way)
    expected = in_numpy(*given)
    np.testing.assert_allclose(fade, expected[0], rtol=1e-5)
    np.testing.assert_allclose(way, expected[1], rtol=1e-9)
    assert np.hypot(*way.T) == pytest.approx([0, 1, 0, 0, 0, 1])


@pytest.mark.parametrize("channels", [1, 3])
def test_areas_similar_to_a_darker_plate_agree_with_numpy(channels):
    rng = np.random.default_rng(channels)
    shape, count, chroma = (40, 60), 6, 0.9
    bare = np.full((*shape, channels), 128, np.uint8) + rng.integers(0, 40, channels, np.uint8)
    lab = (bare + rng.integers(-30, 20, (*shape, channels))).astype(np.uint8)
    limit = rng.integers(5, 30, shape).astype(np.uint8)
    labels = scene(rng, count, shape)[4]
    lab[labels == 2, 0] = 60  # darker than any shadow
    sides = find_sides(lab, bare, chroma, limit, labels, count)
    light, plate = lab[..., 0].astype(float), bare[..., 0].astype(float)
    padded = np.pad(light, 1, mode="edge")
    around = [padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1]]
    slope = np.hypot(around[1] - around[0], around[3] - around[2]) / 2
    inner, dark = labels > 0, light < plate
    like = inner & dark
    if channels == 3:  # the plate's chroma, darkened as its lightness
        tint = 128 + (light / plate)[..., None] * (bare[..., 1:] - 128.0)
        like &= chroma * np.linalg.norm(lab[..., 1:] - tint, axis=-1) <= limit
    assert 0.1 < like[inner].mean() < 0.9
    beside = inner & dark & (np.max(around, axis=0) <= plate + limit)
    np.testing.assert_array_equal(sides.like, like)
    np.testing.assert_array_equal(sides.lit, like & (light >= DARKEST * plate))
    np.testing.assert_allclose(sides.slope, np.where(inner & dark, slope, 0), rtol=1e-6)
    for k in range(1, count):
        own = labels == k
        assert sides.steepest[k] == pytest.approx(np.max(slope[own & beside], initial=0))
        assert sides.largest[k] == np.max((plate - light)[own & beside], initial=0)
        assert sides.total[k] == np.sum(own)
        assert sides.balance[k] == np.sum(own & ~dark) - np.sum(own & like)


@pytest.mark.parametrize("seed", range(3))
def test_light_and_dark_sides_are_those_of_otsu(seed):
    rng = np.random.default_rng(seed)
    away, _, like, slope, labels, *_ = scene(rng)
    count = 6
    for k, fraction in enumerate((0.0, 0.5, 0.5, 0.9, 0.3, 0.6)):  # of a shadow beside a part
        shade = rng.random(labels.shape) < fraction
        level = np.where(shade, rng.normal(20, 4, labels.shape), rng.normal(44, 4, labels.shape))
        away[labels == k] = np.clip(level, 1, 255).astype(np.uint8)[labels == k]
    away[labels == 2] = 40
    like[labels == 4] = False
    steepest = np.full(count, 2.0, np.float32)
    bound, light, dark = (np.zeros(count, np.float32) for _ in range(3))
    _kernels.part_sides(away, like, slope, steepest, labels, bound, light, dark)
    for k in range(1, count):
        own = (labels == k) & (slope < EVEN * steepest[k])
        level = away[own].astype(float)
        splits = [(level[level <= at], level[level > at]) for at in range(255)]
        splits = [each for each in splits if min(map(len, each)) >= MIN_UNIFORM]
        between = [len(a) * len(b) * (np.mean(b) - np.mean(a)) ** 2 for a, b in splits]
        low, high = map(np.mean, splits[np.argmax(between)]) if splits else (0.0, 0.0)
        border = 0.5 * (low + high) if low <= LIGHTER * high else 0.0
        if 2 * np.sum(like[own] & (level < int(border))) < np.sum(level < int(border)):
            border = 0.0
        assert (bound[k], light[k]) == pytest.approx((border, low))
        assert np.sum(level > dark[k]) >= DARKER * len(level) > np.sum(level > dark[k] + 1)
    assert (bound[1:] > 0).tolist() == [True, False, True, False, True]


@pytest.mark.parametrize("face", [None, 1, 2])
def test_a_patch_of_which_side_faces_are_seen_has_no_shadow(face):
    """Two dark parts, each with a lighter side whose edge is soft."""
    light = np.full((60, 120), 200.0)
    for x in (20, 80):
        ramp = np.clip((np.arange(120) - x - 6) / 6, 0, 1) * np.clip(
            (x + 26 - np.arange(120)) / 8, 0, 1
        )
        light[20:40] -= 60 * ramp
        light[20:40, x - 8 : x + 12] = 40
    labels = np.zeros(light.shape, np.int32)
    labels[20:40, 10:48], labels[20:40, 70:108] = 1, 2
    away = np.where(labels > 0, 200 - light, 0).astype(np.uint8)
    labels[away == 0] = 0
    lab = light.astype(np.uint8)[..., None]
    sides = find_sides(
        lab, np.full_like(lab, 200), 0.0, np.full(light.shape, 5, np.uint8), labels, 3
    )
    faces = None if face is None else np.arange(3) == face
    left = away.copy()
    cut = remove_shadows(sides, left, labels, faces=faces)
    assert cut.tolist() == [False, face != 1, face != 2]
    for k in (1, 2):
        shade = (labels == k) & (away < 100)
        assert (
            np.mean(left[shade] == 0) > 0.9
            if face != k
            else np.array_equal(left[labels == k], away[labels == k])
        )
