"""Method B: theory of the number of harmonics, warm starts, refusals."""

import numpy as np
import pytest

from plate_core import PlateError
from plate_solver import SinusoidSolver, Status, average_force

PLACE = np.array([[0.12, -0.06]])


@pytest.mark.parametrize("number", [2, 3, 4])
def test_greatest_force_grows_with_the_harmonics(rig, number):
    # DESIGN 5: a part at rest gets at most (N - 1)/(N + 1) of mu m g, and a little less is found.
    bound = (number - 1) / (number + 1)
    solver = SinusoidSolver(rig, harmonics=number)
    for angle in (0.3, 2.0):
        way = np.array([[np.cos(angle), np.sin(angle)]])
        solver.reset()
        assert solver.solve(PLACE, 0.93 * bound * way).success
        beyond = solver.solve(PLACE, 1.05 * bound * way)
        assert not beyond.success
        assert np.sum(average_force(beyond.cycle, PLACE) * way) < bound + 2e-3


def test_one_harmonic_never_succeeds(rig):
    solution = SinusoidSolver(rig, harmonics=1, restarts=2).solve(PLACE, [[0.01, 0.0]])
    assert not solution.success
    np.testing.assert_allclose(solution.residual, [[0.01, 0.0]], atol=1e-6)


@pytest.mark.parametrize(("number", "min_met", "max_met"), [(2, 0.0, 0.2), (4, 0.4, 1.0)])
def test_more_constraints_than_rank_are_not_met(rig, scene, number, min_met, max_met):
    # 6 parts are 12 numbers; N = 2 has rank 10, N = 4 rank 22. Small forces, so reach is no reason.
    solver = SinusoidSolver(rig, harmonics=number, restarts=4)
    met = 0
    for seed in range(10):
        solver.reset()
        rng, position = scene(seed, 6)
        met += solver.solve(position, rng.uniform(-0.03, 0.03, (6, 2))).success
    assert min_met <= met / 10 <= max_met


def test_at_rest_cycles_start_at_rest(rig, scene):
    rng, position = scene(0, 2)
    force = rng.uniform(-0.1, 0.1, (2, 2))
    free = SinusoidSolver(rig).solve(position, force)
    rest = SinusoidSolver(rig, harmonics=3, at_rest=True).solve(position, force)
    assert free.success
    assert rest.success
    assert rest.cycle.starts_at_rest
    assert not free.cycle.starts_at_rest


def test_options_are_followed(rig):
    solution = SinusoidSolver(rig, harmonics=3, period=0.08).solve(PLACE, [[0.1, 0.0]])
    assert solution.cycle.period == pytest.approx(0.08)
    t = (np.arange(600) + 0.5) / 600 * 0.08
    spectrum = np.abs(np.fft.rfft(solution.cycle.twist(t), axis=0)).max(axis=1)
    assert np.max(spectrum[4:]) < 1e-3 * np.max(spectrum)
    assert spectrum[3] > 1e-3 * np.max(spectrum)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"harmonics": 65}, "harmonics is 65, allowed: 0 to 64"),
        ({"harmonics": 1, "at_rest": True}, "harmonics is 1; at_rest requires"),
    ],
)
def test_wrong_options_are_named(rig, options, message):
    with pytest.raises(PlateError, match=message):
        SinusoidSolver(rig, **options)


def test_last_solution_is_a_good_start(rig, scene):
    # Requests that creep: with memory they need fewer steps than from the table each time.
    warm, cold = SinusoidSolver(rig), SinusoidSolver(rig)
    steps, met = {"warm": 0, "cold": 0}, {"warm": 0, "cold": 0}
    for seed in range(6):
        rng, position = scene(seed, 2)
        force, creep = rng.uniform(-0.1, 0.1, (2, 2)), rng.normal(size=(2, 2))
        warm.reset()
        for k in range(12):
            cold.reset()
            for name, solver in (("warm", warm), ("cold", cold)):
                solution = solver.solve(position, force + 0.002 * k * creep)
                steps[name] += solution.iterations
                met[name] += solution.success
    assert met["warm"] >= 66
    # Measured 0.66: the last steps, on fine samples, are the same for both.
    assert steps["warm"] < 0.8 * steps["cold"]


def test_proven_infeasibility_is_reported(rig):
    solver = SinusoidSolver(rig, harmonics=2, restarts=2)
    inside = solver.solve(PLACE, [[0.3, 0.0]])
    beyond = solver.solve(PLACE, [[0.4, 0.0]])
    assert (inside.status, inside.success) == (Status.SOLVED, True)
    assert (beyond.status, beyond.success) == (Status.UNREACHABLE, False)
    assert np.max(np.abs(average_force(inside.cycle, PLACE) - [[0.3, 0.0]])) < 1.1e-4


def test_more_tries_never_make_a_wrong_success(rig, scene):
    solver = SinusoidSolver(rig, harmonics=2, restarts=5)
    solved = 0
    for seed in range(30):
        solver.reset()
        rng, position = scene(seed, 3)
        force = rng.uniform(-0.12, 0.12, (3, 2))
        result = solver.solve(position, force)
        miss = np.max(np.abs(average_force(result.cycle, position) - force))
        assert result.success == (miss < 1.05e-4)
        solved += result.success
    assert solved >= 15
