"""Parts with height, cast shadows, gloss, focus and sizes, against OpenCV's projection in space."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from dark_parts import BLACK, PLATE, centroid, covered, ring

import plate_sim.camera.camera as camera_module
from plate_core import PlateCycle, PlateError, load_rig
from plate_core.rig import Lens, PartType, project
from plate_core.tasks import load_scenario
from plate_sim import Camera, Disturbances, Simulation
from plate_sim.camera import Lighting

TURN, PLACE = np.array([2.95, 0.08, 0.03]), np.array([0.004, -0.003, 0.66])
"""Of plate_home in the camera's frame: rotation vector [rad], translation [m]; tilted."""

LENSES = [
    Lens((620.0, 625.0), (316.0, 243.0), (-0.3, 0.09, 1e-3, -1e-3, 0.0)),
    Lens((620.0, 620.0), (319.5, 239.5)),
]
HEIGHT = 0.02
PLACES = np.array([[-0.24, -0.1], [0.01, -0.02], [0.2, 0.07], [-0.13, 0.08], [0.22, -0.1]])
CORNERS = 0.02 * np.array([[0.0, 0], [1, 0], [1, 0.4], [0.4, 0.4], [0.4, 1], [0, 1]]) - 0.006
BRACKET = PartType("bracket", outline=tuple(map(tuple, CORNERS.tolist())))
HOLE = 0.006 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
WASHER = PartType("washer", radius_m=0.012, holes=(tuple(map(tuple, HOLE.tolist())),), symmetry=4)
FINE = 8
"""Sub-pixels along a pixel's side in the masks that are compared with."""

WINDOW = 96
"""Pixels along the side of such a mask: it holds one part."""

INVISIBLE = Lighting(side_shade=PLATE / BLACK)
"""Side faces as bright as the plate."""

ONE_SHADE = Lighting(side_shade=1.0)


def in_space(lens, points, height):
    """Images (n, 2) [px] of points of the plate's plane, raised."""
    there = np.column_stack([points, np.full(len(points), height)])
    return cv2.projectPoints(there, TURN, PLACE, lens.matrix, np.array(lens.distortion))[0][:, 0]


def rig_with(lens):
    rig = load_rig()
    corners = tuple(map(tuple, in_space(lens, rig.plate.corners, 0).tolist()))
    return replace(rig, camera=replace(rig.camera, lens=lens, corners_px=corners))


def shoot(camera, position, **more):
    grey = np.full(len(position), BLACK)
    return camera.render(position, grey, np.random.default_rng(0), **more).astype(float)


def seen(camera, points):
    """Images (n, 2) [px] of points of the plate, without a lens that bends."""
    return project(camera._to_image, np.array(points))


def dense(corners, each=12):
    """Points along a polygon's sides, which a lens bends."""
    side = np.linspace(0, 1, each, endpoint=False)[:, None]
    return (corners[:, None] + side * (np.roll(corners, -1, axis=0) - corners)[:, None]).reshape(
        -1, 2
    )


def mask_of(polygon, corner):
    """Which sub-pixels of the window at a pixel a polygon (n, 2) [px] covers, all of it inside."""
    assert np.all((polygon > corner) & (polygon < corner + WINDOW - 1))
    mask = np.zeros((WINDOW * FINE, WINDOW * FINE), np.uint8)
    cv2.fillPoly(mask, [np.round((polygon - corner + 0.5) * FINE - 0.5).astype(np.int32)], 1)
    return mask.astype(bool)


def moments_of(mask, corner):
    """Centre (2,) [px] and area [px2] of the mask of a window, which is larger by 1 to 2 %: it has
    the sub-pixels on the edge."""
    v, u = np.nonzero(mask)
    middle = np.array([u.mean() + 0.5, v.mean() + 0.5]) / FINE - 0.5
    return corner + middle, len(u) / FINE**2


