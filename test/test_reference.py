"""The reference of keys: the page agrees with the code, and the code with its descriptions."""

import re
from collections import defaultdict
from pathlib import Path

import pytest
import yaml
from reference import PAGE, page

from plate_core import PlateError, load_rig, rig, tasks
from plate_core.tasks import load_scenario
from plate_core.yaml_fields import Fields, Number, Numbers, Whole
from plate_sim.camera import part_greys
from plate_vision import CLASSES

ROOT = Path(__file__).resolve().parents[1]

RIG = yaml.safe_load((ROOT / "config/rig.yaml").read_text("utf-8")) | {
    "fiducials": {
        "dictionary": "4X4_50",
        "side_m": 0.03,
        "centre_m": {
            f"marker_{k}": [0.28 * x, 0.13 * y]
            for k, (x, y) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        },
    },
    "suspension": {
        "frequency_hz": [35, 35, 35],
        "damping_ratio": [0.03, 0.03, 0.03],
        "inertia_kgm2": 0.075,
        "centre_of_mass_m": [0, 0],
        "feedforward": {"mass": 0, "damping": 0, "stiffness": 1},
        "motor_gain": [1.15, 0.85, 1.15, 0.85],
        "motor_bandwidth_hz": 200,
    },
}
RIG["types"] = {
    "nut": {
        "outline_m": [[0.01, 0], [0, 0.01], [-0.01, 0], [0, -0.01]],
        "holes_m": [[[0.004, 0], [0, 0.004], [-0.004, 0], [0, -0.004]]],
        "mass_kg": 0.01,
        "mu": 0.25,
        "colour_lab": [50, 0, 0],
        "symmetry": 4,
        "scatter_m": 0.0001,
        "height_m": 0.005,
        "picture": "nut.png",
    },
    "coin": {"radius_m": 0.01, "symmetry": 0},
}
for node, motor in enumerate(RIG["motors"].values(), 1):
    motor |= {"drive": "cia402", "node": node, "counts_per_m": 1e6, "sign": -1}
    motor |= {"home": "absolute", "serial": 700 + node}
ODRIVES = {
    name: {key: motor[key] for key in motor if key not in ("counts_per_m", "serial")}
    | {"drive": "odrive", "turns_per_m": 25}
    for name, motor in RIG["motors"].items()
}
RIG["camera"]["colour"] = True
RIG["camera"]["height_m"] = 0.9
RIG["parts"]["height_m"] = 0.005
RIG["camera"] |= {"trigger_phase": 0.5, "trigger_pulse_s": 0.002}
CIRCLE = {"centre_m": [0, 0], "radius_m": 0.1, "start_deg": 0, "turn": "left"}
TASKS = {
    "sort": {
        "regions": {"black": "left", "grey": {"bin_m": [[0.1, 0], [0.2, 0], [0.2, 0.1]]}},
        "goal_fraction": 0.6,
        "hold_s": 0.5,
    },
    "follow": {
        "max_error_m": 0.01,
        "paths": [
            {"class": "black", "circle": CIRCLE, "speed_mps": 0.01, "laps": 1},
            {"class": "grey", "waypoints_m": [[0, 0], [1, 0]], "speed_mps": 0.01, "closed": False},
        ],
    },
    "assemble": {
        "places_m": {"black": [[0, 0]], "grey": [[0.1, 0]]},
        "tolerance_m": 0.003,
        "hold_s": 1,
    },
    "pose": {
        "poses": [
            {"class": "black", "angle_deg": 90, "place_m": [0.1, 0]},
            {"class": "grey", "angle_deg": 90},
        ],
        "tolerance_m": 0.003,
        "tolerance_deg": 3,
        "hold_s": 1,
    },
    "move": {
        "targets": [{"id": "black_1", "place_m": [0.1, 0], "angle_deg": 90}],
        "tolerance_m": 0.003,
        "tolerance_deg": 3,
        "hold_s": 1,
    },
    "feed": {
        "picks": [
            {
                "class": "black",
                "ready": 2,
                "window_m": [[0, 0], [0.1, 0.1]],
                "angle_deg": 90,
                "tolerance_deg": 5,
            },
        ],
        "clearance_m": 0.006,
        "chute": "left",
        "hopper": {
            "fill": 9,
            "least": 8,
            "rate_ps": 10,
            "place_m": [0, 0],
            "spread_m": 0.05,
            "mix": {"black": 0.5, "grey": 0.5},
        },
        "timeout_s": 30,
        "valid_s": 10,
    },
}


def scenario(kind):
    parts = [{"class": "black", "count": 1}, {"class": "grey", "positions_m": [[0.1, 0]]}]
    return {
        "description": "d",
        "rig": "desk",
        "marked": True,
        "parts": parts,
        "task": {"kind": kind, **TASKS[kind]},
        "time_limit_s": 60,
    }


FILES = [(load_rig, RIG), (load_rig, RIG | {"motors": ODRIVES})] + [
    (load_scenario, scenario(kind)) for kind in TASKS
]


def places(data):
    """All mappings of a file, at any depth."""
    if isinstance(data, dict):
        yield data
        for value in data.values():
            yield from places(value)
    if isinstance(data, list):
        for value in data:
            yield from places(value)


