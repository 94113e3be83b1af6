"""Parts of types in the whole loop without ROS: camera, detector, planner, solver, simulator."""

import pytest
from short_task import FEW_STARTS, with_few

from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from plate_core.tasks import load_scenario
from plate_sim.world import Disturbances

UNEVEN = Disturbances(friction_spread=0.1, friction_patches=0.1, highlights=0.03)


@pytest.mark.parametrize(
    "scenario",
    [load_scenario("align_6"), load_scenario("assemble_letters")]
    + [with_few("sort_shapes"), with_few("sort_mixed")],
    ids=lambda scenario: scenario.name,
)
def test_parts_of_types_reach_their_targets(scenario):
    setup = Setup(scenario, seed=7, disturbances=UNEVEN, effort=FEW_STARTS)
    row = summary(setup, load_rig(scenario.rig))
    assert row["success"], row["message"]
    assert row["dropped"] == 0
