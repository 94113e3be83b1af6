"""A graph whose solver uses little CPU time, so that other tests can run."""

from collections.abc import Collection
from dataclasses import dataclass

from short_task import FEW_STARTS

from plate_bringup import GraphNode, RunOptions, Value


@dataclass(frozen=True)
class LightOptions(RunOptions):
    """`RunOptions` with `FEW_STARTS` for the solver."""

    def parameters(self, node: GraphNode, given: Collection[str] | None = None) -> dict[str, Value]:
        values = super().parameters(node, given)
        return values | FEW_STARTS if node.name == "solver" else values
