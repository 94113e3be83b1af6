"""The filter against parts that are moved by another method: explicit steps, 12 times finer."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, PlateCycle, load_rig
from plate_core.rig import CameraTrigger, PartType, row_delay
from plate_planner.estimation.cycle_log import CycleLog
from plate_planner.estimation.estimator import MISSED_IMAGES, DriftBias, Estimator, LastRequest
from plate_planner.estimation.filter import CAMERA_M, propagate
from plate_planner.estimation.latency import LatencyHypotheses

RIG = load_rig()
ACCEL, MASS = RIG.friction.accel, RIG.parts.mass_kg
T = 0.1
FINE = 1e-4
"""Step of the truth [s]."""


def shaken(rng):
    """Return a cycle from rest to rest that slides parts about, at some 30 m/s2."""
    s = np.arange(200) / 200
    window = np.sin(np.pi * s)[:, None] ** 4
    waves = [np.sin(2 * np.pi * k * s + rng.uniform(0, 6))[:, None] for k in (1, 2, 3)]
    size = rng.normal(size=(3, 3)) * [2e-3, 2e-3, 8e-3]
    return PlateCycle.from_samples(T, window * sum(w * a for w, a in zip(waves, size, strict=True)))


def slide(position, speed, bound, pose, twist):
    """Return places (n + 1, K, 2) of parts from step to step of FINE; `speed` goes with them."""
    # Python's complex numbers as vectors: arrays of so few parts would take ten times as long.
    turns = 1j * twist[:, 2]
    still = (twist[:, :2] @ [1, 1j] - turns * (pose[:, :2] @ [1, 1j])).tolist()
    turns = turns.tolist()
    past = np.empty((len(twist) + 1, *position.shape))
    for k, (x, v) in enumerate(zip(position @ [1, 1j], speed @ [1, 1j], strict=True)):
        x, v, gain = complex(x), complex(v), FINE * bound[k]
        ways = [x]
        for a, w in zip(still, turns, strict=True):
            slip = a + w * x - v
            v += gain / max(abs(slip), 1e-3) * slip
            x += FINE * v
            ways.append(x)
        past[:, k] = np.array(ways).view(float).reshape(-1, 2)
        speed[k] = v.real, v.imag
    return past


class World:
    """Parts with friction of their own; knows each instant's places."""

    def __init__(self, count, friction, seed=0, noise=0.01e-3):
        self.rng = np.random.default_rng(seed)
        self.place = self.rng.uniform(-0.1, 0.1, (count, 2))
        self.speed = np.zeros((count, 2))
        self.bound = ACCEL * np.broadcast_to(friction, count)
        self.noise = noise
        self.past = [self.place]

    def run(self, cycle):
        t = np.arange(round(cycle.period / FINE)) * FINE
        pose, twist = cycle.pose(t), cycle.twist(t)
        self.past = slide(self.place, self.speed, self.bound, pose, twist)
        self.place = self.past[-1]

    def ago(self, age):
        return self.past[max(len(self.past) - 1 - round(age / FINE), 0)]

    def seen(self, age=0.0, names=None):
        names = names or tuple(f"black_{i + 1}" for i in range(len(self.place)))
        position = self.ago(age) + self.noise * self.rng.normal(size=self.place.shape)
        return Parts.make(names, position)


def estimated(
    world, cycles, latency=0.0, given=0.0, edit=lambda k, parts: parts, starts_reported=False
):
    """Yield the estimator after every image, and the truth at its stamp. `starts_reported`:
    whether the starts of cycles are reported."""
    estimator, cycle = Estimator.of(RIG, T, given), PlateCycle.rest(T)
    for k in range(cycles):
        if starts_reported:
            estimator = estimator.started(cycle, k * T, triggered=True)
        estimator = estimator.update(edit(k, world.seen(latency)), k * T)
        parts = estimator.parts
        axes, max_drift = np.tile(np.eye(2), (len(parts), 1, 1)), np.full(len(parts), 0.1)
        estimator = estimator.observe(parts, estimator.predict(parts), axes, 0.3, max_drift)
        yield estimator, world.place
        world.run(cycle)
        cycle = shaken(world.rng)
        estimator = estimator.record_cycle(cycle, k * T)


