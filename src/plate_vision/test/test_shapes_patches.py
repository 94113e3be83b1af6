"""Segmentation of parts of any outline: drawn ones, whose centres are known to a sub-pixel."""

import cv2
import numpy as np
import pytest

from plate_vision import ImageError, detect, make_region
from plate_vision.shapes import Patch, find_outlines, find_patches, learn_plate, model_background
from plate_vision.shapes.grouping import split_into_pieces
from plate_vision.shapes.outlines import patch_rings

SUB = 8
"""Sub-pixels along each side of a pixel."""

SIZE = (200, 260)
LIGHT, DARK = (190, 200, 205), (35, 40, 45)
RED, BLUE, GREY = (40, 60, 130), (140, 90, 50), (90, 90, 90)
"""Blue, green, red."""


def cover_of(inside, size=SIZE):
    """Fraction of each pixel inside a shape. `inside` returns which points x, y [px] are inside."""
    offset = (np.arange(SUB) + 0.5) / SUB - 0.5
    x = (np.arange(size[1])[:, None] + offset).ravel()
    y = (np.arange(size[0])[:, None] + offset).ravel()[:, None]
    shape = (size[0], SUB, size[1], SUB)
    return np.broadcast_to(inside(x, y), (size[0] * SUB, size[1] * SUB)).reshape(shape).mean((1, 3))


def disc(cx, cy, radius):
    return lambda x, y: (x - cx) ** 2 + (y - cy) ** 2 <= radius**2


def ring(cx, cy, radius, hole):
    return lambda x, y: disc(cx, cy, radius)(x, y) & ~disc(cx, cy, hole)(x, y)


def box(cx, cy, width, height, turn=0.0):
    c, s = np.cos(turn), np.sin(turn)
    return lambda x, y: (
        (np.abs((x - cx) * c + (y - cy) * s) <= width / 2)
        & (np.abs((y - cy) * c - (x - cx) * s) <= height / 2)
    )


def bracket(cx, cy):
    """An L of two arms, 24 px long and 8 px wide, its outer corner at (cx, cy)."""
    return lambda x, y: box(cx + 12, cy + 4, 24, 8)(x, y) | box(cx + 4, cy + 12, 8, 24)(x, y)


def picture(parts, plate=LIGHT, seed=0, blur=0.6, noise=2.0, light=1.0):
    """A picture of (shape, colour) in order, on a plate."""
    image = np.tile(np.array(plate, float), (*SIZE, 1))
    for shape, colour in parts:
        cover = cover_of(shape)[:, :, None]
        image = image * (1 - cover) + np.array(colour) * cover
    image = cv2.GaussianBlur(image, (0, 0), blur) * light
    image = image + noise * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def bare(plate=LIGHT, **options):
    return learn_plate(np.stack([picture([], plate, seed, **options) for seed in (11, 12, 13)]))


def centres(patches):
    return np.array([patch.centre_px for patch in patches]).reshape(-1, 2)


def worst(patches, truth):
    """Largest error of the centres [px], once there are as many."""
    assert len(patches) == len(truth)
    gap = np.linalg.norm(centres(patches)[:, None] - np.array(truth), axis=2)
    assert sorted(gap.argmin(axis=0)) == list(range(len(truth)))
    return gap.min(axis=0).max()


def test_patch_measures_to_a_fraction_of_a_pixel():
    cover = cover_of(ring(40.3, 35.7, 14, 6), (70, 80)).astype(np.float32)
    patch = Patch(cover > 0.5, (100, 50), cover)
    assert patch.centre_px == pytest.approx([140.3, 85.7], abs=0.01)
    assert patch.area_px2 == pytest.approx(np.pi * (14**2 - 6**2), rel=2e-3)
    assert np.hypot(*(patch.outline - [140.3, 85.7]).T) == pytest.approx(14, abs=0.35)
    assert len(patch.holes) == 1
    assert np.hypot(*(patch.holes[0] - [140.3, 85.7]).T) == pytest.approx(6, abs=0.65)


