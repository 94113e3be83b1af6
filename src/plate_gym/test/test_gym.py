"""Environments against Gymnasium's own checks, the loop without ROS, and the rules they state."""

import copy
import pickle
import re
import subprocess
import sys
from dataclasses import fields, replace
from functools import partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from threading import Lock
from types import SimpleNamespace

import numpy as np
import pytest

from plate_bringup.loop import Setup, run
from plate_core import PlateCycle, PlateError, load_rig
from plate_core.motion import usage

pytestmark = pytest.mark.needs("gymnasium")


@pytest.fixture
def gym():
    import plate_gym

    return plate_gym


def test_without_gymnasium_the_command_is_named():
    code = "import sys; sys.modules['gymnasium'] = None; import plate_gym"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.endswith("plate_gym requires gymnasium: pip install gymnasium\n")
    assert done.stderr.count("Traceback") == 1


def played(env, actions, seed=0):
    """Observations, rewards and information of one plate, from a seed on."""
    results = [env.reset(seed=seed)]
    results += [env.step(action) for action in actions]
    return results


def of_plate(result, k):
    """The same of plate `k` of many."""
    *arrays, info = result
    known = {name: info[name][k] for name in info if name[0] != "_" and info[f"_{name}"][k]}
    return [array[k] for array in arrays], known


def equal(one, many):
    assert np.array_equal(one[0], many[0][0])
    assert one[1:-1] == tuple(many[0][1:])
    assert set(one[-1]) == set(many[1])
    for name, value in many[1].items():
        assert np.array_equal(one[-1][name], value), name


@pytest.mark.parametrize(
    ("task", "action", "observation"),
    [
        ("Sort10-v1", "motion", "parts"), ("Sort4-v1", "forces", "parts"),
        ("Letters-v1", "progress", "parts"), ("Assemble8-v1", "cycle", "image"),
        ("Follow5-v1", "motion", "parts"), ("Feed-v1", "progress", "parts"),
        ("Feed-v1", "cycle", "parts"),
    ],
)  # fmt: skip
def test_gymnasium_finds_nothing_wrong(gym, task, action, observation, recwarn):
    from gymnasium.utils.env_checker import check_env

    env = gym.PlateEnv(task, action=action, observation=observation)
    check_env(env, skip_render_check=True)
    assert not [str(w.message) for w in recwarn if "custom" not in str(w.message)]


def test_all_tasks_are_registered(gym):
    import gymnasium

    for task in gym.TASKS:
        assert gymnasium.spec(f"plate/{task}").kwargs == {"task": task}
    many = gymnasium.make_vec("plate/Sort4-v1", num_envs=2, world="friction")
    assert isinstance(many.unwrapped, gym.PlateVectorEnv)


def test_tasks_have_unchanged_digests(gym):
    """A change of a task's scenario or rig needs a new version of the task."""
    from plate_gym.tasks import digest

    assert {name: digest(scenario) for name, (scenario, _) in gym.TASKS.items()} == {
        name: mark for name, (_, mark) in gym.TASKS.items()
    }


@pytest.mark.parametrize(
    ("task", "settings", "steps"),
    [
        ("Sort10-v1", {}, 6),
        ("Sort4-v1", {"world": "held_out"}, 4),
        ("Letters-v1", {"world": "friction"}, 3),
        ("Sort4-v1", {"world": "misses", "observation": "image"}, 2),
        ("Sort4-v1", {"action": "forces"}, 2),
        ("Follow2-v1", {}, 6),
        ("Feed-v1", {"world": "held_out"}, 12),
        ("Feed-v1", {"action": "forces"}, 3),
    ],
)
def test_many_plates_behave_like_single_plates(gym, task, settings, steps):
    """To the last bit, on two cores and on one."""
    many = gym.PlateVectorEnv(task, 3, threads=2, **settings)
    rng = np.random.default_rng(5)
    actions = rng.uniform(-1, 1, (steps, *many.action_space.shape))
    together = played(many, actions, seed=7)
    for k in range(3):
        alone = played(gym.PlateEnv(task, **settings), actions[:, k], seed=7 + k)
        for one, all_ in zip(alone, together, strict=True):
            equal(one, of_plate(all_, k))


