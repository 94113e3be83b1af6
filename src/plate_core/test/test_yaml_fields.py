"""Fields: every kind of value, and the message for every kind of mistake."""

import numpy as np
import pytest

from plate_core import PlateError
from plate_core.yaml_fields import CONFIG, FAST_LENGTH, Fields, Key, Number, Text, read_yaml


class FileError(PlateError):
    """Stands for RigError and its like."""


def fields(**data) -> Fields:
    return Fields(data, "file.yaml", FileError)


def test_allowed_values_are_read():
    f = fields(a=1, b=2.5, c=3, d="x", e=[[1, 2], [3, 4]], f={"g": 1}, h=[{"i": 1}])
    assert f.number("a", 0, 2) == 1.0
    assert isinstance(f.number("a", 0, 2), float)
    assert f.number("b", 2.5, 2.5) == 2.5
    assert f.integer("c", 3, 3) == 3
    assert f.text("d", ["x", "y"]) == "x"
    np.testing.assert_array_equal(f.array("e", (None, 2), 1, 4), [[1, 2], [3, 4]])
    assert f.child("f").number("g", 0, 1) == 1
    assert f.children("h")[0].integer("i", 0, 1) == 1
    f.finish()


def test_texts_with_commas_are_texts(tmp_path):
    path = tmp_path / "some.yaml"
    path.write_text("a: parts 1,2\nb: {c: 1, 3: {}, d: }\n")
    assert read_yaml(path, FileError).keys() == ("a", "b")


def test_defaults_are_for_missing_keys_only():
    f = fields(a="no")
    assert f.number("b", 0, 1, default=0.5) == 0.5
    assert f.integer("c", 0, 9, default=7) == 7
    assert not f.has("b")
    with pytest.raises(FileError):
        f.number("a", 0, 1, default=0.5)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda f: f.number("x", 0, 1), "x is 2, allowed: a number from 0 to 1"),
        (lambda f: f.number("y", 0, 1), "y is 'two', allowed: a number from 0 to 1"),
        (lambda f: f.number("inf", 0, 1e9), "inf is inf, allowed: a number"),
        (lambda f: f.number("none", 0, 1), "none is None, allowed: a number"),
        (lambda f: f.number("gone", 0, 1), "gone is missing, expected a number from 0 to 1"),
        (lambda f: f.integer("half", 0, 9), "half is 0.5, allowed: a whole number from 0 to 9"),
        (lambda f: f.integer("yes", 0, 9), "yes is True, allowed: a whole number from 0 to 9"),
        (lambda f: f.integer("x", 3, 9), "x is 2, allowed: a whole number from 3 to 9"),
        (lambda f: f.text("x"), "x is 2, allowed: a text"),
        (lambda f: f.text("y", ["a", "b"]), "y is 'two', allowed: one of a, b"),
        (lambda f: f.array("list", (3,), 0, 9), "allowed: 3 numbers from 0 to 9"),
        (lambda f: f.array("list", (None, 2), 0, 9), "allowed: n x 2 numbers from 0 to 9"),
        (lambda f: f.array("list", (2,), 0, 1), "allowed: 2 numbers from 0 to 1"),
        (lambda f: f.array("ragged", (2, 2), 0, 9), "allowed: 2 x 2 numbers from 0 to 9"),
        (lambda f: f.array("holes", (2,), 0, 9), "allowed: 2 numbers from 0 to 9"),
        (lambda f: f.child("x"), "file.yaml: x: got 2, expected a mapping"),
        (lambda f: f.children("x"), "x is 2, allowed: a list of mappings"),
        (lambda f: f.children("list"), r"list\[0\]: got 1, expected a mapping"),
    ],
)
def test_wrong_values_are_refused_with_a_message(read, message):
    f = fields(
        x=2,
        y="two",
        inf=float("inf"),
        none=None,
        half=0.5,
        yes=True,
        list=[1, 2],
        ragged=[[1, 2], [3]],
        holes=[1, None],
    )
    with pytest.raises(FileError, match=message):
        read(f)


def test_unknown_keys_are_refused():
    f = fields(a=1, typo=2)
    f.number("a", 0, 1)
    with pytest.raises(FileError, match=r"file\.yaml: unknown key typo, allowed: a$"):
        f.finish()


def test_the_nearest_known_key_is_suggested():
    f = fields(a=1, hold=2)
    assert f.number("a", 0, 1) + f.number("hold_s", 0, 1, default=0) == 1
    with pytest.raises(FileError, match=r"key hold \(did you mean hold_s\?\), allowed: a, "):
        f.finish()
    with pytest.raises(FileError, match=r"hold_s is missing, .* \(the file has hold\)"):
        fields(a=1, hold=2).number("hold_s", 0, 1)
    optional = fields(makred=True)
    assert not optional.has("marked")
    with pytest.raises(FileError, match=r"did you mean marked\?"):
        optional.finish()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", "key a occurs twice, at line 1 and at line 3"),
        ("a: {mu: 1, mu: 2}\n", "key mu occurs twice, at line 1 and at line 1"),
        ("a:\n- b: 1\n- c: 1\n  c: 2\n", "key c occurs twice, at line 3 and at line 4"),
        ("a:\n  mu: 0,3\n", "mu is 0,3 at line 2, allowed: a decimal point, 0.3"),
        ("a: {mu: 0,3}\n", "mu is 0,3 at line 1, allowed: a decimal point, 0.3"),
        ("a: {mu: -1,05, g: 9.81}\n", "mu is -1,05 at line 1, allowed: a decimal point, -1.05"),
        ("a: 1\nw: 0640\n", "w is 0640 at line 2, which YAML reads as 416, allowed: a decimal"),
        ("m:\n- {n: -010}\n", "n is -010 at line 2, which YAML reads as -8, allowed: a decimal"),
        ("p: [[1, 2], [007, 0]]\n", "p is 007 at line 1, which YAML reads as 7, allowed"),
        ("a: {kg: 2:30}\n", "kg is 2:30 at line 1, which YAML reads as 150, allowed"),
        ("a: {kg: 0:02.5}\n", "kg is 0:02.5 at line 1, which YAML reads as 2.5, allowed"),
    ],
)
def test_a_text_that_yaml_would_misread_is_refused(tmp_path, text, message):
    path = tmp_path / "some.yaml"
    path.write_text(text)
    with pytest.raises(FileError, match=rf"some\.yaml: {message}"):
        read_yaml(path, FileError)


