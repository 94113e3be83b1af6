"""The complete closed loop: its nodes, their parameters for one run, and the launch files.

The module `loop` runs the same loop in one process without ROS. This package combines the stages.
Only `plate_gym` imports it; the other packages do not.
"""

from .graph import GraphError, GraphNode, RunOptions, Value, load_graph

__all__ = [
    "GraphError",
    "GraphNode",
    "RunOptions",
    "Value",
    "load_graph",
]