def refused(read, path, data):
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(PlateError) as caught:
        read(path)
    return str(caught.value)


def cases():
    """Every number, with a value out of its range, in every file that has it."""
    for section in (*rig.SECTIONS, *tasks.SECTIONS):
        for key in section.keys:
            if isinstance(key.kind, Number | Whole | Numbers):
                yield pytest.param(section, key, id=f"{section.where}: {key.name}")


def test_classes_are_those_that_detector_and_simulator_know():
    assert tasks.CLASSES == CLASSES
    assert len(set(part_greys(list(tasks.CLASSES)))) == len(CLASSES)


@pytest.mark.parametrize(("section", "key"), list(cases()))
def test_a_value_out_of_range_is_refused_with_key_and_range(tmp_path, section, key):
    tried = 0
    for read, data in FILES:
        for place in places(data):
            known = {each.name for each in section.keys}
            if key.name not in place or not set(place) <= known | {"kind", "sides"}:
                continue
            before = place[key.name]
            for value in (1.0001 * key.kind.high + 1, key.kind.low - 1e-5):
                wrong = value
                if isinstance(key.kind, Whole):
                    wrong = key.kind.high + 1 if value > key.kind.high else key.kind.low - 1
                if isinstance(key.kind, Numbers):
                    wrong = [value] * len(before)
                    if isinstance(before[0], list):
                        wrong = [[value] * len(row) for row in before]
                place[key.name] = wrong
                try:
                    message = refused(read, tmp_path / "file.yaml", data)
                finally:
                    place[key.name] = before
                assert f"{key.name} is " in message
                form = "" if isinstance(key.kind, Whole) else "g"
                assert f"{key.kind.low:{form}} to {key.kind.high:{form}}" in message
                tried += 1
    if key.name not in ("stiffness", "damping", "spline_m"):  # in place of others, none here
        assert tried >= 2


@pytest.fixture(name="asked")
def _asked(monkeypatch):
    """Keys that the readers ask for, by their place in the file: without its name and numbers."""
    requested, finish = defaultdict(set), Fields.finish

    def noting(fields):
        place = re.sub(r"\[\d+\]", "[]", fields.where).partition(": ")[2]
        requested[place] |= fields._used
        finish(fields)

    monkeypatch.setattr(Fields, "finish", noting)
    return requested


PLACES = {
    "": ["scenario file"],
    "parts[]": ["parts[]"],
    "task: regions: grey": ["task, kind: sort, a polygon in regions"],
    "task: paths[]": ["task, kind: follow, paths[]"],
    "task: paths[]: circle": ["task, kind: follow, paths[], circle"],
    "task: poses[]": ["task, kind: pose, poses[]"],
    "task: targets[]": ["task, kind: move, targets[]"],
    "task: picks[]": ["task, kind: feed, picks[]"],
    "task: hopper": ["task, kind: feed, hopper"],
}
"""Sections of a scenario file by places in it."""

NAMED = ("regions", "places_m", "motors", "fiducials: centre_m", "types", "mix")
"""Places whose keys are names of classes, types, motors or markers."""


def known_at(sections, place, heads):
    """Names of keys that the reference has for a place, by the heads of its sections."""
    if place.endswith(("feedforward", "servo")):  # their keys stand in the words of the table
        table = sections["suspension"][place.rpartition(": ")[2]]
        return set(
            re.findall(r"\b(mass|damping|stiffness|\w+_npm|\w+_nspm)\b", table.kind.description)
        )
    return {key.name for head in heads for key in sections[head].keys}


@pytest.mark.parametrize("kind", TASKS)
def test_requirements_on_a_scenario_file_agree_with_the_reference(tmp_path, asked, kind):
    sections = {section.where: section for section in tasks.SECTIONS}
    path = tmp_path / "file.yaml"
    path.write_text(yaml.safe_dump(scenario(kind)))
    load_scenario(path)
    here = PLACES | {"task": ["task", f"task, kind: {kind}"]}
    for place, names in asked.items():
        if place.endswith(NAMED):
            continue
        known = known_at(sections, place, here[place])
        if place == "task" and kind == "sort":
            assert "`sides`" in sections["task, kind: sort"]["regions"].meaning
            known.add("sides")
        assert names == known, place


def test_requirements_on_a_rig_file_agree_with_the_reference(tmp_path, asked):
    sections = {re.split(r"[ ,]", section.where)[0]: section for section in rig.SECTIONS}
    path = tmp_path / "file.yaml"
    servo = {"stiffness_npm": 100, "damping_nspm": 1}
    suspension = RIG["suspension"] | {"servo": servo}
    path.write_text(yaml.safe_dump(RIG | {"suspension": suspension}))
    load_rig(path)
    path.write_text(yaml.safe_dump(RIG | {"motors": ODRIVES}))
    load_rig(path)
    assert asked.pop("") == set(sections)
    for place, names in asked.items():
        if not place.endswith(NAMED):
            assert names == known_at(sections, place, [place.partition(":")[0]]), place


def test_the_page_agrees_with_the_code():
    assert PAGE.read_text("utf-8") == page(), "run: python tools/reference.py"