@pytest.mark.parametrize("lens", LENSES)
def test_top_faces_are_where_opencv_projects_them(lens):
    rig = rig_with(lens)
    camera, high = Camera(rig, 0.0), np.full(len(PLACES), HEIGHT)
    image = shoot(camera, PLACES, height=high, lighting=INVISIBLE)
    for position in PLACES:
        expected, area = centroid(in_space(lens, position + ring(0.008), HEIGHT))
        centre, weight = covered(camera, image, expected)
        assert np.hypot(*(centre - expected)) < 0.02
        assert weight == pytest.approx(area, rel=0.01)
        # By far not where a flat part would be, in all but the middle.
        flat = in_space(lens, position[None], 0)[0]
        assert np.hypot(*(flat - expected)) > (2 if np.hypot(*position) > 0.1 else 0.2)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("kind", [None, BRACKET, WASHER], ids=["disc", "bracket", "washer"])
def test_silhouettes_are_the_union_of_all_sections(lens, kind):
    """A hundred sections of each part, projected one by one; holes where none is in the way."""
    rig = rig_with(lens)
    camera, high = Camera(rig, 0.0), np.full(len(PLACES), HEIGHT)
    angle = np.linspace(0.3, 5, len(PLACES))
    more = {} if kind is None else {"types": [kind] * len(PLACES), "angle": angle}
    image = shoot(camera, PLACES, height=high, lighting=ONE_SHADE, **more)
    for position, turn in zip(PLACES, angle, strict=True):
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        solid = ring(0.008) if kind is None else kind.polygon
        holes = [] if kind is None else [dense(np.array(hole)) for hole in kind.holes]
        union, through = False, True
        corner = np.round(in_space(lens, position[None], 0)[0]) - WINDOW // 2
        for level in np.linspace(0, HEIGHT, 60):
            union = union | mask_of(
                in_space(lens, position + dense(solid) @ rotation, level), corner
            )
            for hole in holes:
                through = through & mask_of(
                    in_space(lens, position + hole @ rotation, level), corner
                )
        expected, area = moments_of(union & ~through if holes else union, corner)
        centre, weight = covered(camera, image, expected)
        assert np.hypot(*(centre - expected)) < 0.1
        assert weight == pytest.approx(area, rel=0.03)


def test_side_faces_have_another_shade():
    camera = Camera(rig_with(LENSES[1]), 0.0)
    position = PLACES[:1]
    both, top, silhouette = (
        shoot(camera, position, height=np.array([HEIGHT]), lighting=light)
        for light in (Lighting(side_shade=0.5), INVISIBLE, ONE_SHADE)
    )
    side = (silhouette / camera._light < BLACK + 1) & (top / camera._light > PLATE - 1)
    assert np.count_nonzero(side) > 20
    assert np.allclose(both[side] / camera._light[side], 0.5 * BLACK, atol=1)
    whole = top / camera._light < BLACK + 1
    assert np.count_nonzero(whole) > 100
    assert np.array_equal(both[whole], top[whole])


def test_a_part_hides_those_behind_it():
    """The nearer one to the point below the camera leans over the other one's foot."""
    rig = rig_with(LENSES[1])
    camera, position = Camera(rig, 0.0), np.array([[0.20, 0.0], [0.217, 0.0]])
    high = np.full(2, HEIGHT)
    for order in ([0, 1], [1, 0]):
        grey = np.array([BLACK, 130.0])[order]
        image = camera.render(
            position[order], grey, np.random.default_rng(0), height=high, lighting=ONE_SHADE
        )
        u, v = np.round(in_space(LENSES[1], position[:1] + [0.0075, 0], HEIGHT)[0]).astype(int)
        assert image[v, u] < 60


