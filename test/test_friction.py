"""Friction measured at the rig: with the simulator, which knows nothing of its model, and in the
real graph."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from plate_core import config_path, load_rig
from plate_core.rig import default_rig_path
from plate_driver.friction import make_push, slip
from plate_sim.friction import simulate
from plate_sim.plate import Ground
from plate_sim.world import Disturbances
from stages.friction import PLACES, measured, parts_at

RIG = load_rig()
G = RIG.friction.gravity
NEAR_EDGES = [
    {"class": "black", "positions_m": [[-0.273, -0.123], [0.273, 0.123]]},
    {"class": "grey", "positions_m": [[0.05, -0.04], [-0.05, 0.04]]},
]
"""Parts with little clearance along x and y. The measurement then makes fewer pushes."""


@pytest.mark.parametrize("static", [1.0, 1.2])
@pytest.mark.parametrize("times", [1.1, 1.7, 2.4])
def test_the_slip_is_that_of_the_simulators_integrator(static, times):
    mu = 0.3
    push = make_push(RIG, 1, -1, times * mu * G, 0.3)
    state = np.zeros((1, 2)), np.zeros((1, 2))
    for motion in push.cycle.parts:
        run = simulate(motion, *state, mu, G, ground=Ground(static_ratio=static))
        state = run.position[-1], run.velocity[-1]
    [expected] = slip(push, np.array([mu]), static * mu * G, G)
    assert state[0][0, 1] == pytest.approx(expected, rel=0.01, abs=2e-6)


@pytest.mark.parametrize(
    ("mu", "spread", "patches", "static"),
    [(0.15, 0.0, 0.0, 1.2), (0.25, 0.1, 0.1, 1.2), (0.6, 0.2, 0.0, 1.0)],
)
def test_friction_is_measured_within_5_percent(mu, spread, patches, static):
    world = Disturbances(friction_spread=spread, friction_patches=patches, static_ratio=static)
    found, true = measured(RIG, parts_at(PLACES), 3, mu, world)
    assert len(found.parts) == len(PLACES)
    exact = np.array([true[part.id] for part in found.parts])
    assert [part.mu for part in found.parts] == pytest.approx(exact, rel=0.05)
    assert found.mu == pytest.approx(np.mean(exact), rel=0.02)
    assert found.between_parts == pytest.approx(np.std(exact, ddof=1) / np.mean(exact), abs=0.01)
    assert found.static_ratio == pytest.approx(static, abs=0.05)
    assert (found.over_plate > 0.01) == (patches > 0)


def test_the_command_measures_it_in_the_real_graph_and_writes_it(tmp_path):
    pytest.importorskip("rclpy")
    from graph.session import session
    from light_graph import LightOptions

    rig_file = Path(shutil.copy(default_rig_path(), tmp_path / "rig.yaml"))
    before = rig_file.read_text(encoding="utf-8")
    scenario = yaml.safe_load(config_path("scenarios/sort_4.yaml").read_text(encoding="utf-8"))
    scenario["parts"] = NEAR_EDGES
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    options = LightOptions(scenario=str(tmp_path / "scenario.yaml"), rig_file=str(rig_file))
    with session(options, tmp_path, pictures=False) as graph:
        graph.observer.await_ready()
        graph.observer.set_parameter("simulator", "mu_scale", 1.3)
        words = [sys.executable, "-c", "from plate_client.command import main; main()"]
        done = subprocess.run(
            [*words, "friction", "--write"], capture_output=True, text=True, timeout=600,
            env=os.environ | {"ROS_DOMAIN_ID": str(graph.observer.domain)},
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "mu 0.25 -> 0.32" in done.stdout
    assert load_rig(rig_file).friction.mu == pytest.approx(0.325, rel=0.02)
    after = rig_file.read_text(encoding="utf-8")
    changed = [
        pair for pair in zip(before.splitlines(), after.splitlines(), strict=True)
        if pair[0] != pair[1]
    ]  # fmt: skip
    assert len(changed) == 1  # comments stay
