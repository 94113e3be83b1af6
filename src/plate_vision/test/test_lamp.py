"""Shadows of one lamp, and holes in which light falls short: parts of types, drawn apart."""

import cv2
import numpy as np
import pytest

from plate_core import config_path
from plate_core.rig import load_part_types
from plate_vision.overlooked import unnamed_objects
from plate_vision.recognition import calibrate_by_scale, find_types, find_types_and_lamp
from plate_vision.shapes import learn_plate, make_catalogue
from plate_vision.shapes.classes import is_named
from plate_vision.shapes.segmentation import segment

TYPES = load_part_types(config_path("parts.yaml"))
SIZE, SCALE, FINE = (480, 360), 1000.0, 5
PLATE_LAB = (88.0, 0.0, 2.0)
NAMES = ["nut", "washer", "square", "bar", "bracket", "coin_small", "coin_large", "screw"]


def bgr(lab):
    return 255 * cv2.cvtColor(np.float32([[lab]]), cv2.COLOR_Lab2BGR)[0, 0]


def cover(shapes):
    """How much of each pixel lies in the first rings of shapes [px], less their other ones."""
    fine = np.zeros((FINE * SIZE[1], FINE * SIZE[0]), np.uint8)
    for rings in shapes:
        for number, ring in enumerate(rings):
            point = np.rint(16 * (FINE * (ring + 0.5) - 0.5)).astype(np.int32)
            cv2.fillPoly(fine, [point], 0 if number else 255, shift=4)
    return cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA)[:, :, None] / 255


def poses(seed=3):
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(0.055 + 0.09 * np.arange(5), -0.055 - 0.08 * np.arange(4))
    return [
        (NAMES[k % len(NAMES)], *place, rng.uniform(-np.pi, np.pi))
        for k, place in enumerate(zip(x.ravel(), y.ravel(), strict=True))
    ]


def outlines_px(name, x, y, angle):
    c, s = np.cos(angle), np.sin(angle)
    rings = [TYPES[name].polygon, *map(np.array, TYPES[name].holes)]
    turn = np.array([[c, s], [-s, c]])
    return [(ring @ turn + (x, y)) * (SCALE, -SCALE) for ring in rings]


def picture(parts, depth=0.0, shift_px=(0.0, 0.0), soft=0.0, hole=0.0, seed=0):
    """Parts on a plate that is darker by `depth` where they keep the lamp's light from it, and by
    `hole` in their holes."""
    shapes = [outlines_px(*part) for part in parts]
    light = np.ones((*SIZE[::-1], 1))
    if depth:
        along = np.linspace(0, 1, 2 * int(np.hypot(*shift_px)) + 2)
        cast = [[rings[0] + t * np.array(shift_px)] for rings in shapes for t in along]
        shaded = cover(cast)
        light -= depth * (cv2.GaussianBlur(shaded, (0, 0), soft)[:, :, None] if soft else shaded)
    if hole:
        light -= hole * cover([[inner] for rings in shapes for inner in rings[1:]])
    image = bgr(PLATE_LAB) * light
    for name in {part[0] for part in parts}:
        own = cover([rings for part, rings in zip(parts, shapes, strict=True) if part[0] == name])
        image += own * (bgr(TYPES[name].colour_lab) - image)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    image += 2 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def bare():
    return learn_plate(np.stack([picture([], seed=seed) for seed in (1, 2, 3)]))


@pytest.fixture(scope="module")
def catalogue():
    return make_catalogue(TYPES)


def offsets(image, parts, bare, catalogue):
    """Distances of parts from their places [m], once all have their names, and the sightings."""
    found = find_types(image, catalogue, bare, calibrate_by_scale(SCALE))
    gaps = []
    for name, x, y, _ in parts:
        gap = np.hypot(found["x"] - x, found["y"] - y)
        assert found["label"][np.argmin(gap)] == name
        gaps.append(gap.min())
    assert len(found) == len(parts)
    return np.array(gaps), found


@pytest.mark.parametrize("soft", [0.0, 1.0])
@pytest.mark.parametrize("shift_px", [(2.4, 1.8), (-4.0, 3.0), (0.0, 9.0)])
@pytest.mark.parametrize("depth", [0.3, 0.5])
def test_shadows_of_one_lamp_are_taken_off(depth, shift_px, soft, bare, catalogue):
    parts = poses()
    image = picture(parts, depth, shift_px, soft, seed=7)
    gaps, found = offsets(image, parts, bare, catalogue)
    rms = np.sqrt(np.mean(gaps**2))
    assert rms < (0.5e-3 if soft else 0.3e-3)
    assert rms < 2.5 * np.median(found["place_sd"])
    lamp = segment(image, bare)[1]
    assert np.hypot(*(lamp.shift_px - shift_px)) < 1.5


