"""The evaluation of agents: its counts, its repeatability, and the cheats that it detects."""

import copy
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from plate_core import PlateError
from plate_core.files import OwnFile

pytestmark = pytest.mark.needs("gymnasium")


LAZY = """
import numpy as np

class Lazy:
    action, observation = "motion", "parts"

    def __init__(self, brief, seed):
        print("made", end="")
        self.action_size = brief.action_space.shape

    def act(self, observation, info):
        return np.zeros(self.action_size)
"""


@pytest.fixture
def bench():
    import plate_gym.bench

    return plate_gym.bench


@pytest.fixture
def provenance():
    import plate_gym.provenance

    return plate_gym.provenance


@pytest.fixture(scope="module")
def result():
    import plate_gym.bench

    found = plate_gym.bench.evaluate("A", ["Sort4-v1"], range(2))
    return json.loads(json.dumps(found))  # as a file has it


def test_agent_b_sorts_and_its_result_is_reproducible(bench, result):
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
        ("time_s", 1.0, "seed 1: time_s is 1.0 in the result, "),
        ("places", "00", "seed 1: places is '00' in the result, "),
    ],
)
def test_a_changed_result_is_detected(bench, result, key, value, words, monkeypatch):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    changed = copy.deepcopy(result)
    changed["tasks"]["Sort4-v1"]["rows"][1][key] = value
    assert words in "\n".join(bench.check(changed))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ([], None, "result has None, allowed: agent, "),
        ([], "text", "result has 'text', allowed: agent, "),
        (["more"], 1, "versions, limits, files, tasks, more, allowed: agent, world, commit, "),
        (["agent"], 3, "result: agent is 3, allowed: str"),
        (["agent"], "a\x1b[2J", "result: agent is 'a\\x1b[2J', allowed: up to 300 printable "),
        (["agent"], "B](https://example.org)", "agent is 'B](https://example.org)', allowed: "),
        (["commit"], "a b", "commit is 'a b', allowed: the form "),
        (["agent"], "a" * 10**7, "aaa', allowed: up to 300 printable characters"),
        (["versions"], {"numpy": ["2"]}, "result: versions: numpy is ['2'], allowed: str"),
        (["limits"], {"decision_s": 60.0}, "result: limits has decision_s, allowed: decision_s, "),
        (["limits", "memory_gb"], "4", "result: limits: memory_gb is '4', allowed: a number "),
        (["files"], {"w.npz": 3}, "result: files: w.npz is 3, allowed: str"),
        (["files"], dict.fromkeys(map(str, range(10_001)), ""), "files has 10001 names, allowed: "),
        (["tasks"], ["x" * 10**6] * 10**3, "...], allowed: dict"),
        (["tasks"], {}, "result: tasks is {}, allowed: one task or more"),
        (["tasks"], [1], "result: tasks is [1], allowed: dict"),
        (["tasks", "Sort4-v1"], {}, "result: Sort4-v1: rows is None, allowed: a list"),
        (["tasks", "Sort4-v1", "rows"], [], "result: Sort4-v1: rows is [], allowed: a list with"),
        (
            ["tasks", "Sort4-v1", "rows", 1],
            {"seed": 1},
            "rows[1] has seed, allowed: time_s, ",
        ),
        (["tasks", "Sort4-v1", "rows", 1, "seed"], "0", "rows[1]: seed is '0', allowed: int"),
        (["tasks", "Sort4-v1", "rows", 1, "seed"], 0.0, "rows[1]: seed is 0.0, allowed: int"),
        (["tasks", "Sort4-v1", "rows", 1, "seed"], -1, "rows[1]: seed is -1, allowed: 0 or more"),
        (["tasks", "Sort4-v1", "rows", 1, "seed"], 10**4299, ", allowed: an integer below 2**128"),
        (["tasks", "Sort4-v1", "rows", 1, "dropped"], 2**128, "allowed: an integer below 2**128"),
        (["tasks", "Sort4-v1", "rows", 1, "wall_ms"], -2, "wall_ms is -2, allowed: 0 or more"),
        (
            ["tasks", "Sort4-v1", "rows", 1, "seed"],
            0,
            "a seed occurs twice, allowed: each seed once",
        ),
        (["tasks", "Sort4-v1", "rows", 1, "return"], np.nan, "return is nan, allowed: a number"),
        (
            ["tasks", "Sort4-v1", "rows", 1, "time_s"],
            1e10,
            "time_s is 10000000000.0, allowed: a number below 1e+09",
        ),
        (["tasks", "Sort5-v1"], {}, "result: task is 'Sort5-v1'"),
    ],
)
def test_an_invalid_result_is_refused(bench, result, path, value, words):
    changed = {"": copy.deepcopy(result)}
    path, place = ["", *path], changed
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(PlateError) as problem:
        bench.check(changed[""])
    assert words in str(problem.value)


