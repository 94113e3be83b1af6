"""Following: paths, the PD step, and the whole, against plants that are written here."""

import re
from dataclasses import replace

import numpy as np
import pytest
from plant import MASS, RIG, Plant, T, ready, run
from scipy.integrate import solve_ivp

from plate_core import Parts, ScenarioError
from plate_core.tasks import PathTask, load_scenario
from plate_planner import FollowOptions, Planner, PlannerOptions
from plate_planner.estimation import LastRequest
from plate_planner.tasks import DriftInterval, Follower, Situation, pd_drift
from plate_planner.tasks.follow import CORNER_ACCEL
from plate_planner.tasks.path import PolygonPath

# Paths

SQUARE = ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1))


def square(**changes) -> PolygonPath:
    values = {"label": "black", "waypoint": SQUARE, "speed": 0.02, "closed": True, "laps": 1.0}
    return PolygonPath.from_task(PathTask(**(values | changes)))


@pytest.mark.parametrize("laps", [1.0, 2.5])
def test_arc_length_grows_at_the_speed_even_round_corners(laps):
    path = square(laps=laps)
    t = np.linspace(0, path.duration, 20001)
    travelled = np.sum(np.hypot(*np.diff(path.position(t), axis=0).T))
    assert travelled == pytest.approx(0.02 * path.duration, rel=1e-3)  # steps cut the corners
    assert path.duration == pytest.approx(laps * 0.4 / 0.02)


def test_corners_are_met_on_time():
    assert square().position(np.array([0.0, 5.0, 10.0, 15.0, 20.0])) == pytest.approx(
        np.array([*SQUARE, SQUARE[0]]), abs=1e-12
    )


def test_a_path_rests_before_its_start_and_after_its_end():
    path = square(closed=False)
    assert path.duration == pytest.approx(15.0)
    for t, corner in ((-1.0, SQUARE[0]), (15.0 + 1e-9, SQUARE[-1]), (99.0, SQUARE[-1])):
        assert path.position(t) == pytest.approx(np.array(corner))


def test_a_corner_belongs_to_the_edge_that_begins_there():
    assert square().heading(0.0) == pytest.approx(np.array([1.0, 0.0]))
    assert square().heading(5.0 + 1e-9) == pytest.approx(np.array([0.0, 1.0]))


PROFILE = ((0.0, 0.002), (0.25, 0.02), (0.6, 0.02), (1.0, 0.005))


@pytest.mark.parametrize("laps", [1.0, 2.25])
def test_a_speed_profile_is_what_an_integrator_makes_of_it(laps):
    path = square(profile=PROFILE, laps=laps)
    fraction, speed = np.array(PROFILE).T
    ran = solve_ivp(
        lambda t, s: np.interp(np.mod(s / path.length, 1), fraction, speed),
        (0, path.duration), [0.0], rtol=1e-9, atol=1e-12, max_step=0.05, dense_output=True,
    )  # fmt: skip
    assert ran.y[0, -1] == pytest.approx(laps * path.length, abs=2e-5)
    t = np.linspace(0.01, path.duration * 0.999, 500)
    corner = np.vstack([path.corner[:-1]] * 3 + [path.corner[:1]])
    arc = np.append(0.0, np.cumsum(np.hypot(*np.diff(corner, axis=0).T)))
    expected = np.column_stack([np.interp(ran.sol(t)[0], arc, axis) for axis in corner.T])
    assert path.position(t) == pytest.approx(expected, abs=2e-5)


def test_the_heading_is_the_direction_of_motion_and_the_speed_follows_the_profile():
    path, step = square(profile=PROFILE), 1e-4
    t = np.linspace(0.5, path.duration - 0.5, 41)
    velocity = (path.position(t + step) - path.position(t - step)) / (2 * step)
    clear = np.min(np.abs(path._arc_length_at(t)[:, None] - path.arc), axis=1) > 1e-4
    assert np.sum(clear) > 30
    speed = np.hypot(*velocity.T)
    assert path.heading(t)[clear] == pytest.approx((velocity / speed[:, None])[clear], abs=1e-6)
    expected = np.interp(path._arc_length_at(t) / path.length, *np.array(PROFILE).T)
    assert speed[clear] == pytest.approx(expected[clear], abs=1e-7)


# The PD step against a double integrator with one cycle of delay


