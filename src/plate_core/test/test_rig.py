"""The rig file: its values, and how a wrong file is refused."""

import dataclasses
import os

import numpy as np
import pytest
import yaml

from plate_core import PlateError, RigError, config_path, load_rig
from plate_core.rig import CameraTrigger, Lens, default_rig_path, edit_rig
from plate_core.rig.edit import edit_text


@pytest.fixture(name="data")
def _data():
    """The default rig, as plain YAML data to spoil."""
    return yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))


@pytest.fixture(name="load")
def _load(tmp_path):
    def load(data):
        path = tmp_path / "rig.yaml"
        path.write_text(data if isinstance(data, str) else yaml.safe_dump(data, sort_keys=False))
        return load_rig(path)

    return load


def test_default_rig():
    rig = load_rig()
    assert rig.plate.length_m == 0.6
    assert [motor.name for motor in rig.motors] == ["motor_1", "motor_2", "motor_3", "motor_4"]
    assert rig.gamma == pytest.approx(100 / (0.25 * 9.81))
    assert rig.force_unit == pytest.approx(0.25 * 9.81 * 0.02)
    np.testing.assert_allclose(rig.plate.corners[0], [-0.3, -0.15])


def test_directions_become_unit_vectors(data, load):
    data["motors"]["motor_1"]["direction"] = [0.3, 0.4]
    np.testing.assert_allclose(load(data).motors[0].direction, [0.6, 0.8])


def test_rig_of_the_environment(data, tmp_path, monkeypatch):
    data["plate"]["mass_kg"] = 3.5
    path = tmp_path / "other.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    monkeypatch.setenv("PLATE_RIG", str(path))
    assert default_rig_path() == path
    assert load_rig().plate.mass_kg == 3.5
    assert load_rig("").plate.mass_kg == 3.5


def test_missing_config_file_is_named():
    with pytest.raises(PlateError, match=r"config file nothing\.yaml does not exist in .*config"):
        config_path("nothing.yaml")


SPOILT = [
    (("plate", "width_m"), "wide", "plate: width_m is 'wide', allowed: a number"),
    (("plate", "mass_kg"), True, "plate: mass_kg is True, allowed: a number"),
    (("plate", "mass_kg"), float("nan"), "plate: mass_kg is nan, allowed: a number"),
    (("plate", "lenght_m"), 1, "plate: unknown key lenght_m \\(did you mean length_m.\\), allowed"),
    (("limits", "accel_mps2"), 2, "accel_mps2 is 2, allowed: more than mu g"),
    (("limits",), 5, "limits: got 5, expected a mapping"),
    (("motors", "motor_1", "direction"), [0, 0], "direction is .*, allowed: a vector that is not"),
    (("motors", "motor_1", "direction"), [1], "allowed: 2 numbers from -1 to 1"),
    (("motors", "motor_1", "point_m"), [1, "a"], "allowed: 2 numbers from -10 to 10"),
    (("motors", "motor_5"), {}, "motors: keys are .*motor_5, allowed: motor_1, motor_2, motor_3"),
    (
        ("motors",),
        {"motor_1": {}, "motor_2": {}},
        r"^rig\.yaml: motors: keys are motor_1, motor_2, al",
    ),
    (("camera", "width_px"), 640.5, "width_px is 640.5, allowed: a whole number from 16 to 16384"),
    (("camera", "trigger_pulse_s"), 0.02, "trigger_phase is missing"),
    (("camera", "corners_px"), [[0, 0]] * 4, "allowed: four corners that span"),
    (("camera", "corners_px"), [[0, 0]] * 3, "corners_px is .*, allowed: 4 x 2 numbers"),
    (("camera", "focal_px"), [0, 900], "focal_px is .*, allowed: 2 numbers from 10 to"),
    (("camera", "distortion"), "k1", "distortion is 'k1', allowed: n numbers from -1e.06 to"),
    (("camera", "distortion"), [0.1] * 3, "lens: distortion has 3 values, allowed: 4 or 5 for plu"),
    (("camera", "distortion"), [-2, 0, 0, 0, 0], "lens: distortion is .* folds the image of the p"),
    (("camera", "distortion_model"), "fisheye", "camera: lens: distortion_model is 'fisheye'"),
    (("camera", "distortion_model"), 5, "camera: distortion_model is 5, allowed: a text"),
]


@pytest.mark.parametrize(("keys", "value", "message"), SPOILT)
def test_wrong_values_are_refused(data, load, keys, value, message):
    place = data
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    with pytest.raises(RigError, match=message):
        load(data)