def test_an_unknown_key_of_the_summary_is_reported(bench, result, monkeypatch):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    changed = copy.deepcopy(result)
    changed["tasks"]["Sort4-v1"]["better"] = 1.0
    assert bench.check(changed) == ["Sort4-v1: the summary does not match its rows"]


def test_wrong_results_and_results_of_other_code_are_reported(bench, result, monkeypatch):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    reports = []
    assert bench.check(result | {"sources": "00"}, reports.append) == []
    took = f"{result['tasks']['Sort4-v1']['decision_ms']:.3g}"
    assert reports == [
        f"agent A, commit {result['commit'] or 'unknown'}",
        f"sources is 00 in the result, and {bench.sources()} here",
        "Sort4-v1: the result has seeds 0:2",
        f"Sort4-v1: 2 seeds repeated, 0 differences so far; {took} ms per decision in the result, "
        f"{took} ms here",
    ]
    assert bench.ranges([0, 1, 2, 5, 8, 9]) == "0:3, 5, 8:10"


def test_seeds_of_any_size_are_run_again(bench, result, monkeypatch):
    seeds, requested = [1, 2**63, 2**63 + 1], []
    row = result["tasks"]["Sort4-v1"]["rows"][0]

    def episode(agent, world, task, seed):
        requested.append(seed)
        return row | {"seed": seed}

    monkeypatch.setattr(bench, "episode", episode)
    found = json.loads(json.dumps(bench.evaluate("A", "Sort4-v1", seeds)))
    reports = []
    assert bench.check(found, reports.append) == []
    assert requested == 2 * seeds
    assert reports[1] == f"Sort4-v1: the result has seeds 1, {2**63}:{2**63 + 2}"


@pytest.mark.parametrize("good", [True, False])
def test_fresh_seeds_reveal_selected_seeds(bench, result, monkeypatch, good):
    """An agent that does well on the seeds that it hands in only."""
    row, reports = result["tasks"]["Sort4-v1"]["rows"][0], []

    def episode(agent, world, task, seed):
        return row | {"seed": seed, "success": world == "nominal" and (good or seed < 20)}

    monkeypatch.setattr(bench, "episode", episode)
    found = json.loads(json.dumps(bench.evaluate("A", "Sort4-v1", range(20))))
    wrong = bench.check(found, reports.append, fresh=20)
    assert wrong == (
        [] if good else ["Sort4-v1: success is 1.0 in the result, 0.0 with fresh seeds"]
    )
    assert ", nominal, fresh seeds " in reports[-1]
    # nothing was claimed about this world
    assert bench.check(found, reports.append, fresh=20, world="held_out") == []
    assert "   0 % (0 to 16)" in reports[-1]
    assert ", held_out, fresh seeds " in reports[-1]


