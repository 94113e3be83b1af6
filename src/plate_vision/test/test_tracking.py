"""Ids and drift against motions that are known."""

import numpy as np
import pytest

from plate_vision import OptionError, Tracker, TrackerOptions, TrackError
from plate_vision.overlooked import OVERLOOKED
from plate_vision.tracking import found_text, update

DT = 0.05


def follow(frames, options=None, dt=DT):
    """Take in frames of (position, label); return the part sets seen after each."""
    tracker = Tracker(options or TrackerOptions())
    answers = []
    for k, (position, label) in enumerate(frames):
        tracker = update(tracker, k * dt, np.array(position, float), label)
        answers.append(tracker.parts)
    return answers


def test_first_names_from_left_to_right():
    position = [[0.2, 0], [-0.1, 0.1], [0.0, 0.0], [-0.2, 0.0]]
    parts = follow([(position, ["black", "grey", "black", "grey"])])[0]
    assert parts.ids == ("black_1", "black_2", "grey_1", "grey_2")
    assert parts.position.tolist() == [[0, 0], [0.2, 0], [-0.2, 0], [-0.1, 0.1]]
    assert np.all(parts.velocity == 0)


def test_without_detections_there_are_no_parts():
    empty = (np.empty((0, 2)), [])
    for parts in follow([empty, empty]):
        assert parts.ids == ()
        assert parts.position.shape == parts.velocity.shape == (0, 2)


def test_ids_stay_over_1000_frames(rng):
    """Ten parts that wander at random, turn at the rim, and keep apart by twice their radius."""
    count, speed, near = 10, 0.06, 0.016
    x, y = np.meshgrid(np.linspace(-0.25, 0.25, 5), [-0.08, 0.08])
    position = np.stack([x.ravel(), y.ravel()], axis=1)
    label = np.array(["black", "grey"])[rng.integers(0, 2, count)]
    heading = rng.uniform(0, 2 * np.pi, count)
    tracker = Tracker()
    names = None
    for k in range(1000):
        heading += 0.5 * rng.standard_normal(count)
        move = speed * DT * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        for i in range(count):
            target = position[i] + move[i]
            gap = np.hypot(*(np.delete(position, i, axis=0) - target).T)
            if np.all(np.abs(target) < [0.29, 0.14]) and gap.min() > near:
                position[i] = target
            else:
                heading[i] += np.pi / 2
        order = rng.permutation(count)
        seen = position[order] + 1e-5 * rng.standard_normal((count, 2))
        tracker = update(tracker, k * DT, seen, label[order])
        parts = tracker.parts
        gap = np.linalg.norm(parts.position[:, None] - position[None], axis=2)
        assert gap.min(axis=1).max() < 1e-4
        here = dict(zip(parts.ids, gap.argmin(axis=1).tolist(), strict=True))
        names = names or here
        assert here == names
        assert all(label[i] == name.split("_")[0] for name, i in here.items())


def test_parts_of_one_class_that_cross():
    """Where they pass, each is nearer to the other's last position than to its own."""
    t = (np.arange(40) + 0.5) * DT
    right = np.stack([-0.1 + 0.1 * t, np.full_like(t, 0.002)], axis=1)
    left = np.stack([0.1 - 0.1 * t, np.full_like(t, -0.002)], axis=1)
    answers = follow([([a, b], ["grey", "grey"]) for a, b in zip(right, left, strict=True)])
    for parts, a, b in zip(answers, right, left, strict=True):
        assert parts.ids == ("grey_1", "grey_2")
        assert np.allclose(parts.position, [a, b])


def test_parts_of_two_classes_that_swap_places():
    a, b = [0.0, 0.0], [0.016, 0.0]
    before, after = follow([([a, b], ["black", "grey"]), ([a, b], ["grey", "black"])])
    assert before.ids == after.ids == ("black_1", "grey_1")
    assert after.position.tolist() == [b, a]


def test_choice_is_the_best_for_all():
    """Part by part, the nearest first, would give the second the first's place and lose one."""
    before = [[0.0, 0.0], [0.018, 0.0]]
    after = [[0.011, 0.0], [0.029, 0.0]]
    parts = follow([(before, ["grey"] * 2), (after, ["grey"] * 2)])[1]
    assert parts.ids == ("grey_1", "grey_2")
    assert parts.position.tolist() == after