@pytest.mark.parametrize(
    "text", ["0", "-0", "0.5", "00.5", "0x10", "1_000", "'0640'", "0.0e-3", "2026-01-02"]
)
def test_other_notations_of_values_are_allowed(tmp_path, text):
    path = tmp_path / "some.yaml"
    path.write_text(f"a: {text}\n")
    assert read_yaml(path, FileError).keys() == ("a",)


def test_a_key_has_its_unit_in_its_name():
    names = {"a_m": "m", "b_mps2": "m/s^2", "c_deg": "degrees", "mu": "-", "goal_fraction": "-"}
    assert {name: Key(name, Number(0, 1), "").unit for name in names} == names
    assert Key("side_m", Text(), "").unit == ""


def test_keys_are_in_order_and_known():
    f = fields(b=1, a=2)
    assert f.keys() == ("b", "a")
    f.finish()


def test_files(tmp_path):
    path = tmp_path / "some.yaml"
    path.write_text("a: 1\n")
    assert read_yaml(path, FileError).number("a", 0, 1) == 1
    path.write_text("a: 1\nb: [1\n")
    with pytest.raises(FileError, match=r"some\.yaml: broken YAML at line \d"):
        read_yaml(path, FileError)
    path.write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(
        FileError, match=r"some\.yaml: (is no text in UTF-8 .*, allowed: UTF-8|broken YAML)"
    ):
        read_yaml(path, FileError)
    with pytest.raises(FileError, match="is a folder, allowed: a regular file"):
        read_yaml(tmp_path, FileError)
    with pytest.raises(FileError, match="no such file"):
        read_yaml(tmp_path / "none.yaml", FileError)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 2026-13-45", "line 1: '2026-13-45' is no timestamp"),
        ("b: 1\na: !!int abc", "line 2: 'abc' is no int"),
        ("a: !!bool abc", "'abc' is no bool"),
        ("a: " + 5000 * "9", "is no int"),
        pytest.param(1000 * "[" + 1000 * "]", "nested too deeply", id="nested"),
        ("a: &a [*a]", "a is .*, allowed: 2 numbers"),
        ("a: &a {b: *a}", "a is .*, allowed: 2 numbers"),
        (f"a: [1, 1{400 * '0'}]", "a is .*, allowed: 2 numbers"),
        ("a: [yes, no]", r"a is \[True, False\], allowed: 2 numbers"),
        ("a: ['1', '2']", "a is .*, allowed: 2 numbers"),
    ],
)
def test_odd_values_are_refused_in_a_line(tmp_path, text, message):
    path = tmp_path / "file.yaml"
    path.write_text(text)
    with pytest.raises(FileError, match=message) as error:
        read_yaml(path, FileError).array("a", (2,), 0, 1e9)
    assert len(str(error.value)) < 600
    assert "\n" not in str(error.value)


def test_aliases_of_aliases_are_read_and_shown_in_short(tmp_path):
    path = tmp_path / "file.yaml"
    lines = ["x0: &x0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    for i in range(1, 12):  # 9^12 entries, if each were visited
        lines.append(f"x{i}: &x{i} [{', '.join(9 * [f'*x{i - 1}'])}]")
    path.write_text("\n".join(lines))
    with pytest.raises(FileError, match=r"x11 is .*, allowed: a text") as error:
        read_yaml(path, FileError).text("x11")
    assert len(str(error.value)) < 5000


@pytest.mark.parametrize("text", ["1e-3", "1E-3", "+1.e-3", "10e-4", "0.1e-2", "1.0e-3", ".1e-2"])
def test_numbers_with_an_exponent_are_numbers(tmp_path, text):
    path = tmp_path / "file.yaml"
    path.write_text(f"a: {text}")
    assert read_yaml(path, FileError).number("a", 0, 1) == 0.001


def test_an_invalid_file_path_is_refused():
    for path in ("a\0b.yaml", 5000 * "a" + ".yaml"):
        with pytest.raises(FileError, match="cannot be read"):
            read_yaml(path, FileError)


def test_the_fast_parser_and_the_other_one_return_the_same(tmp_path, monkeypatch):
    paths = sorted(CONFIG.rglob("*.yaml"))
    assert len(paths) > 20
    fast = [read_yaml(path, FileError)._data for path in paths]
    monkeypatch.setattr("plate_core.yaml_fields.FAST_LENGTH", -1)
    assert fast == [read_yaml(path, FileError)._data for path in paths]


def test_deeply_nested_yaml_is_refused(tmp_path):
    path = tmp_path / "deep.yaml"
    for depth in (FAST_LENGTH, 10 * FAST_LENGTH):
        path.write_text(depth * "[")
        with pytest.raises(FileError, match="nested too deeply"):
            read_yaml(path, FileError)
