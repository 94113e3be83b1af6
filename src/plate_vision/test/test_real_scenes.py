"""Discs in scenes that laboratories have: height, tilt, shine, shadow, contrast, colour, sizes."""

import re

import numpy as np
import pytest

from plate_core.status import Level
from plate_vision import DetectorOptions, Tracker, make_vision, observe
from plate_vision.overlooked import Expected, OverlookedTally, is_separate_object

from .raycast import Look, cast

GRID = np.array(
    [(x, y) for x in np.linspace(-0.165, 0.165, 6) for y in np.linspace(-0.09, 0.09, 4)]
)
GREYS = np.tile([40.0, 130.0], 12)
NEAR = Look(distance=0.43, focal_px=430.0)


def scattered(rng):
    """Return 24 places (24, 2) [m], at least 20 mm apart."""
    return GRID + rng.uniform(-0.012, 0.012, GRID.shape)


def seen(rig, image, images=2):
    """Return the tracker after some images of one scene."""
    vision, tracker = make_vision(rig, DetectorOptions()), Tracker()
    for k in range(images):
        tracker = observe(vision, tracker, image, 1 + 0.1 * k)
    return tracker


def errors(tracker, position):
    """Return the distances (n,) [m] of all parts from the truth; all must be found, no others."""
    found = tracker.parts.position
    assert len(found) == len(position), tracker.overlooked["reason"].tolist()
    gap = np.linalg.norm(found[:, None] - position, axis=2)
    assert len(set(gap.argmin(axis=1).tolist())) == len(position)
    return gap.min(axis=1)


SCENES = {
    "high, near": (NEAR, {"height": 0.01}),
    "high, its sides bright": (NEAR, {"height": 0.01, "side": 1.2}),
    "high, tilted": (Look(0.6, 650.0, (0.0, 25.0)), {"height": 0.01}),
    "tilted sideways": (Look(0.6, 620.0, (0.0, 30.0)), {}),
    "tilted forwards": (Look(0.6, 620.0, (30.0, 0.0)), {}),
    "a highlight": (Look(), {"gloss": 0.3}),
    "faint": (Look(), {"plate": 160.0, "greys": 130.0}),
    "bright on dark": (Look(), {"plate": 70.0, "greys": 200.0}),
    "bright on grey": (Look(), {"plate": 130.0, "greys": 200.0}),
    "sizes": (Look(), {"radius": np.linspace(0.0066, 0.0094, 24)}),
    "noise": (Look(), {"noise": 20.0}),
    "small and soft": (Look(0.9, 560.0), {"blur_px": 1.8}),
    "a short hard shadow": (Look(), {"shadow": (0.003, -0.002, 0.5)}),
    "a long hard shadow": (Look(), {"shadow": (-0.006, 0.007, 0.45)}),
    "a soft shadow": (Look(), {"shadow": (0.005, 0.003, 0.35), "soft_px": 1.5}),
}
WORST = {"noise": 4e-4, "small and soft": 4e-4}
"""Largest error of a place [m], where it is not 0.25 mm."""


@pytest.mark.parametrize("name", SCENES)
def test_parts_are_found_where_they_are(name, rng):
    look, settings = SCENES[name]
    position, options = scattered(rng), dict(settings)
    greys = np.broadcast_to(options.pop("greys", GREYS), 24)
    image = cast(look, position, greys, rng, **options)
    rig = look.rig(height=settings.get("height", 0.0))
    assert errors(seen(rig, image), position).max() < WORST.get(name, 2.5e-4)


@pytest.mark.parametrize("plate", [200.0, 90.0])
def test_both_brighter_and_darker_parts(plate, rng):
    position = scattered(rng)
    image = cast(Look(), position, np.tile([20.0, 250.0], 12), rng, plate=plate)
    tracker = seen(Look().rig(), image)
    assert errors(tracker, position).max() < 2.5e-4
    assert sorted({name.split("_")[0] for name in tracker.parts.ids}) == ["black", "white"]


def test_parts_that_differ_in_colour_alone(rng):
    """Yellow on white: green and red are those of the plate."""
    position = scattered(rng)
    image = cast(Look(), position, np.tile([[60.0, 218.0, 222.0]], (24, 1)), rng)
    assert errors(seen(Look().rig(), image), position).max() < 2.5e-4


def test_without_a_lens_the_height_is_known_by_the_perspective_or_by_the_rig_file(rng):
    """A tilted view of square pixels determines the camera's position."""
    look = Look(0.6, 650.0, (0.0, 25.0))
    position = scattered(rng)
    image = cast(look, position, GREYS, rng, height=0.01)
    assert errors(seen(look.rig(height=0.01, calibrated=False), image), position).max() < 4e-4


def test_an_unknown_height_increases_the_reported_noise(rng):
    position = scattered(rng)
    image = cast(NEAR, position, GREYS, rng, height=0.006)
    tracker = seen(NEAR.rig(), image)
    gap = np.linalg.norm(tracker.parts.position[:, None] - position, axis=2).min(axis=1)
    scatter = tracker.quality[:, 0]
    assert len(gap) > 12
    far = gap > 5e-4
    assert np.median(scatter[far]) > 0.3 * np.median(gap[far])


def test_highlights_are_no_marks(rng):
    image = cast(Look(), scattered(rng), GREYS, rng, gloss=0.3)
    assert np.all(seen(Look().rig(), image).parts.angle == 0)


def test_a_detected_shadow_is_stored_in_the_tracker(rng):
    position = scattered(rng)
    look = Look()
    image = cast(look, position, GREYS, rng, shadow=(0.006, -0.004, 0.5))
    tracker = seen(look.rig(), image)
    assert tracker.shadow is not None
    assert tracker.shadow.offset_m == pytest.approx([0.006, -0.004], abs=1e-3)
    assert tracker.shadow.darkness == pytest.approx(0.5, abs=0.1)
    plain = cast(look, position, GREYS, rng)
    after = observe(make_vision(look.rig(), DetectorOptions()), tracker, plain, 2.0)
    assert errors(after, position).max() < 2.5e-4


