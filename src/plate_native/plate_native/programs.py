"""Programs of nodes: they end at once and without a traceback, whenever Ctrl-C comes."""

from __future__ import annotations

import subprocess
from typing import Any

from setuptools.command.install_scripts import install_scripts

ENV = "/usr/bin/env"
HOLDING = "--block-signal=INT"
"""Option of `env`: SIGINT waits until the program lets it come. GNU has it."""

PROGRAM = """
if __name__ == "__main__":
    import atexit
    import os
    import signal
    import sys

    # Until run_node takes over: 130, as shells say of a program that Ctrl-C has ended.
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(128 + number))
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT, signal.SIGTERM])
    PARENT = os.getppid()  # run_node ends the node when that process is gone
    code = 1

    def leave():
        # Python and the libraries would take 0.3 s to tidy up memory that the system takes back.
        try:
            sys.stdout.flush()
        finally:
            os._exit(code)

    atexit.register(leave)  # the first one is called last
    from {module} import {function}

    try:
        {function}()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        raise
"""


def node_programs(*names: str) -> type[install_scripts]:
    """Return the command `install_scripts` for a setup.py whose programs of these names are nodes.

    Python itself needs 20 ms or more before the first line of a program runs, and shows a traceback
    when Ctrl-C comes then; so `env` holds that signal back, if it can.
    """

    class NodePrograms(install_scripts):
        def write_script(
            self, script_name: str, contents: str, mode: str = "t", *ignored: Any
        ) -> None:
            points = self.distribution.entry_points["console_scripts"]
            for name, _, place in (point.partition(" = ") for point in points):
                if name == script_name and name in names:
                    module, _, function = place.partition(":")
                    program = PROGRAM.format(module=module, function=function)
                    line = contents.partition("\n")[0]
                    contents = f"{first_line(line)}\n{program}"
            super().write_script(script_name, contents, mode, *ignored)

    return NodePrograms


def first_line(line: str) -> str:
    """Return the first line of a script, `#!PYTHON`, as one that starts it with SIGINT held back;
    unchanged if this machine's `env` cannot do so."""
    try:
        done = subprocess.run([ENV, HOLDING, "true"], capture_output=True, check=False)
    except OSError:
        return line
    python = line.removeprefix("#!").strip().removeprefix(ENV).strip()
    return line if done.returncode else f"#!{ENV} -S {HOLDING} {python}"
