"""The layouts for RViz and Foxglove show topics that our nodes publish."""

import json
import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PUBLISHER = re.compile(r'(?:create|managed)_(?:lifecycle_)?publisher\(\s*\w+,\s*"(\w+)"')
PUBLISHED = {
    name
    for pattern in ("src/*/plate_*/node.py", "src/plate_core/plate_core/ros/*.py")
    for path in ROOT.glob(pattern)
    for name in PUBLISHER.findall(path.read_text("utf-8"))
}


def rviz():
    view = yaml.safe_load((ROOT / "config/plate.rviz").read_text("utf-8"))["Visualization Manager"]
    assert view["Global Options"]["Fixed Frame"] == "plate_home"
    return [display["Topic"]["Value"] for display in view["Displays"]]


def foxglove():
    text = (ROOT / "config/foxglove.json").read_text("utf-8")
    view = json.loads(text)
    assert sorted(re.findall(r'"(\w+!\w+)": {', text)) == sorted(view["configById"])
    shown = re.findall(r'"(\w+!\w+)"(?!:)', json.dumps(view["layout"]))
    assert sorted(shown) == sorted(view["configById"])
    return re.findall(r'"/(\w+)', text)


@pytest.mark.parametrize("topics", [rviz, foxglove])
def test_every_topic_is_published(topics):
    shown = topics()
    assert len(shown) >= 3
    assert set(shown) <= PUBLISHED
