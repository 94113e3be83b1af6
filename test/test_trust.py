"""Accuracy of the simulator: the tests that the page names exist, and its estimates are those of
the code."""

import ast
import re
from pathlib import Path

from plate_core import load_rig
from stages.trust import PROJECT, RIDES, creep_rows, neglected_effects

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/guide/trust.md").read_text(encoding="utf-8")


def test_every_test_that_the_page_names_is_there():
    named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", PAGE)
    assert len(named) > 15
    for file, name in named:
        source = (ROOT / "src/plate_sim/test" / file).read_text(encoding="utf-8")
        assert name in {getattr(node, "name", "") for node in ast.parse(source).body}, name


def test_the_estimates_on_the_page_are_those_of_the_rig():
    columns = ("effect", "formula", "assumed", "size")
    for row in neglected_effects(load_rig()):
        cells = r"\s*\|\s*".join(re.escape(row[key]) for key in columns)
        assert re.search(cells, PAGE), row


def test_parts_that_friction_holds_do_not_creep():
    rows = creep_rows(PROJECT, 1.0)
    assert len(rows) == 3
    assert max(row[scene] for row in rows for scene in RIDES) < 1e-9
