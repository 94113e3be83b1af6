"""Finite parts that touch: against impulses worked out by hand, invariants, and seen overlaps."""

import re

import numpy as np
import pytest
from harmonic import waves

from plate_core import PlateCycle, PlateError
from plate_sim import Ground, simulate_bodies
from plate_sim.contacts import Contacts
from plate_sim.friction import bar, disc, polygon, union
from plate_sim.plate import LEVEL
from plate_sim.world import STEP
from plate_sim.world.bodies import Shapes, check_starts, run_plates

G = 9.81
L_SHAPE = union(
    [
        [[0, 0], [0.03, 0], [0.03, 0.01], [0, 0.01]],
        [[0, 0.01], [0.01, 0.01], [0.01, 0.03], [0, 0.03]],
    ]
)
TRIANGLE = polygon([[0, 0], [0.03, 0], [0, 0.02]])
HALF = np.array([0.3, 0.15])


def collide(parts, position, angle, speed, spin, contacts, time=0.1):
    """Let parts without friction on the plate meet; return their velocities and spins."""
    run = simulate_bodies(
        PlateCycle.rest(time),
        parts,
        position,
        angle,
        speed,
        spin,
        0,
        contacts=contacts,
        samples=500,
    )
    return run.velocity[-1], run.spin[-1]


def shaken(scale=1.0, period=0.1):
    sine, cosine = np.random.default_rng(3).normal(size=(2, 3, 3)) * [0.2, 0.2, 0.7] * scale
    return waves(period, sine, cosine)


def scattered(count, reach, rng):
    places = []
    while len(places) < count:
        position = rng.uniform(reach - HALF, HALF - reach)
        if all(np.hypot(*(position - other)) > 2 * reach for other in places):
            places.append(position)
    return np.array(places)


def run_on_plate(cycle, parts, position, angle, contacts, cycles=1, pull=0.0):
    ground = Ground(tilt=(np.arcsin(pull / G), 0))
    return simulate_bodies(
        cycle, parts, position, angle, np.zeros((len(position), 2)), 0, 0.25, G, cycles,
        round(cycle.period / STEP), contacts=contacts, ground=ground, half=HALF,
    )  # fmt: skip


