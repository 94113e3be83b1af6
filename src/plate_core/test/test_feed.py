"""Feeding: keys of its scenario files, and which parts a gripper can take."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from plate_core import Parts, ScenarioError, load_rig
from plate_core.tasks import (
    FeedMode,
    Pick,
    check_scenario,
    free_gap,
    load_scenario,
    pick_window,
    ready_parts,
    remaining_rotation,
)

RIG, SHAPES = load_rig(), load_rig("shapes")

FILE = """
description: test
parts:
  - {class: black, count: 2}
  - {class: grey, count: 0}
task:
  kind: feed
  picks:
    - {class: black, ready: 2, window_m: [[0.0, -0.1], [0.2, 0.1]]}
  clearance_m: 0.006
  chute: left
  hopper: {fill: 15, least: 12, rate_ps: 10, place_m: [-0.18, 0], spread_m: 0.05}
"""


def load(tmp_path, text):
    path = tmp_path / "recipe.yaml"
    path.write_text(text, encoding="utf-8")
    scenario = load_scenario(path)
    check_scenario(scenario, RIG)
    return scenario


def test_a_recipe_is_read(tmp_path):
    task = load(tmp_path, FILE).task
    assert task.picks == (Pick("black", 2, (0.0, -0.1), (0.2, 0.1), None, math.radians(5)),)
    assert (task.chute.x, task.chute.y) == (-1, 0)
    assert task.hopper.mix == {"black": 1.0}
    assert (task.hopper.fill, task.hopper.least) == (15, 12)
    assert task.order.mode is FeedMode.FEED
    assert math.isinf(load(tmp_path, FILE).time_limit_s)


def test_fractions_of_a_mix_may_be_rounded(tmp_path):
    given = "spread_m: 0.05, mix: {black: 0.6666667, grey: 0.3333334}"
    mix = load(tmp_path, FILE.replace("spread_m: 0.05", given)).task.hopper.mix
    np.random.default_rng(0).choice(list(mix), p=list(mix.values()))  # as the simulator does
    assert mix["black"] == pytest.approx(2 / 3, abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("class: black, ready", "class: red, ready", "class is 'red'"),
        ("ready: 2", "ready: 16", r"at most 15, .*now 16"),
        ("[[0.0, -0.1], [0.2, 0.1]]", "[[0.2, 0.1], [0.0, -0.1]]", "lower left corner, then"),
        ("[[0.0, -0.1], [0.2, 0.1]]", "[[0.0, 0.2], [-0.1, 0.1]]", "lower left corner, then"),
        ("[0.2, 0.1]", "[0.4, 0.1]", r"window of black is .*0.4"),
        (
            "[[0.0, -0.1], [0.2, 0.1]]",
            "[[0, 0.137], [0.2, 0.14]]",
            "window of black has .* 14 mm .*allowed",
        ),
        ("ready: 2", "ready: 2, angle_deg: 10", "angles? of black"),
        ("clearance_m: 0.006", "clearance_m: 0.3", "at most 1, .* a clearance of 300 mm"),
        ("chute: left", "chute: up", "chute is 'up'"),
        ("fill: 15", "fill: 10", "least is 12, allowed: at most fill, which is 10"),
        ("spread_m: 0.05", "spread_m: 0.05, mix: {black: 0.5}", "fractions of .*sum is 1"),
        ("spread_m: 0.05", "spread_m: 0.05, mix: {grey: 1}", "0 for each class of picks.*black"),
        (
            "spread_m: 0.05",
            "spread_m: 0.05, mix: {blak: 1}",
            r"'blak' is unknown \(did you mean black",
        ),
        (
            "[[0.0, -0.1], [0.2, 0.1]]",
            "[[0, 0], [1e-3, 1e-3]]",
            "ready of black is 2, allowed: at most 1, .*window of 1 by 1 mm",
        ),
        ("[-0.18, 0]", "[-0.38, 0]", "place_m is .-0.38, 0. m, allowed"),
        ("rate_ps: 10, ", "", "rate_ps"),
        (
            "- {class: black, ready",
            "- {class: black}\n    - {class: black, ready",
            "each class at most once",
        ),
    ],
)
def test_wrong_recipes_are_refused_by_name(tmp_path, old, new, message):
    assert old in FILE
    with pytest.raises(ScenarioError, match=message):
        load(tmp_path, FILE.replace(old, new))


def test_only_a_feed_may_begin_without_parts_of_a_class(tmp_path):
    text = FILE[: FILE.index("task:")] + (
        "task: {kind: sort, sides: {black: left, grey: right}, goal_fraction: 0.6, hold_s: 0.5}\n"
        "time_limit_s: 10\n"
    )
    with pytest.raises(ScenarioError, match="count is 0, allowed"):
        load(tmp_path, text)


def test_without_a_window_parts_keep_off_the_edges():
    pick = Pick("black", 1, (-math.inf, -math.inf), (math.inf, math.inf))
    low, high = pick_window(pick, RIG)
    assert high == pytest.approx(RIG.plate.half - (RIG.limits.stroke_m + 1.25 * 0.008))
    assert low == pytest.approx(-high)


def test_gaps_of_discs_are_exact():
    parts = Parts.make(("black_1", "black_2", "grey_1"), np.array([[0, 0], [0.03, 0.04], [0.2, 0]]))
    gap, rim = free_gap(parts, RIG), 2 * RIG.parts.radius_m
    assert gap[:2] == pytest.approx(0.05 - rim)
    assert gap[2] == pytest.approx(math.hypot(0.17, 0.04) - rim)
    assert free_gap(parts.take([0]), RIG) == [math.inf]
    assert len(free_gap(parts.take([]), RIG)) == 0


def test_gaps_of_outlines_are_those_of_fine_samples():
    rng = np.random.default_rng(3)
    labels = [str(rng.choice(["bar", "nut", "bracket", "washer"])) for _ in range(14)]
    ids = tuple(f"{label}_{k}" for k, label in enumerate(labels))
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(3)), -1).reshape(-1, 2)[:14]
    position = 0.034 * (grid - 1.0) + rng.uniform(-2e-3, 2e-3, (14, 2))
    parts = Parts.make(ids, position, angle=rng.uniform(-3, 3, 14))
    outlines = []
    for k, label in enumerate(labels):
        corner = SHAPES.part_type(label).polygon
        after = np.roll(corner, -1, axis=0)
        fine = np.concatenate([a + (b - a) * np.linspace(0, 1, 60)[:, None]
                               for a, b in zip(corner, after, strict=True)])  # fmt: skip
        turn, cos, sin = parts.angle[k], np.cos(parts.angle[k]), np.sin(parts.angle[k])
        assert np.isfinite(turn)
        outlines.append(fine @ np.array([[cos, sin], [-sin, cos]]) + position[k])
    gap = free_gap(parts, SHAPES)
    for k in range(14):
        other = np.concatenate([o for j, o in enumerate(outlines) if j != k])
        nearest, _ = cKDTree(other).query(outlines[k])
        assert gap[k] == pytest.approx(np.min(nearest), abs=4e-4)


def test_parts_that_overlap_have_no_gap():
    parts = Parts.make(("bar_1", "bar_2"), np.array([[0, 0], [0.002, 0.001]]))
    assert np.all(free_gap(parts, SHAPES) <= 0)


def test_ready_is_in_the_window_turned_and_alone():
    pick = Pick("bar", 1, (0.0, -0.1), (0.2, 0.1), 0.0, math.radians(5))
    position = np.array([[0.05, 0], [0.15, 0], [0.1, 0.08], [-0.1, 0], [0.1, -0.07], [0.1, -0.085]])
    parts = Parts.make(
        tuple(f"bar_{k}" for k in range(6)), position, angle=np.radians([3, 90, 179, 0, 0, 0])
    )
    ready = ready_parts(parts, pick, 0.006, SHAPES)
    assert ready.tolist() == [True, False, True, False, False, False]
    wide = replace(pick, angle=None)
    assert ready_parts(parts, wide, 0.002, SHAPES).tolist() == [
        True, True, True, False, True, True,
    ]  # fmt: skip
    assert not np.any(ready_parts(parts, replace(pick, label="nut"), 0.0, SHAPES))


def test_the_shorter_way_to_an_angle():
    parts = Parts.make(("bar_1", "bar_2"), np.zeros((2, 2)), angle=np.array([3.0, -1.0]))
    assert remaining_rotation(parts, 0.0, 2) == pytest.approx([np.pi - 3.0, 1.0])
    assert remaining_rotation(parts, 0.0, 1) == pytest.approx([-3.0, 1.0])
