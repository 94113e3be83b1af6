"""Friction from pushes: the model against closed forms, the procedure against a made-up world."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, PlateError, load_rig
from plate_core.motion import usage
from plate_driver.friction import (
    FrictionMeasurement,
    Rest,
    Stage,
    make_push,
    max_accel,
    rig_mu,
    slip,
)
from plate_driver.friction.push import BRAKE, push_length

RIG = load_rig()
G = RIG.friction.gravity
PLACES = {"black_1": (-0.1, 0.05), "black_2": (0.1, 0.05), "grey_1": (0.0, -0.05)}


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_push_begins_and_ends_at_home_and_keeps_the_limits(axis, sign):
    push = make_push(RIG, axis, sign, 8.0, 0.5)
    cycle = push.cycle
    assert cycle.starts_at_rest
    assert not np.any(cycle.tail.state(-1))
    t = np.linspace(0, cycle.period, 5000)
    pose, accel = cycle.pose(t), cycle.accel(t)[:, axis] * sign
    assert np.ptp(pose[:, axis]) == pytest.approx(push_length(RIG), rel=1e-6)
    assert np.max(np.abs(np.delete(pose, axis, 1))) == 0
    assert np.max(accel) == pytest.approx(8.0, rel=1e-3)
    assert np.min(accel) == pytest.approx(-8.0 * BRAKE, rel=1e-3)
    assert usage(RIG, cycle).overall < 1


def sharp(accel, mu, way):
    """Slip [m] of a push without ramps, by the closed form at the head of push.py."""
    r, first = mu * G / accel, way * BRAKE / (1 + BRAKE)
    return first * (1 - r) * (1 + BRAKE) / (r + BRAKE)


@pytest.mark.parametrize("mu", [0.15, 0.3, 0.6])
@pytest.mark.parametrize("times", [1.3, 1.7, 2.2])
def test_the_slip_is_that_of_the_closed_form(monkeypatch, mu, times):
    monkeypatch.setattr("plate_driver.friction.push.RAMP", 0.005)
    accel = times * mu * G
    push = make_push(RIG, 0, 1, accel, 0.3)
    [found] = slip(push, np.array([mu]), 0.0, G)
    assert found == pytest.approx(sharp(accel, mu, push_length(RIG)), rel=0.01)


def test_a_part_holds_up_to_static_friction():
    push = make_push(RIG, 0, 1, 3.0, 0.3)
    mu, hold = np.array([0.2, 0.2, 0.2, 0.31]), np.array([2.99, 3.01, 0.0, 0.0])
    slips = slip(push, mu, hold, G)
    assert slips[1] == slips[3] == pytest.approx(0, abs=1e-9)
    assert slips[0] == pytest.approx(slips[2], rel=0.1)
    assert slips[2] > 1e-3


def measured(
    mu, static=1.0, noise=1e-5, places=PLACES, rig=RIG, wrong=1.0, seed=0, along=(1.0, 1.0)
):
    """Measure in a world of the closed integral: mu and static ratio by part; `along` are factors
    of mu along x and y."""
    rng, shape = np.random.default_rng(seed), (len(places), 2)
    place = {name: np.array(xy) for name, xy in places.items()}

    def look():
        true = np.array([*place.values()]).reshape(shape)
        images = [Parts.make(tuple(place), true + rng.normal(0, noise, shape)) for _ in range(4)]
        return Rest.of(images)

    measurement = FrictionMeasurement.start(rig, look())
    while (push := measurement.push) is not None:
        assert usage(rig, push.cycle).overall < 1
        values = along[push.axis] * np.array([mu[name] for name in place])
        lags = slip(push, values, static * values * G, G)
        for name, lag in zip(place, lags, strict=True):
            place[name] = place[name] - wrong * lag * push.sign * np.eye(2)[push.axis]
            room = rig.plate.half - np.abs(place[name])
            assert np.min(room) > rig.edge_margin(name[:-2]).wall_m
        measurement = measurement.after(look())
    back = [np.hypot(*(place[name] - places[name])) for name in places]
    assert max(back) < 0.005  # pushes alternate
    return measurement.result


@pytest.mark.parametrize("static", [1.0, 1.25])
def test_mu_of_each_part_and_the_static_ratio(static):
    true = {"black_1": 0.2, "black_2": 0.26, "grey_1": 0.22}
    found = measured(true, static)
    for part in found.parts:
        assert part.mu == pytest.approx(true[part.id], rel=0.01)
        assert part.error < 0.01 * part.mu
    values = list(true.values())
    assert found.mu == pytest.approx(np.mean(values), rel=0.01)
    assert found.error == pytest.approx(np.std(values, ddof=1) / np.sqrt(3), rel=0.1)
    assert found.between_parts == pytest.approx(np.std(values, ddof=1) / np.mean(values), rel=0.1)
    assert found.over_plate < 0.01
    assert found.static_ratio == pytest.approx(static, abs=0.04)
    assert abs(found.static_ratio - static) < 3 * found.static_error < 0.15
    assert found.notes == ()


@pytest.mark.parametrize(("grey", "reported"), [(0.25, True), (0.295, False)])
def test_mu_that_differs_between_types_is_reported(grey, reported):
    places = PLACES | {"grey_2": (0.2, -0.05)}
    true = {"black_1": 0.3, "black_2": 0.302, "grey_1": grey, "grey_2": grey + 0.002}
    found = measured(true, places=places)
    assert len(found.notes) == reported
    assert not reported or f"black 0.301, grey {grey + 0.001:.3f}" in found.notes[0]


def test_the_standard_error_is_that_of_repeated_measurements():
    """A noisier camera: errors over their standard errors have a variance of 1."""
    many = {
        f"black_{5 * k + n}": (0.1 * k - 0.2, 0.05 * n - 0.1) for k in range(5) for n in range(5)
    }
    true = dict.fromkeys(many, 0.25)
    parts = [
        p for seed in range(2) for p in measured(true, noise=8e-5, places=many, seed=seed).parts
    ]
    ratio = np.array([(part.mu - 0.25) / part.error for part in parts])
    assert 0.7 < np.sqrt(np.mean(ratio**2)) < 1.4
    assert np.mean([part.error for part in parts]) > 1e-4


@pytest.mark.parametrize("along", [(1.15, 0.85), (0.85, 1.15)])
def test_mu_that_differs_along_x_and_y_is_reported_and_does_not_change_the_static_ratio(along):
    found = measured(dict.fromkeys(PLACES, 0.3), 1.1, along=along)
    assert found.static_ratio == pytest.approx(1.1, abs=0.04)
    assert f"{0.3 * along[0]:.3f} along x and {0.3 * along[1]:.3f} along y" in found.notes[0]


def test_a_part_that_does_not_slide_is_left_out():
    found = measured({"black_1": 0.2, "black_2": 0.2, "grey_1": 3.0})
    assert [part.id for part in found.parts] == ["black_1", "black_2"]
    assert "grey_1 is excluded, because it does not slide" in found.notes[0]


def test_parts_far_from_the_others_friction_are_left_out():
    found = measured({"black_1": 0.25, "black_2": 0.25, "grey_1": 0.09})
    assert [part.id for part in found.parts] == ["black_1", "black_2"]
    assert "grey_1 is excluded, because its mu is about 0.09" in found.notes[0]


def refused(match, mu=0.25, **world):
    with pytest.raises(PlateError, match=match):
        measured(dict.fromkeys(world.get("places", PLACES), mu), **world)


def test_a_friction_measurement_that_is_not_possible_is_refused_with_the_reason():
    refused("no part is detected, allowed: one or more", places={})
    refused("black_1 is 10 mm from an edge, allowed: 26 mm or more", places={"black_1": (0.29, 0)})
    near = {"black_1": (0.0, 0.0), "black_2": (0.018, 0.0)}
    refused("black_1 and black_2 are 2.0 mm apart, allowed: 4 mm or more", places=near)
    refused("moved .* mm in the direction of the push, allowed: against it", wrong=-1.0)
    weak = replace(RIG, limits=replace(RIG.limits, accel=2.0))
    refused("did not slide at .* mu is above 0.1", rig=weak)
    refused("did not slide .*, or the plate does not move", wrong=0.0)
    refused("slid .* Either mu is below 0.033", mu=0.02)
    refused("does not slide at .* static friction may be above 1.7", static=1.8)
    refused("slid .* or static friction is about twice", static=2.49)
    refused("the camera's noise is .* allowed: .*20 times", noise=2.5e-4)


def test_parts_that_still_move_are_no_rest():
    images = [Parts.make(("black_1",), np.array([[0.001 * k, 0.0]])) for k in range(4)]
    assert Rest.of(images) is None
    lost = [images[0], Parts.make((), np.zeros((0, 2)))]
    assert not Rest.of(lost).position


def test_parts_that_are_lost_from_sight_end_it():
    images = [Parts.make(tuple(PLACES), np.array([*PLACES.values()]))] * 2
    measurement = FrictionMeasurement.start(RIG, Rest.of(images))
    assert measurement.stage is Stage.SEARCH
    one = [Parts.make(("black_1",), np.array([PLACES["black_1"]]))] * 2
    with pytest.raises(PlateError, match=r"1 of 3 parts are detected .*, allowed: half"):
        measurement.after(Rest.of(one))


def test_parts_that_touch_after_a_push_end_it():
    def rest(step):
        """Two parts side by side along each axis; of each pair the one ahead has moved back."""
        gap = 2 * RIG.part_type("black").reach_m + 0.0045
        place = {
            "black_1": (0, 0), "black_2": (gap, 0), "black_3": (-gap, 0), "black_4": (0, gap),
            "black_5": (0, -gap),
        }  # fmt: skip
        at = np.array([*place.values()], float)
        along = np.eye(2)[push.axis] * push.sign if step else np.zeros(2)
        at[at @ along > 0] -= step * along
        return Rest.of([Parts.make(tuple(place), at)] * 2)

    push = None
    measurement = FrictionMeasurement.start(RIG, rest(0.0))
    push = measurement.push
    assert measurement.after(rest(0.001)).todo != measurement.todo
    with pytest.raises(PlateError, match=r"black_1 and black_\d are 0\.[0-5] mm apart, allowed"):
        measurement.after(rest(0.0043))


def test_the_greatest_acceleration_is_within_the_limits():
    for rig in (RIG, load_rig("desk"), load_rig("voice_coils")):
        maximum = max_accel(rig, 0.3)
        assert 0.5 < usage(rig, make_push(rig, 0, 1, maximum, 0.3).cycle).overall < 1


def test_the_rig_files_mu_is_that_of_parts_without_one_of_their_own():
    found = measured({"black_1": 0.2, "black_2": 0.2, "grey_1": 0.3})
    kind = RIG.part_type("grey")
    rig = replace(RIG, types={"grey": replace(kind, mu=0.4)})
    assert rig_mu(rig, found) == pytest.approx(0.2, rel=0.01)
    both = {name: replace(kind, name=name, mu=0.4) for name in ("black", "grey")}
    with pytest.raises(PlateError, match="types of all parts have a separate mu, allowed"):
        rig_mu(replace(RIG, types=both), found)