def test_code_is_identified_by_its_content(provenance, tmp_path, monkeypatch):
    """The commit is that of this file or of its original, even inside another repository. A change
    of any source changes the digest."""
    before = provenance.sources()
    package = tmp_path / "plate_core"
    package.mkdir()
    (package / "__init__.py").write_text("")
    spec = SimpleNamespace(origin=str(package / "__init__.py"))
    monkeypatch.setattr(provenance, "find_spec", lambda name: spec)
    other = provenance.sources()
    (package / "kernel.hpp").write_text("int x;")
    assert len({before, other, provenance.sources()}) == 3
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    done = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "a"]
    subprocess.run([*done, "--allow-empty"], cwd=tmp_path, check=True)
    name = "provenance.py"
    kept, copy = tmp_path / "src/plate_gym/plate_gym" / name, tmp_path / "install" / name
    for path in (kept, copy):
        path.parent.mkdir(parents=True)
        path.write_text("")
    monkeypatch.setattr(provenance, "__file__", str(copy))  # as set-up does
    assert provenance.commit() == ""
    subprocess.run(["git", "add", "src"], cwd=tmp_path, check=True)
    assert provenance.commit()
    copy.write_text("1")
    assert provenance.commit() == ""


CHEATS = {
    "Teleport": "def act(self, seen, info): self.brief.plates",
    "Ahead": "def act(self, seen, info): self.brief.step(self.brief.action_space.sample())",
    "Peep": "def act(self, seen, info): return info['error_m']",
    "Again": "def act(self, seen, info): self.brief.reset(seed=7)",
    "Set": "def act(self, seen, info): self.brief.scenario = None",
    "Nan": "def act(self, seen, info): return np.full(18, np.nan)",
    "Exit": "def act(self, seen, info): raise SystemExit(3)",
    "Wish": "action = 'wish'\n    def act(self, seen, info): pass",
}


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module with agents that cheat or fail, and with objects that are no agents."""
    text = "import numpy as np\nclass Base:\n    action, observation = 'motion', 'parts'\n"
    text += "    def __init__(self, brief, seed): self.brief = brief\n"
    text += "\n".join(f"class {name}(Base):\n    {code}" for name, code in CHEATS.items())
    text += "\nnumber = 3\nclass Slow(Base):\n    action = 'progress'\n"
    text += "    def act(self, seen, info): return self.brief.action_space.sample()\n"
    (tmp_path / "odd_agents.py").write_text(text)
    (tmp_path / "broken_agents.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.parametrize("name", CHEATS)
def test_an_agent_that_cheats_or_fails_is_named(bench, module, name):
    with pytest.raises(PlateError, match=f"agent odd_agents:{name}, Sort4-v1, seed 3, step 0: "):
        bench.evaluate(f"odd_agents:{name}", "Sort4-v1", np.arange(3, 4))


def test_an_agent_that_kills_its_process_is_named(bench, tmp_path, monkeypatch):
    text = LAZY.replace("return", "__import__('os')._exit(0)  #")
    (tmp_path / "deadly.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        PlateError, match="agent deadly:Lazy, Sort4-v1, seed 0, step 0: its process di"
    ):
        bench.evaluate("deadly:Lazy", "Sort4-v1", [0], workers=1)


def test_failed_episodes_have_no_share_in_medians_and_may_fail_at_another_step(bench, result):
    good = result["tasks"]["Sort4-v1"]["rows"][0]
    failed = {key: kind() for key, kind in bench.ROW.items()} | {"seed": 7, "failure": "slow"}
    assert bench.summary([good, failed])["decision_ms"] == good["decision_ms"]
    assert bench.summary([good, failed])["success"] == 0.5
    assert bench.summary([failed])["decision_ms"] == 0
    assert list(bench.differing(failed, failed | {"steps": 9, "failure": "large"})) == []
    assert list(bench.differing(failed, good)) == [("failure", None)]
    assert list(bench.differing(good, failed)) == [("failure", "slow")]


def test_an_agent_is_imported_only_if_the_reviewer_trusts_it(bench, result, tmp_path, monkeypatch):
    text = "from pathlib import Path\nPath('imported').touch()\n" + LAZY
    (tmp_path / "stranger.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    claimed = result | {"agent": "stranger:Lazy"}
    for trusted in ("", "other:Agent"):
        with pytest.raises(PlateError, match=r"agent stranger:Lazy.*--trust stranger:Lazy"):
            bench.check(claimed, trusted=trusted)
    assert not (tmp_path / "imported").exists()
    wrong = bench.check(claimed, trusted="stranger:Lazy")
    assert (tmp_path / "imported").exists()
    assert any("success is True in the result, False here" in text for text in wrong)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("fifo", "is a FIFO"), ("folder", "is a folder"), ("device", "is a device"),
        ("socket", "is a socket"), ("large", "has 3000 MB"),
    ],
)  # fmt: skip
def test_a_result_is_a_regular_file_of_limited_size(bench, tmp_path, kind, words):
    path = tmp_path / "result"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as own:
            own.bind(str(path))
    else:
        with path.open("wb") as file:
            file.truncate(3_000_000_000)
    with pytest.raises(PlateError, match=f"{words}, allowed: a regular file up to 64 MB"):
        bench.read(path)


def test_a_key_that_occurs_twice_is_refused(bench, tmp_path):
    """A reader of the file can see another value than the program."""
    path = tmp_path / "result.json"
    path.write_text('{"tasks": [{"success": true, "success": false}]}')
    with pytest.raises(PlateError, match=r"result\.json is not JSON: an object has a key twice"):
        bench.read(path)


def test_names_of_files_cannot_control_the_terminal(bench, tmp_path, monkeypatch, capsys):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "\x1b[2J.py").write_text("#" * 1_100_000)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "argv", ["bench", "--agent", "other:Agent"])
    assert bench.main() == 2
    assert "/other/?[2J.py: has 1.1 MB, allowed: " in capsys.readouterr().err


def test_long_lists_of_a_result_are_shortened(bench, result, monkeypatch):
    row = result["tasks"]["Sort4-v1"]["rows"][0]
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: row | {"seed": seed})
    claimed = json.loads(json.dumps(bench.evaluate("A", "Sort4-v1", range(0, 2000, 2))))
    claimed["versions"] |= dict.fromkeys(map(str, range(9000)), "1")
    reports = []
    assert bench.check(claimed, reports.append) == []
    assert len(reports) == 1 + bench.MAX_OTHER + 3
    assert reports[-3] == "8900 more differences of versions and files"
    assert max(map(len, reports)) < 400


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"decision_s": 0}, "decision_s is 0, allowed: 0.1 to 1e[+]06"),
        ({"memory_gb": float("nan")}, "memory_gb is nan, allowed: 0.5 to 1e[+]06"),
    ],
)
def test_wrong_limits_are_refused(bench, limits, words):
    with pytest.raises(PlateError, match=words):
        bench.Limits(**limits)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("odd_agents:number", "agent odd_agents:number is 3, allowed: a class with the attributes"),
        ("odd_agents:Base", "allowed: a class with the attributes action and observation"),
        ("broken_agents:Any", "broken_agents:Any cannot be loaded: ZeroDivisionError: division"),
    ],
)
def test_an_invalid_agent_is_refused(bench, module, name, words):
    with pytest.raises(PlateError) as problem:
        bench.agent_class(name)
    assert words in str(problem.value)


def test_the_solver_counts_as_decision_time(bench, module, monkeypatch):
    """Where the action asks it: by clocks that only its work moves on."""
    import plate_gym.episode
    import plate_gym.plates

    hours = np.zeros(2)
    answer = plate_gym.plates.Controller.solve

    def slow(self, *args):
        hours[:] += 3600, 7200
        return answer(self, *args)

    monkeypatch.setattr(plate_gym.plates.Controller, "solve", slow)
    for place in (plate_gym.episode, plate_gym.plates):
        monkeypatch.setattr(place, "clocks", hours.copy)
    monkeypatch.setattr(plate_gym.plates, "ROUNDING_S", 119.5)  # of 120 s
    row = bench.episode("odd_agents:Slow", "nominal", "Sort4-v1", 0)
    times = [row[name] for name in bench.TIMES]
    assert times == pytest.approx([0, 3.6e6, 3.6e6, 7.2e6, 7.2e6])


def in_this_process(bench, monkeypatch):
    """The command's workers do not have the changes that a test has made."""
    episodes = bench.episodes

    def here(agent, world, task, seeds, workers, *args, **settings):
        return episodes(agent, world, task, seeds, 0)

    monkeypatch.setattr(bench, "episodes", here)


