"""Frames: there and back, velocities by differences, the camera's corners."""

from dataclasses import replace

import numpy as np

from plate_core import load_rig
from plate_core.rig import homography, project, row_delay, surface_velocity, to_home, to_plate

RIG = load_rig()
POSE = np.array([0.004, -0.003, 0.05])
POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2))


def test_to_plate_inverts_to_home():
    np.testing.assert_allclose(to_plate(POSE, to_home(POSE, POINTS)), POINTS, atol=1e-15)


def test_quarter_turn_is_counter_clockwise():
    pose = np.array([1, 2, np.pi / 2])
    np.testing.assert_allclose(to_home(pose, [[1, 0]]), [[1, 3]], atol=1e-15)


def test_surface_velocity_is_that_of_the_plate_point_there():
    twist, step = np.array([0.3, -0.2, 1.5]), 1e-6
    on_plate = to_plate(POSE, POINTS)
    moved = to_home(POSE + step * twist, on_plate) - to_home(POSE - step * twist, on_plate)
    np.testing.assert_allclose(surface_velocity(POSE, twist, POINTS), moved / (2 * step), atol=1e-9)


def test_surface_velocity_of_many_instants():
    poses = np.stack([POSE, 2 * POSE])
    twists = np.array([[0.1, 0.2, 0.3], [-0.3, 0.2, 0.1]])
    both = surface_velocity(poses[:, None], twists[:, None], POINTS[None])
    for i in range(2):
        np.testing.assert_allclose(both[i], surface_velocity(poses[i], twists[i], POINTS))


def test_homography_maps_the_corners():
    matrix = homography(RIG)
    np.testing.assert_allclose(project(matrix, RIG.plate.corners), RIG.camera.corners_px, atol=1e-9)


def test_homography_keeps_lines_straight():
    matrix = homography(RIG)
    line = np.column_stack([np.linspace(-0.3, 0.3, 7), np.linspace(-0.1, 0.12, 7)])
    u, v = project(matrix, line).T
    np.testing.assert_allclose(np.polyval(np.polyfit(u, v, 1), u), v, atol=1e-9)


def test_homography_and_its_inverse():
    matrix = homography(RIG)
    back = project(np.linalg.inv(matrix), project(matrix, POINTS))
    np.testing.assert_allclose(back, POINTS, atol=1e-12)


def test_the_rows_of_an_image_are_exposed_one_after_the_other():
    rig = replace(RIG, camera=replace(RIG.camera, readout_s=0.02))
    pixels = np.column_stack([[30, 600, 200, 320], np.array([0.0, 0.25, 0.5, 1]) * 480])
    points = project(np.linalg.inv(homography(rig)), pixels)
    np.testing.assert_allclose(row_delay(rig, points), [-0.01, -0.005, 0, 0.01], atol=1e-12)
