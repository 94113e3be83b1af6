"""Motions that are evaluated after two plays, of which the first becomes the cycle."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import CycleRequest, Parts, PlateCycle, Targets
from plate_core.motion import is_rest, usage
from plate_sim import simulate
from plate_solver import Controller, Goal
from plate_solver.controller import LOOKAHEAD_S
from plate_solver.cycle_map import end_turning
from plate_solver.goal import PartRotations
from plate_solver.limits import Limits
from plate_solver.sinusoids import family_on_grid, solver
from plate_solver.sinusoids.basis import TAIL_CHECKS
from plate_solver.sinusoids.descent import descend
from plate_solver.sinusoids.solver import PLAYS, ROUGH, SinusoidCycles

PLATE = np.array([[1e-3, -5e-4, 0.01], [0.05, 0.1, -0.5], [5.0, -3.0, 20.0]])
"""A state of the plate that is well within the limits."""


def family_of(rig, plays=1, plate=PLATE):
    return family_on_grid(8, 0.1, Limits.of(rig), ROUGH, True, plate, plays)


def cycles(rig, **options):
    return SinusoidCycles(rig, harmonics=8, period=0.1, **options)


def each_play(rig, own, plays):
    """The families of single plays: each begins in the state in which the previous one ends."""
    families, state = [], PLATE
    for _ in range(plays):
        families.append(family_of(rig, plate=state))
        state = families[-1].cycle(own).state(-1)
    return families


def to_the_middle(rig, scene, seed, count=10):
    """Many parts with far to go, and a plate in motion."""
    _, position = scene(seed, count)
    way = np.where(position[:, :1] > 0, -0.1, 0.1) * [1.0, 0.0]
    return Goal(
        position, 0 * position, way, np.full((count, 2), 0.01), rig.friction.accel,
        multi_cycle=True, weight=0.03, edge=rig.plate.half - 0.008, coast=0.03, plate=PLATE,
        free_end=True,
    )  # fmt: skip


@pytest.mark.parametrize("plays", [2, 3])
def test_each_play_begins_in_the_state_in_which_the_previous_one_ends(rig, plays):
    whole = family_of(rig, plays)
    own = 0.3 * whole.random(np.random.default_rng(1))
    single = each_play(rig, own, plays)
    for k in (0, 1):
        samples = np.vstack([family.samples(own)[k] for family in single])
        np.testing.assert_allclose(whole.samples(own)[k], samples, atol=1e-12)
    assert whole.samples(own)[2].sum() == pytest.approx(0.1 * plays)
    coefficients = whole.coefficients(own)

    def checked(family):
        ways = zip(family.basis.checks, family.basis.settling_checks, strict=True)
        return [look @ coefficients + settling @ family.plate for look, settling in ways]

    for k, found in enumerate(checked(whole)):
        inner = [checked(family)[k][:-TAIL_CHECKS] for family in single]
        tail = checked(single[-1])[k][-TAIL_CHECKS:]
        np.testing.assert_allclose(found, np.vstack([*inner, tail]), atol=1e-9)


def test_the_finished_cycle_is_the_first_play(rig):
    twice, once = family_of(rig, 2), family_of(rig)
    own = twice.random(np.random.default_rng(2))
    cycle, first = twice.cycle(own), once.cycle(own)
    assert cycle.period == 0.1
    np.testing.assert_array_equal(cycle.knot_pose, first.knot_pose)
    np.testing.assert_array_equal(cycle.coefficients, first.coefficients)
    np.testing.assert_array_equal(cycle.tail.state(0), cycle.state(-1))
    assert is_rest(cycle.tail.state(-1))


def test_the_prediction_for_two_plays_is_the_map_applied_twice(rig, scene):
    rng, position = scene(3, 5)
    rotations = PartRotations(
        rng.normal(size=5), np.tile([3e-5, 1e-5, 2e-5], (5, 1)), np.zeros(5), np.zeros(5),
        np.ones(5),
    )  # fmt: skip
    velocity, still = 0.05 * rng.normal(size=(5, 2)), np.zeros((5, 2))
    goal = Goal(position, velocity, still, still, rig.friction.accel, rotations, plate=PLATE)
    twice = family_of(rig, 2)
    own = 0.8 * twice.random(rng)
    state, angle = (position, velocity, np.zeros(5), rotations.spin), np.zeros(5)
    for play in each_play(rig, own, 2):
        place, speed, turn, spin = end_turning(
            *state[:2], state[3], rotations.spread, *play.samples(own), goal.friction_accel
        )
        state, angle = (place, speed, turn, spin), angle + turn
    end = goal.end(*twice.samples(own))
    np.testing.assert_allclose(end, np.append(place.T.ravel(), angle), atol=1e-9)
    assert np.max(np.abs(place - position)) > 1e-3


def test_parts_end_where_predicted_after_one_play_and_after_two(rig, scene):
    """The simulator integrates exactly, the search by steps."""
    goal = to_the_middle(rig, scene, 4)
    steering = cycles(rig, iterations=16, restarts=4)
    cycle = steering.steer(goal, 1e-5, 0.0).cycle
    assert cycle.period == 0.1
    assert usage(rig, cycle).worst <= 1
    np.testing.assert_array_equal(cycle.state(0), PLATE)
    twice = family_of(rig, PLAYS)
    own = twice.nearest(steering._last_twist[8, 0.1, ROUGH, True])
    position, velocity, begin = goal.position, goal.velocity, PLATE
    for _ in range(PLAYS):
        play = family_of(rig, plate=begin).cycle(own)
        run = simulate(play, position, velocity, rig.friction.mu, rig.friction.gravity)
        position, velocity, begin = run.position[-1], run.velocity[-1], play.state(-1)
    predicted = goal.end(*twice.samples(own)).reshape(2, -1).T
    np.testing.assert_allclose(position + goal.coast * velocity, predicted, atol=1e-3)


def left_after(rig, goal, cycle, plays):
    """Cost of where the parts are once the motion of a cycle was played `plays` times."""
    once = family_of(rig)
    position = goal.position
    velocity = goal.velocity
    state = PLATE
    times = (np.arange(once.basis.steps) + 0.5) * once.basis.dt
    own = once.nearest(cycle.twist(times))
    for _ in range(plays):
        play = family_of(rig, plate=state).cycle(own)
        run = simulate(play, position, velocity, rig.friction.mu, rig.friction.gravity)
        position, velocity, state = run.position[-1], run.velocity[-1], play.state(-1)
    error, _ = goal.error((position + goal.coast * velocity).T.ravel())
    return error @ error


def test_less_is_left_after_two_plays_and_more_after_one(rig, scene, monkeypatch):
    left = {}
    for plays in (1, 2):
        monkeypatch.setattr(solver, "PLAYS", plays)
        for seed in range(6):
            goal = to_the_middle(rig, scene, seed)
            steering = cycles(rig, iterations=16, restarts=20, seed=seed)
            cycle = steering.steer(goal, 1e-5, 0.0).cycle
            for after in (1, 2):
                left.setdefault((plays, after), []).append(left_after(rig, goal, cycle, after))
    mean = {key: np.mean(values) for key, values in left.items()}
    assert mean[2, 2] < mean[1, 2], mean
    assert mean[1, 1] < mean[2, 1], mean


@pytest.mark.parametrize(("free_end", "descents"), [(True, 1 + 3 + 5), (False, 1 + 3 + 9)])
def test_two_plays_take_half_the_starts(rig, scene, monkeypatch, free_end, descents):
    """With the first one, three more at random, and then three corrections within the limits."""
    given = []

    def counted(problem, *how):
        given.append(problem)
        return descend(problem, *how)

    monkeypatch.setattr(solver, "descend", counted)
    goal = replace(to_the_middle(rig, scene, 0), free_end=free_end)
    cycle = cycles(rig, iterations=1, restarts=9).steer(goal, 0.0, 0.0).cycle
    assert len(given) == descents + 3
    assert {problem.motions.basis.period for problem in given} == {0.2 if free_end else 0.1}
    assert cycle.period == 0.1
    assert is_rest(cycle.state(-1)) != free_end


@pytest.mark.parametrize("out", [True, False])
def test_a_motion_is_refused_if_a_part_is_off_the_plate_between_two_plays(rig, monkeypatch, out):
    """However good the end of the second play is: the next result replaces that play."""
    edge = rig.plate.half[0] - 0.5 * np.sqrt(rig.part_type("black").area_m2 / np.pi)
    position, velocity = np.array([[edge - 1e-3, 0.0]]), np.array([[0.03, 0.0]])
    still, rng = np.zeros((3, 3)), np.random.default_rng(0)
    goal = Goal(
        position, velocity, 0 * position, 0 * position, rig.friction.accel, coast=LOOKAHEAD_S
    )
    once, twice = (family_of(rig, plays, still) for plays in (1, 2))

    def ends(own):
        return [goal.end(*family.samples(own))[0] for family in (once, twice)]

    drawn = (0.9 * twice.random(rng) for _ in range(1000))
    found = ((own, *ends(own)) for own in drawn)
    own, first, _ = next(
        one for one in found if one[2] < edge and (one[1] > edge + 1e-4 if out else one[1] < edge)
    )
    monkeypatch.setattr(solver, "descend", lambda problem, *_: descend(problem, own, 0.0, 0))
    aim = np.array([[-0.1, 0.0]])
    request = CycleRequest.make(
        Parts.make(("black_0",), position), start=np.hstack([position, velocity]), plate=still,
        targets=Targets(aim, aim, np.ones((1, 2))),
    )  # fmt: skip
    result = Controller(rig).solve(request, PlateCycle.rest(0.1))
    assert is_rest(result.cycle.state(-1)) == out
    assert ("would leave the plate" in result.message) == out
    if not out:
        assert result.solution.predicted[0] == pytest.approx(first, abs=1e-4)