def closed_loop(reference, start, cycles, kp, drift_gain=1.0, noise=0.0, limit=1.0):
    """Return the errors (cycles, 2) [m] of one part.

    The plant: the answer to the image at the start of cycle k is a force over cycle k+1, and a
    force F changes the drift from the one measured in that image by F T/m.
    """
    rng = np.random.default_rng(0)
    x, seen_before = np.array([start], float), np.array([start], float)
    coming = np.zeros((1, 2))  # drift of the cycle that is about to begin
    requested = LastRequest()
    errors = []
    for k in range(cycles):
        t = k * T
        errors.append((x - reference(t))[0])
        seen = x + noise * rng.normal(size=x.shape)
        v = (seen - seen_before) / T
        expected = pd_drift(
            seen + T * requested.drift_of(Parts.make(("black_1",), seen, v), t, T),
            reference(t + T),
            reference(t + 2 * T),
            T,
            kp,
            np.array([limit]),
        )
        part = Parts.make(("black_1",), seen, v)
        force, tolerance = DriftInterval(expected, expected).force(part, RIG, T)
        assert np.all(tolerance == 0)
        assert np.all(np.abs(force) <= RIG.force_unit + 1e-15)
        seen_before, x = seen, x + T * drift_gain * coming
        coming = v + force * T / MASS
        requested = LastRequest(("black_1",), coming, t)
    return np.array(errors)


def still(t):
    return np.zeros((1, 2))


def line(t):
    return np.array([[0.02 * max(t - T, 0), 0.0]])


@pytest.mark.parametrize("kp", [0.3, 0.6, 0.9])
def test_the_controller_converges_from_an_offset(kp):
    errors = closed_loop(still, (0.005, -0.003), 80, kp)
    assert np.max(np.abs(errors[-10:])) < 1e-6


def test_full_gain_is_deadbeat():
    errors = closed_loop(still, (0.005, -0.003), 6, kp=1.0)
    assert np.max(np.abs(errors[2:])) < 1e-12  # one cycle of delay, one to get there


def test_the_error_falls_by_the_gain_each_cycle():
    errors = closed_loop(still, (0.005, 0.0), 12, kp=0.4)[:, 0]
    assert errors[2:] / errors[1:-1] == pytest.approx(np.full(10, 0.6), abs=1e-9)


def test_the_controller_follows_constant_speed_without_error():
    errors = closed_loop(line, (0.0, 0.0), 100, kp=0.6)
    assert np.max(np.abs(errors)) < 1e-12


def test_a_plant_10_percent_off_leaves_a_small_steady_error():
    errors = closed_loop(line, (0.0, 0.0), 200, kp=0.6, drift_gain=0.9)
    # Drift 0.9 v_des = 0.02 needs v_des - v_ref = 0.02/9: a predicted error of that times T/kp.
    # The part is behind its prediction, too, by the drift that is missing: another 0.02/9 T.
    expected = 0.02 / 9 * T / 0.6 + 0.02 / 9 * T
    assert abs(errors[-1, 0]) == pytest.approx(expected, rel=1e-6)


def test_measurement_noise_is_not_amplified():
    errors = closed_loop(line, (0.0, 0.0), 2000, kp=0.6, noise=1e-4)
    assert np.sqrt(np.mean(errors**2)) < 2e-4


def test_the_requested_drift_is_bounded_in_magnitude_not_in_direction():
    far = np.array([[0.3, 0.4], [0.0, 0.001]])
    expected = pd_drift(np.zeros((2, 2)), far, far, T, 0.5, np.array([0.06, 0.06]))
    assert expected == pytest.approx(np.array([[0.036, 0.048], [0.0, 0.005]]))


def test_the_force_reproduces_the_requested_interval():
    rng = np.random.default_rng(1)
    velocity = 0.01 * rng.normal(size=(5, 2))
    request = DriftInterval(np.full((5, 2), -0.01), np.full((5, 2), 0.03))
    ids = tuple(f"black_{k}" for k in range(5))
    parts = Parts.make(ids, 0 * velocity, velocity)
    force, tolerance = request.force(parts, RIG, T)
    back = velocity + force * T / MASS
    assert back - tolerance * T / MASS == pytest.approx(request.low)
    assert back + tolerance * T / MASS == pytest.approx(request.high)


# The complete rules, with a plant that follows each request one cycle later