@pytest.mark.parametrize(
    ("task", "world"),
    [("Sort4-v1", "held_out"), ("Sort10-v1", "nominal"), ("Corners12-v1", "misses")],
)
def test_many_plates_that_end_and_restart_behave_like_single_plates(gym, task, world):
    """To the last bit. On all plates but the first, a part begins at a corner and falls off."""
    many = gym.PlateVectorEnv(task, 3, world=world, threads=2)
    alone = [gym.PlateEnv(task, world=world) for _ in range(3)]
    many.reset(seed=11)
    for k, env in enumerate(alone):
        env.reset(seed=11 + k)
        if k > 0:
            corner = env.plates.rig.plate.half - 1e-4
            for simulation in (env.plates.plates[0].simulation, many.plates.plates[k].simulation):
                place = np.vstack([corner, simulation.state.position[1:]])
                simulation.state = replace(simulation.state, position=place)
    ended, lost, restarts = [False] * 3, 0, 0
    for action in np.random.default_rng(3).uniform(-1, 1, (15, *many.action_space.shape)):
        together = many.step(action)
        for k, env in enumerate(alone):
            if ended[k]:
                seen, info = env.reset()
                one, restarts = (seen, 0.0, False, False, info), restarts + 1
                assert info["dropped"] == 0
            else:
                one = env.step(action[k])
            equal(one, of_plate(together, k))
            ended[k] = one[2] or one[3]
            lost += int(one[-1]["dropped"]) if ended[k] else 0
    assert lost >= 2
    assert restarts >= 2


def test_a_plate_that_has_ended_restarts(gym):
    """In the world that `reset` without a seed gives one plate alone."""
    many, one = gym.PlateVectorEnv("Sort4-v1", 2), gym.PlateEnv("Sort4-v1")
    many.reset(seed=3)
    plate = many.plates.plates[1]
    plate.timeline = replace(plate.timeline, begin=many.plates.scenario.time_limit_s)
    still = np.zeros(many.action_space.shape)
    assert many.step(still)[3].tolist() == [False, True]
    seen, reward, ended, over, info = many.step(still)
    one.reset(seed=4)
    assert np.array_equal(seen[1], one.reset()[0])
    assert info["time_s"].tolist() == [0.2, 0.0]
    assert not np.any([reward[1:], ended[1:], over[1:]])


@pytest.mark.parametrize(
    ("task", "action"),
    [("Corners12-v1", level) for level in ("motion", "cycle", "forces")] + [("Feed-v1", "motion")],
)
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copied_environment_continues_identically(gym, task, action, copied):
    many = gym.PlateVectorEnv(task, 2, action=action, threads=2)
    many.reset(seed=3)
    many.step(many.action_space.sample())
    twin, actions = copied(many), many.action_space.sample()
    for _ in range(8 if task == "Feed-v1" else 1):  # the robot takes a part meanwhile
        (seen, *_, info), (again, *_, same) = many.step(actions), twin.step(actions)
        assert np.array_equal(seen, again)
    assert np.array_equal(info["there"], same["there"])
    assert task != "Feed-v1" or info["there"].any()


def test_a_forked_process_continues(gym):
    many = gym.PlateVectorEnv("Sort4-v1", 2, action="forces", threads=2)
    many.reset(seed=0)
    still = np.zeros(many.action_space.shape)
    many.step(still)
    child = get_context("fork").Process(target=many.step, args=(still,))
    child.start()
    child.join(30)
    child.kill()
    assert child.exitcode == 0


