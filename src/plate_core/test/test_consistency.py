"""Rigs whose facts do not fit each other: refused where impossible, else a warning."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from shown_text import says

from plate_core import RigError, config_path, load_rig
from plate_core.rig import (
    MIN_GAMMA,
    Lens,
    camera_pose,
    part_radius_px,
    rig_names,
    rig_warnings,
    to_image,
)
from plate_core.rig.check_rig import main, max_sinusoid, rig_report
from plate_core.rig.consistency import check
from plate_core.rig.drawing import _draw_plate

RIG = load_rig()
MARKERS = {
    "dictionary": "4X4_50", "side_m": 0.03,
    "centre_m": {"marker_0": [-0.28, -0.13], "marker_1": [0.28, -0.13], "marker_2": [0.28, 0.145],
                 "marker_3": [-0.28, 0.13]},
}  # fmt: skip
OTHER_PLATE = [[170, 390], [470, 390], [470, 90], [170, 90]]
MIRRORED = [[617.82, 389.50], [21.01, 387.25], [26.86, 91.35], [614.33, 93.94]]

HEAVY = {name: {"radius_m": 0.01, "mass_kg": kg} for name, kg in (("nut", 0.02), ("block", 0.3))}
DRIVE = {"point_m": [-0.30, 0.10], "direction": [1, 0], "drive": "cia402", "node": 1}
DRIVE |= {"counts_per_m": 1e6}

IMPOSSIBLE = [
    (("motors", "motor_1"), DRIVE, "motor_2: drive is 'bridge', but motor_1 has 'cia402', allowed"),
    (("motors", "motor_1", "point_m"), [-3.0, 0.1], r"motor_1: point_m is \[-3, 0.1\], 2.7 m outs"),
    (("camera", "corners_px"), OTHER_PLATE, r"corners_px .* ratio of 1, .* 0.6 x 0.3 m"),
    (("camera", "corners_px"), MIRRORED, "corners_px are in mirrored order, allowed: "),
    (("camera", "corners_px"), [[20, 387], [617, 389], [200, 300], [27, 91]], "no convex quad"),
    (("camera", "corners_px"), [[-579, 387], [18, 389], [14, 94], [-573, 91]], "outside the image"),
    (("fiducials",), MARKERS, r"marker_2 is \[0.28, 0.145\], .*allowed: \|x\| up to"),
    (("parts", "radius_m"), 0.0025, r"2.47 px .*, allowed: 3 to 200 px, .*camera nearer, "),
    (("parts", "radius_m"), 0.08, r"radius_m is 0.08 on a plate whose shorter side is 0.3 m, allo"),
    (("limits", "force_n"), 2.0, r"force_n is 2, .* plate of 2 kg by 2 m/s2 .* 2.45 or"),
    (("limits", "stroke_m"), 3e-5, r"stroke_m is 3e-05 m, which allows 1.89 m/s2 at 40 Hz"),
    (("limits", "following_error_m"), 1e-9, r"is 1e-09, allowed: 0 .*, or 1e-05"),
    (("limits", "speed_mps"), 0.005, r"speed_mps is 0.005 m/s, which allows 1.26 m/s2 at 40 Hz"),
]
WARNINGS = [
    (("motors", "motor_1", "point_m"), [-0.4, 0.1], "motor_1: point_m is .* 0.1 m outside"),
    (("camera", "corners_px"), [[1, 387], [638, 390], [634, 94], [7, 91]], r"6 % error, allowed"),
    (("camera", "corners_px"), [[-4, 387], [592, 389], [589, 94], [1, 91]], r"corners_px\[0\] is "),
    (("parts", "radius_m"), 0.0035, r"3.45 px .*, allowed: 3 to 200 px, advised: 4 px"),
    (("parts", "radius_m"), 0.03, r"radius_m is 0.03 on a plate .* advised: up to 0.022"),
    (("parts", "mass_kg"), 0.3, "parts: mass_kg is 0.3 on a plate of 2 kg"),
    (("types",), HEAVY, "types: block: mass_kg is 0.3 on a plate of 2 kg"),
    (("limits", "continuous_force_n"), 300, "continuous_force_n is 300, more than the peak force"),
    (("limits", "accel_mps2"), 6.0, r"Gamma is 2.45 \(.*accel_mps2\), advised: 5 or more"),
    (("limits", "stroke_m"), 0.6, r"stroke_m is 0.6, but .* only 0.1 m: .* 5 Hz"),
]


@pytest.fixture(name="spoilt")
def _spoilt(tmp_path):
    def write(keys, value):
        data = place = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value
        path = tmp_path / "my_rig.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(("keys", "value", "words"), IMPOSSIBLE)
def test_an_impossible_rig_is_refused(spoilt, keys, value, words):
    with pytest.raises(RigError, match=rf"^my_rig\.yaml: .*({words})"):
        load_rig(spoilt(keys, value))


@pytest.mark.parametrize(("keys", "value", "words"), WARNINGS)
def test_an_unlikely_value_causes_a_warning(spoilt, keys, value, words):
    (doubt,) = rig_warnings(load_rig(spoilt(keys, value)))
    assert not doubt.impossible
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(doubt.text)


def test_corners_in_another_order_are_recognised(spoilt):
    corners = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))["camera"]
    turned = corners["corners_px"][1:] + corners["corners_px"][:1]
    with pytest.raises(RigError, match=r"corners_px .*their order; .*last pair"):
        load_rig(spoilt(("camera", "corners_px"), turned))


@pytest.mark.parametrize("name", rig_names())
def test_rigs_that_are_shipped_are_consistent(name):
    rig = load_rig(name)
    assert rig_warnings(rig) == []
    assert rig.gamma > MIN_GAMMA


def test_default_rig_is_consistent():
    assert rig_warnings(RIG) == []


@pytest.mark.parametrize("seed", range(30))
def test_possible_views_of_the_plate_are_accepted_and_others_reported(seed):
    """A pinhole camera anywhere above plates of any size, with its K known or not."""
    rng = np.random.default_rng(seed)
    plate = replace(RIG.plate, length_m=rng.uniform(0.1, 1), width_m=rng.uniform(0.1, 1))
    focal = rng.uniform(500, 2000)
    matrix = np.array([[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]])
    tilt, about, roll = rng.uniform(0, 0.6), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)

    def turn(angle):
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])

    lean = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    above = np.diag([1.0, -1.0, -1.0])  # the camera looks down
    rotation = turn(about) @ lean @ turn(-about) @ above @ turn(roll)
    points = np.column_stack([plate.corners, np.zeros(4)]) @ rotation.T
    points[:, 2] += focal * 1.3 * np.hypot(*plate.half) / 240
    seen = points @ matrix.T
    corners = seen[:, :2] / seen[:, 2:]
    lens = Lens((focal, focal), (319.5, 239.5)) if seed % 2 else None
    camera = replace(RIG.camera, corners_px=tuple(map(tuple, corners)), lens=lens)
    rig = replace(RIG, plate=plate, camera=camera)
    assert [
        d.text for d in rig_warnings(rig, "camera") if "ratio" in d.text or "order" in d.text
    ] == []
    longer = replace(plate, length_m=1.3 * plate.length_m)
    if seed % 2:
        texts = [d for d in rig_warnings(replace(rig, plate=longer), "camera") if "ratio" in d.text]
        assert texts[0].impossible


def test_radius_in_the_image_is_that_of_the_disc():
    """Against the area of its outline in the image."""
    angle = np.linspace(0, 2 * np.pi, 2000)
    ring = RIG.parts.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    x, y = to_image(RIG, ring).T
    area = 0.5 * abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    assert part_radius_px(RIG) == pytest.approx(np.sqrt(area / np.pi), rel=1e-3)


def test_sinusoids_by_hand():
    """2 kg: along x two motors push; 10 mm to 16 Hz, 100 m/s2 from there on."""
    slow, fast = max_sinusoid(RIG, "x", 5.0), max_sinusoid(RIG, "x", 40.0)
    assert slow.limit == "stroke_m"
    assert slow.travel == pytest.approx(0.01)
    assert slow.accel == pytest.approx(0.01 * (10 * np.pi) ** 2)
    assert fast.limit == "accel_mps2"
    assert fast.travel == pytest.approx(100 / (80 * np.pi) ** 2)
    weak = replace(RIG, limits=replace(RIG.limits, force=10.0, continuous_force=5.0))
    assert max_sinusoid(weak, "y", 40.0).accel == pytest.approx(10.0)
    assert max_sinusoid(weak, "y", 40.0).limit.startswith("force_n of motor_")
    turned = max_sinusoid(weak, "theta", 40.0)  # 0.075 kg m2, levers 0.1, 0.1, 0.2, 0.2 m
    maximum = 10.0 * 0.1 / 0.2 / 0.075
    assert turned.accel == pytest.approx(maximum * np.hypot(0.3, 0.15))


@pytest.fixture(name="check_rig")
def _check_rig(monkeypatch, capsys):
    """The command in this process: returns exit code, output and errors."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["check_rig", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capsys.readouterr()

    return run


