"""What several tests here share: a graph that runs, and the firmware, built for this machine."""

import contextlib
import os
from functools import partial
from pathlib import Path

import pytest
import yaml
from device_orders import running
from graph.domains import own_domain
from simulated_firmware import SimulatedFirmware, compiled

FOUR = {
    "description": "As `play`, but with few parts, far from the edges.",
    "parts": [
        {"class": "black", "positions_m": [[0.06, 0.05], [-0.08, 0.03]]},
        {"class": "grey", "positions_m": [[-0.05, -0.06], [0.07, -0.04]]},
    ],
    "task": {"kind": "move", "tolerance_m": 0.002, "hold_s": 0.5, "until_canceled": True},
}
"""None leaves the plate where images or answers are late."""


@pytest.fixture
def domain():
    """A ROS domain for this test alone."""
    with own_domain() as domain:
        yield domain


@pytest.fixture(scope="module")
def graph(tmp_path_factory, request):
    """A graph that runs, with the live page; in lockstep if the module says `LOCKSTEP = True`."""
    from graph.session import ANSWER_S, session  # only where there is ROS
    from light_graph import LightOptions

    folder = tmp_path_factory.mktemp("logs")
    (folder / "four.yaml").write_text(yaml.safe_dump(FOUR), encoding="utf-8")
    lockstep = getattr(request.module, "LOCKSTEP", False)
    options = LightOptions(scenario=str(folder / "four.yaml"), view=True, lockstep=lockstep)
    # The page's `teach` writes its file where the detector runs.
    with contextlib.chdir(folder), session(options, folder, pictures=False) as running:
        assert running.page(), running.processes.tail("page")
        running.observer.await_ready()
        ready = running.observer.record.driver.text
        # The planner hears it at a time of its own, and takes no goal before.
        heard = partial(running.observer.record.last, "planner", "driver_status")
        assert running.observer.until(lambda: heard() == ready, ANSWER_S), heard()
        if lockstep:
            give_way(running.processes)
        yield running


def give_way(processes):
    """Let programs with a time of their own be first: a graph in lockstep takes what is left."""
    for name in processes.names:
        for thread in Path(f"/proc/{processes.pid(name)}/task").iterdir():
            os.setpriority(os.PRIO_PROCESS, int(thread.name), 10)


@pytest.fixture(scope="module")
def url(graph):
    """Address of its page."""
    return graph.page()


@pytest.fixture(name="program", scope="session")
def _program(tmp_path_factory):
    folder = tmp_path_factory.mktemp("firmware")
    return compiled(folder, "*.c", "host/host.c", "host/motors.c")


@pytest.fixture(name="device")
def _device(program):
    """It, as a function from orders to what is printed."""
    return running(program)


@pytest.fixture(name="firmware")
def _firmware(program):
    """The firmware in simulated time, on a line of its own."""
    firmware = SimulatedFirmware(program)
    yield firmware
    firmware.end()