@pytest.mark.parametrize("age", [0.0, 0.05])
def test_the_filter_estimates_friction_and_the_position_at_the_stamp(age):
    friction = np.array([0.7, 0.9, 1.0, 1.3])
    errors, raw = [], []
    for estimator, truth in estimated(World(4, friction), 25, age, age):
        errors.append(np.abs(estimator.parts.position - truth).max())
        raw.append(np.abs(estimator.seen.position - truth).max())
    assert np.median(errors[10:]) < 0.04e-3
    if age:  # without the filter they would be where they were half a cycle ago
        assert np.median(raw[10:]) > 10 * np.median(errors[10:])
    assert estimator.friction == pytest.approx(friction, rel=0.04)
    assert estimator.parts.friction_limit == pytest.approx(friction * ACCEL * MASS, rel=0.04)


def test_each_row_of_a_rolling_shutter_has_its_own_time():
    rolling = replace(RIG, camera=replace(RIG.camera, readout_s=0.04))
    world, cycle, age = World(4, 1.1), PlateCycle.rest(T), 0.05
    estimators, errors = [Estimator.of(rig, T, age) for rig in (rolling, RIG)], []
    for k in range(25):
        delay = row_delay(rolling, world.place)
        shown = [world.ago(age - late)[i] for i, late in enumerate(delay)]
        parts = Parts.make(tuple(f"black_{i + 1}" for i in range(4)), np.array(shown))
        estimators = [each.update(parts, k * T) for each in estimators]
        errors.append([np.abs(e.parts.position - world.place).max() for e in estimators])
        world.run(cycle)
        cycle = shaken(world.rng)
        estimators = [each.record_cycle(cycle, k * T) for each in estimators]
    known, unknown = np.median(errors[10:], axis=0)
    assert known < 0.05e-3
    assert unknown > 5 * known


@pytest.mark.parametrize(
    ("age", "reported"), [(0.0, False), (0.013, False), (0.1, False), (0.05, True), (0.1, True)]
)
def test_the_filter_estimates_the_age_of_images(age, reported):
    """Also where their stamps are those of cycles' starts, as a trigger's are."""
    errors = []
    for estimator, truth in estimated(World(4, 1.1), 32, age, given=None, starts_reported=reported):
        errors.append(np.abs(estimator.parts.position - truth).max())
    assert estimator.hypotheses.latency == pytest.approx(age, abs=1e-3)
    assert np.median(errors[24:]) < 0.1e-3


@pytest.mark.parametrize(("late", "found"), [(0.0, True), (5e-3, False)])
def test_an_image_stamped_at_a_reported_start_is_not_old(late, found):
    world, cycle = World(3, 1.1), shaken(np.random.default_rng(2))
    estimator = Estimator.of(RIG, T, None).update(world.seen(), late)
    world.run(cycle)
    estimator = estimator.started(cycle, 0.0, triggered=True).started(cycle, T, triggered=True)
    estimator = estimator.update(world.seen(), T + late)
    assert estimator.latency_known is found
    if found:
        assert estimator.hypotheses.latency == 0
        assert estimator.parts.position == pytest.approx(world.place, abs=0.05e-3)


def test_the_error_of_the_filter_agrees_with_its_covariance():
    square = []
    for seed in range(4):
        for k, (estimator, truth) in enumerate(estimated(World(4, 1.1, seed), 12)):
            if k > 3:
                gap = estimator.mean[:, :2] - truth
                spread = estimator.hypotheses.estimate.covariance[0, :, :2, :2]
                square.append(np.einsum("ki,kij,kj->k", gap, np.linalg.inv(spread), gap) / 2)
    # 1 if it were exact; it allows for more than this world holds: uneven friction, a worse camera.
    assert 0.05 < np.mean(square) < 1.2


