"""Images against the projected truth."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateError, load_rig
from plate_core.rig import homography, project, to_home
from plate_sim import Camera, part_greys

RIG = load_rig()
SCALE = 993.0
"""Pixels per metre on the plate, near enough to size windows."""


def render(position, classes, noise=0.0, seed=0, **more):
    camera = Camera(RIG, noise)
    return camera.render(position, part_greys(classes), np.random.default_rng(seed), **more)


def darkness(image, empty, point, size=20):
    """Centroid (u, v) [px] and sum of the light that a part removes around a point [px]."""
    u0, v0 = np.round(point).astype(int)
    window = np.s_[v0 - size : v0 + size + 1, u0 - size : u0 + size + 1]
    weight = empty[window].astype(float) - image[window]
    v, u = np.mgrid[window]
    return np.array([np.sum(weight * u), np.sum(weight * v)]) / weight.sum(), weight.sum()


def test_centroids_are_where_the_parts_are():
    rng = np.random.default_rng(4)
    position = np.stack(
        [np.linspace(-0.25, 0.25, 12), np.tile([-0.1, 0.0, 0.1], 4)], axis=1
    ) + rng.uniform(-1e-3, 1e-3, (12, 2))
    image, empty = render(position, ["black", "grey"] * 6), render(np.zeros((0, 2)), [])
    for point in project(homography(RIG), position):
        centre, _ = darkness(image, empty, point)
        assert np.abs(centre - point).max() < 0.03


def test_rendered_areas_are_correct():
    empty = render(np.zeros((0, 2)), [])
    for shift in (0.0, 3e-4, 5e-4):
        position = np.array([[shift, shift / 2]])
        _, weight = darkness(
            render(position, ["black"]), empty, project(homography(RIG), position)[0]
        )
        assert weight / (220 - 40) == pytest.approx(np.pi * (0.008 * SCALE) ** 2, rel=0.02)


def test_parts_plate_and_background_have_their_grey_levels():
    position = np.array([[-0.05, 0.0], [0.05, 0.0]])
    image = render(position, ["black", "grey"])
    (u1, v1), (u2, v2) = np.round(project(homography(RIG), position)).astype(int)
    assert image[v1, u1] == pytest.approx(40, abs=1)
    assert image[v2, u2] == pytest.approx(130, abs=1)
    assert image[(v1 + v2) // 2, (u1 + u2) // 2] == pytest.approx(220, abs=1)
    assert image[5, 320] == pytest.approx(60 * 0.95, abs=1)
    assert image[0, 0] == pytest.approx(60 * 0.9, abs=1)


def test_noise_has_its_size_and_its_seed():
    position = np.array([[0.0, 0.0]])
    clean = render(position, ["black"]).astype(float)
    noisy = render(position, ["black"], noise=2.0, seed=1)
    assert np.std(noisy - clean) == pytest.approx(2.0, abs=0.05)
    assert np.mean(noisy - clean) == pytest.approx(0.0, abs=0.02)
    assert np.array_equal(noisy, render(position, ["black"], noise=2.0, seed=1))
    assert not np.array_equal(noisy, render(position, ["black"], noise=2.0, seed=2))


def test_moving_parts_are_blurred_along_their_way():
    position, velocity = np.array([[0.0, 0.0]]), np.array([[4.0, 0.0]])
    still, moving = (render(position, ["black"], velocity=v) for v in (None, velocity))
    empty = render(np.zeros((0, 2)), [])
    middle = position + velocity * RIG.camera.exposure_s / 2
    point = project(homography(RIG), middle)[0]
    centre, weight = darkness(moving, empty, point)
    assert np.abs(centre - point).max() < 0.03
    assert weight == pytest.approx(darkness(still, empty, point)[1], rel=0.01)
    row = round(point[1])
    soft_still, soft_moving = (
        np.count_nonzero((image[row] > 65) & (image[row] < 200)) for image in (still, moving)
    )
    assert soft_moving >= soft_still + 4  # edges as wide as the way, 4 px


def test_the_plate_is_drawn_where_it_is():
    pose = np.array([0.008, -0.005, 0.01])
    image = render(np.zeros((0, 2)), [], pose=pose).astype(float)
    corners = to_home(pose, RIG.plate.corners)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inward = -(a + b) / np.linalg.norm(a + b) * 0.003
        for point, light in (((a + b) / 2 + inward, 220), ((a + b) / 2 - inward, 60)):
            u, v = np.round(project(homography(RIG), point[None])[0]).astype(int)
            assert image[v, u] == pytest.approx(light, rel=0.1)


def test_parts_at_the_images_border_are_cut_off():
    camera = replace(RIG.camera, corners_px=((-22, 388), (618, 391), (613, 93), (-27, 90)))
    image = Camera(replace(RIG, camera=camera), 0.0).render(
        np.array([[-0.28, 0.0], [-0.5, 0.0]]), part_greys(["black"] * 2), np.random.default_rng(0)
    )
    assert image.shape == (480, 640)
    assert image.min() < 50


def test_unknown_classes_are_refused():
    with pytest.raises(PlateError, match="part class is 'pink', allowed: black, grey"):
        part_greys(["black", "pink"])
