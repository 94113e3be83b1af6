"""The reference agents, and the information that agents receive."""

import numpy as np
import pytest

from plate_core import PlateError

pytestmark = pytest.mark.needs("gymnasium")


def test_an_agent_gets_copies_of_the_data():
    from plate_gym import PlateEnv
    from plate_gym.agent import Brief

    env = PlateEnv("Sort4-v1")
    env.reset(seed=0)
    brief, before = Brief.of(env), env.plates.friction_limit.copy()
    brief.friction_limit[:] = 0
    brief.rig.plate.half[:] = 0
    assert np.array_equal(env.plates.friction_limit, before)
    assert np.all(env.plates.rig.plate.half > 0)
    assert brief.action_space is not env.action_space


def test_an_agent_cannot_reconstruct_its_world_from_its_seed(monkeypatch):
    from plate_gym.agents import AGENTS, Random
    from plate_gym.episode import episode
    from plate_sim.world import Simulation

    class Twin(Random):
        def __init__(self, brief, seed):
            super().__init__(brief, seed)
            self.twin = Simulation(brief.rig, brief.scenario, seed).state.position

        def act(self, seen, info):
            far = np.max(np.abs(self.twin - seen[:, :2]))
            raise RuntimeError("found" if far < 0.01 else "elsewhere")

    monkeypatch.setitem(AGENTS, "twin", Twin)
    with pytest.raises(PlateError, match="elsewhere"):
        episode("twin", "nominal", "Sort4-v1", 0)


@pytest.mark.parametrize("name", ["A", "averaged", "1998", "random"])
def test_all_other_agents_run(name):
    from plate_gym import PlateEnv
    from plate_gym.agent import Brief
    from plate_gym.episode import agent_class

    kind = agent_class(name)
    env = PlateEnv("Sort4-v1", action=kind.action, observation=kind.observation)
    seen, info = env.reset(seed=0)
    agent, way = kind(Brief.of(env), 0), info["to_go_m"]
    for _ in range(8):
        seen, *_, info = env.step(agent.act(seen, info))
    assert info["limit_share"] > 0.9
    assert name != "A" or info["to_go_m"] < 0.9 * way


def test_the_papers_method_gets_the_forces_it_requests(monkeypatch):
    """On the averaged map, with a plate so slow that it reverses in no time: the force that gives a
    part 30 mm/s in 0.2 s, as a fraction of 0.25 times 9.81 m/s^2."""
    from plate_gym import PlateEnv, classic
    from plate_gym.agent import Brief
    from plate_gym.episode import agent_class, episode
    from plate_solver import average_force

    monkeypatch.setattr(classic, "SPEED_MPS", 2e-3)
    env = PlateEnv("Sort4-v1", action="cycle")
    seen, info = env.reset(seed=0)
    cycle, place = agent_class("1998")(Brief.of(env), 0).act(seen, info), seen[:, :2]
    force = average_force(cycle, place, np.zeros_like(place))
    requested = 0.03 / (0.25 * 9.81 * 0.2) * np.array([-1, -1, 1, 1])
    assert force == pytest.approx(np.column_stack([requested, 0 * requested]), abs=2e-3)
    with pytest.raises(PlateError, match="task is assemble_letters, allowed: sort, assemble, "):
        episode("1998", "nominal", "Letters-v1", 0)


def test_parts_reach_exact_positions_although_the_predictions_of_the_agent_are_wrong():
    """If the plate does not rest between motions near the targets, this episode fails."""
    from plate_gym.episode import episode

    assert episode("B", "held_out", "Letters-v1", 2)["success"]
