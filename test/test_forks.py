"""Nodes as forks: as processes of their own for all who look, with true exit codes."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from graph import forks
from graph.forks import Fork, Server

SHOWS = """#!/usr/bin/env python3
import json, os, sys
with open("/proc/self/comm") as name, open("/proc/self/cmdline") as command:
    print(json.dumps([sys.argv, os.getcwd(), os.environ["MARK"], sys.path[0], name.read().strip(),
                      command.read().rstrip("\\0"), os.getsid(0) == os.getpid(), sys.stdin.read()]))
sys.exit(int(sys.argv[1]))
"""
WAITS = "#!/usr/bin/env python3\nimport time\nprint('here')\ntime.sleep(60)\n"


@pytest.fixture(name="server")
def _server():
    # A module that cannot be loaded, and one that prints, into a buffer: neither may matter.
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    server = Server(["no_such_module", "this"], buffered)
    yield server
    server._end()


@pytest.fixture(name="start")
def _start(server, tmp_path):
    def start(text, *words):
        program, log = tmp_path / "shows", tmp_path / "log"
        program.write_text(text)
        return Fork(server.start([str(program), *words], os.environ | {"MARK": "m"}, log)), log

    return start


def test_a_fork_has_its_own_arguments_name_and_folder(start, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    fork, log = start(SHOWS, "3")
    assert fork.wait(30) == fork.poll() == 3
    program = str(tmp_path / "shows")
    words, here, mark, path, name, command, leads, typed = json.loads(log.read_text())
    assert (words, here, mark, path) == ([program, "3"], str(tmp_path / "here"), "m", str(tmp_path))
    assert (name, leads, typed) == ("shows", True, "")
    assert f"{program}\0".startswith(command[:40])  # as `ps` shows it, which may be cut


@pytest.mark.parametrize(
    ("text", "code", "last_line"),
    [
        ("#!python\n", 0, ""),
        ("#!python\nraise SystemExit('a reason')\n", 1, "a reason\n"),
        ("#!python\nimport nothing_of_that_name\n", 1, "No module named 'nothing_of_that_name'"),
        ("#!python\nimport os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n", -9, ""),
    ],
)
def test_the_exit_code_and_last_output_of_a_fork_are_reported(start, text, code, last_line):
    fork, log = start(text)
    assert fork.wait(30) == code
    assert last_line in log.read_text()


def test_an_exit_code_is_reported_even_if_sigchld_is_ignored(request):
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        fork, _ = request.getfixturevalue("start")("#!python\nraise SystemExit(4)\n")
        assert fork.wait(30) == 4
    finally:
        signal.signal(signal.SIGCHLD, before)


def test_a_node_is_a_child_of_the_program_and_continues_without_its_server(start, server):
    fork, log = start(WAITS)
    assert f"PPid:\t{os.getpid()}\n" in Path(f"/proc/{fork.pid}/status").read_text()
    while not (log.exists() and log.read_text()):
        with pytest.raises(subprocess.TimeoutExpired):
            fork.wait(0.01)
    os.kill(server._process.pid, signal.SIGKILL)
    with pytest.raises(OSError, match=r"ended|Broken pipe"):
        start(WAITS)
    assert fork.poll() is None
    fork.send_signal(signal.SIGTERM)
    assert fork.wait(30) == -signal.SIGTERM


def test_a_server_that_does_not_answer_is_ended(start, server, monkeypatch):
    os.kill(server._process.pid, signal.SIGSTOP)
    monkeypatch.setattr(forks, "START_S", 0.2)
    with pytest.raises(OSError, match="does not answer"):
        start(WAITS)
    assert server._process.wait(30) == -signal.SIGKILL


def test_only_python_scripts_with_the_same_libraries_are_forked(tmp_path):
    shell, python = tmp_path / "shell", tmp_path / "python"
    shell.write_text("#!/bin/sh\n")
    python.write_text("#!/usr/bin/env python3\n")
    assert Fork.start([str(shell)], os.environ, tmp_path / "log", []) is None
    assert Fork.start(["nowhere"], os.environ, tmp_path / "log", []) is None
    assert Fork.start([str(python)], os.environ, tmp_path / "log", []).wait(30) == 0
    other = os.environ | {"OPENBLAS_CORETYPE": "Prescott"}
    assert Fork.start([str(python)], other, tmp_path / "log", []) is None
