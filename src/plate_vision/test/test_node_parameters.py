"""Parameters of the detector."""

import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, Graph, image, names
from rclpy.parameter import Parameter

from plate_core import PlateError

pytestmark = pytest.mark.usefixtures("detector_time")


def test_live_parameters(graph, draw, rng):
    frame = draw(CENTRE_PX, LABEL, rng, radius=7.9)
    radius_px = graph.detector._vision.options.radius_px
    (result,) = graph.detector.set_parameters([Parameter("threshold", value=0.5)])
    assert result.successful
    assert names(graph.answer(image(frame, 1.0))) == ["black_1"]
    assert graph.detector._vision.options.radius_px == radius_px
    (result,) = graph.detector.set_parameters([Parameter("max_missed", value=-1)])
    assert not result.successful
    assert result.reason == "Parameter max_missed out of range. Min: 0, Max: 1000, value: -1"
    (result,) = graph.detector.set_parameters([Parameter("rig_file", value="other.yaml")])
    assert not result.successful


@pytest.mark.parametrize(("name", "value"), [("threshold", 1.5), ("gate_m", 0.0)])
def test_wrong_parameters_are_refused_at_start(name, value):
    with pytest.raises(PlateError, match=f"parameter {name} is {value}, allowed: "):
        Graph(**{name: value})


@pytest.mark.parametrize("name", ["source", "path", "rate"])
def test_parameters_of_earlier_versions_name_their_replacements(name):
    with pytest.raises(PlateError, match=rf"{name} of detector was .*plate_vision camera "):
        Graph(**{name: "file"})