def test_motions_of_any_kind_can_be_vectorised(gym):
    """By processes too, which get the spaces and motions of others."""
    import gymnasium

    make = partial(gymnasium.make_vec, "plate/Sort4-v1", num_envs=2, action="cycle")
    seen = []
    for many in (make(), make(vectorization_mode="async")):
        many.reset(seed=3)
        many.action_space.seed(0)
        seen.append(many.step(many.action_space.sample())[0])
        many.close()
    assert np.array_equal(*seen)


def test_a_seed_may_be_any_number(gym):
    env = gym.PlateEnv("Sort4-v1", action="forces")
    still = np.zeros(env.action_space.shape)
    for seed in (5, 2**31 + 5):  # of the solver, too
        first = env.reset(seed=seed)[0]
        seen = env.step(still)[0]
        assert np.array_equal(env.reset(seed=seed)[0], first)
        assert np.array_equal(env.step(still)[0], seen)


def test_some_plates_restart(gym):
    many, one = gym.PlateVectorEnv("Sort4-v1", 3), gym.PlateEnv("Sort4-v1")
    many.reset(seed=np.int64(3))
    seen = many.step(many.action_space.sample())[0]
    mask = np.array([False, True, False])
    again, info = many.reset(seed=[None, 7, None], options={"reset_mask": mask})
    assert np.array_equal(again[1], one.reset(seed=np.int64(7))[0])
    assert np.array_equal(again[~mask], seen[~mask])
    assert info["_time_s"].tolist() == mask.tolist()


def test_calls_before_reset_or_with_wrong_shapes_are_refused(gym):
    import gymnasium

    from plate_gym.agent import Brief

    one, many = gym.PlateEnv("Sort4-v1"), gym.PlateVectorEnv("Sort4-v1", 2)
    shown, some = gym.PlateEnv("Sort4-v1", render_mode="rgb_array"), {"reset_mask": [True, False]}
    early = [
        lambda: one.step(one.action_space.sample()), shown.render,
        lambda: many.step(many.action_space.sample()), lambda: many.reset(options=some),
        lambda: Brief.of(one),
    ]  # fmt: skip
    for call in early:
        with pytest.raises(gymnasium.error.ResetNeeded):
            call()
    for name, wrong in (("num_envs", 0), ("num_envs", 1.5), ("threads", 0), ("threads", 1.5)):
        with pytest.raises(PlateError, match=f"{name} is {wrong}, allowed: a whole number, 1"):
            gym.PlateVectorEnv("Sort4-v1", **{name: wrong})
    with pytest.raises(PlateError, match="seed has 3 numbers, allowed: 2"):
        many.reset(seed=[1, 2, 3])
    for wrong, reported in ((-1, "-1"), (1.5, "1.5"), ("a", "'a'"), (True, "True")):
        for call in (one.reset, many.reset, lambda seed: many.reset(seed=[0, seed])):
            with pytest.raises(PlateError, match=f"seed is {reported}, allowed: a whole number"):
                call(seed=wrong)
    with pytest.raises(PlateError, match=r"reset_mask is \[True\], allowed: 2 booleans"):
        many.reset(options={"reset_mask": [True]})
    many.reset(seed=1)
    for wrong, count in ((np.zeros((1, 18)), 1), (np.zeros((3, 18)), 3), (None, None)):
        with pytest.raises(PlateError, match=f"actions are {count}, allowed: 2"):
            many.step(wrong)


def test_rounding_errors_of_actions_are_accepted(gym):
    env = gym.PlateEnv("Sort4-v1")
    env.reset(seed=0)
    above = np.nextafter(np.ones(18, np.float32), np.float32(2))
    seen = env.step(above)[0]
    env.reset(seed=0)
    assert np.array_equal(env.step(np.ones(18))[0], seen)


def test_changes_to_a_returned_image_have_no_effect(gym):
    """To write on it changes nothing, even if the next one is missed."""
    env = gym.PlateEnv("Sort4-v1", observation="image")
    seen = env.reset(seed=0)[0]
    before = seen.copy()
    seen[:] = 0
    assert np.array_equal(env.plates.observed()[0], before)


