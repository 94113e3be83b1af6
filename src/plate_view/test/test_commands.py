"""Commands that browsers are allowed to send."""

import contextlib
import json
import math
import shlex

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plate_view import Command, CommandError, Role, read_command
from plate_view.calls import call_text
from plate_view.commands import COMMANDS, FOR_ALL, number_of

GOOD = {
    "emergency_stop": {}, "cut_power": {}, "stop": {}, "cancel": {}, "learn_plate": {},
    "enable": {"on": True},
    "start": {"scenario": "sort_4"},
    "move": {"targets": [{"id": "black_1", "x": 0.1, "y": -0.05, "angle": None}]},
    "follow": {"id": "black_1", "points": [[0, 0], [0.1, 0]], "speed": 0.02, "closed": False},
    "set": {"node": "solver", "name": "method", "value": "rotations"},
    "parameters": {"node": "solver"},
    "place": {"id": None, "type": "black", "x": 0.0, "y": 0.0, "angle": 0},
    "remove": {"id": "black_1"},
    "reset": {"seed": 3},
    "teach": {"name": "nut"},
    "find_home": {}, "save_home": {},
    "take_lens_pictures": {"on": True, "columns": 9, "rows": 7, "square_m": 0.03, "marker_m": 0.0},
    "fit_lens": {},
    "save_lens": {},
    "measure_friction": {"start": True},
    "write_friction": {},
    "watch": {"image": True, "field": False, "camera": True},
    "replay": {"playing": False},
}  # fmt: skip


def read(name, values, role=Role.OPERATOR):
    return read_command(json.dumps({"do": name, "number": 7, **values}), role)


def test_every_command_is_read():
    assert GOOD.keys() == COMMANDS.keys()
    for name, values in GOOD.items():
        command = read(name, values)
        assert (command.name, command.number) == (name, 7)
        assert {key: command.values[key] for key in values if key != "targets"} == {
            key: value if key != "points" else [tuple(p) for p in value]
            for key, value in values.items()
            if key != "targets"
        }


def test_a_target_without_an_angle_may_have_any():
    (target,) = read("move", GOOD["move"]).values["targets"]
    assert math.isnan(target["angle"])
    assert (target["id"], target["x"], target["y"]) == ("black_1", 0.1, -0.05)


def test_a_viewer_cannot_send_commands():
    for name, values in GOOD.items():
        if name in FOR_ALL:
            assert read(name, values, Role.VIEWER).name == name
        else:
            with pytest.raises(CommandError, match="read only"):
                read(name, values, Role.VIEWER)


WRONG = [
    "", "no json", "[]", "3", "null", '{"do": 3}', '{"do": "rm"}', '{"do": null}',
    '{"do": "stop", "force": true}', '{"do": "enable"}', '{"do": "enable", "on": 1}',
    '{"do": "move", "targets": []}', '{"do": "move", "targets": [{"id": "a", "x": 1}]}',
    '{"do": "move", "targets": [{"id": "a", "x": NaN, "y": 0}]}',
    '{"do": "move", "targets": [{"id": "a", "x": 1e300, "y": 0}]}',
    '{"do": "move", "targets": [{"id": "a", "x": true, "y": 0}]}',
    '{"do": "move", "targets": [{"id": "a", "x": 0, "y": 0, "z": 1}]}',
    '{"do": "remove", "id": "' + "x" * 300 + '"}', '{"do": "remove", "id": "a\\u0000b"}',
    '{"do": "follow", "id": "a", "points": [[0, 0]], "speed": 1, "closed": false}',
    '{"do": "reset", "seed": -1}', '{"do": "reset", "seed": 1.5}',
    '{"do": "set", "node": "a", "name": "b", "value": [1]}',
    '{"do": "set", "node": "a", "name": "b", "value": Infinity}', "[" * 100_000,
]  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_command_is_refused_with_the_allowed_values(text):
    with pytest.raises(CommandError, match="allowed"):
        read_command(text, Role.OPERATOR)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # of a busy machine
@given(st.sampled_from(sorted(COMMANDS)), st.dictionaries(st.text(max_size=8), JSON), st.data())
def test_random_input_is_a_command_or_is_refused(name, extra, data):
    """Any input is parsed or refused, and parsed commands can be printed."""
    values = {key: data.draw(JSON) for key in COMMANDS[name]}
    text = json.dumps({"do": name, **values, **extra})
    with contextlib.suppress(CommandError):
        assert "\n" not in call_text(read_command(text, Role.OPERATOR))


def test_calls_have_the_text_of_a_command():
    reported = {name: call_text(read(name, values)) for name, values in GOOD.items()}
    assert reported["stop"] == "plate stop"
    assert reported["learn_plate"] == "ros2 service call /detector/learn_plate std_srvs/srv/Trigger"
    assert reported["start"] == "plate goal sort_4"
    assert reported["set"] == "plate set solver method rotations"
    assert "{targets: [{id: black_1, x: 0.1, y: -0.05, angle: .nan}]}" in reported["move"]
    assert reported["enable"] == "plate enable"
    assert reported["reset"].startswith("plate set simulator seed 3 && ros2 service call")
    assert "id" not in shlex.split(reported["place"])[-1]


def test_special_characters_of_a_shell_are_quoted():
    command = Command("set", 1, {"node": "a", "name": "b", "value": "$(reboot)'; ls"})
    line = call_text(command)
    assert shlex.split(line) == ["plate", "set", "a", "b", "$(reboot)'; ls"]
    command = Command("remove", 1, {"id": "$(reboot)`ls`"})
    assert shlex.split(call_text(command))[-1] == "{id: $(reboot)`ls`}"


def test_an_invalid_number_is_read_as_minus_one():
    assert [number_of(each) for each in ({"number": 3}, {"number": True}, {}, 3)] == [3, -1, -1, -1]
