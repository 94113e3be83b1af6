"""The guide of the feeder agrees with the feeder."""

from pathlib import Path

import pytest

from plate_core import ScenarioError
from plate_core.tasks import FeedTask, load_scenario
from plate_feeder import Code, load_hand_eye

ROOT = Path(__file__).resolve().parents[1]
GUIDE = (ROOT / "docs/guide/feeder.md").read_text(encoding="utf-8")
YAML = [block.split("```")[0] for block in GUIDE.split("```yaml\n")[1:]]


def test_the_table_of_codes():
    rows = [line for line in GUIDE.splitlines() if line.startswith(("| 2", "| 4", "| 5"))]
    assert [int(row.split("|")[1]) for row in rows] == list(Code)


def test_the_recipe_of_the_guide_is_valid(tmp_path):
    path = tmp_path / "recipe.yaml"
    path.write_text(YAML[0])
    assert isinstance(load_scenario(path).task, FeedTask)
    path.write_text(YAML[0].replace("clearance_m", "clearance"))
    with pytest.raises(ScenarioError, match="clearance_m"):
        load_scenario(path)


def test_the_hand_eye_file_of_the_guide_is_valid(tmp_path):
    path = tmp_path / "hand_eye.yaml"
    path.write_text(YAML[1])
    assert load_hand_eye(path).frame == "robot_base"
