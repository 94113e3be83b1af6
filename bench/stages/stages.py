"""Computation time of each stage of the loop for one image.

`loop.run` runs the loop. After a run of the loop, every stage gets the inputs of this run again,
and is timed.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np

from harness import Result, Table, timed
from plate_bringup.loop import Moment, Setup, run
from plate_core import PlateCycle, Rig, load_rig, part_class
from plate_core.tasks import Scenario
from plate_driver.setpoints import prepare
from plate_planner import Planner
from plate_sim import Camera, part_greys, run_cycle
from plate_solver import Controller
from plate_vision import Tracker, make_vision, observe
from tasks.runs import sorting_scenario

PARTS = (1, 2, 4, 6, 8, 10, 16)
IMAGES = 40
"""Number of images of a run."""

FIRST = 4
"""Number of first images that are not counted, because the loop has not detected all parts yet, or
fills caches."""

STAGES = ("camera", "vision", "planner", "solver", "driver", "simulator")


def measure(quick: bool) -> Result:
    """Time all stages for several numbers of parts to sort."""
    rig = load_rig()
    rows = []
    for parts in (2, 10) if quick else PARTS:
        scenario = sorting_scenario(parts)
        moments = list(islice(run(Setup(scenario), rig), 15 if quick else IMAGES))
        rows.append(stages_row(rig, scenario, moments))
    return Result([Table.of("stages", rows)])


def stages_row(rig: Rig, scenario: Scenario, moments: list[Moment]) -> dict[str, Any]:
    """Give every stage the inputs of the run again, and return the row of its times."""
    camera, vision, tracker = Camera(rig), make_vision(rig), Tracker()
    planner, controller = Planner(rig, scenario), Controller(rig)
    state = planner.start(planner.initial())
    grey = part_greys([part_class(name) for name in moments[0].world.ids])
    rng = np.random.default_rng(0)
    seconds: dict[str, list[float]] = {name: [] for name in STAGES}

    def run_stage(stage: str, call: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        result, spent = timed(call, *arguments, **named)
        seconds[stage].append(spent)
        return result

    running = PlateCycle.rest(0.1)
    for moment in moments:
        world, now = moment.world, round(moment.time * 1e9)
        run_stage("camera", camera.render, world.position, grey, rng, world.velocity)
        tracker = run_stage("vision", observe, vision, tracker, moment.image, moment.time)
        state, _, _ = run_stage("planner", planner.plan, state, tracker.parts, moment.time)
        result = run_stage("solver", controller.solve, moment.request, running)
        run_stage("driver", prepare, rig, result.cycle, now, before=(running,))
        run_stage("simulator", run_cycle, world, running, rig)
        # The recorded inputs of the next cycle belong to the cycle that the control loop has
        # played. Therefore continue with this cycle.
        running = prepare(rig, moment.result.cycle, now, before=(running,))[0].cycle
    medians = {name: 1e3 * float(np.median(seconds[name][FIRST:])) for name in STAGES}
    return {
        "parts": len(grey),
        **medians,
        "answer": sum(medians[name] for name in ("vision", "planner", "solver", "driver")),
        "period": 1e3 * float(np.median([m.result.cycle.period for m in moments[FIRST:]])),
    }