def test_a_trigger_of_the_camera(data, load):
    assert load(data).camera.trigger is None
    data["camera"]["trigger_phase"] = 0.25
    assert load(data).camera.trigger == CameraTrigger(0.25, 0.002)
    data["camera"]["trigger_pulse_s"] = 0.0
    with pytest.raises(RigError, match=r"trigger_pulse_s is 0\.0, allowed: a number from 0\.001"):
        load(data)


def test_motors_bear_half_of_their_peak_force_unless_stated(data, load):
    data["limits"] |= {"force_n": 180.0, "continuous_force_n": 70.0}
    assert load(data).limits.continuous_force == 70.0
    del data["limits"]["continuous_force_n"]
    assert load(data).limits.continuous_force == 90.0


def test_missing_key_is_named(data, load):
    del data["limits"]["speed_mps"]
    with pytest.raises(RigError, match=r"limits: speed_mps is missing, expected a number from 0\."):
        load(data)


def test_motors_that_cannot_turn_the_plate_are_refused(data, load):
    for i, motor in enumerate(data["motors"].values()):
        motor["direction"] = [1, 0] if i < 2 else [0, 1]
        motor["point_m"] = [0, 0]
    with pytest.raises(RigError, match=r"motors: .* x, y and theta requires more than 20 times"):
        load(data)


@pytest.mark.parametrize(
    "text",
    ["", "- 1\n- 2\n", "plate: [1, 2\n", "plate: {a: 1}\nplate: b: c\n", '"\\U00110000": 1\n',
     '"\\UFFFFFFFF": 1\n'],
)  # fmt: skip
def test_broken_files_are_refused(load, text):
    with pytest.raises(RigError, match=r"rig\.yaml: (got|broken YAML)"):
        load(text)


def test_missing_file_is_named():
    with pytest.raises(RigError, match=r"nowhere/rig\.yaml: no such file"):
        load_rig("nowhere/rig.yaml")


def test_rig_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_rig().plate.mass_kg = 1.0


MARKERS = {
    "dictionary": "4X4_50",
    "side_m": 0.03,
    "centre_m": {
        "marker_0": [-0.28, -0.13], "marker_1": [0.28, -0.13], "marker_2": [0.28, 0.13],
        "marker_17": [-0.28, 0.13],
    },
}  # fmt: skip


