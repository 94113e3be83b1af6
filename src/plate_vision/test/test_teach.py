"""Types learned from drawn pictures, compared with the truth; refused pictures; the program."""

import re
import resource
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from plate_core import PlateError, RigError, config_path, load_rig
from plate_core.rig import PART_TYPE, PartType, load_part_types
from plate_vision import make_vision
from plate_vision.errors import TeachError
from plate_vision.recognition import calibrate_by_scale, find_parts
from plate_vision.shapes import learn_plate
from plate_vision.shapes.part_files import add_type, save_part_types
from plate_vision.shapes.teach_parts import main
from plate_vision.shapes.teaching import (
    Example,
    check_distinguishable,
    learn_type,
    merge_types,
    teach,
    type_differences,
)

from .raycast import Look, cast

TYPES = load_part_types(config_path("parts.yaml"))
SIZE_PX = (240, 160)
HOME = calibrate_by_scale(1000.0)
PLACES = [(-0.07, -0.03), (0.05, 0.04), (0.06, -0.04), (-0.06, 0.03), (0.0, 0.0)]


def picture(draw_types, name, seed, count=3, types=TYPES, **options):
    rng = np.random.default_rng(seed)
    poses = [(name, x, y, rng.uniform(-np.pi, np.pi)) for x, y in PLACES[:count]]
    return draw_types(types, poses, rng, size_px=SIZE_PX, **options)


def gear(teeth, outer=0.02, inner=0.0165):
    turn = 2 * np.pi * np.arange(4 * teeth) / (4 * teeth)
    radius = np.repeat(np.tile([outer, inner], teeth), 2)
    corner = radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return PartType("gear", outline=tuple(map(tuple, corner.tolist())), colour_lab=(40.0, 0.0, 0.0))


@pytest.mark.parametrize("name", ["nut", "washer", "square", "bar", "bracket", "screw"])
def test_the_learned_type_equals_the_drawn_part(draw_types, name):
    pictures = [Example(picture(draw_types, name, seed)) for seed in (1, 2)]
    lesson = learn_type(name, pictures, HOME)
    part, true = lesson.part, TYPES[name]
    assert lesson.count == 6
    assert part.symmetry == true.symmetry
    assert len(part.holes) == len(true.holes)
    assert bool(part.radius_m) == bool(true.radius_m)
    outlines, sizes, colours = type_differences(part, true, 1000.0)
    assert outlines < 0.25
    assert abs(sizes) < 0.1
    assert colours < 2
    expected = 2e3 * np.sqrt(true.area_m2 / np.pi)
    assert 1e3 * lesson.size_m == pytest.approx([expected, 0], abs=0.25)
    assert part.scatter_m < 1e-4
    if name in ("square", "bar"):
        assert len(part.outline) == 4


def test_one_example_is_enough_and_grey_levels_will_do(draw_types):
    grey = picture(draw_types, "bracket", 3, count=1)[:, :, 1].copy()
    part = learn_type("bracket", [Example(grey)], HOME).part
    assert part.symmetry == 1
    assert part.colour_lab[1:] == (0, 0)
    assert type_differences(part, TYPES["bracket"], 1000.0)[0] < 0.3


@pytest.mark.parametrize("rows", [(0.04, -0.04, 0.0), (-0.04, 0.0, 0.04), (0.0, 0.04, -0.04)])
def test_the_leftmost_part_of_the_first_example_defines_the_angle_0(draw_types, rows):
    rng = np.random.default_rng(4)
    poses = [
        ("screw", x, y, a) for x, y, a in zip((0.07, -0.07, 0), rows, (2, 0.7, -1), strict=True)
    ]
    first = draw_types(TYPES, poses, rng, size_px=SIZE_PX)
    again = draw_types(TYPES, [("screw", 0.01, 0, 1.2)], rng, size_px=SIZE_PX)
    types = teach({"screw": [Example(first)]}, HOME)
    (found,) = find_parts(again, types)
    assert np.degrees(found["angle_rad"]) == pytest.approx(np.degrees(0.5), abs=1.5)


