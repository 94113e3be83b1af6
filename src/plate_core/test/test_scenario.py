"""Scenarios: the shipped ones, refusals, and the places at which parts start."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from plate_core import ScenarioError, config_path, load_rig
from plate_core.tasks import (
    Bin,
    FollowTask,
    PartGroup,
    Side,
    SortTask,
    check_scenario,
    edge_warnings,
    load_scenario,
    scenario_names,
    start_positions,
)
from plate_core.tasks.scenario import RANDOM_GAPS

SORT = """
description: test
parts:
  - {class: black, count: 2}
  - {class: grey, positions_m: [[0.1, 0.0]]}
task: {kind: sort, sides: {black: left, grey: right}, goal_fraction: 0.6, hold_s: 0.5}
time_limit_s: 10
"""

FOLLOW = """
description: test
parts:
  - {class: black, positions_m: [[0.0, 0.0]]}
task:
  kind: follow
  max_error_m: 0.03
  paths:
    - {class: black, waypoints_m: [[0, 0], [0.1, 0], [0.1, 0.1]], speed_mps: 0.02, closed: true,
       laps: 2}
time_limit_s: 60
"""


ASSEMBLE = """
description: test
parts:
  - {class: black, count: 2}
  - {class: grey, count: 1}
task: {kind: assemble, places_m: {black: [[0.1, 0], [0.1, 0.1]], grey: [[0, 0]]},
       tolerance_m: 0.003, hold_s: 1}
time_limit_s: 60
"""

POSE = """
description: test
marked: true
parts:
  - {class: black, count: 2}
task:
  kind: pose
  poses:
    - {class: black, angle_deg: 90}
    - {class: black, place_m: [0.1, 0], angle_deg: -45}
  tolerance_m: 0.003
  tolerance_deg: 3
  hold_s: 1
time_limit_s: 60
"""

MOVE = """
description: test
parts:
  - {class: black, count: 1}
task: {kind: move, targets: [{id: black_1, place_m: [0.1, 0.1]}], tolerance_m: 0.002, hold_s: 0}
time_limit_s: 10
"""

BINS = """
description: test
parts:
  - {class: black, count: 2}
  - {class: grey, count: 1}
task:
  kind: sort
  regions:
    black: top_left
    grey: {bin_m: [[0.1, 0], [0.2, 0], [0.15, 0.1]]}
  goal_fraction: 0.5
  hold_s: 0