NO_LENS = replace(RIG, camera=replace(RIG.camera, lens=None))


def test_parallax_is_reported_while_heights_are_unknown():
    """By similar triangles, from the camera's place that the pose gives."""
    rotation, translation = camera_pose(RIG)
    x, y, high = -rotation.T @ translation
    far = max(np.hypot(cx - x, cy - y) for cx, cy in RIG.plate.corners)
    reported = (
        f"wrong by up to {1e3 * far * 5e-3 / (high - 5e-3):.2g} mm (in the corner that is "
        f"{1e3 * far:.0f} mm from"
    )
    report_text = rig_report(RIG, "a.yaml", [])
    assert f"{high:.3g} m above the point [{x:.3f}, {y:.3f}]" in report_text
    assert says(report_text, "height_m is 0", "for parts", "5 mm high")
    assert reported in report_text
    report_text = rig_report(replace(RIG, parts=replace(RIG.parts, height_m=0.004)), "a.yaml", [])
    assert "5 mm high" not in report_text
    shapes = load_rig("shapes")
    known = {name: replace(part, height_m=0.003) for name, part in shapes.types.items()}
    known["nut"] = shapes.types["nut"]
    assert "unknown) for nut. " in rig_report(replace(shapes, types=known), "a.yaml", [])


def test_an_unknown_camera_place_is_reported():
    reported = rig_report(NO_LENS, "a.yaml", [])
    assert says(reported, "position is unknown", "focal_px", "height_m", "too far from")
    high = replace(NO_LENS, camera=replace(NO_LENS.camera, height_m=0.9))
    assert "the lens is 0.9 m above the point" in rig_report(high, "a.yaml", [])


