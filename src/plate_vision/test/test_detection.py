"""Detected parts against the truth of frames drawn here."""

import numpy as np
import pytest

from plate_core import PlateError
from plate_vision import (
    CLASSES,
    DETECTION,
    DetectorOptions,
    ImageError,
    OptionError,
    detect,
    make_region,
)

RADIUS_PX = 8.0
OPTIONS = DetectorOptions(radius_px=RADIUS_PX)
TURN = np.pi / 3


def apart(count, rng, gap_px, box=(45.0, 595.0, 110.0, 370.0)):
    """Random centres (count, 2) [px], at least `gap_px` between rims."""
    centre = np.empty((0, 2))
    while len(centre) < count:
        point = rng.uniform([box[0], box[2]], [box[1], box[3]])
        if np.all(np.hypot(*(centre - point).T) > 2 * RADIUS_PX + gap_px):
            centre = np.vstack([centre, point])
    return centre


def labels(count, rng):
    return rng.choice(CLASSES, count)


def error_px(found, centre, label):
    """Return distances (M,) [px] of the detections from the truth. All parts must be detected, and
    nothing else."""
    assert len(found) == len(centre)
    gap = np.hypot(found["x_px"] - centre[:, :1], found["y_px"] - centre[:, 1:])
    nearest = gap.argmin(axis=1)
    assert len(set(nearest.tolist())) == len(centre)
    assert found["label"][nearest].tolist() == list(label)
    return gap.min(axis=1)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("shading", ["flat", "slope", "vignette"])
@pytest.mark.parametrize("blur", [0.0, 0.7])
def test_centres_of_parts_apart(draw, corners_px, rng, shading, blur):
    errors, radii = [], []
    for _ in range(4):
        centre, label = apart(20, rng, gap_px=6), labels(20, rng)
        found = detect(draw(centre, label, rng, shading=shading, blur=blur), OPTIONS, corners_px)
        errors.append(error_px(found, centre, label))
        radii.append(found["radius_px"] - RADIUS_PX)
    assert rms(errors) < 0.02
    assert np.max(errors) < 0.06
    assert np.max(np.abs(radii)) < 0.1


SCENES = {
    "no noise": (40, 6, 0.0, {"noise": 0}, 0.008),
    "plate displaced": (10, 6, (4.0, -3.0), {}, 0.02),
    "smaller": (10, 10, 0.0, {"radius": 0.85 * RADIUS_PX}, 0.02),
    "larger": (10, 10, 0.0, {"radius": 1.15 * RADIUS_PX}, 0.02),
    "half the light": (10, 6, 0.0, {"light": 0.5}, 0.04),
}
"""Number of parts, least gap [px], shift of the plate [px], options of `draw`, and maximum error
[px] rms."""


@pytest.mark.parametrize("name", SCENES)
def test_errors_of_scenes(draw, corners_px, rng, name):
    """Without noise, the error is nearly zero: subpixel position and shading cause no bias."""
    count, gap_px, shift, options, most = SCENES[name]
    centre, label = apart(count, rng, gap_px), labels(count, rng)
    frame = draw(centre, label, rng, corners=corners_px + shift, **options)
    assert rms(error_px(detect(frame, OPTIONS, corners_px), centre, label)) < most


def test_a_hundred_crowded_parts(draw, corners_px, rng):
    for _ in range(3):
        centre, label = apart(100, rng, gap_px=0.0), labels(100, rng)
        found = detect(draw(centre, label, rng), OPTIONS, corners_px)
        assert rms(error_px(found, centre, label)) < 0.02


@pytest.mark.parametrize(("gap_px", "most"), [(-2.0, 0.04), (0.5, 0.02), (2.0, 0.02), (4.0, 0.02)])
def test_centres_of_near_parts(draw, corners_px, rng, gap_px, most):
    """In a tilted view, a part hides some of the next one, which is still detected by its visible
    area."""
    middle = apart(12, rng, gap_px=30, box=(60, 580, 125, 355))
    angle = rng.uniform(0, np.pi, 12)
    half = (RADIUS_PX + gap_px / 2) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    centre, label = np.concatenate([middle - half, middle + half]), labels(24, rng)
    found = detect(draw(centre, label, rng), OPTIONS, corners_px)
    assert rms(error_px(found, centre, label)) < most