@pytest.mark.parametrize("shuffle", [False, True])
def test_the_planner_follows_the_rectangles_of_the_paper(shuffle):
    scenario = load_scenario("follow_2")
    plant = Plant(scenario, shuffle=shuffle, seed=5)
    _, _, progress = run(Planner(RIG, scenario), plant)
    assert progress.text.endswith(" s: error 0.00 mm RMS, maximum 0.00")
    assert "slowed" not in progress.text
    # Slower at eight corners, and at both ends; then it is seen at rest.
    assert 0 < progress.time_s - 0.56 / 0.04 - 3 * T < 0.5
    assert progress.rms_error_m < 1e-12  # a plant without error can be followed without error


def test_the_planner_follows_paths_with_disturbances():
    scenario = load_scenario("follow_2")
    plant = Plant(scenario, disturbance=1e-3)
    options = PlannerOptions(follow=FollowOptions(kp=0.3))
    _, _, progress = run(Planner(RIG, scenario, options), plant)
    assert progress.phase == "done"
    assert progress.rms_error_m < 1e-3
    assert progress.max_error_m < 3e-3


def test_following_corrects_an_offset_at_the_start():
    scenario = load_scenario("follow_2")
    plant = Plant(scenario)
    plant.position += [0.02, -0.01]
    planner = Planner(RIG, scenario)
    state, _, progress = run(planner, plant, cycles=100)
    reference = planner.rules.reference(state.memory, 100 * T)
    assert progress.phase == "running"
    assert np.max(np.abs(plant.position - reference)) < 1e-3


@pytest.mark.parametrize("far", [0.006, 0.05])
def test_parts_away_from_their_paths_are_led_to_them_first(far):
    scenario = load_scenario("follow_2")
    plant = Plant(scenario)
    plant.position += [-far / 2, far]
    maximum = 0.0
    planner = Planner(RIG, scenario)
    state = ready(planner, plant.seen())
    for k in range(1000):
        state, request, progress = planner.plan(state, plant.seen(), k * T)
        if progress.phase != "running":
            break
        if state.memory.leading:
            assert progress.max_error_m == 0  # the path has not begun
        plant.step(request)
        maximum = max(maximum, np.max(np.abs(plant.drift)))
    assert progress.phase == "done"
    assert progress.max_error_m <= 0.0045 + 1e-6  # nearer than where references slow down
    led = state.memory.approach_s
    assert 0 < progress.time_s - 0.56 / 0.04 - led - T < 0.7
    assert f"{led:.1f} s of the time to reach the starts" in progress.text
    assert maximum <= 0.05


@pytest.mark.parametrize(
    ("speed", "accel", "warning"),
    [
        (0.04, 100.0, ""),
        (0.08, 100.0, ""),
        (0.081, 100.0, "speed_mps is 0.081; 2 parts on this rig reach about 0.08 m/s"),
        (0.04, 10.0, "speed_mps is 0.04; 2 parts on this rig reach about 0.019 m/s"),
        (0.07, 10.0, "no motion of this plate moves a part faster than 0.062 m/s (a T/16)"),
    ],
)
def test_too_high_a_speed_is_reported_with_a_feasible_speed(speed, accel, warning):
    scenario = load_scenario("follow_2")
    paths = tuple(replace(path, speed=speed) for path in scenario.task.paths)
    rig = replace(RIG, limits=replace(RIG.limits, accel=accel))
    planner = Planner(rig, replace(scenario, task=replace(scenario.task, paths=paths)))
    warnings = planner.rules.warnings()
    assert bool(warnings) == bool(warning)
    assert warning in "".join(warnings)
    assert ("shakes too little" in "".join(planner.warnings())) == (accel == 10.0)


def test_a_path_that_takes_longer_than_the_time_limit_is_refused():
    scenario = replace(load_scenario("follow_2"), time_limit_s=10.0)
    with pytest.raises(ScenarioError, match=r"paths: path 1 takes 14 s .* at most time_limit_s"):
        Planner(RIG, scenario)
    Planner(RIG, replace(scenario, time_limit_s=14.1))


@pytest.mark.parametrize(
    ("name", "gamma", "warning"),
    [
        ("sort_4", 7.1, ""),
        ("sort_4", 4.9, "expect the task to take longer"),
        ("sort_10", 7.1, ""),
        ("sort_10", 4.9, "several times as long, and some runs may exceed time_limit_s, 1"),
    ],
)
def test_a_plate_that_shakes_too_little_is_reported_with_the_consequences(name, gamma, warning):
    rig = replace(RIG, limits=replace(RIG.limits, accel=gamma * RIG.friction.accel))
    warnings = Planner(rig, load_scenario(name)).warnings()
    assert bool(warnings) == bool(warning)
    assert warning in "".join(warnings)