def test_heights_that_contradict_each_other(spoilt):
    with pytest.raises(
        RigError, match=r"parts: height_m is 0.1, but the camera is 0.15 m above the plate"
    ):
        check(
            replace(
                NO_LENS, camera=replace(NO_LENS.camera, height_m=0.15),
                parts=replace(RIG.parts, height_m=0.1),
            )
        )  # fmt: skip
    (doubt,) = rig_warnings(load_rig(spoilt(("camera", "height_m"), 1.2)))
    assert says(doubt.text, "height_m is 1.2", "focal_px", "allowed: 0.9")
    assert not doubt.impossible


def test_names_of_motors_are_beside_their_arrows():
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    _draw_plate(axes, load_rig())
    figure.draw_without_rendering()
    names = [text for text in axes.texts if text.get_text().startswith("motor")]
    arrows = [text for text in axes.texts if not text.get_text()]
    assert (len(names), len(arrows)) == (4, 4)
    for box in (name.get_window_extent() for name in names):
        for arrow in arrows:
            ends = np.linspace(arrow.xyann, arrow.xy, 100)
            assert not np.any(box.count_contains(axes.transData.transform(ends)))


def test_command_reports_and_draws(check_rig, tmp_path):
    drawing = tmp_path / "new" / "desk.svg"
    code, out, err = check_rig("desk", "--drawing", drawing)
    assert (code, err) == (0, "")
    assert f"Gamma = {load_rig('desk').gamma:.1f}" in out
    assert "no inconsistencies" in out
    assert ET.parse(drawing).getroot().tag.endswith("svg")
    text = drawing.read_text(encoding="utf-8")
    for words in ("motor_1", "motor_2", "motor_3", "motor_4", "+x, -y"):
        assert words in text