def test_the_markers_of_a_rig_are_read(data, load):
    assert load(data).fiducials is None
    fiducials = load({**data, "fiducials": MARKERS}).fiducials
    assert fiducials.numbers == (0, 1, 2, 17)
    corners = [[-0.295, 0.145], [-0.265, 0.145], [-0.265, 0.115], [-0.295, 0.115]]
    np.testing.assert_allclose(fiducials.corners[3], corners)


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("side_m is 0", {"side_m": 0}),
        ("dictionary is 5", {"dictionary": 5}),
        ("dictionary is '4X4', allowed: one of 4X4_50, 4X4_100", {"dictionary": "4X4"}),
        ("markers is 2, allowed: 4 to 16", {"centre_m": {"marker_0": [0, 0], "marker_1": [1, 1]}}),
        ("allowed: marker_0", {"centre_m": {f"m{i}": [i, i] for i in range(4)}}),
        ("allowed: 2 numbers", {"centre_m": {f"marker_{i}": [i] for i in range(4)}}),
        ("apart", {"centre_m": {f"marker_{i}": [i // 2 * 0.1, 0.03 * i] for i in range(4)}}),
        ("on one line", {"centre_m": {f"marker_{i}": [i, 2 * i] for i in range(4)}}),
        ("unknown key colour", {"colour": "red"}),
    ],
)
def test_wrong_fiducials_are_refused(data, load, words, change):
    with pytest.raises(RigError, match=words):
        load({**data, "fiducials": {**MARKERS, **change}})


def test_markers_span_an_area_as_wide_as_their_side(data, load):
    """Also no centre is nearer to another than 1.2 sides."""
    side = MARKERS["side_m"]

    def placed(wide, step=0.1):
        high = (0.5, -0.5, -0.5, 0.5)
        centres = {f"marker_{k}": [step * (k - 1.5), wide * side * high[k]] for k in range(4)}
        return load({**data, "fiducials": {**MARKERS, "centre_m": centres}}).fiducials

    assert placed(1.01).numbers == (0, 1, 2, 3)
    with pytest.raises(RigError, match="all centres are on one line"):
        placed(0.99)
    assert placed(2.0, 1.21 * side).numbers == (0, 1, 2, 3)
    with pytest.raises(RigError, match=r"apart, allowed: more than .* \(1\.2 times"):
        placed(2.0, 1.19 * side)


@pytest.mark.parametrize("block", [False, True])
def test_a_rig_file_is_changed_in_either_style_of_yaml(tmp_path, block):
    path, corners = tmp_path / "rig.yaml", ((9.5, 400), (600, 401.25), (590, 80), (12, 90))
    text = config_path("rig.yaml").read_text(encoding="utf-8")
    path.write_text(yaml.safe_dump(yaml.safe_load(text)) if block else text, encoding="utf-8")
    before = load_rig(path)
    camera = dataclasses.replace(before.camera, corners_px=corners)
    after = dataclasses.replace(before, camera=camera)
    values = {("camera",): {"corners_px": str([list(each) for each in corners])}}
    edit_rig(path, values, lambda rig: rig == after)
    assert load_rig(path) == after
    changed = path.read_text(encoding="utf-8").splitlines()
    if not block:
        lines = zip(text.splitlines(), changed, strict=True)
        assert [old.split(":")[0].strip() for old, new in lines if old != new] == ["corners_px"]


LENS = {"focal_px": "[812.5, 811.0]", "centre_px": "[320.0, 241.5]", "distortion": "[-0.1, 1e-05]"}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (
            "camera:\n  a: 1  # one\n  # of the last\n  b: [2,\n    3]  # two\n"
            "# next\nparts: {c: 1}\n",
            "camera:\n  a: 1  # one\n  # of the last\n  b: [2,\n    3]  # two\n"
            "  focal_px: [812.5, 811.0]\n  centre_px: [320.0, 241.5]\n  distortion: [-0.1, 1e-05]\n"
            "# next\nparts: {c: 1}\n",
        ),
        (
            "parts:\n  c: 1\ncamera:\n  a: 1\n  distortion: [0]  # k1",
            "parts:\n  c: 1\ncamera:\n  a: 1\n  distortion: [-0.1, 1e-05]  # k1\n"
            "  focal_px: [812.5, 811.0]\n  centre_px: [320.0, 241.5]",
        ),
        (
            "camera: {a: 1,  # one\n  b: [2, 3]}  # two\nparts: {c: 1}\n",
            "camera: {a: 1,  # one\n  b: [2, 3], focal_px: [812.5, 811.0], "
            "centre_px: [320.0, 241.5], distortion: [-0.1, 1e-05]}  # two\nparts: {c: 1}\n",
        ),
    ],
    ids=["block", "block, one is there and the file has no last newline", "flow"],
)
def test_missing_keys_are_added_and_comments_stay(before, after):
    assert edit_text(before, {("camera",): LENS}) == after


@pytest.mark.parametrize("block", [False, True])
def test_a_lens_is_added_to_a_rig_file(tmp_path, data, block):
    path = tmp_path / "rig.yaml"
    for key in LENS:
        del data["camera"][key]
    path.write_text(yaml.safe_dump(data, default_flow_style=not block), encoding="utf-8")
    lens = Lens((812.5, 811.0), (320.0, 241.5), (-0.1, 1e-5, 0, 0))
    before = load_rig(path)
    after = dataclasses.replace(before, camera=dataclasses.replace(before.camera, lens=lens))
    values = {**LENS, "distortion": "[-0.1, 1e-05, 0, 0]", "distortion_model": "plumb_bob"}
    edit_rig(path, {("camera",): values}, lambda rig: rig == after)
    assert load_rig(path) == after


@pytest.mark.parametrize(
    "text",
    ["", "- a", "3", "{", "plate: {}", "friction: {}", "friction: ~", "friction: [1]",
     "? {a: b}\n: c", "a: 1\n---\nb: 2", '"\\UFFFFFFFF": 1', "[" * 3000,
     "friction: &a {mu: 1, b: *a}"],
)  # fmt: skip
def test_a_broken_rig_file_is_not_edited(tmp_path, text):
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PlateError, match=r"rig file|rig\.yaml"):
        edit_rig(path, {("friction",): {"mu": "0.3"}}, lambda rig: True)
    assert path.read_text(encoding="utf-8") == text
    assert [one.name for one in tmp_path.iterdir()] == ["rig.yaml"]


def test_a_rig_file_that_is_edited_is_a_regular_file(tmp_path):
    path = tmp_path / "rig.yaml"
    os.mkfifo(path)  # a pipe without a writer
    with pytest.raises(PlateError, match=r"rig\.yaml: is a FIFO, allowed: a regular file"):
        edit_rig(path, {}, lambda rig: True)
    path.unlink()
    path.write_bytes(b"\xff")
    with pytest.raises(PlateError, match=r"rig\.yaml: is no text in UTF-8 \('utf-8'"):
        edit_rig(path, {}, lambda rig: True)
    assert path.read_bytes() == b"\xff"