def test_the_first_example_defines_the_angle_0(draw_types):
    rng = np.random.default_rng(4)
    first = draw_types(TYPES, [("screw", 0, 0, 0.7)], rng, size_px=SIZE_PX)
    again = draw_types(TYPES, [("screw", 0.01, 0, 1.2)], rng, size_px=SIZE_PX)
    types = teach({"screw": [Example(first), Example(again)]}, HOME)
    (found,) = find_parts(again, types)
    assert found["label"] == "screw"
    assert np.degrees(found["angle_rad"]) == pytest.approx(np.degrees(0.5), abs=1)


def test_a_box_picks_one_part_of_many(draw_types):
    rng = np.random.default_rng(5)
    poses = [("nut", -0.06, 0, 0.0), ("bar", 0.06, 0, 0.0)]
    scene = draw_types(TYPES, poses, rng, size_px=SIZE_PX)
    boxes = {"nut": (30, 40, 90, 120), "bar": (150, 40, 210, 120)}
    types = teach({name: [Example(scene, box)] for name, box in boxes.items()}, HOME)
    assert types["nut"].symmetry == 6
    assert types["bar"].symmetry == 2
    assert [*find_parts(scene, types)["label"]].count("bar") == 1


def test_a_box_picks_the_part_that_its_centre_is_on(draw_types):
    """Also one that does not hold the part's own centre: at an end of a bar."""
    rng = np.random.default_rng(5)
    poses = [("bar", 0.06, 0.02, 0.0), ("nut", -0.06, -0.03, 0.0)]
    scene = draw_types(TYPES, poses, rng, size_px=SIZE_PX)
    for x in (171, 187):  # the bar's centre is at (179.5, 59.5)
        box = (x - 3, 61, x + 3, 65)
        assert learn_type("bar", [Example(scene, box)], HOME).part.symmetry == 2
    for box in ((176, 70, 182, 74), (190, 57, 202, 61)):  # beside it
        with pytest.raises(TeachError):
            learn_type("bar", [Example(scene, box)], HOME)


def test_failed_lessons_report_why(draw_types):
    bare = picture(draw_types, "nut", 6, count=0)
    nuts, coins = (
        Example(picture(draw_types, name, 7), name=name) for name in ("nut", "coin_large")
    )
    with pytest.raises(TeachError, match=r"type nut: there are no examples, allowed: 1 to 5"):
        learn_type("nut", [], HOME)
    with pytest.raises(TeachError, match=r"type nut: there are 6 examples, allowed: 1 to 5"):
        learn_type("nut", [nuts] * 6, HOME)
    with pytest.raises(TeachError, match=r"type nut: bare\.png: no part is visible, allowed"):
        learn_type("nut", [Example(bare, name="bare.png")], HOME)
    with pytest.raises(TeachError, match=r"examples differ: .* holes, but .* in .*, allowed"):
        learn_type("nut", [nuts, coins], HOME)
    small = Example(picture(draw_types, "coin_small", 8), name="small")
    with pytest.raises(TeachError, match=r"examples differ: in small the size differs by .* px"):
        learn_type("coin", [coins, small], HOME)
    with pytest.raises(RigError, match=r"type is 'Nut', allowed: lower-case letters"):
        learn_type("Nut", [nuts], HOME)


def test_causes_of_poor_recognition_are_reported(draw_types):
    sharp = picture(draw_types, "nut", 12)
    assert learn_type("nut", [Example(sharp)], HOME).warnings == ()
    (warning,) = learn_type("nut", [Example(cv2.GaussianBlur(sharp, (0, 0), 4))], HOME).warnings
    assert "picture: blur of the contours is" in warning
    red = {"nut": replace(TYPES["nut"], colour_lab=(50.0, 60.0, 40.0))}
    examples = [Example(sharp), Example(picture(draw_types, "nut", 13, types=red))]
    (warning,) = learn_type("nut", examples, HOME).warnings
    assert "teach each colour as a separate type" in warning