@pytest.mark.parametrize("length", [0.005, 0.015])
def test_shadows_are_as_long_and_as_dark_as_set(length):
    """Along the light from the part's middle: dark from the rim on, light again after the length,
    half of it there."""
    rig = load_rig()
    camera, position = Camera(rig, 0.0), np.array([[0.05, 0.02]])
    light = Lighting(shadows=0.6, shadow_m=length, shadow_deg=30.0, penumbra_m=0.004)
    image, bare = shoot(camera, position, lighting=light), shoot(camera, position[:0])
    way = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    along = np.arange(0, 0.03, 1e-4)
    u, v = seen(camera, position + along[:, None] * way).T.astype(np.float32)
    part = cv2.remap(image / bare, u, v, cv2.INTER_LINEAR).ravel()
    beyond = along > 0.0095
    assert np.allclose(part[beyond & (along < 0.008 + length - 0.0025)], 0.4, atol=0.02)
    assert np.allclose(part[along > 0.008 + length + 0.0035], 1.0, atol=0.01)
    half = along[np.flatnonzero(part < 0.7)[-1]]
    assert half == pytest.approx(0.008 + length, abs=5e-4)
    u, v = seen(camera, position - 0.011 * way).T.astype(np.float32)
    assert cv2.remap(image / bare, u, v, cv2.INTER_LINEAR).item() == pytest.approx(1.0, abs=0.01)


def test_gloss_is_a_bright_disc_towards_the_lamp():
    camera, position = Camera(load_rig(), 0.0), np.array([[0.05, 0.02]])
    image = shoot(camera, position, lighting=Lighting(gloss=0.3, shadow_deg=90.0))
    dull = shoot(camera, position)
    weight = (image - dull) / camera._light / (255 - BLACK)
    scale = np.linalg.norm(np.diff(seen(camera, [[0, 0], [1e-2, 0]]), axis=0))
    assert weight.sum() == pytest.approx(np.pi * (0.3 * 0.8 * scale) ** 2, rel=0.03)
    v = np.arange(480)[:, None]
    middle = seen(camera, position)[0]
    assert np.sum(weight * v) / weight.sum() > middle[1] + 1  # -y is down in the image
    assert image.max() > dull.max()


def test_defocus_is_a_gaussian_of_the_sharp_image():
    rig = load_rig()
    sharp, soft = (shoot(Camera(rig, 0.0, defocus_px=sigma), PLACES) for sigma in (0.0, 1.7))
    blurred = cv2.GaussianBlur(sharp, (0, 0), 1.7, borderType=cv2.BORDER_REFLECT)
    assert np.abs(blurred - soft).max() < 1.5
    assert np.abs(sharp - soft).max() > 30


def test_sizes_scale_outlines_and_marks():
    rig = load_rig()
    camera, angle = Camera(rig, 0.0), np.zeros(len(PLACES))
    size = np.linspace(0.7, 1.3, len(PLACES))
    image = shoot(camera, PLACES, size=size, types=[BRACKET] * len(PLACES), angle=angle)
    for position, factor in zip(PLACES, size, strict=True):
        larger = replace(BRACKET, outline=tuple(map(tuple, (factor * CORNERS).tolist())))
        alone = shoot(camera, position[None], types=[larger], angle=angle[:1])
        u, v = np.round(seen(camera, position)[0]).astype(int)
        window = np.s_[v - 30 : v + 31, u - 30 : u + 31]
        assert np.abs(image[window] - alone[window]).max() <= 1


def test_effects_that_are_off_are_not_computed(monkeypatch):
    """No outline is computed, nothing is blurred or scaled, and the camera's position is not
    computed."""

    def never(*_):
        raise AssertionError

    for name in ("sweep_outlines", "scale_outlines", "camera_position"):
        monkeypatch.setattr(camera_module, name, never)
    monkeypatch.setattr("scipy.ndimage.gaussian_filter", never)
    rig = replace(load_rig(), camera=replace(load_rig().camera, lens=None))
    shoot(Camera(rig), PLACES, lighting=Disturbances().lighting(3.0))


