"""The filter against parts that are moved by another method: explicit steps, 12 times finer."""

import numpy as np
import pytest

from plate_core import Parts, PlateCycle
from plate_planner.ages import Ages
from plate_planner.estimation import CAMERA_M, carried
from plate_planner.plate_log import PlateLog
from plate_planner.watch import COAST, Watch

ACCEL = 2.4525
T = 0.1
MASS = 0.02
FINE = 2e-5
"""Step of the truth [s]."""


def shaken(rng):
    """Return a cycle from rest to rest that slides parts about, at some 30 m/s2."""
    s = np.arange(200) / 200
    window = np.sin(np.pi * s)[:, None] ** 4
    waves = [np.sin(2 * np.pi * k * s + rng.uniform(0, 6))[:, None] for k in (1, 2, 3)]
    size = rng.normal(size=(3, 3)) * [2e-3, 2e-3, 8e-3]
    return PlateCycle.from_samples(T, window * sum(w * a for w, a in zip(waves, size, strict=True)))


class World:
    """Parts with friction of their own; knows each instant's places."""

    def __init__(self, count, friction, seed=0, noise=0.01e-3):
        self.rng = np.random.default_rng(seed)
        self.place = self.rng.uniform(-0.1, 0.1, (count, 2))
        self.speed = np.zeros((count, 2))
        self.bound = ACCEL * np.broadcast_to(friction, count)[:, None]
        self.noise = noise
        self.past = [self.place]

    def run(self, cycle):
        t = np.arange(round(cycle.period / FINE)) * FINE
        pose, twist = cycle.pose(t), cycle.twist(t)
        self.past = [self.place]
        for k in range(len(t)):
            arm = self.place - pose[k, :2]
            surface = twist[k, :2] + twist[k, 2] * np.column_stack([-arm[:, 1], arm[:, 0]])
            slip = surface - self.speed
            pull = self.bound * slip / np.maximum(np.hypot(*slip.T), 1e-3)[:, None]
            self.speed = self.speed + FINE * pull
            self.place = self.place + FINE * self.speed
            self.past.append(self.place)

    def ago(self, age):
        return self.past[max(len(self.past) - 1 - round(age / FINE), 0)]

    def seen(self, age=0.0, names=None):
        names = names or tuple(f"black_{i + 1}" for i in range(len(self.place)))
        place = self.ago(age) + self.noise * self.rng.normal(size=self.place.shape)
        return Parts.make(names, place)


def watched(world, cycles, age=0.0, told=0.0, edit=lambda k, parts: parts):
    """Yield the watch after every image, and the truth at its stamp."""
    watch, cycle = Watch(ACCEL, MASS, ages=Ages.known(told)), PlateCycle.rest(T)
    for k in range(cycles):
        watch = watch.look(edit(k, world.seen(age)), k * T)
        yield watch, world.place
        world.run(cycle)
        cycle = shaken(world.rng)
        watch = watch.hear(cycle, k * T)


@pytest.mark.parametrize("age", [0.0, 0.05])
def test_it_finds_friction_and_the_place_at_the_stamp(age):
    friction = np.array([0.7, 0.9, 1.0, 1.3])
    errors, raw = [], []
    for watch, truth in watched(World(4, friction), 25, age, age):
        errors.append(np.abs(watch.parts.position - truth).max())
        raw.append(np.abs(watch.seen.position - truth).max())
    assert np.median(errors[10:]) < 0.04e-3
    if age:  # without the filter they would be where they were half a cycle ago
        assert np.median(raw[10:]) > 10 * np.median(errors[10:])
    assert watch.belief.friction == pytest.approx(friction, rel=0.04)
    assert watch.parts.friction_limit == pytest.approx(friction * ACCEL * MASS, rel=0.04)


@pytest.mark.parametrize("age", [0.0, 0.013, 0.1])
def test_it_finds_out_how_old_images_are(age):
    errors = []
    for watch, truth in watched(World(4, 1.1), 32, age, told=None):
        errors.append(np.abs(watch.parts.position - truth).max())
    assert watch.ages.age == pytest.approx(age, abs=1e-3)
    assert np.median(errors[24:]) < 0.1e-3


