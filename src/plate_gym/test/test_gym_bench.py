"""The judge of agents: what it counts, that it gives the same again, what it notices."""

import copy
import json
import subprocess
import sys

import pytest

from plate_core import PlateError

pytestmark = pytest.mark.needs("gymnasium")

LAZY = """
import numpy as np

class Lazy:
    action, observation = "motion", "parts"

    def __init__(self, env, seed):
        self.action_size = env.action_space.shape

    def act(self, observation, info):
        return np.zeros(self.action_size)
"""


@pytest.fixture
def bench():
    import plate_gym.bench

    return plate_gym.bench


@pytest.fixture(scope="module")
def result():
    import plate_gym.bench

    found = plate_gym.bench.evaluate("A", ["Sort4-v1"], range(2))
    return json.loads(json.dumps(found))  # as a file has it


def test_ours_sorts_and_is_the_same_again(bench, result):
    found = result["tasks"]["Sort4-v1"]
    assert found["success"] == 1
    assert found["success_interval"] == pytest.approx([0.342, 1], abs=1e-3)  # Wilson's, 2 of 2
    assert [row["return"] for row in found["rows"]] == pytest.approx([2, 2], abs=0.1)
    assert 0 < found["time_s"] < 20
    assert found["decision_ms"] > 0
    assert all(0.9 < row["limit_share"] <= 1 for row in found["rows"])
    assert bench.check(result) == []


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("time_s", 1.0, "seed 1: time_s is 1.0, again: "),
        ("places", "00", "seed 1: places is '00', again: "),
        ("seed", 0, "a seed is given twice, allowed: each once"),
    ],
)
def test_what_was_changed_is_noticed(bench, result, key, value, words, monkeypatch):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    changed = copy.deepcopy(result)
    changed["tasks"]["Sort4-v1"]["rows"][1][key] = value
    assert words in "\n".join(bench.check(changed))


def test_a_summary_is_of_its_rows(bench, result, monkeypatch):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    changed = copy.deepcopy(result)
    changed["tasks"]["Sort4-v1"]["time_s"] = 1.0
    assert bench.check(changed) == ["Sort4-v1: the summary is not that of its rows"]


def test_an_agent_of_ones_own_by_the_command(tmp_path, bench):
    """One that does nothing gets nothing, for as long as the task may take."""
    (tmp_path / "lazy.py").write_text(LAZY, encoding="utf-8")
    command = [
        sys.executable, "-m", "plate_gym.bench", "--agent", "lazy:Lazy", "--task", "Sort4-v1",
        "--seeds", "5", "--workers", "1", "--json", "lazy.json",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads((tmp_path / "lazy.json").read_text())["tasks"]["Sort4-v1"]["rows"]
    assert (row["success"], row["return"], row["steps"], row["limit_share"]) == (False, 0, 1200, 0)
    assert row["time_s"] == pytest.approx(120)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"agent": "C"}, "agent is 'C', allowed: B, A, "),
        ({"agent": "nowhere:Agent"}, "agent nowhere:Agent cannot be loaded: No module"),
        ({"tasks": ["Sort5"]}, "task is 'Sort5'"),
        ({"world": "moon"}, "world is 'moon'"),
        ({"seeds": [-1]}, "seeds are [-1], allowed: one or more, from 0 on"),
    ],
)
def test_wrong_names_are_refused(bench, settings, words):
    with pytest.raises(PlateError) as problem:
        bench.evaluate(**{"agent": "random", "tasks": ["Sort4-v1"], "seeds": [0], **settings})
    assert words in str(problem.value)


@pytest.mark.parametrize("name", ["A", "averaged", "random"])
def test_the_other_agents_act(bench, name):
    from plate_gym import PlateEnv

    kind = bench.agent_class(name)
    env = PlateEnv("Sort4-v1", action=kind.action, observation=kind.observation)
    seen, info = env.reset(seed=0)
    agent, way = kind(env, 0), info["to_go_m"]
    for _ in range(8):
        seen, *_, info = env.step(agent.act(seen, info))
    assert info["limit_share"] > 0.9
    assert name != "A" or info["to_go_m"] < 0.9 * way


def ended(main):
    """With which code a program has ended, by itself or by its parser."""
    try:
        return main()
    except SystemExit as end:
        return end.code


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["--agent", "C"], 2, "error: agent is 'C', allowed: B, A, "),
        (["--check", "nowhere.json"], 2, "error: [Errno 2] No such file"),
        (["--check", "text.json"], 2, "error: text.json is no JSON: "),
        (["--check", "empty.json"], 2, "error: result has no agent, world, tasks, allowed: "),
        (["--check", "false.json"], 1, "Sort4-v1, seed 0: dropped is 1, again: 0"),
        (["--seeds", "5:1"], 2, "is '5:1', allowed: FIRST:END"),
    ],
)
def test_the_command_says_what_is_wrong(
    bench, result, words, code, told, tmp_path, monkeypatch, capsys
):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    false = copy.deepcopy(result)
    false["tasks"]["Sort4-v1"]["rows"][0]["dropped"] = 1
    for name, text in (("text", "..."), ("empty", "{}"), ("false", json.dumps(false))):
        (tmp_path / f"{name}.json").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["bench", *words])
    assert ended(bench.main) == code
    said = capsys.readouterr()
    assert told in said.out + said.err


def test_the_speed_of_each_size_is_told(monkeypatch, capsys):
    from plate_gym import speed

    for name in ("CYCLES", "MANY"):
        monkeypatch.setattr(speed, name, 2)
    monkeypatch.setattr(speed, "TASKS", ("Sort4-v1",))
    monkeypatch.setattr(sys, "argv", ["speed"])
    assert speed.main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[1:3]] == [["Sort4-v1", "1"], ["Sort4-v1", "2"]]
    assert all(float(number) > 0 for line in lines[1:] for number in line.split()[3:])
