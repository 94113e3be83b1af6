"""Remains of an image: highlights and holes belong to the object around them, specks to none."""

import numpy as np
import pytest

from plate_vision.remains import Remains, clean_remains


def after(deviating, radius_px=4.0, stride=2):
    outside = np.zeros(deviating.shape, bool)
    return clean_remains(Remains(deviating, outside, (0, 0, stride)), radius_px).deviating


@pytest.mark.parametrize(
    ("hole", "filled"),
    [((2, 3), True), ((3, 2), True), ((1, 1), True), ((3, 3), False), ((1, 7), False)],
)
def test_an_enclosed_area_of_up_to_half_a_part_is_filled(hole, filled):
    deviating = np.zeros((20, 30), np.uint8)
    deviating[2:15, 4:20] = 1
    object_alone = deviating.copy()
    deviating[5 : 5 + hole[0], 8 : 8 + hole[1]] = 0
    np.testing.assert_array_equal(after(deviating), object_alone if filled else deviating)
    np.testing.assert_array_equal(after(deviating, radius_px=9.0), object_alone)


@pytest.mark.parametrize("turns", range(4))
def test_an_area_at_the_edge_of_the_grid_is_not_enclosed(turns):
    deviating = np.zeros((20, 30), np.uint8)
    deviating[4:15, :9] = 1
    deviating[8:10, :2] = 0
    deviating = np.ascontiguousarray(np.rot90(deviating, turns))
    np.testing.assert_array_equal(after(deviating), deviating)


@pytest.mark.parametrize("size", [(1, 1), (2, 9), (9, 2), (3, 3), (3, 9), (9, 3)])
def test_specks_are_removed(size):
    deviating = np.zeros((20, 30), np.uint8)
    deviating[4 : 4 + size[0], 6 : 6 + size[1]] = 1
    np.testing.assert_array_equal(after(deviating), deviating if min(size) >= 3 else 0)
