"""The node `page`. The node serves a live web page of the graph, and executes the commands of this
page."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from plate_core import PlateError, config_path, load_rig
from plate_core.ros import DATA, NodeOptions, SafeLifecycleNode, parameter, run_node
from plate_core.status import Finding, Level
from plate_core.tasks import check_scenario, load_scenario, read_scenario, scenario_names
from plate_core.yaml_fields import read_yaml
from plate_interfaces.msg import Targets

from .access import Access
from .commands import URGENT, Command
from .inbox import Inbox
from .ros import TOPICS, Listener, Operator, PendingCommand, Replay, Stops
from .scene import Scene, rig_scene, type_scene
from .server import PageServer, Socket
from .top_view import TopView

FRAME_S = 0.04
"""Minimum time between two messages of the same kind to the browsers [s]."""

SLOW_S = 0.5
"""Minimum time between two messages of the same kind if their data change slowly [s]."""


SWITCH_S = 0.0005
"""Interval at which Python switches between threads [s]. The thread that stops the plate therefore
starts to run after at most this time."""

ALWAYS_THERE = ("black", "grey")
"""Types of parts that every rig has."""

REPLAY = ("begin", "end", "now", "playing", "rate", "problem")
"""Attributes of a replay that are sent to browsers."""


@dataclass(frozen=True)
class Options(NodeOptions):
    """Parameters of the page."""

    address: str = parameter(
        "127.0.0.1",
        "IP address of the page's server. 0.0.0.0 means all networks, and requires a token.",
    )
    port: int = parameter(8080, "TCP port. If it is in use, the next free port is used.", 1, 65000)
    operator_token: str = parameter(
        "", "Token of operators: commands require ?token=TOKEN at the end of the page's address. "
        "If it is empty, every browser on this machine may send commands.",
    )  # fmt: skip
    viewer_token: str = parameter(
        "", "Token of read-only browsers: they require ?token=TOKEN at the end of the page's "
        "address. If it is empty, no token gives read-only access.",
    )  # fmt: skip
    scenario: str = parameter("", "Scenario that the page selects at first.")
    bag: str = parameter(
        "", "Folder of a recorded bag, which the page replays instead of showing the graph."
    )


class PageNode(SafeLifecycleNode[Options]):
    """Node `page`. The node serves a live web page of the graph. The node executes the commands of
    the page with the public actions, topics, services and parameters of the graph.

    While a browser is connected, the node subscribes to parts, part_forces, part_targets,
    cycle_started, motor_setpoints, task_status, driver_status, friction, diagnostics and /rosout.
    The node subscribes to image_raw if a browser shows the image. It publishes targets. Without a
    browser there are no subscriptions.
    """

    def __init__(self) -> None:
        super().__init__("page", Options)
        self._server: PageServer | None = None
        self._listener: Listener | None = None
        self._replay: Replay | None = None
        self._inbox, self._adapts = Inbox(), False
        self.report(self._diagnose, self._diagnostic_values)

    def configure(self) -> None:
        """Read the rig, and create clients and publishers."""
        options = self.options
        self._rig = load_rig(options.rig_file)
        self._access = Access(options.address, options.operator_token, options.viewer_token)
        self._view = TopView(self._rig)
        targets = self.managed_publisher(Targets, "targets", DATA)
        expected = load_scenario(options.scenario) if options.scenario else None
        self._operator = Operator(self, self._rig, targets.publish, expected)
        self.keep(Operator.close, self._operator)
        self._stops = Stops(self)
        self.keep(Stops.close, self._stops)
        work = self.create_guard_condition(self._process_next)
        self.keep(self.destroy_guard_condition, work)
        self._wake = work.trigger
        self._frames = self.managed_timer(FRAME_S, self._on_tick_timer)
        self.managed_timer(SLOW_S, self._on_slow_tick_timer)

    def begin(self) -> None:
        """Start serving the page."""
        if self.options.bag:
            kinds = {name.removeprefix("/"): topic.kind for name, topic in TOPICS.items()}
            own_namespace = self.get_namespace()
            self._replay = Replay(self.options.bag, kinds, self._forward_message, own_namespace)
        port = self.options.port
        self._server = PageServer(
            self._access, port, self._make_hello(), self._queue_command, self._request_adaptation
        )
        namespace = self.get_namespace() if self._replay is None else self._replay.namespace
        self._listener = Listener(self, self._rig, self._view, self._server, namespace)
        self._operator.begin(self._server, self._listener)
        if self._replay is not None:
            self._replay.seek(self._replay.begin)
        else:
            self._frames.cancel()  # the timer runs only while a browser is connected
        self.get_logger().info(f"page at {self._server.url}")

    def rest(self) -> None:
        """Stop serving the page. Running tasks continue."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        if self._listener is not None:
            self._listener.close()
        replay, self._replay = self._replay, None
        if replay is not None:
            replay.close()

    def _make_hello(self) -> Scene:
        """Return the first message that every browser receives."""
        rig, options = self._rig, self.options
        types = sorted({*rig.types, *ALWAYS_THERE})
        return {
            "rig": rig_scene(rig, Path(options.rig_file).stem or "default rig"),
            "image": {"x": self._view.x, "y": self._view.y},
            "types": {name: type_scene(rig.part_type(name)) for name in types},
            "scenarios": self._list_scenarios(),
            "scenario": Path(options.scenario).stem,
            "simulator": False,
            "replay": bool(options.bag),
        }

    def _list_scenarios(self) -> Scene:
        """Return the scenarios that this rig can execute, and the contents of their files."""
        found = {}
        own_files = (
            [self.options.scenario] if self.options.scenario not in ("", *scenario_names()) else []
        )
        for name in [*own_files, *scenario_names()]:
            with contextlib.suppress(PlateError):
                path = (
                    Path(name) if name in own_files else config_path("scenarios") / f"{name}.yaml"
                )
                fields = read_yaml(path, PlateError)
                scenario = read_scenario(fields, path.stem, path.parent)
                check_scenario(scenario, self._rig)
                found[scenario.name] = fields.data
        return found

    def _on_tick_timer(self) -> None:
        if self._replay is not None:
            self._replay.step()
        if self._listener is not None:
            self._listener.tick()

    def _on_slow_tick_timer(self) -> None:
        # check repeatedly, because a simulator may start or end at any time
        if self._server is not None:
            simulators = self.count_services(self.resolve_service_name("simulator/reset"))
            self._server.hello["simulator"] = bool(simulators)
        if self._listener is not None:
            self._listener.tick_slowly()
        self._publish_replay()

    # The functions below are called on the server's thread. These functions pass commands to the
    # thread of the ROS node.

    def _queue_command(self, browser: Socket, command: Command) -> None:
        if command.name in URGENT and self._replay is None:
            self._stops.do(PendingCommand(browser.page, browser, command))
            return
        self._inbox.put(browser, command)
        self._wake()

    def _request_adaptation(self) -> None:
        self._adapts = True
        self._wake()

    def _process_next(self) -> None:
        """Execute the next command from the queue. Then return to the ROS executor, so that other
        callbacks can run."""
        if self._inbox:
            self._execute_next_command()
        if self._inbox:
            self._wake()
        if not self._adapts or self._server is None:
            return
        self._adapts = False
        if self._listener is not None and not self.options.bag:
            self._listener.adapt()
            if self._server.browsers:
                self._frames.reset()
            else:
                self._frames.cancel()

    def _execute_next_command(self) -> None:
        browser, command, old = self._inbox.take()
        if self._server is None:
            return
        if old:
            self._server.answer(
                browser, command.number, False, "the command waited too long; send it again"
            )
        elif self._replay is not None or command.name == "replay":
            self._control_replay(browser, command)
        else:
            self._operator.do(browser, command)

    # A recorded run

    def _forward_message(self, topic: str, msg: object) -> None:
        if self._listener is not None:
            self._listener.receive("/rosout" if topic == "rosout" else topic, msg)

    def _control_replay(self, browser: Socket, command: Command) -> None:
        """Play a replay, jump to another time, or change the rate. All other commands need a
        running ROS graph."""
        server, replay, values = self._server, self._replay, command.values
        assert server is not None
        why = ""
        if replay is None:
            why = "this page shows a running graph; replay requires the parameter bag"
        elif command.name != "replay":
            why = f"{command.name}: this page shows a recorded run, allowed: replay"
        else:
            try:
                if values["rate"] is not None:
                    replay.set_rate(values["rate"])
                if values["seek"] is not None:
                    replay.seek(values["seek"])
                if values["playing"] is not None:
                    replay.play(values["playing"])
            except PlateError as error:
                why = str(error)
        server.answer(browser, command.number, not why, why)
        self._publish_replay()

    def _publish_replay(self) -> None:
        replay, server = self._replay, self._server
        if replay is not None and server is not None:
            where = {name: getattr(replay, name) for name in REPLAY}
            server.publish("replay", {"kind": "replay", **where})

    # Diagnostics

    def _diagnose(self, now: float) -> Finding:
        server = self._server
        if server is None:
            return Finding(Level.WARN, "not served")
        return Finding(Level.OK, f"{server.url}, {len(server.browsers)} browsers")

    def _diagnostic_values(self) -> Mapping[str, object]:
        server = self._server
        return {} if server is None else {"url": server.url, "browsers": len(server.browsers)}


def main() -> None:
    """Run the node."""
    sys.setswitchinterval(SWITCH_S)
    run_node(PageNode, Options)