def test_a_part_that_starts_near_its_path_is_not_led():
    scenario = load_scenario("follow_2")
    plant = Plant(scenario)
    plant.position += [0.004, 0.0]
    state, _, progress = run(Planner(RIG, scenario), plant, cycles=20)
    assert (progress.phase, state.memory.leading, state.memory.approach_s) == (
        "running",
        False,
        0.0,
    )


def test_references_wait_for_a_part_that_stays_behind_and_then_it_is_stuck():
    scenario = load_scenario("follow_2")
    plant = Plant(scenario)
    plant.answer = lambda last_request: np.zeros((2, 2))
    _, last_request, progress = run(Planner(RIG, scenario), plant)
    assert progress.speed_scaling == 0
    assert 0.0045 < progress.max_error_m <= 0.5 * scenario.task.max_error_m + 1e-3
    assert progress.text.startswith("stuck after ")
    assert "no progress for 30 s; black_" in progress.text
    assert "requested drift was (" in progress.text
    assert (
        "its actual drift was (0.0, 0.0) mm/s; friction.mu or the motors may differ"
        in progress.text
    )
    assert len(last_request.parts) == 0


def test_a_part_pushed_far_off_its_path_ends_the_task():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=50)
    plant.position[1] += [0.0, 0.04]
    _, request, progress = planner.plan(state, plant.seen(), 5.0)
    reported = (
        r"stuck after 5\.0 s: black_2 at \(0\.\d+, 0\.\d+\) m is 40\.0 mm off its path, allowed: 30"
    )
    assert re.match(reported, progress.text)
    assert len(request.parts) == 0


class Weak(Plant):
    """A plant on which parts get a fraction of the requested drift, up to a bound."""

    share, bound = 1.0, np.inf

    def answer(self, last_request):
        drift = self.share * super().answer(last_request)
        return np.clip(drift, -self.bound, self.bound)


def test_the_observer_compensates_for_weak_friction():
    errors = {}
    for gain in (0.0, 0.7):
        plant = Weak(load_scenario("follow_2"))
        plant.share = 0.8
        options = PlannerOptions(follow=FollowOptions(observer_gain=gain))
        planner = Planner(RIG, plant.scenario, options)
        state, _, _ = run(planner, plant, cycles=60)
        errors[gain] = np.max(planner.rules.errors(state.memory, plant.seen(), 60 * T))
    # Without: (1/0.8 - 1) v (1 + 1/kp) T, as in test_pd, of which 0.8 arrives. With: none is left.
    assert errors[0.0] > 0.8e-3
    assert errors[0.7] < 0.02 * errors[0.0]


def test_the_planner_slows_down_if_the_plate_cannot_reach_the_speed():
    plant = Weak(load_scenario("follow_2"))
    plant.bound = 0.014  # of the 40 mm/s that the paths are run at
    _, _, progress = run(Planner(RIG, plant.scenario), plant)
    assert progress.phase == "done"
    assert progress.pace == pytest.approx(0.56 / 0.04 / (progress.time_s - T), rel=0.01)
    assert f"slowed down to {100 * progress.pace:.0f} % of the requested speed" in progress.text
    assert 0.9 < progress.time_s / (0.56 / 0.014) < 1.1
    assert progress.max_error_m < 0.016


@pytest.mark.parametrize(("fraction", "scalings"), [(0.05, (1.0, 1.0)), (0.2, (0.7, 0.49))])
def test_references_slow_down_as_soon_as_a_cycle_falls_short_of_the_request(fraction, scalings):
    scenario = load_scenario("follow_2")
    plant, follower = Plant(scenario), Follower(scenario.task, RIG)
    memory = follower.begin(plant.seen(), 0.0)
    for k in range(12):
        seen = Parts.make(plant.ids, follower.reference(memory, k * T))  # no error at all as yet
        short = np.array([fraction * 0.04 if k < len(scalings) else 0.0, 0.0])
        start = (k + 1) * T
        now = Situation(
            seen, k * T, start, start, T, True, True, seen.position, short, True, seen, 0.0
        )
        memory = follower.measure(memory, now)
        if k < len(scalings):
            assert memory.scaling[1] == pytest.approx(scalings[k])
    assert memory.scaling[1] == 1.0


