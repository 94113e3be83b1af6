"""Images that would take long: counts bound the work, and parts are detected all the same."""

import cv2
import numpy as np

from plate_vision.shapes import find_patches, grouping, learn_plate, segmentation
from plate_vision.shapes.grouping import Work, split_into_pieces

SIZE = (240, 320)


def plate(seed, noise=2.0, light=1.0):
    rng = np.random.default_rng(seed)
    image = 205 * light + noise * rng.standard_normal((*SIZE, 3))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def with_discs(image, spots, radius=9):
    for x, y in spots:
        cv2.circle(image, (x, y), radius, (45, 45, 45), -1, cv2.LINE_AA)
    return image


SPOTS = [(40 + 60 * k, y) for k in range(5) for y in (50, 120, 190)]


def test_a_count_that_is_used_up_gives_nothing_more():
    work = Work(10)
    assert work.take(7)
    assert not work.take(4)
    assert work.take(3)


def test_a_plate_sized_patch_is_one_group_and_is_not_cut(monkeypatch):
    """As with light that the detector has not followed: most of the plate then differs by more than
    its noise."""
    cuts = []
    split = grouping.split_patch
    monkeypatch.setattr(grouping, "split_patch", lambda *a: cuts.append(a[1].size) or split(*a))
    bare = learn_plate(np.stack([plate(seed) for seed in (1, 2, 3)]))
    found = find_patches(with_discs(plate(7, light=0.93), SPOTS), bare)
    large = [patch for patch in found if patch.area_px2 > 0.5 * SIZE[0] * SIZE[1]]
    assert [patch.group for patch in large] == [True]
    assert sum(cuts) < 0.1 * SIZE[0] * SIZE[1]


def test_patches_of_noise_do_not_displace_parts(monkeypatch):
    monkeypatch.setattr(segmentation, "MAX_PATCHES", 20)
    bare = learn_plate(np.stack([plate(seed) for seed in (1, 2, 3)]))
    image = plate(7)
    for x in range(10, 320, 20):  # 48 specks between the parts
        for y in (20, 85, 155):
            cv2.circle(image, (x, y), 4, (90, 90, 90), -1)
    found = find_patches(with_discs(image, SPOTS), bare)
    assert len(found) <= 20
    for spot in SPOTS:
        assert min(np.hypot(*(patch.centre_px - spot)) for patch in found) < 2


def test_pieces_without_work_left_are_groups(monkeypatch):
    inside = np.zeros((60, 100), bool)
    for x in (20, 45, 70):
        cv2.circle(canvas := inside.astype(np.uint8), (x, 30), 14, 1, -1)
        inside |= canvas > 0
    solid = (inside, inside.astype(np.float32), np.full((60, 100, 3), 60, np.uint8))
    assert len(split_into_pieces([solid], 30, 8.75, 60 * 100 * 10)) == 3
    monkeypatch.setattr(grouping, "WORK", 0.0)
    assert [piece.group for piece in split_into_pieces([solid], 30, 8.75, 60 * 100 * 10)] == [True]
