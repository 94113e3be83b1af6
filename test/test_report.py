"""The charts: Pareto fronts, tables, pictures, and a report that refers to nothing outside."""

import csv
import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from harness import is_done

BENCH = Path(__file__).resolve().parents[1] / "bench"

QUICK = "force_map"

pytestmark = pytest.mark.needs("plotly", "kaleido", "pandas", "tabulate", "numba")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Folder of a quick measurement and its chart."""
    out = tmp_path_factory.mktemp("charts")
    for arguments in (
        ["run.py", QUICK, "--quick", "--out", out / "bench"],
        ["charts.py", "--draw", "--quick", "--out", out],
    ):
        done = subprocess.run(
            [sys.executable, str(BENCH / arguments[0]), *map(str, arguments[1:])],
            capture_output=True, text=True, timeout=200, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def chart():
    """A chart with a panel of every kind: points and a front, names, a field with a line on it."""
    from report.axis import Axis
    from report.chart import Chart, Sheet
    from report.panels import Panels, Style

    x, y, panels = Axis("x [m]", log=True), Axis("y [s]"), Panels()
    first = panels.add("points", x, y, "less less")
    some = [{"x": 1.0, "y": 3.0}, {"x": 10.0, "y": None}, {"x": 100.0, "y": 1.0}]
    first.points(some, "x", "y", Style("some", marker="D", line="--"))
    first.rule("wanted", x=20.0)
    first.rule("limit", y=2.0)
    first.mark(1.0, 3.0)
    names = panels.add("names", y, Axis("", names=("b", "a")))
    names.points([{"x": 1.0, "y": "a"}, {"x": 2.0, "y": "b"}], "x", "y", Style("named"))
    field = panels.add("field", y, y)
    field.heat([1.0, 2.0, 3.0], [2.0, 5.0], [[0.0, 0.5, None], [0.1, 0.9, 1.0]], "success", (0, 1))
    theory = [{"x": 1.0, "y": 2.0}, {"x": 3.0, "y": 5.0}]
    field.points(theory, "x", "y", Style("theory", marker="", line="-"), in_front=False)
    sheet = Sheet([{"x": 1}])
    return Chart("one", "a", "Title </script>", "reading", "finding", "why", panels, sheet)


class References(HTMLParser):
    """Collects the files and links of a page."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        self.found += [value for name, value in attrs if name in ("src", "href", "data") and value]


