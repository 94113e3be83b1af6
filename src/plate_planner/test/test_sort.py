"""Requests of sorting: the targets of the parts, in lanes while they are far; when parts are
sorted."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, ScenarioError, load_rig
from plate_core.tasks import Bin, PartGroup, Side, SortTask, load_scenario
from plate_planner.tasks import Situation, Sorter
from plate_planner.tasks.sort import LANE_AT, MARGIN, bin_slots

RIG = load_rig()
HALF = RIG.plate.half
TASK = SortTask({"black": Side(-1, 0), "grey": Side(1, 0)}, goal_fraction=0.6, hold_s=0.5)
SORTER = Sorter(TASK, RIG)
LINE = (0.6 + MARGIN) * HALF
TINY = 1e-9


def fractions(*points: tuple[float, float]) -> np.ndarray:
    """Return places [m] at fractions of the half sides."""
    return np.array(points) * HALF


def targets_of(ids, points, task=TASK, swirl=1.0, rig=RIG):
    """Return the request for parts at fractions of the half sides."""
    return Sorter(task, rig).request(Parts.make(ids, fractions(*points)), swirl)


def test_parts_are_to_come_a_little_beyond_their_lines():
    to = targets_of(("grey_1", "black_1"), [(-0.3, 0.0), (0.9, 0.0)])
    assert (to.low[0, 0], to.high[0, 0]) == pytest.approx((LINE[0], HALF[0]))
    assert (to.low[1, 0], to.high[1, 0]) == pytest.approx((-HALF[0], -LINE[0]))
    assert to.gap_m > 0


def test_the_weight_of_the_farthest_part_is_inversely_proportional_to_its_distance():
    for x in (-0.9, -0.2, 0.3, 0.5):
        to = targets_of(("grey_1", "grey_2"), [(x, 0.0), (0.58, 0.0)])
        way = LINE[0] - x * HALF[0]
        assert to.weight[:, 0] * way == pytest.approx(0.006)
    near = targets_of(("grey_1",), [(0.6299, 0.0)])
    assert near.weight[0, 0] == pytest.approx(1.2)  # and not beyond all bounds


def test_far_parts_keep_to_their_lane_and_near_ones_do_not():
    ids, points = ("grey_1", "black_1", "grey_2"), [(-0.5, 0.0), (0.5, 0.0), (0.7, 0.0)]
    for swirl in (1.0, -1.0):
        to = targets_of(ids, points, swirl=swirl)
        upper, lower = (0, 1) if swirl > 0 else (1, 0)
        assert to.low[upper, 1] == pytest.approx(LANE_AT * HALF[1])
        assert to.high[lower, 1] == pytest.approx(-LANE_AT * HALF[1])
        assert np.all(to.weight[:2, 1] > 0)
        assert to.weight[2, 1] == 0
        assert (to.low[2, 1], to.high[2, 1]) == pytest.approx((-HALF[1], HALF[1]))


def test_parts_that_all_go_to_one_side_need_no_lanes():
    to = targets_of(("grey_1", "grey_2"), [(-0.5, 0.1), (-0.2, -0.1)])
    assert np.all(to.weight[:, 1] == 0)


@pytest.mark.parametrize("up", [1, -1])
def test_parts_for_opposite_corners_go_in_lanes_and_then_on_to_their_corners(up):
    corners = {"black": Side(-1, -up), "grey": Side(1, up)}
    sorter = Sorter(replace(TASK, regions=corners), RIG)
    ids, points = ("grey_1", "black_1", "grey_2"), [(-0.5, -0.9), (0.5, -0.9), (0.62, 0.0)]
    parts = Parts.make(ids, fractions(*points))
    swirl = sorter.swirl(None, parts)
    assert swirl == sorter.swirl(-swirl, parts) == up
    to = sorter.request(parts, swirl)
    inner = np.array([LANE_AT, -LANE_AT, LINE[1] / HALF[1]]) * up * HALF[1]
    nearer = np.where(inner > 0, to.low[:, 1], to.high[:, 1])
    assert nearer == pytest.approx(inner)
    assert to.weight[2, 1] == pytest.approx(to.weight[2, 0])
    beside = {"black": Side(-1, up), "grey": Side(1, up)}  # one swirl does not lead to both
    to = targets_of(ids, points, replace(TASK, regions=beside), sorter.swirl(None, parts))
    assert np.where(up > 0, to.low[:, 1], to.high[:, 1]) == pytest.approx(up * LINE[1])


def test_the_swirl_has_the_nearer_direction_and_rarely_changes_it():
    def parts(*heights):
        return Parts.make(("grey_1", "black_1"), fractions((-0.5, heights[0]), (0.5, heights[1])))

    assert SORTER.swirl(None, parts(0.5, -0.5)) == 1.0
    assert SORTER.swirl(None, parts(-0.5, 0.5)) == -1.0
    assert SORTER.swirl(1.0, parts(-0.1, 0.1)) == 1.0
    assert SORTER.swirl(1.0, parts(-0.5, 0.5)) == -1.0
    assert SORTER.swirl(-1.0, parts(0.5, 0.5)) == -1.0
    assert SORTER.swirl(1.0, Parts.make((), np.zeros((0, 2)))) == 1.0


def test_the_mirror_image_gets_the_mirrored_request():
    rng = np.random.default_rng(1)
    position = rng.uniform(-HALF, HALF, (8, 2))
    ids = tuple(f"{('black', 'grey')[i % 2]}_{i}" for i in range(8))
    swapped = tuple(f"{('grey', 'black')[i % 2]}_{i}" for i in range(8))
    to = SORTER.request(Parts.make(ids, position), 1.0)
    mirror = SORTER.request(Parts.make(swapped, position * [-1, 1]), -1.0)
    assert mirror.low[:, 0] == pytest.approx(-to.high[:, 0])
    assert mirror.low[:, 1] == pytest.approx(to.low[:, 1])
    assert mirror.weight == pytest.approx(to.weight)


def test_a_class_without_a_goal_is_only_kept_on_the_plate():
    to = targets_of(("red_1", "grey_1"), [(0.3, 0.3), (0.0, 0.0)])
    assert np.all(to.weight[0] == 0)
    parts = Parts.make(("red_1",), np.array([[0.29, 0]]))
    assert np.isnan(SORTER.to_go(parts)[0])
    there = Parts.make(("red_1", "grey_1"), np.array([[0.29, 0], [0.25, 0]]))
    now = Situation(
        there, 0.0, 0.1, 0.1, 0.1, True, True, there.position, np.zeros(2), True, there, 0.0
    )
    found = SORTER.assess(None, now)[1]
    assert (found.count, found.total, found.goal_met) == (1, 1, True)
    assert found.outcome == "1 of 1 parts in their regions"


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


def test_corners_are_requested_along_both_axes_and_top_is_left_rotated():
    task = SortTask({"black": Side(-1, 1), "grey": Side(0, 1)}, goal_fraction=0.6, hold_s=0.5)
    ids = ("black_1", "black_2", "black_3", "grey_1", "grey_2")
    points = [(-0.7, 0.7), (-0.7, 0.3), (0.3, 0.2), (0.86, 0.7), (0.0, 0.0)]
    parts = Parts.make(ids, fractions(*points))
    short = [0, 0.3 * HALF[1], np.hypot(0.9 * HALF[0], 0.4 * HALF[1]), 0, 0.6 * HALF[1]]
    assert Sorter(task, RIG).to_go(parts) == pytest.approx(np.array(short))
    to = targets_of(ids, points, task)
    assert to.high[2, 0] == pytest.approx(-LINE[0])
    assert to.low[2, 1] == pytest.approx(LINE[1])
    assert np.all(to.weight[2] > 0)
    assert to.weight[4, 0] == 0  # grey's x is free
    # On a square plate the rules along y are those along x.
    square = replace(RIG, plate=replace(RIG.plate, width_m=RIG.plate.length_m))
    up = Sorter(SortTask({"grey": Side(0, 1)}, 0.6, 0.5), square)
    right = Sorter(SortTask({"grey": Side(1, 0)}, 0.6, 0.5), square)
    point = np.array([[0.05, 0.06], [0.03, 0.09], [-0.2, -0.27]])
    names = ("grey_1", "grey_2", "grey_3")
    a = up.request(Parts.make(names, point), 1.0)
    b = right.request(Parts.make(names, point[:, ::-1]), 1.0)
    assert a.low[:, 1] == pytest.approx(b.low[:, 0])
    assert a.weight[:, 1] == pytest.approx(b.weight[:, 0])


BIN = Bin(((-0.2, -0.1), (-0.05, -0.1), (-0.05, -0.02), (-0.12, 0.04), (-0.2, -0.02)))


def within_bin(point: np.ndarray) -> np.ndarray:
    """Return the distances (n,) [m] of points from the sides of the bin, which is convex; negative
    outside."""
    corner = np.array(BIN.corner)
    side = np.roll(corner, -1, axis=0) - corner
    arm = point[:, None] - corner
    area = side[:, 0] * arm[..., 1] - side[:, 1] * arm[..., 0]
    return np.min(area / np.hypot(*side.T), axis=1)


def test_distance_to_a_bin_is_zero_within_and_to_the_outline_without():
    sorter = Sorter(SortTask({"black": BIN}, 0.0, 0.5), RIG)
    points = [(-0.1, -0.06), (0.05, -0.06), (-0.12, 0.05), (-0.2, -0.13), (-0.23, -0.14)]
    parts = Parts.make(tuple(f"black_{i}" for i in range(5)), np.array(points))
    assert sorter.to_go(parts) == pytest.approx(np.array([0, 0.1, 0.01, 0.03, 0.05]))


def test_parts_for_a_bin_are_each_to_come_into_a_slot():
    sorter = Sorter(SortTask({"black": BIN}, 0.0, 0.5), RIG)
    parts = Parts.make(("black_1", "black_2"), np.array([[0.1, 0.0], [-0.15, 0.1]]))
    to = sorter.request(parts, 1.0)
    middle, slot = (to.low + to.high) / 2, bin_slots(BIN, "black", RIG)
    gap = np.hypot(*(middle[:, None] - slot[None]).transpose(2, 0, 1))
    assert np.min(gap, axis=1) == pytest.approx(0, abs=1e-9)
    assert len(set(np.argmin(gap, axis=1))) == 2
    for end in (to.low, to.high):  # anywhere there it is within the bin
        assert np.all(within_bin(end) >= RIG.parts.radius_m * 0.2)
    assert np.all(to.weight > 0)


def test_slots_are_apart_and_clear_of_the_bins_sides():
    slot = bin_slots(BIN, "black", RIG)
    radius = RIG.parts.radius_m
    gap = np.hypot(*(slot[:, None] - slot[None]).transpose(2, 0, 1)) + np.eye(len(slot))
    assert len(slot) >= 8  # its area has room for 15 squares
    assert np.min(gap) >= 3.5 * radius - 1e-9
    assert np.min(within_bin(slot)) >= 1.25 * radius - 1e-9


def test_a_bin_too_small_for_its_parts_is_refused():
    small = Bin(((0.0, 0.0), (0.05, 0.0), (0.05, 0.05), (0.0, 0.05)))
    scenario = replace(load_scenario("sort_4"), task=SortTask({"black": small, "grey": BIN}, 0, 0))
    room = len(bin_slots(small, "black", RIG))
    assert room == 4  # two by two, 28 mm apart in 50 mm less 10 mm at each side
    scenario = replace(scenario, parts=(PartGroup("black", room + 1), PartGroup("grey", 2)))
    with pytest.raises(ScenarioError, match=rf"black has {room + 1} parts, .* at most {room} "):
        Sorter(scenario.task, RIG).check(scenario)


@pytest.mark.parametrize(
    ("inner", "min_gap_mm", "room"), [(0.08, 20, 10), (0.12, 20, 5), (0.124, 14, 5), (0.13, 0, 0)]
)
def test_parts_for_a_bin_along_an_edge_keep_behind_the_wall_if_it_has_room_there(
    inner, min_gap_mm, room
):
    """The wall is 20 mm from the edge, and 14 mm are required. Slots are 10 mm from the sides."""
    strip = Bin(((-0.1, inner), (0.05, inner), (0.05, 0.15), (-0.1, 0.15)))
    slot = bin_slots(strip, "black", RIG)
    assert len(slot) == room
    if room:
        assert 1e3 * np.min(0.15 - slot[:, 1]) >= min_gap_mm - 1e-6
        sorter = Sorter(SortTask({"black": strip, "grey": BIN}, 0, 0), RIG)
        parts = Parts.make(("black_1",), np.zeros((1, 2)))
        assert sorter.request(parts, 1.0).high[0, 1] <= 0.15 - 1e-3 * min_gap_mm + 1e-9


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_two_bins_in_one_place_are_refused(shift):
    other = Bin(tuple((x + shift, y) for x, y in BIN.corner))
    beside = Bin(tuple((-x, y) for x, y in BIN.corner))
    scenario = load_scenario("sort_4")
    with pytest.raises(
        ScenarioError, match=r"bin_m of black and of grey overlap .* allowed: bins that do"
    ):
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
        with pytest.raises(ScenarioError, match=r"black has 16 parts, allowed: at most 15 "):
            Sorter(task, RIG).check(crowded)


def test_without_parts_there_is_no_request():
    request = SORTER.request(Parts.make((), np.zeros((0, 2))), 1.0)
    assert request.low.shape == request.high.shape == (0, 2)
