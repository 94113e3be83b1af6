"""Things that belong to no class of the task: they are kept on the plate, and reported."""

import numpy as np
import pytest
from plant import RIG, Plant, T, ready
from shown_text import says

from plate_core import CycleRequest, OverlookedThing, Parts, PlateCycle
from plate_core.tasks import load_scenario
from plate_planner import Planner
from plate_planner.supervision import Overlooked, Reason

HALF, RADIUS = RIG.plate.half, RIG.parts.radius_m
PLACE = np.array([[0.05, 0.02], [-0.1, 0.1]])
THINGS = ("unknown_1", "group_2")


def with_things(parts, ids=THINGS, position=PLACE):
    """Return parts and things that belong to no class of the task."""
    return Parts.make(
        parts.ids + tuple(ids),
        np.vstack([parts.position, position[: len(ids)]]),
        np.vstack([parts.velocity, np.zeros((len(ids), 2))]),
    )


def test_a_task_ends_well_beside_unknown_things_and_names_them():
    planner = Planner(RIG, load_scenario("sort_4"))
    plant = Plant(planner.scenario, seed=2)
    state = ready(planner, with_things(plant.seen()))
    texts = set()
    for k in range(600):
        state, request, progress = planner.plan(state, with_things(plant.seen()), k * T)
        if progress.phase != "running":
            break
        texts.add(progress.text)
        if request.parts.ids:
            assert set(THINGS) <= set(request.parts.ids)  # the solver keeps parts clear of them
            rows = [request.parts.ids.index(name) for name in THINGS]
            assert not np.any(request.targets.weight[rows])  # but they need not move
        rows = np.flatnonzero([name not in THINGS for name in request.parts.ids])
        plant.step(CycleRequest.make(request.parts.take(rows), request.forces.force[rows]))
    things = "2 unknown objects are on the plate (unknown_1 at (0.050, 0.020) m, group_2 at "
    assert progress.phase == "done"
    assert f"4 of 4 parts in their regions; {things}" in progress.text
    assert any(text.startswith(f"running: {things}") for text in texts)


def test_things_that_come_and_go_do_not_keep_a_task_from_beginning():
    planner = Planner(RIG, load_scenario("sort_4"))
    parts = Plant(planner.scenario, seed=2).seen()
    state, _, _ = planner.plan(planner.initial(), with_things(parts), 0.0)
    state = planner.start(state)
    for k, ids in enumerate((("unknown_3",), ())):
        state, _, _ = planner.plan(state, with_things(parts, ids), (k + 1) * T)
    assert state.task.began == T
    missing = parts.take([0, 1, 2])  # while a part that comes and goes does
    state, _, _ = planner.plan(planner.initial(), parts, 0.0)
    state = planner.start(state)
    for k, image in enumerate((missing, parts)):
        state, _, _ = planner.plan(state, image, (k + 1) * T)
    assert state.task.began == 2 * T


def asked_of(planner, images):
    """Return the ids in the request after each of these images; the plate rests."""
    state, requested = ready(planner, images[0]), []
    for k, image in enumerate(images):
        state = planner.started(state, PlateCycle.rest(T), k * T, True)
        state, request, _ = planner.plan(state, image, k * T)
        requested.append(request.parts.ids)
    return requested


def test_parts_keep_clear_of_a_thing_that_is_not_seen_for_a_while():
    planner = Planner(RIG, load_scenario("sort_4"))
    parts = Plant(planner.scenario, seed=2).seen()
    both = with_things(parts)
    requested = asked_of(planner, [both, both, *[parts] * 12])
    assert ["unknown_1" in ids for ids in requested] == [True] * 12 + [False] * 2  # ten images
    again = with_things(parts, ("unknown_3",))  # it is back, under another name
    last = asked_of(planner, [both, parts, again])[-1]
    assert set(last) == {*parts.ids, "unknown_3", "group_2"}


