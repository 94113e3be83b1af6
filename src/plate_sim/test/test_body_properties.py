"""Properties of any finite parts: energy, momentum, order of parts, rotated and mirrored scenes."""

import harmonic
import numpy as np
import pytest
from footprints import on_feet
from hypothesis import example, given, settings
from hypothesis import strategies as st

from plate_core import PlateCycle
from plate_sim import Ground, simulate_bodies
from plate_sim.contacts import Contacts
from plate_sim.friction import Footprint, bar, disc, polygon, union

G = 9.81
L_CORNERS = [
    [[0, 0], [0.03, 0], [0.03, 0.01], [0, 0.01]],
    [[0, 0.01], [0.01, 0.01], [0.01, 0.03], [0, 0.03]],
]
TRIANGLE = [[0, 0], [0.03, 0], [0, 0.02]]
FEET = [[0.01, 0], [-0.005, 0.008], [-0.005, -0.008]]
SHAPES = [
    disc(0.01), disc(0.018, mass=0.09), bar(0.04, 0.01), polygon(TRIANGLE, mass=0.01),
    union(L_CORNERS, points=24), on_feet(disc(0.012), FEET),
]  # fmt: skip
REST = PlateCycle.rest(0.05)

few = settings(max_examples=100, deadline=None, derandomize=True)
numbers = st.floats(-1, 1)
scenes = st.tuples(
    st.lists(st.sampled_from(range(len(SHAPES))), min_size=2, max_size=4),
    st.integers(0, 10**6),
    st.floats(0, 1),
    st.floats(0, 2),
)
"""Which shapes, a seed of their states, restitution and friction of contacts."""


def state(kinds, seed, pace=1.0):
    """Parts on a ring that fly to about its centre, and so meet."""
    rng = np.random.default_rng(seed)
    count = len(kinds)
    turn = 2 * np.pi * (np.arange(count) + 0.3 * rng.uniform(size=count)) / count
    out = np.column_stack([np.cos(turn), np.sin(turn)])
    position = out * (0.05 + 0.01 * rng.uniform(size=(count, 1)))
    speed = pace * (-out * rng.uniform(0.8, 2, (count, 1)) + 0.2 * rng.normal(size=(count, 2)))
    return position, rng.uniform(0, 6, count), speed, rng.normal(size=count) * 15 * pace


def amounts(parts, run):
    """Momentum, angular momentum and energy, (k, 2), (k,), (k,)."""
    mass = np.array([part.mass for part in parts])
    inertia = np.array([part.inertia for part in parts])
    x, v, w = run.position, run.velocity, run.spin
    moment = mass * (x[..., 0] * v[..., 1] - x[..., 1] * v[..., 0]) + inertia * w
    energy = 0.5 * (mass * (v**2).sum(-1) + inertia * w**2)
    return np.einsum("i,kid->kd", mass, v), moment.sum(1), energy.sum(1)


def waves(seed, size, mirror=False, turn=0.0, period=0.05):
    sine, cosine = np.random.default_rng(seed).normal(size=(2, 2, 3)) * [0.2, 0.2, 0.7] * size
    if mirror:
        sine, cosine = sine * [1, -1, -1], cosine * [1, -1, -1]
    q = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return harmonic.waves(period, sine @ q.T, cosine @ q.T, 128)