@pytest.mark.parametrize("task", ["Sort4-v1", "Letters-v1"])
def test_agent_b_computes_the_same_cycles_as_the_loop(gym, task):
    """The same images lead to the same motions, and these to the same places."""
    from plate_gym.agent import Brief
    from plate_gym.agents import AGENTS

    kind = AGENTS["B_by_image"]
    env = gym.PlateEnv(task, action=kind.action, observation=kind.observation)
    seen, info = env.reset(seed=3)
    agent = kind(Brief.of(env), 3)
    moved = 0
    for moment in islice(run(Setup(gym.TASKS[task][0], 3)), 4):
        assert np.array_equal(seen, moment.image)
        true = env.plates.plates[0].simulation.state.position
        assert true == pytest.approx(moment.world.position, abs=1e-12)
        cycle = agent.act(seen, info)
        assert np.array_equal(cycle.knot_pose, moment.result.cycle.knot_pose)
        moved += cycle.moves
        seen, *_, info = env.step(cycle)
    assert moved >= 1


def test_motions_keep_the_limits_and_use_them(gym):
    """By the exact check of whole motions, which knows nothing of bounds."""
    from plate_gym.motions import Motions

    rig, rng = load_rig(), np.random.default_rng(1)
    motions = Motions(rig)
    wild = [np.sign(rng.normal(size=motions.size)), *rng.uniform(-1, 1, (3, motions.size))]
    for action in [*wild, *np.eye(motions.size)[:4]]:
        cycle, fraction = motions.cycle(action)
        true = usage(rig, cycle).overall
        assert 0.9 < true <= fraction <= 1
    small, _ = motions.cycle(0.01 * wild[1])
    assert usage(rig, small).overall < 0.2


def test_success_and_loss_by_the_true_positions(gym):
    """Parts put where they belong: done after `hold_s`. One that is put off the plate is lost."""
    env = gym.PlateEnv("Sort4-v1")
    _, info = env.reset(seed=1)
    plate, still = env.plates.plates[0], np.zeros(env.action_space.shape)
    way, simulation = info["to_go_m"], plate.simulation
    assert way > 0.1
    for k, name in enumerate(simulation.state.ids):
        side = -0.25 if name.startswith("black") else 0.25
        simulation.place(name, "", np.array([side, 0.05 * k - 0.1]))
    rewards, ended = [], False
    while not ended:
        _, reward, ended, over, info = env.step(still)
        rewards.append(reward)
        assert not over
        assert len(rewards) < 20
    assert rewards == pytest.approx([1, *[0] * (len(rewards) - 2), 1])
    assert info["success"]
    assert info["there"] == 4
    assert info["time_s"] == pytest.approx(0.6)  # seen there at 0.1 s, held for 0.5 s
    assert env.step(still)[1:3] == (0, True)  # who goes on gets nothing for it

    env.reset(seed=1)
    state = env.plates.plates[0].simulation.state
    state.position[0], state.velocity[0] = [0.299, 0.0], [2.0, 0.0]
    *_, ended, over, info = env.step(still)
    assert ended
    assert not over
    assert info["dropped"] == 1
    assert not info["success"]