def ring(count):
    return np.array([(np.cos(k * TURN), np.sin(k * TURN)) for k in range(count)])


ARRANGEMENTS = {
    "two": np.array([[0, 0], [1, 0]]),
    "three in line": np.array([[-1, 0], [0, 0], [1, 0]]),
    "three in a triangle": np.vstack([[[0, 0]], ring(2)]),
    "four in a square": np.array([[0, 0], [1, 0], [0, 1], [1, 1]]),
    "seven packed": np.vstack([[[0, 0]], ring(6)]),
}


@pytest.mark.parametrize("name", ARRANGEMENTS)
@pytest.mark.parametrize("blur", [0.0, 0.7, 1.1])
def test_touching_parts_are_split(draw, corners_px, rng, name, blur):
    """Also if the gaps between them are so blurred that they are dark."""
    errors = []
    for _ in range(2):
        groups = []
        for x in (90, 205, 320, 435, 550):
            for y in (150, 240, 330):
                angle = rng.uniform(0, 2 * np.pi)
                turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
                shape = ARRANGEMENTS[name] - ARRANGEMENTS[name].mean(axis=0)
                groups.append(2 * RADIUS_PX * shape @ turn.T + (x, y) + rng.uniform(-1, 1, 2))
        centre = np.concatenate(groups)
        label = labels(len(centre), rng)
        found = detect(draw(centre, label, rng, blur=blur), OPTIONS, corners_px)
        errors.append(error_px(found, centre, label))
    assert rms(errors) < 0.07
    assert np.max(errors) < 0.2


@pytest.mark.parametrize("room", ["dark", "bright"])
def test_parts_cut_by_the_edge(draw, corners_px, rng, room):
    """A part that hangs over the edge, with its centre still on the plate, whatever is beyond."""
    xs = np.arange(60.0, 600.0, 45.0)
    over = rng.uniform(0.5, 9, len(xs))
    top = np.interp(xs, [27, 613], [90, 93])
    centre, label = np.stack([xs, top + over], axis=1), labels(len(xs), rng)

    def brighten(image):
        if room == "bright":
            y, x = np.mgrid[: image.shape[0], : image.shape[1]]
            image[y < np.interp(x, [27, 613], [90, 93]) - 0.5] = 250

    found = detect(draw(centre, label, rng, extra=brighten), OPTIONS, corners_px)
    errors = error_px(found, centre, label)
    assert rms(errors) < 0.08
    assert np.max(errors) < 0.25


@pytest.mark.parametrize("corner", range(4))
@pytest.mark.parametrize("room", [20, 70, 250])
def test_part_in_a_corner(draw, corners_px, rng, corner, room):
    """A quarter of it is on the plate, whatever the room looks like."""
    centre = corners_px[corner] + 1.5 * np.sign([320, 240] - corners_px[corner])
    on_plate = draw([], [], rng, shading="flat", noise=0) > 145

    def paint(image):
        image[~on_plate] = room

    found = detect(draw([centre], ["black"], rng, extra=paint), OPTIONS, corners_px)
    assert error_px(found, centre[None], ["black"])[0] < 0.5


def test_objects_beside_the_plate_are_ignored(draw, corners_px, rng):
    centre = np.array(
        [[300.0, 40.0], [300.0, 84.0], [300.0, 430.0], [320.0, 240.0], [635.0, 240.0]]
    )
    label = ["black"] * 5

    def whiten(image):  # a white table: parts that lie on it are easily seen
        image[:88] = image[394:] = 240
        image[:, 621:] = 240

    frame = draw(centre, label, rng, extra=None)
    assert error_px(detect(frame, OPTIONS, corners_px), centre[3:4], ["black"])[0] < 0.1
    frame = draw([], [], rng, extra=whiten)
    assert len(detect(frame, OPTIONS, corners_px)) == 0


