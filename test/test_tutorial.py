"""The commands of docs/tutorial.md do what the page shows.

A block of commands below `<!-- not run: why -->` is left out here. One below
`<!-- in a second terminal -->` runs while the next one does. Below `<!-- decimals vary -->` numbers
with a decimal point may have any value: times, and what depends on them.
"""

import os
import re
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from shown_text import differs

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/tutorial.md"

BLOCK = re.compile(r"(?:^<!-- (.+?) -->\n)?^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"# (\S*my/\S+)")
MAX_S = 300
NOISE = "RTPS_TRANSPORT_SHM"
"""Output of the network layer about processes that were killed in any earlier run."""


@dataclass(frozen=True)
class Step:
    """A command and its expected output, or a file and its content."""

    command: str = ""
    shown: str = ""
    note: str = ""
    file: str = ""
    text: str = ""


def steps(page):
    """Return the steps of a page in their order, without the steps that are not run."""
    found = []
    for note, kind, body in BLOCK.findall(page):
        name = FILE.match(body)
        if name:
            found.append(Step(file=name[1], text=body))
        elif kind == "console" and not note.startswith("not run: "):
            for part in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]:
                command, _, shown = re.sub(r"\\\n>? *", "", part).partition("\n")
                found.append(Step(command, shown, note))
    return found


def shell(command):
    """Start a command as a person would, in the clone."""
    return subprocess.Popen(
        ["bash", "-c", command],
        cwd=ROOT,
        env={k: v for k, v in os.environ.items() if not k.startswith("MAKE")},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def printed_by(process):
    """All that a command prints; it is ended if it takes too long."""
    try:
        lines = process.communicate(timeout=MAX_S)[0].splitlines()
        return "\n".join(line for line in lines if NOISE not in line)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def test_every_command_shows_the_output_of_the_page(tmp_path, domain):
    pytest.importorskip("rclpy")
    page = PAGE.read_text(encoding="utf-8").replace("my/", f"{tmp_path}/my/")
    page = re.sub(r"(DOMAIN_ID=|--domain )42", rf"\g<1>{domain}", page)
    (tmp_path / "my").mkdir()
    running = []
    for step in steps(page):
        if step.file:
            Path(step.file).write_text(step.text, encoding="utf-8")
            continue
        running.append((step, shell(step.command)))
        if step.note == "in a second terminal":
            continue
        results = [(done, printed_by(process)) for done, process in reversed(running)]
        running.clear()
        for done, printed in results:
            loose = done.note == "decimals vary"
            assert not differs(done.shown, printed, loose), done.command


def test_the_page_has_steps():
    found = steps(PAGE.read_text(encoding="utf-8"))
    assert sum(bool(step.command) for step in found) >= 8
    assert sum(bool(step.file) for step in found) >= 2


def test_a_wrong_output_is_noticed():
    assert not differs("time 14.1 s ... done", "time 14.9 s\nmotors\n  all done")
    assert differs("time 14.1 s", "time 16.1 s")
    assert differs("4 of 5", "3 of 5")
    assert differs("done", "done, but")
    assert differs("3 parts, 1.2 s", "4 parts, 1.2 s", decimals_vary=True)
    assert not differs("3 parts, 1.2 s", "3 parts, 9.9 s", decimals_vary=True)
    assert not differs("(+0.276, -0.000)", "(+0.276,  -0.001)")
