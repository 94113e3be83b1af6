"""Kernels refuse arguments with which they would read or write outside memory."""

import numpy as np
import pytest

from plate_vision import _kernels

GREY, USABLE = np.zeros((20, 30), np.uint8), np.ones((20, 30), bool)
LIGHT = np.float32([200, 0, 0, 0, 0, 0, 15, 10, 0.1])
PLATE = GREY, LIGHT, USABLE
EIGHTS = np.full(4, 8.0)
DISCS = np.tile([1.0, 0, 0, 1, 8, 0, 0, 1], (4, 1))
WHOLE = np.zeros((0, 3)), np.zeros((0, 8))
NO_SHADOW = np.empty((0, 2)), 0.0, 1.0
LABELS = np.full((20, 30), 3, np.int32)
FIELD = np.zeros((20, 30), np.float32)
PAIRS, THREE = np.ones((4, 2)), np.zeros(3)
TO_PX = np.eye(2, 3)
EDGES = np.array([[0.0, 0, 1, 0, 1]])


def outputs(*names):
    """Return arrays of float32 for three patches, or other types."""
    return [np.zeros(3, name) for name in names]


WRONG = {
    "samples outside the image": lambda: _kernels.fit_light(
        GREY, np.array([20]), np.array([0]), np.zeros((6, 1), np.float32), 60
    ),
    "edges of two numbers": lambda: _kernels.region_depth(PAIRS, np.zeros((0, 8)), THREE, THREE),
    "a light for two channels": lambda: _kernels.write_contrast(
        GREY[..., None], np.stack([LIGHT, LIGHT]), (0, 0, 30, 20), GREY
    ),
    "contrast beyond the image": lambda: _kernels.write_contrast(
        GREY[..., None], LIGHT[None], (0, 0, 31, 20), GREY
    ),
    "a grid beyond the colours": lambda: _kernels.find_deviating(
        GREY[..., None], LIGHT[None], 0.1, (0, 0, 2), np.zeros((20, 30), np.uint8)
    ),
    "parts that are not drawn": lambda: _kernels.clear_parts(GREY, (0, 0, 1), PAIRS, DISCS[1:]),
    "more pixels to look at than there are": lambda: _kernels.any_deviating(
        GREY[..., None], LIGHT[None], 0.1, USABLE, (0, 1, 1), PAIRS, DISCS
    ),
    "silhouettes of other parts": lambda: _kernels.any_deviating(
        GREY[..., None], LIGHT[None], 0.1, USABLE, (0, 0, 1), PAIRS, DISCS[1:]
    ),
    "no place for marks": lambda: _kernels.measure_dark(
        *PLATE, 0.01, *WHOLE, PAIRS, DISCS, np.zeros((4, 7)), PAIRS[1:], np.zeros(4, bool)
    ),
    "dark parts without a silhouette": lambda: _kernels.measure_dark(
        *PLATE, 0.01, *WHOLE, PAIRS, DISCS[1:], np.zeros((4, 7)), 0 * PAIRS, np.zeros(4, bool)
    ),
    "dark parts beside two edges with one bow": lambda: _kernels.measure_dark(
        *PLATE,
        0.01,
        np.zeros((2, 3)),
        np.zeros((1, 8)),
        PAIRS,
        DISCS,
        np.zeros((4, 7)),
        0 * PAIRS,
        np.zeros(4, bool),
    ),
    "discs of six numbers": lambda: _kernels.judge(
        np.zeros((4, 6)), DISCS, PAIRS, EIGHTS, *WHOLE, 0.01, 0.2, 0.4, 1.0
    ),
    "discs without a brightness": lambda: _kernels.judge(
        np.zeros((4, 7)), DISCS, PAIRS, THREE, *WHOLE, 0.01, 0.2, 0.4, 1.0
    ),
    "brightness without radii": lambda: _kernels.find_brightness(
        GREY[..., None], LIGHT[None], PAIRS, THREE, 0.6
    ),
    "another size of plate": lambda: _kernels.vote(GREY, LIGHT, USABLE[1:], 0, 0, DISCS[:1], FIELD),
    "a light of six numbers": lambda: _kernels.vote(
        GREY, LIGHT[:6], USABLE, 0, 0, DISCS[:1], FIELD
    ),
    "a grid beyond the image": lambda: _kernels.find_dark(
        *PLATE, 0.8, (0, 0, 2), USABLE, np.zeros((20, 30), np.uint8)
    ),
    "a step of nothing": lambda: _kernels.find_peaks(FIELD, 0, 0, USABLE, (0, 0, 0), 8),
    "no room for discs": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS, *NO_SHADOW, 0.01, np.zeros((3, 7))
    ),
    "an endless radius": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS + [0, 0, 0, 0, np.inf, 0, 0, 0], *NO_SHADOW, 0.01, np.zeros((4, 7))
    ),
    "an endless lean": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS + [0, 0, 0, 0, 0, np.inf, 0, 0], *NO_SHADOW, 0.01, np.zeros((4, 7))
    ),
    "a silhouette without area": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS * [0, 0, 0, 0, 1, 1, 1, 1], *NO_SHADOW, 0.01, np.zeros((4, 7))
    ),
    "too few silhouettes": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS[1:], *NO_SHADOW, 0.01, np.zeros((4, 7))
    ),
    "a shadow of fewer discs": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS, PAIRS[1:], 0.5, 1.0, 0.01, np.zeros((4, 7))
    ),
    "an endless shadow": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS, PAIRS * np.inf, 0.5, 1.0, 0.01, np.zeros((4, 7))
    ),
    "a shadow without an edge": lambda: _kernels.fit_discs(
        *PLATE, PAIRS, DISCS, PAIRS, 0.5, 0.0, 0.01, np.zeros((4, 7))
    ),
    "no silhouette for a seed": lambda: _kernels.find_marks(*PLATE, 0.01, PAIRS, DISCS[1:]),
    "a radius of nothing": lambda: _kernels.find_marks(
        *PLATE, 0.01, PAIRS, DISCS * [1, 1, 1, 1, 0, 1, 1, 1]
    ),
    "a box beyond the image": lambda: _kernels.relight(
        GREY[..., None], np.zeros((6, 1), np.float32), LIGHT[6:], (0, 0, 31, 20), GREY[..., None]
    ),
    "a light of five terms": lambda: _kernels.relight(
        GREY[..., None], np.zeros((5, 1), np.float32), LIGHT[6:], (0, 0, 30, 20), GREY[..., None]
    ),
    "a label too large": lambda: _kernels.find_contrasts(
        LABELS, GREY, GREY, GREY, *outputs("f4", "f4", "?")
    ),
    "a negative label": lambda: _kernels.find_fade(
        GREY, GREY, USABLE, FIELD, -LABELS, *outputs("f4", "f4", "f4"), np.zeros((3, 2))
    ),
    "a distance without end": lambda: _kernels.find_basins(
        FIELD + np.inf, 0.8, 0.6, 16, np.zeros((20, 30), np.int32)
    ),
    "a field of one row": lambda: _kernels.find_edge(
        FIELD[:1], np.ones((4, 2), np.int32), False, np.empty((8, 2))
    ),
    "rings beyond the points": lambda: _kernels.outline_edges(PAIRS, np.array([3, 5])),
    "rings that end before they begin": lambda: _kernels.outline_edges(PAIRS, np.array([3, 2])),
    "no edges": lambda: _kernels.distances(EDGES[:0], PAIRS),
    "a pose of two numbers": lambda: _kernels.fit_pose(EDGES, PAIRS, THREE[:2], 1, True, 5, 1, 1),
    "a stride of nothing": lambda: _kernels.search(
        FIELD, FIELD, TO_PX, PAIRS, PAIRS, THREE[:2], 1, THREE, 0
    ),
    "a rim that is nowhere": lambda: _kernels.search(
        FIELD, FIELD, TO_PX, np.nan * PAIRS, PAIRS, THREE[:2], 0, THREE, 1
    ),
    "a rim far away": lambda: _kernels.search(
        FIELD, FIELD, TO_PX, 1e9 * PAIRS, PAIRS, THREE[:2], 0, THREE, 1
    ),
}


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG)
def test_wrong_calls_raise(call):
    with pytest.raises((ValueError, IndexError)):
        call()


def test_an_array_of_another_type_is_not_written_to():
    with pytest.raises(TypeError):
        _kernels.crowded(PAIRS, 1.0, np.zeros(4, np.uint8))
