"""The page of the first day: its commands run, its buttons and pictures are there."""

import re

from test_tutorial import ROOT, printed_by, shell, steps

PAGE = ROOT / "docs/guide/first_day.md"
TEXT = PAGE.read_text(encoding="utf-8")
STATIC = ROOT / "src/plate_view/plate_view/static"


def test_the_commands_of_the_page_run(tmp_path):
    found = steps(re.sub(r"\bmy\b(?=/|$)", f"{tmp_path}/my", TEXT, flags=re.MULTILINE))
    assert len(found) >= 3
    together = " && ".join(step.command for step in found)
    process = shell(f"set -e; {together}")
    printed = printed_by(process)
    assert process.returncode == 0, printed
    assert "ERROR" not in printed


def test_buttons_and_checks_that_it_names_are_on_the_page():
    reported = "".join(path.read_text(encoding="utf-8") for path in STATIC.rglob("*.[jh][st]*"))
    buttons = re.findall(r"[Pp]ress \*([^*]+)\*", TEXT)
    assert len(buttons) >= 6
    assert [
        name for name in buttons if f'"{name}"' not in reported and f">{name}<" not in reported
    ] == []


def test_commands_of_plate_that_it_names_exist():
    names = re.findall(r"`plate (\w+)`|^\$ plate (\w+)", TEXT, re.MULTILINE)
    command = ROOT / "src/plate_client/plate_client/command.py"
    known = set(re.findall(r'^    "(\w+)": ', command.read_text(encoding="utf-8"), re.MULTILINE))
    assert "enable" in known
    assert {one or other for one, other in names} <= known
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    given = set(re.findall(r"\b([A-Z]+)=", TEXT))
    assert given <= set(re.search(r"^NAMES := (.*)$", makefile, re.MULTILINE)[1].split())