@pytest.mark.filterwarnings("ignore:setDaemon", "ignore:unclosed file")  # kaleido's own
def test_every_kind_of_panel_is_drawn_as_a_picture(chart, tmp_path):
    chart.panels.draw().write_image(tmp_path / "one.png")
    with Image.open(tmp_path / "one.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    assert len(np.unique(pixels, axis=0)) > 200  # colours of a field, not a blank sheet


def test_the_report_refers_to_nothing_outside(drawn):
    parser = References()
    parser.feed((drawn / "report/index.html").read_text(encoding="utf-8"))
    assert any(value.startswith("data:text/csv") for value in parser.found)
    assert [v for v in parser.found if not v.startswith(("#", "data:"))] == []


def test_every_chart_has_a_picture_and_its_rows(drawn):
    text = (drawn / "docs/results.md").read_text(encoding="utf-8")
    pictures = re.findall(r"!\[[^]]*\]\((results/(\w+)\.png)\)", text)
    assert [name for _, name in pictures] == [QUICK]
    for path, name in pictures:
        assert (drawn / "docs" / path).stat().st_size > 5000
        with (drawn / f"docs/results/{name}.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        data = json.loads((drawn / f"bench/{name}.json").read_text(encoding="utf-8"))
        methods = {row["method"] for table in data["tables"] for row in table["rows"]}
        assert len(rows) >= 5
        assert {row["method"] for row in rows} <= methods


def test_a_measurement_that_is_there_is_not_made_again(drawn):
    assert is_done(drawn / "bench", QUICK, quick=True)
    assert not is_done(drawn / "bench", QUICK, quick=False)
    assert not is_done(drawn / "bench", "sim", quick=True)
    path = drawn / f"bench/{QUICK}.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(data | {"code": "of another day"}), encoding="utf-8")
    assert not is_done(drawn / "bench", QUICK, quick=True)
    path.write_text(json.dumps(data), encoding="utf-8")


@pytest.mark.filterwarnings("ignore:setDaemon", "ignore:unclosed file")  # kaleido's own
def test_charts_are_drawn_from_their_csv_files_where_nothing_is_measured(
    drawn, tmp_path, monkeypatch, capfd
):
    """As on a fresh clone: the same text and CSV files; charts that cannot be drawn are
    reported."""
    import charts

    shutil.copytree(drawn / "docs", tmp_path / "docs")
    (tmp_path / "docs/results.md").unlink()
    (tmp_path / "docs/results/sim.csv").write_text("of,older,code\n1,2,3\n")
    words = ["charts.py", "--draw", "--quick", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    assert charts.main() == 0
    for name in ("results.md", f"results/{QUICK}.csv", "results/measured.json"):
        assert (tmp_path / "docs" / name).read_text() == (drawn / "docs" / name).read_text()
    output = capfd.readouterr().err
    assert "chart sim is omitted: its stored rows have no column 'case'" in output
    assert "chart vision is omitted: " in output
    assert f" from {tmp_path / 'docs/results'}: {QUICK}\n" in output


def test_charts_of_uncommitted_code_are_not_published(monkeypatch, capsys):
    import charts

    monkeypatch.setattr(sys, "argv", ["charts.py"])
    monkeypatch.setattr(charts, "commit", lambda: "abc-dirty")
    monkeypatch.setattr(charts, "is_done", lambda *_: False)
    assert charts.main() == 1
    assert "the commit is abc-dirty, " in capsys.readouterr().err


def test_rows_come_back_from_a_csv_file_as_they_were(tmp_path):
    from report.chart import Sheet

    rows = [{"a": 1, "b": 2.5e-9, "c": None}, {"c": True, "a": '(3), "x"', "d": "1 ms"}]
    sheet = Sheet.of(rows, {"c": "C [m]"})
    (tmp_path / "one.csv").write_text(sheet.csv)
    assert Sheet.read(tmp_path / "one.csv", {"c": "C [m]"}) == sheet
    assert [list(row) for row in sheet.rows] == [["c", "a", "b", "d"]] * 2


@pytest.mark.parametrize("span", [0.02, 0.3, 0.9, 1.7, 3.2, 6.5, 14.0])
@pytest.mark.parametrize("low", [-11.3, -0.05, 2.7])
def test_every_log_axis_has_some_numbers_and_not_too_many(low, span):
    from report.axis import log_ticks, tick_texts

    ticks = log_ticks(low, low + span)
    assert 3 <= len(ticks) <= 10
    assert np.all(np.diff(ticks) > 0)
    assert low <= np.log10(ticks[0]) < np.log10(ticks[-1]) <= low + span
    assert len(set(tick_texts(ticks))) == len(ticks)


def front_of(better, *places):
    from report.panels import pareto_front

    return pareto_front(places, better)


def test_the_pareto_front_is_a_staircase():
    places = [(1, 5), (2, 2), (3, 3), (4, 1), (4, 2)]
    assert front_of("less less", *places) == [(1, 5), (2, 5), (2, 2), (4, 2), (4, 1)]
    assert front_of("more less", *places) == [(4, 1)]
    assert front_of("", *places) == []


def test_the_pareto_front_ignores_hollow_points():
    from report.axis import Axis
    from report.panels import Panels, Style

    panel = Panels().add("", Axis(""), Axis(""), "less less")
    rows = [{"x": 1, "y": 1}, {"x": 2, "y": 3}, {"x": 3, "y": 2}]
    panel.points(rows, "x", "y", Style(""), hollow=lambda row: row["x"] == 1)
    [front] = panel.front()
    assert list(zip(front.x, front.y, strict=True)) == [(2, 3), (3, 3), (3, 2)]


def test_tables_of_documents_are_of_their_measurements(tmp_path):
    from harness import LONG, MEASUREMENTS
    from report.documents import DOCUMENTS, fill_documents, names

    assert not [name for name in names() if name not in MEASUREMENTS or name in LONG]
    for name in DOCUMENTS:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("nothing here\n", encoding="utf-8")
    guide = "before\n<!-- measured: rigs by_rig -->\nold\n<!-- end -->\n"
    guide += "- <!-- measured: rigs summary -->\n<!-- end --><!-- measured: sim a -->x<!-- end -->"
    (tmp_path / DOCUMENTS[0]).write_text(guide, encoding="utf-8")
    one = {"key": "by_rig", "columns": {"rig": "rig", "n": "runs"}, "note": "Three seeds."}
    data = {
        "rigs": {"tables": [one | {"rows": [{"rig": "desk", "n": 3}]}], "summary": ["all well"]}
    }
    facts = {"rigs": {"seconds": 7, "commit": "abc", "machine": {"load": 0.5}}}
    fill_documents(data, facts | {"sim": {"commit": "def"}}, tmp_path)
    text = (tmp_path / DOCUMENTS[0]).read_text(encoding="utf-8")
    assert re.search(r"before\n<!-- measured: rigs by_rig -->\n\| rig *\| runs *\|\n", text)
    assert re.search(r"\| desk *\| 3 *\|", text)
    assert "old" not in text
    note = "*Three seeds. `make bench ARGS=rigs` repeats the measurement"
    assert f"{note} (7 s, commit abc, load 0.5).*" in text
    assert "- all well\n" in text
    assert text.endswith("<!-- measured: sim a -->x<!-- end -->")
    fill_documents(data, facts, tmp_path)  # where all are of one commit docs/results.md names it
    assert "(7 s, load 0.5)" in (tmp_path / DOCUMENTS[0]).read_text(encoding="utf-8")
