"""Marks against the truth of frames drawn here."""

import numpy as np
import pytest

from plate_core import load_rig
from plate_vision import DetectorOptions, Tracker, detect, make_vision, observe

RADIUS_PX = 8.0
OPTIONS = DetectorOptions(radius_px=RADIUS_PX)
SUB = 10
GREY_OF = {"black": 40.0, "grey": 130.0}
MARK_GREY = {"black": 130.0, "grey": 40.0}


def marks(centre, label, angle, place=0.5, size=0.3):
    """Return a function that draws a spot on every disc, by counting sub-pixels."""

    def extra(image):
        offset = (np.arange(SUB) + 0.5) / SUB - 0.5
        for (x, y), name, turn in zip(centre, label, angle, strict=True):
            at = x + place * RADIUS_PX * np.cos(turn), y - place * RADIUS_PX * np.sin(turn)
            xs, ys = (np.arange(round(c) - 5, round(c) + 6) for c in at)
            dx = (xs[:, None] + offset).ravel() - at[0]
            dy = (ys[:, None] + offset).ravel() - at[1]
            inside = dx**2 + dy[:, None] ** 2 <= (size * RADIUS_PX) ** 2
            cover = inside.reshape(len(ys), SUB, len(xs), SUB).mean(axis=(1, 3))
            window = image[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1]
            window += cover * (MARK_GREY[name] - GREY_OF[name])

    return extra


def scattered(rng):
    """Return centres (24, 2) [px] on a grid, each off it, classes and angles [rad]."""
    grid = np.stack(np.meshgrid(np.linspace(80, 560, 8), (150.0, 240.0, 330.0)), axis=-1)
    centre = grid.reshape(-1, 2) + rng.uniform(-3, 3, (24, 2))
    return centre, rng.choice(list(GREY_OF), 24), rng.uniform(-np.pi, np.pi, 24)


def rows(found, centre):
    gap = np.hypot(found["x_px"] - centre[:, :1], found["y_px"] - centre[:, 1:])
    assert len(found) == len(centre)
    return gap.argmin(axis=1), gap.min(axis=1)


@pytest.mark.parametrize("shading", ["flat", "vignette"])
def test_a_mark_determines_the_angle_and_does_not_move_the_centre(draw, corners_px, rng, shading):
    turned, off = [], []
    for _ in range(4):
        centre, label, angle = scattered(rng)
        extra = marks(centre, label, angle)
        image = draw(centre, label, rng, shading=shading, extra=extra)
        found = detect(image, OPTIONS, corners_px)
        row, gap = rows(found, centre)
        assert found["label"][row].tolist() == list(label)
        error = found["angle_rad"][row] - angle
        turned.append(np.abs((error + np.pi) % (2 * np.pi) - np.pi))
        off.append(gap)
    assert np.degrees(np.max(turned)) < 3
    assert np.degrees(np.median(turned)) < 0.7
    assert np.sqrt(np.mean(np.square(off))) < 0.05  # 0.03 without marks


def test_marks_have_the_stated_deviation(draw, rng):
    vision = make_vision(load_rig())
    centre, label, angle = scattered(rng)
    tracker = observe(
        vision, Tracker(), draw(centre, label, rng, extra=marks(centre, label, angle)), 0.0
    )
    gap = tracker.parts.position[:, None] - vision.calibration.to_home(centre)
    nearest = np.argmin(np.hypot(*np.moveaxis(gap, 2, 0)), axis=1)
    error = np.remainder(tracker.parts.angle - angle[nearest] + np.pi, 2 * np.pi) - np.pi
    assert 1 / 3 < np.sqrt(np.mean(np.square(error / tracker.quality[:, 1]))) < 3


def test_discs_without_a_mark_have_no_angle(draw, corners_px, rng):
    centre, label, _ = scattered(rng)
    found = detect(draw(centre, label, rng), OPTIONS, corners_px)
    assert np.all(found["angle_rad"] == 0)


@pytest.mark.parametrize(("place", "size"), [(0.0, 0.3), (0.5, 0.1), (0.9, 0.3)])
def test_spots_that_are_no_mark_give_no_angle(draw, corners_px, rng, place, size):
    """A spot in the middle, a speck, a bite out of the rim."""
    centre, label, angle = scattered(rng)
    extra = marks(centre, label, angle, place, size)
    found = detect(draw(centre, label, rng, extra=extra), OPTIONS, corners_px)
    row, _ = rows(found, centre)
    assert np.all(found["angle_rad"][row] == 0)
