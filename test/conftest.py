"""Fixtures of several tests: a running graph, and the firmware compiled for this machine."""

import contextlib
import os
import shutil
from functools import partial
from pathlib import Path

import pytest
import yaml
from device_orders import running
from graph.domains import own_domain
from simulated_firmware import SimulatedFirmware, compiled

from plate_core import config_path

FOUR = {
    "description": "As `play`, but with few parts, far from the edges.",
    "parts": [
        {"class": "black", "positions_m": [[0.06, 0.05], [-0.08, 0.03]]},
        {"class": "grey", "positions_m": [[-0.05, -0.06], [0.07, -0.04]]},
    ],
    "task": {"kind": "move", "tolerance_m": 0.002, "hold_s": 0.5, "until_canceled": True},
}
"""Scenario in which no part leaves the plate, even if images or results are late."""


@pytest.fixture
def domain():
    """A ROS domain that only this test uses."""
    with own_domain() as domain:
        yield domain


@pytest.fixture(scope="module")
def graph(tmp_path_factory, request):
    """A running graph with the live page. It runs in lockstep if the module has `LOCKSTEP =
    True`."""
    from graph.session import ANSWER_S, session  # only where there is ROS
    from light_graph import LightOptions

    folder = tmp_path_factory.mktemp("logs")
    (folder / "four.yaml").write_text(yaml.safe_dump(FOUR), encoding="utf-8")
    lockstep = getattr(request.module, "LOCKSTEP", False)
    # The page's `save_home` and others write into the rig file, so the graph has a copy of it.
    shutil.copy(config_path("rig.yaml"), folder)
    options = LightOptions(
        scenario=str(folder / "four.yaml"),
        rig_file=str(folder / "rig.yaml"),
        view=True,
        lockstep=lockstep,
    )
    # The page's `teach` writes its file into the detector's working folder.
    with contextlib.chdir(folder), session(options, folder, pictures=False) as running:
        assert running.page(), running.processes.tail("page")
        running.observer.await_ready()
        ready = running.observer.record.driver.text
        # The planner may receive this status later, and accepts no goal before.
        received = partial(running.observer.record.last, "planner", "driver_status")
        assert running.observer.until(lambda: received() == ready, ANSWER_S), received()
        if lockstep:
            give_way(running.processes)
        yield running


def give_way(processes):
    """Lower the priority of a graph in lockstep, because other programs run in real time."""
    for name in processes.names:
        for thread in Path(f"/proc/{processes.pid(name)}/task").iterdir():
            os.setpriority(os.PRIO_PROCESS, int(thread.name), 10)


@pytest.fixture(scope="module")
def url(graph):
    """Address of the graph's page."""
    return graph.page()


@pytest.fixture(name="program", scope="session")
def _program(tmp_path_factory):
    folder = tmp_path_factory.mktemp("firmware")
    return compiled(folder, "*.c", "host/host.c", "host/motors.c")


@pytest.fixture(name="device")
def _device(program):
    """The firmware, as a function from orders to its output."""
    return running(program)


@pytest.fixture(name="firmware")
def _firmware(program):
    """The firmware in simulated time, on a separate line."""
    firmware = SimulatedFirmware(program)
    yield firmware
    firmware.end()
