"""Every node of the loop through every transition, twice; its inputs are read in configure."""

import importlib

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.clock import Clock  # noqa: E402
from rclpy.lifecycle import TransitionCallbackReturn  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from stepped_clock import SteppedClock, SteppedExecutor  # noqa: E402

from plate_core.rig import default_rig_path  # noqa: E402
from plate_core.ros import DATA  # noqa: E402

NODES = {
    "simulator": ("plate_sim.node", "SimulatorNode"),
    "device": ("plate_sim.device.node", "DeviceNode"),
    "detector": ("plate_vision.node", "DetectorNode"),
    "planner": ("plate_planner.node", "PlannerNode"),
    "solver": ("plate_solver.node", "SolverNode"),
    "driver": ("plate_driver.node", "DriverNode"),
}
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class Managed:
    """A node, and its diagnostics."""

    def __init__(self, name, tmp_path, monkeypatch, **parameters):
        module, kind = NODES[name]
        module = importlib.import_module(module)
        clock = SteppedClock(monkeypatch)
        if name == "driver":  # a thread of its own, which ends as time goes on
            monkeypatch.setattr("plate_driver.safety.node.Clock", Clock)
        if name == "device":
            parameters["link"] = tmp_path / "port"
        words = ["--ros-args", "-r", f"__ns:=/lifecycle_{name}"]
        for each in parameters.items():
            words += ["-p", "{}:={}".format(*each)]
        rclpy.init(args=words)
        self.node = getattr(module, kind)()
        self.ear, self.executor = rclpy.create_node("ear"), SteppedExecutor(clock)
        self.until, self.spin_for = self.executor.until, self.executor.spin_for
        self.messages = []
        topic = f"/lifecycle_{name}/diagnostics"
        self.ear.create_subscription(DiagnosticArray, topic, self._on_report, DATA)
        for each in (self.node, self.ear):
            self.executor.add_node(each)

    def _on_report(self, msg):
        self.messages += [status.message for status in msg.status]

    def trigger(self, transition):
        return getattr(self.node, f"trigger_{transition}")()

    @property
    def entities(self):
        node = self.node
        kinds = node.publishers, node.subscriptions, node.services, node.timers
        return [len(list(each)) for each in kinds]

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.executor.shutdown()
        self.node.destroy_node()
        self.ear.destroy_node()
        rclpy.shutdown()


@pytest.mark.parametrize("name", NODES)
def test_every_transition_twice(name, tmp_path, monkeypatch):
    with Managed(name, tmp_path, monkeypatch) as managed:
        empty = managed.entities
        for _ in (1, 2):
            assert managed.trigger("configure") == SUCCESS
            for _ in (1, 2):
                assert managed.trigger("activate") == SUCCESS
                managed.spin_for(0.3)
                assert managed.trigger("deactivate") == SUCCESS
                managed.spin_for(0.2)  # messages on their way do no harm
            assert managed.trigger("cleanup") == SUCCESS
            managed.spin_for(0.2)
            assert managed.entities == empty
        managed.until(lambda: managed.messages[-1].startswith("unconfigured"))
        assert managed.trigger("configure") == SUCCESS
        assert managed.trigger("activate") == SUCCESS
        assert managed.trigger("shutdown") == SUCCESS
        managed.spin_for(0.2)
        assert managed.entities == empty
    assert not list(tmp_path.iterdir())  # the device's port


@pytest.mark.parametrize("name", NODES)
def test_an_invalid_rig_file_is_refused_and_read_again_after_its_repair(
    name, tmp_path, monkeypatch
):
    rig = tmp_path / "rig.yaml"
    good = default_rig_path().read_text(encoding="utf-8")
    with Managed(name, tmp_path, monkeypatch, rig_file=rig) as managed:
        empty = managed.entities
        for text in (None, good.replace("length_m", "lenght_m"), good):
            if text is not None:
                rig.write_text(text, encoding="utf-8")
            if text == good:
                break
            assert managed.trigger("configure") == FAILURE
            assert managed.entities == empty
            why = str(managed.node.failure)
            assert "rig.yaml: no such file" in why if text is None else "lenght_m" in why
            managed.messages.clear()
            managed.until(lambda w=why: any(w in text for text in managed.messages))
        assert managed.trigger("configure") == SUCCESS
        assert managed.trigger("activate") == SUCCESS
        (result,) = managed.node.set_parameters([Parameter("rig_file", value="")])
        assert result.reason == (
            f"parameter rig_file is only read when {name} is configured, allowed: changes while "
            "the node is not active"
        )
        assert managed.trigger("deactivate") == SUCCESS
        (result,) = managed.node.set_parameters([Parameter("rig_file", value="none.yaml")])
        assert result.successful
        assert managed.trigger("activate") == SUCCESS  # still with the configured values
        assert managed.trigger("deactivate") == SUCCESS
        assert managed.trigger("cleanup") == SUCCESS
        assert managed.trigger("configure") == FAILURE