def test_height_needs_the_cameras_place():
    rig = replace(load_rig(), camera=replace(load_rig().camera, lens=None))
    with pytest.raises(PlateError, match=r"height is \[0\.01, .* allowed: 0"):
        shoot(Camera(rig), PLACES, height=np.full(len(PLACES), 0.01))
    flat = shoot(Camera(rig), PLACES, height=np.zeros(len(PLACES)))
    np.testing.assert_array_equal(flat, shoot(Camera(rig), PLACES))
    with pytest.raises(PlateError, match=r"part_height_m is 0\.01, allowed: 0, "):
        Simulation(rig, load_scenario("sort_4"), 1, Disturbances(part_height_m=0.01))
    simulation = Simulation(rig, load_scenario("sort_4"), 1)
    with pytest.raises(PlateError, match=r"part_height_m is 0\.01, allowed"):
        simulation.change(Disturbances(part_height_m=0.01), 2.0, 1.0)
    known = replace(rig, camera=replace(rig.camera, height_m=0.9))
    Simulation(known, load_scenario("sort_4"), 1, Disturbances(part_height_m=0.01)).capture()
    with pytest.raises(PlateError, match=r"height: .* m, allowed: 0 to less than 0\.9"):
        shoot(Camera(known), PLACES, height=np.full(len(PLACES), 0.9))


def levels(simulation, cycles=12):
    """Mean grey of the images' middle rows at the starts of cycles of 0.1 s, over the first's."""
    means = []
    for _ in range(cycles):
        means.append(simulation.capture().mean())
        simulation.run(PlateCycle.rest(0.1))
    return np.array(means) / means[0]


def test_light_steps_and_flickers_in_time():
    scenario = load_scenario("sort_4")
    step = Simulation(
        load_rig(), scenario, 1, Disturbances(light_step=-0.2, light_step_s=0.45), noise=0.0
    )
    expected = np.where(np.arange(12) * 0.1 >= 0.45, 0.8, 1.0)
    assert np.allclose(levels(step), expected, atol=0.005)
    world = Disturbances(flicker=0.06, flicker_hz=2.5)  # each fourth image alike
    flicker = levels(Simulation(load_rig(), scenario, 1, world, noise=0.0))
    assert np.allclose(
        flicker, 1 + 0.06 * np.sin(2 * np.pi * 2.5 * 0.1 * np.arange(12)), atol=0.005
    )


def test_heights_and_sizes_of_a_run():
    """Of the rig file, unless set; sizes by seed and name, whatever else there is."""
    rig, scenario = load_rig(), load_scenario("sort_4")
    flat, reported = (
        Simulation(replace(rig, parts=replace(rig.parts, height_m=height)), scenario, 3, noise=0.0)
        for height in (0.0, 0.02)
    )
    kept = Simulation(rig, scenario, 3, Disturbances(part_height_m=0.02), noise=0.0)
    assert np.array_equal(reported.capture(), kept.capture())
    assert np.abs(reported.capture().astype(float) - flat.capture()).max() > 50
    spread = Disturbances(size_spread=0.3)
    one, two = (Simulation(rig, scenario, seed, spread, noise=0.0) for seed in (3, 4))
    assert np.all(np.abs(one._view._size - 1) <= 0.3)
    assert np.ptp(one._view._size) > 0.05
    assert not np.array_equal(one._view._size, two._view._size)
    before = dict(zip(one.state.ids, one._view._size, strict=True))
    one.remove(one.state.ids[0])
    assert all(
        before[name] == size for name, size in zip(one.state.ids, one._view._size, strict=True)
    )


def test_a_change_draws_the_plate_again():
    simulation = Simulation(load_rig(), load_scenario("sort_4"), 3, noise=0.0)
    before = simulation.capture().astype(float)
    simulation.change(Disturbances(plate_grey=70.0, black_grey=200.0, grey_grey=180.0), 0.0, 1.0)
    after = simulation.capture().astype(float)
    assert np.median(before[100:380, 50:600]) > 190
    assert np.median(after[100:380, 50:600]) < 75
    assert after.max() > 180
    simulation.change(Disturbances(), 0.0, 1.0)
    assert np.array_equal(simulation.capture(), before)