@pytest.mark.parametrize("plate", [LIGHT, DARK], ids=["light", "dark"])
def test_parts_of_any_outline_on_a_plate_that_is_known(plate):
    parts = [
        (ring(40.3, 40.6, 12, 5), GREY),
        (bracket(100.4, 30.2), RED),
        (box(180.7, 50.1, 26, 12, 0.5), BLUE),
        (disc(60.2, 130.9, 14), RED),
    ]
    patches = find_patches(picture(parts, plate), bare(plate))
    arm = (24 * 8 * 12 + 16 * 8 * 4) / (24 * 8 + 16 * 8)
    other = (24 * 8 * 4 + 16 * 8 * 16) / (24 * 8 + 16 * 8)
    truth = [(40.3, 40.6), (100.4 + arm, 30.2 + other), (180.7, 50.1), (60.2, 130.9)]
    assert worst(patches, truth) < 0.15
    assert sorted(len(patch.holes) for patch in patches) == [0, 0, 0, 1]
    assert all(patch.whole and not patch.group for patch in patches)


def test_an_object_inside_a_frame_is_not_part_of_the_frame():
    inner = disc(60.4, 80.7, 9)
    rim = (lambda x, y: ~disc(130, 100, 90)(x, y), DARK)
    patches = find_patches(picture([rim, (inner, DARK)]), bare())
    large, small = sorted(patches, key=lambda patch: -patch.area_px2)
    assert not large.mask[81 - large.corner[1], 60 - large.corner[0]]
    assert small.centre_px == pytest.approx([60.4, 80.7], abs=0.15)


def test_a_jagged_part_with_a_waist_is_one():
    def jagged(x, y):
        left = box(100, 100, 14, 60)(x, y) | box(118, 76, 24, 12)(x, y) | box(90, 100, 16, 14)(x, y)
        right = box(160, 100, 12, 70)(x, y) | box(146, 129, 20, 12)(x, y)
        return left | right | box(130, 100, 50, 5)(x, y)

    patches = find_patches(picture([(jagged, GREY), (disc(40, 40, 12), RED)]), bare())
    assert len(patches) == 2
    assert not any(patch.group for patch in patches)


def test_a_spot_without_an_edge_is_no_part_of_a_photograph():
    image = picture([(disc(60, 60, 20), GREY)]).astype(float)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    arms = [np.exp(-(((x - 180) / a) ** 2) - ((y - 130) / b) ** 2) for a, b in ((60, 14), (14, 60))]
    image -= 45 * np.maximum(*arms)[:, :, None] * (1.0, 0.9, 0.7)
    found = detect(np.clip(image, 0, 255).astype(np.uint8))
    assert len(found) == 1
    assert found["x_px"][0] == pytest.approx(60, abs=0.3)


def test_grey_levels_are_sufficient_to_find_parts():
    shapes = [disc(50.2, 60.4, 13), box(150.6, 90.3, 30, 14, 1.0)]
    images = [picture([(shape, GREY) for shape in shapes])[:, :, 1]]
    plate = learn_plate(np.stack([picture([], seed=5)[:, :, 1]]))
    assert worst(find_patches(images[0], plate), [(50.2, 60.4), (150.6, 90.3)]) < 0.15


def test_an_empty_plate_has_no_parts():
    assert find_patches(picture([], seed=4), bare()) == []
    assert (
        find_patches(np.zeros((5, 6), np.uint8), learn_plate(np.zeros((2, 5, 6), np.uint8))) == []
    )


def test_slow_changes_of_light_are_followed():
    image = picture([(disc(80.4, 90.3, 12), RED)], light=0.9)
    assert worst(find_patches(image, bare().followed(image)), [(80.4, 90.3)]) < 0.15


@pytest.mark.parametrize("light", [0.3, 0.6, 1.2])
def test_jumps_of_the_exposure_are_followed(light):
    image = picture([(disc(80.4, 90.3, 12), DARK)], light=light)
    assert worst(find_patches(image, bare().followed(image)), [(80.4, 90.3)]) < 0.2


def test_grey_levels_are_compared_with_a_plate_in_colours_and_colours_with_a_grey_one():
    image = picture([(disc(80.4, 90.3, 12), DARK)])
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    plain = learn_plate(cv2.cvtColor(picture([], seed=11), cv2.COLOR_BGR2GRAY)[None])
    for seen, background in ((grey, bare()), (image, plain)):
        assert worst(find_patches(seen, background), [(80.4, 90.3)]) < 0.15


def test_a_part_that_the_image_cuts_off_is_not_whole_where_the_plate_goes_on():
    plate = make_region(SIZE[::-1], np.array([[-50, 250], [310, 250], [310, -50], [-50, -50]]))
    image = picture([(disc(80.4, 90.3, 12), RED), (disc(255.0, 90.3, 12), RED)])
    whole = {round(p.centre_px[0]) > 200: p.whole for p in find_patches(image, bare(), plate)}
    assert whole == {False: True, True: False}


