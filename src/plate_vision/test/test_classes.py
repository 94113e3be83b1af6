"""Which type a part is and how it is turned, against the truth of drawn pictures."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from plate_core import config_path
from plate_core.rig import load_part_types, to_home, to_plate
from plate_vision import calibrate_by_scale
from plate_vision.recognition import camera_limits, find_parts, find_types
from plate_vision.shapes import model_background
from plate_vision.shapes.catalogue import fit_template, make_catalogue, make_template
from plate_vision.shapes.outlines import distances, fit_pose, make_outline

TYPES = load_part_types(config_path("parts.yaml"))
SCALE = 1000.0
CENTRE_PX = np.array([319.5, 239.5])
GRID = [(x, y) for y in (-0.15, -0.05, 0.05, 0.15) for x in (-0.24, -0.12, 0.0, 0.12, 0.24)]


@pytest.fixture(scope="module")
def catalogue():
    return make_catalogue(TYPES)


def scatter(names, rng):
    """Poses of parts on a grid, each turned and shifted at random."""
    return [
        (name, x + 0.01 * rng.random(), y + 0.01 * rng.random(), rng.uniform(-np.pi, np.pi))
        for name, (x, y) in zip(names, GRID, strict=False)
    ]


def paired(found, poses):
    """Each pose with the detection there."""
    place = np.array([[x, -y] for _, x, y, _ in poses]) * SCALE + CENTRE_PX
    for pose, point in zip(poses, place, strict=True):
        gap = np.hypot(found["x_px"] - point[0], found["y_px"] - point[1])
        yield pose, found[np.argmin(gap)], float(np.min(gap))


def turn_error(found, pose):
    """Error of an angle [degrees], modulo the symmetry; 0 for a disc."""
    symmetry = TYPES[pose[0]].symmetry
    if symmetry == 0:
        return 0.0
    period = 360 / symmetry
    return float((np.degrees(found["angle_rad"] - pose[3]) + period / 2) % period - period / 2)


@pytest.mark.parametrize("seed", range(3))
def test_names_places_and_angles_are_the_true_ones(draw_types, catalogue, seed):
    rng = np.random.default_rng(seed)
    poses = scatter(rng.permutation([*TYPES] * 2), rng)
    found = find_parts(draw_types(TYPES, poses, rng), catalogue)
    assert len(found) == len(poses)
    for pose, one, gap in paired(found, poses):
        assert one["label"] == pose[0]
        assert one["confidence"] > 0.8
        assert gap < 0.1
        assert abs(turn_error(one, pose)) < 1.2
        expected = np.sqrt(TYPES[pose[0]].area_m2 / np.pi) * SCALE
        assert one["radius_px"] == pytest.approx(expected, abs=1e-6)


def star(corners, reach, depth):
    """A type with a given number of corners."""
    turn = np.pi / corners * np.arange(2 * corners)
    far = reach * np.where(np.arange(2 * corners) % 2, 1 - depth, 1)
    outline = np.column_stack([far * np.cos(turn), far * np.sin(turn)])
    outline = tuple(map(tuple, outline.tolist()))
    return replace(TYPES["square"], name="star", outline=outline, symmetry=corners)


@pytest.mark.parametrize(
    ("corners", "reach", "depth", "blur"),
    [(5, 0.01, 0.15, 0.7), (8, 0.01, 0.1, 0.7), (16, 0.012, 0.15, 1.5), (16, 0.008, 0.15, 1.5)],
)
def test_angles_have_the_stated_uncertainty(draw_types, corners, reach, depth, blur):
    rng = np.random.default_rng(13)
    types = {"star": star(corners, reach, depth)}
    catalogue, errors = make_catalogue(types), []
    for _ in range(3):
        poses = scatter(["star"] * 20, rng)
        image = draw_types(types, poses, rng, blur=blur)
        bare, calibration = model_background(image), calibrate_by_scale(SCALE)
        seen = find_types(image, catalogue, bare, calibration)
        for pose, one, _ in paired(seen, poses):
            period = 2 * np.pi / corners
            off = (one["angle"] - pose[3] + period / 2) % period - period / 2
            errors.append(off / one["angle_sd"])
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_indistinguishable_types_are_reported():
    calibration = calibrate_by_scale(SCALE)
    assert camera_limits(TYPES, calibration) == []
    (text,) = camera_limits({"star": star(16, 0.006, 0.1)}, calibration)
    assert text.startswith("type star: protrusion of its 16 corners in the image is 0.0")
    coins = {name: replace(TYPES["coin_small"], name=name) for name in ("one", "two", "three")}
    coins["two"] = replace(coins["two"], radius_m=0.0083)
    coins["three"] = replace(coins["three"], radius_m=0.0098)
    alike, _, alone = camera_limits(coins, calibration)
    assert "one and two look alike" in alike
    assert "two and three differ only in size, by 1.5 px" in alone
    del coins["two"]
    assert camera_limits(coins, calibrate_by_scale(2 * SCALE)) == []


def test_head_and_tail_of_a_screw_are_distinguished(draw_types, catalogue):
    rng = np.random.default_rng(5)
    poses = scatter(["screw"] * 20, rng)
    found = find_parts(draw_types(TYPES, poses, rng, blur=1.5), catalogue)
    assert [one["label"] for one in found] == ["screw"] * 20
    assert max(abs(turn_error(one, pose)) for pose, one, _ in paired(found, poses)) < 1.5


TURNS = 96
"""Angles for which spectra are compared."""


def turned(template, turn):
    """The outline of a type turned by `turn` of `TURNS`."""
    c, s = np.cos(2 * np.pi * turn / TURNS), np.sin(2 * np.pi * turn / TURNS)
    return make_outline([ring @ np.array([[c, s], [-s, c]]) for ring in template.outline.rings])


def laid(turn, decoys, weight):
    """How far the fit of a screw is off (angle [rad], RMS [m]), where its spectrum is likest in
    other angles: weights of the spectra of these (`decoys`) and of the right one."""
    template = make_template(TYPES["screw"])
    outline = turned(template, turn)
    spectrum = weight * outline.spectrum
    for other, much in decoys.items():
        spectrum = spectrum + much * turned(template, other).spectrum
    fit = fit_template(template, replace(outline, spectrum=spectrum), 1e3)
    return abs(np.angle(np.exp(1j * (fit.pose[2] - 2 * np.pi * turn / TURNS)))), fit.residual


@pytest.mark.parametrize("turn", [0, 1, 7, 48, TURNS - 1])
def test_a_type_is_laid_on_from_each_likely_angle(turn):
    off, rest = laid(turn, {}, 1.0)
    assert off < 1e-3
    assert rest < 1e-5
    decoys = {(turn + 24) % TURNS: 1.0, (turn + 48) % TURNS: 0.9, (turn + 72) % TURNS: 0.8}
    off, rest = laid(turn, decoys, 0.6)
    assert off < 1e-3  # the fourth
    assert rest < 1e-5


def test_the_residual_of_a_fit_is_the_mean_of_both_directions():
    template = make_template(TYPES["bracket"])
    x, y = template.outline.points.T
    wavy = to_home(np.array([0.1, -0.05, 0.7]), np.column_stack([x, y + 3e-4 * np.sin(900 * x)]))
    fit = fit_template(template, make_outline([wavy]), 1e3)
    samples, outward = np.split(template.samples, 2, axis=1)
    moved = to_home(fit.pose, samples + fit.swell * outward)
    there = shapely.distance(shapely.LinearRing(wavy), shapely.points(moved))
    own, back = shapely.Polygon(TYPES["bracket"].polygon), shapely.points(to_plate(fit.pose, wavy))
    away = shapely.distance(own.exterior, back) * np.where(shapely.contains(own, back), -1, 1)
    square = np.mean([np.mean(there**2), np.mean((away - fit.swell) ** 2)])
    assert fit.residual == pytest.approx(np.sqrt(square), rel=1e-6)
    assert fit.residual > 1e-4


def test_without_colours_outlines_do(draw_types, catalogue):
    rng = np.random.default_rng(6)
    poses = scatter(["nut", "washer", "square", "bar", "bracket", "screw", "coin_large"], rng)
    picture = draw_types(TYPES, poses, rng)[:, :, 1].copy()
    found = find_parts(picture, catalogue)
    assert sorted(found["label"]) == sorted(pose[0] for pose in poses)


def test_a_part_that_resembles_no_type_is_unknown(draw_types):
    rng = np.random.default_rng(7)
    poses = scatter(["nut", "bracket", "coin_large"], rng)
    picture = draw_types(TYPES, poses, rng)
    found = find_parts(picture, {"nut": TYPES["nut"]})
    named = {pose[0]: one["label"] for pose, one, _ in paired(found, poses)}
    assert named == {"nut": "nut", "bracket": "unknown", "coin_large": "unknown"}
    assert set(find_parts(picture, {})["label"]) == {"unknown"}


def test_another_colour_is_another_type(draw_types):
    rng = np.random.default_rng(8)
    red = replace(TYPES["square"], name="red", colour_lab=(45.0, 55.0, 35.0))
    blue = replace(TYPES["square"], name="blue", colour_lab=(40.0, 10.0, -45.0))
    types = {"red": red, "blue": blue}
    poses = scatter(["red", "blue"] * 3, rng)
    found = find_parts(draw_types(types, poses, rng), types)
    assert [one["label"] for _, one, _ in paired(found, poses)] == ["red", "blue"] * 3


def test_a_flipped_part_is_not_of_its_type(draw_types):
    rng = np.random.default_rng(9)
    outline = (
        (0.0, 0.0),
        (0.024, 0.0),
        (0.024, 0.007),
        (0.008, 0.007),
        (0.008, 0.014),
        (0.0, 0.014),
    )
    corner = np.array(outline) - make_outline([np.array(outline)]).centre
    hook = replace(TYPES["bracket"], name="hook", outline=tuple(map(tuple, corner.tolist())))
    over = replace(hook, name="over", outline=tuple((x, -y) for x, y in hook.outline[::-1]))
    poses = scatter(["hook", "over"] * 3, rng)
    picture = draw_types({"hook": hook, "over": over}, poses, rng)
    one = [part["label"] for _, part, _ in paired(find_parts(picture, {"hook": hook}), poses)]
    assert one == ["hook", "unknown"] * 3
    both = find_parts(picture, {"hook": hook, "over": over})
    assert [part["label"] for _, part, _ in paired(both, poses)] == ["hook", "over"] * 3


def test_round_and_ragged_parts_of_a_kind_have_no_other_face(draw_types):
    rng = np.random.default_rng(11)

    def colony(name):
        turn = 2 * np.pi * np.arange(9) / 9
        around = 0.005 * (1 + 0.09 * rng.uniform(-1, 1, 9))[:, None]
        corners = around * np.column_stack([np.cos(turn), np.sin(turn)])
        corners -= make_outline([corners]).centre
        outline = tuple(map(tuple, corners.tolist()))
        return replace(TYPES["bracket"], name=name, outline=outline, scatter_m=2e-4)

    types = {f"colony_{k}": colony(f"colony_{k}") for k in range(10)}
    poses = scatter([*types] * 2, rng)
    found = find_parts(draw_types(types, poses, rng), {"colony_0": types["colony_0"]})
    named = [one["label"] == "colony_0" for _, one, _ in paired(found, poses)]
    assert sum(named) >= 18


def test_the_spectrum_turns_with_the_outline():
    ring = np.array([[0.0, 0.0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]])
    outline = make_outline([ring])
    assert outline.area == pytest.approx(6)
    assert outline.centre == pytest.approx([(4 * 2 + 2 * 0.5) / 6, (4 * 0.5 + 2 * 2) / 6])
    fine = np.concatenate([np.linspace(a, b, 50, endpoint=False) for a, b in
                           zip(ring, np.roll(ring, -1, axis=0), strict=True)])  # fmt: skip
    outline = make_outline([fine])
    turned = make_outline([(fine @ np.array([[0.6, 0.8], [-0.8, 0.6]])) + (7, -2)])
    angle = np.arctan2(0.8, 0.6)
    expected = outline.spectrum * np.exp(-1j * angle * np.arange(len(outline.spectrum)))
    assert np.allclose(turned.spectrum, expected, rtol=0, atol=1e-9 * outline.spectrum[0].real)
    assert make_outline([fine[::-1]]).area == pytest.approx(6)


def test_distances_have_signs_and_ways_out():
    square = make_outline([np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])]).edges
    found = distances(square, np.array([[1.0, 0.5], [3.0, 1.0], [3.0, 3.0], [1.0, -2.0]]))
    assert found[:, 0] == pytest.approx([-0.5, 1, np.sqrt(2), 2])
    assert found[1:, 1:] == pytest.approx(np.array([[1, 0], [0.5**0.5, 0.5**0.5], [0, -1]]))


@pytest.mark.parametrize("way", [1, -1])
def test_a_point_in_line_with_an_edge_is_outside(way):
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    for a, b in zip(square, np.roll(square, -1, axis=0), strict=True):
        beyond = b + 0.5 * (b - a) if way > 0 else a - 0.5 * (b - a)
        rolled = [make_outline([np.roll(square, k, axis=0)]).edges for k in range(4)]
        assert [distances(edges, beyond[None])[0, 0] for edges in rolled] == pytest.approx([1] * 4)


def test_a_fit_finds_pose_and_swelling():
    ring = np.array([[-2.0, -1], [2, -1], [2, 1], [-2, 1]])
    edges = make_outline([ring]).edges
    wide = np.concatenate([
        np.linspace(a, b, 20, endpoint=False) for a, b in
        zip(ring * (1.05, 1.1), np.roll(ring, -1, axis=0) * (1.05, 1.1), strict=True)
    ])  # fmt: skip
    turn = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    fit = fit_pose(edges, wide @ turn + (5, 6), np.array([5.3, 5.8, 0.5]), 0.5, True, 10)
    assert fit.pose == pytest.approx([5, 6, 0.3], abs=0.01)
    assert fit.swell == pytest.approx(0.1, abs=0.01)
    assert fit.residual < 0.02


def test_parts_that_touch_are_taken_apart_by_their_types(draw_types):
    rng = np.random.default_rng(10)
    types = {name: TYPES[name] for name in ("square", "bar", "bracket")}
    # Side by side: seen as one patch without a neck.
    poses = [
        ("square", 0.0, 0.0, 0.0),
        ("bar", 0.0202, 0.001, 0.0),
        ("square", -0.0162, -0.002, 0.0),
    ]
    picture = draw_types(types, poses, rng)
    found = find_parts(picture, types)
    assert len(found) == 3
    for pose, one, gap in paired(found, poses):
        assert one["label"] == pose[0]
        assert gap < 0.5
        assert abs(turn_error(one, pose)) < 2.5


def test_two_adjacent_brackets_are_separated(draw_types):
    rng = np.random.default_rng(12)
    types = {name: TYPES[name] for name in ("bracket", "screw")}
    poses = [("bracket", 0.0, 0.0, 0.0), ("bracket", -0.0166, 0.004, np.pi)]
    found = find_parts(draw_types(types, poses, rng), types)
    assert len(found) == 2
    for pose, one, gap in paired(found, poses):
        assert one["label"] == pose[0]
        assert gap < 0.5
        assert abs(turn_error(one, pose)) < 2.5


def test_touching_parts_of_which_no_type_is_known_are_not_dropped(draw_types):
    rng = np.random.default_rng(11)
    poses = [("square", 0.0, 0.0, 0.0), ("bar", 0.0202, 0.001, 0.0)]
    found = find_parts(draw_types(TYPES, poses, rng), {"nut": TYPES["nut"]})
    assert len(found)
    assert set(found["label"]) <= {"unknown", "group"}
