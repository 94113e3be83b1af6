"""The `--help` text of a node.

The text contains the node's docstring (purpose, topics and services) and its parameters with
defaults and ranges. This module also refuses wrong command lines and parameter files.
"""

from __future__ import annotations

import inspect
import itertools
import sys
from collections.abc import Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from textwrap import wrap
from typing import Any

from rclpy.utilities import remove_ros_args

from ..errors import PlateError
from ..files import YAML_BYTES, check_file

WIDTH = 100
"""Width of the text [characters]."""


def print_help(node: Any, options: type | None, args: Sequence[str] | None) -> bool:
    """Print the help text if the command line contains `-h` or `--help`. Return whether the text
    was printed.

    Raises
    ------
    PlateError
        If `options` is given and the command line contains arguments other than `--help` and the
        arguments of ROS, or if a parameter file cannot be read.
    """
    check_parameter_files(args)
    try:
        arguments = remove_ros_args(sys.argv if args is None else ["", *args])[1:]
    except RuntimeError:  # the arguments are wrong; rclpy.init will report this error
        return False
    if {"-h", "--help"} & set(arguments):
        print(usage(start_command(sys.argv[0]), node, options))
        return True
    if arguments and options is not None:
        raise PlateError(
            f"argument {arguments[0]!r}, allowed: --help, or --ros-args -p NAME:=VALUE ..."
        )
    return False


def check_parameter_files(args: Sequence[str] | None) -> None:
    """Refuse parameter files that would block ROS or fill the memory."""
    for word, file in itertools.pairwise(sys.argv if args is None else args):
        if word == "--params-file":
            check_file(file, YAML_BYTES)


def start_command(path: str) -> str:
    """Return the command that starts a program: `ros2 run ...` for an installed program, otherwise
    `python ...`."""
    program = Path(path)
    if program.parent.parent.name == "lib":
        return f"ros2 run {program.parent.name} {program.name}"
    return f"python {program}"


def usage(start: str, node: Any, options: type | None) -> str:
    """Return the help text.

    Parameters
    ----------
    start : str
        Command that starts the program.
    node : class
        Node class. The docstring of the class describes the node, its topics and its services.
    options : class, optional
        Dataclass of the parameters, as for `declare`.
    """
    lines = [f"usage: {start} [--ros-args -p NAME:=VALUE ...]", ""]
    lines += (inspect.getdoc(node) or "").splitlines()
    if options is not None:
        lines += ["", "Parameters and defaults (* can be changed while the node runs):"]
        others: dict[str, list[str]] = {}
        for item in fields(options):
            assert item.default is not MISSING
            spec = item.metadata["spec"]
            name = f"{item.name}{'*' if spec.live else ''}"
            if spec.group:
                others.setdefault(spec.group, []).append(name)
                continue
            default = str(item.default).lower() if isinstance(item.default, bool) else item.default
            allowed = f" ({spec.allowed})" if spec.allowed else ""
            head = f"  {name:18} {str(default) or repr(''):12} "
            text = wrap(f"{spec.description}{allowed}", WIDTH - len(head))
            lines += [head + text[0], *(" " * len(head) + more for more in text[1:])]
        for group, names in others.items():
            lines += wrap(
                f"{group}: {', '.join(names)}",
                WIDTH - 2,
                initial_indent="  ",
                subsequent_indent="    ",
            )
    return "\n".join(lines)