def test_results_before_a_failure_are_kept(bench, result, monkeypatch, tmp_path, capsys):
    row, problems = result["tasks"]["Sort4-v1"]["rows"][0], []

    def episode(agent, world, task, seed):
        if task == "Sort10-v1":
            raise problems.pop()
        return row | {"seed": seed}

    monkeypatch.setattr(bench, "episode", episode)
    in_this_process(bench, monkeypatch)
    place = tmp_path / "found.json"
    words = ["--task", "Sort4-v1", "--task", "Sort10-v1", "--seeds", "7"]
    monkeypatch.setattr(sys, "argv", ["bench", "--json", str(place), *words])
    for problem, code in ((PlateError("lost"), 2), (KeyboardInterrupt, 130)):
        problems.append(problem)
        place.unlink(missing_ok=True)
        assert bench.main() == code
        assert list(json.loads(place.read_text())["tasks"]) == ["Sort4-v1"]
    kept = f"stopped; {place} has the episodes so far\n"
    assert capsys.readouterr().err == f"error: lost\n{kept}"


def test_a_second_call_runs_only_missing_episodes(bench, result, monkeypatch, tmp_path):
    row, run = result["tasks"]["Sort4-v1"]["rows"][0], []

    def episode(agent, world, task, seed):
        run.append((task, seed))
        if seed == 9:
            raise KeyboardInterrupt
        return row | {"seed": seed}

    monkeypatch.setattr(bench, "episode", episode)
    in_this_process(bench, monkeypatch)
    place = tmp_path / "found.json"
    words = ["bench", "--json", str(place), "--task", "Sort4-v1", "--agent", "A", "--seeds"]
    monkeypatch.setattr(sys, "argv", [*words, "7:10"])
    assert bench.main() == 130
    monkeypatch.setattr(sys, "argv", [*words, "6:9"])
    assert bench.main() == 0
    assert run == [("Sort4-v1", seed) for seed in (7, 8, 9, 6)]
    found = json.loads(place.read_text())
    rows = [row | {"seed": seed} for seed in (6, 7, 8)]
    assert found["tasks"]["Sort4-v1"] == json.loads(json.dumps(bench.summary(rows)))
    assert [file.name for file in tmp_path.iterdir()] == ["found.json"]


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("agent",), "B", "agent was B and is now A; allowed: "),
        (("world",), "friction", "world was friction and is now nominal; "),
        (("sources",), "of another commit", "sources was of another commit and is now "),
        (("versions", "numpy"), "1.0", "numpy was 1.0 and is now 2."),
        (("versions", "shapely"), "1.0", "shapely was 1.0 and is now 2."),
        (("versions", "first cycles"), "00", "first cycles was 00 and is now "),
        (("limits", "decision_s"), 5.0, "decision_s was 5.0 and is now 60.0; "),
        (("limits", "memory_gb"), 1.0, "memory_gb was 1.0 and is now 4.0; "),
        (("files", "weights.npz"), "00", "file weights.npz was 00 and is now None; "),
        (
            ("limits",),
            None,
            "decision_s was None and is now 60.0; memory_gb was None and is now 4.0",
        ),
    ],
)
def test_a_result_of_other_terms_is_not_continued(
    bench, result, monkeypatch, tmp_path, capsys, place, value, words
):
    other = copy.deepcopy(result)
    if value is None:  # as earlier versions wrote it
        del other["limits"], other["files"]
    else:
        (other if len(place) == 1 else other[place[0]])[place[-1]] = value
    file = tmp_path / "found.json"
    file.write_text(json.dumps(other), encoding="utf-8")
    before = file.read_text()
    words_of_call = ["--json", str(file), "--task", "Sort4-v1", "--agent", "A", "--seeds", "0"]
    monkeypatch.setattr(sys, "argv", ["bench", *words_of_call])
    assert bench.main() == 2
    assert f"the earlier result cannot be continued: {words}" in capsys.readouterr().err
    assert file.read_text() == before


