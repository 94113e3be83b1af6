"""Remains of an image: highlights and holes belong to the object around them, specks to none."""

import numpy as np
import pytest

from plate_vision.remains import Remains, clean_remains


def after(odd, radius_px=4.0, stride=2):
    outside = np.zeros(odd.shape, bool)
    return clean_remains(Remains(odd, outside, (0, 0, stride)), radius_px).odd


@pytest.mark.parametrize(
    ("hole", "filled"),
    [((2, 3), True), ((3, 2), True), ((1, 1), True), ((3, 3), False), ((1, 7), False)],
)
def test_an_enclosed_area_of_up_to_half_a_part_is_filled(hole, filled):
    odd = np.zeros((20, 30), np.uint8)
    odd[2:15, 4:20] = 1
    object_alone = odd.copy()
    odd[5 : 5 + hole[0], 8 : 8 + hole[1]] = 0
    np.testing.assert_array_equal(after(odd), object_alone if filled else odd)
    np.testing.assert_array_equal(after(odd, radius_px=9.0), object_alone)


@pytest.mark.parametrize("turns", range(4))
def test_an_area_at_the_edge_of_the_grid_is_not_enclosed(turns):
    odd = np.zeros((20, 30), np.uint8)
    odd[4:15, :9] = 1
    odd[8:10, :2] = 0
    odd = np.ascontiguousarray(np.rot90(odd, turns))
    np.testing.assert_array_equal(after(odd), odd)


@pytest.mark.parametrize("size", [(1, 1), (2, 9), (9, 2), (3, 3), (3, 9), (9, 3)])
def test_specks_are_removed(size):
    odd = np.zeros((20, 30), np.uint8)
    odd[4 : 4 + size[0], 6 : 6 + size[1]] = 1
    np.testing.assert_array_equal(after(odd), odd if min(size) >= 3 else 0)
