"""Part types: the allowed contents of their file, and their moments."""

import pickle

import numpy as np
import pytest

from plate_core import RigError, config_path, load_rig
from plate_core.rig import load_part_types, moments


def write(tmp_path, text):
    path = tmp_path / "parts.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_shipped_types_are_centred_and_know_their_symmetry():
    types = load_part_types(config_path("parts.yaml"))
    symmetry = {name: part.symmetry for name, part in types.items()}
    assert symmetry == {
        "nut": 6, "washer": 0, "square": 4, "bar": 2, "bracket": 1, "coin_small": 0,
        "coin_middle": 0, "coin_large": 0, "screw": 1,
    }  # fmt: skip
    for part in types.values():
        area, centre, _ = moments(part.polygon, [np.array(hole) for hole in part.holes])
        np.testing.assert_allclose(centre, 0, atol=1e-9)
        assert part.area_m2 == pytest.approx(area)
    length, width = 0.024, 0.012
    np.testing.assert_allclose(types["bar"].spread_m2, np.diag([length**2, width**2]) / 12)
    assert types["coin_small"].spread_m2 == pytest.approx(np.eye(2) * 0.008**2 / 4, rel=2e-3)


def test_moments_of_a_polygon_agree_with_a_grid():
    outline = np.array([[0, 0], [0.03, 0], [0.03, 0.01], [0.01, 0.01], [0.01, 0.03], [0, 0.03]])
    axis = (np.arange(300) + 0.5) * 1e-4
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    inside = (x < 0.01) | (y < 0.01)
    area, centre, second = moments(outline)
    assert area == pytest.approx(inside.sum() * 1e-8)
    assert centre == pytest.approx([x[inside].mean(), y[inside].mean()])
    assert second[0, 1] == pytest.approx(np.sum(x * y * inside) * 1e-8)
    assert second[0, 0] == pytest.approx(np.sum(x * x * inside) * 1e-8, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        *(
            (f"{name}: {{radius_m: 0.01}}", f"type is '{name}', allowed: lower-case letters")
            for name in (
                "nut_3",
                "Nut",
                "4nut",
                "_nut",
                "nut_",
                "nut__m4",
                "nut-m4",
                "n" * 33,
                "black",
                "grey",
                "unknown",
                "group",
            )
        ),
        ("nut: {}", r"nut: outline_m or radius_m is missing"),
        ("nut: {radius_m: 0.01, outline_m: [[0, 0]]}", "outline_m and radius_m are given"),
        ("nut: {outline_m: [[0, 0], [1, 1], [1, 0], [0, 1]]}", "edges do not cross"),
        ("nut: {outline_m: [[0, 0], [1, 1]]}", "3 to 32 corners"),
        *(
            (f"nut: {{outline_m: [{corners}]}}", "outline_m is .*edges do not cross")
            for corners in (
                "[0, 0], [0.1, 0], [0.1, 0.1], [0, 0]",  # the first corner again
                "[0, 0], [0.1, 0], [0.1, 0], [0.1, 0.1]",
                "[0, 0], [0.1, 0], [0.2, 0]",  # a line
                "[0, 0], [0.2, 0], [0.1, 0], [0.1, 0.1]",  # back along an edge
                "[0, 0], [0.2, 0], [0.2, 0.2], [0.1, 0], [0, 0.2]",  # a corner on an edge
            )
        ),
        ("nut: {outline_m: [[0, 0], [1, .nan], [1, 1]]}", "outline_m is .*allowed: .*numbers"),
        ("nut: {outline_m: [[0, 0], [1.0e-5, 0], [0, 1.0e-5]]}", "at least 1e-08 m2"),
        *(
            (
                "nut: {outline_m: [[0, 0], [0.02, 0], [0.02, 0.02], [0, 0.02]], "
                f"holes_m: [{holes}]}}",
                "holes_m is .*allowed: holes .*do not overlap",
            )
            for holes in (
                "[[0.01, 0.005], [0.02, 0.005], [0.02, 0.01]]",  # along an edge of the outline
                "[[0.005, 0.005], [0.01, 0.005], [0.01, 0.01]], "
                "[[0.005, 0.005], [0.01, 0.005], [0.01, 0.01]]",
                "[[0, 0], [0.02, 0], [0.02, 0.02], [0, 0.02]]",
            )
        ),
        (
            "nut: {outline_m: [[0, 0], [0.02, 0], [0.02, 0.02], [0, 0.02]], holes_m: [[[1.0e-8, "
            "1.0e-8], [0.01999999, 1.0e-8], [0.01999999, 0.01999999], [1.0e-8, 0.01999999]]]}",
            "holes_m is .*allowed: holes that leave some area",
        ),
        ("nut: {radius_m: 0.01, symmetry: 3}", "symmetry is 3, allowed: 0 for a disc"),
        ("nut: {radius_m: 0.01, colour: red}", "unknown key colour"),
        ("nut: {radius_m: 0.01, holes_m: [[[0, 0], [0.009, 0], [0, 0.009]]]}", "around its centre"),
        (
            "nut: {outline_m: [[0, 0], [0.01, 0], [0, 0.01]], "
            "holes_m: [[[0, 0], [0.1, 0], [0, 0.1]]]}",
            "holes_m is .*allowed: holes .*inside the part",
        ),
        (
            "nut: {radius_m: 0.01, holes_m: [[[-0.0088, -0.0088], [0.0088, -0.0088], "
            "[0.0088, 0.0088], [-0.0088, 0.0088]]]}",
            "holes_m is .*allowed: holes .*inside the part",
        ),
        (
            "nut: {radius_m: 0.01, holes_m: [[[-0.004, -0.004], [0.004, -0.004], [0, 0.004]], "
            "[[-0.003, -0.003], [0.003, -0.003], [0, 0.003]]]}",
            "holes_m is .*do not overlap",
        ),
    ],
)
def test_bad_types_are_refused_in_one_line(tmp_path, text, message):
    with pytest.raises(RigError, match=message) as info:
        load_part_types(write(tmp_path, text))
    assert "\n" not in str(info.value)


def test_a_name_of_32_letters_with_digits_is_allowed(tmp_path):
    names = ["n" * 32, "n", "m4", "nut_m4", "nut_4m_a2", "blacks"]
    text = "\n".join(f"{name}: {{radius_m: 0.01}}" for name in names)
    types = load_part_types(write(tmp_path, text))
    assert list(types) == [part.name for part in types.values()] == names


def test_corners_on_a_straight_edge_do_not_hide_a_symmetry(tmp_path):
    bar = "[[-0.012, -0.006], [0.003, -0.006], [0.012, -0.006], [0.012, 0.006], [-0.012, 0.006]]"
    assert load_part_types(write(tmp_path, f"bar: {{outline_m: {bar}}}"))["bar"].symmetry == 2


def test_a_rig_supplies_values_that_a_type_omits(tmp_path):
    rig = load_rig("shapes")
    assert pickle.loads(pickle.dumps(rig)).part_type("nut") == rig.part_type("nut")  # for workers
    assert rig.part_type("nut").mu == rig.friction.mu
    black = rig.part_type("black")
    assert (black.radius_m, black.mass_kg) == (rig.parts.radius_m, rig.parts.mass_kg)