def test_a_file_that_cannot_be_continued_is_refused_before_the_cluster(
    bench, monkeypatch, tmp_path, capsys
):
    place = tmp_path / "found.json"
    place.write_text("[]", encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["bench", "--json", str(place), "--cluster", "tcp://x:1"])
    monkeypatch.setattr(bench, "Cluster", None)
    assert bench.main() == 2
    assert "error: result has [], allowed: agent, " in capsys.readouterr().err


def test_the_cluster_is_awaited_only_for_missing_episodes_of_known_tasks(
    bench, result, monkeypatch, tmp_path, capsys
):
    place = tmp_path / "found.json"
    place.write_text(json.dumps(result), encoding="utf-8")
    monkeypatch.setattr(bench, "Cluster", None)
    seeds = [str(row["seed"]) for row in result["tasks"]["Sort4-v1"]["rows"]]
    words = ["bench", "--cluster", "tcp://x:1", "--json", str(place), "--agent", result["agent"]]
    for task, code in (("Sort4-v1", 0), ("Sort3-v1", 2)):
        monkeypatch.setattr(sys, "argv", [*words, "--seeds", seeds[0], "--task", task])
        assert bench.main() == code
    assert "task is 'Sort3-v1'" in capsys.readouterr().err


def test_a_module_that_does_not_exist_is_named_before_the_cluster(bench, monkeypatch, capsys):
    words = ["bench", "--cluster", "tcp://x:1", "--agent", "absent:Agent", "--task", "Sort4-v1"]
    monkeypatch.setattr(sys, "argv", words)
    monkeypatch.setattr(bench, "Cluster", None)
    assert bench.main() == 2
    assert "agent is absent:Agent: no module absent in this folder" in capsys.readouterr().err