@pytest.mark.parametrize("rub", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("bounce", [0.0, 0.6, 1.0])
def test_rims_of_two_discs_rub_and_turn_them(bounce, rub):
    # Impulses along n and t; the rims' speed yields by 1/m + R^2/I = 3/m for each disc.
    masses, radii = np.array([0.02, 0.05]), np.array([0.01, 0.016])
    n, t = np.array([0.8, 0.6]), np.array([-0.6, 0.8])
    speed, spin = np.array([[-0.5, -0.2], [0.1, 0.05]]), np.array([20.0, -5.0])
    touch = np.array([radii.sum() * n, [0, 0]])
    position = touch - speed * 0.0333
    parts = [disc(r, mass=m) for r, m in zip(radii, masses, strict=True)]
    v, w = collide(parts, position, 0, speed, spin, Contacts(bounce, rub))
    across, along = (speed[0] - speed[1]) @ n, (speed[0] - speed[1]) @ t - spin @ radii
    hit = -(1 + bounce) * across / (1 / masses).sum()
    drag = np.clip(-along / (3 / masses).sum(), -rub * hit, rub * hit)
    push = hit * n + drag * t
    assert across < 0
    assert v == pytest.approx(speed + np.outer([1, -1], push) / masses[:, None], rel=1e-9)
    assert w == pytest.approx(spin - drag * radii / (0.5 * masses * radii**2), rel=1e-9)


def test_a_disc_that_hits_the_end_of_a_bar_turns_it():
    # It hits at an arm b from the centre: 1/j = 1/m + 1/M + b^2/I
    length, arm = 0.06, 0.024
    parts = [bar(length, 0.01, mass=0.03), disc(0.008, mass=0.02)]
    position = [[0, 0], [arm, 0.03]]
    v, w = collide(parts, position, 0, [[0, 0], [0, -0.4]], [0, 0], Contacts(0.5))
    push = 1.5 * 0.4 / (1 / 0.02 + 1 / 0.03 + arm**2 / parts[0].inertia)
    assert v == pytest.approx(np.array([[0, -push / 0.03], [0, -0.4 + push / 0.02]]), abs=1e-12)
    assert w == pytest.approx([-push * arm / parts[0].inertia, 0], abs=1e-9)


@pytest.mark.parametrize("shape", [bar(0.03, 0.01), disc(0.01), L_SHAPE, TRIANGLE])
def test_walls_send_parts_back(shape):
    # A flat side that meets the wall squarely does not turn; restitution is that of speed.
    low = min(piece[:, 1].min() for piece in shape.outline)
    start = np.array([[0.0, -HALF[1] - low + 0.02]])
    run = simulate_bodies(
        PlateCycle.rest(0.1), shape, start, 0, [[0, -0.4]], 0, 0.0, samples=0,
        contacts=Contacts(0.5, 0.3, True), half=HALF,
    )  # fmt: skip
    assert run.velocity[-1] == pytest.approx(np.array([[0, 0.2]]), abs=1e-6)
    assert run.spin[-1] == pytest.approx([0], abs=1e-4)
    assert run.position[-1, 0] == pytest.approx([0, start[0, 1] - 0.02 + 0.2 * 0.05], abs=1e-6)


def test_a_bar_that_meets_another_flat_stops_without_turning():
    parts = [bar(0.04, 0.01, mass=0.02), bar(0.04, 0.02, mass=0.06)]
    v, w = collide(parts, [[0, 0.03], [0, 0]], 0, [[0, -0.4], [0, 0]], [0, 0], Contacts())
    assert v == pytest.approx(np.array([[0, -0.1], [0, -0.1]]), abs=1e-9)
    assert w == pytest.approx(0, abs=1e-6)


def test_squares_that_overlap_flat_are_parted_by_no_more_than_the_overlap():
    square = polygon([[-0.01, -0.01], [0.01, -0.01], [0.01, 0.01], [-0.01, 0.01]])
    position = np.array([[0, 0], [0.02 - 1e-4, 0]])
    run = simulate_bodies(
        PlateCycle.rest(0.02), [square] * 2, position, 0, np.zeros((2, 2)), 0, 0,
        contacts=Contacts(), samples=20,
    )  # fmt: skip
    overlap = 0.02 - np.diff(run.position[-1, :, 0])[0]
    assert 0 <= overlap <= 1e-5
    assert np.mean(run.position[-1], axis=0) == pytest.approx(np.mean(position, axis=0), abs=1e-12)
    assert not np.any(run.velocity)


def test_an_inner_corner_holds_a_disc():
    # A disc pushed into the notch of an L touches both arms, and carries it along.
    notch = np.array([0.01, 0.01]) - np.array([0.011, 0.011])
    start = notch + 0.008 + 0.01
    v, w = collide(
        [L_SHAPE, disc(0.008)], [[0, 0], start], 0, [[0, 0], [-0.2, -0.2]], [0, 0], Contacts()
    )
    assert v[0] == pytest.approx(v[1], abs=1e-3)
    assert w == pytest.approx(0, abs=0.2)


def depth(one, other, shared=None):
    """Maximum overlap of two convex polygons [m], by separating axes in numpy, without a side of
    the first one that is not part of its outline."""
    minimum = np.inf
    for a, b in ((one, other), (other, one)):
        side = np.roll(a, -1, axis=0) - a
        out = np.column_stack([side[:, 1], -side[:, 0]]) / np.linalg.norm(side, axis=1)[:, None]
        apart = (out @ b.T - np.sum(out * a, axis=1)[:, None]).min(axis=1)
        if a is one and shared is not None:
            apart[shared] = -np.inf
        minimum = min(minimum, -np.max(apart))
    return max(minimum, 0.0)


@pytest.mark.parametrize(
    ("shape", "count"), [(disc(0.008), 60), (bar(0.03, 0.01), 30), (L_SHAPE, 14)]
)
@pytest.mark.parametrize("pull", [0.0, 1.5])
def test_a_shaken_crowd_overlaps_by_20_micrometres_at_most(shape, count, pull):
    rng = np.random.default_rng(4)
    position = scattered(count, shape.reach, rng)
    angle = rng.uniform(0, 6, count)
    contacts = Contacts(0.3, 0.4, walls=True)
    run = run_on_plate(shaken(), shape, position, angle, contacts, 20, pull)
    assert run.on_plate.all()
    deepest, met = 0.0, 0
    for k in range(0, len(run.time), 97):
        sine, cosine = np.sin(run.angle[k]), np.cos(run.angle[k])
        turn = np.array([[cosine, -sine], [sine, cosine]]).transpose(2, 0, 1)
        seen = [[p @ turn[i].T + run.position[k, i] for p in shape.outline] for i in range(count)]
        for i in range(count):
            for j in range(i):
                apart = np.hypot(*(run.position[k, i] - run.position[k, j]))
                if apart > 2.05 * shape.reach:
                    continue
                met += 1
                if shape.radius:
                    deepest = max(deepest, 2 * shape.radius - apart)
                else:
                    deepest = max(deepest, *(depth(a, b) for a in seen[i] for b in seen[j]))
    assert met > 20
    assert deepest < 20e-6


def test_a_part_beyond_the_edge_leaves_the_plate():
    position = np.array([[0.295, 0.0], [0.27, 0.0], [0.0, 0.0]])
    speed = np.array([[0.5, 0], [0, 0], [0, 0]])
    states = check_starts([(position, np.zeros(3), speed, np.zeros(3))])
    here = np.array([[True, True, False]])
    (record,) = run_plates(
        [PlateCycle.rest(0.1)], [500], Shapes.of([disc(0.012)] * 3), states, here,
        np.full((1, 3), 0.01), [LEVEL.effect(G)], Contacts(), HALF, 1, 1, "abc",
    )  # fmt: skip
    assert here.tolist() == [[False, True, False]]
    assert record[-1, 0, :2] == pytest.approx([0.3, 0], abs=2e-4)
    assert record[-1, 0, 3:].tolist() == [0, 0, 0]
    assert record[-1, 1:, :2].tolist() == position[1:].tolist()
    assert record.shape == (501, 3, 6)
    assert np.array_equal(states[0], record[-1])


def test_the_order_of_bodies_does_not_change_the_motion_of_a_crowd():
    rng = np.random.default_rng(6)
    position, angle = scattered(10, L_SHAPE.reach, rng), rng.uniform(0, 6, 10)
    parts = [L_SHAPE, disc(0.02), bar(0.03, 0.01)] * 3 + [disc(0.01)]
    order = rng.permutation(10)
    contacts = Contacts(0.4, 0.3, walls=True)
    one = run_on_plate(shaken(), parts, position, angle, contacts, 3)
    other = run_on_plate(
        shaken(), [parts[i] for i in order], position[order], angle[order], contacts, 3
    )
    for name in ("position", "angle", "velocity", "spin"):
        assert getattr(other, name)[-1].tolist() == getattr(one, name)[-1, order].tolist()


@pytest.mark.parametrize(
    ("parts", "place", "message"),
    [
        (
            [disc(0.01), disc(0.01)],
            [[0, 0], [0.015, 0]],
            "parts a and b overlap by 5 mm, allowed: at most 1 mm",
        ),
        ([bar(0.03, 0.01), disc(0.01)], [[0, 0], [0, 0.01]], "parts a and b overlap by 5 mm"),
        ([L_SHAPE, L_SHAPE], [[0, 0], [0, 0.005]], "overlap by 10 mm"),
    ],
)
def test_parts_that_overlap_at_the_start_are_refused(parts, place, message):
    still = np.zeros(2), np.zeros((2, 2)), np.zeros(2)
    with pytest.raises(PlateError, match="overlap by") as error:
        run_plates(
            [PlateCycle.rest(0.1)] * 2, [500] * 2, Shapes.of(parts),
            check_starts([(np.array([[0, 0], [0.1, 0]]), *still), (np.array(place), *still)]),
            np.ones((2, 2), bool), np.ones((2, 2)), [LEVEL.effect(G)] * 2, Contacts(), HALF, 1, 0,
            ["a", "b"],
        )  # fmt: skip
    assert message in str(error.value)


def test_walls_need_a_plate():
    with pytest.raises(PlateError, match="walls"):
        simulate_bodies(
            PlateCycle.rest(0.1), disc(0.01), [[0, 0]], 0, [[0, 0]], 0, 0.2,
            contacts=Contacts(walls=True),
        )  # fmt: skip


def test_parts_that_do_not_touch_take_nothing_from_a_pair_that_does():
    # The first two squares meet; the others near each other, but stay 1.5 mm apart.
    square = polygon([[0.01, 0.01], [-0.01, 0.01], [-0.01, -0.01], [0.01, -0.01]])
    position = [[0, 0], [0.0201, 0], [0.1, 0], [0.122, 0]]
    run = simulate_bodies(
        PlateCycle.rest(0.005), square, position, 0, [[0.1, 0], [0, 0], [0, 0], [-0.1, 0]], 0, 0,
        contacts=Contacts(),
    )  # fmt: skip
    np.testing.assert_allclose(run.velocity[-1, :, 0], [0.05, 0.05, 0, -0.1], atol=1e-12)


def corners_at(shape, position, angle):
    sine, cosine = np.sin(angle), np.cos(angle)
    return shape.outline[0] @ np.array([[cosine, sine], [-sine, cosine]]) + position


def off(point, corners):
    """Distance (n,) [m] of points (n, 2) from the rim of a polygon."""
    after = np.roll(corners, -1, axis=0)
    side = after - corners
    fraction = np.sum((point[:, None] - corners) * side, axis=2) / np.sum(side**2, axis=1)
    nearest = corners + np.clip(fraction, 0, 1)[..., None] * side
    return np.min(np.linalg.norm(point[:, None] - nearest, axis=2), axis=1)


@pytest.mark.parametrize("seed", range(20))
def test_the_push_of_two_parts_acts_where_they_touch(seed):
    """Without rubbing its line of action follows from both parts' changes of speed and spin."""
    rng = np.random.default_rng(seed)
    shapes = [bar(0.04, 0.012, mass=0.02), TRIANGLE, bar(0.02, 0.02, mass=0.05)]
    parts = [shapes[k] for k in rng.integers(0, 3, 2)]
    angle = rng.choice([rng.uniform(0, 6), 0.0, np.pi / 2], 2)
    position = np.array([[0.0, 0.0], [0.06, rng.uniform(-0.012, 0.012)]])
    speed = np.array([[0.3, 0.0], [-0.3, rng.uniform(-0.1, 0.1)]])
    run = simulate_bodies(
        PlateCycle.rest(0.1), parts, position, angle, speed, 0, 0, contacts=Contacts(), samples=5000
    )
    moved = np.flatnonzero(np.any(run.velocity[:, 0] != speed[0], axis=1))
    if not len(moved):  # they pass each other
        assert np.all(run.spin == 0)
        return
    hit = moved[0]
    push = parts[0].mass * (run.velocity[hit, 0] - speed[0])
    assert -push == pytest.approx(parts[1].mass * (run.velocity[hit, 1] - speed[1]), abs=1e-9)
    across = np.array([push[1], -push[0]]) / np.hypot(*push)
    one, other = (corners_at(parts[k], run.position[hit, k], angle[k]) for k in (0, 1))
    touching = np.concatenate([one[off(one, other) < 1e-4], other[off(other, one) < 1e-4]])
    low, high = np.min(touching @ across) - 1e-4, np.max(touching @ across) + 1e-4
    for k, sign in ((0, 1), (1, -1)):
        arm = sign * parts[k].inertia * run.spin[hit, k] / np.hypot(*push)
        assert low <= run.position[hit, k] @ across + arm <= high


def reported_depth(parts, position, angle):
    """Depth [m] of the overlap for which two parts are refused, to three digits."""
    still = np.zeros((2, 2)), np.zeros(2)
    with pytest.raises(PlateError, match="overlap by") as error:
        run_plates(
            [PlateCycle.rest(0.1)], [500], Shapes.of(parts),
            check_starts([(position, angle, *still)]),
            np.ones((1, 2), bool), np.ones((1, 2)), [LEVEL.effect(G)], Contacts(), HALF, 1, 0,
            ["a", "b"],
        )  # fmt: skip
    return 1e-3 * float(re.search(r"overlap by (\S+) mm", str(error.value))[1])


@pytest.mark.parametrize("seed", range(6))
def test_an_overlap_is_as_deep_as_along_the_side_that_separates_most(seed):
    rng = np.random.default_rng(seed)
    parts = [bar(0.04, 0.012), TRIANGLE] if seed % 2 else [bar(0.02, 0.02), bar(0.04, 0.012)]
    angle, position = rng.uniform(0, 6, 2), np.zeros((2, 2))
    while True:
        position[1] = rng.uniform(-0.02, 0.02, 2)
        expected = depth(*(corners_at(parts[k], position[k], angle[k]) for k in (0, 1)))
        if expected > 2e-3:
            break
    assert reported_depth(parts, position, angle) == pytest.approx(expected, rel=6e-3)


def test_the_side_that_two_pieces_of_a_part_share_does_not_bound_an_overlap():
    """A slim bar across an L, whose arm it faces with a side beyond the ends of the arm's."""
    parts, angle = [L_SHAPE, bar(0.04, 0.004)], np.array([0.0, 0.7626])
    position = np.array([[0, 0], L_SHAPE.outline[0].min(axis=0) + [-0.00823, -0.00134]])
    arm, other = L_SHAPE.outline[1], corners_at(parts[1], position[1], angle[1])
    assert np.all(arm[:2, 1] == arm[:, 1].min())  # the shared side is its first
    expected = depth(arm, other, shared=0)
    assert expected > 1.3 * depth(arm, other)
    assert reported_depth(parts, position, angle) == pytest.approx(expected, rel=6e-3)
