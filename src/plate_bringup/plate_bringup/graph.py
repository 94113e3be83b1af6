"""List of the nodes of the closed loop, and their parameters for a run."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import yaml

from plate_core import PlateError, config_path
from plate_core.tasks import FeedTask, load_scenario
from plate_core.yaml_fields import Fields, read_yaml

Value = str | int | float | bool

NODES_WITH_TIMEOUT = ("simulator", "detector", "planner", "solver")
"""Nodes that have the parameter input_timeout_s."""

OWN = {
    "simulator": ("scenario", "seed", "lockstep", "rate", "simulated_time", "image_rate"),
    "device": ("seed",),
    "planner": ("lockstep",),
    "solver": ("method", "seed"),
    "driver": ("transport", "autostart"),
    "page": ("scenario",),
}
"""Options of a run that set a parameter with the same name, by node."""

UNTIMED_S = 30.0
"""Value of `input_timeout_s` for all nodes with this parameter if time is simulated [s, wall]. The
timeout is long, because a cycle of simulated time can take a long wall time."""


SERIAL_ANSWER_S = 0.14
"""Value of the planner's parameter `answer_s` with the transport serial [s]. This value includes
the transmission time of a table."""

SERIAL_HANDOVER_S = 0.08
"""Value of the solver's parameter `handover_s` with the transport serial [s]. This value includes
the transmission time of a table."""


class GraphError(PlateError):
    """Error: the list of nodes is wrong, or a node does not work as required."""


@dataclass(frozen=True)
class GraphNode:
    """Node of the graph.

    Attributes
    ----------
    name, package, executable : str
        `name` is the name of the node in the graph. `ros2 run PACKAGE EXECUTABLE` starts the node.
    component : str
        Qualified name of the node's class.
    on_hardware : bool
        Whether the node also runs with hardware. False for a node that simulates hardware.
    transport : str
        Transport with which the node runs. Empty if the node runs with all transports.
    view : bool
        Whether the node only displays the state of the graph. Such a node runs only with the option
        `view`.
    feed : bool
        Whether the node runs only if the task is a feed task.
    camera : bool
        Whether the node runs only if the option `camera` is given.
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
    """Read the list of nodes, in the order in which they are started.

    Parameters
    ----------
    path : path, optional
        YAML file. Default: config/graph.yaml.

    Raises
    ------
    GraphError
        If the file is invalid, or if a name occurs twice.
    """
    fields = read_yaml(path or config_path("graph.yaml"), GraphError)
    nodes = tuple(_read_node(child) for child in fields.children("nodes"))
    fields.finish()
    names = [node.name for node in nodes]
    if len(set(names)) < len(names) or not names:
        raise fields.fail("nodes", "at least one node, each name once")
    return nodes


def _read_node(fields: Fields) -> GraphNode:
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
    """Options of a run. These options determine the nodes and their parameters.

    Attributes
    ----------
    scenario : str
        Scenario of the simulator: name or path.
    method : str
        Method of the solver.
    seed : int
        Random seed of simulator and solver.
    transport, port : str
        Transport and serial port of the driver.
    camera : str
        Device of the camera node. Empty: the simulator or another node publishes the images.
    hardware : bool
        Whether the run is on hardware, without the simulator. If `port` is given, the run is also
        on hardware. With a camera but without a port, only the motor controller is simulated.
    link : str
        Serial port of the simulated device.
    firmware : str
        Firmware program for drives on a CAN bus, which the simulated device runs. Empty: no CAN
        bus.
    lockstep : bool
        Whether the simulator waits after each image until the new cycle has arrived. If True, time
        is simulated.
    rate : float
        Simulated seconds per second. If the value is not 1, time is simulated.
    simulated_time : bool
        Whether time is simulated even at rate 1, so that the simulator's parameter `rate` can be
        changed during the run.
    image_rate : float
        Image rate of a free-running camera in the simulation [1/s]. 0 means one image at the start
        of each cycle.
    rig_file : str
        Rig file of all nodes. Empty for the default rig.
    autostart : bool
        Whether the driver is configured and activated at the start. If false, another program must
        do this.
    one_process : bool
        Whether `plate_bringup one_process` runs all nodes in one process.
    view : bool
        Whether to show the live page.
    recipe : str
        Scenario of the feeder: name or path. Empty: `scenario` is used if it is a feed task.
    robot_port : int
        TCP port of the feeder, to which robots connect. 0 means any free port.
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
    def feed_scenario(self) -> str:
        """Scenario of the feeder. Empty if the run has no feeder."""
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
            and (not node.feed or bool(self.feed_scenario))
        )

    @property
    def is_simulated_time(self) -> bool:
        """Whether the nodes use the time that the simulator publishes."""
        return self.lockstep or self.rate != 1 or self.simulated_time

    @property
    def over_link(self) -> bool:
        """Whether the driver is connected to the simulated motor controller."""
        return self.transport == "serial" and not (self.hardware or self.port)

    def parameter_file(
        self, nodes: Iterable[GraphNode], given: Collection[str] | None = None, space: str = "**"
    ) -> str:
        """Return the parameters of several nodes as the text of a ROS parameter file.

        Parameters
        ----------
        space : str, optional
            Namespace of the nodes, without slashes at the beginning and the end. Empty if there is
            no namespace. By default, the parameters apply to all namespaces.
        """
        where = f"/{space}".rstrip("/")
        values = {
            f"{where}/{node.name}": {"ros__parameters": self.parameters(node, given)}
            for node in nodes
        }
        return str(yaml.safe_dump({name: v for name, v in values.items() if v["ros__parameters"]}))

    def parameters(self, node: GraphNode, given: Collection[str] | None = None) -> dict[str, Value]:
        """Return the parameters of a node that options of the run set, because their values differ
        from nodes.yaml.

        Parameters
        ----------
        given : names, optional
            Names of the options that set parameters. For the other options, the values in
            nodes.yaml remain. Default: all options.
        """
        chosen = {option.name for option in fields(self)} if given is None else {*given}
        names = [name for name in OWN.get(node.name, ()) if name in chosen]
        values: dict[str, Value] = {name: getattr(self, name) for name in names}
        if node.name == "driver" and (self.port or self.over_link):
            values["port"] = self.port or self.link
        if node.name == "camera":
            values["device"] = self.camera
        if node.name == "feeder":
            values["recipe"] = self.feed_scenario
            if "robot_port" in chosen:
                values["port"] = self.robot_port
        if node.name == "device":
            values["link"] = self.link
            if self.firmware:
                values["firmware"] = self.firmware
        if node.name == "simulator" and self.over_link:
            values["driven_by"] = "device"
        # On hardware, hardware.yaml sets the value of camera_triggered.
        serial = self.transport == "serial" and not self.hardware
        if node.name == "planner" and (self.image_rate > 0 or serial):
            values["camera_triggered"] = False
            if self.transport == "serial":
                values["answer_s"] = SERIAL_ANSWER_S
        if node.name == "solver" and serial:
            values["handover_s"] = SERIAL_HANDOVER_S
        if self.rig_file:
            values["rig_file"] = self.rig_file
        if self.is_simulated_time:
            if node.on_hardware:
                values["use_sim_time"] = True
            if node.name in NODES_WITH_TIMEOUT:
                values["input_timeout_s"] = UNTIMED_S
        return values