def test_a_part_that_the_robot_takes_counts(gym):
    """It asks at 0 s and, as three lie ready, grips one 0.4 of its 2 s later, and one each 2 s:
    that which is nearest to the middle of the window. 0.3 s after a grip it has left, and 1.2 s
    after it asks again: meanwhile another is to be got ready, and actions count."""
    env = gym.PlateEnv("Feed-v1", render_mode="rgb_array")
    seen, info = env.reset(seed=0)
    assert seen[:, 6].tolist() == [1.0] * 10 + [0.0] * 5
    simulation = env.plates.plates[0].simulation
    simulation.remove("black_10")
    simulation.place("", "grey", np.array([-0.25, 0.1]))
    ready = {"black_2": (0.1, 0.01), "black_5": (0.1, -0.06), "black_7": (0.2, 0.05)}
    for k in range(1, 10):
        place = ready.get(f"black_{k}", (0.03 * k - 0.28, -0.13))
        simulation.place(f"black_{k}", "", np.array(place))
    taken, rests = [], []
    for step in range(1, 32):
        seen, reward, *_, info = env.step(np.full(env.action_space.shape, float(info["rests"])))
        rests.append(bool(info["rests"]))
        if reward:
            taken.append((step, reward, int(info["there"]), [*np.flatnonzero(info["ids"] == "")]))
        if step == 7:
            before = env.render().astype(float)
        if step == 8:
            assert np.max(np.abs(env.render() - before)) > 50
            true = dict(zip(simulation.state.ids, simulation.state.position.tolist(), strict=True))
            assert true["black_5"] == [0.1, -0.06]  # it rests, whatever the action
            assert seen[1].tolist() == [0, 0, 0, 0, 0, 1000, 0]
            assert info["ids"][10] == "grey_1"  # row 9 had just become empty
            assert seen[10, 6] == -1
    assert taken == [(8, 1 / 30, 1, [1]), (28, 1 / 30, 2, [1, 4])]
    assert rests == [True] * 10 + [False] * 9 + [True] * 11 + [False]
    assert info["waiting"] == 0


def test_parts_that_leave_count_unless_they_are_meant_to(gym):
    """The chute is on the right. A lost part costs reward, but does not end the episode."""
    env = gym.PlateEnv("Feed-v1")
    for label, x, lost in (("grey", 0.299, 0), ("grey", -0.299, 1), ("black", 0.299, 1)):
        env.reset(seed=0)
        plate = env.plates.plates[0].simulation
        name = plate.place("", label, np.array([np.sign(x) * 0.28, 0.0]))
        row = plate.state.ids.index(name)
        plate.state.position[row], plate.state.velocity[row] = [x, 0.0], [np.sign(x) * 2, 0.0]
        _, reward, ended, over, info = env.step(np.zeros(env.action_space.shape))
        assert (reward, ended, over, info["dropped"]) == (-lost, False, False, lost)
        assert name not in info["ids"]


def test_feed_succeeds_with_27_parts_in_a_minute(gym):
    env = gym.PlateEnv("Feed-v1")
    for picks, done in ((26, False), (27, True)):
        env.reset(seed=0)
        plate = env.plates.plates[0]
        plate.memory._cell.tally.picks = picks
        plate.timeline = replace(plate.timeline, begin=59.85)
        for last in (False, True):
            _, reward, ended, over, info = env.step(np.zeros(env.action_space.shape))
            assert (ended, over, info["success"]) == (last and done, last and not done, ended)
        assert (info["there"], reward) == (picks, done)


def test_follow_succeeds_if_the_part_is_on_the_path(gym):
    """Two laps on a circle of 120 mm: 8.02 s at the greatest speed whose v^2/r is 0.12 mu g."""
    env = gym.PlateEnv("Follow1-v1")
    seen, info = env.reset(seed=0)
    still, rewards, ended = np.zeros(env.action_space.shape), [], False
    while not ended:
        env.plates.plates[0].simulation.place("black_1", "", seen[0, 6:8])
        angle = 0.2 / 0.12 * np.clip(info["path_s"], 0, 7.5398)
        assert seen[0, 6:8] == pytest.approx([0.12 * np.cos(angle), 0.12 * np.sin(angle)], abs=1e-3)
        seen, reward, ended, over, info = env.step(still)
        rewards.append(reward)
    assert info["success"]
    assert not over
    assert sum(rewards) == pytest.approx(2)
    assert 8.02 + 0.2 < info["time_s"] < 10
    assert info["error_m"][0] < 1e-9


