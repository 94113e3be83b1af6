"""Parts of which nothing is known: drawn ones, and photographs with centres marked by hand."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from plate_vision import ImageError, detect

PHOTOGRAPHS_PX = yaml.safe_load(
    Path(__file__).with_name("photographs.yaml").read_text(encoding="utf-8")
)
"""Centres by name."""

SUB = 8
"""Sub-pixels along each side of a pixel."""


def scene(shapes, part=180.0, ground=80.0, light=None, noise=2.0, seed=1, size=(300, 400)):
    """Return a picture (H, W) uint8. `shapes` return which points x, y [px] are inside."""
    height, width = size
    offset = (np.arange(SUB) + 0.5) / SUB - 0.5
    x = (np.arange(width)[:, None] + offset).ravel()
    y = (np.arange(height)[:, None] + offset).ravel()[:, None]
    inside = np.zeros((height * SUB, width * SUB), bool)
    for shape in shapes:
        inside |= shape(x, y)
    cover = inside.reshape(height, SUB, width, SUB).mean(axis=(1, 3))
    image = ground + (part - ground) * cover
    if light is not None:
        image = image * light(np.linspace(-1, 1, width), np.linspace(-1, 1, height)[:, None])
    image = image + noise * np.random.default_rng(seed).standard_normal(size)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def disc(cx, cy, radius):
    return lambda x, y: (x - cx) ** 2 + (y - cy) ** 2 <= radius**2


def polygon(corners):
    """A convex polygon by its corners (n, 2) [px], counter-clockwise as seen."""

    def inside(x, y):
        result = True
        for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            result = result & ((bx - ax) * (y - ay) - (by - ay) * (x - ax) <= 0)
        return result

    return inside


def turned(corners, angle_rad, centre):
    """Corners (n, 2), y up, turned counter-clockwise, as they are seen: y down [px]."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return (np.asarray(corners) @ np.array([[c, s], [-s, c]])) * (1, -1) + centre


def slope(u, v):
    return 1 + 0.3 * u - 0.2 * v


def nearest(found, centre):
    centre = np.asarray(centre, dtype=float).reshape(-1, 2)
    assert len(found) == len(centre)
    if not len(centre):
        return np.zeros(0), found
    gap = np.hypot(found["x_px"] - centre[:, :1], found["y_px"] - centre[:, 1:])
    assert sorted(gap.argmin(axis=1).tolist()) == list(range(len(centre)))
    return gap.min(axis=1), found[gap.argmin(axis=1)]


MIXED = [(60.3, 70.2, 12), (150.6, 80.9, 25), (280.1, 90.4, 40), (90.8, 210.5, 18), (250, 220, 30)]


@pytest.mark.parametrize("light", [None, slope], ids=["even", "uneven"])
@pytest.mark.parametrize(("part", "ground"), [(180, 80), (40, 150)], ids=["bright", "dark"])
def test_discs_of_any_size(light, part, ground):
    image = scene([disc(*one) for one in MIXED], part, ground, light)
    error, parts = nearest(detect(image), [one[:2] for one in MIXED])
    assert error.max() < 0.4
    assert np.abs(parts["radius_px"] - [one[2] for one in MIXED]).max() < 0.7
    assert set(parts["method"]) == {"outline"}
    assert set(parts["label"]) <= ({"white"} if part > ground else {"black", "grey"})
    assert parts["confidence"].min() > 0.8
    assert np.all(parts["angle_rad"] == 0)


def test_the_size_of_equal_parts_is_found():
    """They are measured again as parts of that radius: ten times better."""
    centre = [(50.3, 60.2), (120.6, 80.9), (200.1, 90.4), (80.8, 200.5), (250.7, 200.1)]
    for part, ground in ((180, 80), (40, 200)):
        image = scene([disc(x, y, 15) for x, y in centre], part, ground)
        error, parts = nearest(detect(image), centre)
        assert error.max() < 0.04
        assert np.abs(parts["radius_px"] - 15).max() < 0.1
        assert set(parts["method"]) == {"moments"}


def test_parts_that_touch_are_parted_where_others_show_their_size():
    centre = [(50.3, 60.2), (120.6, 80.9), (200.1, 90.4), (80.8, 200.5), (250.7, 200.1)]
    centre += [(330.2, 200.4), (330.2, 230.4)]
    image = scene([disc(x, y, 15) for x, y in centre], 40, 200)
    error, parts = nearest(detect(image), centre)
    assert error.max() < 0.06
    assert parts["method"].tolist() == 5 * ["moments"] + 2 * ["fit"]


def test_wrong_pictures_are_refused():
    for picture in (np.full((30, 40), np.nan), np.zeros((30, 40), np.uint16), np.zeros((0, 4))):
        with pytest.raises(ImageError, match=r"image: .* allowed: "):
            detect(picture)


ANGLES = (0.2, 0.9, 1.7, 2.8)


