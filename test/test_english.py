"""The check of sentences finds each pattern of the private dialect, and no plain sentence."""

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))

from english import PATTERNS, check, findings

BAD = (
    "What is missed is missed.",
    "By how much an answer is given sooner.",
    "So many openings that brought nothing.",
    "It is a good one but for rounding.",
    "The plate begins anew.",
    "The hopper is to be open.",
    "The forces are as asked.",
    "A module cannot be had here.",
)
GOOD = (
    "Number of openings without a new part.",
    "What if a drive fails?",
    "How far does the part move?",
    "The plate must rest, except during calibration.",
)


@pytest.mark.parametrize(("advice", "sentence"), list(zip(PATTERNS, BAD, strict=True)))
def test_each_pattern_is_found_with_its_line(tmp_path, advice, sentence):
    places = {
        "page.md": f"# Page\n\n{sentence}\n",
        "module.py": f'"""Module."""\n\nNAME = 1  # {sentence}\n',
        "kernel.hpp": f"#pragma once\n\n// {sentence}\n",
    }
    for name, text in places.items():
        file = tmp_path / name
        file.write_text(text)
        assert [(line, found) for line, found, _ in findings(file)] == [(3, advice)], name


def test_docstrings_and_messages_are_checked(tmp_path, capsys):
    file = tmp_path / "module.py"
    file.write_text(f'"""{BAD[0]}"""\n\n\ndef check():\n    raise ValueError("{BAD[3]}")\n')
    assert check([str(file)]) == 1
    assert [line.split(":")[1] for line in capsys.readouterr().out.splitlines()] == ["1", "5"]


@pytest.mark.parametrize("sentence", GOOD)
def test_plain_sentences_pass(tmp_path, sentence):
    file = tmp_path / "page.md"
    file.write_text(f"{sentence}\n\n```\n{BAD[0]}\n```\n\n| {BAD[1]} |\n")
    assert check([str(file)]) == 0


ODD = {
    "latin.md": b"caf\xe9\n",
    "binary.yaml": b"\xff\xfe\x00\x01",
    "broken.py": b"def f(:\n",
    "indented.py": b"if True:\n        a = 1\n    b = 2\n",
    "open.py": b'text = """\n',
    "zero.py": b"a = 1\x00\n",
    "coding.py": b"# -*- coding: nothing -*-\n",
}
"""Contents that do not match the names."""


@pytest.mark.parametrize("name", [*ODD, "missing.md", "folder.md", "dangling.py"])
def test_an_odd_file_is_a_finding_and_the_others_are_checked(tmp_path, capsys, name):
    odd, bad = tmp_path / name, tmp_path / "bad.md"
    bad.write_text(f"{BAD[0]}\n")
    if name in ODD:
        odd.write_bytes(ODD[name])
    elif name == "folder.md":
        odd.mkdir()
    elif name == "dangling.py":
        odd.symlink_to(tmp_path / "nothing")
    assert check([str(odd), str(bad)]) == 1
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith(
        f"{odd}: not readable as {'Python' if odd.suffix == '.py' else 'UTF-8'}"
    )
    assert second.startswith(f"{bad}:1: ")


@pytest.mark.parametrize("folder", ["bench", "examples", "src", "test", "tools"])
def test_a_section_title_of_a_docstring_has_its_own_line(folder):
    joined = re.compile(r"^ *(?:Attributes|Parameters|Raises|Returns|Yields) -{3}", re.MULTILINE)
    files = list((Path(__file__).parents[1] / folder).rglob("*.py"))
    assert files
    assert [str(file) for file in files if joined.search(file.read_text("utf-8"))] == []