def test_a_part_with_small_deviations_from_a_circle_is_a_disc(draw_types):
    def seed(number):
        rng, turn = np.random.default_rng(number), 2 * np.pi * np.arange(30) / 30
        waves = [np.cos(k * turn + rng.uniform(0, 2 * np.pi)) for k in (2, 3, 4, 5)]
        radius = 0.012 * (1 + 0.03 * np.sum(waves, axis=0))
        ring = radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        part = PartType("seed", outline=tuple(map(tuple, ring.tolist())), colour_lab=(40.0, 0, 0))
        return Example(picture(draw_types, "seed", 14, count=2, types={"seed": part}))

    assert learn_type("seed", [seed(0)], HOME).part.symmetry == 1
    assert learn_type("seed", [seed(number) for number in range(5)], HOME).part.symmetry == 0


def test_nuts_of_different_sizes_keep_their_angle(draw_types):
    def nut(size):
        ring = size * np.array(TYPES["nut"].outline)
        part = replace(TYPES["nut"], outline=tuple(map(tuple, ring.tolist())), holes=())
        return Example(picture(draw_types, "nut", 16, count=2, types={"nut": part}))

    part = learn_type("nut", [nut(size) for size in (1.0, 1.3, 1.6)], HOME).part
    assert part.scatter_m > 0.1 * part.reach_m
    assert part.symmetry == 6


def test_an_outline_with_too_many_corners_is_refused(draw_types):
    types, rng = {"gear": gear(20)}, np.random.default_rng(9)
    example = Example(draw_types(types, [("gear", 0, 0, 0)], rng, scale=2500.0, size_px=SIZE_PX))
    with pytest.raises(TeachError, match=r"its outline has \d+ corners, allowed: 32; .* RMS error"):
        learn_type("gear", [example], calibrate_by_scale(2500.0))


def test_similar_types_are_refused_and_can_be_merged(draw_types):
    nut = learn_type("nut", [Example(picture(draw_types, "nut", 10))], HOME).part
    again = learn_type("nut_b", [Example(picture(draw_types, "nut", 11))], HOME).part
    with pytest.raises(TeachError, match=r"types nut_b and nut look alike: .* px, .* sizes"):
        check_distinguishable(again, {"nut": nut}, HOME)
    check_distinguishable(nut, {"nut": nut, "washer": TYPES["washer"]}, HOME)
    one = merge_types(nut, again)
    assert one.name == "nut"
    assert one.symmetry == 6
    assert max(type_differences(one, other, 1000.0)[0] for other in (nut, again)) < 0.15


def test_no_key_of_a_type_is_lost_where_types_are_written(tmp_path):
    known = {"mass_kg": 0.02, "mu": 0.3, "scatter_m": 1e-4, "height_m": 0.004}
    disc = PartType("disc", radius_m=0.01, symmetry=0, picture="disc.png", **known)
    nut = replace(TYPES["nut"], colour_lab=(40.0, 1.0, -2.0), picture="nut.png", **known)
    path = tmp_path / "parts.yaml"
    save_part_types(path, {"disc": disc, "nut": nut})
    written = yaml.safe_load(path.read_text())
    assert {*written["disc"], *written["nut"]} == {key.name for key in PART_TYPE.keys}
    again = load_part_types(path)
    for part in (disc, nut):
        for field in ("radius_m", "symmetry", "colour_lab", "picture", *known):
            assert getattr(again[part.name], field) == getattr(part, field), field


def test_a_file_of_types_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part_types(path, TYPES)
    again = load_part_types(path)
    assert [*again] == [*TYPES]
    for name, part in again.items():
        assert part.symmetry == TYPES[name].symmetry
        assert part.mass_kg == TYPES[name].mass_kg
        assert np.abs(part.polygon - TYPES[name].polygon).max() < 2e-6
    with pytest.raises(RigError, match="allowed: lower-case letters"):
        save_part_types(path, {"Nut": TYPES["nut"]})
    assert [*load_part_types(path)] == [*TYPES]


@pytest.fixture
def folder(tmp_path, monkeypatch, draw_types):
    """Pictures through the default rig's camera: a bare plate, screws, brackets."""
    monkeypatch.chdir(tmp_path)
    to_image = make_vision(load_rig(config_path("rig.yaml"))).calibration.to_image
    for name in ("bare", "screw", "bracket"):
        rng = np.random.default_rng(len(name))
        poses = [(name, x, y, rng.uniform(-3, 3)) for x, y in PLACES if name != "bare"]
        cv2.imwrite(f"{name}.png", draw_types(TYPES, poses, rng, to_image=to_image))
    cv2.imwrite("small.png", np.full((30, 40, 3), 200, np.uint8))
    return tmp_path


