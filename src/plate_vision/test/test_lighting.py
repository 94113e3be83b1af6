"""Light that changes between two images: followed within the plate's region, in every image."""

import cv2
import numpy as np
import pytest

from plate_vision import ImageError, make_region
from plate_vision.bare_plate import BarePlate, know_plate
from plate_vision.shapes import find_patches, learn_plate
from plate_vision.vision import Vision

SIZE = (320, 240)
PLATE, ROOM = np.array([205.0, 212.0, 208.0]), 12.0
CORNERS = np.array([[110, 60], [300, 64], [296, 190], [112, 186]])
SPOTS = [(150.3, 100.2), (210.7, 90.4), (260.2, 150.1), (170.4, 160.6)]
INK = [(40, 45, 50), (90, 90, 90), (40, 60, 130), (140, 90, 50)]
"""Blue, green, red."""


def picture(spots, seed, light=1.0, room=ROOM, tilt=0.0, tint=(1.0, 1.0, 1.0), radius=10):
    """A plate in a room that has a light of its own, with discs on it."""
    fine = np.full((4 * SIZE[1], 4 * SIZE[0], 3), room)
    scaled = np.rint(16 * (4 * (CORNERS + 0.5) - 0.5)).astype(np.int32)
    cv2.fillPoly(fine, [scaled], PLATE.tolist(), shift=4)
    for (x, y), ink in zip(spots, INK * len(spots), strict=False):
        middle = np.rint(16 * (4 * (np.array([x, y]) + 0.5) - 0.5)).astype(int)
        cv2.circle(fine, middle.tolist(), 16 * 4 * radius, ink, -1, cv2.LINE_8, 4)
    image = cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA)
    lit = light * np.array(tint) * (1 + tilt * np.linspace(-1, 1, SIZE[0]))[:, None]
    image = np.where(np.all(image == room, axis=2)[:, :, None], image, image * lit)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    image += 2 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def grey(image):
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def learned(room=ROOM, look=np.asarray):
    return learn_plate(np.stack([look(picture([], seed, room=room)) for seed in (1, 2, 3)]))


def region():
    return make_region(SIZE, CORNERS)


def worst(image, background):
    """Largest error of the centres [px], once there are as many."""
    patches = find_patches(image, background, region())
    assert len(patches) == len(SPOTS)
    gap = [np.hypot(*(np.array(SPOTS) - patch.centre_px).T).min() for patch in patches]
    return max(gap)


@pytest.mark.parametrize("room", [ROOM, 190.0], ids=["dark room", "bright room"])
@pytest.mark.parametrize("look", [np.asarray, grey], ids=["colour", "grey"])
@pytest.mark.parametrize("light", [0.6, 0.85, 0.95, 1.0, 1.05, 1.15, 1.4])
def test_a_step_of_the_light_on_the_plate_alone_is_followed(light, look, room):
    image = look(picture(SPOTS, 7, light, room))
    now = learned(room, look).followed(image, region())
    assert worst(image, now) < 0.25
    true = learn_plate(look(picture([], 5, light, room))[None])
    here = np.s_[80:170, 130:280, 0]
    assert np.median(now.lab[here]) == pytest.approx(np.median(true.lab[here]), abs=2)


def test_light_that_falls_from_one_side_and_has_another_colour_is_followed():
    image = picture(SPOTS, 8, 0.9, tilt=0.2, tint=(0.85, 1.0, 1.1))
    assert worst(image, learned().followed(image, region())) < 0.25


def crowd():
    """Places of discs that cover 60 % of the plate."""
    return [(x, y) for x in np.arange(121, 295, 23.0) for y in np.arange(74, 185, 23.0)]


@pytest.mark.parametrize("ink", [(40, 45, 50), (130, 130, 130), (170, 170, 170)])
@pytest.mark.parametrize("light", [0.7, 1.0, 1.15])
def test_parts_that_cover_most_of_the_plate_are_not_taken_for_it(ink, light, monkeypatch):
    monkeypatch.setitem(globals(), "INK", [ink])
    image = picture(crowd(), 9, light, radius=10)
    found = learned().light_of(image, region())
    assert found.factor == pytest.approx(light, rel=0.04)
    assert np.mean(found.shown) < 0.6


def test_every_image_of_a_light_that_flickers_shows_all_parts():
    vision = Vision(None, region(), None, None, None, 0.01, background=learned())
    plate = BarePlate(True, vision.background)
    for number in range(6):
        image = picture(SPOTS, 20 + number, 1 + 0.1 * (-1) ** number)
        plate, vision, problem = know_plate(plate, vision, image)
        assert problem is None
        assert worst(image, vision.background) < 0.25


@pytest.mark.parametrize("look", [np.asarray, grey], ids=["colour", "grey"])
@pytest.mark.parametrize("softer_px", [1.0, 2.0, 3.0])
def test_parts_near_the_plates_edge_are_seen_out_of_focus(softer_px, look, monkeypatch):
    """The edge of the bare plate was sharper."""
    near = [*SPOTS[:3], (125.8, 140.3)]
    monkeypatch.setitem(globals(), "SPOTS", near)
    image = look(cv2.GaussianBlur(picture(near, 7), (0, 0), softer_px))
    vision = Vision(None, region(), None, None, None, 0.01, background=learned(look=look))
    _, vision, _ = know_plate(BarePlate(True, vision.background), vision, image)
    assert worst(image, vision.background) < 0.4


def test_a_displaced_plate_is_not_reported_as_out_of_focus():
    moved = np.roll(picture(SPOTS, 7), 5, axis=1)
    bare = learned()
    assert bare.softened(moved, region()) is bare
    assert bare.softened(picture(SPOTS, 8), region()) is bare


def test_an_image_without_light_is_refused_and_the_next_one_is_not():
    vision = Vision(None, region(), None, None, None, 0.01, background=learned())
    plate = BarePlate(True, vision.background)
    with pytest.raises(ImageError, match=r"light: 0 % of the plate .*20 to 500 %.*learn_plate"):
        know_plate(plate, vision, picture(SPOTS, 3, 0.03))
    _, vision, _ = know_plate(plate, vision, picture(SPOTS, 4))
    assert worst(picture(SPOTS, 4), vision.background) < 0.25
