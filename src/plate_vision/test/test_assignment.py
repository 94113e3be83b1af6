"""Which sighting is of which part, by predicted place, class and angle; ids stay unique."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plate_vision import Prediction, Tracker, TrackerOptions, TrackError
from plate_vision.tracking import update

T = 0.2
SURE = (2e-5, 0.02, 1.0)


def expecting(tracker, stamp, moved):
    """Predict that the parts of a tracker have moved by (2,) [m] at a stamp."""
    ids = tuple(track.id for track in tracker.tracks)
    place = np.array([track.position for track in tracker.tracks]) + moved
    return Prediction(ids, stamp, place)


def ids_at(tracker):
    """Ids by place, to the tenth of a millimetre."""
    parts = tracker.parts
    places = np.round(1e4 * parts.position).astype(int).tolist()
    return {tuple(place): name for place, name in zip(places, parts.ids, strict=True)}


ROW = np.column_stack([np.arange(6) * 0.02 - 0.05, np.zeros(6)])
STEP = np.array([0.02, 0.0])
"""A row of parts that moves on by the distance of two of them: it looks as if it rested."""


def test_a_row_that_moves_by_its_spacing_keeps_its_ids():
    tracker = update(Tracker(), -T, ROW, ["grey"] * 6)
    tracker = update(tracker, 0.0, ROW, ["grey"] * 6)
    moved = update(tracker, T, ROW + STEP, ["grey"] * 6, expected=expecting(tracker, T, STEP))
    assert moved.parts.ids == tracker.parts.ids
    assert np.allclose(moved.parts.position, ROW + STEP)
    assert np.allclose(moved.parts.velocity, STEP / T)
    alone = update(tracker, T, ROW + STEP, ["grey"] * 6)
    assert ids_at(alone) != ids_at(moved)  # so only the prediction distinguishes them


def test_no_other_part_takes_the_place_of_a_missed_part():
    tracker = update(Tracker(), 0.0, ROW, ["grey"] * 6)
    known = expecting(tracker, T, STEP)
    left = np.delete(ROW, 2, axis=0)
    seen = update(tracker, T, left + STEP, ["grey"] * 5, expected=known)
    assert seen.parts.ids == ("grey_1", "grey_2", "grey_4", "grey_5", "grey_6")
    assert [track.missed for track in seen.tracks] == [0, 0, 1, 0, 0, 0]


def test_a_false_sighting_beside_a_missed_part_is_not_the_part():
    tracker = update(Tracker(), 0.0, ROW[:1], ["grey"])
    known = expecting(tracker, T, STEP)
    after = update(tracker, T, ROW[:1] + STEP + [0.0, 0.012], ["grey"], expected=known)
    assert after.parts.ids == ()
    back = update(after, 2 * T, ROW[:1] + STEP, ["grey"], expected=expecting(after, 2 * T, STEP))
    assert back.parts.ids == ("grey_1",)


def test_a_part_that_was_pushed_keeps_its_id():
    tracker = update(Tracker(), 0.0, ROW, ["grey"] * 6)
    place = ROW + STEP
    place[3] += [0.002, 0.004]
    moved = update(tracker, T, place, ["grey"] * 6, expected=expecting(tracker, T, STEP))
    assert moved.parts.ids == tracker.parts.ids
    assert np.allclose(moved.parts.position, place)


def test_predictions_that_are_wrong_altogether_do_no_harm():
    """The plate did not run the cycle: all rest, and are expected elsewhere."""
    tracker = update(Tracker(), 0.0, ROW, ["grey"] * 6)
    tracker = update(tracker, T, ROW, ["grey"] * 6)
    moved = update(tracker, 2 * T, ROW, ["grey"] * 6, expected=expecting(tracker, 2 * T, STEP / 2))
    assert ids_at(moved) == ids_at(tracker)


@pytest.mark.parametrize("ways", [0.25, 0.5, 0.75, 1.0, 1.1, 2.0])
def test_an_image_on_the_way_to_the_prediction_or_beyond(ways):
    """A camera that runs free, or an image that failed: parts are between where they were and where
    they will be, or go on the same way."""
    tracker = update(Tracker(), -T, ROW, ["grey"] * 6)
    tracker = update(tracker, 0.0, ROW, ["grey"] * 6)
    known = expecting(tracker, T, STEP)
    moved = update(tracker, ways * T, ROW + ways * STEP, ["grey"] * 6, expected=known)
    assert moved.parts.ids == tracker.parts.ids
    assert np.allclose(moved.parts.position, ROW + ways * STEP)


@pytest.mark.parametrize("at", [0.0, -1.0])
def test_an_old_prediction_is_ignored(at):
    tracker = update(Tracker(), -T, ROW, ["grey"] * 6)
    tracker = update(tracker, 0.0, ROW, ["grey"] * 6)
    moved = update(tracker, T, ROW + STEP, ["grey"] * 6, expected=expecting(tracker, at, STEP))
    assert ids_at(moved) == ids_at(update(tracker, T, ROW + STEP, ["grey"] * 6))


def test_an_old_prediction_loses_no_parts():
    """The part went only a little further in a minute without images."""
    tracker = update(Tracker(), 0.0, ROW, ["grey"] * 6)
    known = expecting(tracker, T, STEP / 4)
    moved = update(tracker, 60.0, ROW + STEP / 4, ["grey"] * 6, expected=known)
    assert moved.parts.ids == tracker.parts.ids


def test_predictions_of_unknown_parts_are_no_parts():
    tracker = update(Tracker(), 0.0, ROW[:2], ["grey"] * 2)
    known = Prediction(("black_7", "grey_9"), T, ROW[2:4])
    after = update(tracker, T, ROW[:2], ["grey"] * 2, expected=known)
    assert after.parts.ids == ("grey_1", "grey_2")


def test_a_misread_class_keeps_the_id():
    tracker = Tracker()
    for k in range(40):
        label = ["black" if k % 5 else "grey", "grey"]
        label = ["black", "grey"] if k == 0 else label
        tracker = update(tracker, k * T, ROW[[0, 3]] + [1e-3 * k, 0], label)
        assert tracker.parts.ids == ("black_1", "grey_1")
        assert tracker.renamed == ()


def test_a_permanent_change_of_class_changes_the_id_once():
    tracker, names = Tracker(), []
    for k in range(40):
        label = ["black" if k < 20 else "grey", "grey"]
        tracker = update(tracker, k * T, ROW[[0, 3]], label)
        names.append({*tracker.parts.ids})
        assert tracker.renamed == ((("black_1", "grey_2"),) if k == 26 else ())
    assert names[:26] == [{"black_1", "grey_1"}] * 26
    assert names[26:] == [{"grey_2", "grey_1"}] * 14
    assert tracker.given_up == ()


def test_a_class_misread_in_the_first_image_is_put_right_soon():
    tracker = Tracker()
    for k in range(5):
        tracker = update(tracker, k * T, ROW[:1], ["grey" if k == 0 else "black"])
    assert tracker.parts.ids == ("black_1",)


def test_classes_distinguish_parts_that_places_do_not():
    """Two parts of two classes exchange places: both would have to be misclassified."""
    tracker = update(Tracker(), 0.0, ROW[:2], ["black", "grey"])
    assert update(tracker, T, ROW[1::-1], ["black", "grey"]).parts.ids == ("black_1", "grey_1")
    swapped = update(tracker, T, ROW[:2], ["grey", "black"])
    assert ids_at(swapped) == {(-300, 0): "black_1", (-500, 0): "grey_1"}


@pytest.mark.parametrize(("symmetry", "turned"), [(1, 0.0), (2, np.pi), (6, np.pi / 3)])
def test_angles_distinguish_parts_that_places_do_not(symmetry, turned):
    """Two bars are as near to the one's place as to the other's; by their angles they are known."""
    place, angle = np.array([[0.0, 0.0], [0.0, 0.02]]), np.array([0.0, 0.5 * np.pi / symmetry])
    known, alike = np.array([SURE, SURE]), np.array([symmetry] * 2)
    tracker = update(Tracker(), 0.0, place, ["bar"] * 2, angle, known, alike)
    later = np.array([[0.02, 0.01], [-0.02, 0.01]])
    for order in ([0, 1], [1, 0]):
        seen = angle[order] + [turned, 0.05]
        tracks = update(tracker, T, later, ["bar"] * 2, seen, known, alike).tracks
        where = [tracks[i].position for i in (0, 1)]
        assert where == [tuple(later[order.index(i)]) for i in (0, 1)]
        assert max(abs(t.angle - a) for t, a in zip(tracks, angle, strict=True)) < 0.06
        assert max(abs(t.spin) for t in tracks) < 0.3


def test_angles_of_discs_are_ignored():
    place, quality = ROW[:2], np.array([SURE, SURE])
    tracker = update(Tracker(), 0.0, place, ["disc"] * 2, np.zeros(2), quality, np.zeros(2, int))
    after = update(
        tracker, T, place, ["disc"] * 2, np.array([1.0, -2.0]), quality, np.zeros(2, int)
    )
    assert ids_at(after) == ids_at(tracker)


@pytest.mark.parametrize(
    ("name", "value"),
    [("angle", [0.0]), ("angle", [0.0, np.nan]), ("quality", [SURE]), ("symmetry", [1, 1, 1])],
)
def test_wrong_measurements_are_refused(name, value):
    with pytest.raises(TrackError, match=f"{name} .*allowed: "):
        update(Tracker(), 0.0, ROW[:2], ["grey"] * 2, **{name: np.array(value)})


def test_ids_that_were_given_up_are_reported():
    tracker = update(Tracker(TrackerOptions(max_missed=1)), 0.0, ROW[:2], ["grey"] * 2)
    reported = []
    for k in range(1, 4):
        tracker = update(tracker, k * T, ROW[:1], ["grey"])
        reported.append(tracker.given_up)
    assert reported == [(), ("grey_2",), ()]


def swarm(rng, count, frames, missed, false, misread):
    """Play a crowd of one type at 40 mm/s and more, whose motion is predicted to 0.2 mm; count ids
    that change the part."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 6), np.linspace(-0.1, 0.1, 5))
    middle = np.column_stack([x.ravel(), y.ravel()])[:count]
    phase, rate = rng.uniform(0, 2 * np.pi, (2, count, 2)), rng.uniform(1.5, 2.5, (count, 2))
    tracker, expected, owner, swaps = Tracker(), None, {}, 0
    for k in range(frames):
        here, after = (middle + 0.025 * np.sin(phase[0] + rate * j * T) for j in (k, k + 1))
        there = rng.random(count) >= missed if k else np.ones(count, bool)
        specks = rng.uniform([-0.3, -0.15], [0.3, 0.15], (rng.binomial(count, false), 2))
        place = np.concatenate([here[there] + 2e-5 * rng.standard_normal((there.sum(), 2)), specks])
        label = np.where(rng.random(len(place)) < misread, "other", "part")
        tracker = update(tracker, k * T, place, label, expected=expected)
        for name, at in zip(tracker.parts.ids, tracker.parts.position, strict=True):
            gap = np.hypot(*(here - at).T)
            if gap.min() < 1e-3:
                swaps += owner.setdefault(name, gap.argmin()) != gap.argmin()
                owner[name] = gap.argmin()
        rows = [owner.get(t.id, -1) for t in tracker.tracks]
        place = after[rows] + 2e-4 * rng.standard_normal((len(rows), 2))
        expected = Prediction(tuple(t.id for t in tracker.tracks), (k + 1) * T, place)
    return swaps, owner


