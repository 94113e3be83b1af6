"""The list of nodes that make up the closed loop, and the parameters of one run."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import yaml

from plate_core import PlateError, config_path
from plate_core.tasks import FeedTask, load_scenario
from plate_core.yaml_fields import Fields, read_yaml

Value = str | int | float | bool

JUDGING = ("simulator", "detector", "planner", "solver")
"""Nodes with the parameter input_timeout_s."""

OWN = {
    "simulator": ("scenario", "seed", "lockstep", "rate", "simulated_time", "image_rate"),
    "device": ("seed",),
    "planner": ("lockstep",),
    "solver": ("method", "seed"),
    "driver": ("transport", "autostart"),
    "page": ("scenario",),
}
"""Options of a run that are parameters of a node, under the same name."""

UNTIMED_S = 30.0
"""Their timeout [s, wall] where time is simulated: how long a step takes then tells nothing."""


SERIAL_ANSWER_S, SERIAL_HANDOVER_S = 0.14, 0.08
"""The planner's answer_s, and the solver's handover_s, with a serial line, on which a table takes
its time [s]."""


class GraphError(PlateError):
    """The list of nodes is wrong, or a node does not do its part."""


@dataclass(frozen=True)
class GraphNode:
    """A node of the graph.

    Attributes
    ----------
    name, package, executable : str
        What `ros2 run PACKAGE EXECUTABLE` starts, and the name it has in the graph.
    component : str
        Its class.
    on_hardware : bool
        Whether it runs on hardware too; False for what stands in for the hardware.
    transport : str
        The only transport that it is for; empty: all.
    view : bool
        Whether it only shows the graph. Such a node is started only on request.
    feed : bool
        Whether it is for a task of `feed` alone.
    camera : bool
        Whether it runs only if the option `camera` is given.
    """

    name: str
    package: str
    executable: str
    component: str
    on_hardware: bool
    transport: str = ""
    view: bool = False
    feed: bool = False
    camera: bool = False


def load_graph(path: str | Path | None = None) -> tuple[GraphNode, ...]:
    """Read the list of nodes, in the order in which they are to be started.

    Parameters
    ----------
    path : path, optional
        YAML file; config/graph.yaml if left out.

    Raises
    ------
    GraphError
        If the file is broken, or a name is given twice.
    """
    fields = read_yaml(path or config_path("graph.yaml"), GraphError)
    nodes = tuple(_node(child) for child in fields.children("nodes"))
    fields.finish()
    names = [node.name for node in nodes]
    if len(set(names)) < len(names) or not names:
        raise fields.fail("nodes", "at least one node, each name once")
    return nodes


def _node(fields: Fields) -> GraphNode:
    node = GraphNode(
        fields.text("name"),
        fields.text("package"),
        fields.text("executable"),
        fields.text("component"),
        fields.flag("on_hardware"),
        fields.text("transport") if fields.has("transport") else "",
        fields.has("view") and fields.flag("view"),
        fields.has("feed") and fields.flag("feed"),
        fields.has("camera") and fields.flag("camera"),
    )
    fields.finish()
    return node


@dataclass(frozen=True)
class RunOptions:
    """What is to be run, and how: becomes parameters of the nodes.

    Attributes
    ----------
    scenario : str
        Name or path: to the simulator.
    method : str
        Of the solver.
    seed : int
        Of simulator and solver.
    transport, port : str
        Of the driver.
    camera : str
        Device of the camera node. If empty, images come from the simulator or another node.
    hardware : bool
        Whether nothing is simulated. A port has the same effect. With a camera but no port, only
        the motor controller is simulated.
    link : str
        The simulated device's port.
    firmware : str
        Program of the firmware for drives, which the simulated device runs; empty: no bus.
    lockstep : bool
        The simulator waits for every answer; time is the simulator's.
    rate : float
        Simulated seconds per wall second; other than 1, time is the simulator's.
    simulated_time : bool
        Time is the simulator's at rate 1 too: its parameter `rate` may change while it runs.
    image_rate : float
        Images of a simulated camera that runs free [1/s]; 0: one at the start of each cycle.
    rig_file : str
        To all nodes; empty: the default rig.
    autostart : bool
        False: the driver waits until it is configured and activated from outside.
    one_process : bool
        All nodes in one process, `plate_bringup one_process`.
    view : bool
        The live page too.
    recipe : str
        What the feeder feeds, as `scenario`; empty: the scenario, if it is one of `feed`.
    robot_port : int
        On which the feeder serves robots; 0: any free one.
    """

    scenario: str = "sort_10"
    method: str = "sinusoids"
    seed: int = 0
    transport: str = "sim"
    port: str = ""
    camera: str = ""
    hardware: bool = False
    link: str = "/tmp/plate_device"
    firmware: str = ""
    lockstep: bool = False
    rate: float = 1.0
    simulated_time: bool = False
    image_rate: float = 0.0
    rig_file: str = ""
    autostart: bool = True
    one_process: bool = False
    view: bool = False
    recipe: str = ""
    robot_port: int = 7171

    @property
    def feeds(self) -> str:
        """What the feeder feeds; empty: there is none."""
        if self.recipe or self.hardware or self.port or self.camera:
            return self.recipe
        return self.scenario if isinstance(load_scenario(self.scenario).task, FeedTask) else ""

    def nodes(self, graph: Iterable[GraphNode]) -> tuple[GraphNode, ...]:
        """Return the nodes of the graph that this run needs."""
        real = self.hardware or bool(self.port)
        return tuple(
            node
            for node in graph
            if (node.on_hardware or not (real or (self.camera and not node.transport)))
            and (not node.camera or bool(self.camera))
            and node.transport in ("", self.transport)
            and (self.view or not node.view)
            and (not node.feed or bool(self.feeds))
        )

    @property
    def over_link(self) -> bool:
        """Whether the driver talks to the simulated device."""
        return self.transport == "serial" and not (self.hardware or self.port)

    def parameter_file(
        self, nodes: Iterable[GraphNode], given: Collection[str] | None = None, space: str = "**"
    ) -> str:
        """Return `parameters` of several nodes as a file of ROS parameters.

        Parameters
        ----------
        space : str, optional
            Namespace of the nodes, without slashes at its ends; empty: none. Any, if left out.
        """
        where = f"/{space}".rstrip("/")
        values = {
            f"{where}/{node.name}": {"ros__parameters": self.parameters(node, given)}
            for node in nodes
        }
        return str(yaml.safe_dump({name: v for name, v in values.items() if v["ros__parameters"]}))

    def parameters(self, node: GraphNode, given: Collection[str] | None = None) -> dict[str, Value]:
        """Return the parameters of a node, over those of nodes.yaml.

        Parameters
        ----------
        given : names, optional
            Options that were chosen: all others are left as nodes.yaml has them. If left out all
            options were.
        """
        chosen = {option.name for option in fields(self)} if given is None else {*given}
        names = [name for name in OWN.get(node.name, ()) if name in chosen]
        values: dict[str, Value] = {name: getattr(self, name) for name in names}
        if node.name == "driver" and (self.port or self.over_link):
            values["port"] = self.port or self.link
        if node.name == "camera":
            values["device"] = self.camera
        if node.name == "feeder":
            values["recipe"] = self.feeds
            if "robot_port" in chosen:
                values["port"] = self.robot_port
        if node.name == "device":
            values["link"] = self.link
            if self.firmware:
                values["firmware"] = self.firmware
        if node.name == "simulator" and self.over_link:
            values["driven_by"] = "device"
        serial = self.transport == "serial" and not self.hardware  # that has a file of its own
        if node.name == "planner" and (self.image_rate > 0 or serial):
            values["camera_triggered"] = False
            if self.transport == "serial":
                values["answer_s"] = SERIAL_ANSWER_S
        if node.name == "solver" and serial:
            values["handover_s"] = SERIAL_HANDOVER_S
        if self.rig_file:
            values["rig_file"] = self.rig_file
        if self.lockstep or self.rate != 1 or self.simulated_time:
            if node.on_hardware:
                values["use_sim_time"] = True
            if node.name in JUDGING:
                values["input_timeout_s"] = UNTIMED_S
        return values
