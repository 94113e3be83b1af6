"""Tasks and simulated worlds of the benchmark. The definition of a task never changes. If a value
must change, a new task with the version `-v2` is added."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from typing import TypeVar

import yaml

from plate_core import PlateError, Rig, config_path, did_you_mean, load_rig
from plate_core.tasks import FeedTask, Scenario, load_scenario
from plate_sim.world import NONE, Disturbances

Value = TypeVar("Value")


@dataclass(frozen=True)
class World:
    """Differences between the simulated world and the rig file.

    Attributes
    ----------
    disturbances : Disturbances
    mu_scale : float
        True friction divided by the friction in the rig file.
    """

    disturbances: Disturbances = NONE
    mu_scale: float = 1.0


WORLDS = {
    "nominal": World(),
    "friction": World(Disturbances(friction_spread=0.2, friction_patches=0.2)),
    "latency": World(Disturbances(latency=0.05)),
    "misses": World(Disturbances(missed_parts=0.03, false_parts=0.03)),
    "held_out": World(
        Disturbances(
            friction_spread=0.15, friction_patches=0.15, static_ratio=1.2, tilt_x=0.005,
            latency=0.03, missed_images=0.01, missed_parts=0.01, false_parts=0.01,
        ),
        mu_scale=0.9,
    ),
}  # fmt: skip
"""Simulated worlds by name. The nominal world agrees with the rig file. Three worlds have
disturbances. The world `held_out` is intended for evaluations with random seeds."""

TASKS = {
    "Sort4-v1": ("sort_4", "996659cd0c19052a"),
    "Sort10-v1": ("sort_10", "09cb7551aee2010d"),
    "Sort24-v1": ("sort_24", "1d28d949ef2a00f9"),
    "Sort50-v1": ("sort_50", "fa30dcf2a7f9bb94"),
    "Corners12-v1": ("sort_corners_12", "fa48fddb4a4d15aa"),
    "Assemble8-v1": ("assemble_8", "24a6a1dd24bb45ac"),
    "AlignBars-v1": ("align_6", "b0ee32c9dc902b4f"),
    "Letters-v1": ("assemble_letters", "0f64101d3c9a5865"),
    "Follow1-v1": ("follow_1", "975827ce93056271"),
    "Follow2-v1": ("follow_2", "6c1f8071b3c1583c"),
    "Follow5-v1": ("follow_5", "2fb08bd80f644f14"),
    "Feed-v1": ("feed", "4004538ca1f5638b"),
}
"""Scenario of each task, and a digest of the files that define the task. The files of a task are
the scenario file, the rig file, and the file of part types that the rig file names."""


FEED_S = 60.0
"""Duration of a feed task [s]. A feed task does not end earlier."""


def scenario_of(task: str) -> tuple[Scenario, Rig]:
    """Return the scenario and the rig of a task.

    Raises
    ------
    PlateError
        If there is no such task.
    """
    scenario = load_scenario(chosen("task", task, TASKS)[0])
    if isinstance(scenario.task, FeedTask):
        scenario = replace(scenario, time_limit_s=FEED_S)
    return scenario, load_rig(scenario.rig)


def chosen(name: str, key: str, among: dict[str, Value]) -> Value:
    """Return the value of the key `key` in the dict `among`. `name` describes the key in the error
    message.

    Raises
    ------
    PlateError
        If the key is unknown. The message lists the allowed keys.
    """
    if key not in among:
        raise PlateError(
            f"{name} is {key!r}{did_you_mean(key, among)}, allowed: {', '.join(among)}"
        )
    return among[key]


def digest(scenario: str) -> str:
    """Return a digest of the contents of a scenario file, its rig file, and the rig's file of part
    types. Comments in the files and the scenario's description do not change the digest."""
    path = config_path("scenarios") / f"{scenario}.yaml"
    contents = [yaml.safe_load(path.read_text("utf-8"))]
    contents[0].pop("description", None)
    path = config_path(f"rigs/{contents[0]['rig']}.yaml" if "rig" in contents[0] else "rig.yaml")
    contents.append(yaml.safe_load(path.read_text("utf-8")))
    if "types" in contents[1]:
        types = path.parent / contents[1]["types"]
        contents.append(yaml.safe_load(types.read_text("utf-8")))
    return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()[:16]