@pytest.mark.parametrize(
    ("corners", "turn"),
    [
        ([(-30, -12), (30, -12), (30, 12), (-30, 12)], np.pi),
        ([(-20, -20), (20, -20), (20, 20), (-20, 20)], np.pi / 2),
        ([(-24, -14), (24, -14), (14, 14), (-14, 14)], np.pi),
    ],
    ids=["bar", "square", "trapezium"],
)
@pytest.mark.parametrize("angle_rad", ANGLES)
def test_polygons_have_an_angle(corners, turn, angle_rad):
    """Counter-clockwise as seen; up to the symmetry of the shape."""
    seen = turned(corners, angle_rad, (200.3, 150.6))
    image = scene([polygon(seen), disc(60, 60, 20)], 180, 80, slope)
    found = detect(image)
    assert len(found) == 2
    part = found[np.argmax(found["x_px"])]
    x, y = np.array(corners, dtype=float).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = np.sum(cross) / 2
    middle_y = np.sum((y + np.roll(y, -1)) * cross) / (6 * area)
    centre = turned([(0, middle_y)], angle_rad, (200.3, 150.6))[0]
    assert np.hypot(part["x_px"] - centre[0], part["y_px"] - centre[1]) < 0.4
    assert part["radius_px"] == pytest.approx(np.sqrt(area / np.pi), abs=0.7)
    away = (part["angle_rad"] - angle_rad + turn / 2) % turn - turn / 2
    assert abs(away) < np.deg2rad(2)


def test_soft_shadow_and_scratch_are_no_parts():
    def shadow(u, v):
        return 1 - 0.25 * np.exp(-((u - 0.3) ** 2 + (v + 0.2) ** 2) / 0.5)

    image = scene([disc(100, 150, 20)], 200, 90, shadow)
    image[40:42, 20:380] = 230
    error, _ = nearest(detect(image), [(100, 150)])
    assert error.max() < 0.4
    assert len(detect(scene([], 200, 120, shadow))) == 0


def test_glare_on_a_part():
    image = scene([disc(100.4, 150.7, 25), disc(250, 100, 18)], 40, 160)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    image[np.hypot(x - 105, y - 145) < 6] = 250
    error, _ = nearest(detect(image), [(100.4, 150.7), (250, 100)])
    assert error.max() < 0.5


def test_parts_blurred_along_the_motion():
    """Eight pixels long: the centre stays in the middle."""
    shapes = [disc(100.5, 150, 25), disc(260.5, 120, 20)]
    image = scene(shapes, 40, 160, noise=0).astype(float)
    image = np.mean([np.roll(image, k, axis=1) for k in range(-4, 5)], axis=0)
    image = np.rint(image + np.random.default_rng(2).standard_normal(image.shape))
    error, _ = nearest(detect(image.astype(np.uint8)), [(100.5, 150), (260.5, 120)])
    assert error.max() < 0.5


@pytest.mark.parametrize("shape", [(300, 400), (1, 1), (1, 300), (7, 9), (20, 20)])
def test_a_uniform_or_noisy_image_contains_no_parts(shape):
    rng = np.random.default_rng(3)
    for level in (0, 3, 128, 252, 255):
        assert len(detect(np.full(shape, level, np.uint8))) == 0
        noisy = level + 3 * rng.standard_normal(shape)
        assert len(detect(np.clip(noisy, 0, 255).astype(np.uint8))) == 0
    assert len(detect(rng.integers(0, 256, shape, dtype=np.uint8))) == 0


def test_huge_picture():
    image = np.full((6000, 8000), 200, np.uint8)
    y, x = np.mgrid[:1200, :1200]
    image[2000:3200, 3000:4200][np.hypot(x - 600.0, y - 600.0) < 500] = 60
    error, parts = nearest(detect(image), [(3600, 2600)])
    assert error.max() < 2
    assert parts["radius_px"][0] == pytest.approx(500, rel=0.02)


@pytest.mark.needs("skimage")
@pytest.mark.parametrize(
    ("name", "worst_px", "invented"),
    [
        ("coins", 1.5, 0),
        ("cell", 3, 0),
        ("grass", 0, 0),
        ("gravel", 0, 0),
        ("chelsea", 0, 2),  # the eyes
        ("retina", np.inf, 18),  # taken for the background, with crossings of vessels on it
    ],
)
def test_parts_of_photographs_are_found(name, worst_px, invented):
    """Centres near to those marked by hand, and hardly more parts than these, nothing set."""
    from skimage import data

    found = detect(getattr(data, name)())
    found = found[found["method"] != "group"]
    marks = np.array(PHOTOGRAPHS_PX[name], float).reshape(-1, 2)
    gap = np.hypot(*(marks[:, None] - np.column_stack([found["x_px"], found["y_px"]])).T)
    assert np.all(gap.min(axis=0, initial=np.inf) <= worst_px)
    assert np.count_nonzero(gap.min(axis=1, initial=np.inf) > worst_px) <= invented
    assert len(found) <= len(marks) + invented