def test_a_command_with_unread_output_ends(tmp_path):
    """`check_rig | head -1`: no traceback, no error, whenever the reader leaves."""
    for first in (1, 5000):
        command = f"{sys.executable} -m plate_core.rig.check_rig --drawing a.svg | head -c {first}"
        script = f"{command} >read; echo ${{PIPESTATUS[0]}}"
        done = subprocess.run(
            ["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60
        )
        assert done.stderr == ""
        assert done.stdout.strip() in ("0", "141")


def test_command_reports_a_persistent_warning_once(check_rig, spoilt, tmp_path):
    path = spoilt(("limits", "continuous_force_n"), 12.0)
    code, out, _ = check_rig(path, "--drawing", tmp_path / "a.svg")
    assert code == 0
    assert says(out, "= 7.8: ", "19.2 m/s2", "continuously", "continuous_force_n")
    assert says(out, "continuous force 12 N", "1.6 times")
    assert "continuous" not in out.split("sinusoidal shaking")[1]


def test_command_warns(check_rig, spoilt, tmp_path):
    path = spoilt(("limits", "stroke_m"), 0.6)
    code, out, _ = check_rig(path, "--drawing", tmp_path / "a.svg")
    assert code == 0
    assert says(out, "\nwarning: ", "stroke_m is 0.6", "5 Hz")


def test_command_reports_all_errors(check_rig, spoilt, tmp_path):
    path = spoilt(("motors", "motor_1", "point_m"), [-3.0, 0.1])
    text = path.read_text(encoding="utf-8").replace("radius_m: 0.008", "radius_m: 0.0025")
    path.write_text(text, encoding="utf-8")
    code, out, _ = check_rig(path, "--drawing", tmp_path / "a.png")
    assert code == 1
    assert out.count("WRONG: ") == 2
    assert (tmp_path / "a.png").stat().st_size > 10_000
    code, _, err = check_rig("desc")
    assert code == 2
    assert (
        "rig is 'desc' (did you mean desk?), allowed: desk, linear_motors, odrives, shapes, vo"
        in err
    )


def drives(*values, of="linear_motors", **limits):
    """The rig with linear motors; `values` are node and scale of its drives."""
    rig = load_rig(of)
    values = values or [(n, 1e6) for n in (1, 2, 3, 4)]
    motors = tuple(
        replace(motor, drive=replace(motor.drive, node=node, counts_per_m=scale))
        for motor, (node, scale) in zip(rig.motors, values, strict=True)
    )
    return replace(rig, motors=motors, limits=replace(rig.limits, **limits))


GOOD = (3, 1e6), (4, 1e6)
TURNS = [(n, 25 * 2**20) for n in (1, 2, 3, 4)]


def changed(*numbers, **change):
    """The rig with linear motors, with other drives of these motors."""
    rig = load_rig("linear_motors")
    motors = list(rig.motors)
    for k in numbers:
        motors[k - 1] = replace(motors[k - 1], drive=replace(motors[k - 1].drive, **change))
    return replace(rig, motors=tuple(motors))


def mixed():
    """CiA 402, and one ODrive."""
    rig, other = load_rig("linear_motors"), load_rig("odrives")
    return replace(rig, motors=(*rig.motors[:3], other.motors[3]))


def test_a_millimetre_in_units_of_the_drive_is_reported():
    reported = rig_report(load_rig("linear_motors"), "a.yaml", [])
    assert "motor_2: cia402, node 2: 1 mm along its direction is -1000 counts" in reported
    reported = rig_report(load_rig("odrives"), "a.yaml", [])
    assert "motor_1: odrive, node 1: 1 mm along its direction is +0.025 turns" in reported


@pytest.mark.parametrize(
    ("rig", "impossible", "text"),
    [
        (
            drives((1, 1e6), (3, 1e6), *GOOD),
            True,
            "motor_3: node is 3, the same as for motor_2, allowed",
        ),
        (drives((1, 5e9), (2, 1e6), *GOOD), True, "motor_1: counts_per_m is 5e+09, but a stroke"),
        (drives((1, 1e6), (2, 5e4), *GOOD), False, "motor_2: counts_per_m is 50000, so one count"),
        (changed(2, 4, serial=77), True, "motor_4: serial is 77, the same as for motor_2"),
        (changed(2, absolute=True), False, "motors: home is 'here' for some"),
        (mixed(), True, "motor_4: drive is 'odrive', but motor_1 has 'cia402', allowed"),
        (drives(*TURNS[:3], (63, 2**20), of="odrives"), True, "motor_4: node is 63, allowed for"),
        (drives(*TURNS[:3], (4, 40 * 2**20), of="odrives"), False, "turns_per_m is 40, so the"),
        (drives((1, 1e7), (2, 1e6), *GOOD), False, "counts_per_m is 1e+07, 1e+06, 1e+06, 1e+06"),
        (drives(following_error_m=0.01), False, "following_error_m is 0.01, so a motor"),
        (drives(following_error_m=0.0), False, "following_error_m is 0, so only the drives"),
    ],
)
def test_drives_that_do_not_fit_are_named(rig, impossible, text):
    doubt, *more = rig_warnings(rig)
    assert doubt.impossible == impossible
    assert text in doubt.text
    assert all("check them" in each.text for each in more)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"node": 0}, "motor_1: node is 0, allowed: a whole number from 1 to 126"),
        ({"sign": 0}, "motor_1: sign is 0, allowed: 1 or -1"),
        ({"drive": "odriv"}, "motor_1: drive is 'odriv'.*, allowed: one of bridge, cia402, odrive"),
        ({"drive": "odrive"}, "motor_1: turns_per_m is missing"),
        ({"drive": "odrive", "turns_per_m": 25}, r"unknown key counts_per_m .*, allowed: .*"),
        ({"sign": True}, "motor_1: sign is True, allowed: 1 or -1"),
        ({"drive": "bridge"}, "motor_1: node is 1, allowed: this key only with drive: cia402"),
    ],
)
def test_keys_of_a_drive_are_checked(spoilt, change, text):
    with pytest.raises(RigError, match=text):
        load_rig(spoilt(("motors", "motor_1"), DRIVE | change))