def test_the_filter_predicts_positions_at_the_next_cycle_start():
    world = World(3, [0.8, 1.0, 1.2])
    ahead, errors = None, []
    for estimator, truth in estimated(world, 20):
        if ahead is not None:
            errors.append(np.abs(ahead - truth).max())
        ahead = estimator.predict(estimator.parts)
    assert np.median(errors[8:]) < 0.1e-3


def test_a_part_that_is_missed_is_carried_on_and_given_up_in_the_end():
    lost_images = range(10, 10 + MISSED_IMAGES.parts + 1)

    def edit(k, parts):
        keep = [0, 2] if k in lost_images else [0, 1, 2]
        return Parts.make(tuple(parts.ids[i] for i in keep), parts.position[keep])

    for k, (estimator, truth) in enumerate(estimated(World(3, 0.9), 20, edit=edit)):
        if lost_images[0] <= k < lost_images[0] + MISSED_IMAGES.parts:
            assert estimator.parts.ids == ("black_1", "black_2", "black_3")
            assert np.abs(estimator.parts.position - truth).max() < 0.5e-3
        elif k == lost_images[0] + MISSED_IMAGES.parts:
            assert estimator.parts.ids == ("black_1", "black_3")
    assert set(estimator.parts.ids) == {"black_1", "black_2", "black_3"}  # it came back


def test_a_part_put_down_in_mid_task_is_known_at_once_and_soon_well():
    def edit(k, parts):
        return parts if k >= 8 else Parts.make(parts.ids[:2], parts.position[:2])

    for k, (estimator, truth) in enumerate(estimated(World(3, [1.0, 1.0, 0.8]), 24, edit=edit)):
        assert len(estimator.parts) == (3 if k >= 8 else 2)
        if k > 12:
            assert np.abs(estimator.parts.position - truth).max() < 0.1e-3
    assert estimator.friction[2] == pytest.approx(0.8, rel=0.05)


def test_a_part_that_is_pushed_is_where_it_is_seen():
    world = World(2, 1.2)
    for k, (estimator, truth) in enumerate(estimated(world, 20)):
        if k == 12:
            learnt = estimator.friction[1]
            world.place = world.place + [[0, 0], [4e-3, -3e-3]]
        if k == 13:
            assert np.abs(estimator.parts.position - truth).max() < 6 * CAMERA_M
            assert estimator.friction[1] == pytest.approx(learnt, rel=0.05)
    assert np.abs(estimator.parts.position - truth).max() < 0.1e-3


def test_parts_stay_where_no_motion_is_known():
    part = Parts.make(("black_1",), np.array([[0.1, 0.0]]))
    estimator = Estimator.of(RIG, T, None).update(part, 3.0)
    assert estimator.predict(part) == pytest.approx(part.position)
    assert estimator.parts.position == pytest.approx(part.position)


def test_a_slipping_part_is_pulled_by_mu_g():
    # A plate that is at rest brakes a part: x = v^2/(2 mu g) where it stops, mu of its own.
    log = CycleLog(((0.0, PlateCycle.rest(0.2)),))
    state = np.array([[0.0, 0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 0.1, np.log(0.5)]])
    end = propagate(log, state, 0.0, 0.2, ACCEL)
    assert end[0, 0] == pytest.approx(0.01 / (2 * ACCEL), rel=0.01)
    assert end[1, 1] == pytest.approx(0.01 / ACCEL, rel=0.01)
    assert end[:, 2:4] == pytest.approx(np.zeros((2, 2)), abs=1e-12)


class Windy(World):
    """Parts that are also blown about."""

    wind = np.array([[8e-3, 0.0], [0.0, -5e-3], [0.0, 0.0]])

    def run(self, cycle):
        super().run(cycle)
        self.past = (
            self.past + np.linspace(0, cycle.period, len(self.past))[:, None, None] * self.wind
        )
        self.place = self.past[-1]