def test_a_lost_part_that_is_seen_as_a_thing_has_not_left_the_plate():
    planner = Planner(RIG, load_scenario("sort_4"))
    parts = Plant(planner.scenario, seed=2).seen()
    parts.position[0] = HALF - 0.02  # near a corner
    state, now = (
        ready(planner, parts),
        with_things(parts.take([1, 2, 3]), THINGS[:1], parts.position[:1]),
    )
    for k in range(30):
        state, _, progress = planner.plan(state, now if k > 2 else parts, k * T)
    assert progress.phase == "lost part"
    assert state.task.reason == Reason.PART_UNSEEN
    assert says(progress.text, "unknown_1", "class", "no longer", "detections_")


def test_a_task_that_misses_a_part_names_the_thing_that_it_may_be():
    planner = Planner(RIG, load_scenario("sort_4"))
    parts = Plant(planner.scenario, seed=2).seen().take([0, 1, 2])
    state = planner.start(planner.initial())
    for k in range(110):
        state, _, progress = planner.plan(state, with_things(parts, THINGS[:1]), k * T)
    assert says(progress.text, "within 10 s of", "1 unknown object", "unknown_1 at (0.050,")


def test_the_solver_gets_the_parts_of_the_task_before_unknown_things():
    planner = Planner(RIG, load_scenario("sort_50"))
    parts = Plant(planner.scenario, seed=2).seen()
    ids = tuple(f"unknown_{k}" for k in range(1, 71))
    position = np.random.default_rng(1).uniform(-0.9, 0.9, (70, 2)) * HALF
    state = ready(planner, with_things(parts, ids, position))
    _, request, _ = planner.plan(state, with_things(parts, ids, position), 0.0)
    assert len(request.parts) == 100
    assert set(parts.ids) <= set(request.parts.ids)


def thing(x, y, radius=RADIUS, reason="misfit"):
    return OverlookedThing(x, y, radius, reason)


NOBODY = Parts.make((), np.zeros((0, 2)))


@pytest.mark.parametrize(
    ("seen", "counts"),
    [
        (thing(0, 0), True),
        (thing(0, 0, 0.6 * RADIUS), True),  # 0.36 of a part's area
        (thing(0, 0, 0.5 * RADIUS), False),  # 0.25
        (thing(0, 0, 1.7 * RADIUS), True),  # 2.9
        (thing(0, 0, 1.8 * RADIUS), False),  # 3.2
        (thing(HALF[0] - 0.5 * RADIUS, 0), False),  # not wholly on the plate
        (thing(HALF[0] - 1.5 * RADIUS, 0), False),  # the edge of a plate that is not at home
        (thing(0, -HALF[1] - 0.05), False),
        (thing(PLACE[0, 0] + 0.002, PLACE[0, 1]), False),  # published as a part
    ],
)
def test_only_a_thing_that_may_be_a_part_counts(seen, counts):
    overlooked = Overlooked(RIG)
    overlooked.add((seen,), Parts.make(("unknown_1",), PLACE[:1]))
    assert overlooked.count == int(counts)
    assert bool(overlooked.text) == counts


def test_a_thing_counts_if_most_images_show_it():
    overlooked = Overlooked(RIG)
    for k in range(5):
        overlooked.add((thing(0, 0),) if k % 2 == 0 else (), NOBODY)
    assert overlooked.count == 1
    overlooked.add((), NOBODY)  # now two of the last five
    overlooked.add((), NOBODY)
    assert (overlooked.count, overlooked.text) == (0, "")


def test_the_text_has_places_and_reasons():
    overlooked = Overlooked(RIG)
    things = [thing(0.1 * k - 0.2, 0.05, reason="too large") for k in range(5)]
    overlooked.add(tuple(things), NOBODY)
    places = [f"too large at ({x}, 0.050) m" for x in ("-0.200", "-0.100", "0.000")]
    assert says(overlooked.text, "5 undetected objects", *places, "and 2 more")
