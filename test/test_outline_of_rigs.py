"""The plate's outline as the simulator draws it is where each rig file has it."""

import pytest

from plate_core import load_rig
from plate_core.rig import rig_names
from plate_core.tasks import load_scenario
from plate_sim.world import Simulation
from plate_vision import make_vision
from plate_vision.plate import OutlineCheck

ROUND = [name for name in rig_names() if name not in ("shapes", "washers")]


@pytest.mark.parametrize(
    ("rig", "scenario"),
    [
        *((name, "sort_4") for name in ROUND),
        ("", "sort_50"),
        ("", "sort_corners_12"),
        ("shapes", "sort_shapes"),
        ("shapes", "sort_mixed"),
    ],
)
def test_the_outline_check_reports_no_problem_for_any_rig(rig, scenario):
    rig, scenario = load_rig(rig), load_scenario(scenario)
    simulation = Simulation(rig, scenario, 3)
    check = OutlineCheck.of(rig, make_vision(rig).calibration)
    for k in range(5):
        check = check.add(simulation.capture(), 0.1 * k)
    assert check.finding is None
    assert check.agrees
    assert check.text.startswith("as predicted, within 0.0")