REASONS = {
    "too large": {"radius": 0.013},
    "too small": {"radius": 0.005},
}


@pytest.mark.parametrize("reason", REASONS)
def test_ignored_objects_are_listed_with_their_reason(reason, rng):
    position = GRID[::3]
    image = cast(Look(), position, np.full(len(position), 40.0), rng, **REASONS[reason])
    tracker = seen(Look().rig(), image)
    assert {name.split("_")[0] for name in tracker.parts.ids} <= {"unknown"}
    things = tracker.overlooked
    assert things["reason"].tolist() == [reason] * len(position)
    gap = np.hypot(things["x"] - position[:, :1], things["y"] - position[:, 1:])
    assert gap.min(axis=1).max() < 1e-3


def test_a_new_part_in_place_of_an_unknown_object_is_unknown_until_it_has_a_class(rng):
    position = GRID[::3]
    large = cast(Look(), position, np.full(8, 40.0), rng, radius=0.013)
    plain = cast(Look(), position, np.full(8, 40.0), rng)
    vision, tracker = make_vision(Look().rig(), DetectorOptions()), Tracker()
    for k in range(2):
        tracker = observe(vision, tracker, large, 1 + 0.1 * k)
    assert {name.split("_")[0] for name in tracker.parts.ids} == {"unknown"}
    waited = 0
    while any(name.startswith("unknown") for name in tracker.parts.ids):
        tracker = observe(vision, tracker, plain, 2 + 0.1 * waited)
        unknown = [name for name in tracker.parts.ids if name.startswith("unknown")]
        assert tracker.overlooked["reason"].tolist() == ["unsettled"] * len(unknown)
        waited += 1
    assert 2 <= waited <= 5
    assert len(tracker.parts.ids) == 8


def test_parts_as_dark_as_their_shadows_are_not_taken_for_them(rng):
    """Which end of the dark thing is the part cannot be seen: nothing is reported as sure."""
    position = scattered(rng)
    image = cast(Look(), position, np.full(24, 130.0), rng, shadow=(0.007, 0.006, 0.43))
    tracker = seen(Look().rig(), image)
    found, scatter = tracker.parts.position, tracker.quality[:, 0]
    gap = np.linalg.norm(found[:, None] - position, axis=2).min(axis=1)
    assert np.all((gap < 2.5e-4) | (scatter > 5e-4))


def test_no_part_overlaps_another(rng):
    """Shadows of a crowd look like parts of their own."""
    places = np.linspace(-0.17, 0.17, 18)
    position = np.stack(np.meshgrid(places, places[5:13] - 0.01), axis=2).reshape(-1, 2)
    image = cast(
        Look(), position, np.full(len(position), 60.0), rng, radius=0.004, shadow=(0.004, 0.0, 0.3)
    )
    found = seen(Look().rig(radius=0.004), image).parts.position
    gap = np.linalg.norm(found[:, None] - found, axis=2) + np.eye(len(found))
    assert gap.min() > 1.3 * 0.004


@pytest.mark.parametrize("soft_px", [0.0, 1.5])
def test_two_parts_show_a_shadow(soft_px, rng):
    position = np.array([[-0.05, 0.03], [0.08, -0.04]])
    given = {"shadow": (0.004, -0.003, 0.5), "soft_px": soft_px}
    look = Look()
    tracker = seen(look.rig(), cast(look, position, np.full(2, 40.0), rng, **given))
    assert tracker.shadow is not None
    assert tracker.shadow.offset_m == pytest.approx([0.004, -0.003], abs=8e-4)
    assert errors(tracker, position).max() < 0.25e-3


def test_a_shadow_is_looked_for_in_fewer_and_fewer_images(rng, monkeypatch):
    """Where none explains the image, as with things of other shapes."""
    calls = []
    monkeypatch.setattr(
        "plate_vision.detection.find_shadow", lambda *given: calls.append(len(given))
    )
    image = cast(Look(), GRID, np.full(24, 40.0), rng, radius=0.012)
    vision, tracker = make_vision(Look().rig(), DetectorOptions()), Tracker()
    for k in range(16):
        tracker = observe(vision, tracker, image, 1 + 0.1 * k)
    assert len(calls) == 5


HIDDEN = {
    "half": (np.s_[:, 240:], (0.1, 0.0)),
    "a third": (np.s_[:, :160], (-0.134, 0.0)),
    "rows beside parts": (np.s_[140:180], (0.0, -0.009)),
    "a hand": (np.s_[60:150, 200:300], (0.01, 0.04)),
}
"""Hidden pixels, and the middle of what they hide of the plate [m]."""


@pytest.mark.parametrize("grey", [0, 120])
@pytest.mark.parametrize("name", HIDDEN)
def test_a_hidden_region_is_named_with_its_place(name, grey, rng):
    image = cast(Look(), GRID, GREYS, rng)
    pixels, (x, y) = HIDDEN[name]
    image[pixels] = grey
    tracker = seen(Look().rig(), image)
    parts, things = tracker.parts.position, tracker.overlooked
    radius, tally = things["radius_px"] / 1111, OverlookedTally()
    beside = is_separate_object(things, radius, 0.008, parts)
    tally.add(len(parts), things[beside], radius[beside])
    found = tally.finding(Expected(0.008, 0.008))
    assert found.level == Level.WARN
    place = re.search(r"plate around \((\S+), (\S+)\) m", found.message)
    assert [float(value) for value in place.groups()] == pytest.approx([x, y], abs=0.006)
