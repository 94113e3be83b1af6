"""A running graph: its processes, and the observer that watches these processes.

`session` starts the nodes, waits until the first image is answered, and stops the nodes at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from plate_bringup import RunOptions, load_graph
from plate_core import load_rig
from plate_core.tasks import Scenario, load_scenario

from . import gate
from .domains import own_domain
from .observer import Observer
from .processes import Processes

START_S = 180.0
"""Maximum wait until all nodes have started [s]. A busy computer can take long to load the
nodes."""

ANSWER_S = 180.0
"""Maximum wait for the answer to the first image [s]."""

PAGE_S = 10.0
"""Maximum wait for the live page after the other nodes have processed an image [s]."""

CAMERA_S = 3.0
"""Maximum wait for a camera that is not simulated [s]."""


@dataclass(frozen=True)
class Session:
    """Running nodes that are all visible in the ROS graph, and have answered the first image.

    Attributes
    ----------
    options : RunOptions
    processes : Processes
    observer : Observer
    nodes : list of str
        Names of the nodes, without display nodes.
    """

    options: RunOptions
    processes: Processes
    observer: Observer
    nodes: list[str]

    @property
    def scenario(self) -> Scenario:
        """Scenario of the run."""
        return load_scenario(self.options.scenario)

    def free(self) -> None:
        """Activate the driver and, with transport serial, enable the motors.

        The caller has the responsibility of an operator when the motors are enabled.

        Raises
        ------
        GraphError
            If somebody has stopped the motors or the task meanwhile, or if the driver refuses.
        """
        self.observer.check_not_stopped()
        if not driver_triggers(self.options):
            self.observer.activate_driver()
        if self.options.transport == "serial":
            print("Calling the service enable: from now on the motors can move.", flush=True)
            # check again for a stop, because enabling the motors would clear the stop
            self.observer.enable(self.observer.check_not_stopped)

    def page(self) -> str:
        """Return the address of the live page, or an empty text if there is no page."""
        record = self.observer.record
        if self.options.view:
            self.observer.until(lambda: bool(record.last("page", "url")), PAGE_S)
        return record.last("page", "url")

    def begin(self) -> None:
        """Activate the driver as `free` does, and start the task.

        In lockstep, the planner processes the second image only when the goal arrives. Therefore
        the task begins with this image.
        """
        self.free()
        self.observer.await_ready()
        self.observer.check_not_stopped()
        self.observer.start(self.scenario)


def driver_triggers(options: RunOptions) -> bool:
    """Return whether the motor controller triggers the camera. Images of a triggered camera arrive
    only after the driver is connected to the controller."""
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
    """Context with a running graph. The nodes are stopped at the end of the context.

    Parameters
    ----------
    options : RunOptions
        If `autostart` is False, `Session.free` activates the driver.
    logs : path
        Folder for the nodes' logs.
    domain : int, optional
        ROS domain. Default: a free domain.
    pictures : bool
        Whether the observer records images.
    waiting : callable
        Function that is called during a wait, with a text about the missing event.
    watched : bool
        Whether a wait raises GraphError if a node has ended.
    gated : bool
        Whether the main input of each node passes through the gate (module `gate`).

    Raises
    ------
    GraphError
        If a node ends or does not appear, if there is no camera, or if images are not answered. The
        message contains the reason.
    """
    nodes = options.nodes(load_graph())
    remaps = gate.gate_remappings(options.transport) if gated else {}
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
            processes.add({gate.GATE: gate.gate_command(options.transport)})
        loop = [node.name for node in nodes if not node.view]
        seen = observer.await_nodes(loop, START_S)
        if driver_triggers(options) and not options.autostart:
            observer.until(Path(options.port or options.link).exists, START_S)
            # activation does not switch on the motors; they stay off until `enable` is called
            observer.activate_driver()
        if "simulator" not in seen:
            observer.await_camera(CAMERA_S)
        observer.await_answers(ANSWER_S, seen)
        yield Session(options, processes, observer, seen)
