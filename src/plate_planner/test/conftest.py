"""Fixtures that several tests of the node use."""

import pytest


@pytest.fixture
def graph(clock):
    from planner_graph import Graph

    made = []

    def make(**parameters):
        while made:
            made.pop().close()
        made.append(Graph(clock, **parameters))
        return made[-1]

    yield make
    for item in made:
        item.close()