def test_a_crowd_of_one_type_at_speed_keeps_its_ids(rng):
    """5 % missed, 2 % false, 3 % of classes misread; parts move by half their distance."""
    swaps, owner = swarm(rng, 30, 300, 0.05, 0.02, 0.03)
    assert swaps == 0
    assert sorted({*owner.values()}) == [*range(30)]


SIGHTINGS = st.lists(
    st.lists(
        st.tuples(
            st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.sampled_from("abc"), st.booleans()
        ),
        max_size=6,
    ),
    max_size=12,
)


@settings(max_examples=60, deadline=None)
@given(SIGHTINGS, st.integers(1, 3), st.integers(0, 2), st.integers(0, 2**32 - 1))
def test_ids_are_unique_and_never_given_again(images, confirm, most, seed):
    rng = np.random.default_rng(seed)
    tracker, missing = Tracker(TrackerOptions(confirm=confirm, max_missed=most)), set()
    for k, image in enumerate(images):
        place = np.array([each[:2] for each in image]).reshape(-1, 2)
        quality = np.array([SURE if each[3] else (np.nan,) * 3 for each in image]).reshape(-1, 3)
        before = {track.id for track in tracker.tracks if track.number}
        known = expecting(tracker, k * T, rng.normal(0, 0.01, 2)) if tracker.tracks else None
        tracker = update(
            tracker, k * T, place, [each[2] for each in image], None, quality, expected=known
        )
        ids = [track.id for track in tracker.tracks if track.number]
        assert len({*ids}) == len(ids)
        assert len(tracker.found) == len(image)
        missing |= before - {*ids}
        assert not missing & {*ids}
        reported = {*tracker.given_up, *(old for old, _ in tracker.renamed)}
        assert reported == before - {*ids}
        last = tracker.last_number
        assert all(track.number <= last.get(track.label, 0) for track in tracker.tracks)
