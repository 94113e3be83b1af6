"""Discs that meet: no overlap, momentum kept, no energy gained."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.rig import to_plate
from plate_sim import (
    Contacts,
    PlateMotion,
    WorldState,
    record_cycle,
    run_cycle,
    simulate,
    simulate_bodies,
)
from plate_sim.friction import disc

RIG = load_rig()
RADIUS = RIG.parts.radius_m
SMOOTH = 0.0
"""Friction coefficient that leaves only the contacts."""


def discs(position, velocity=None):
    state = WorldState.at_rest(tuple(f"black_{i}" for i in range(len(position))), position)
    return state if velocity is None else replace(state, velocity=np.array(velocity, float))


def energy_of(run):
    """Energy by mass (k,) [m2/s2] of discs, whose inertia is R^2/2."""
    return np.sum(run.velocity**2, axis=(1, 2)) + RADIUS**2 / 2 * np.sum(run.spin**2, axis=1)


def deepest_overlap(path):
    """Greatest overlap [m] of any two discs at any step of a path (k, M, 2)."""
    i, j = np.triu_indices(path.shape[1], 1)
    return 2 * RADIUS - np.min(np.linalg.norm(path[:, i] - path[:, j], axis=2))


def test_after_a_head_on_collision_discs_move_together():
    state = discs([[-0.02, 0], [0.02, 0]], [[0.3, 0], [-0.1, 0]])
    end, run = record_cycle(state, PlateCycle.rest(0.2), RIG, mu=SMOOTH)
    assert deepest_overlap(run.position) < 1e-12
    assert end.velocity == pytest.approx(np.array([[0.1, 0], [0.1, 0]]))
    assert np.sum(end.position, axis=0) == pytest.approx([0.04, 0])


def test_discs_without_contact_friction_keep_their_tangential_velocity():
    state = discs([[-0.02, 0.005], [0.02, -0.005]], [[0.3, 0.0], [-0.3, 0.0]])
    end, _ = record_cycle(state, PlateCycle.rest(0.1), RIG, mu=SMOOTH)
    assert np.sum(end.velocity, axis=0) == pytest.approx(0, abs=1e-12)
    # The remaining speed is the component across the line of centres at the time of contact.
    sine = 0.01 / (2 * RADIUS)
    assert np.linalg.norm(end.velocity[0]) == pytest.approx(0.3 * sine, rel=1e-9)


def test_crowd_keeps_momentum_and_gains_no_energy():
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    state = discs((grid - [2, 1.5]) * 0.022, rng.normal(0, 0.2, (20, 2)))
    end, run = record_cycle(state, PlateCycle.rest(0.3), RIG, mu=SMOOTH)
    assert end.dropped == 0
    momentum = np.sum(run.velocity, axis=1)
    assert momentum == pytest.approx(np.broadcast_to(momentum[0], momentum.shape), abs=1e-12)
    energy = energy_of(run)
    assert np.all(np.diff(energy) <= 1e-15)
    assert energy[-1] < 0.9 * energy[0]  # they did meet
    assert deepest_overlap(run.position) < 3e-5


def test_pressed_discs_do_not_overlap():
    # Nine discs thrown at their common centre, on a plate that shakes them.
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    state = discs(np.vstack([0.06 * ring, [[0, 0]]]), np.vstack([-0.6 * ring, [[0, 0]]]))
    t = np.arange(64) / 64
    pose = 1e-3 * np.stack([np.cos(2 * np.pi * t) - 1, np.sin(4 * np.pi * t), 0 * t], axis=1)
    _, run = record_cycle(state, PlateCycle.from_samples(0.15, pose), RIG)
    assert deepest_overlap(run.position) < 3e-5
    assert np.max(np.linalg.norm(run.position[-1], axis=1)) < 0.04


def test_discs_that_overlap_a_little_at_the_start_are_parted_without_speed():
    gap = 2 * RADIUS - 0.5e-3
    state = discs([[0, 0], [gap, 0], [gap / 2, 0.5 * np.sqrt(3) * gap]])
    end, run = record_cycle(state, PlateCycle.rest(0.05), RIG)
    assert deepest_overlap(run.position[-1:]) <= 1.1e-5
    assert np.all(end.velocity == 0)


def test_discs_apart_move_like_points():
    rng = np.random.default_rng(1)
    cycle = PlateCycle.from_samples(0.1, 1e-3 * rng.normal(size=(12, 3)) * [1, 1, 4])
    state = discs([[-0.1, 0.05], [0.1, 0.0], [0.0, -0.08]])
    _, run = record_cycle(state, cycle, RIG)
    points = simulate(
        cycle, state.position, state.velocity, RIG.friction.mu, RIG.friction.gravity,
        samples=len(run.time) - 1,
    )  # fmt: skip
    # Points take the surface's velocity as straight within a step, discs as a parabola.
    assert run.position == pytest.approx(points.position, abs=2e-6)
    assert run.velocity == pytest.approx(points.velocity, abs=2e-4)


def collide(offset, restitution, friction, step=1e-3):
    """Two discs at 0.3 and -0.1 m/s, their courses `offset` [m] apart; where they end."""
    state = discs([[-0.03, offset / 2], [0.03, -offset / 2]], [[0.3, 0], [-0.1, 0]])
    contacts = Contacts(restitution, friction)
    return record_cycle(state, PlateCycle.rest(0.2), RIG, SMOOTH, step, contacts=contacts)


@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("friction", [0.0, 0.1, 5.0])
@pytest.mark.parametrize("offset", [0.0, 0.005, -0.012])
def test_two_discs_collide_as_on_paper(restitution, friction, offset):
    end, run = collide(offset, restitution, friction)
    # In the frame of the second: touch where the distance along the course is 2 r cos
    sine = offset / (2 * RADIUS)
    normal = np.array([-np.sqrt(1 - sine**2), sine])  # from the second to the first
    along = np.array([-normal[1], normal[0]])
    relative = np.array([0.4, 0.0])
    closing, across = -relative @ normal, relative @ along
    hit = (1 + restitution) * closing / 2
    # Rims yield by 1/m + R^2/I = 3/m.
    rub = -np.sign(across) * min(friction * hit, abs(across) / 6)
    first = np.array([0.3, 0]) + hit * normal + rub * along
    second = np.array([-0.1, 0]) - hit * normal - rub * along
    assert end.velocity == pytest.approx(np.array([first, second]), abs=1e-12)
    assert end.spin == pytest.approx([-2 * rub / RADIUS] * 2, abs=1e-9)
    when = (0.06 + 2 * RADIUS * normal[0]) / 0.4
    touch = np.array([[-0.03, offset / 2], [0.03, -offset / 2]]) + [
        [0.3 * when, 0],
        [-0.1 * when, 0],
    ]
    assert end.position == pytest.approx(touch + (0.2 - when) * np.array([first, second]))
    assert deepest_overlap(run.position) < 1e-12


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_disc_meets_a_wall_as_on_paper(friction):
    state = discs([[0, 0]], [[0.5, 2.0]])
    contacts = Contacts(0.5, friction, walls=True)
    end, run = record_cycle(state, PlateCycle.rest(0.1), RIG, SMOOTH, 1e-3, contacts=contacts)
    reach = RIG.plate.half[1] - RADIUS
    rub = min(friction * 1.5 * 2.0, 0.5 / 3)
    assert end.velocity[0] == pytest.approx([0.5 - rub, -1.0])
    when = reach / 2.0
    assert end.position[0, 1] == pytest.approx(reach - (0.1 - when))
    assert np.max(np.abs(run.position[:, 0, 1])) <= reach + 1e-12
    assert end.dropped == 0


def crowd(count, rng, speed=0.3, spread=0.9):
    """Discs at random, apart from each other."""
    position = [rng.uniform(-1, 1, 2) * spread * (RIG.plate.half - RADIUS)]
    while len(position) < count:
        new = rng.uniform(-1, 1, 2) * spread * (RIG.plate.half - RADIUS)
        if np.min(np.linalg.norm(np.array(position) - new, axis=1)) > 2.1 * RADIUS:
            position.append(new)
    return discs(np.array(position), rng.normal(0, speed, (count, 2)))


def shaken(rng, scale=1.0):
    return PlateCycle.from_samples(0.1, scale * 1e-3 * rng.normal(size=(12, 3)) * [1, 1, 4])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("step", [1e-3, 5e-5])
def test_contacts_never_add_energy_and_keep_momentum(seed, step):
    rng = np.random.default_rng(seed)
    contacts = Contacts(rng.choice([0.0, 0.5, 1.0]), rng.choice([0.0, 0.2, 2.0]))
    state = crowd(40, rng, spread=0.5)
    end, run = record_cycle(state, PlateCycle.rest(0.06), RIG, SMOOTH, step, contacts=contacts)
    assert end.dropped == 0
    energy, momentum = energy_of(run), np.sum(run.velocity, axis=1)
    assert momentum == pytest.approx(np.broadcast_to(momentum[0], momentum.shape), abs=1e-12)
    assert np.all(np.diff(energy) <= 1e-13 * energy[0])
    assert deepest_overlap(run.position) < 1e-4


def test_elastic_discs_between_smooth_walls_keep_their_energy():
    rng = np.random.default_rng(0)
    state = crowd(60, rng)
    contacts = Contacts(1.0, 0.0, walls=True)
    end = run_cycle(state, PlateCycle.rest(0.1), RIG, SMOOTH, 1e-3, contacts=contacts, cycles=10)
    assert np.sum(end.velocity**2) == pytest.approx(np.sum(state.velocity**2), rel=1e-12)
    assert end.dropped == 0


@pytest.mark.parametrize("seed", range(4))
def test_results_do_not_depend_on_the_order_of_parts(seed):
    rng = np.random.default_rng(seed)
    cycle, state, order = shaken(rng), crowd(60, rng), rng.permutation(60)
    contacts = Contacts(0.3, 0.2, walls=seed % 2 == 0)
    mixed = WorldState(
        tuple(state.ids[i] for i in order),
        state.position[order], state.velocity[order], state.on_plate[order],
    )  # fmt: skip
    end = run_cycle(state, cycle, RIG, step=2e-4, contacts=contacts, cycles=3)
    other = run_cycle(mixed, cycle, RIG, step=2e-4, contacts=contacts, cycles=3)
    assert np.array_equal(other.position, end.position[order])
    assert np.array_equal(other.velocity, end.velocity[order])


@pytest.mark.parametrize("seed", range(6))
def test_fast_discs_meet_and_fall_at_the_same_step_with_and_without_a_record(seed):
    # A record of each step makes the kernel check contacts and edges in each step. Without a
    # record, it does not check steps in which no disc can meet another disc or an edge.
    rng = np.random.default_rng(seed)
    cycle, state = shaken(rng), crowd(20, rng)
    state = replace(state, velocity=rng.uniform(-2, 2, (20, 2)), spin=rng.uniform(-5, 5, 20))
    end = run_cycle(state, cycle, RIG)
    recorded, path = record_cycle(state, cycle, RIG)
    assert end.dropped > 0
    assert deepest_overlap(path.position) > -1e-4  # some discs meet
    for name in ("position", "velocity", "angle", "spin", "on_plate"):
        assert np.array_equal(getattr(end, name), getattr(recorded, name))


@pytest.mark.parametrize("sign", [[-1, 1], [1, -1], [-1, -1]])
def test_mirrored_scenes_stay_mirrored(sign):
    rng = np.random.default_rng(3)
    cycle, state = shaken(rng), crowd(12, rng)
    turn = sign[0] * sign[1]
    mirrored = PlateCycle.from_samples(0.1, cycle.knot_pose[:-1] * [*sign, turn])
    contacts = Contacts(0.3, 0.2, walls=True)
    end, _ = record_cycle(state, cycle, RIG, step=2e-4, contacts=contacts)
    start = replace(state, position=state.position * sign, velocity=state.velocity * sign)
    other, _ = record_cycle(start, mirrored, RIG, step=2e-4, contacts=contacts)
    assert other.position == pytest.approx(end.position * sign, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_full_tray_of_parts_stays_within_the_walls_without_overlap(seed):
    rng = np.random.default_rng(seed)
    state = crowd(150, rng)
    contacts = Contacts(0.5, 0.3, walls=True)
    cycle = shaken(rng, 2)
    end, run = record_cycle(state, cycle, RIG, step=1e-3, contacts=contacts, cycles=3)
    assert end.dropped == 0
    assert np.all(np.isfinite(run.position))
    assert np.all(np.isfinite(run.velocity))
    assert deepest_overlap(run.position) < 1e-4
    position = to_plate(cycle.pose(cycle.period)[0], end.position)
    assert np.all(np.abs(position) < RIG.plate.half - RADIUS + 1e-4)


def test_wrong_starts_are_refused_by_name():
    cycle = PlateCycle.rest(0.01)
    with pytest.raises(PlateError, match="black_0 and black_1 overlap by 6 mm"):
        run_cycle(discs([[0, 0], [0.01, 0], [0.1, 0]]), cycle, RIG)
    with pytest.raises(PlateError, match="black_0 and black_1 overlap by 16 mm"):
        run_cycle(discs([[0, 0], [0, 0]]), cycle, RIG)
    named = r"black_1 and black_3 overlap by 1\.7 mm, allowed: at most 0\.8 mm"
    with pytest.raises(PlateError, match=named):
        run_cycle(discs([[-0.1, 0], [0.0143, 0], [0.1, 0], [0, 0]]), cycle, RIG)
    broken = discs([[0, 0], [0.1, 0]], [[0, 0], [np.nan, 0]])
    with pytest.raises(PlateError, match="velocity has values that are not finite: part 1"):
        run_cycle(broken, cycle, RIG)
    with pytest.raises(PlateError, match=r"restitution is 1\.1"):
        Contacts(restitution=1.1)
    with pytest.raises(PlateError, match=r"friction is -0\.1"):
        Contacts(friction=-0.1)
    with pytest.raises(PlateError, match=r"friction is -0\.2"):
        run_cycle(discs([[0, 0]]), cycle, RIG, mu=-0.2)
    with pytest.raises(PlateError, match="cycles is 0"):
        run_cycle(discs([[0, 0]]), cycle, RIG, cycles=0)


def test_parts_are_refused_that_cannot_be_run():
    still, position, rest = np.zeros((2, 2)), np.array([[0, 0], [0.1, 0]]), PlateCycle.rest(0.01)
    rims = {"contacts": Contacts(), "half": RIG.plate.half}
    with pytest.raises(PlateError, match=r"cycles is 2, allowed: 1"):
        simulate_bodies(
            PlateMotion.of_cycle(rest), disc(RADIUS), position, 0, still, 0, 0.2, cycles=2, **rims
        )
    with pytest.raises(PlateError, match="parts 0 and 1 overlap by 6 mm"):
        simulate_bodies(rest, disc(RADIUS), 0.1 * position, 0, still, 0, 0.2, **rims)
    with pytest.raises(PlateError, match="step is 0"):
        simulate_bodies(rest, disc(RADIUS), position, 0, still, 0, 0.2, step=0, **rims)


def test_without_samples_the_final_state_is_the_same():
    state = crowd(20, np.random.default_rng(0))
    cycle = shaken(np.random.default_rng(1))
    run, end = (
        simulate_bodies(
            cycle, disc(RADIUS), state.position, 0, state.velocity, 0, 0.3, cycles=2,
            samples=samples, step=1e-3, contacts=Contacts(), half=RIG.plate.half,
        )
        for samples in (100, 0)
    )  # fmt: skip
    assert np.array_equal(end.position[-1], run.position[-1])
    assert np.array_equal(end.velocity[-1], run.velocity[-1])
    assert end.time[-1] == pytest.approx(run.time[-1])