def test_missed_parts_are_not_published_and_keep_their_id():
    drift = np.array([0.04, 0.0])
    both = [(np.array([[0, 0], [0, 0.1]]) + k * DT * drift, ["black", "black"]) for k in range(12)]
    frames = [
        (position[1:], label[1:]) if 3 <= k < 8 else (position, label)
        for k, (position, label) in enumerate(both)
    ]
    answers = follow(frames, TrackerOptions(max_missed=5))
    for k, parts in enumerate(answers):
        assert parts.ids == (("black_2",) if 3 <= k < 8 else ("black_1", "black_2"))
    # Over the gap the drift is that between the two images in which the part was seen.
    assert np.allclose(answers[8].velocity, drift)


def test_parts_missed_too_long_are_retired():
    seen, unseen = ([[0.0, 0.0]], ["grey"]), (np.empty((0, 2)), [])
    back = follow([seen, *[unseen] * 5, seen], TrackerOptions(max_missed=5))[-1]
    assert back.ids == ("grey_1",)
    back = follow([seen, *[unseen] * 6, seen, seen], TrackerOptions(max_missed=5))[-1]
    assert back.ids == ("grey_2",)  # numbers are not used twice
    back = follow([seen, unseen, seen], TrackerOptions(max_missed=0, confirm=1))[-1]
    assert back.ids == ("grey_2",)


def test_new_parts_get_new_numbers():
    one = ([[0.0, 0.0]], ["grey"])
    two = ([[0.0, 0.0], [-0.1, 0.0]], ["grey", "grey"])
    answers = follow([one, two, two])
    assert answers[1].ids == ("grey_1",)
    assert answers[2].ids == ("grey_1", "grey_2")
    assert answers[2].position.tolist() == [[0, 0], [-0.1, 0]]
    assert answers[2].velocity.tolist() == [[0, 0], [0, 0]]


@pytest.mark.parametrize("confirm", [1, 2, 3])
def test_an_object_with_too_few_consecutive_detections_is_no_part(confirm):
    """Specks that come and go at one place: never in `confirm` images in a row."""
    empty = (np.empty((0, 2)), [])
    part, both = ([[0.0, 0.0]], ["grey"]), ([[0.0, 0.0], [0.1, 0.0]], ["grey", "grey"])
    options = TrackerOptions(confirm=confirm)
    speck = [both] * (confirm - 1)
    for parts in follow([empty, part, *speck, part, *speck, part], options)[1:]:
        assert parts.ids == ("grey_1",)
    assert follow([part, *speck, both], options)[-1].ids == ("grey_1", "grey_2")


@pytest.mark.parametrize(("jump", "name"), [(0.0199, "grey_1"), (0.0201, "grey_2")])
def test_a_detection_beyond_the_gate_is_another_part(jump, name):
    options = TrackerOptions(gate_m=0.02, confirm=1)
    answers = follow([([[0, 0]], ["grey"]), ([[jump, 0]], ["grey"])], options)
    assert answers[1].ids == (name,)


def test_ids_stay_when_a_crowd_is_missed_and_specks_come(rng):
    """Twelve parts of one class at speeds up to 60 mm/s, a tenth missed, a tenth of specks."""
    count, options, tracker = 12, TrackerOptions(), Tracker()
    phase, rate = rng.uniform(0, 2 * np.pi, (2, count)), rng.uniform(0.5, 1.5, (2, count))
    middle = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 4), [-0.1, 0, 0.1]), axis=2).reshape(-1, 2)
    owner, nearest, seen_as = {}, np.inf, 0
    for k in range(1000):
        position = middle + [0.05, 0.045] * np.sin(phase + rate * k * DT).T
        gap = np.linalg.norm(position[:, None] - position, axis=2)
        nearest = min(nearest, gap[~np.eye(count, dtype=bool)].min())
        here = np.flatnonzero(rng.random(count) > 0.1) if k else np.arange(count)
        specks = rng.uniform([-0.3, -0.15], [0.3, 0.15], (rng.binomial(count, 0.01), 2))
        places = np.concatenate(
            [position[here] + 2e-5 * rng.standard_normal((len(here), 2)), specks]
        )
        tracker = update(tracker, k * DT, places, ["grey"] * len(places))
        for name, place in zip(tracker.parts.ids, tracker.parts.position, strict=True):
            true = int(np.argmin(np.linalg.norm(position - place, axis=1)))
            if np.linalg.norm(position[true] - place) < 1e-3:
                assert owner.setdefault(name, true) == true, f"image {k}: {name}"
                seen_as += 1
    assert nearest < 0.9 * options.gate_m
    assert seen_as > 0.85 * 1000 * count
    assert tracker.last_number["grey"] >= count


