"""The judge of ids, and the crowd that it judges: both must be able to fail."""

import numpy as np

from plate_core import Parts, PlateCycle, load_rig
from tasks.identity import CROWD, Identities, Instant, follow_crowd, to_and_fro

PLACE = np.array([[-0.1, 0.0], [0.0, 0.0], [0.1, 0.0]])
NAMES = ("black_1", "black_2", "grey_1")


def judged(*images):
    """Take in images of ids at places (M, 2) [m]; returns the counts."""
    total = Identities(reach=0.004, near=0.02)
    for ids, place in images:
        total.take(Parts.make(ids, np.array(place)), NAMES, PLACE)
    return {name: count for name, count in total.count.items() if count}


def test_ids_that_stay_count_for_nothing():
    assert judged(("abc", PLACE), ("ab", PLACE[:2]), ("abc", PLACE)) == {"frames": 3}


def test_ids_that_change_their_parts_are_swaps():
    counts = judged(("abc", PLACE), ("bac", PLACE), ("bac", PLACE))
    assert counts == {"frames": 3, "swaps": 2, "renamed": 2}


def test_new_ids_of_known_parts_and_ids_of_nothing():
    assert judged(("abc", PLACE), ("dbc", PLACE)) == {"frames": 2, "renamed": 1}
    assert judged(("abc", PLACE + [[0.0, 0.005]] * 3)) == {"frames": 1, "ghosts": 3}


def test_near_passes():
    total = Identities(reach=0.004, near=0.02)
    place = np.array([[0.0, 0.0], [0.019, 0.0], [0.019, 0.019]])
    total.take(Parts.make((), np.zeros((0, 2))), NAMES, place)
    assert total.count["near"] == 1  # of one class
    assert np.isclose(total.closest, 0.019)


def test_a_crowd_that_jumps_loses_its_ids_and_one_that_rests_does_not():
    """By a plate that rests, a part that takes another's place is another part."""
    rig, rest = load_rig(), PlateCycle.rest(0.2)
    place = np.column_stack([np.linspace(-0.2, 0.2, 10), np.zeros(10)])
    ids = tuple(f"black_{i}" for i in range(10))
    still = [Instant(0.2 * k, ids, place, rest) for k in range(8)]
    jumped = still[:4] + [Instant(i.time, ids, np.roll(place, 1, 0), rest) for i in still[4:]]
    swaps = []
    for path in (still, jumped):
        total = Identities(reach=0.004, near=0.02)
        follow_crowd(rig, path, np.random.default_rng(3), total, 1, predict=True)
        assert total.count["frames"] == 8
        swaps.append(total.count["swaps"])
    assert swaps == [0, 10]


def test_the_crowd_moves():
    path = [*to_and_fro(load_rig(), 8, 1)]
    assert len(path[0].ids) == CROWD
    assert np.all(np.diff([instant.time for instant in path]) > 0.05)
    assert np.hypot(*(path[-1].position - path[0].position).T).max() > 0.01