def test_an_episode_that_ends_its_workers_is_named(bench):
    futures = [Future(), Future()]
    futures[0].set_result({})
    futures[1].set_exception(PlateError("several workers ended"))
    pool = Mock(submit=Mock(side_effect=futures))
    with pytest.raises(PlateError, match=r"^agent A, Sort4-v1, seed 8: several workers ended$"):
        list(bench.episodes("A", "nominal", "Sort4-v1", [7, 8], 0, pool=pool))


def test_a_slow_episode_delays_no_other_row(bench, result):
    row, futures = result["tasks"]["Sort4-v1"]["rows"][0], [Future(), Future()]
    pool = Mock(submit=Mock(side_effect=futures))
    futures[1].set_result(row | {"seed": 1})
    rows = bench.episodes("A", "nominal", "Sort4-v1", [0, 1], 0, pool=pool)
    found = []
    thread = threading.Thread(target=lambda: found.extend(row["seed"] for row in rows), daemon=True)
    thread.start()
    end = time.monotonic() + 60
    while not found and time.monotonic() < end:
        time.sleep(0.01)
    futures[0].set_result(row | {"seed": 0})
    thread.join(60)
    assert found == [1, 0]


def test_two_calls_at_once_do_not_write_one_file(bench, result, monkeypatch, tmp_path, capsys):
    place = tmp_path / "found.json"
    place.write_text(json.dumps(result), encoding="utf-8")
    words = ["--json", str(place), "--task", "Sort4-v1", "--agent", "A", "--seeds", "0:2"]
    monkeypatch.setattr(sys, "argv", ["bench", *words])
    with OwnFile(place):
        assert bench.main() == 2
    assert f"error: {place} is in use, " in capsys.readouterr().err
    assert bench.main() == 0


