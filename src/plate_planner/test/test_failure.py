"""Texts for failed tasks: the cause, the part, and the remedy that fits."""

from dataclasses import replace

import numpy as np
import pytest
from plant import RIG

from plate_core import Parts
from plate_planner.estimation import LastRequest
from plate_planner.supervision.failure import (
    FEW,
    NOBODY,
    LastSeen,
    loss_of,
    outlook,
    shortfall_text,
)
from plate_planner.supervision.phase import Reason

WEAK = replace(RIG, limits=replace(RIG.limits, accel=6.0))
TWO = Parts.make(("a", "b"), np.array([[0.1, 0.2], [-0.1, 0.05]]), np.array([[4e-3, 0], [0, 1e-3]]))


@pytest.mark.parametrize(
    ("rig", "drift", "force", "count", "inside", "outside"),
    [
        (RIG, [0.0, 6e-3], [0.0, 3e-3], 2, ["(0.0, 6.0) mm/s", "3.0 of", "rig file"], "fewer"),
        (RIG, [0.0, 6e-3], [0.0, 3e-3], FEW + 1, ["use fewer parts"], "rig file"),
        (WEAK, [0.0, 6e-3], [0.0, 3e-3], FEW + 1, ["shakes too little"], "fewer"),
        (RIG, [0.0, 1.9e-3], [0.0, 1e-3], 2, ["(0.0, 1.9) mm/s", "drift was (0.0, 1.0)"], "; "),
        (RIG, [0.0, 0.4e-3], [0.0, 0.2e-3], 2, ["0.2 of"], "; "),  # nothing is expected to move
        (RIG, None, None, 2, ["b at (-0.100, 0.050) m has 30.0 mm"], "drift"),
    ],
)
def test_the_part_with_the_largest_shortfall_is_reported_with_a_remedy(
    rig, drift, force, count, inside, outside
):
    request = LastRequest()
    if drift is not None:
        values = np.array([[1.0, 1.0], drift]), np.array([[9.0, 9.0], force])
        request = LastRequest(("a", "b"), values[0], 0.0, values[1])
    text = shortfall_text(request, rig, TWO, np.array([0.02, 0.03]), count)
    assert text.startswith("b at ")
    assert all(words in text for words in inside), text
    assert outside not in text
    max_force = 1e3 * rig.parts.mass_kg * rig.friction.mu * rig.friction.gravity
    assert drift is None or f" of {max_force:.1f} mN" in text
    assert shortfall_text(request, rig, NOBODY, np.empty(0), count) == ""


@pytest.mark.parametrize(
    ("rig", "count", "limit_s", "inside", "outside"),
    [
        (RIG, 20, 60.0, "", "x"),
        (WEAK, FEW, 60.0, "take longer", "time_limit_s"),
        (WEAK, FEW + 1, np.inf, "several times", "time_limit_s"),
        (WEAK, FEW + 1, 60.0, "time_limit_s, 60 s", "take longer"),
    ],
)
def test_a_weak_plate_is_reported_before_the_start(rig, count, limit_s, inside, outside):
    text = outlook(rig, count, limit_s)
    assert bool(text) == (rig is WEAK)
    assert inside in text
    assert outside not in text


@pytest.mark.parametrize(
    ("place", "there", "reason", "inside"),
    [
        (None, "unknown_1", Reason.PART_UNSEEN, "not detected"),
        ((0.1, 0.2), "unknown_1", Reason.PART_UNSEEN, "where unknown_1 is"),
        ((0.1, 0.2), "a", Reason.PART_LEFT, "fewer parts"),  # a named part covers no other one
        ((0.1, 0.0), "unknown_1", Reason.PART_UNSEEN, "150 mm from the edge"),
    ],
)
def test_a_lost_part_left_over_an_edge_or_is_no_longer_recognised(place, there, reason, inside):
    rig = replace(RIG, plate=replace(RIG.plate, width_m=0.4 + 2 * RIG.parts.radius_m))
    near = (0.1 + 2.9 * rig.parts.radius_m, 0.2)
    if place == (0.1, 0.0):
        rig = replace(RIG, plate=replace(RIG.plate, width_m=0.3))
    last = place and LastSeen(place, 12.5)
    failure = loss_of("c", last, 10.0, rig, FEW + 1, Parts.make((there,), np.array([near])))
    assert failure.reason is reason
    assert inside in failure.text
    assert place is None or ", 2.5 s after" in failure.text