def test_references_wait_for_a_slow_part_and_the_episode_fails_if_it_leaves(gym):
    """For a part that stays behind, at half of `max_error_m`: for ever."""
    env = gym.PlateEnv("Follow2-v1")
    env.reset(seed=0)
    still = np.zeros(env.action_space.shape)
    for _ in range(20):
        seen, reward, ended, _, info = env.step(still)
    off = np.hypot(*(seen[:, 6:8] - seen[:, :2]).T)
    assert np.all((off > 0.0145) & (off < 0.0175))  # 4 mm in a cycle at full pace
    assert np.all(info["error_m"] < off)  # root mean square
    assert (reward, ended, info["pace"][1]) == (0, False, 0)
    for distance in (0.0302, 0.0305):
        env.plates.plates[0].simulation.place("black_1", "", seen[0, 6:8] + [0, distance])
        _, _, ended, _, info = env.step(still)
        assert (ended, bool(info["success"])) == (distance > 0.0303, False)


def test_agent_b_follows_the_given_references(gym):
    from plate_gym.agent import Brief
    from plate_gym.agents import AGENTS

    env = gym.PlateEnv("Follow2-v1", action="cycle")
    seen, info = env.reset(seed=0)
    agent = AGENTS["B"](Brief.of(env), 0)
    for _ in range(12):
        seen, *_, info = env.step(agent.act(seen, info))
    assert np.max(info["error_m"]) < 2e-4
    assert np.min(np.hypot(*(seen[:, :2] - seen[:, 6:8]).T)) > 3e-3  # at 40 mm/s


def test_agent_b_feeds_parts_as_fast_as_the_robot_takes_them(gym):
    """An agent that does nothing feeds the parts that happen to be ready."""
    from plate_gym.agent import Brief
    from plate_gym.agents import AGENTS

    for works in (True, False):
        env = gym.PlateEnv("Feed-v1", action="cycle")
        seen, info = env.reset(seed=0)
        agent = AGENTS["B"](Brief.of(env), 0)
        while info["time_s"] < 19:
            seen, *_, info = env.step(agent.act(seen, info) if works else PlateCycle.rest(0.1))
        assert info["dropped"] == 0
        assert (info["there"] == 10) == (info["waiting"] == 0) == works


def test_observations_have_noise_latency_and_misses(gym):
    """True positions with noise, with the latency and the misses of the world."""
    env = gym.PlateEnv("Sort10-v1")
    true = env.reset(seed=2)[0], env.plates.plates[0].simulation.state
    error = true[0][:, :2] - true[1].position
    assert 1e-6 < np.std(error) < 1e-4
    assert np.all(true[0][:, 5] == 0)

    rng, late = np.random.default_rng(0), gym.PlateEnv("Sort10-v1", world="latency")
    late.reset(seed=2)
    actions = rng.uniform(-1, 1, (3, *env.action_space.shape))
    for action in actions:
        seen = late.step(action)[0]
    plate = late.plates.plates[0].simulation
    before = plate._view.history.ago(0.05).position
    assert seen[:, :2] == pytest.approx(before, abs=2e-4)
    assert np.max(np.abs(before - plate.state.position)) > 5e-4

    missing = gym.PlateVectorEnv("Sort50-v1", 6, world="misses")
    ages = missing.reset(seed=0)[0][..., 5]
    assert 0.005 < np.mean(ages > 0) < 0.08  # 3 % of 300