def test_a_result_of_other_weights_is_not_continued(bench, monkeypatch, tmp_path, capsys):
    text = LAZY.replace("print(", "open(__file__[:-7] + 'weights.npz'); print(")
    (tmp_path / "lazy.py").write_text(text, encoding="utf-8")
    (tmp_path / "weights.npz").write_bytes(b"1")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    own = bench.files("lazy:Lazy")
    assert sorted(own) == ["lazy.py", "weights.npz"]
    monkeypatch.setattr(bench, "episodes", lambda *words, **more: iter(()))
    words = ["--json", "lazy.json", "--task", "Sort4-v1", "--agent", "lazy:Lazy", "--seeds", "0"]
    monkeypatch.setattr(sys, "argv", ["bench", *words])
    row = {key: kind() for key, kind in bench.ROW.items()}
    found = {
        "agent": "lazy:Lazy", "world": "nominal", "commit": "", "sources": bench.sources(),
        "versions": bench.versions("lazy:Lazy"), "limits": {"decision_s": 60.0, "memory_gb": 4.0},
        "files": own, "tasks": {"Sort4-v1": bench.summary([row])},
    }  # fmt: skip
    (tmp_path / "lazy.json").write_text(json.dumps(found), encoding="utf-8")
    assert bench.main() == 0
    (tmp_path / "weights.npz").write_bytes(b"2")
    assert bench.main() == 2
    mark = own["weights.npz"]
    assert f"continued: file weights.npz was {mark} and is now " in capsys.readouterr().err


def test_a_summary_is_of_its_rows(bench, result, monkeypatch):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    changed = copy.deepcopy(result)
    changed["tasks"]["Sort4-v1"]["time_s"] = 1.0
    assert bench.check(changed) == ["Sort4-v1: the summary does not match its rows"]


def test_the_command_evaluates_a_user_agent(tmp_path, bench, monkeypatch):
    """An agent that does nothing gets no reward during the whole task. It runs where libraries
    compute the same on all processors."""
    monkeypatch.delenv("NPY_DISABLE_CPU_FEATURES", raising=False)
    alike = f"import os\nassert os.environ.items() >= {bench.ALIKE}.items()\n"
    (tmp_path / "lazy.py").write_text(alike + LAZY, encoding="utf-8")
    command = [
        sys.executable, "-m", "plate_gym.bench", "--agent", "lazy:Lazy", "--task", "Sort4-v1",
        "--seeds", "5", "--workers", "1", "--json", "lazy.json",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stderr == "agent: made\n"  # its output is no result
    (row,) = json.loads((tmp_path / "lazy.json").read_text())["tasks"]["Sort4-v1"]["rows"]
    assert (row["success"], row["return"], row["steps"], row["limit_share"]) == (False, 0, 1200, 0)
    assert row["time_s"] == pytest.approx(120)


def test_an_agent_that_hangs_ends_with_the_command(tmp_path):
    """Its worker, which gets no interrupt, also ends. The agent's output is no reply of the
    evaluation."""
    text = LAZY.replace("return", "os.write(1, b'the same again'); hang()  #")
    hang = """
import os, time
from pathlib import Path

def hang():
    Path("new").write_text(str(os.getpid()))
    Path("new").rename("hangs")
    time.sleep(1e6)
"""
    (tmp_path / "hanging.py").write_text(hang + text, encoding="utf-8")
    command = [
        sys.executable, "-m", "plate_gym.bench", "--agent", "hanging:Lazy", "--task", "Sort4-v1",
        "--seeds", "0:3", "--workers", "1",
    ]  # fmt: skip
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # The tests may run under `&`, where SIGINT is ignored.
    interruptible = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(command, cwd=tmp_path, preexec_fn=interruptible, **pipes) as process:
        while not (tmp_path / "hangs").exists():
            assert process.poll() is None, process.communicate()
            time.sleep(0.1)
        for _ in range(10):  # further interrupts do not disturb the end
            process.send_signal(signal.SIGINT)
            time.sleep(0.02)
        output, errors = process.communicate(timeout=60)
    assert (process.returncode, output) == (130, "")
    assert errors == "agent: madethe same again\nstopped\n"
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "hangs").read_text()), 0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"agent": "C"}, "agent is 'C', allowed: B, A, "),
        (
            {"agent": "nowhere:Agent"},
            "No module named 'nowhere'; no nowhere.py in this folder (",
        ),
        ({"tasks": ["Sort5"]}, "task is 'Sort5'"),
        ({"world": "moon"}, "world is 'moon'"),
        ({"seeds": [-1]}, "seeds are [-1], allowed: one or more different numbers, 0 or larger"),
        (
            {"seeds": [0, 0]},
            "seeds are [0, 0], allowed: one or more different numbers, 0 or larger",
        ),
        ({"seeds": iter([])}, "seeds are [], allowed: one or more"),
    ],
)
def test_wrong_names_are_refused(bench, settings, words):
    with pytest.raises(PlateError) as problem:
        bench.evaluate(**{"agent": "random", "tasks": ["Sort4-v1"], "seeds": [0], **settings})
    assert words in str(problem.value)


