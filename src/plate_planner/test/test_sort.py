"""What sorting asks for: intervals, edges, dodging, and when a part counts as sorted."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, ScenarioError, load_rig
from plate_core.tasks import Bin, PartGroup, Side, SortTask, load_scenario
from plate_planner.tasks import Sorter, SortOptions
from plate_planner.tasks.sort import inside, outline_distance, slots

RIG = load_rig()
HALF = RIG.plate.half
TASK = SortTask({"black": Side(-1, 0), "grey": Side(1, 0)}, goal_fraction=0.6, hold_s=0.5)
OPTIONS = SortOptions(drift_max=0.01)
SORTER = Sorter(TASK, RIG, OPTIONS)
TINY = 1e-9


def interval(part_id: str, x: float, y: float = 0.0, options: SortOptions = OPTIONS):
    """Return low, high (2,) [drift_max] for one part at fractions of the half sides."""
    parts = Parts.make((part_id,), np.array([[x, y]]) * HALF)
    request = Sorter(TASK, RIG, options).request(parts, 0.1)
    return request.low[0] / options.drift_max, request.high[0] / options.drift_max


@pytest.mark.parametrize("x", [-0.85, -0.3, 0.0, 0.5])
def test_a_part_on_its_way_may_be_up_to_twice_as_fast_as_asked(x):
    low, high = interval("grey_1", x)
    assert (low[0], high[0]) == pytest.approx((1, 2))
    low, high = interval("black_1", -x)
    assert (low[0], high[0]) == pytest.approx((-2, -1))


def test_a_part_in_its_band_may_stay_or_wander_but_not_lead_out():
    low, high = interval("grey_1", 0.75)
    assert low[0] == pytest.approx(-0.6)
    assert high[0] > 0
    at_the_line_low, _ = interval("grey_1", 0.66)
    assert at_the_line_low[0] == pytest.approx(0, abs=1e-9)


def test_a_part_just_over_the_goal_line_is_still_asked_on():
    low, _ = interval("grey_1", 0.61)
    assert low[0] > 0


@pytest.mark.parametrize("x", [0.9, 0.95, 1.0])
def test_a_part_near_its_own_end_is_asked_back(x):
    low, high = interval("grey_1", x)
    assert low[0] <= high[0] < 0
    low, high = interval("black_1", -x)
    assert 0 < low[0] <= high[0]


def test_y_is_free_in_the_middle_and_exact_at_the_edge():
    low, high = interval("grey_1", 0, 0.69)
    assert (low[1], high[1]) == pytest.approx((-0.6, 0.6))
    low, high = interval("grey_1", 0, 0.775)
    assert (low[1], high[1]) == pytest.approx((-0.8, -0.2))
    for y, most in ((0.85, 1), (0.99, 2)):  # and faster inwards is welcome where a fall is near
        low, high = interval("grey_1", 0, y)
        assert (low[1], high[1]) == pytest.approx((-most, -1))
        low, high = interval("grey_1", 0, -y)
        assert (low[1], high[1]) == pytest.approx((1, most))


def test_requests_do_not_jump():
    """A small step of a part changes its request little: no threshold makes it twitch."""
    x = np.linspace(-1, 1, 2001)
    for part_id in ("grey_1", "black_1", "red_1"):
        rows = np.array([np.concatenate(interval(part_id, a, b)) for a in x for b in (0.0, a)])
        for along in (rows[0::2], rows[1::2]):
            assert np.max(np.abs(np.diff(along, axis=0))) < 0.1


def test_intervals_are_never_empty_and_never_lead_off_the_plate():
    rng = np.random.default_rng(0)
    ids = (*(f"{'black' if i % 2 else 'grey'}_{i}" for i in range(12)), "red_1")
    for _ in range(200):
        position = rng.uniform(-HALF, HALF, (13, 2))
        parts = Parts.make(ids, position, 0.01 * rng.normal(size=(13, 2)))
        request = SORTER.request(parts, 0.1)
        assert np.all(request.low <= request.high + TINY)
        ahead = position + 0.1 * parts.velocity
        outside = np.abs(ahead) >= 0.9 * HALF
        outward = np.where(ahead > 0, request.high, -request.low)
        assert np.all(outward[outside] <= 0.0 + TINY)


def test_the_mirror_image_asks_for_the_mirror_image():
    rng = np.random.default_rng(1)
    position = rng.uniform(-HALF, HALF, (8, 2))
    ids = ("black_1", "grey_1", "black_2", "grey_2", "black_3", "grey_3", "black_4", "grey_4")
    swapped = tuple(
        i.replace("black", "x").replace("grey", "black").replace("x", "grey") for i in ids
    )
    request = SORTER.request(Parts.make(ids, position), 0.1)
    mirror = SORTER.request(Parts.make(swapped, position * [-1, 1]), 0.1)
    assert mirror.low[:, 0] == pytest.approx(-request.high[:, 0])
    assert mirror.low[:, 1] == pytest.approx(request.low[:, 1])


def test_a_class_without_a_goal_is_only_kept_on_the_plate():
    low, high = interval("red_1", 0.3, 0.3)
    assert low == pytest.approx([-0.6, -0.6])
    assert high == pytest.approx([0.6, 0.6])
    low, high = interval("red_1", -0.87, 0.87)
    assert low == pytest.approx([1, -1])
    assert high == pytest.approx([1, -1])
    parts = Parts.make(("red_1",), np.array([[0.29, 0]]))
    assert np.isnan(SORTER.to_go(parts)[0])


def pair(gap_x: float, gap_y: float, left="grey_1", right="black_1", options=OPTIONS):
    """Request for two parts this far apart, in radii."""
    r = RIG.parts.radius_m
    position = np.array([[-gap_x / 2 * r, -gap_y / 2 * r], [gap_x / 2 * r, gap_y / 2 * r]])
    return Sorter(TASK, RIG, options).request(Parts.make((left, right), position), 0.1)


def test_parts_that_would_meet_dodge_along_y():
    request = pair(4, 1)
    assert request.high[0, 1] == pytest.approx(-0.4 * 0.01)  # the lower one goes down
    assert request.low[1, 1] == pytest.approx(0.4 * 0.01)
    level = pair(4, 0)
    assert level.high[0, 1] * level.low[1, 1] < 0


def test_dodging_begins_and_ends_gradually():
    for along in (
        [pair(x, 1) for x in np.arange(7, 0.5, -0.01)],
        [pair(3, y) for y in np.arange(4, 0.5, -0.01)],
    ):
        rows = np.array([np.concatenate([r.low[:, 1], r.high[:, 1]]) for r in along])
        assert np.max(np.abs(np.diff(rows, axis=0))) < 0.02 * 0.01


def test_the_edge_comes_before_dodging():
    position = np.array([[-0.01, 0.9 * HALF[1]], [0.01, 0.9 * HALF[1] - 0.01]])
    request = SORTER.request(Parts.make(("grey_1", "black_1"), position), 0.1)
    assert request.high[0, 1] == pytest.approx(-0.01)  # back from the edge, though upper


@pytest.mark.parametrize(
    "request_",
    [
        pair(6, 1),  # far along x
        pair(4, 3.1),  # clear along y
        pair(4, 1, "black_1", "grey_1"),  # going apart
        pair(4, 1, "grey_1", "grey_2"),  # going the same way
        pair(4, 1, options=replace(OPTIONS, dodge=0.0)),  # switched off
    ],
)
def test_others_are_left_alone(request_):
    assert request_.low[:, 1] == pytest.approx(-0.006)
    assert request_.high[:, 1] == pytest.approx(0.006)


@pytest.mark.parametrize(
    ("part_id", "fraction", "expected"),
    [
        ("grey_1", 0.6 + TINY, True),
        ("grey_1", 0.6 - TINY, False),
        ("grey_1", -0.9, False),
        ("black_1", -0.6 - TINY, True),
        ("black_1", -0.6 + TINY, False),
    ],
)
def test_sorted_means_beyond_the_goal_line_on_its_own_side(part_id, fraction, expected):
    parts = Parts.make((part_id,), np.array([[fraction * HALF[0], 0.0]]))
    assert (SORTER.to_go(parts)[0] == 0) == expected


def fractions(*points: tuple[float, float]) -> np.ndarray:
    """Return places [m] at fractions of the half sides."""
    return np.array(points) * HALF


def test_nothing_else_is_asked_while_a_part_is_nearly_off_the_plate():
    others = fractions((-0.5, 0.0), (0.4, 0.5), (0.86, 0.0))
    ids = ("black_1", "black_2", "grey_1", "grey_2")
    free = 0.0
    for y, share in ((0.88, 0.0), (0.915, 0.5), (0.95, 1.0)):
        parts = Parts.make(ids, np.vstack([others, fractions((0.0, -y))]))
        low, high = (x / OPTIONS.drift_max for x in vars(SORTER.request(parts, 0.1)).values())
        assert low[3, 1] == pytest.approx(1)  # inwards, whatever the others do
        assert high[3, 1] == pytest.approx(1 + share)
        free = high[0, 0] if share == 0 else free
        assert free < -0.2
        assert high[0, 0] == pytest.approx((1 - share) * free + share * 2, abs=0.01)
        assert high[2, 0] <= 0  # not off another edge meanwhile
        assert np.all(low <= high)


def test_a_place_near_an_edge_is_no_danger():
    task = SortTask({"grey": Bin(((0.2, 0.1), (0.3, 0.1), (0.3, 0.15), (0.2, 0.15)))}, 0.0, 0.5)
    sorter = Sorter(task, RIG, OPTIONS)
    place = slots(task.regions["grey"], RIG)
    there = place[np.argmax(place[:, 1])]
    assert there[1] > 0.9 * HALF[1]
    parts = Parts.make(("grey_1", "grey_2"), np.array([there, [-0.1, 0.0]]))
    request = sorter.request(parts, 0.1)
    assert request.low[1, 0] == pytest.approx(OPTIONS.drift_max, rel=0.2)  # on its way as ever


def test_corners_are_sorted_along_x_first_and_then_along_y():
    task = SortTask({"black": Side(-1, 1), "grey": Side(1, -1)}, goal_fraction=0.6, hold_s=0.5)
    sorter = Sorter(task, RIG, OPTIONS)
    ids = ("black_1", "grey_1")

    def asked(*points):
        request = sorter.request(Parts.make(ids, fractions(*points)), 0.1)
        return request.low / OPTIONS.drift_max, request.high / OPTIONS.drift_max

    low, high = asked((-0.7, 0.2), (0.3, 0.3))  # grey is not at its end
    assert (low[1, 0], high[1, 0]) == pytest.approx((1, 2))
    assert low[:, 1] == pytest.approx([-0.6, -0.6])
    assert high[:, 1] == pytest.approx([0.6, 0.6])
    low, high = asked((-0.7, -0.3), (0.7, 0.3))
    assert (low[0, 1], high[0, 1]) == pytest.approx((1, 2))
    assert (low[1, 1], high[1, 1]) == pytest.approx((-2, -1))
    assert np.all((low[:, 0] < 0.61) & (high[:, 0] > -0.61))  # and stay at their ends


def test_a_corner_wants_both_axes_and_top_is_left_turned_round():
    task = SortTask({"black": Side(-1, 1), "grey": Side(0, 1)}, goal_fraction=0.6, hold_s=0.5)
    sorter = Sorter(task, RIG, OPTIONS)
    ids = ("black_1", "black_2", "black_3", "grey_1", "grey_2")
    points = fractions((-0.7, 0.7), (-0.7, 0.3), (0.3, 0.2), (0.86, 0.7), (0.0, 0.0))
    parts = Parts.make(ids, points)
    short = [0, 0.3 * HALF[1], np.hypot(0.9 * HALF[0], 0.4 * HALF[1]), 0, 0.6 * HALF[1]]
    assert sorter.to_go(parts) == pytest.approx(np.array(short))
    low, high = (x / OPTIONS.drift_max for x in vars(sorter.request(parts, 0.1)).values())
    assert (low[2, 0], high[2, 0]) == pytest.approx((-2, -1))  # to the left first
    assert (low[4, 0], high[4, 0]) == pytest.approx((-0.6, 0.6))  # grey's x is free
    # On a square plate the rules along y are those along x.
    square = replace(RIG, plate=replace(RIG.plate, width_m=RIG.plate.length_m))
    up = Sorter(SortTask({"grey": Side(0, 1)}, 0.6, 0.5), square, OPTIONS)
    right = Sorter(SortTask({"grey": Side(1, 0)}, 0.6, 0.5), square, OPTIONS)
    point = np.array([[0.05, 0.06], [0.03, 0.09], [-0.2, -0.27]])
    names = ("grey_1", "grey_2", "grey_3")
    a = up.request(Parts.make(names, point), 0.1)
    b = right.request(Parts.make(names, point[:, ::-1]), 0.1)
    assert a.low == pytest.approx(b.low[:, ::-1])
    assert a.high == pytest.approx(b.high[:, ::-1])


BIN = Bin(((-0.2, -0.1), (-0.05, -0.1), (-0.05, -0.02), (-0.12, 0.04), (-0.2, -0.02)))


def test_distance_to_a_bin_is_zero_within_and_to_the_outline_without():
    sorter = Sorter(SortTask({"black": BIN}, 0.0, 0.5), RIG)
    points = [(-0.1, -0.06), (0.05, -0.06), (-0.12, 0.05), (-0.2, -0.13), (-0.23, -0.14)]
    parts = Parts.make(tuple(f"black_{i}" for i in range(5)), np.array(points))
    assert sorter.to_go(parts) == pytest.approx(np.array([0, 0.1, 0.01, 0.03, 0.05]))


def test_slots_are_apart_and_clear_of_the_bins_sides():
    slot = slots(BIN, RIG)
    radius = RIG.parts.radius_m
    gap = np.hypot(*(slot[:, None] - slot[None]).transpose(2, 0, 1)) + np.eye(len(slot))
    assert len(slot) >= 8  # its area has room for 15 squares
    assert np.min(gap) >= 3.5 * radius - 1e-9
    assert np.all(inside(slot, np.array(BIN.corner)))
    assert np.min(outline_distance(slot, np.array(BIN.corner))) >= 1.25 * radius - 1e-9


def test_a_bin_too_small_for_its_parts_is_refused():
    small = Bin(((0.0, 0.0), (0.05, 0.0), (0.05, 0.05), (0.0, 0.05)))
    scenario = replace(load_scenario("sort_4"), task=SortTask({"black": small, "grey": BIN}, 0, 0))
    room = len(slots(small, RIG))
    assert room == 4  # two by two, 28 mm apart in 50 mm less 10 mm at each side
    scenario = replace(scenario, parts=(PartGroup("black", room + 1), PartGroup("grey", 2)))
    with pytest.raises(ScenarioError, match=rf"that of black is for {room + 1} parts, .*{room},"):
        Sorter(scenario.task, RIG).check(scenario)


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_two_bins_in_one_place_are_refused(shift):
    other = Bin(tuple((x + shift, y) for x, y in BIN.corner))
    beside = Bin(tuple((-x, y) for x, y in BIN.corner))
    scenario = load_scenario("sort_4")
    with pytest.raises(ScenarioError, match=r"bin_m of black and of grey overlap .*one beside"):
        Sorter(SortTask({"black": BIN, "grey": other}, 0, 0), RIG).check(scenario)
    Sorter(SortTask({"black": BIN, "grey": beside}, 0, 0), RIG).check(scenario)


def test_a_corner_too_small_for_its_parts_is_refused():
    task = SortTask({"black": Side(-1, -1), "grey": Side(1, 0)}, goal_fraction=0.6, hold_s=0)
    scenario = replace(load_scenario("sort_4"), task=task)
    room = 5 * 3  # of 16 mm, centres in 75 x 37.5 mm
    for count, fits in ((room, True), (room + 1, False)):
        parts = (PartGroup("black", count), PartGroup("grey", 50))
        crowded = replace(scenario, parts=parts)
        if fits:
            Sorter(task, RIG).check(crowded)
            continue
        with pytest.raises(ScenarioError, match=r"black is for 16 parts, allowed: at most 15,"):
            Sorter(task, RIG).check(crowded)


def test_no_parts_no_request():
    request = SORTER.request(Parts.make((), np.zeros((0, 2))), 0.1)
    assert request.low.shape == request.high.shape == (0, 2)