def test_a_highlight_belongs_to_its_part():
    parts = [(disc(80.4, 90.3, 16), (60, 60, 60)), (disc(86, 84, 3), (252, 252, 252))]
    (patch,) = find_patches(picture(parts), bare())
    assert np.hypot(*(patch.centre_px - [80.4, 90.3])) < 0.3
    assert patch.holes == []


def test_a_shadow_is_no_part():
    spots = [(60.3, 60.4), (150.6, 70.2), (100.1, 140.5)]
    plate = np.tile(np.array(LIGHT, float), (*SIZE, 1))
    cast = sum(cover_of(disc(x + 4, y + 3, 12)) for x, y in spots)
    plate *= 1 - 0.3 * cv2.GaussianBlur(cast, (0, 0), 2.5)[:, :, None]
    for x, y in spots:
        cover = cover_of(disc(x, y, 12))[:, :, None]
        plate = plate * (1 - cover) + np.array((60, 60, 60)) * cover
    plate += 2 * np.random.default_rng(3).standard_normal(plate.shape)
    image = np.clip(np.rint(plate), 0, 255).astype(np.uint8)
    assert worst(find_patches(image, bare()), spots) < 0.6


@pytest.mark.parametrize("high_px", [2, 4, 6])
def test_dark_side_faces_of_high_parts_leave_no_shadows(high_px):
    """A camera beside the parts sees them all on the same side."""
    spots = [(60.3, 60.4), (150.6, 70.2), (100.1, 140.5), (200.4, 130.3)]
    parts = []
    for x, y in spots:
        parts += [(disc(x + k, y, 12), (45, 45, 45)) for k in range(high_px + 1)]
        parts.append((disc(x, y, 12), (130, 130, 130)))
    assert worst(find_patches(picture(parts), bare()), spots) < high_px


def test_a_ragged_narrow_hole_does_not_cut_a_part_in_two():
    """The hole of a high washer, seen from the side: a side face narrows it, and shades off."""
    x0, y0 = 100.4, 90.3

    def hole(x, y):
        return (((x - x0) / 2) ** 2 + ((y - y0) / 4.5) ** 2 < 1) | box(x0 + 2, y0, 4, 1.6)(x, y)

    def washer(x, y):
        outer = [disc(x0 - 2.5, y0, 9), disc(x0 + 2.5, y0, 9), box(x0, y0, 5, 18)]
        return np.any([one(x, y) for one in outer], axis=0) & ~hole(x, y)

    (patch,) = find_patches(picture([(washer, DARK)], blur=0.4), bare())
    assert patch.centre_px == pytest.approx((x0, y0), abs=0.3)
    assert patch.area_px2 == pytest.approx(np.pi * 9**2 + 5 * 18 - 32, rel=0.04)


def test_parts_in_two_colours_are_one():
    halves = [
        (disc(80.4, 90.3, 14), RED),
        (lambda x, y: disc(80.4, 90.3, 14)(x, y) & (x > 83), (150, 150, 150)),
    ]
    assert worst(find_patches(picture(halves), bare()), [(80.4, 90.3)]) < 0.5


def test_a_chain_of_parts_is_split():
    spots = [(50.3, 80.1), (74.3, 80.1), (95.0, 92.2), (119.1, 92.2)]
    parts = [(disc(x, y, 12), BLUE) for x, y in spots]
    parts.append((box(141.2, 92.2, 20, 24), BLUE))
    assert worst(find_patches(picture(parts), bare()), [*spots, (141.2, 92.2)]) < 0.8


def test_a_pair_with_a_common_side_is_split_by_similar_parts():
    """Two bars with a whole side in common, and others of their kind elsewhere."""
    apart = [(40.3, 40.2), (100.1, 40.9), (160.7, 40.4), (220.2, 40.6)]
    pair = [(100.0, 120.0), (104.0, 132.0)]
    parts = [(box(x, y, 26, 12), RED) for x, y in apart + pair]
    assert worst(find_patches(picture(parts), bare()), apart + pair) < 1.0


