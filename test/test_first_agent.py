"""The notebook docs/first_agent.ipynb runs, and its agent does its task."""

import json
import re

import how_it_works
import pytest

NOTEBOOK = how_it_works.DOCS / "first_agent.ipynb"


@pytest.mark.needs("gymnasium")
def test_the_first_agent_sorts(monkeypatch):
    from plate_gym.agents import AGENTS

    monkeypatch.setitem(AGENTS, "mine", None)  # forgotten at the end
    printed, figures = how_it_works.run(how_it_works.code_cells(NOTEBOOK))
    how_it_works.plt.close("all")
    assert re.search(r"^done: True in (\d+\.\d) s", printed, re.MULTILINE)
    done = dict(re.findall(r"^(\w+) +done +(\d+) %", printed, re.MULTILINE))
    assert done == {"mine": "100", "B": "100"}
    assert list(figures) == ["first_agent"]


def test_the_notebook_contains_no_outputs():
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
