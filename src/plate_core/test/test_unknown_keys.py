"""A key that no reader knows is refused by name, however deep it stands, in every kind of file."""

import pytest
import yaml

from plate_core import PlateError, config_path, load_rig
from plate_core.rig.part_types import load_part_types
from plate_core.tasks import load_scenario

STRAY = "stray"
MOVE = {
    "parts": [{"class": "black", "count": 1}],
    "task": {
        "kind": "move",
        "targets": [{"id": "black_1", "place_m": [0.1, 0], "angle_deg": 10}],
    },
    "time_limit_s": 10,
}
MARKERS = {
    "dictionary": "4X4_50",
    "side_m": 0.03,
    "centre_m": {
        "marker_0": [-0.28, -0.13], "marker_1": [0.28, -0.13], "marker_2": [0.28, 0.13],
        "marker_3": [-0.28, 0.13],
    },
}  # fmt: skip
SERVO = {"stiffness_npm": 1e4, "damping_nspm": 10}


def mappings(data, path=()):
    """Yield the keys that lead to each mapping of a document."""
    if isinstance(data, dict):
        yield path
    children = data.items() if isinstance(data, dict) else enumerate(data)
    for key, child in children:
        if isinstance(child, dict | list):
            yield from mappings(child, (*path, key))


def kind(path):
    return tuple("*" if isinstance(key, int) else key for key in path)


def cases():
    """Files with one mapping of each path, and a loader."""
    folder = config_path("rig.yaml").parent
    files = [(path, load_scenario) for path in sorted(folder.glob("scenarios/*.yaml"))]
    files += [(path, load_rig) for path in [folder / "rig.yaml", *sorted(folder.glob("rigs/*"))]]
    files += [(folder / "parts.yaml", load_part_types)]
    documents = [(path.name, yaml.safe_load(path.read_text()), load) for path, load in files]
    desk = yaml.safe_load((folder / "rigs" / "desk.yaml").read_text())
    desk["suspension"]["servo"] = SERVO
    documents += [
        ("move.yaml", MOVE, load_scenario), ("full.yaml", {**desk, "fiducials": MARKERS}, load_rig)
    ]  # fmt: skip
    seen = set()
    for name, data, load in documents:
        task = data["task"]["kind"] if "task" in data else ""
        for path in mappings(data):
            if (load, task, kind(path)) not in seen:
                seen.add((load, task, kind(path)))
                yield pytest.param(data, load, path, id=f"{name}:{'.'.join(map(str, path))}")


@pytest.mark.parametrize(("data", "load", "path"), [*cases()])
def test_an_unknown_key_is_named(data, load, path, tmp_path):
    data = yaml.safe_load(yaml.safe_dump(data))
    inner = data
    for key in path:
        inner = inner[key]
    inner[STRAY] = 1
    file = tmp_path / "own.yaml"
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(PlateError, match=STRAY):
        load(str(file))
