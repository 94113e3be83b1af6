"""The closed loop as a whole: which nodes it has, their parameters for one run, how it is launched;
and without ROS, in one process: `loop`.

This package puts the stages together. Of the others `plate_gym` alone imports it.
"""

from .graph import GraphError, GraphNode, RunOptions, Value, load_graph

__all__ = [
    "GraphError",
    "GraphNode",
    "RunOptions",
    "Value",
    "load_graph",
]
