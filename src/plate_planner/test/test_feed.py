"""Feeding: which parts are prepared, when the plate rests, and the reports."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, PlateCycle, PlateError, load_rig
from plate_core.tasks import FeedMode, FeedOrder, Pick, Side, load_scenario
from plate_planner import Phase, Planner
from plate_planner.tasks import Feeder
from plate_planner.tasks.task import Situation

RIG, T = load_rig(), 0.1
SCENARIO = load_scenario("feed")
TASK = replace(SCENARIO.task, chute=Side(-1, 0))


def parts(**position):
    ids = tuple(position)
    return Parts.make(ids, np.array([position[name] for name in ids]).reshape(-1, 2))


def situation(seen, t=0.0, hidden=None, tail=0.0):
    every = seen if hidden is None else Parts.make(
        seen.ids + hidden.ids, np.vstack([seen.position, hidden.position])
    )  # fmt: skip
    short = np.zeros(len(every))
    return Situation(
        every, t, t + T, t + T + tail, T, True, True, every.position, short, True, seen, t
    )


def run(task, *images, memory=None, begin=0, kept=False):
    """Return the results of the rules for images, one per cycle, the first one in a given cycle."""
    rules, found = Feeder(task, RIG), None
    for k, seen in enumerate(images):
        now = replace(situation(seen, (begin + k) * T), kept=kept)
        memory, found = rules.assess(memory, now)
    return memory, found


LONE = {"black_1": (0.0, 0.0), "black_2": (0.1, 0.0), "black_3": (0.2, 0.0)}


def test_the_plate_rests_when_enough_parts_are_ready():
    memory, found = run(TASK, parts(**LONE))
    assert found.request is None
    assert not memory.report.at_rest, "it may have moved until now"
    memory, found = run(TASK, *3 * [parts(**LONE)])
    assert memory.report.at_rest
    assert set(memory.report.ready.ids) == set(LONE)
    assert memory.report.seen == {"black": 3}


def test_the_plate_does_not_rest_before_its_tail_has_ended():
    rules, memory, at_rest = Feeder(TASK, RIG), None, []
    for k in range(4):
        memory, _ = rules.assess(memory, situation(parts(**LONE), k * T, tail=T))
        at_rest.append(memory.report.at_rest)
    assert at_rest == [False, False, False, True]


@pytest.mark.parametrize(
    "other", [(0.022, 0.0), (0.0, -0.021)], ids=["beside", "below"]
)  # rims 5 and 6 mm apart, less than the clearance
def test_parts_too_near_each_other_are_parted(other):
    memory, found = run(TASK, parts(**LONE, black_4=other)) if other[0] else run(
        TASK, parts(black_1=(0.0, 0.0), black_4=other, black_2=(0.1, 0), black_3=(0.2, 0))
    )  # fmt: skip
    assert found.request is not None, "only two are ready"
    targets = found.request
    assert targets.gap_m > TASK.clearance_m
    assert set(memory.report.ready.ids) <= {"black_2", "black_3"}
    assert "black_1" in memory.chosen or "black_4" in memory.chosen


def test_parts_outside_the_window_are_led_there_the_nearest_first():
    seen = parts(black_1=(-0.1, 0.0), black_2=(-0.2, 0.1), black_3=(-0.28, -0.1), **{
        f"black_{k}": (-0.28, 0.1 - 0.03 * k) for k in (4, 5)
    })  # fmt: skip
    memory, found = run(TASK, seen)
    assert memory.chosen == ("black_1", "black_2", "black_3"), "as many as are to be ready"
    targets = found.request
    requested = dict(zip(seen.ids, targets.weight[:, 0], strict=True))
    assert requested["black_1"] == requested["black_2"]
    assert 0 < 10 * requested["black_5"] < requested["black_2"]
    assert targets.low[0, 0] >= TASK.picks[0].low[0]


def test_an_order_to_rest_holds_for_all_part_positions():
    task = replace(TASK, order=FeedOrder(FeedMode.REST))
    crowd = parts(black_1=(0.0, 0.0), black_2=(0.017, 0.0))
    memory, found = run(task, *3 * [crowd])
    assert found.request is None
    assert memory.report.at_rest
    assert memory.report.mode is FeedMode.REST


def test_the_plate_is_not_at_rest_before_the_last_motion_has_ended():
    rules, memory, at_rest = Feeder(TASK, RIG), None, []
    crowd = parts(black_1=(0.0, 0.0), black_2=(0.017, 0.0))
    memory, _ = rules.assess(memory, situation(crowd, 0.0))
    rules = Feeder(replace(TASK, order=FeedOrder(FeedMode.REST)), RIG)
    for k in (1, 2, 3):
        memory, _ = rules.assess(memory, situation(crowd, k * T))
        at_rest.append(memory.report.at_rest)
    # Image 1 is answered by the first rest, which begins at image 2, when parts still drift.
    assert at_rest == [False, False, True]


@pytest.mark.parametrize(
    ("begins", "reported", "arrival"),
    [(4, 4, 3.9), (4, 5, 3.9), (6, 6, 5.5)],
    ids=["reported at once", "reported with the next image", "the planner is behind"],
)
def test_no_part_is_at_rest_while_a_requested_motion_can_start(begins, reported, arrival):
    """The cycle for image 0 starts at image `begins`, long after the order to rest. Its start is
    reported before image `reported`. The planner receives the cycle after image 3, at time
    `arrival`, followed by rest."""
    feed = Planner(RIG, replace(SCENARIO, task=TASK))
    state, still = feed.start(feed.initial()), []
    push = np.outer(np.sin(np.linspace(0, 2 * np.pi, 20)) ** 3, [0.001, 0.0, 0.0])
    rest, push = PlateCycle.rest(T), PlateCycle.from_samples(T, push)
    crowd = parts(black_1=(0.0, 0.0), black_2=(0.017, 0.0))
    for k in range(12):
        if k == reported > begins:
            state = feed.started(state, push, begins * T, triggered=True)
        if k != begins or reported == begins:
            state = feed.started(state, push if k == begins else rest, k * T, triggered=True)
        state, expected, _ = feed.plan(state, crowd, k * T)
        assert bool(expected.parts.ids) is (k == 0)
        still.append(state.memory.report.at_rest)
        if k == 0:
            feed = feed.order(state, FeedOrder(FeedMode.REST))
        elif k >= 3:
            for requested in range(4) if k == 3 else [k]:
                answer = rest if requested else push
                state = feed.record_cycle(state, answer, max(arrival, k) * T, requested * T)
    assert still == [k > begins + 1 for k in range(12)]


def test_a_motion_that_rest_has_overtaken_may_still_begin_while_the_driver_stands_still():
    """The cycle for image 0 and the rest after it are received at once, but reach the plate late:
    it rests until the motion begins with image 4."""
    assert _at_rest_while_a_motion_is_awaited(begins=4, count=8) == [k > 5 for k in range(8)]


def test_the_wait_for_a_refused_motion_ends():
    still = _at_rest_while_a_motion_is_awaited(begins=None, count=12)
    assert not any(still[:6])
    assert all(still[8:])


def _at_rest_while_a_motion_is_awaited(begins, count):
    """Return whether each image is reported as at rest. The motion requested after image 0 arrives
    in time, and begins with an image, or never."""
    feed = Planner(RIG, replace(SCENARIO, task=TASK))
    state, still = feed.start(feed.initial()), []
    push = np.outer(np.sin(np.linspace(0, 2 * np.pi, 20)) ** 3, [0.001, 0.0, 0.0])
    rest, push = PlateCycle.rest(T), PlateCycle.from_samples(T, push)
    for k in range(count):
        state = feed.started(state, push if k == begins else rest, k * T, triggered=True)
        state, _, _ = feed.plan(state, parts(black_1=(0.0, 0.0), black_2=(0.017, 0.0)), k * T)
        still.append(state.memory.report.at_rest)
        state = feed.record_cycle(state, rest if k else push, (k + 0.5) * T, k * T)
        if k == 0:
            feed = feed.order(state, FeedOrder(FeedMode.REST))
    return still


def test_without_further_reports_the_plate_counts_as_resting():
    feed = Planner(RIG, replace(SCENARIO, task=replace(TASK, order=FeedOrder(FeedMode.REST))))
    state, rest = feed.start(feed.initial()), PlateCycle.rest(T)
    for k in range(25):
        if k < 3:
            state = feed.started(state, rest, k * T, triggered=True)
        state, _, _ = feed.plan(state, parts(**LONE), k * T)
        state = feed.record_cycle(state, rest, (k + 0.5) * T, k * T)
    assert state.memory.report.at_rest


def test_a_part_that_moves_on_a_plate_at_rest_is_not_ready():
    moved = {**LONE, "black_2": (0.103, 0.0)}
    memory, _ = run(TASK, parts(**LONE), parts(**LONE), parts(**moved))
    assert memory.report.at_rest
    assert set(memory.report.ready.ids) == {"black_1", "black_3"}


def test_a_hidden_part_is_still_an_obstacle():
    rules, memory = Feeder(TASK, RIG), None
    hidden = parts(black_4=(0.01, 0.005))
    for k in range(3):
        memory, _ = rules.assess(memory, situation(parts(**LONE), k * T, hidden))
    assert set(memory.report.ready.ids) == {"black_2", "black_3"}


def test_unwanted_parts_go_to_the_chute():
    seen = parts(**LONE, grey_1=(-0.2, 0.0), grey_2=(-0.1, 0.0))
    _, found = run(TASK, seen)
    targets = found.request
    assert targets.high[3, 0] < -RIG.plate.half[0]
    assert targets.weight[3, 0] > targets.weight[4, 0] > 0, "the nearer one first"
    waiting = parts(black_4=(-0.1, 0.05), grey_1=(-0.2, 0.0), grey_2=(-0.1, 0.0))
    _, found = run(TASK, waiting)
    requested = found.request
    assert np.all(requested.weight[0] > 0), "others get ready meanwhile"
    assert np.all(requested.weight[1] > requested.weight[2])
    assert np.all(requested.weight[2] > 0)
    _, found = run(replace(TASK, chute=None), waiting)
    requested = found.request
    assert np.all(requested.weight[1:] == 0)
    assert np.all(requested.low[1:] <= -RIG.plate.half), (
        "anywhere, not where they are: the edge counts"
    )
    assert np.all(requested.high[1:] >= RIG.plate.half)
    many = parts(black_4=(-0.1, 0.05), **{f"grey_{k}": (-0.2, 0.03 * k - 0.1) for k in range(5)})
    _, found = run(TASK, many)
    assert np.all(found.request.weight[1:] > 0)
    fed = {"black_4": (-0.1, 0.05), "black_5": (-0.285, 0.09)}
    beside = {f"grey_{k}": (-0.29, 0.03 * k - 0.1) for k in range(5)}
    _, found = run(TASK, parts(**fed, **beside, grey_5=(0.2, 0.0)))
    requested, alone = found.request, run(TASK, parts(**fed))[1].request
    assert requested.weight[:2] == pytest.approx(alone.weight), "they take nothing from those fed"
    assert requested.low[:2] == pytest.approx(alone.low), "also beside the chute"
    few = parts(black_4=(-0.1, 0.05), grey_3=(-0.2, 0.02))
    memory, _ = run(TASK, many)
    _, found = run(TASK, few, memory=memory)
    assert np.all(found.request.weight[1] > 0), "then all of them go"
    _, found = run(replace(TASK, chute=None), seen)
    assert found.request is None, "without a chute they stay"


def test_a_purge_takes_all_of_them():
    _, found = run(replace(TASK, order=FeedOrder(FeedMode.PURGE)), parts(**LONE))
    assert np.all(found.request.high[:, 0] < -RIG.plate.half[0])
    assert np.all(found.request.weight > 0)


@pytest.mark.parametrize(
    ("name", "place", "discharged", "lost"),
    [
        ("grey_9", (-0.28, 0.0), 1, 0),
        ("black_9", (-0.28, 0.0), 0, 1),
        ("grey_9", (0.295, 0.0), 0, 1),
        ("black_9", (0.0, 0.145), 0, 1),
        ("black_9", (0.1, 0.05), 0, 0),
    ],
    ids=["chute", "chute, but wanted", "far side", "long side", "taken"],
)
def test_removed_parts_are_counted_by_their_last_position(name, place, discharged, lost):
    before, after = parts(**LONE, **{name: place}), parts(**LONE)
    memory, _ = run(TASK, before, after)
    assert (memory.report.discharged, memory.report.lost) == (discharged, lost)
    memory, _ = run(replace(TASK, order=FeedOrder(FeedMode.REST)), *4 * [before])
    hidden = replace(TASK, order=FeedOrder(FeedMode.REST, hidden=True))
    memory, _ = run(hidden, after, after, memory=memory, begin=4, kept=True)  # behind a robot
    assert (memory.report.discharged, memory.report.lost) == (0, 0)
    back = parts(**LONE, **{name.replace("9", "17"): (place[0], place[1] + 0.002)})
    assert run(TASK, back, memory=memory, begin=6)[0].report.lost == 0, "under another name"
    memory, _ = run(TASK, after, memory=memory, begin=6)
    assert (memory.report.discharged, memory.report.lost) == (discharged, lost)
    memory, _ = run(replace(TASK, order=FeedOrder(FeedMode.PURGE)), before, after)
    assert memory.report.lost == (place[0] > -0.2 and lost)


def test_bars_rotate_by_the_smaller_angle():
    rig, scenario = load_rig("shapes"), load_scenario("feed_bars")
    seen = Parts.make(
        ("bar_1", "bar_2", "bar_3"), np.array([[0, 0], [0.1, 0], [0.2, 0.0]]),
        angle=np.radians([170.0, 0.0, 90.0]),
    )  # fmt: skip
    task = replace(scenario.task, picks=(replace(scenario.task.picks[0], ready=3),))
    memory, found = Feeder(task, rig).assess(None, situation(seen))
    angles = found.request.angles
    assert np.degrees(angles.low[0]) == pytest.approx(178.5), "a turn of half a round is none"
    assert np.all(angles.weight > 0), "ready parts keep their weights"
    assert angles.weight[0] > 4 * angles.weight[2], "the nearest one first"
    assert memory.chosen == ("bar_1", "bar_3")


def test_parts_come_and_go_while_the_task_runs():
    feed = Planner(RIG, SCENARIO)
    state = feed.start(feed.initial())
    images = [parts(), parts(), parts(black_1=(0, 0)), parts(black_7=(0.1, 0)), parts()]
    for k, seen in enumerate(images):
        state, _, progress = feed.plan(state, seen, k * T)
        assert progress.phase is Phase.RUNNING, progress.text
    for k in range(len(images), 40):
        state, _, progress = feed.plan(state, parts(), k * T)
    assert progress.phase is Phase.RUNNING


def test_the_state_of_the_planner_does_not_grow_with_removed_parts():
    feed, sizes = Planner(RIG, SCENARIO), []
    state = feed.start(feed.initial())
    for k in range(1000, 1300):
        state, *_ = feed.plan(state, parts(**{f"black_{k}": (0.1, 0.0)}), k * T)
        sizes.append(len(pickle.dumps(state)))
    assert abs(sizes[299] - sizes[99]) < 100


def test_orders_change_what_is_done_and_wrong_ones_are_refused():
    feed = Planner(RIG, SCENARIO)
    state = feed.start(feed.initial())
    state, *_ = feed.plan(state, parts(**LONE), 0.0)
    pick = Pick("grey", 1, (0.0, -0.1), (0.2, 0.1))
    requested = FeedOrder(FeedMode.FEED, (pick,))
    other = feed.order(state, requested)
    assert other.scenario.task.order == requested
    back = other.order(state, FeedOrder(FeedMode.REST))
    assert back.scenario.task.picks == TASK.picks
    for wrong, why in (
        (replace(pick, label="nut"), "class is 'nut', allowed: black, grey"),
        (replace(pick, high=(0.4, 0.1)), "window of grey"),
        (replace(pick, angle=1.0, tolerance_rad=0.1), "angle of grey .* is round"),
        (replace(pick, ready=0), "ready of grey is 0, allowed: 1 to 100"),
        (replace(pick, low=(np.nan, 0.0)), "window of grey"),
    ):
        with pytest.raises(PlateError, match=why):
            feed.order(state, FeedOrder(FeedMode.FEED, (wrong,)))
    with pytest.raises(PlateError, match="no task of kind feed runs"):
        feed.order(feed.initial(), FeedOrder(FeedMode.REST))
    stay = Planner(RIG, replace(SCENARIO, task=replace(TASK, chute=None)))
    with pytest.raises(PlateError, match="requires a chute"):
        stay.order(state, FeedOrder(FeedMode.PURGE))


def test_parts_hidden_by_a_robot_keep_their_positions_and_may_get_new_ids():
    feed = Planner(RIG, replace(SCENARIO, task=replace(TASK, chute=None)))
    state = feed.start(feed.initial())
    crowd, hidden = parts(**LONE, black_4=(0.0, 0.1)), parts(**LONE, grey_9=(0.1, 0.05))
    for k in range(3):
        state, *_ = feed.plan(state, crowd, k * T)
    feed = feed.order(state, FeedOrder(FeedMode.REST))
    for k in range(3, 6):
        state, *_ = feed.plan(state, crowd, k * T)
    feed = feed.order(state, FeedOrder(FeedMode.REST, hidden=True))
    for k in range(6, 20):
        state, *_ = feed.plan(state, hidden, k * T)
    report = state.memory.report
    assert report.at_rest
    assert set(report.ready.ids) == set(crowd.ids)
    assert report.seen == {"black": 4}
    feed = feed.order(state, FeedOrder())
    for k in (20, 21):
        state, *_ = feed.plan(state, parts(**LONE, black_5=(0.0, 0.1)), k * T)
    assert set(state.memory.report.ready.ids) == {*LONE, "black_5"}
    assert state.memory.report.lost == 0


@pytest.mark.parametrize("late", [False, True], ids=["before", "after"])
def test_a_part_that_the_robot_took_beside_the_chute_is_not_lost(late):
    """Whether orders come before an image or, with a camera that runs free, after it."""
    wide = replace(TASK, picks=(replace(TASK.picks[0], low=(-0.28, -0.1)),))
    feed = Planner(RIG, replace(SCENARIO, task=wide))
    state = feed.start(feed.initial())
    before, after = parts(**LONE, black_9=(-0.275, 0.0)), parts(**LONE)
    for order, seen, count in (
        (FeedOrder(), before, 3),
        (FeedOrder(FeedMode.REST), before, 3),
        (FeedOrder(FeedMode.REST, hidden=True), before, 2),
        (FeedOrder(FeedMode.REST, hidden=True), after, 3),
        (FeedOrder(), after, 8),
    ):
        for _ in range(count):
            t = state.estimator.stamp + T if np.isfinite(state.estimator.stamp) else 0.0
            begun = state.task.began is not None
            if begun and not late:
                feed = feed.order(state, order)
            state = feed.see(state, seen, t)
            if begun and late:
                feed = feed.order(state, order)
            state, *_ = feed.next_request(state)
    assert (state.memory.report.lost, state.memory.report.discharged) == (0, 0)
    assert state.memory.report.seen == {"black": 3}
