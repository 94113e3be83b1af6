"""The closed loop with objects on the plate that belong to no class of the task. The simulator's
truth shows what happens to them."""

from dataclasses import replace

import numpy as np
import pytest
from short_task import FEW_STARTS

from plate_bringup import loop
from plate_core import load_rig
from plate_core.tasks import load_scenario
from plate_vision import tracking

MORE = 3


@pytest.mark.parametrize("scenario", ["sort_10", "assemble_8"])
def test_unknown_things_stay_on_the_plate_and_clear_of_its_edge(scenario, monkeypatch):
    expected, rig = load_scenario(scenario), load_rig()
    first = expected.parts[0]
    there = replace(expected, parts=(replace(first, count=first.count + MORE), *expected.parts[1:]))
    world = {}

    def simulation(rig, _, *args, **kwargs):
        world["it"] = loop_simulation(rig, there, *args, **kwargs)
        ids = [name for name in world["it"].state.ids if name.startswith(first.label)]
        world["unknown"] = ids[:MORE]
        return world["it"]

    def update(tracker, stamp, centre, label, *args, **kwargs):
        """Record the detections of an image, without the class of some parts."""
        state, label = world["it"].state, np.array(label, dtype="U32")
        for name, position in zip(state.ids, state.position, strict=True):
            if name in world["unknown"]:
                label[np.argmin(np.hypot(*(centre - position).T))] = "unknown"
        return tracking.update(tracker, stamp, centre, label, *args, **kwargs)

    loop_simulation = loop.Simulation
    monkeypatch.setattr(loop, "Simulation", simulation)
    monkeypatch.setattr("plate_vision.vision.update", update)
    min_gap = np.inf
    for moment in loop.run(loop.Setup(expected, seed=4, effort=FEW_STARTS), rig):
        rows = [moment.world.ids.index(name) for name in world["unknown"]]
        away = rig.plate.half - np.abs(moment.world.position[rows])
        min_gap = min(min_gap, float(away.min()))
    assert moment.progress.phase == "done"
    assert f"{MORE} unknown objects are on the plate (unknown_1 at (" in moment.progress.text
    assert moment.world.dropped == 0
    assert min_gap > rig.edge_margin("unknown").min_m