def test_a_patch_that_cannot_be_split_is_a_group():
    """Three brackets that lie in each other, among discs of one kind."""
    apart = [(30.3, 30.2), (80.1, 30.9), (140.7, 30.4), (200.2, 30.6), (30.5, 140.5)]
    parts = [(disc(x, y, 9), RED) for x, y in apart]
    parts += [(bracket(x, y), RED) for x, y in [(120, 110), (128, 118), (136, 126)]]
    patches = find_patches(picture(parts), bare())
    assert [patch.group for patch in patches].count(True) == 1
    assert sum(not patch.group for patch in patches) == len(apart)


def test_a_patch_that_the_border_cuts_is_not_whole():
    image = picture([(disc(3.0, 80.0, 12), RED), (disc(80.4, 90.3, 12), RED)])
    patches = find_patches(image, bare())
    assert sorted(patch.whole for patch in patches) == [False, True]
    region = make_region((SIZE[1], SIZE[0]), np.array([[85, 5], [250, 5], [250, 190], [85, 190]]))
    assert [patch.whole for patch in find_patches(image, bare(), region)] == [False]


def test_a_photograph_has_dark_and_bright_parts_and_any_border():
    parts = [
        (disc(60.2, 60.4, 13), (235, 235, 235)),
        (disc(150.3, 70.1, 15), (30, 30, 30)),
        (box(130, 195, 300, 14), (60, 40, 30)),
    ]
    image = picture(parts, (120, 130, 125))
    found = [patch for patch in find_patches(image, model_background(image)) if patch.whole]
    assert worst(found, [(60.2, 60.4), (150.3, 70.1)]) < 0.2
    assert set(detect(image)["label"]) == {"white", "black"}


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((10, 20), np.uint8), "260 x 200 px"),
        (np.zeros((*SIZE, 3)), "uint8"),
        (np.zeros((2, 3, 4, 5), np.uint8), r"\(H, W\)"),
    ],
)
def test_wrong_images_are_refused(image, message):
    with pytest.raises(ImageError, match=rf"image: .* allowed: .*{message}"):
        find_patches(image, bare())


def test_wrong_pictures_of_the_plate_are_refused():
    with pytest.raises(ImageError, match=r"images: shape is .* allowed: \(n, H, W\)"):
        learn_plate(np.zeros((10, 20), np.uint8))


@pytest.mark.parametrize("seed", range(3))
def test_a_gap_that_four_bars_enclose_is_no_part(seed):
    """It had come out as a patch of single pixels, without a rim, and the detector ended."""
    around = [(116, 96, 1.93), (137, 88, 2.43), (144, 107, 1.19), (127, 114, 0.44)]
    apart = [(30 + 60 * k, y, 0.5 * k) for k in range(4) for y in (40, 160)]
    move = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
    bars = [box(*(at + move), 23.3, 12, turn) for *at, turn in [*around, *apart]]
    image = picture([(bar, BLUE) for bar in bars], seed=seed)
    areas = [patch.area_px2 for patch in find_patches(image, model_background(image))]
    assert areas == pytest.approx(12 * [280], rel=0.25)


def pieces(*patches):
    """Pieces of patches, each of several shapes that touch."""
    solids = []
    for shapes in patches:
        cover = np.max([cover_of(shape) for shape in shapes], axis=0).astype(np.float32)
        solids.append((cover > 0.5, cover, np.full((*SIZE, 3), GREY, np.uint8)))
    found = split_into_pieces(solids, 30, 8.75, SIZE[0] * SIZE[1])
    for rank, (inside, _, _) in enumerate(solids):  # they share each patch out, whole
        own = [piece.inside for piece in found if piece.rank == rank]
        np.testing.assert_array_equal(np.sum(own, axis=0), inside)
    return found


def fractions(found, shapes):
    """Intersection over union of each shape with the nearest piece."""
    insides = [cover_of(shape) > 0.5 for shape in shapes]
    return [
        max(np.sum(piece.inside & inside) / np.sum(piece.inside | inside) for piece in found)
        for inside in insides
    ]


def test_touching_parts_with_narrow_necks_are_pieces_of_one_patch():
    chain = [disc(40 + 23.4 * k, 60, 12) for k in range(4)]
    single = disc(200, 150, 14)
    found = pieces([single], chain)
    traits = sorted((piece.rank, piece.alone, piece.group) for piece in found)
    assert traits == [(0, True, False), *[(1, False, False)] * 4]
    assert min(fractions(found, [single, *chain])) > 0.95


