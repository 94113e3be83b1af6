"""The notebook runs, and prints what the page docs/how_it_works.md shows."""

import json
import re

import how_it_works
import pytest
from shown_text import differs

PAGE = (how_it_works.DOCS / "how_it_works.md").read_text(encoding="utf-8")
PICTURE = re.compile(r"!\[[^\]]+\]\(how_it_works/(\w+)\.png\)")


@pytest.fixture(name="told", scope="module")
def _told():
    printed, figures = how_it_works.run(how_it_works.code_cells(how_it_works.NOTEBOOK))
    yield printed, list(figures)
    how_it_works.plt.close("all")


def test_the_page_shows_what_the_notebook_prints(told):
    blocks = re.findall(r"^```text\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 5
    assert not differs("...\n" + "\n...\n".join(blocks) + "\n...", told[0])


def test_the_cycle_map_leaves_little_to_be_missed(told):
    missed = re.search(r"^cycle map: (\d+) %", told[0], re.MULTILINE)
    assert int(missed[1]) < 5


def test_the_pictures_of_the_page_are_those_of_the_notebook(told):
    shown = PICTURE.findall(PAGE)
    assert shown == told[1]
    assert all((how_it_works.DOCS / "how_it_works" / f"{name}.png").is_file() for name in shown)


def test_no_outputs_are_kept_in_the_notebook():
    cells = json.loads(how_it_works.NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(code) > 8
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
