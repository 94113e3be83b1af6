"""Parts with a height, seen by a camera that is near: positions are those on the plate."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plate_core.rig import PartType
from plate_vision.camera import calibrate_by_matrix
from plate_vision.recognition import find_types
from plate_vision.shapes import learn_plate, make_catalogue
from plate_vision.shapes.heights import footprint
from plate_vision.shapes.outlines import make_outline

SIZE = (480, 360)
FOCAL_PX, PLACE = 430.0, np.array([0.0, 0.0, 0.43])
"""A camera that looks straight down from 0.43 m: 1 px/mm on the plate."""

FINE = 5
PLATE, TOP, SIDE = 215, (50, 45, 40), (25, 22, 20)
"""Grey level; blue, green, red."""


def about_its_centre(corners):
    outline = make_outline([np.array(corners, float)])
    return tuple(map(tuple, np.array(corners) - outline.centre))


TYPES = {
    "square": PartType(
        "square", ((-8e-3, -8e-3), (8e-3, -8e-3), (8e-3, 8e-3), (-8e-3, 8e-3)), symmetry=4
    ),
    "bracket": PartType(
        "bracket",
        about_its_centre(
            [(0, 0), (22e-3, 0), (22e-3, 8e-3), (8e-3, 8e-3), (8e-3, 22e-3), (0, 22e-3)]
        ),
    ),
    "coin": PartType("coin", radius_m=9e-3, symmetry=0),
    "washer": PartType(
        "washer",
        radius_m=12e-3,
        holes=(tuple((5e-3 * np.cos(t), 5e-3 * np.sin(t)) for t in np.arange(16) * np.pi / 8),),
        symmetry=0,
    ),
    "ring": PartType(
        "ring",
        radius_m=10e-3,
        holes=(tuple((5e-3 * np.cos(t), 5e-3 * np.sin(t)) for t in np.arange(16) * np.pi / 8),),
        symmetry=0,
    ),
}  # fmt: skip

POSES = [
    ("square", -0.13, 0.09, 0.3), ("bracket", 0.12, 0.09, 2.0), ("coin", 0.14, -0.08, 0.0),
    ("washer", -0.12, -0.09, 0.0), ("bracket", -0.03, -0.1, -1.0), ("square", 0.02, 0.01, 0.7),
]  # fmt: skip


def seen(point, height):
    """Where points (n, 2) at a height are seen [px]."""
    scaled = FOCAL_PX * (point - PLACE[:2]) / (PLACE[2] - height)
    return scaled * (1, -1) + (np.array(SIZE) - 1) / 2


GREYS = (140, 140, 140), (98, 98, 98)
"""Of a top and side faces as light as a shadow: no darker than half of the plate."""


def picture(height, seed=0, poses=POSES, colours=(TOP, SIDE)):
    """Prisms, drawn as stacks of their outlines from the plate up to the top, which has the first
    colour."""
    top, side = colours
    fine = np.full((FINE * SIZE[1], FINE * SIZE[0], 3), PLATE, np.uint8)
    for name, x, y, angle in poses:
        c, s = np.cos(angle), np.sin(angle)
        rings = [TYPES[name].polygon, *map(np.array, TYPES[name].holes)]
        rings = [ring @ np.array([[c, s], [-s, c]]) + (x, y) for ring in rings]
        low = np.floor(np.min([seen(rings[0], z).min(axis=0) for z in (0, height)], axis=0))
        x0, y0 = (low - 2).astype(int)
        here = fine[FINE * y0 : FINE * (y0 + 60), FINE * x0 : FINE * (x0 + 60)]
        for z in np.linspace(0, height, 16 if height else 1):
            layer = np.zeros(here.shape[:2], np.uint8)
            for number, ring in enumerate(rings):
                point = 16 * (FINE * (seen(ring, z) - (x0, y0) + 0.5) - 0.5)
                cv2.fillPoly(layer, [np.rint(point).astype(np.int32)], not number, shift=4)
            here[layer > 0] = side
        here[layer > 0] = top
    image = cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.7).astype(float)
    image += 2 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def sightings(drawn, known, place=PLACE, poses=POSES, colours=(TOP, SIDE)):
    """Detections of parts of one height in a picture for another height."""
    scale = FOCAL_PX / PLACE[2]
    middle = (np.array(SIZE) - 1) / 2
    view = np.array([[scale, 0, middle[0]], [0, -scale, middle[1]], [0, 0, 1]])
    calibration = replace(calibrate_by_matrix(view), camera_position=place)
    types = {name: replace(one, height_m=known) for name, one in TYPES.items()}
    bare = learn_plate(np.stack([picture(0, seed, []) for seed in (1, 2, 3)]))
    return find_types(picture(drawn, 7, poses, colours), make_catalogue(types), bare, calibration)


def errors(drawn, known, place=PLACE, poses=POSES, colours=(TOP, SIDE)):
    """Distances [m] of parts from where they touch the plate, once all have their own name."""
    found = sightings(drawn, known, place, poses, colours)
    assert len(found) == len(poses)
    gaps = []
    for name, x, y, _ in poses:
        gap = np.hypot(found["x"] - x, found["y"] - y)
        assert found["label"][np.argmin(gap)] == name
        gaps.append(gap.min())
    return np.array(gaps)


@pytest.mark.parametrize("height", [0.0, 0.003, 0.006, 0.010])
def test_parts_are_where_they_touch_the_plate(height):
    off = errors(height, height)
    assert np.sqrt(np.mean(off**2)) < 0.25e-3
    assert off.max() < 0.4e-3


RIGHT = [
    ("ring", 0.11, 0.10, 0.0), ("ring", 0.14, 0.0, 0.0), ("ring", 0.17, -0.08, 0.0),
    ("ring", 0.19, 0.05, 0.0),
]  # fmt: skip


def test_tops_that_are_lighter_than_their_side_faces_are_no_shadows():
    """Where all parts are on one side of the camera, their dark sides point the same way."""
    assert errors(0.010, 0.010, poses=RIGHT, colours=GREYS).max() < 0.6e-3


def test_without_their_height_none_of_them_vanishes():
    """Their tops are taken for shadows of their side faces, which are no parts: then all that is
    seen is an unknown thing."""
    found = sightings(0.010, 0.0, poses=RIGHT, colours=GREYS)
    for _, x, y, _ in RIGHT:
        assert np.hypot(found["x"] - x, found["y"] - y).min() < 5e-3


def test_without_its_height_a_part_is_seen_where_its_top_and_sides_are():
    off = errors(0.003, 0.0)
    expected = 0.5 * 0.003 / 0.427 * np.array([np.hypot(x, y) for _, x, y, _ in POSES])
    assert off == pytest.approx(expected, abs=0.35e-3)


def test_reported_scatter_has_what_an_unknown_height_costs():
    off = errors(0.005, 0.0)
    sd = np.hypot(sightings(0.005, 0.0)["place_sd"], 0.04e-3)
    assert np.sqrt(np.mean(off**2)) < 3.5 * np.sqrt(2) * np.median(sd)
    flat = sightings(0.0, 0.0)
    assert np.median(flat["place_sd"]) < 0.05e-3


def test_heights_are_ignored_if_the_cameras_place_is_unknown():
    assert errors(0.003, 0.003, place=None) == pytest.approx(errors(0.003, 0.0), abs=1e-6)


@pytest.mark.parametrize("at", [(0.1, 0.0), (-0.08, 0.06), (0.0, 0.0)])
@pytest.mark.parametrize("name", TYPES)
def test_footprint_of_what_is_seen_is_the_parts_own(name, at):
    """The outline of a convex part and the centre of any: holes lose slivers."""
    factor = PLACE[2] / (PLACE[2] - 0.008)
    steps = np.linspace(1, factor, 30)
    rings = [TYPES[name].polygon + at, *(np.array(hole) + at for hole in TYPES[name].holes)]
    fine = np.zeros((600, 600), np.uint8)
    origin, scale = np.array(at) - 0.03, 10_000.0
    for t in steps:
        layer = np.zeros_like(fine)
        for number, ring in enumerate(rings):
            point = np.rint(16 * ((t * ring - origin) * scale - 0.5)).astype(np.int32)
            cv2.fillPoly(layer, [point], not number, shift=4)
        fine |= layer
    contours, tree = cv2.findContours(fine, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer = max(range(len(contours)), key=lambda k: cv2.contourArea(contours[k]))
    order = [outer, *(k for k in range(len(contours)) if tree[0, k, 3] == outer)]
    swept = make_outline([(contours[k][:, 0] + 0.5) / scale + origin for k in order])
    found = footprint(swept, PLACE, 0.008, 1000.0)
    assert found.centre == pytest.approx(at, abs=0.25e-3 if name == "bracket" else 0.1e-3)
    assert len(found.ends) == len(rings)
    if not TYPES[name].holes and name != "bracket":
        assert found.area == pytest.approx(TYPES[name].area_m2, rel=0.03)