def test_pictures_that_a_type_is_taught_from_stay(folder):
    """Also of the type's name, beside the file of types; and types that somebody else wrote in."""
    before = (folder / "screw.png").read_bytes()
    rig = ["--rig", str(config_path("rig.yaml")), "--bare", "bare.png"]
    main(["screw", "screw.png", *rig])
    assert (folder / "screw.png").read_bytes() == before
    assert cv2.imread("screw_taught.png").shape == (320, 320, 3)
    main(["delete", "screw"])
    assert not (folder / "screw_taught.png").exists()
    save_part_types(folder / "parts.yaml", {"screw": replace(TYPES["screw"], picture="screw.png")})
    main(["delete", "screw"])
    assert (folder / "screw.png").read_bytes() == before


def test_a_type_is_not_merged_into_itself(folder, capsys):
    save_part_types(folder / "parts.yaml", TYPES)
    with pytest.raises(SystemExit):
        main(["merge", "nut", "nut"])
    assert "both types are 'nut', allowed: different types" in capsys.readouterr().err
    assert [*load_part_types("parts.yaml")] == [*TYPES]


@contextmanager
def full_disk():
    """No file may be longer than 100 bytes."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_file_of_types_is_not_lost_where_the_disk_is_full(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part_types(path, TYPES)
    with full_disk(), pytest.raises(PlateError, match=r"types .*parts\.yaml: cannot be written"):
        save_part_types(path, {"nut": TYPES["nut"]})
    assert [*load_part_types(path)] == [*TYPES]
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize("name", ["unknown", "group", "n" * 33])
def test_names_that_nothing_would_be_called_by_are_refused(name, tmp_path):
    with pytest.raises(RigError, match=f"type is '{name}', allowed: lower-case letters, digits"):
        save_part_types(tmp_path / "parts.yaml", {name: TYPES["nut"]})


def test_the_program_teaches_lists_renames_merges_and_deletes(folder, capsys):
    rig = ["--rig", str(config_path("rig.yaml")), "--bare", "bare.png"]
    main(["screw", "screw.png", "bare.png", *rig])
    output = capsys.readouterr()
    sides = r"(25\.[0-4]|24\.[6-9]). x (9\.[0-4]|8\.[6-9]). mm"  # the screw has 25 x 9 mm
    assert re.search(rf"corners, no symmetry; {sides} \+- ", output.out)
    assert re.search("warning: example not used: type screw: bare.*: ", output.err)
    main(["bracket", "bracket.png", *rig])
    types = load_part_types("parts.yaml")
    assert type_differences(types["screw"], TYPES["screw"], 1000.0)[0] < 0.25
    assert type_differences(types["bracket"], TYPES["bracket"], 1000.0)[0] < 0.25
    assert cv2.imread("screw_taught.png") is not None
    capsys.readouterr()
    main(["list"])
    assert re.search(rf"corners, 0 holes, symmetry 1, {sides}, colour", capsys.readouterr().out)
    main(["rename", "screw", "bolt"])
    assert [*load_part_types("parts.yaml")] == ["bolt", "bracket"]
    assert (folder / "bolt_taught.png").exists()
    main(["merge", "bolt", "bracket"])
    main(["delete", "bolt"])
    assert [*load_part_types("parts.yaml")] == []


def test_parts_are_marked_in_pictures_of_any_size_and_one_scale(tmp_path, monkeypatch, draw_types):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(15)
    poses = [("nut", -0.06, 0.02, 0.4), ("bar", 0.06, 0.0, 0.2), ("nut", 0.01, -0.02, 1.0)]
    cv2.imwrite("tray.png", draw_types(TYPES, poses, rng, size_px=SIZE_PX))
    boxes = [f"--box={x - 14},{y - 14},28,28" for x, y in ((60, 60), (130, 100))]
    main(["nut", "tray.png", "--scale", "1", *boxes])
    assert type_differences(load_part_types("parts.yaml")["nut"], TYPES["nut"], 1000.0)[0] < 0.3
    cv2.imwrite("one.png", cv2.imread("tray.png")[30:130, 145:215])
    cv2.imwrite("two.png", cv2.imread("tray.png")[20:150, 140:220])
    main(["bar", "one.png", "two.png", "--scale", "1"])
    assert type_differences(load_part_types("parts.yaml")["bar"], TYPES["bar"], 1000.0)[0] < 0.3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nut", "screw.png", "small.png"], "small.png: 40 x 30 px, allowed: "),
        (
            ["nut", "screw.png", "small.png", "--box", "1,1,9,9"],
            "--box: number of pictures is 2, allowed: 1",
        ),
        (["nut", "small.png", "--box", "1,1,99,9"], "box is 1,1,99,9, allowed: within 40 x 30 px"),
        *(
            (["nut", "small.png", f"--box={box}"], f"box is '{box}', allowed: x, y, width and")
            for box in ("-1,1,9,9", "1,-1,9,9", "1,1,0,9", "1,1,9,0", "1,1,9,9,9", "a,1,9,9")
        ),
        (["nut", "small.png", "--box", "1,9"], "box is '1,9', allowed: x, y, width and height"),
        (["nut", "small.png", "--scale", "0"], "scale is '0', allowed: 0.01 to 1000 px/mm"),
        (["nut", "nothing.png"], "nothing.png: no such file or folder"),
        (["nut", "bare.png", "--bare", "bare.png"], "no part is visible"),
        (["list", "--out", "no.yaml"], "no.yaml"),
    ],
)
def test_errors_are_reported_in_one_line(folder, capsys, words, message):
    with pytest.raises(SystemExit) as end:
        main([*words, *(["--rig", str(config_path("rig.yaml"))] if words[0] == "nut" else [])])
    assert end.value.code == 2
    output = capsys.readouterr().err.splitlines()
    assert message in output[-1]
    assert "error: " in output[-1]


def test_side_faces_are_not_learned_and_the_height_stays(rng, tmp_path):
    """A cylinder away from the place below the camera."""
    look, radius, height = Look(distance=0.43, focal_px=430.0), 0.012, 0.02
    vision = make_vision(look.rig(radius=radius, height=height))
    bare = learn_plate(np.stack([cast(look, np.empty((0, 2)), np.empty(0), rng)]))
    place = np.array([[0.13, 0.05]])
    image = cast(look, place, np.array([60.0]), rng, radius=radius, height=height)
    file, given = tmp_path / "parts.yaml", (vision.calibration, bare, vision.region)
    shown = [Example(image)]
    taught = add_type(file, "post", shown, *given, height).part
    assert np.sqrt(taught.area_m2 / np.pi) == pytest.approx(radius, rel=0.02)
    again = add_type(file, "post", shown, *given).part
    assert again.height_m == load_part_types(file)["post"].height_m == height
    flat = add_type(file, "post", shown, *given, 0.0).part
    assert flat.area_m2 > 1.2 * taught.area_m2
    assert flat.height_m == 0


@pytest.mark.parametrize(("height", "given", "warns"), [(8, 0, 1), (8, 8, 0), (0, 0, 0)])
def test_a_missing_height_is_requested(height, given, warns, rng):
    """Cylinders of a height [mm] at three places show side faces of three lengths."""
    look = Look(distance=0.43, focal_px=430.0)
    vision = make_vision(look.rig(radius=0.012))
    bare = learn_plate(np.stack([cast(look, np.empty((0, 2)), np.empty(0), rng)]))
    place = np.array([[0.13, 0.05], [0.0, -0.02], [-0.09, 0.05]])
    image = cast(look, place, np.full(3, 60.0), rng, radius=0.012, height=1e-3 * height)
    learned = vision.calibration, bare, vision.region, 1e-3 * given
    lesson = learn_type("post", [Example(image)], *learned)
    assert lesson.count == 3
    assert len(lesson.warnings) == warns
    for warning in lesson.warnings:
        stated = re.search(r"agree best with a height of about (\d+) mm: .* --height", warning)
        assert int(stated[1]) == pytest.approx(height, abs=2)