def test_the_margin_keeps_parts_whose_centres_seem_off_the_plate(draw, corners_px, rng):
    """With the plate a little displaced, a part's centre may seem to be beside it."""
    moved = corners_px + (0.0, -2.0)
    centre = np.array([[300.0, 91.85], [400.0, 240.0]])  # y of the edge at rest there: 92.55
    frame = draw(centre, ["black", "grey"], rng, corners=moved)
    assert error_px(detect(frame, OPTIONS, corners_px), centre, ["black", "grey"]).max() < 0.2
    found = detect(frame, DetectorOptions(radius_px=RADIUS_PX, margin_px=0), corners_px)
    assert found["label"].tolist() == ["grey"]
    assert len(detect(frame, OPTIONS, moved)) == 2


def test_empty_plate(draw, corners_px, rng):
    for shading in ("flat", "slope", "vignette"):
        found = detect(draw([], [], rng, shading=shading), OPTIONS, corners_px)
        assert found.dtype == DETECTION
        assert found.shape == (0,)


@pytest.mark.parametrize("level", [0, 1, 20, 128, 255])
@pytest.mark.parametrize("shape", [(480, 640), (1, 1), (1, 300), (300, 1), (3, 3), (20, 20)])
def test_even_images_have_no_parts(level, shape):
    assert len(detect(np.full(shape, level, np.uint8))) == 0


def test_noise_has_no_parts(rng, corners_px):
    for low, high in ((0, 256), (150, 256), (0, 60)):
        image = rng.integers(low, high, (480, 640), dtype=np.uint8)
        assert len(detect(image, OPTIONS, corners_px)) == 0
        assert len(detect(image)) == 0


def test_other_dark_things_are_no_parts(draw, corners_px, rng):
    def clutter(image):
        image[200:290, 100:180] = 30  # a large box
        image[150:154, 250:400] = 30  # a thin line
        image[300:305, 300:305] = 30  # a speck
        image[230:270, 400:408] = 30  # a short bar
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        image[np.hypot(x - 500, y - 200) < 16] = 30  # a disc twice as large
        image[np.hypot(x - 500, y - 300) < 4] = 30  # and one half as large

    centre, label = np.array([[220.0, 330.0], [560.0, 130.0]]), ["black", "grey"]
    found = detect(draw(centre, label, rng, extra=clutter), OPTIONS, corners_px)
    assert error_px(found, centre, label).max() < 0.06


def ellipse(x, y):
    return (x / 12) ** 2 + (y / 5.5) ** 2 < 1


def plus(x, y):
    return (np.abs(x) < 3) & (np.abs(y) < 12) | (np.abs(y) < 3) & (np.abs(x) < 12)


def triangle(x, y):
    return (y < 7) & (y > 1.73 * np.abs(x) - 14)


def larger(x, y):
    return np.hypot(x, y) < 1.4 * RADIUS_PX


def smaller(x, y):
    return np.hypot(x, y) < 0.65 * RADIUS_PX


@pytest.mark.parametrize("shape", [ellipse, plus, triangle, larger, smaller, None])
def test_other_shapes_as_large_as_a_part_and_a_shadow_are_no_parts(draw, corners_px, rng, shape):
    def add(image):
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        if shape is None:
            image *= 1 - 0.15 * np.exp(-((x - 300) ** 2 + (y - 200) ** 2) / (2 * 8.0**2))
        else:
            image[shape(x - 300, y - 200)] = 40

    assert len(detect(draw([], [], rng, extra=add), OPTIONS, corners_px)) == 0


def test_part_with_something_attached(draw, corners_px, rng):
    """It hardly moves the part: moments would be drawn aside by 0.4 px."""

    def wire(image):
        image[199:202, 308:330] = 40

    centre = np.array([[300.3, 200.4]])
    found = detect(draw(centre, ["black"], rng, extra=wire), OPTIONS, corners_px)
    assert error_px(found, centre, ["black"])[0] < 0.12


