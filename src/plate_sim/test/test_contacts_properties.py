"""Properties of any crowd of discs: random crowds, shrunk to the smallest that fails."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from plate_core import PlateCycle, load_rig
from plate_sim import Contacts, Ground, simulate_bodies
from plate_sim.friction import disc
from plate_sim.plate import LEVEL

RIG = load_rig()
RADIUS, HALF = RIG.parts.radius_m, RIG.plate.half
WIDE = np.array([5.0, 5.0])
"""Half sides of a plate that no disc leaves [m]."""

OVERLAP = 1e-4
"""Deepest overlap [m] allowed in a crowd at any step: 0.6 % of a disc."""

some = settings(max_examples=25, deadline=None, derandomize=True, database=None)


@st.composite
def crowds(draw, max_parts=24):
    """Places (M, 2) [m] of discs apart from each other, and velocities [m/s]: rest to 1 m/s."""
    columns, lines = draw(st.integers(1, 6)), draw(st.integers(1, max_parts // 6))
    spacing = 2 * RADIUS + draw(st.sampled_from([1e-9, 1e-4, 4e-3]))
    seed, speed = draw(st.integers(0, 2**32 - 1)), draw(st.sampled_from([0.0, 0.05, 0.5, 1.0]))
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(columns), np.arange(lines))
    position = (
        np.stack([x - columns / 2 + 0.5, y - lines / 2 + 0.5], axis=-1).reshape(-1, 2) * spacing
    )
    shift = 0.4 * (spacing - 2 * RADIUS) * rng.uniform(-1, 1, position.shape)
    return position + shift, speed * rng.normal(size=position.shape)


contacts = st.builds(Contacts, st.floats(0, 1), st.sampled_from([0.0, 0.3, 5.0]), st.booleans())
steps = st.sampled_from([50, 61, 400])


@st.composite
def shakes(draw):
    """Motions of the plate, up to far beyond friction, that turn too."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = draw(st.sampled_from([0.0, 1e-4, 1e-3, 4e-3]))
    return PlateCycle.from_samples(0.06, size * rng.normal(size=(10, 3)) * [1, 1, 4])


def run_discs(cycle, position, velocity, mu, half, contacts, steps, cycles=1, ground=LEVEL):
    """The motion of discs at every step."""
    return simulate_bodies(
        cycle, disc(RADIUS), position, 0, velocity, 0, mu, 9.81, cycles, steps, contacts=contacts,
        ground=ground, half=half, step=cycle.period / steps,
    )  # fmt: skip


def deepest(path):
    """Deepest overlap [m] of any two discs at any step of a path (k, M, 2)."""
    i, j = np.triu_indices(path.shape[1], 1)
    if len(i) == 0:
        return 0.0
    return 2 * RADIUS - np.min(np.linalg.norm(path[:, i] - path[:, j], axis=2))


@some
@given(crowds(), contacts, steps, shakes(), st.floats(0, 2), st.floats(1, 2), st.floats(-0.2, 0.2))
def test_any_run_is_finite_and_discs_stay_apart(crowd, contact, n, cycle, mu, static, tilt):
    run = run_discs(cycle, *crowd, mu, HALF, contact, n, 2, Ground(static, (tilt, 0)))
    assert np.isfinite(run.position).all()
    assert np.isfinite(run.velocity).all()
    assert deepest(run.position[:, run.on_plate]) < OVERLAP
    assert run.on_plate.all() or not contact.walls


@some
@given(crowds(), contacts, steps)
def test_contacts_create_no_energy(crowd, contact, n):
    run = run_discs(PlateCycle.rest(0.1), *crowd, 0.0, HALF, contact, n, 2)
    energy = np.sum(run.velocity**2, axis=(1, 2)) + RADIUS**2 / 2 * np.sum(run.spin**2, axis=1)
    if not contact.walls:  # who leaves the plate takes its energy along
        assert energy[-1] <= energy[0] * (1 + 1e-12)
    assert np.all(np.diff(energy) <= 1e-13 * energy[0])


@some
@given(crowds(), st.floats(0, 1), st.sampled_from([0.0, 0.3, 5.0]), steps)
def test_contacts_between_discs_keep_momentum(crowd, restitution, friction, n):
    run = run_discs(PlateCycle.rest(0.1), *crowd, 0.0, WIDE, Contacts(restitution, friction), n)
    assert run.on_plate.all()
    momentum = run.velocity.sum(axis=1)
    assert np.abs(momentum - momentum[0]).max() < 1e-12
    # So the common centre moves on evenly.
    centre = run.position.mean(axis=1)
    even = centre[0] + np.outer(run.time, momentum[0]) / len(run.on_plate)
    assert np.abs(centre - even).max() < 1e-12


@some
@given(crowds(), contacts, steps, shakes(), st.randoms(use_true_random=False))
def test_the_order_of_parts_does_not_matter(crowd, contact, n, cycle, random):
    order = list(range(len(crowd[0])))
    random.shuffle(order)
    run = run_discs(cycle, *crowd, 0.3, HALF, contact, n)
    other = run_discs(cycle, *(array[order] for array in crowd), 0.3, HALF, contact, n)
    assert np.array_equal(other.position, run.position[:, order])
    assert np.array_equal(other.velocity, run.velocity[:, order])
    assert np.array_equal(other.on_plate, run.on_plate[order])


def turned(angle, mirror):
    """Rotation by an angle [rad], after a mirror at the x axis: (2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]]) @ np.diag([1, -1 if mirror else 1])


@some
@given(
    st.floats(-0.012, 0.012), st.floats(0.05, 0.8), st.floats(0, 1), shakes(),
    st.floats(-np.pi, np.pi), st.booleans(),
)  # fmt: skip
def test_turned_and_mirrored_frames_give_the_same(offset, speed, restitution, cycle, angle, mirror):
    # Three discs, of which two meet: a chain of hits would amplify rounding without bound.
    position = np.array([[-0.02, offset], [0.02, 0.0], [0.0, 0.1]])
    velocity = np.array([[speed, 0.0], [-0.1, 0.0], [0.0, 0.2]])
    frame = turned(angle, mirror)
    pose = cycle.knot_pose[:-1].copy()
    pose[:, :2] = pose[:, :2] @ frame.T
    pose[:, 2] *= -1 if mirror else 1
    other_cycle = PlateCycle.from_samples(cycle.period, pose)
    contact = Contacts(restitution, 0.2)
    run = run_discs(cycle, position, velocity, 0.3, WIDE, contact, 200)
    turned_start = position @ frame.T, velocity @ frame.T
    other = run_discs(other_cycle, *turned_start, 0.3, WIDE, contact, 200)
    assert np.abs(other.position - run.position @ frame.T).max() < 1e-9