def test_the_tested_scenes_contain_contacts():
    met = 0
    for seed in range(40):
        parts = [SHAPES[seed % 6], SHAPES[seed // 6 % 6]]
        run = simulate_bodies(REST, parts, *state([0, 0], seed), 0, contacts=Contacts())
        met += np.ptp(run.velocity, axis=0).max() > 0
    assert met > 30


@few
@given(scenes)
def test_contacts_keep_momentum_and_angular_momentum_and_add_no_energy(scene):
    kinds, seed, bounce, rub = scene
    parts = [SHAPES[k] for k in kinds]
    run = simulate_bodies(REST, parts, *state(kinds, seed), 0, contacts=Contacts(bounce, rub))
    momentum, moment, energy = amounts(parts, run)
    size = sum(part.mass for part in parts)
    assert momentum == pytest.approx(np.tile(momentum[0], (len(momentum), 1)), abs=1e-12 * size)
    # Parts of a crowd that are shifted apart, by up to 20 um at 2 m/s, take that much along.
    assert moment == pytest.approx(np.full(len(moment), moment[0]), abs=4e-5 * size)
    assert np.diff(energy).max() <= 1e-12 * energy[0]
    assert np.isfinite(run.angle).all()


@few
@given(scenes)
def test_elastic_smooth_parts_keep_energy_too(scene):
    kinds, seed, _, _ = scene
    parts = [SHAPES[k] for k in kinds]
    run = simulate_bodies(REST, parts, *state(kinds, seed), 0, contacts=Contacts(1.0, 0.0))
    energy = amounts(parts, run)[2]
    assert energy == pytest.approx(np.full(len(energy), energy[0]), rel=1e-12)


@few
@given(scenes, st.floats(0, 1))
def test_a_still_plate_gives_no_energy(scene, mu):
    kinds, seed, bounce, rub = scene
    parts = [SHAPES[k] for k in kinds]
    run = simulate_bodies(
        REST, parts, *state(kinds, seed), mu, contacts=Contacts(bounce, rub),
        ground=Ground(static_ratio=1.5),
    )  # fmt: skip
    assert np.diff(amounts(parts, run)[2]).max() <= 1e-14


@few
@given(scenes, st.floats(0, 1.5), st.floats(0, 2), numbers, numbers)
def test_any_finite_scene_stays_finite(scene, mu, size, lean, far):
    kinds, seed, bounce, rub = scene
    position, angle, speed, spin = state(kinds, seed, 10.0 ** (6 * far))
    run = simulate_bodies(
        waves(seed, size), [SHAPES[k] for k in kinds], position, angle, speed, spin, mu,
        contacts=Contacts(bounce, rub), ground=Ground(1.2, (0.3 * lean, 0.1)), samples=16,
    )  # fmt: skip
    for values in (run.position, run.angle, run.velocity, run.spin):
        assert np.isfinite(values).all()


@few
@given(scenes, st.permutations(range(4)))
def test_the_order_of_bodies_does_not_change_their_motion(scene, order):
    kinds, seed, bounce, rub = scene
    order = [i for i in order if i < len(kinds)]
    position, angle, speed, spin = state(kinds, seed)
    contacts = Contacts(bounce, rub)
    one = simulate_bodies(
        waves(seed, 1), [SHAPES[k] for k in kinds], position, angle, speed, spin, 0.3,
        contacts=contacts,
    )  # fmt: skip
    other = simulate_bodies(
        waves(seed, 1), [SHAPES[kinds[i]] for i in order], position[order], angle[order],
        speed[order], spin[order], 0.3, contacts=contacts,
    )  # fmt: skip
    assert other.position.tolist() == one.position[:, order].tolist()
    assert other.spin.tolist() == one.spin[:, order].tolist()


def mirrored(part: Footprint) -> Footprint:
    """Return the part seen in a mirror along x."""
    flip = [1, -1]
    outline = tuple((corners * flip)[::-1] for corners in part.outline)
    return Footprint(
        part.mass, part.inertia, part.points * flip, part.weights, part.blur, outline, part.radius
    )


@few
@given(scenes, st.floats(-3, 3), st.booleans())
@example(([4, 2], 66660, 1.0, 1.0), 0.0, True)
def test_rotated_and_mirrored_scenes_have_rotated_and_mirrored_motions(scene, turn, mirror):
    kinds, seed, bounce, rub = scene
    kinds = kinds[:2]  # which meet once: more would magnify rounding
    position, angle, speed, spin = state(kinds, seed)
    parts, sign = [SHAPES[k] for k in kinds], np.array([1, -1 if mirror else 1])
    q = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) * sign
    run = simulate_bodies(
        waves(seed, 0.5), parts, position, angle, speed, spin, 0.3, contacts=Contacts(bounce, rub),
    )  # fmt: skip
    like = simulate_bodies(
        waves(seed, 0.5, mirror, turn), [mirrored(p) if mirror else p for p in parts],
        position @ q.T, sign[1] * angle + turn, speed @ q.T, sign[1] * spin, 0.3,
        contacts=Contacts(bounce, rub),
    )  # fmt: skip
    # Some scenes magnify a shift by far less than rounding: no turned room can be nearer than that.
    shifted = simulate_bodies(
        waves(seed, 0.5), parts, position + 1e-13, angle, speed, spin, 0.3,
        contacts=Contacts(bounce, rub),
    )  # fmt: skip
    near = 1e-6 + 3 * np.max(np.abs(shifted.position - run.position))
    assert like.position == pytest.approx(run.position @ q.T, abs=near)
    # A contact ends with an overlap of up to 1e-5 m, which depends on the order of the corners.
    reach = [max(p.radius, *(np.max(np.hypot(*c.T)) for c in p.outline), 0.0) for p in parts]
    near = 1e-5 / min(reach) + 3 * np.max(np.abs(shifted.angle - run.angle))
    assert like.angle == pytest.approx(sign[1] * run.angle + turn, abs=near)