def test_a_rendered_picture_shows_the_parts(gym):
    env = gym.PlateEnv("Sort4-v1", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (480, 640, 3)
    again = env.render()
    assert np.mean(before != again) < 0.9  # noise alone
    plate = env.plates.plates[0].simulation
    plate.place("black_1", "", np.array([0.0, 0.1]))
    assert np.max(np.abs(env.render().astype(float) - again)) > 50
    seen = gym.PlateEnv("Sort4-v1").reset(seed=0)[0]
    assert np.array_equal(env.reset(seed=0)[0], seen)  # pictures change nothing


class Tk:
    """A desktop's toolkit like Tk: it destroys a closed window, unless another handler is set."""

    def __init__(self):
        self.lock = Lock()
        self.updates = 0
        self.closed = False
        self.on_close = self.destroy

    def title(self, text):
        pass

    def protocol(self, name, call):
        assert name == "WM_DELETE_WINDOW"
        self.on_close = call

    def update(self):
        self.updates += 1
        if self.updates == 2:
            self.on_close()

    def destroy(self):
        assert not self.closed, "application has been destroyed"
        self.closed = True


def test_a_window_that_is_closed_or_copied_ends_nothing(gym, monkeypatch):
    windows = []

    class Label(SimpleNamespace):
        def pack(self):
            pass

        def configure(self, image):
            assert not self.root.closed, "application has been destroyed"

    def opened():
        windows.append(Tk())
        return windows[-1]

    desktop = SimpleNamespace(
        Tk=opened, Label=lambda root: Label(root=root), PhotoImage=Label, TclError=RuntimeError
    )
    monkeypatch.setitem(sys.modules, "tkinter", desktop)
    env = gym.PlateEnv("Sort4-v1", render_mode="human")
    env.reset(seed=0)
    copy.deepcopy(env).reset()
    for _ in range(3):
        env.step(np.zeros(18))
    env.close()
    env.close()
    assert [(window.updates, window.closed) for window in windows] == [(2, True), (1, False)]


def test_a_rest_after_motion_is_reached_by_the_tail(gym):
    """A motion that does not begin in the plate's state waits until the plate rests."""
    from plate_gym.agent import Brief
    from plate_gym.agents import AGENTS

    env = gym.PlateEnv("Sort10-v1", action="cycle")
    seen, info = env.reset(seed=3)
    agent = AGENTS["B"](Brief.of(env), 3)
    while info["running"].tail is None:
        seen, *_, info = env.step(agent.act(seen, info))
    tail = info["running"].tail
    *_, info = env.step(PlateCycle.rest(0.1))
    assert info["running"] is tail
    *_, info = env.step(PlateCycle.rest(0.1))
    assert not info["running"].moves


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"task": "Sort11-v1"}, "task is 'Sort11-v1', did you mean 'Sort10-v1'?"),
        ({"world": "moon"}, "world is 'moon', allowed: nominal, "),
        ({"action": "wish"}, "action is 'wish', allowed: motion, "),
        ({"observation": "smell"}, "observation is 'smell', allowed: parts, image"),
        ({"action": "forces", "observation": "image"}, "action is 'forces' with images, allowed: "),
        ({"render_mode": "ansi"}, "render_mode is 'ansi', allowed: None, rgb_array, human"),
    ],
)
def test_wrong_settings_are_refused(gym, settings, words):
    with pytest.raises(PlateError) as problem:
        gym.PlateEnv(**{"task": "Sort4-v1", **settings})
    assert words.replace(", did you mean 'Sort10-v1'?", "") in str(problem.value)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (np.full(18, 1.1), "float64 of shape (18,), from 1.1 to 1.1"),
        (np.full(18, np.nan), "float64 of shape (18,), from nan to nan"),
        (np.zeros(17), "float64 of shape (17,), from 0 to 0"),
        ([2] * 18, "int64 of shape (18,), from 2 to 2"),
        (["a"] * 18, "<U1 of shape (18,)"),
        (np.full(18, None), "object of shape (18,)"),
        ([10**400] * 18, "object of shape (18,)"),
        ([[1], [1, 2]], "list"),
    ],
)
def test_wrong_actions_are_refused(gym, wrong, words):
    env = gym.PlateEnv("Sort4-v1")
    env.reset(seed=0)
    with pytest.raises(PlateError) as problem:
        env.step(wrong)
    assert str(problem.value) == f"action is {words}, allowed: Box(-1.0, 1.0, (18,), float64)"


