"""Closed loop of all stages: the nodes, their parameters for a run, and the launch files.

The module `loop` runs the same loop in one process without ROS. This package imports the packages
of the stages. Only `plate_gym` imports this package.
"""

from .graph import GraphError, GraphNode, RunOptions, Value, load_graph

__all__ = [
    "GraphError",
    "GraphNode",
    "RunOptions",
    "Value",
    "load_graph",
]