def test_references_set_by_another_program_stay_for_any_image():
    scenario = load_scenario("follow_2")
    plant, follower = Plant(scenario), Follower(scenario.task, RIG)
    memory = replace(follower.begin(plant.seen(), 0.0), anchor=1.0, progress=0.8, fixed=True)
    seen = Parts.make(plant.ids, follower.reference(memory, 2.0) + [0.003, 0.0])
    short = np.array([0.02, 0.0])
    now = Situation(seen, 2.0, 2.1, 2.1, T, True, True, seen.position, short, True, seen, 0.0)
    after = follower.measure(memory, now)
    assert after.rms_error_m == pytest.approx(0.003)
    assert (after.anchor, after.progress, after.scaling) == (1.0, 0.8, memory.scaling)
    assert follower.measure(replace(memory, fixed=False), now).scaling[1] < 1


@pytest.mark.parametrize("speed", [0.08, 0.2])
def test_references_slow_down_before_corners(speed):
    scenario = load_scenario("follow_2")
    paths = tuple(replace(path, speed=speed) for path in scenario.task.paths)
    plant, follower = Plant(scenario), Follower(replace(scenario.task, paths=paths), RIG)
    memory, places = follower.begin(plant.seen(), 0.0), []
    while not follower.finished(memory, len(places) * T):
        places.append(follower.reference(memory, len(places) * T))
        stamp, none = len(places) * T, np.zeros(2)
        seen = Parts.make(plant.ids, follower.reference(memory, stamp))  # no error at all
        now = Situation(
            seen, stamp, stamp + T, stamp + T, T, True, True, seen.position, none, True, seen, 0.0
        )
        memory = follower.measure(memory, now)
    change = np.hypot(*np.diff(places, n=2, axis=0).T)
    allowed = CORNER_ACCEL * RIG.friction.accel * T**2
    assert np.max(change) < 2 * allowed < 0.55 * np.sqrt(2) * speed * T
    assert np.max(np.hypot(*np.diff(places, axis=0).T)) > 0.075 * T


@pytest.mark.parametrize("known", [True, False])
def test_requests_are_small_until_the_age_of_images_is_known(known):
    scenario = load_scenario("follow_2")
    plant, follower = Plant(scenario), Follower(scenario.task, RIG)
    seen = Parts.make(plant.ids, follower.reference(follower.begin(plant.seen(), 0.0), 0.0))
    wrong, short = seen.position + 0.01, np.zeros(2)
    now = Situation(seen, 0.0, T, T, T, True, known, wrong, short, True, seen, 0.0)
    _, found = follower.assess(None, now)
    speed = np.hypot(*found.request.low.T)
    assert np.all(speed > 0.04) if known else np.all(speed <= 0.3 * 0.04 + 1e-9)


@pytest.mark.parametrize("late", [0, 1, 3])
def test_errors_are_corrected_the_less_the_later_answers_begin(late):
    scenario = load_scenario("follow_2")
    plant, follower = Plant(scenario), Follower(scenario.task, RIG)
    seen = Parts.make(plant.ids, follower.reference(follower.begin(plant.seen(), 0.0), 0.0))
    requested = []
    for error in (0.0, 0.001):
        at = seen.position + [error, 0.0]
        now = Situation(seen, 0.0, T, T, T, True, True, at, np.zeros(2), True, seen, 0.0, late=late)
        requested.append(follower.assess(None, now)[1].request.low)
    assert requested[1] - requested[0] == pytest.approx(
        np.array([[-0.8e-3 / T / (1 + late), 0.0]] * 2)
    )


def test_a_persistent_shortfall_does_not_stop_the_references():
    scenario = load_scenario("follow_2")
    plant, follower = Plant(scenario), Follower(scenario.task, RIG)
    memory = follower.begin(plant.seen(), 0.0)
    short = np.full(2, 0.2 * 0.04)
    for k in range(100):
        seen = Parts.make(plant.ids, follower.reference(memory, k * T))
        start = (k + 1) * T
        now = Situation(
            seen, k * T, start, start, T, True, True, seen.position, short, True, seen, 0.0
        )
        memory = follower.measure(memory, now)
    before = follower.to_go(memory, 100 * T)
    assert 0 < memory.scaling[1] < 0.1
    assert follower.to_go(memory, 101 * T) < before


def test_a_part_that_returns_with_a_new_id_continues_its_path():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=20)
    plant.ids = ("black_1", "black_9")
    _, _, progress = run(planner, plant, t=20 * T, state=state)
    assert progress.phase == "done"
    assert progress.max_error_m < 1e-3
