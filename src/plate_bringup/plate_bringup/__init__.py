"""The complete closed loop: its nodes, their parameters for one run, and the launch files.

The module `loop` runs the same loop without ROS in one process. This package combines the stages.
Of the other packages, only `plate_gym` imports it.
"""

from .graph import GraphError, GraphNode, RunOptions, Value, load_graph

__all__ = [
    "GraphError",
    "GraphNode",
    "RunOptions",
    "Value",
    "load_graph",
]
