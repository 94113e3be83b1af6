"""The closed loop as a whole: which nodes it has, their parameters for one run, how it is launched.

No other package imports this one; `bench/`, `tools/` and tests may.
"""

from .graph import GraphError, GraphNode, RunOptions, Value, load_graph

__all__ = [
    "GraphError",
    "GraphNode",
    "RunOptions",
    "Value",
    "load_graph",
]