def test_a_crowd_that_turns_round_at_70_mm_per_s_keeps_its_ids(rng):
    x, y = np.meshgrid(np.linspace(-0.25, 0.25, 10), np.linspace(-0.1, 0.1, 5))
    start = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.008, 0.008, (50, 2))
    swirl = np.column_stack([-start[:, 1], start[:, 0]])
    swirl *= 0.014 / np.max(np.hypot(*start.T))  # 14 mm in a cycle
    turned = [abs(k % 10 - 5) for k in range(30)]  # there and back
    seen = follow([(start + n * swirl, ["black", "grey"] * 25) for n in turned], dt=0.2)
    first = start + turned[0] * swirl
    order = [int(np.argmin(np.sum((first - at) ** 2, axis=1))) for at in seen[0].position]
    for n, parts in zip(turned, seen, strict=True):
        assert parts.ids == seen[0].ids
        assert parts.position == pytest.approx((start + n * swirl)[order])


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_velocity_is_the_drift_over_the_last_frames(frames):
    """On x = a t2/2 the mean over n dt is a (t - n dt/2): the delay that smoothing costs."""
    accel = 0.1
    t = np.arange(20) * DT
    path = [([[0.5 * accel * s**2, -0.01 * s]], ["black"]) for s in t]
    answers = follow(path, TrackerOptions(velocity_frames=frames))
    for k in range(frames, 20):
        expected = [accel * (t[k] - frames * DT / 2), -0.01]
        assert np.allclose(answers[k].velocity, [expected])


def test_velocity_with_uneven_stamps():
    tracker = Tracker()
    for stamp in (10.0, 10.03, 10.2, 10.25):
        tracker = update(tracker, stamp, [[0.02 * stamp, 0.0]], ["grey"])
        if stamp > 10:
            assert np.allclose(tracker.parts.velocity, [[0.02, 0]])


def test_two_stamps_next_to_each_other_do_not_throw_a_part_far_ahead():
    tracker = Tracker()
    for stamp, x in ((1.0, 0.0), (1.0001, 0.003), (1.02, 0.004), (1.033, 0.002)):
        tracker = update(tracker, stamp, [[x, 0.0]], ["grey"])
        assert tracker.parts.ids == ("grey_1",)


def test_same_stamp_gives_the_same_answer():
    tracker = update(Tracker(), 1.0, [[0.0, 0.0]], ["grey"])
    tracker = update(tracker, 1.05, [[0.001, 0.0]], ["grey"])
    again = update(tracker, 1.05, [[0.001, 0.0]], ["grey"])
    assert again is tracker
    assert again.parts.velocity.tolist() == tracker.parts.velocity.tolist() != [[0, 0]]


def test_earlier_stamp_restarts_tracking():
    tracker = update(Tracker(), 5.0, [[0.0, 0.0], [0.1, 0.0]], ["grey", "grey"])
    tracker = update(tracker, 5.05, [[0.1, 0.0]], ["grey"])
    assert tracker.parts.ids == ("grey_2",)
    tracker = update(tracker, 0.05, [[0.1, 0.0]], ["grey"])
    assert tracker.parts.ids == ("grey_1",)
    assert tracker.parts.velocity.tolist() == [[0, 0]]
    assert len(tracker.tracks) == 1


