"""Results in benchmarks/ are results, of agents that are here; the leaderboard is made of them."""

import json
from pathlib import Path

import pytest

from plate_core import PlateError

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "benchmarks").glob("*"))

pytestmark = pytest.mark.needs("gymnasium")


def test_the_page_is_made_of_the_results():
    import leaderboard

    assert leaderboard.PAGE.read_text(encoding="utf-8") == leaderboard.page()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_result_is_well_formed_and_summed_up_as_its_rows_are(path):
    from plate_gym import TASKS
    from plate_gym.agents import AGENTS
    from plate_gym.result import summary, validate

    assert path.suffix == ".json"
    result = json.loads(path.read_text(encoding="utf-8"))
    validate(result)
    assert set(result["tasks"]) <= set(TASKS)
    for found in result["tasks"].values():
        assert json.loads(json.dumps(summary(found["rows"]))) == found
    module, _, name = result["agent"].partition(":")
    own = ROOT / f"examples/agents/{module}.py"
    assert result["agent"] in AGENTS or f"class {name}" in own.read_text(encoding="utf-8")


def test_better_and_faster_agents_come_first(tmp_path):
    import leaderboard

    from plate_gym.result import ROW, summary

    def result(agent, successes, time_s):
        rows = [
            {key: kind() for key, kind in ROW.items()}
            | {"seed": seed, "success": seed < successes, "time_s": time_s, "error_mm": 2.5}
            for seed in range(20)
        ]
        head = {"world": "nominal", "commit": "1a3f93", "sources": "", "versions": {}}
        return head | {"agent": agent, "tasks": {"Sort4-v1": summary(rows)}}

    for agent, successes, time_s in (("slow", 20, 9.0), ("bad", 1, 1.0), ("fast", 20, 5.0)):
        text = json.dumps(result(agent, successes, time_s))
        (tmp_path / f"{agent}.json").write_text(text, encoding="utf-8")
    lines = [line for line in leaderboard.tables(tmp_path).splitlines() if line.startswith("| [")]
    assert [line.split("]")[0] for line in lines] == ["| [fast", "| [slow", "| [bad"]
    assert lines[0] == ("| [fast](../../benchmarks/fast.json) | 20/20 | 5.0 | 2.5 | 0 |")
    assert "| 1/20 (1-24 %) | 1.0 |" in lines[2]
    (tmp_path / "none.json").write_text(json.dumps(result("none", 0, 9.0)), encoding="utf-8")
    failed = "\n\nNo completed episode: none: [nominal](../../benchmarks/none.json).\n"
    assert failed in leaderboard.tables(tmp_path)
    forged = result("slow", 20, 9.0)
    forged["tasks"]["Sort4-v1"] = {"rows": forged["tasks"]["Sort4-v1"]["rows"], "success": 9.0}
    (tmp_path / "slow.json").write_text(json.dumps(forged), encoding="utf-8")
    assert lines[1] in leaderboard.tables(tmp_path).splitlines()  # the contents of a row
    few = result("slow", 20, 9.0)
    del few["tasks"]["Sort4-v1"]["rows"][3]
    for text, words in (
        ("{", r"slow\.json is not JSON"),
        ("{}", r"slow\.json: result has , allow"),
        (
            json.dumps(few),
            r"slow\.json: Sort4-v1: seeds are 0:3, 4:20, allowed: 0, 1, 2, .* at least 20 seeds",
        ),
    ):
        (tmp_path / "slow.json").write_text(text, encoding="utf-8")
        with pytest.raises(PlateError, match=words):
            leaderboard.tables(tmp_path)


@pytest.mark.parametrize("task", ["Sort4-v1", "Sort10-v1"])
def test_the_network_that_has_learned_sorts(monkeypatch, task):
    """From starts that it has never seen: training draws other ones, and judges other seeds."""
    from plate_gym.episode import episode

    monkeypatch.syspath_prepend(ROOT / "examples/agents")
    rows = [episode("learned:Learned", "nominal", task, seed) for seed in (1000, 1001, 1002)]
    assert sum(row["success"] for row in rows) >= 2
    assert max(row["limit_share"] for row in rows) <= 1
