"""Programs that start nodes. Ctrl-C ends these programs at once and without a traceback, even while
Python starts."""

from __future__ import annotations

import subprocess
from typing import Any

from setuptools.command.install_scripts import install_scripts

ENV = "/usr/bin/env"
HOLDING = "--block-signal=INT"
"""Option of GNU `env`: SIGINT stays blocked until the program unblocks it."""

PROGRAM = """
if __name__ == "__main__":
    import atexit
    import os
    import signal
    import sys

    # Exit with 130, the code that shells report for Ctrl-C, until run_node sets its own handlers.
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(128 + number))
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT, signal.SIGTERM])
    PARENT = os.getppid()  # run_node ends the node when this process has ended
    code = 1

    def leave():
        # Skip the clean-up of Python and libraries, because it takes 0.3 s. The system frees
        # memory.
        try:
            sys.stdout.flush()
        finally:
            os._exit(code)

    atexit.register(leave)  # the function registered first is called last
    try:
        from {module} import {function}
    except ModuleNotFoundError as error:
        if error.name not in ("{package}", "rclpy"):
            raise
        sys.exit(f"error: {{error}}; first source env.sh, or the setup file of your workspace")

    try:
        {function}()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        raise
"""


def node_programs(*names: str) -> type[install_scripts]:
    """Return the command `install_scripts` for a setup.py. `names` contains the names of the
    programs that are ROS nodes.

    Python needs 20 ms or more before the first line of a program runs. Ctrl-C during this time
    would print a traceback. Therefore, the program `env` blocks the signal during this time, if it
    is able to.
    """

    class NodePrograms(install_scripts):
        def write_script(
            self, script_name: str, contents: str, mode: str = "t", *ignored: Any
        ) -> None:
            points = self.distribution.entry_points["console_scripts"]
            for name, _, place in (point.partition(" = ") for point in points):
                if name == script_name and name in names:
                    module, _, function = place.partition(":")
                    package = module.partition(".")[0]
                    program = PROGRAM.format(module=module, function=function, package=package)
                    line = contents.partition("\n")[0]
                    contents = f"{first_line(line)}\n{program}"
            super().write_script(script_name, contents, mode, *ignored)

    return NodePrograms


def first_line(line: str) -> str:
    """Change the first line `#!PYTHON` of a script so that the script starts with SIGINT blocked,
    and return this line. If the program `env` of this machine cannot block signals, the line is
    unchanged."""
    try:
        done = subprocess.run([ENV, HOLDING, "true"], capture_output=True, check=False)
    except OSError:
        return line
    python = line.removeprefix("#!").strip().removeprefix(ENV).strip()
    return line if done.returncode else f"#!{ENV} -S {HOLDING} {python}"