def test_a_step_leaves_the_old_state_as_it_was():
    position = np.array([[0.0, 0.0]])
    first = update(Tracker(), 0.0, position, ["grey"])
    before = first.parts
    update(first, DT, position + 0.01, ["grey"])
    position += 1
    assert np.array_equal(first.parts.position, before.position)
    assert first.parts.ids == before.ids


def test_a_long_pause_loses_no_parts():
    """A part at rest is found again where it was, even though it drifted before."""
    tracker = update(Tracker(), 0.0, [[0.0, 0.0]], ["grey"])
    tracker = update(tracker, DT, [[0.0005, 0.0]], ["grey"])
    tracker = update(tracker, 60.0, [[0.0005, 0.0]], ["grey"])
    assert tracker.parts.ids == ("grey_1",)


@pytest.mark.parametrize(
    ("stamp", "position", "label"),
    [
        (0.0, [[0, 0]], []),
        (0.0, [[0, 0]], ["grey", "grey"]),
        (0.0, [[np.nan, 0]], ["grey"]),
        (0.0, [[0, np.inf]], ["grey"]),
        (np.nan, [[0, 0]], ["grey"]),
    ],
)
def test_wrong_measurements_are_refused(stamp, position, label):
    with pytest.raises(TrackError, match="allowed: "):
        update(Tracker(), stamp, position, label)


@pytest.mark.parametrize(
    ("name", "value"), [("gate_m", 0.0), ("max_missed", -1), ("velocity_frames", 0)]
)
def test_wrong_options_are_refused(name, value):
    with pytest.raises(OptionError, match=f"{name} is .*allowed: "):
        TrackerOptions(**{name: value})


def test_overlooked_things_are_those_of_the_last_image():
    things = np.array([(10.0, 20.0, 4.0, 0.1, -0.1, "too small")], OVERLOOKED)
    tracker = update(Tracker(), 0.0, [[0.0, 0.0]], ["grey"], overlooked=things)
    assert tracker.overlooked["reason"].tolist() == ["too small"]
    assert len(update(tracker, 0.0, [[0.0, 0.0]], ["grey"]).overlooked) == 1  # the same image
    assert len(update(tracker, 0.2, [[0.0, 0.0]], ["grey"]).overlooked) == 0
    assert len(Tracker().overlooked) == 0


def test_an_unknown_reason_is_refused():
    things = np.array([(10.0, 20.0, 4.0, 0.1, -0.1, "ugly")], OVERLOOKED)
    with pytest.raises(TrackError, match="reason is 'ugly', allowed: too small, too large"):
        update(Tracker(), 0.0, [[0.0, 0.0]], ["grey"], overlooked=things)
    with pytest.raises(TrackError, match="overlooked is float64"):
        update(Tracker(), 0.0, [[0.0, 0.0]], ["grey"], overlooked=np.zeros(3))


def test_parts_without_a_class_are_counted_separately():
    def text(*labels):
        place = np.column_stack([np.arange(len(labels)) * 0.05, np.zeros(len(labels))])
        return found_text(update(Tracker(), 0.0, place, list(labels)))

    assert text("grey", "unknown", "black", "grey") == "3 parts: 1 black, 2 grey; 1 unknown"
    assert text("group", "unknown", "group") == "no parts; 1 unknown; 2 group"
    assert text("nut") == "1 part: 1 nut"
    assert text() == "no parts"


def test_an_object_at_the_detection_limit_keeps_its_id():
    """Its name is kept for longer than a part's: so it is published as soon as it is seen again."""
    tracker = Tracker(TrackerOptions(max_missed=5))
    place = np.array([[0.0, 0.0], [0.1, 0.0]])
    tracker = update(tracker, 0.0, place, ["grey", "unknown"])
    for k in range(1, 31):
        tracker = update(tracker, 0.05 * k, np.zeros((0, 2)), [])
    tracker = update(tracker, 0.05 * 31, place, ["grey", "unknown"])
    assert tracker.parts.ids == ("unknown_1",)  # the part needs a second image
    for k in range(32, 63):
        tracker = update(tracker, 0.05 * k, np.zeros((0, 2)), [])
    assert tracker.given_up == ("unknown_1",)
