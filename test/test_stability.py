"""The stability maps: the measured border agrees with the theory."""

import numpy as np
import pytest

from harness import Cache
from maps import gamma, harmonics, separation, stick, suspension
from maps.grid import Grid, StabilityMap, crossing
from maps.stability import MAPS, border_sentence, grids
from plate_core import PlateCycle, load_rig
from plate_solver.library import Library


@pytest.fixture(scope="module")
def rig():
    return load_rig()


def test_crossing_is_where_a_line_passes_the_level():
    assert crossing([1, 2, 4], [0.0, 0.0, 1.0], 0.25) == pytest.approx(2.5)
    assert crossing([1, 2, 4], [1.0, 0.0, 0.0], 0.25) == pytest.approx(1.75)
    assert np.isnan(crossing([1, 2], [0.0, 0.1], 0.25))


@pytest.mark.parametrize("grid", [(12, 6), (24, 13), (48, 26)])
def test_two_parts_are_parted_down_to_the_spacing_of_centres(rig, grid):
    library = Library.around(rig.plate.half, *grid)
    predicted = separation.min_separation(rig, grid[0] * grid[1])
    distance = predicted * np.geomspace(0.5, 2, 7)
    force = [separation.guaranteed_force(rig, library, d, 8) for d in distance]
    observed = crossing(distance.tolist(), force, separation.LEVEL)
    assert observed == pytest.approx(predicted, rel=0.25)
    assert force[0] == pytest.approx(force[2] / np.sqrt(2.52), rel=0.3)  # falls with the distance


@pytest.mark.parametrize("number", [2, 3])
def test_harmonics_serve_as_many_parts_as_they_have_numbers(rig, number):
    max_parts = harmonics.max_parts(number)
    # For one part too many 100 are enough: they solve half of the requests for `max_parts` parts.
    cases = [(max_parts - 1, 250), (max_parts, 250), (max_parts + 1, 100)]
    fraction = [harmonics.solved_fraction(rig, m, number, 8, restarts) for m, restarts in cases]
    assert fraction[0] >= 0.6
    assert fraction[1] > 0
    assert fraction[2] == 0


def test_one_harmonic_moves_no_part(rig):
    assert harmonics.max_parts(1) == 0
    assert harmonics.solved_fraction(rig, 1, 1, 3, restarts=10) == 0


@pytest.mark.parametrize("force", [0.0, 0.1, 0.2])
def test_a_part_never_rests_above_the_predicted_shaking_ratio(rig, force):
    predicted = stick.min_gamma(force)
    below, above = (stick.resting_fraction(rig, force, s * predicted) for s in (0.9, 1.1))
    assert below > 2 * stick.LEVEL
    assert above == 0


def test_dry_friction_of_den_hartog():
    assert stick.min_gamma(0.0) == pytest.approx(np.sqrt(1 + np.pi**2 / 4))


def test_the_overtone_gives_the_requested_force():
    t = (np.arange(200_000) + 0.5) * 2 * np.pi / 200_000
    for force in (0.05, 0.2, 0.33):
        u = np.sin(t) + stick.overtone(force) * np.cos(2 * t)
        assert np.mean(np.sign(u)) == pytest.approx(force, abs=1e-4)


@pytest.mark.parametrize("parts", [1, 3])
def test_averages_hold_above_the_predicted_shaking_ratio(rig, parts):
    cases = gamma.make_motions(rig, parts, 4)
    predicted = gamma.min_gamma(rig, cases)
    ratio = predicted * np.array([0.25, 0.5, 1, 2])
    error = [
        float(np.median([gamma.simulate_force_error(rig, c.scaled(r), p) / f for c, p, f in cases]))
        for r in ratio
    ]
    assert 0.5 * predicted < crossing(ratio.tolist(), error, gamma.LEVEL) < 1.25 * predicted
    cycle, position, _ = cases[0]
    first = gamma.predict_force_error(rig, cycle, position) / 1000
    at_1000 = gamma.simulate_force_error(rig, cycle.scaled(1000), position)
    assert at_1000 == pytest.approx(first, rel=0.05)


@pytest.mark.parametrize(("method", "parts"), [("sinusoids", 2), ("rotations", 6)])
def test_a_plate_that_hangs_stiffer_than_predicted_does_nearly_as_commanded(rig, method, parts):
    cycle = suspension.make_motions(rig, method, parts, 1)[0]
    predicted = suspension.min_frequency(rig, [cycle])
    stiffness = predicted * np.geomspace(0.7, 1.4, 4)
    error = [suspension.realised_error(rig, cycle, hz) for hz in stiffness]
    assert error[0] > suspension.LEVEL > error[-1]
    assert crossing(stiffness.tolist(), error, suspension.LEVEL) == pytest.approx(
        predicted, rel=0.2
    )


def test_the_predicted_error_of_one_harmonic_is_its_transmissibility_less_one(rig):
    t = np.linspace(0, 0.1, 64, endpoint=False)
    pose = np.column_stack([1e-3 * np.sin(2 * np.pi * 10 * t), 0 * t, 0 * t])
    cycle = PlateCycle.from_samples(0.1, pose)
    r, z = 10 / 50, suspension.DAMPING
    assert suspension.predicted_error(rig, cycle, 50.0) == pytest.approx(
        abs(1 / (1 - r**2 + 2j * z * r) - 1), rel=1e-3
    )


def test_nearness_is_the_ratio_of_borders():
    one = MAPS["stick"]
    z = [[0.0], [2 * one.level], [2 * one.level]]
    grid = Grid("", [1.0], [1.0, 1.0001, 2.0], z, [0.5, 1.5], [1.25, 1.25])
    assert "differ by 25 %" in border_sentence(one, [grid])
    grid = Grid("", [1.0], [1.0, 2.0], [[0.0], [0.0]], [0.5, 1.5], [1.25, 1.25])
    assert border_sentence(one, [grid]).startswith("No border")


def test_a_map_is_kept_and_not_measured_again(tmp_path):
    calls = []

    def measured(quick):
        calls.append(quick)
        return [Grid("", [1.0], [2.0], [[3.0]])]

    labels = dict.fromkeys(("title", "x_label", "y_label", "z_label", "line_label"), "")
    one = StabilityMap("stick", level=0.0, measure=measured, bounds=(0, 1), **labels)
    for quick in (True, True, False, True):
        cache = Cache(tmp_path / "kept.jsonl", "code")
        assert grids(one, quick, cache) == [Grid("", [1.0], [2.0], [[3.0]])]
    assert calls == [True, False]