time_limit_s: 10
"""

CIRCLE = FOLLOW.replace(
    "waypoints_m: [[0, 0], [0.1, 0], [0.1, 0.1]], speed_mps: 0.02, closed: true",
    "circle: {centre_m: [0.1, 0], radius_m: 0.05, start_deg: 90, turn: right}, speed_mps: 0.02",
)
SPLINE = FOLLOW.replace("waypoints_m", "spline_m").replace(
    "mps: 0.02", "mps: [[0, 0.01], [1, 0.03]]"
)


def write(folder: Path, text: str) -> Path:
    path = folder / "trial.yaml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def rig():
    return load_rig()


@pytest.mark.parametrize("name", scenario_names())
def test_shipped_scenarios_load_and_fit_the_default_rig(name, rig):
    scenario = load_scenario(name)
    rig = load_rig(scenario.rig) if scenario.rig else rig
    labels, position = start_positions(scenario, rig, np.random.default_rng(0))
    assert scenario.name == name
    assert labels == scenario.labels
    assert position.shape == (scenario.count, 2)
    assert np.all(np.abs(position) < rig.plate.half - rig.parts.radius_m)


def test_the_papers_tasks_are_shipped():
    sort, follow = load_scenario("sort_10"), load_scenario("follow_2")
    assert sort.parts == (PartGroup("black", 5), PartGroup("grey", 5))
    assert isinstance(sort.task, SortTask)
    assert dict(sort.task.regions) == {"black": Side(-1, 0), "grey": Side(1, 0)}
    assert isinstance(follow.task, FollowTask)
    assert [path.speed for path in follow.task.paths] == [0.04, 0.04]
    starts = [path.waypoint[0] for path in follow.task.paths]
    assert list(follow.parts[0].position or ()) == starts


def test_an_unknown_name_lists_the_available_ones():
    with pytest.raises(ScenarioError, match=r"11' \(did you mean sort_\d+\?\).*follow_2") as info:
        load_scenario("sort_11")
    assert "\n" not in str(info.value)


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (
            SORT,
            "class: black",
            "class: black_1",
            r"0\]: class is 'black_1', allowed: lower-case letters",
        ),
        (SORT, "count: 2", "cuont: 2", r"0\]: .*found cuont \(did you mean count\?\), al"),
        (SORT, ", count: 2", "", r"\[0\]: count or positions_m is missing, allowed: one"),
        (SORT, "hold_s: 0.5", "hold_s: 10", r"task: hold_s is 10, allowed: less than time_limit_s"),
        (SORT, "hold_s: 0.5", "hold_s: 0,5", r"hold_s is 0,5 at line \d, .* point, 0.5$"),
        (SORT, "limit_s: 10", "limit_s: 1,50", r"time_limit_s is 1,50 at line \d, .*, 1.50$"),
        (SORT, "class: grey", "class: black", r"parts is .*allowed: each class once"),
        (SORT, "black: left", "black: up", r"black is 'up', allowed: one of left, right, bottom"),
        (SORT, ", grey: right", "", r"grey is missing"),
        (SORT, "grey: right", "grey: right, red: left", r"unknown key red, allowed: black, grey"),
        (SORT, "hold_s: 0.5", "hold_s: 0.5, hold_s: 5", r"key hold_s occurs twice, at line"),
        (SORT, "time_limit_s: 10", "task: {kind: sort}", r"key task occurs twice, at"),
        (SORT, "kind: sort", "kind: juggle", r"kind is 'juggle', allowed: one of sort, follow"),
        (SORT, "time_limit_s", "time_limits", r"time_limit_s is missing, .*the file has time_lim"),
        (SORT, "[[0.1, 0.0]]", "[[0.1, 0.0]], count: 1", r"count and positions_m are given"),
        (SORT, "[[0.1, 0.0]]", "[0.1, 0.0]", r"positions_m is \[0.1, 0.0\], allowed: n x 2"),
        (FOLLOW, "closed: true", "closed: 1", r"closed is 1, allowed: true or false"),
        (FOLLOW, "[0.1, 0.1]]", "[0.1, 0.0]]", r"waypoints_m is .*different from the next"),
        (FOLLOW, "[0.1, 0.1]]", "[0, 0]]", r"waypoints_m is .*differs from the first"),
        (FOLLOW, "- {class: black, w", "- {class: grey, w", r"class is 'grey', allowed: one of bl"),
        (CIRCLE, "laps: 2", "laps: 2, spline_m: []", r"circle and spline_m are given, allowed"),
        (SPLINE, "[1, 0.03]", "[0.9, 0.03]", r"speed_mps is .*fractions that increase from 0 to 1"),
        (SPLINE, "[0, 0.01]", "[0, 0]", r"speed_mps is .*speeds from 1e-05 to 10"),
        (SPLINE, "[0, 0.01], ", "", r"speed_mps is .*fractions that increase from 0 to 1"),
        (SPLINE, "[0, 0.01]", "[0.1, 0.01]", r"speed_mps is .*fractions that increase from 0 to 1"),
        (
            SPLINE,
            "[1, 0.03]",
            "[0, 0.02], [1, 0.03]",
            r"speed_mps is .*fractions that increase from",
        ),
        (SPLINE, ", [0.1, 0.1]]", "]", r"spline_m is .*at least three points"),
        (BINS, "top_left", "middle", r"regions: black is 'middle', allowed: one of left, .*"),
        (BINS, ", [0.15, 0.1]]", "]", r"grey: bin_m is .*at least three corners"),
        (BINS, "[0.15, 0.1]", "[0.3, 0]", r"grey: bin_m is .*with an area"),
        (BINS, "[0.15, 0.1]", "[0.1, 0.1], [0.2, 0.1]", r"grey: bin_m is .*in order"),
        (ASSEMBLE, ", [0.1, 0.1]]", "]", r"places_m has 1 places for class black, allowed: 2, one"),
        (ASSEMBLE, ", grey: [[0, 0]]", "", r"places_m: grey is missing"),
        (POSE, "    - {class: black, angle_deg: 90}\n", "", r"poses .*black.*allowed: 2"),
        (
            FOLLOW,
            "[[0.0, 0.0]]",
            "[[0.0, 0.0], [0.1, 0.0]]",
            r"1 paths for class black, allowed: 2",
        ),
    ],
)
def test_wrong_files_are_refused_with_key_value_and_allowed(tmp_path, text, old, new, message):
    assert old in text
    with pytest.raises(ScenarioError, match=message) as info:
        load_scenario(write(tmp_path, text.replace(old, new, 1)))
    assert str(info.value).startswith("trial.yaml")


def test_regions_are_sides_corners_and_bins(tmp_path):
    task = load_scenario(write(tmp_path, BINS)).task
    assert dict(task.regions) == {
        "black": Side(-1, 1),
        "grey": Bin(((0.1, 0.0), (0.2, 0.0), (0.15, 0.1))),
    }


def test_a_circle_and_a_spline_with_a_speed_profile(tmp_path):
    circle = load_scenario(write(tmp_path, CIRCLE)).task.paths[0]
    point = np.array(circle.waypoint)
    assert (circle.closed, circle.laps, circle.speed, circle.profile) == (True, 2, 0.02, ())
    assert point[0] == pytest.approx([0.1, 0.05])
    assert point[1, 0] > 0.1  # turns right
    assert np.hypot(*(point - [0.1, 0]).T) == pytest.approx(np.full(len(point), 0.05))
    spline = load_scenario(write(tmp_path, SPLINE)).task.paths[0]
    assert (spline.speed, spline.profile) == (0.03, ((0, 0.01), (1, 0.03)))
    assert len(spline.waypoint) > 30


def test_places_go_by_class(tmp_path):
    task = load_scenario(write(tmp_path, ASSEMBLE)).task
    assert task.labels == ("black", "black", "grey")
    assert task.place == ((0.1, 0), (0.1, 0.1), (0, 0))


def test_places_too_near_each_other_and_bins_off_the_plate_are_refused(tmp_path, rig):
    near = load_scenario(write(tmp_path, ASSEMBLE.replace("[0.1, 0.1]", "[0.1, 0.019]")))
    with pytest.raises(ScenarioError, match=r"places_m of black .* 19 mm apart, allowed: 20 mm"):
        check_scenario(near, rig)
    off = load_scenario(write(tmp_path, BINS.replace("[0.2, 0]", "[0.301, 0]")))
    with pytest.raises(ScenarioError, match=r"bin_m of grey is \(0.301, 0\) m, .* to 0.3,"):
        check_scenario(off, rig)


EDGES = [
    (ASSEMBLE, "[0.1, 0.1]", "places_m"),
    (FOLLOW, "[0.1, 0.1]", "paths"),
    (MOVE, "[0.1, 0.1]", "place of black_1"),
    (POSE, "[0.1, 0]", "poses: place_m"),
]


@pytest.mark.parametrize(("text", "old", "key"), EDGES, ids=[key for _, _, key in EDGES])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1])
def test_positions_too_near_an_edge_are_refused_and_near_ones_cause_a_warning(
    tmp_path, rig, text, old, key, sign, axis
):
    """The stroke and half a radius, 14 mm, have to be; the stroke and 1.25 radii, 20 mm, are
    safe."""

    def near(mm):
        place = [0.05, 0.05]
        place[axis] = round(sign * (float(rig.plate.half[axis]) - 1e-3 * mm), 6)
        scenario = load_scenario(write(tmp_path, text.replace(old, str(place))))
        check_scenario(scenario, rig)
        return edge_warnings(scenario, rig)

    assert text.count(old) == 1
    with pytest.raises(ScenarioError, match=rf"{key}.* is \(.*286, \|y\| up to 0.136 .* 14 mm"):
        near(13.9)
    (doubt,) = near(19.9)
    assert "19.9 mm from an edge, advised: 20 mm" in doubt
    assert near(20.0) == ()


def test_the_start_of_a_part_that_must_stay_is_checked_as_its_target(tmp_path, rig):
    """Their place is where they start."""
    start = "positions_m: [[0.288, 0], [0.1, 0.05]]"
    scenario = load_scenario(write(tmp_path, POSE.replace("count: 2", start)))
    with pytest.raises(ScenarioError, match=r"positions_m of black is \(0.288, 0\) m, .*allowed"):
        check_scenario(scenario, rig)
    anywhere = replace(scenario, task=replace(scenario.task, anywhere=True))
    check_scenario(anywhere, rig)


def test_a_bin_whose_parts_would_all_be_lost_is_refused(tmp_path, rig):
    for y, fits in ((0.135, True), (0.137, False)):
        strip = BINS.replace("0.1]]", "0.15]]").replace("0]", f"{y}]")
        scenario = load_scenario(write(tmp_path, strip))
        if fits:
            check_scenario(scenario, rig)
            continue
        with pytest.raises(ScenarioError, match=r"bin_m of grey has .* 14 mm .*allowed: "):
            check_scenario(scenario, rig)


def test_unknown_classes_and_invisible_angles_are_refused(tmp_path, rig):
    with pytest.raises(ScenarioError, match=r"class is 'gray' .did you mean grey.*: black, grey$"):
        check_scenario(load_scenario(write(tmp_path, SORT.replace("grey", "gray"))), rig)
    with pytest.raises(ScenarioError, match=r"marked is false, .*black require marked: true"):
        check_scenario(load_scenario(write(tmp_path, POSE.replace("marked: true", ""))), rig)
    shapes = load_rig("shapes")
    check_scenario(load_scenario(write(tmp_path, POSE.replace("black", "bar"))), shapes)
    with pytest.raises(ScenarioError, match=r"angles of washer are given, allowed: .*not round"):
        check_scenario(load_scenario(write(tmp_path, POSE.replace("black", "washer"))), shapes)
    with pytest.raises(ScenarioError, match=r"class is 'black'.*, allowed with this rig: nut, "):
        check_scenario(load_scenario(write(tmp_path, SORT)), shapes)


def test_placed_parts_that_overlap_are_refused(tmp_path, rig):
    text = SORT.replace("count: 2", "positions_m: [[0.1, 0.012], [0, 0]]")
    words = (
        r"^trial.yaml: parts: positions_m of black \(0.1, 0.012\) m and of grey \(0.1, 0\) m are "
        r"12 mm apart, allowed: 16 mm or more"
    )
    with pytest.raises(ScenarioError, match=words):
        check_scenario(load_scenario(write(tmp_path, text)), rig)
    check_scenario(load_scenario(write(tmp_path, text.replace("0.012", "0.016"))), rig)


@pytest.mark.parametrize(
    ("black", "grey", "shared_cm2"),
    [
        ("left", "right", 0),
        ("left", "left", 450),
        ("left", "top_left", 112.5),
        ("bottom_left", "top_left", 0),
        ("top_left", "bottom_right", 0),
        ("left", "{bin_m: [[-0.15, 0], [0, 0], [0, 0.1], [-0.15, 0.1]]}", 0),
        ("left", "{bin_m: [[-0.16, 0], [0, 0], [0, 0.1], [-0.16, 0.1]]}", 10),
        ("{bin_m: [[-0.16, 0], [0, 0], [0, 0.1], [-0.16, 0.1]]}", "left", 10),
        ("left", "{bin_m: [[-0.29, 0], [-0.2, 0], [-0.2, 0.1]]}", 45),
        ("top_left", "{bin_m: [[-0.2, 0], [-0.2, 0.1], [-0.25, 0]]}", 2.5**2 / 4),
        # a U about the corner's lower edge: two arms of 1 x 2.5 cm reach into it
        (
            "top_left",
            "{bin_m: [[-0.25, 0], [-0.18, 0], [-0.18, 0.1], [-0.19, 0.1], [-0.19, 0.05],"
            " [-0.24, 0.05], [-0.24, 0.1], [-0.25, 0.1]]}",
            5.0,
        ),
    ],
)
def test_regions_of_two_classes_have_no_area_in_common(tmp_path, rig, black, grey, shared_cm2):
    """On 0.6 x 0.3 m, goal lines at half of the half sides: areas by hand."""
    regions = f"regions: {{black: {black}, grey: {grey}}}, goal_fraction: 0.5"
    text = SORT.replace("sides: {black: left, grey: right}, goal_fraction: 0.6", regions)
    scenario = load_scenario(write(tmp_path, text))
    if not shared_cm2:
        check_scenario(scenario, rig)
        return
    with pytest.raises(ScenarioError, match=r"overlap by .*allowed: regions") as info:
        check_scenario(scenario, rig)
    assert str(info.value).startswith("trial.yaml: task: regions: ")
    assert f"by {shared_cm2:.3g} cm2" in str(info.value)


def test_a_hundred_parts_in_all_are_allowed(rig):
    scenario = load_scenario("sort_4")
    black, grey = scenario.parts
    whole = replace(scenario, parts=(replace(black, count=60), replace(grey, count=40)))
    check_scenario(whole, rig)
    with pytest.raises(ScenarioError, match="parts: their number is 101, allowed: at most 100"):
        check_scenario(replace(whole, parts=(black, replace(grey, count=99))), rig)


def test_a_missing_or_damaged_file_causes_a_message_of_one_line(tmp_path):
    with pytest.raises(ScenarioError, match="no such file"):
        load_scenario(tmp_path / "nowhere.yaml")
    with pytest.raises(ScenarioError, match="broken YAML at line"):
        load_scenario(write(tmp_path, "parts: [1, 2"))


def test_a_scenario_names_its_rig(tmp_path):
    assert load_scenario("sort_4").rig == ""
    assert load_scenario("follow_2_desk").rig == "desk"
    mine = tmp_path / "mine.yaml"
    mine.write_text((config_path("rigs") / "desk.yaml").read_text("utf-8"), encoding="utf-8")
    found = load_scenario(write(tmp_path, SORT + "rig: mine.yaml\n")).rig  # beside the scenario
    assert load_rig(found) == load_rig("desk")
    with pytest.raises(ScenarioError, match=r"rig is 'desc', allowed: desk, .*did you mean desk\?"):
        load_scenario(write(tmp_path, SORT + "rig: desc\n"))


def test_laps_count_for_closed_paths_only(tmp_path):
    closed = load_scenario(write(tmp_path, FOLLOW)).task.paths[0]
    path = load_scenario(write(tmp_path, FOLLOW.replace("true,\n       laps: 2", "false"))).task
    assert closed.laps == 2
    assert path.paths[0].laps == 1


def test_scattered_parts_keep_apart_and_clear_of_the_edges(rig):
    scenario = load_scenario("sort_10")
    for seed in range(20):
        _, position = start_positions(scenario, rig, np.random.default_rng(seed))
        gap = np.hypot(*(position[:, None] - position[None]).transpose(2, 0, 1))
        assert np.min(gap + np.eye(len(position))) >= RANDOM_GAPS[0] * rig.parts.radius_m
        assert np.all(np.abs(position) <= [0.85 * 0.30, 0.80 * 0.15])


def test_the_same_seed_gives_the_same_start(rig):
    scenario = load_scenario("sort_6")
    first = start_positions(scenario, rig, np.random.default_rng(7))[1]
    again = start_positions(scenario, rig, np.random.default_rng(7))[1]
    other = start_positions(scenario, rig, np.random.default_rng(8))[1]
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_given_and_scattered_parts_mix_in_the_order_of_the_file(tmp_path, rig):
    scenario = load_scenario(write(tmp_path, SORT))
    labels, position = start_positions(scenario, rig, np.random.default_rng(3))
    assert labels == ("black", "black", "grey")
    assert tuple(position[2]) == (0.1, 0.0)


def test_too_many_parts_are_refused(tmp_path, rig):
    scenario = load_scenario(write(tmp_path, SORT.replace("count: 2", "count: 90")))
    large = replace(rig, parts=replace(rig.parts, radius_m=0.025))
    with pytest.raises(ScenarioError, match=r"count is 90 .*, allowed: at most \d\d\. .* 25 mm"):
        start_positions(scenario, large, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "radius", "sides"), [("sort_10", 0.025, (0.6, 0.3)), ("sort_4", 0.005, (0.15, 0.15))]
)
def test_parts_are_scattered_by_their_size(rig, name, radius, sides):
    plate = replace(rig.plate, length_m=sides[0], width_m=sides[1])
    other = replace(rig, plate=plate, parts=replace(rig.parts, radius_m=radius))
    for seed in range(5):
        _, position = start_positions(load_scenario(name), other, np.random.default_rng(seed))
        gap = np.hypot(*(position[:, None] - position[None]).transpose(2, 0, 1))
        assert np.min(gap + np.eye(len(position))) >= 2.5 * radius
        assert np.all(np.abs(position) <= plate.half - 1.5 * radius)


@pytest.mark.parametrize("text", [SORT, FOLLOW])
def test_points_off_the_plate_are_refused(tmp_path, rig, text):
    scenario = load_scenario(write(tmp_path, text.replace("[0.1, 0", "[0.295, 0", 1)))
    with pytest.raises(ScenarioError, match=r"is \(0.295, 0\) m, .*allowed: \|x\| up to 0.2"):
        start_positions(scenario, rig, np.random.default_rng(0))


def test_poses_are_read_in_radians_and_a_place_may_be_left_out(tmp_path):
    scenario = load_scenario(write(tmp_path, POSE))
    stays, goes = scenario.task.poses
    assert scenario.marked
    assert stays.place is None
    assert stays.angle == pytest.approx(np.pi / 2)
    assert goes.place == (0.1, 0.0)
    assert scenario.task.tolerance_rad == pytest.approx(np.radians(3))
