"""Facts of a rig that are not measured yet."""

from dataclasses import replace

from plate_core import load_rig
from plate_core.rig import unmeasured


def test_a_shipped_rig_is_not_measured():
    first = [text.split(":")[0] for text in unmeasured(load_rig())]
    assert first == ["lens", "corners", "friction"]
    assert "plate friction" in unmeasured(load_rig("desk"))[-1]


def test_measured_values_are_not_reported():
    rig = load_rig()
    corners = tuple((x + 1, y) for x, y in rig.camera.corners_px)
    rig = replace(rig, camera=replace(rig.camera, corners_px=corners))
    assert [text.split(":")[0] for text in unmeasured(rig)] == ["lens", "friction"]
    lens = replace(rig.camera.lens, distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))
    rig = replace(rig, camera=replace(rig.camera, lens=lens))
    assert [text.split(":")[0] for text in unmeasured(rig)] == ["friction"]
    rig = replace(rig, friction=replace(rig.friction, mu=0.2371))
    assert unmeasured(rig) == []
    rig = replace(rig, camera=replace(rig.camera, lens=None))
    assert [text.split(":")[0] for text in unmeasured(rig)] == ["lens"]
