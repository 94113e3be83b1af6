"""The ladder of models: the cheap against the dear on both sides of each border."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_sim import Contacts, WorldState, run_cycle
from plate_sim.ground import LEVEL, Ground
from plate_sim.ladder import TOLERANCE
from plate_sim.models import BODIES, DISCS, POINTS

RIG = load_rig()
RADIUS = RIG.parts.radius_m
EPSILON = 1e-6
FINE = 1e-4
"""Step [s] of the dear model: twice as fine as usual, to judge by."""


def state_of(position, **changes):
    ids = tuple(f"black_{i + 1}" for i in range(len(position)))
    return replace(WorldState.at_rest(ids, position), **changes)


def shaking(rng, turn):
    """A cycle of up to 6 harmonics, a few mm along x and y, `turn` times that in rad."""
    t, h = np.arange(48) / 48, np.arange(1, rng.integers(2, 8))[:, None, None]
    phase = rng.uniform(0, 2 * np.pi, (len(h), 3, 1))
    pose = np.sum(rng.normal(size=phase.shape) / h**1.5 * np.sin(2 * np.pi * h * t + phase), 0).T
    return PlateCycle.from_samples(rng.uniform(0.05, 0.2), pose * [3e-3, 3e-3, 3e-3 * turn])


def scattered(rng, count=6, apart=2.2, size=1.0):
    """Parts in motion, each turning by itself, no two centres within `apart` radii."""
    places = []
    while len(places) < count:
        place = rng.uniform(-size, size, 2) * [0.25, 0.12]
        if all(np.hypot(*(place - other)) > apart * RADIUS for other in places):
            places.append(place)
    spin = rng.normal(size=count) * 10 ** rng.uniform(-2, 0.5)
    return state_of(np.array(places), velocity=rng.normal(size=(count, 2)) * 0.05, spin=spin)


def ground_of(rng):
    return Ground(float(rng.choice([1.0, 1.3])), tuple(rng.choice([0.0, 0.02], 2)))


def off(one, other):
    """Distances [m] of the parts that are on the plate in both."""
    there = one.on_plate & other.on_plate
    return np.linalg.norm(one.position - other.position, axis=1)[there]


# Points or bodies: how much friction all over the footprint does


def border(run):
    """A turn at which bodies are chosen, after one a little less where not; None if none is."""
    low, high = 0.0, 20.0
    if run(low).choice.model == BODIES or run(high).choice.model != BODIES:
        return None
    while high - low > EPSILON * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if run(middle).choice.model == BODIES else (middle, high)
    return low, high


def test_where_parts_begin_to_turn_the_cheap_model_is_still_within_tolerance():
    found, spread = 0, []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        start, ground = scattered(rng, apart=6), ground_of(rng)
        start = replace(start, spin=np.zeros(6))

        def run(turn, start=start, ground=ground, seed=seed, **options):
            cycle = shaking(np.random.default_rng(seed), turn)
            return run_cycle(start, cycle, RIG, ground=ground, **options)

        sides = border(run)
        if sides is None:
            continue
        found += 1
        low, high = sides
        cheap, dear, beyond = run(low), run(low, model=BODIES, step=FINE), run(high)
        spread.append(off(cheap, dear).max())
        assert spread[-1] < TOLERANCE
        assert cheap.spin == pytest.approx(dear.spin, abs=0.05)
        assert cheap.angle == pytest.approx(dear.angle, abs=5e-3)
        assert np.array_equal(beyond.position, run(high, model=BODIES).position)
        # The choice does not tear the motion: both sides agree as well as the tolerance says.
        assert off(cheap, beyond).max() < TOLERANCE
    assert found >= 15
    # The bound is one, and not far above the truth.
    assert max(spread) > TOLERANCE / 3
    assert np.median(spread) > TOLERANCE / 10


def test_many_random_scenes_stay_within_the_tolerance():
    rng = np.random.default_rng(100)
    count = {POINTS: 0, DISCS: 0, BODIES: 0}
    unlike = []
    for _ in range(200):
        cycle, ground = shaking(rng, 10 ** rng.uniform(-1, 1)), ground_of(rng)
        start = scattered(rng, size=rng.choice([0.35, 1]))
        auto = run_cycle(start, cycle, RIG, ground=ground)
        dear = run_cycle(start, cycle, RIG, ground=ground, model=BODIES, step=FINE)
        count[auto.choice.model] += 1
        if auto.choice.model == BODIES:
            cheap = run_cycle(start, cycle, RIG, ground=ground, model=DISCS)
            unlike.append(off(cheap, dear).max())
        else:
            assert np.array_equal(auto.on_plate, dear.on_plate)
            assert off(auto, dear).max() < TOLERANCE
    assert min(count.values()) >= 10, count
    # Nor are bodies chosen where they are of no use: the bound is not far above the truth.
    assert np.median(unlike) > TOLERANCE / 5


def test_a_part_near_a_centre_of_rotation_is_a_body():
    t = np.arange(64) / 64
    turn = 0.05 * (np.sin(2 * np.pi * t) + 0.3 * np.sin(4 * np.pi * t))
    cycle = PlateCycle.from_samples(0.1, turn[:, None] * [0, 0, 1])
    state = run_cycle(state_of([[0.005, 0.0]]), cycle, RIG)
    assert state.choice.model == BODIES
    assert "black_1 may end" in state.choice.reason
    assert "allowed 0.05 mm" in state.choice.reason
    still = run_cycle(state_of([[0.0, 0.0]]), PlateCycle.rest(0.1), RIG)
    assert still.choice.model == POINTS


# Points or discs: whether parts can touch


def test_parts_that_come_as_close_as_the_models_may_err_are_discs():
    """Two parts slide to rest towards each other; the gap that is left decides."""
    speed, brake = 0.2, RIG.friction.accel
    travel = speed**2 / (2 * brake)
    velocity = np.array([[speed, 0], [-speed, 0]])

    def run(gap, **options):
        apart = 2 * RADIUS + 2 * travel + gap
        start = state_of([[-apart / 2, 0.01], [apart / 2, 0.01]], velocity=velocity)
        return run_cycle(start, PlateCycle.rest(0.2), RIG, **options)

    edge = 2 * TOLERANCE
    ends = run(edge, model=POINTS)
    # How far the integrator's own stop is off that on paper
    edge -= (ends.position[1, 0] - ends.position[0, 0] - 2 * RADIUS) - edge
    above, below = run(edge + 1e-7), run(edge - 1e-7)
    assert (above.choice.model, below.choice.model) == (POINTS, DISCS)
    assert above.choice.reason.startswith("black_1 and black_2 stay 0.1 mm apart")
    assert below.choice.reason.startswith("black_1 and black_2 may touch")
    for gap, state in ((edge + 1e-7, above), (edge - 1e-7, below)):
        assert np.array_equal(state.position, run(gap, model=DISCS).position)
    assert off(above, run(edge + 1e-7, model=BODIES)).max() < 1e-6
    touching = run(-1e-3)
    assert touching.choice.model == DISCS
    assert off(touching, run(-1e-3, model=POINTS)).max() > 4e-4


def test_points_are_discs_to_the_last_bit_wherever_they_are_chosen():
    rng, seen = np.random.default_rng(3), {POINTS: 0, DISCS: 0}
    for _ in range(40):
        start, cycle = scattered(rng, 6, apart=2.02, size=0.5), shaking(rng, 0.0)
        state = run_cycle(replace(start, spin=np.zeros(6)), cycle, RIG)
        discs = run_cycle(start, cycle, RIG, model=DISCS)
        seen[state.choice.model] += 1
        assert np.array_equal(state.position, discs.position)
        assert np.array_equal(state.velocity, discs.velocity)
    assert min(seen.values()) >= 5, seen


def test_rims_that_rub_make_bodies_where_parts_may_touch():
    start = state_of([[0, 0], [0.02, 0.004]], velocity=np.array([[0.4, 0], [0, 0]]))
    for contacts, model in ((Contacts(), DISCS), (Contacts(friction=0.3), BODIES)):
        state = run_cycle(start, PlateCycle.rest(0.1), RIG, contacts=contacts)
        assert state.choice.model == model
        assert np.any(np.abs(state.spin) + np.abs(state.angle) > 1e-3) == (model == BODIES)
    apart = replace(start, position=start.position * [20, 1] - [0.2, 0])
    rubbing = Contacts(friction=0.3)
    state = run_cycle(apart, PlateCycle.rest(0.1), RIG, contacts=rubbing)
    assert state.choice.model == POINTS


@pytest.mark.parametrize("side", [-1, 1])
def test_walls_that_may_be_touched_make_discs(side):
    edge = RIG.plate.half[0] - RADIUS - 2 * TOLERANCE
    walls = Contacts(walls=True)
    start = state_of([[edge + side * 1e-7, 0]])
    state = run_cycle(start, PlateCycle.rest(0.05), RIG, contacts=walls)
    assert state.choice.model == (POINTS if side < 0 else DISCS)
    open_plate = run_cycle(start, PlateCycle.rest(0.05), RIG)
    assert open_plate.choice.model == POINTS


# What is said, and what is refused


def test_a_choice_is_made_anew_for_each_cycle():
    start = state_of([[0, 0]], velocity=np.array([[0.05, 0]]), spin=np.array([20.0]))
    first = run_cycle(start, PlateCycle.rest(0.2), RIG)
    assert first.choice.model == BODIES
    assert 0 < first.angle[0] < 20 * 0.2
    assert first.spin[0] == 0
    assert run_cycle(start, PlateCycle.rest(0.2), RIG, cycles=2).choice.model == POINTS


def test_a_model_asked_for_is_used_and_says_so():
    start = state_of([[0, 0]])
    for model in (POINTS, DISCS, BODIES):
        choice = run_cycle(start, PlateCycle.rest(0.1), RIG, model=model, ground=LEVEL).choice
        assert (choice.model, choice.reason) == (model, "as asked for")
    with pytest.raises(PlateError, match="model is 'rods', allowed: auto, points, discs, bodies"):
        run_cycle(start, PlateCycle.rest(0.1), RIG, model="rods")


def test_an_empty_plate_needs_points():
    state = run_cycle(state_of(np.zeros((0, 2))), PlateCycle.rest(0.1), RIG)
    assert state.choice.model == POINTS
    gone = state_of([[0.4, 0]], on_plate=np.array([False]))
    assert run_cycle(gone, shaking(np.random.default_rng(0), 5), RIG).choice.model == POINTS
