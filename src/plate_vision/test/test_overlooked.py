"""Things that are not taken for parts, as the diagnostics report them."""

import numpy as np
import pytest
from shown_text import says

from plate_core.status import Level
from plate_vision import OVERLOOKED, REASONS
from plate_vision.overlooked import Expected, OverlookedTally, may_be_parts, unnamed_objects
from plate_vision.shapes.classes import DETECTED_OBJECT

DISCS = Expected(8e-3, 8e-3)


def things(*reasons):
    """Return things of these reasons, all at one place."""
    return np.array([(0.0, 0.0, 8.0, 0.0, 0.0, reason) for reason in reasons], OVERLOOKED)


def tally(taken, *images, radius=9.8e-3):
    """Return the tally of images with a given number of parts each, and objects with these
    reasons."""
    counted = OverlookedTally()
    for reasons in images:
        counted.add(taken, things(*reasons), np.full(len(reasons), radius))
    return counted


def test_many_things_are_a_warning_with_the_remedy():
    found = tally(7, ["too large", "too large", "too faint"]).finding(DISCS)
    assert found.level == Level.WARN
    assert says(
        found.message,
        "3 of 10",
        "2 too large",
        "9.8 mm",
        "radius_m in section parts is 8 mm",
        "1 too faint",
    )


def test_a_few_things_are_reported_without_a_warning():
    found = tally(9, ["misfit"]).finding(DISCS)  # 10 %, and only one
    assert (found.level, found.message[:7]) == (Level.OK, "1 of 10")
    assert tally(30, ["misfit"] * 3).finding(DISCS).level == Level.OK  # 9 %
    assert tally(26, ["misfit"] * 3).finding(DISCS).level == Level.WARN  # 10.3 %


def test_missing_parts_cause_a_warning():
    found = tally(0, ["too small"], radius=1e-3).finding(DISCS)
    assert found.level == Level.WARN
    assert says(found.message, "no part", "1 other object", "1 too small", "radius")


def test_specks_do_not_warn_while_parts_are_seen():
    found = tally(4, ["too small"] * 6, radius=1e-3).finding(DISCS)
    assert (found.level, found.message[:7]) == (Level.OK, "6 of 10")


def test_the_edge_of_a_plate_that_moves_does_not_warn_while_parts_are_seen():
    found = tally(4, ["at the edge"] * 3 + ["beyond the plate"]).finding(DISCS)
    assert (found.level, found.message[:6]) == (Level.OK, "4 of 8")
    assert tally(0, ["beyond the plate"]).finding(DISCS).level == Level.WARN


def test_numbers_are_averages_over_the_images():
    counted = tally(4, ["group", "group"], [], ["group", "misfit"], ["misfit"] * 4)
    assert counted.finding(DISCS).message.startswith("2 of 6")
    values = counted.values()
    assert (values["overlooked"], values["overlooked_misfit"]) == ("2", "1.25")
    assert values["overlooked_at_the_edge"] == "0"
    assert set(values) == {"overlooked"} | {f"overlooked_{r.replace(' ', '_')}" for r in REASONS}


def test_a_thing_in_one_image_of_many_is_not_reported():
    assert tally(4, *[[]] * 9, ["misfit"]).finding(DISCS) is None


def test_nothing_seen_is_nothing_to_report():
    assert OverlookedTally().finding(DISCS) is None
    assert tally(3, []).finding(DISCS) is None
    assert OverlookedTally().values()["overlooked"] == "0"


@pytest.mark.parametrize("reason", REASONS)
@pytest.mark.parametrize("typed", [False, True])
def test_each_reason_has_a_remedy(reason, typed):
    found = tally(0, [reason]).finding(Expected(4e-3, 9e-3, typed))
    assert f"1 {reason} (" in found.message
    if reason == "too small":
        sizes = "types have 4 to 9 mm" if typed else "radius_m in section parts is 4 to 9 mm"
        assert f"radius is 9.8 mm, but {sizes}" in found.message


R, INNER = 8e-3, np.array([0.29, 0.14])


@pytest.mark.parametrize(
    ("x", "y", "radius", "may_be"),
    [
        (0.0, 0.0, R, True),
        (0.0, 0.0, 0.56 * R, True),  # 0.31 of a part's area
        (0.0, 0.0, 0.54 * R, False),
        (0.0, 0.0, 1.72 * R, True),  # 2.96
        (0.0, 0.0, 1.74 * R, False),
        (0.291, 0.0, R, False),  # the edge of a plate that is not at home
        (0.1, 0.1 + 2 * R, R, True),  # it touches the part at (0.1, 0.1) m
        (0.1, 0.1 + 1.5 * R, R, False),  # the shadow of that part
    ],
)
def test_only_a_thing_of_a_parts_size_beside_the_parts_may_be_one(x, y, radius, may_be):
    thing = np.array([(0.0, 0.0, 8.0, x, y, "misfit")], OVERLOOKED)
    parts = np.array([[0.1, 0.1], [-0.2, 0.0]])
    assert may_be_parts(thing, np.array([radius]), R, INNER, parts).tolist() == [may_be]
    nobody = np.zeros((0, 2))
    assert may_be_parts(thing, np.array([R]), R, INNER, nobody).tolist() == [x < 0.29]


def test_sightings_of_no_type_are_things():
    rows = [("nut", 8.0, True), ("unknown", 8.0, True), ("unknown", 3.0, True),
            ("unknown", 20.0, True), ("group", 20.0, True), ("unknown", 8.0, False),
            ("unknown", 8.0, True)]  # fmt: skip
    seen = np.zeros(len(rows), DETECTED_OBJECT)
    for row, (label, radius_px, whole) in zip(seen, rows, strict=True):
        row["label"], row["radius_px"], row["whole"], row["x"] = label, radius_px, whole, 0.1
    on_plate = np.array([True] * 6 + [False])
    found = unnamed_objects(seen, on_plate, 1e-3 * seen["radius_px"], 4e-3, 14e-3)
    assert found["reason"].tolist() == ["misfit", "too small", "too large", "group", "at the edge"]
    assert found["x"].tolist() == [0.1] * 5
    assert found["radius_px"].tolist() == [8, 3, 20, 20, 8]