def test_a_wide_neck_separates_two_parts_if_both_are_large_or_like_others():
    large, knob = disc(80, 60, 12), disc(97, 60, 6)
    found = pieces([large, knob])
    assert len(found) == 1
    assert not found[0].group
    pair = [large, disc(100.9, 60, 12)]
    assert min(fractions(pieces(pair), pair)) > 0.9
    apart = [[disc(40, 150, 12)], [disc(180, 150, 6)]]
    parted = [piece for piece in pieces([large, knob], *apart) if piece.rank == 0]
    assert len(parted) == 2
    assert min(fractions(parted, [large, knob])) > 0.85


@pytest.mark.parametrize(("count", "larger", "smaller"), [(240, 80, 40), (60, 20, 12)])
def test_rings_of_holes_are_as_dense_as_the_rim_and_specks_are_no_holes(count, larger, smaller):
    holes = [(80.3, 70.2, 20), (130.6, 70.4, 10), (100.5, 115.1, 6)]
    cover = cover_of(disc(100, 80, 60))
    for hole in holes:
        cover = cover - cover_of(disc(*hole))
    window = np.rint(200 - 150 * cover).astype(np.uint8)
    mask = np.pad((cover > 0.5).astype(np.uint8), 1)
    rings, colour = patch_rings(mask, window, count)
    outer, *inner = sorted(rings, key=len, reverse=True)
    assert colour.tolist() == [50, 50, 50]
    assert len(outer) == count
    assert np.hypot(*(outer - [100, 80]).T) == pytest.approx(60, abs=0.25)
    assert [len(ring) for ring in inner] == pytest.approx([larger, smaller], rel=0.1)
    for ring, (x, y, radius) in zip(inner, holes, strict=False):
        assert np.hypot(*(ring - [x, y]).T) == pytest.approx(radius, abs=0.3)


def test_outlines_of_a_photograph_are_measured():
    """Each number against that of the drawn shape, also where the image is made smaller first."""
    shapes = [
        (disc(50.3, 60.4, 16), (150, 40, 60)), (box(150.6, 60.2, 40, 16, 0.5), (30, 235, 30)),
        (bracket(60, 130), (60, 40, 60)), (ring(190.2, 140.5, 18, 8), (60, 100, 60)),
    ]  # fmt: skip
    image = picture(shapes, (120, 130, 125))
    for scale, seen in ((1, image), (5, cv2.resize(image, None, fx=5, fy=5))):
        found = find_outlines(seen)
        truth = [(50.3, 60.4), (150.6, 60.2), (68.8, 138.8), (190.2, 140.5)]
        place = (np.column_stack([found["x_px"], found["y_px"]]) + 0.5) / scale - 0.5
        gap = np.linalg.norm(place[:, None] - truth, axis=2)
        assert sorted(gap.argmin(axis=0)) == [0, 1, 2, 3]
        assert gap.min(axis=0).max() < 0.3
        one, bar_, corner, washer = found[gap.argmin(axis=0)]
        assert [part["round"] for part in (one, bar_, corner, washer)] == [True, False, False, True]
        assert not found["group"].any()
        areas = [np.pi * 16**2, 640, 320, np.pi * (18**2 - 8**2)]
        for part, area in zip((one, bar_, corner, washer), areas, strict=True):
            assert part["radius_px"] == pytest.approx(scale * np.sqrt(area / np.pi), rel=0.03)
            assert part["background"] == pytest.approx(130, abs=2)
        assert one["angle_rad"] == washer["angle_rad"] == 0
        assert bar_["angle_rad"] == pytest.approx(np.pi - 0.5, abs=0.03)
        assert one["contrast"] == pytest.approx(-90, abs=4)  # of the middle channel
        assert bar_["contrast"] == pytest.approx(105, abs=4)
        assert washer["contrast"] == pytest.approx(-30, abs=4)
        assert one["confidence"] == pytest.approx(1, abs=0.03)
        assert corner["confidence"] == pytest.approx(320 / (24**2 - 16**2 / 2), abs=0.06)
        assert washer["confidence"] == pytest.approx(0.5, abs=0.06)


def test_a_patch_is_a_part_if_it_fills_its_hull_or_ends_at_an_edge():
    frayed, filled = (bracket(60, 60), DARK), (disc(180, 120, 22), GREY)
    assert len(find_outlines(picture([frayed, filled]))) == 2
    (one,) = find_outlines(picture([filled], blur=12))
    assert one["x_px"] == pytest.approx(180, abs=0.5)
