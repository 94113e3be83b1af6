"""Footprints of part types: cut into convex pieces, with holes, and moved as bodies."""

from dataclasses import replace

import numpy as np
import pytest
from footprints import friction_gap

from plate_core import PlateCycle, config_path, load_rig
from plate_core.rig import PartType, load_part_types
from plate_sim.friction import bar, disc, quadrature
from plate_sim.friction.outline import convex_pieces, footprint_of
from plate_sim.world import WorldState, run_cycle

TYPES = load_part_types(config_path("parts.yaml"))
RIG = load_rig("shapes")


@pytest.mark.parametrize("name", sorted(TYPES))
def test_mass_and_moments_are_the_types(name):
    part = replace(TYPES[name], mass_kg=0.01)
    footprint = footprint_of(part)
    assert footprint.mass == 0.01
    assert footprint.gyration2 == pytest.approx(np.trace(part.spread_m2), rel=2e-3)
    assert footprint.reach == pytest.approx(part.reach_m, rel=1e-3)
    if len(footprint.points):
        np.testing.assert_allclose(footprint.weights @ footprint.points, 0, atol=1e-12)
        spread = (footprint.weights[:, None] * footprint.points).T @ footprint.points
        np.testing.assert_allclose(spread, part.spread_m2, rtol=1e-3, atol=1e-9)


def test_stars_are_cut_into_convex_pieces_of_the_same_area():
    rng = np.random.default_rng(0)
    for corners in range(5, 31, 5):
        turn = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.6, corners)) / corners
        radius = rng.uniform(0.004, 0.01, corners)
        star = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        pieces = convex_pieces(star)
        assert sum(map(quadrature.area, pieces)) == pytest.approx(quadrature.area(star))
        assert len(pieces) < corners - 2  # fewer than triangles


def test_a_bracket_is_two_pieces_and_a_hexagon_one():
    assert len(convex_pieces(TYPES["bracket"].polygon)) == 2
    assert len(convex_pieces(TYPES["nut"].polygon)) == 1


def test_a_ring_rubs_as_an_annulus_does():
    """Torque of a part that turns on the spot: mu m g times the mean distance of its points."""
    outer, inner = 0.0105, 0.0053
    ring = footprint_of(TYPES["washer"])
    torque = ring.friction(np.array([[0.0, 0.0, 100.0]]))[0, 2]
    mean = 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2)
    assert torque == pytest.approx(mean, rel=0.02)  # its hole is an octagon


def test_types_that_differ_by_name_share_a_footprint():
    one, other = (PartType(name, radius_m=0.008, symmetry=0) for name in ("black", "grey"))
    assert footprint_of(one) is footprint_of(other)


def test_a_square_of_a_type_is_the_square():
    square = footprint_of(TYPES["square"])
    assert friction_gap(square, bar(0.016, 0.016)) < 1e-9
    assert footprint_of(TYPES["coin_small"]).even
    assert disc(0.008).even


def test_parts_of_types_move_turn_and_keep_apart():
    """Two bars end to end on a plate that turns and shakes: they turn, and never overlap."""
    n, period = 128, 0.2
    t = 2 * np.pi * np.arange(n) / n
    pose = np.zeros((n, 3))
    pose[:, 0] = 0.006 * (np.sin(t) + 0.25 * np.sin(2 * t))
    pose[:, 2] = 0.05 * (np.sin(t + 1) + 0.25 * np.sin(2 * t))
    cycle = PlateCycle.from_samples(period, pose)
    position = np.array([[0.0, 0.02], [0.0245, 0.02]])
    state = WorldState.at_rest(("bar_1", "bar_2"), position)
    for _ in range(10):
        state = run_cycle(state, cycle, RIG)
        along = state.position[1] - state.position[0]
        assert np.hypot(*along) > 0.0118  # the width of one, at least
    assert np.all(np.abs(state.angle) > 0.02)