def test_parts_without_shadows_have_no_lamp(bare, catalogue):
    image = picture(poses(), seed=7)
    assert segment(image, bare)[1] is None
    gaps, found = offsets(image, poses(), bare, catalogue)
    assert gaps.max() < 0.15e-3
    assert found["place_sd"].max() < 0.03e-3


def test_one_part_with_a_shadow_does_not_make_a_lamp(bare):
    image = picture(poses(), seed=7)
    one = picture(poses()[:1], 0.5, (6, 4), seed=7)
    image[:100, :100] = one[:100, :100]
    assert segment(image, bare)[1] is None


HALF_LIGHT = {"depth": 0.5, "shift_px": (4.0, 3.0)}


def touching():
    """Parts none of which shows alone where its shadow is: all are as grey as the shadow, or touch
    a part of another colour."""
    parts = [("washer", *pose[1:]) for pose in poses()[:8]]
    # A washer beside each square.
    return parts + [
        (name, 0.055 + 0.1 * k + dx, -0.27, 0.0)
        for k in range(3)
        for name, dx in (("square", 0.0), ("washer", 0.0205))
    ]


def test_the_last_lamp_is_used_if_an_image_shows_no_shadows(bare, catalogue):
    view = calibrate_by_scale(SCALE)
    _, lamp = find_types_and_lamp(picture(poses(), seed=7, **HALF_LIGHT), catalogue, bare, view)
    assert lamp is not None
    image = picture(touching(), seed=8, **HALF_LIGHT)
    _, none = find_types_and_lamp(image, catalogue, bare, view)
    assert none is None
    seen, still = find_types_and_lamp(image, catalogue, bare, view, None, lamp)
    assert still is lamp
    assert len(seen) == len(touching())
    # Without it, once it is switched off.
    dark, gone = find_types_and_lamp(picture(poses(), seed=9), catalogue, bare, view, None, lamp)
    assert gone is None
    assert len(dark) == len(poses())


@pytest.mark.parametrize("hole", [0.2, 0.3, 0.4])
def test_dark_holes_of_nuts_and_washers_are_holes(hole, bare, catalogue):
    parts = [(("nut", "washer", "coin_large")[k % 3], *pose[1:]) for k, pose in enumerate(poses())]
    gaps, _ = offsets(picture(parts, hole=hole, seed=8), parts, bare, catalogue)
    assert gaps.max() < 0.3e-3


def test_a_disc_of_a_washers_colour_is_no_sure_washer(bare, catalogue):
    """It has no hole that looks like the plate."""
    parts = [("washer", *pose[1:]) for pose in poses()]
    whole = picture(parts, hole=0.1, seed=8)
    for part in parts:
        ring = outlines_px(*part)[0]
        cv2.fillPoly(whole, [np.rint(ring).astype(np.int32)], bgr((45.0, 0.0, 0.0)).tolist())
    found = find_types(whole, catalogue, bare, calibrate_by_scale(SCALE))
    real = find_types(picture(parts, seed=8), catalogue, bare, calibrate_by_scale(SCALE))
    assert np.all(real["label"] == "washer")
    sure = found["confidence"][found["label"] == "washer"]
    assert np.all(sure < 0.7 * real["confidence"].min())


def test_types_are_not_named_in_a_blurred_image(bare, catalogue):
    sharp = picture(poses(), seed=7)
    for blur_px, blurred in ((1.8, False), (3.0, True), (4.0, True)):
        image = cv2.GaussianBlur(sharp, (0, 0), blur_px)
        found = find_types(image, catalogue, bare, calibrate_by_scale(SCALE))
        named = found[is_named(found)]
        assert np.any(found["blurred"]) == blurred
        assert len(named) == (0 if blurred else len(poses()))
        for name, x, y, _ in poses():
            near = np.hypot(named["x"] - x, named["y"] - y) < 3e-3
            assert set(named["label"][near].tolist()) <= {name}
    again = picture([("coin_large", 0.2, -0.15, 0.0)], seed=8)
    (one,) = find_types(
        cv2.GaussianBlur(again, (0, 0), 3), catalogue, bare, calibrate_by_scale(SCALE)
    )
    assert one["blurred"]
    things = unnamed_objects(np.array([one]), np.ones(1, bool), np.array([9e-3]), 4e-3, 14e-3)
    assert things["reason"].tolist() == ["blurred"]