def test_its_error_is_as_large_as_it_says():
    square = []
    for seed in range(4):
        for k, (watch, truth) in enumerate(watched(World(4, 1.1, seed), 12)):
            if k > 3:
                gap = watch.belief.mean[:, :2] - truth
                spread = watch.belief.covariance[:, :2, :2]
                square.append(np.einsum("ki,kij,kj->k", gap, np.linalg.inv(spread), gap) / 2)
    # 1 if it were exact; it allows for more than this world holds: uneven friction, a worse camera.
    assert 0.05 < np.mean(square) < 1.2


def test_it_knows_where_the_next_cycle_finds_the_parts():
    world = World(3, [0.8, 1.0, 1.2])
    ahead, errors = None, []
    for watch, truth in watched(world, 20):
        if ahead is not None:
            errors.append(np.abs(ahead - truth).max())
        ahead = watch.ahead(watch.parts.ids)
    assert np.median(errors[8:]) < 0.1e-3


def test_a_part_that_is_missed_is_carried_on_and_given_up_in_the_end():
    gone = range(10, 10 + COAST + 1)

    def edit(k, parts):
        keep = [0, 2] if k in gone else [0, 1, 2]
        return Parts.make(tuple(parts.ids[i] for i in keep), parts.position[keep])

    for k, (watch, truth) in enumerate(watched(World(3, 0.9), 20, edit=edit)):
        if gone[0] <= k < gone[0] + COAST:
            assert watch.parts.ids == ("black_1", "black_2", "black_3")
            assert np.abs(watch.parts.position - truth).max() < 0.5e-3
        elif k == gone[0] + COAST:
            assert watch.parts.ids == ("black_1", "black_3")
    assert set(watch.parts.ids) == {"black_1", "black_2", "black_3"}  # it came back


def test_a_part_put_down_in_mid_task_is_known_at_once_and_soon_well():
    def edit(k, parts):
        return parts if k >= 8 else Parts.make(parts.ids[:2], parts.position[:2])

    for k, (watch, truth) in enumerate(watched(World(3, [1.0, 1.0, 0.8]), 24, edit=edit)):
        assert len(watch.parts) == (3 if k >= 8 else 2)
        if k > 12:
            assert np.abs(watch.parts.position - truth).max() < 0.1e-3
    assert watch.belief.friction[2] == pytest.approx(0.8, rel=0.05)


def test_a_part_that_is_pushed_is_where_it_is_seen():
    world = World(2, 1.2)
    for k, (watch, truth) in enumerate(watched(world, 20)):
        if k == 12:
            learnt = watch.belief.friction[1]
            world.place = world.place + [[0, 0], [4e-3, -3e-3]]
        if k == 13:
            assert np.abs(watch.parts.position - truth).max() < 6 * CAMERA_M
            assert watch.belief.friction[1] == pytest.approx(learnt, rel=0.05)
    assert np.abs(watch.parts.position - truth).max() < 0.1e-3


def test_parts_stay_where_no_motion_is_known():
    watch = Watch(ACCEL, MASS).look(Parts.make(("black_1",), np.array([[0.1, 0.0]])), 3.0)
    assert watch.ahead(("black_1",)) is None
    assert watch.parts.position == pytest.approx(np.array([[0.1, 0.0]]))


def test_a_slipping_part_is_pulled_by_mu_g():
    # A plate that is at rest brakes a part: x = v^2/(2 mu g) where it stops, mu of its own.
    log = PlateLog(((0.0, PlateCycle.rest(0.2)),))
    state = np.array([[0.0, 0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 0.1, np.log(0.5)]])
    end = carried(log, state, 0.0, 0.2, ACCEL)
    assert end[0, 0] == pytest.approx(0.01 / (2 * ACCEL), rel=0.01)
    assert end[1, 1] == pytest.approx(0.01 / ACCEL, rel=0.01)
    assert end[:, 2:4] == pytest.approx(np.zeros((2, 2)), abs=1e-12)


class Windy(World):
    """Parts that are also blown about."""

    wind = np.array([[8e-3, 0.0], [0.0, -5e-3], [0.0, 0.0]])

    def run(self, cycle):
        super().run(cycle)
        self.place = self.place + self.wind * cycle.period
        self.past.append(self.place)


def test_what_parts_do_beyond_what_the_model_knows_is_observed():
    surprises = [w.surprise(w.belief.ids) for w, _ in watched(Windy(3, 1.0), 40) if w.belief.ids]
    assert surprises[-1] == pytest.approx(Windy.wind, abs=2e-3)  # the filter takes some for speed