@pytest.mark.parametrize("radius_px", [4.0, 12.0, 30.0])
def test_parts_of_other_radii_are_detected(draw, corners_px, rng, radius_px):
    centre = np.array([[x, y] for x in (100.3, 220.0, 340.6) for y in (150.2, 300.8)])
    label = labels(6, rng)
    frame = draw(centre, label, rng, radius=radius_px)
    found = detect(frame, DetectorOptions(radius_px=radius_px), corners_px)
    assert rms(error_px(found, centre, label)) < 0.03
    assert np.allclose(found["radius_px"], radius_px, atol=0.15)


def test_radius_tolerance(draw, corners_px, rng):
    for fraction in (0.9, 1.1):
        frame = draw([[300.0, 200.0]], ["grey"], rng, radius=fraction * RADIUS_PX)
        for tolerance, count in ((0.05, 0), (0.15, 1)):
            options = DetectorOptions(radius_px=RADIUS_PX, radius_tolerance=tolerance)
            assert len(detect(frame, options, corners_px)) == count


def test_thresholds_separate_the_classes(draw, corners_px, rng):
    """Shares of the plate's brightness: black is 0.18, grey 0.59 of it."""
    centre = np.array([[200.0, 200.0], [400.0, 300.0]])
    frame = draw(centre, ["black", "grey"], rng)

    def found(**options):
        return sorted(detect(frame, DetectorOptions(**options), corners_px)["label"].tolist())

    assert found() == ["black", "grey"]
    assert found(threshold=0.5) == ["black"]
    assert found(class_threshold=0.7) == ["black", "black"]
    assert found(class_threshold=0.1) == ["grey", "grey"]
    assert found(min_plate_grey=240) == []


def test_images_of_all_memory_layouts_are_accepted(draw, corners_px, rng):
    centre, label = apart(10, rng, gap_px=6), labels(10, rng)
    frame = draw(centre, label, rng)
    frame.setflags(write=False)
    expected = detect(frame, OPTIONS, corners_px)
    assert rms(error_px(detect(frame, OPTIONS), centre, label)) < 0.03  # without a region
    padded = np.zeros((480, 700), np.uint8)
    padded[:, :640] = frame
    for image in (padded[:, :640], np.dstack([frame] * 3), np.asfortranarray(frame)):
        assert np.array_equal(detect(image, OPTIONS, corners_px), expected)
    assert np.array_equal(detect(frame, OPTIONS, corners_px[::-1]), expected)  # other sense
    region = make_region((640, 480), corners_px)
    assert np.array_equal(detect(frame, OPTIONS, region), expected)
    with pytest.raises(ImageError, match=r"image: size is .* allowed: .*region"):
        detect(frame[:-1], OPTIONS, region)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((48, 64), np.uint16),
        np.zeros((48, 64), float),
        np.zeros(64, np.uint8),
        np.zeros((48, 64, 4), np.uint8),
        np.zeros((0, 64), np.uint8),
    ],
    ids=["uint16", "float", "1-D", "4 channels", "empty"],
)
def test_wrong_images_are_refused(image):
    with pytest.raises(ImageError, match=r"image: .* allowed: "):
        detect(image)


@pytest.mark.parametrize(
    "region",
    [
        [[0, 0], [10, 0], [10, 10]],
        [[0, 0], [10, 0], [20, 0], [30, 0]],
        [[0, 0], [100, 100], [100, 0], [0, 100]],
        [[0, 0], [100, 0], [100, np.nan], [0, 100]],
        [[0, 0], [5, 0], [5, 5], [0, 5]],
        [[900, 0], [1000, 0], [1000, 100], [900, 100]],
    ],
    ids=["three", "in line", "crossed", "nan", "tiny", "outside"],
)
def test_wrong_regions_are_refused(region):
    with pytest.raises(ImageError, match=r"region: .*allowed: "):
        detect(np.full((480, 640), 200, np.uint8), region=np.array(region))


@pytest.mark.parametrize(
    ("name", "value"),
    [("radius_px", 2.0), ("threshold", 1.0), ("margin_px", -1.0), ("radius_tolerance", np.nan)],
)
def test_wrong_options_are_refused(name, value):
    with pytest.raises(OptionError, match=f"{name} is .*allowed: ") as info:
        DetectorOptions(**{name: value})
    assert isinstance(info.value, PlateError)
