"""A running graph: its processes, and us watching them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from plate_bringup import RunOptions, load_graph
from plate_core import load_rig
from plate_core.tasks import Scenario, load_scenario

from . import relays
from .domains import own_domain
from .observer import Observer
from .processes import Processes

START_S = 180.0
"""Longest wait for the nodes [s]: a busy machine may take long to load them."""

ANSWER_S = 180.0
"""Longest wait for the answer to the first image [s]."""

PAGE_S = 10.0
"""Longest wait for the page, when all others answer [s]."""

CAMERA_S = 3.0
"""Longest wait for a camera that is not simulated [s]."""


@dataclass(frozen=True)
class Session:
    """The nodes of a run, all seen over DDS, and the first image answered.

    Attributes
    ----------
    options : RunOptions
    processes : Processes
    observer : Observer
    nodes : list of str
        Names as seen over DDS.
    """

    options: RunOptions
    processes: Processes
    observer: Observer
    nodes: list[str]

    @property
    def scenario(self) -> Scenario:
        """What is to be done."""
        return load_scenario(self.options.scenario)

    def free(self) -> None:
        """Set the plate free: activate the driver and, where there are motors, enable them.

        The caller stands for the person who enables.

        Raises
        ------
        GraphError
            If somebody has stopped the plate meanwhile, or the driver refuses.
        """
        self.observer.check_not_stopped()
        if not driver_triggers(self.options):
            self.observer.activate_driver()
        self.observer.check_not_stopped()  # by anyone: an enable would clear that
        if self.options.transport == "serial":
            print("Calling the service enable: from now on the motors may move.", flush=True)
            self.observer.enable()

    def page(self) -> str:
        """Return the address of the live page; empty if there is none."""
        record = self.observer.record
        if self.options.view:
            self.observer.until(lambda: bool(record.last("page", "url")), PAGE_S)
        return record.last("page", "url")

    def begin(self) -> None:
        """Set the plate free and start the task.

        In lockstep the planner waits for the goal at the second image: the task begins with it.
        """
        self.free()
        self.observer.await_ready()
        self.observer.check_not_stopped()
        self.observer.start(self.scenario)


def driver_triggers(options: RunOptions) -> bool:
    """Tell whether the camera takes images only once the driver speaks with the motor controller,
    which triggers it."""
    return options.transport == "serial" and load_rig(options.rig_file).camera.trigger is not None


@contextmanager
def session(
    options: RunOptions,
    logs: Path,
    domain: int | None = None,
    pictures: bool = True,
    waiting: Callable[[str], None] = lambda _: None,
    watched: bool = True,
    gated: bool = False,
) -> Iterator[Session]:
    """Start the nodes, and stop them at the end.

    Parameters
    ----------
    options : RunOptions
        With `autostart` False `Session.free` activates the driver.
    logs : path
        Folder for the nodes' logs.
    domain : int, optional
        ROS domain; if left out, one of its own.
    pictures : bool
        Whether the observer listens to images.
    waiting : callable
        Called with what is waited for, while it is.
    watched : bool
        Whether a node that ends by itself ends all.
    gated : bool
        Whether the main input of each node comes through the gate of `relays`.

    Raises
    ------
    GraphError
        If a node ends or does not appear, there is no camera, or images are not answered: why.
    """
    nodes = options.nodes(load_graph())
    remaps = relays.remaps(options.transport) if gated else {}
    with (
        own_domain(domain) as domain,
        Processes(nodes, options, logs, domain, remaps=remaps) as processes,
        Observer(
            domain,
            processes.check if watched else lambda: None,
            pictures,
            waiting,
            any(node.name == "simulator" for node in nodes),
        ) as observer,
    ):
        if gated:
            processes.add({relays.GATE: relays.command(relays.GATE, options.transport)})
        loop = [node.name for node in nodes if not node.view]
        seen = observer.await_nodes(loop, START_S)
        if driver_triggers(options) and not options.autostart:
            observer.until(Path(options.port or options.link).exists, START_S)
            observer.activate_driver()  # motors stay off until they are enabled
        if "simulator" not in seen:
            observer.await_camera(CAMERA_S)
        observer.await_answers(ANSWER_S, seen)
        yield Session(options, processes, observer, seen)