def ended(main):
    """Exit code of a program, from itself or from its parser."""
    try:
        return main()
    except SystemExit as end:
        return end.code


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--agent", "C"], 2, "error: agent is 'C', allowed: B, A, "),
        (["--check", "nowhere.json"], 2, "error: nowhere.json: no such file"),
        (["--trust", "a:B"], 2, "--trust requires --check"),
        (["--decision-limit", "0"], 2, "decision_s is 0, allowed: 0.1 to 1e+06"),
        (["--json", "fifo"], 2, "error: [Errno 6] No such device or address: 'fifo'"),
        (["--check", "text.json"], 2, "error: text.json is not JSON: "),
        (["--check", "deep.json"], 2, "error: deep.json is not JSON: "),
        (["--check", "long.json"], 2, "error: long.json is not JSON: "),
        (["--check", "empty.json"], 2, "error: result has , allowed: agent, world, "),
        (["--check", "false.json", "--json", "x"], 2, "--json is given with --check"),
        (
            ["--check", "false.json", "--seeds", "3", "--agent", "A"],
            2,
            "--agent, --seeds is given with --check",
        ),
        (["--fresh", "3"], 2, "--fresh is 3, allowed: 1 to 100000, together with --check"),
        (["--check", "false.json", "--world", "latency"], 2, "--world is given with --check"),
        (["--check", "false.json", "--fresh", "1", "--world", "moon"], 2, "world is 'moon'"),
        (["--workers", "0"], 2, "--workers is 0, allowed: 1 or more"),
        (["--workers", "2", "--cluster", "tcp://x:1"], 2, "--workers is given with --cluster"),
        (["--json", "nowhere/x.json"], 2, "error: [Errno 2] No such file"),
        (
            ["--check", "false.json"],
            1,
            "Sort4-v1, seed 0: dropped is 1 in the result, 0 here",
        ),
        (["--seeds", "5:1"], 2, "is '5:1', allowed: FIRST:END"),
        (["--seeds", f"0:{10**20}"], 2, "allowed: FIRST:END, at most 100000 of them"),
    ],
)
def test_the_command_reports_errors(
    bench, result, words, code, message, tmp_path, monkeypatch, capsys
):
    rows = {row["seed"]: row for row in result["tasks"]["Sort4-v1"]["rows"]}
    monkeypatch.setattr(bench, "episode", lambda agent, world, task, seed: rows[seed])
    in_this_process(bench, monkeypatch)
    false = copy.deepcopy(result)
    false["tasks"]["Sort4-v1"]["rows"][0]["dropped"] = 1
    files = {"text": "...", "empty": "{}", "deep": "[" * 100_000, "long": "9" * 5000}
    for name, text in (files | {"false": json.dumps(false)}).items():
        (tmp_path / f"{name}.json").write_text(text, encoding="utf-8")
    os.mkfifo(tmp_path / "fifo")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["bench", *words])
    assert ended(bench.main) == code
    output = capsys.readouterr()
    assert message in output.out + output.err


def test_the_speed_of_each_size_is_reported(monkeypatch, capsys):
    from plate_gym import speed

    for name in ("CYCLES", "MANY"):
        monkeypatch.setattr(speed, name, 2)
    monkeypatch.setattr(speed, "TASKS", ("Sort4-v1",))
    monkeypatch.setattr(sys, "argv", ["speed"])
    assert speed.main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[1:3]] == [["Sort4-v1", "1"], ["Sort4-v1", "2"]]
    assert all(float(number) > 0 for line in lines[1:] for number in line.split()[3:])
