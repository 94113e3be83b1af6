"""Program that runs all nodes of the loop in one process and one executor. The program is useful on
small computers and for debugging."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from typing import Any

from plate_core.ros import run_nodes

from .graph import RunOptions, load_graph


def main() -> None:
    """Run the nodes whose names the command line contains."""
    graph = {node.name: node for node in load_graph()}
    default = [node.name for node in RunOptions().nodes(graph.values())]
    parser = argparse.ArgumentParser(
        prog="ros2 run plate_bringup one_process",
        usage="%(prog)s [NODE ...] [--ros-args --params-file FILE ...]",
        description=__doc__,
    )
    parser.add_argument(
        "nodes",
        metavar="NODE",
        nargs="*",
        help=f"any of {', '.join(graph)} (default: {', '.join(default)})",
    )
    arguments = sys.argv[1:]
    ros = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    names = parser.parse_args(arguments[:ros]).nodes or default
    unknown = [name for name in names if name not in graph]
    if unknown:
        parser.error(f"node is {unknown[0]!r}, allowed: {', '.join(graph)}")
    run_nodes({name: component(graph[name].component) for name in names}, arguments[ros:])


def component(name: str) -> Any:
    """Return the class with this qualified name."""
    module, _, kind = name.rpartition(".")
    return getattr(import_module(module), kind)