def test_a_drift_that_the_model_omits_is_estimated():
    *_, (estimator, _) = estimated(Windy(3, 1.0), 40)
    # The filter takes some for speed.
    assert estimator.bias.drift == pytest.approx(Windy.wind, abs=2e-3)


# Deviations of the parts from the prediction, compared with known drifts

MOST = np.array([0.05, 0.05])


def axes(*angles):
    cos, sin = np.cos(angles), np.sin(angles)
    return np.stack([np.column_stack([cos, sin]), np.column_stack([-sin, cos])], axis=1)


def learnt(drift, cycles, gain, latency=0.0, late=0.0, seen=(True, True)):
    """Return the bias after cycles in which parts drift by `drift` [m/s] more than predicted."""
    bias, ids = DriftBias(("black_1", "black_2"), np.zeros((2, 2))), ("black_1", "black_2")
    for k in range(cycles):
        position = np.full((2, 2), 0.3 * k)
        bias = bias.with_prediction(position, k * T, (k + 1) * T, latency)
        parts, t = Parts.make(ids, position + T * drift), (k + 1) * T + late
        bias = bias.update(parts, np.array(seen), t, latency, axes(0.4, 2.0), gain, MOST)
    return bias


def test_the_bias_goes_to_the_true_drift_by_its_gain():
    drift = np.array([[0.01, -0.02], [0.0, 0.03]])
    for cycles in (1, 2, 8):
        left = learnt(drift, cycles, 0.7).along(axes(0.4, 2.0)) - drift
        assert left == pytest.approx(-(0.3**cycles) * drift, abs=1e-12)


def test_the_bias_turns_with_the_path():
    bias = learnt(np.array([[0.01, 0.0], [0.0, 0.0]]), 40, 0.7)
    assert bias.along(axes(0.4 + np.pi / 2, 2.0))[0] == pytest.approx([0.0, 0.01])


def test_the_bias_is_bounded():
    bias = learnt(np.array([[5.0, 0.0], [0.0, -5.0]]), 40, 0.7)
    assert np.max(np.abs(bias.drift)) == pytest.approx(0.05)


def test_the_bias_ignores_parts_that_were_not_predicted_or_not_detected():
    drift = np.full((2, 2), 0.01)
    hidden = learnt(drift, 5, 0.7, seen=(False, True))
    assert not np.any(hidden.drift[0])
    assert np.any(hidden.drift[1])
    for other in ({"late": 0.5 * T}, {"latency": None}):
        assert not np.any(learnt(drift, 5, 0.7, **other).drift)
    stranger = Parts.make(("black_3",), np.zeros((1, 2)))
    bias = learnt(drift, 5, 0.7).with_prediction(np.zeros((2, 2)), 0.0, T, 0.0)
    bias = bias.update(stranger, np.array([True]), T, 0.0, axes(0.0), 0.7, MOST[:1])
    assert not np.any(bias.drift)


def test_parts_without_a_request_keep_drifting():
    parts = Parts.make(("a_1", "a_2"), np.zeros((2, 2)), np.full((2, 2), 0.01))
    requested = LastRequest(("a_2",), np.full((1, 2), 0.03), 1.0)
    assert requested.drift_of(parts, 1.0 + T, T) == pytest.approx(
        np.array([[0.01] * 2, [0.03] * 2])
    )
    for other in (1.0 + 2 * T, 0.0):  # too old, and from a time that has restarted
        assert requested.drift_of(parts, other, T) == pytest.approx(np.full((2, 2), 0.01))


# A camera that runs free


