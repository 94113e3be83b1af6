"""Parts of types in the whole loop without ROS: camera, detector, planner, solver, simulator."""

import pytest

from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from plate_core.tasks import load_scenario
from plate_sim.world import Disturbances

UNEVEN = Disturbances(friction_spread=0.1, friction_patches=0.1, highlights=0.03)


@pytest.mark.parametrize("name", ["align_6", "assemble_letters", "sort_shapes", "sort_mixed"])
def test_parts_of_types_come_where_the_task_wants_them(name):
    rig = load_rig(load_scenario(name).rig)
    row = summary(Setup(name, seed=7, disturbances=UNEVEN), rig)
    assert row["success"], row["message"]
    assert row["dropped"] == 0