def test_a_wrong_action_of_many_rows_is_refused_in_a_line(gym):
    env = gym.PlateEnv("Feed-v1", action="progress")
    env.reset(seed=0)
    with pytest.raises(PlateError) as problem:
        env.step(np.zeros((15, 2)))
    assert str(problem.value) == (
        "action is float64 of shape (15, 2), from 0 to 0, allowed: (15, 3), rows from "
        "[-1.0, -1.0, 0.0] to [1.0, 1.0, 1.0]"
    )


def test_motions_beyond_the_limits_are_scaled_down(gym):
    env = gym.PlateEnv("Sort4-v1", action="cycle")
    env.reset(seed=0)
    wild = env.action_space.sample().scaled(5.0)
    *_, info = env.step(wild)
    assert info["scaled"]
    assert info["limit_share"] <= 1
    assert usage(load_rig(), info["running"]).overall <= 1
    with pytest.raises(PlateError, match=r"action is of type int, allowed: plate_core\.PlateCycle"):
        env.step(3)


def test_reported_cycles_cannot_be_changed(gym):
    """Not beyond the limits, nor at all."""
    env = gym.PlateEnv("Sort4-v1", action="cycle")
    env.reset(seed=0)
    for _ in range(2):
        *_, info = env.step(env.action_space.sample())
    with pytest.raises(ValueError, match="read-only"):
        info["running"].coefficients[:] *= 5


def test_the_programs_and_tables_of_the_guide_are_correct(capsys):
    """The page's programs run, and its tables agree with the scenarios and the worlds."""
    from plate_gym.agent import KNOWN, Brief
    from plate_gym.tasks import TASKS, WORLDS, scenario_of
    from plate_sim.world import NONE

    page = (Path(__file__).resolve().parents[3] / "docs/guide/gym.md").read_text(encoding="utf-8")
    scope: dict = {}
    blocks = re.findall(r"```python\n(.*?)```", page, re.S)
    for block in blocks:
        exec(block, scope)
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("True ")
    assert float(first.split()[1]) < 12
    assert second.startswith("(64, 10, 6) ")
    exec(blocks[0].replace("seed=0", "seed=2"), {})  # a part begins at an edge
    assert capsys.readouterr().out.startswith("True ")
    own = scope["plate_gym"].PlateEnv("Sort4-v1")
    seen, info = own.reset(seed=0)
    agent = scope["Agent"](Brief.of(own), 0)
    assert own.action_space.contains(agent.act(seen, info))
    assert {*Brief.__dataclass_fields__, *KNOWN} <= set(re.findall(r"`(\w+)`", page))
    assert set(info) <= set(re.findall(r"`(\w+)`", page))
    table = page[page.index("| environment |") : page.index("An environment never")]
    for name in TASKS:
        scenario, _ = scenario_of(name)
        (row,) = [line for line in table.splitlines() if f"{name.removesuffix('-v1')}" in line]
        assert f"{getattr(scenario.task, 'hold_s', 0.0):.1f} |" in row
        assert f"{scenario.time_limit_s:.0f}" in row.rsplit("|", 2)[1]
    for name, world in WORLDS.items():
        (row,) = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
        values = {each.name: getattr(world.disturbances, each.name) for each in fields(NONE)}
        values = {key: value for key, value in values.items() if value != getattr(NONE, key)}
        figures = {round(1e3 * values.pop("latency", 0)), 100 - round(100 * world.mu_scale)}
        figures |= {round(float(np.degrees(values.pop("tilt_x", 0))), 1)}
        figures |= {round(100 * (values.pop("static_ratio", 1) - 1))}
        figures |= {round(100 * value) for value in values.values()}
        assert {float(figure) for figure in re.findall(r"[\d.]+", row)} == figures - {0}, name