def run_free(rate, latency, given=None, jitter=0.0, cycles=40, seed=0, later=0.0):
    """Yield the estimator when each cycle begins, as reported, and the truth there.

    Images are taken at `rate` [1/s]; halfway their latency grows by `later` [s].
    """
    world, rng = World(4, 1.1, seed), np.random.default_rng(seed)
    estimator = Estimator.of(RIG, T, given)
    cycle = PlateCycle.rest(T)
    middle = 0.01
    last = 0.0
    for k in range(cycles):
        estimator = estimator.started(cycle, k * T)
        yield estimator, world.place
        world.run(cycle)
        while middle < (k + 1) * T:
            old = latency + (later if k > cycles // 2 else 0.0)
            last = max(middle + old + jitter * rng.standard_normal(), last + 1e-4)
            estimator = estimator.update(world.seen((k + 1) * T - middle), last)
            middle += 1 / rate
        cycle = shaken(world.rng)


@pytest.mark.parametrize(
    ("rate", "latency"), [(15.0, 0.0), (15.0, 0.08), (47.0, 0.037), (47.0, 0.08), (120.0, 0.0)]
)
def test_images_of_any_time_determine_places_and_latency(rate, latency):
    errors = []
    for estimator, truth in run_free(rate, latency):
        if len(estimator.parts):
            errors.append(np.abs(estimator.parts.position - truth).max())
    assert estimator.hypotheses.latency == pytest.approx(latency, abs=1.5e-3)
    assert np.median(errors[20:]) < 0.1e-3
    assert estimator.frames.rate == pytest.approx(rate, rel=0.01)


@pytest.mark.parametrize("phase", [0.0, 0.45])
@pytest.mark.parametrize("latency", [0.0, 0.06])
def test_images_of_a_trigger_line_need_no_search_for_their_latency(phase, latency):
    """Stamps have any delay and noise; the line reports when images were taken."""
    rig = replace(RIG, camera=replace(RIG.camera, trigger=CameraTrigger(phase)))
    world, rng = World(4, 1.1), np.random.default_rng(0)
    estimator, cycle, errors = Estimator.of(rig, T, None), PlateCycle.rest(T), []
    for k in range(20):
        estimator = estimator.started(cycle, k * T)
        if k:
            errors.append(np.abs(estimator.parts.position - world.place).max())
        world.run(cycle)
        taken = (k + phase) * T
        seen = world.seen((k + 1) * T - taken - rig.camera.exposure_s / 2)
        estimator = estimator.update(seen, taken + latency + 3e-3 * rng.standard_normal())
        cycle = shaken(world.rng)
    assert max(errors[1:]) < 0.2e-3
    assert np.median(errors[5:]) < 0.05e-3
    assert estimator.hypotheses.latency == 0.0


def test_the_estimated_latency_follows_a_slower_camera():
    runs = run_free(30.0, 0.02, cycles=80, later=0.04)
    found = [estimator.hypotheses.latency for estimator, _ in runs]
    assert found[40] == pytest.approx(0.02, abs=2e-3)
    assert found[-1] == pytest.approx(0.06, abs=2e-3)


def test_stamps_that_scatter_are_put_right_as_frames_are_regular():
    errors = []
    for estimator, truth in run_free(30.0, 0.03, 0.03, jitter=0.005, cycles=60):
        if len(estimator.parts):
            errors.append(np.abs(estimator.parts.position - truth).max())
    assert estimator.frames.noise_s == pytest.approx(0.005, rel=0.3)
    assert np.median(errors[30:]) < 0.2e-3


def test_the_search_for_the_latency_bears_an_empty_plate():
    """Parts that are taken before it has ended leave nothing to move."""
    found = LatencyHypotheses.of(None)
    later = np.full(len(found.latencies), 0.01)
    log = CycleLog().record_cycle(PlateCycle.rest(T), 0.0).advance(0.0)
    assert found.estimate.moved(log, later, ACCEL).mean.shape == found.estimate.mean.shape


def test_the_first_images_in_motion_already_determine_the_latency():
    """Noisy stamps are not accepted before the frame interval is known; a wrong first estimate is
    corrected."""
    errors = []
    for seed in range(8):
        runs = run_free(30.0, 0.08, jitter=0.005, cycles=3, seed=seed)
        *_, (estimator, truth) = runs
        errors.append(np.abs(estimator.parts.position - truth).max())
    assert np.median(errors) < 0.2e-3


def test_angles_are_those_between_cycles():
    """The part swings with the plate, and turns by 0.05 rad in a cycle."""
    estimator, angles = Estimator.of(RIG, T, 0.0), []
    for k in range(12):
        estimator = estimator.started(PlateCycle.rest(T), k * T)
        for t in k * T + np.arange(0.01, T, 0.016):
            swing = 0.4 * np.sin(np.pi * (t / T % 1)) ** 4
            seen = Parts.make(("black_1",), np.zeros((1, 2)), angle=np.array([0.5 * t + swing]))
            estimator = estimator.update(seen, t)
        angles.append((estimator.parts.angle[0] - 0.5 * k * T, estimator.parts.spin[0]))
    off, spin = np.array(angles[3:]).T
    assert np.abs(off).max() < 0.02
    assert spin == pytest.approx(np.full(len(spin), 0.5), abs=0.2)


def test_irregular_images_are_reported():
    world, none = World(2, 1.0), Estimator.of(RIG, T, 0.0)
    for rate, problem in (
        (10.0, ""), (5.0, ""), (12.4, ""), (13.7, "image rate is 13.7 per second"),
        (30.0, "image rate is 30 per second, but"),
    ):  # fmt: skip
        estimator = none
        for k in range(30):
            estimator = estimator.update(world.seen(), k / rate)
            estimator = estimator.record_cycle(PlateCycle.rest(T), k / rate)
        assert estimator.image_problem.startswith(problem)
        assert bool(estimator.image_problem) == bool(problem)
        assert estimator.image_rate == pytest.approx(rate, rel=1e-3)
    *_, (estimator, _) = run_free(7.0, 0.0, 0.0, cycles=20)
    one = "image rate is 7 per second, allowed: 10 or more (one per cycle)"
    assert estimator.image_problem == one
    for rate, problem in ((9.75, True), (9.85, False), (15.0, False)):
        *_, (estimator, _) = run_free(rate, 0.0, 0.0, cycles=20)
        assert bool(estimator.image_problem) is problem


def test_late_starts_of_answers_are_reported():
    estimator = Estimator.of(RIG, T, 0.0)
    for late, problem in (
        (0, ""),
        (1, "results start a cycle late"),
        (2, "results start 2 cycles late"),
    ):
        late_log = replace(estimator.log, delays=(late,) * 7)
        reported = replace(estimator, log=late_log).answer_problem
        assert reported.startswith(problem)
        assert bool(reported) == bool(problem)


@pytest.mark.parametrize("triggered", [True, False])
def test_unanswered_cycles_are_reported_with_possible_causes(triggered):
    rng = np.random.default_rng(0)
    estimator, cycle = Estimator.of(RIG, T, 0.0), shaken(rng)
    for k in range(100):
        if k % 10:  # else it begins again
            cycle = shaken(rng)
            estimator = estimator.record_cycle(cycle, T * (k - 0.5), T * (k - 1))
        if k == 20:
            estimator = estimator.begin_task()
            assert not estimator.unanswered_problem
        estimator = estimator.started(cycle, T * k, triggered)
    lacking = "images are missing, or " if triggered else ""  # else answers need none
    assert estimator.unanswered_problem == (
        f"8 of 80 cycles were not answered in time: {lacking}the computer or the line is too slow"
    )


def test_a_type_has_the_friction_of_its_file_until_measured():
    steel = PartType("nut", radius_m=0.008, symmetry=0, mass_kg=0.01, mu=0.1)
    rig = replace(load_rig(), types={"nut": steel})
    parts = Parts.make(("black_1", "nut_1"), np.zeros((2, 2)))
    estimator = Estimator.of(rig, 0.1, 0.0).update(parts, 0.0)
    assert estimator.friction == pytest.approx([1.0, 0.1 / rig.friction.mu])
    moving = estimator.record_cycle(PlateCycle.rest(0.1), 0.0).update(parts, 0.1).parts
    bounds = estimator.hypotheses.estimate.usual
    assert bounds == pytest.approx([0, np.log(0.1 / rig.friction.mu)])
    assert moving.friction_limit == pytest.approx([rig.force_unit, 0.1 * 9.81 * 0.01])
