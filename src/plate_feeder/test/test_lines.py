"""Lines of robots, and the lines that answer them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plate_feeder import Code, Quantity, ReadyPart
from plate_feeder.lines import (
    COMMANDS,
    MAX_ANSWER,
    MAX_LINE,
    Command,
    LineError,
    answer_line,
    part_text,
    quantity_text,
    read_line,
)


@pytest.mark.parametrize(
    ("line", "command"),
    [
        (b"get_part", Command("get_part")),
        (b"  GET_PART black\t2.5 ", Command("get_part", label="black", timeout_s=2.5)),
        (b"get_part 3", Command("get_part", timeout_s=3.0)),
        (b"prepare_part black", Command("prepare_part", label="black")),
        (b"part_taken", Command("part_taken")),
        (b"part_taken failed", Command("part_taken", taken=False)),
        (b"part_taken black_3", Command("part_taken", part="black_3")),
        (b"part_taken black_3 OK", Command("part_taken", part="black_3")),
        (b"part_taken black_3 failed", Command("part_taken", part="black_3", taken=False)),
        (b"purge 20", Command("purge", timeout_s=20.0)),
        (b"part_quantity", Command("part_quantity")),
        (b"state", Command("state")),
    ],
)
def test_lines_are_read(line, command):
    assert read_line(line) == command


@pytest.mark.parametrize(
    ("line", "code", "named"),
    [
        (b"get_prat", Code.UNKNOWN_COMMAND, "get_part?"),
        (b"resume_feeding", Code.UNKNOWN_COMMAND, "allowed: get_part"),  # no robot may
        (b"   ", Code.UNKNOWN_COMMAND, "''"),
        (b"get_part black 2 3", Code.BAD_ARGUMENT, "get_part [class] [timeout_s]"),
        (b"get_part -2", Code.BAD_ARGUMENT, "'-2'"),
        (b"get_part 1e3", Code.BAD_ARGUMENT, "'1e3'"),
        (b"get_part 1_0", Code.BAD_ARGUMENT, "'1_0'"),
        (b"get_part 12345678", Code.BAD_ARGUMENT, "'12345678'"),
        (b"purge black", Code.BAD_ARGUMENT, "'black'"),
        (b"state now", Code.BAD_ARGUMENT, "'now'"),
        (b"part_taken a ok b", Code.BAD_ARGUMENT, "'ok'"),
        (b"get_part \xe9", Code.BAD_LINE, "ASCII"),
        (b"get_part \x00", Code.BAD_LINE, "ASCII"),
        (b"a" * (MAX_LINE + 1), Code.BAD_LINE, "256"),
    ],
)
def test_wrong_lines_are_refused(line, code, named):
    with pytest.raises(LineError, match="") as caught:
        read_line(line)
    assert caught.value.code is code
    assert named in str(caught.value)


@given(st.binary(max_size=300))
def test_any_line_is_a_command_or_refused(line):
    try:
        command, code, text = read_line(line), Code.DONE, ""
    except LineError as error:
        command, code, text = None, error.code, str(error)
    if command is not None:
        assert command.name in COMMANDS
        assert math.isfinite(command.timeout_s)
    else:
        assert 400 <= code < 500
        answer = answer_line(code, text)
        assert answer.endswith(b"\r\n")
        assert answer.count(b"\n") == 1
        assert len(answer) <= MAX_ANSWER + 2


def test_replies_are_one_line_of_plain_text():
    assert answer_line(Code.DONE, "a\nb\r\n  c é") == b"200 a b c ?\r\n"


def test_a_long_reply_is_cut_between_two_words():
    counts = {f"a_type_of_part_{letter}": 12 for letter in "abcdefghijklmnop"}
    text = quantity_text(Quantity(counts, 2, 5, 1, 0))
    words = answer_line(Code.DONE, text).decode().split()
    assert len(words) > 15
    assert words == f"200 {text}".split()[: len(words)]
    for size in range(240, 260):
        line = answer_line(Code.DONE, size // 2 * "1 ").decode()
        assert line == f"200 {min(size // 2, 123) * '1 '}".strip() + "\r\n"


def test_a_part_in_millimetres_and_degrees():
    part = ReadyPart("m8_nut_12", 0.012345, -1e-7, math.radians(-190))
    assert part_text(part, 9.96) == (
        "x=12.35 y=0.00 angle=170.00 id=m8_nut_12 class=m8_nut valid_s=10.0"
    )


def test_a_quantity_is_formatted_as_one_line():
    text = quantity_text(Quantity({"black": 3, "grey": 1}, 2, 5, 1, 0))
    assert text == "seen=4 ready=2 taken=5 discharged=1 lost=0 black=3 grey=1"


def test_only_one_code_means_a_fulfilled_request():
    assert {code for code in Code if code.done} == {Code.DONE}
