"""The device node at one end of its pseudo-terminal, the driver node at the other, in real time."""

import os
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from shaking import bump

from plate_core import load_rig
from plate_core.rig import rig_path
from plate_core.serial_protocol import State

rclpy = pytest.importorskip("rclpy")
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.ros import (  # noqa: E402
    DATA,
    LATCHED,
    cycle_to_msg,
    msg_to_motors,
    nanoseconds,
    start_nodes,
)
from plate_driver.node import DriverNode  # noqa: E402
from plate_interfaces.msg import DriverStatus  # noqa: E402
from plate_sim.device import SuspendedPlate, node  # noqa: E402
from plate_sim.device.node import DeviceNode  # noqa: E402

RIG = load_rig()
PATIENCE_S = 15.0


def test_a_cycle_goes_round_and_after_a_pulled_plug_a_person_enables(tmp_path):
    link = tmp_path / "port"
    file, driven = tmp_path / "nodes.yaml", {"port": str(link), "transport": "serial"}
    parameters = {"device": {"link": str(link)}, "driver": driven | {"hold_cycles": 20}}
    text = {f"/**/{name}": {"ros__parameters": values} for name, values in parameters.items()}
    file.write_text(yaml.safe_dump(text), encoding="utf-8")
    rclpy.init(args=["--ros-args", "--params-file", str(file), "-r", "__ns:=/device_node"])
    executor, own = SingleThreadedExecutor(), SingleThreadedExecutor()
    device = DeviceNode()
    start_nodes(device)
    own.add_node(device)
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            own.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=serve)  # the device must not wait for the others
    thread.start()
    driver, peer = DriverNode(), rclpy.create_node("peer")
    start_nodes(driver)
    motions: list[JointTrajectory] = []
    states: list[JointState] = []
    peer.create_subscription(JointTrajectory, "motor_motion", motions.append, 50)
    peer.create_subscription(JointState, "motor_states", states.append, DATA)
    reported = [DriverStatus()]
    peer.create_subscription(DriverStatus, "driver_status", reported.append, LATCHED)
    cycles = peer.create_publisher(JointTrajectory, "plate_cycle", DATA)
    enabler = peer.create_client(SetBool, "enable")
    for each in (driver, peer):
        executor.add_node(each)

    def until(condition) -> bool:
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.01)
            if condition():
                return True
        return False

    def enable() -> bool:
        """As a person does, again where a busy machine has let the line fall silent meanwhile."""
        for _ in range(3):
            future = enabler.call_async(SetBool.Request(data=True))
            if until(future.done) and future.result().success and until(ready):
                return True
        return False

    def ready() -> bool:
        return reported[-1].state == DriverStatus.READY

    def whole(msg: JointTrajectory) -> bool:
        return len(msg.points) == 33 and any(msg.points[16].positions)

    try:
        assert until(lambda: cycles.get_subscription_count() and len(motions) > 2)
        assert not any(any(point.positions) for point in motions[-1].points)
        assert until(enabler.service_is_ready)
        assert not ready()
        assert enable()
        cycle, clock = bump(2e-3, 0.2), peer.get_clock()
        # As the planner does, again and again
        peer.create_timer(0.5, lambda: cycles.publish(cycle_to_msg(cycle, clock.now().to_msg())))
        assert until(lambda: sum(map(whole, motions)) > 3)
        played = msg_to_motors(RIG, next(filter(whole, motions)))
        np.testing.assert_allclose(played.knot_pose, cycle.knot_pose, atol=1e-8)
        # Segment follows upon stretch.
        ends = [
            nanoseconds(m.header.stamp) + nanoseconds(m.points[-1].time_from_start) for m in motions
        ]
        starts = [nanoseconds(m.header.stamp) for m in motions]
        gaps = np.subtract(starts[1:], ends[:-1])
        assert np.min(gaps) >= -2
        # On a busy machine the device's clock stalls, which it reports.
        assert np.sum(gaps) <= 1e6 * device._lost_ms + 2 * len(gaps)
        assert until(lambda: any(any(s.position) for s in states))
        # Pulled out, the device brakes; back again, the plate rests until somebody enables.
        device.set_parameters([Parameter("disconnect_s", value=0.5)])
        device._emulator.disconnect()
        assert until(lambda: not link.exists())
        assert until(lambda: device._emulator.state is State.OFF)
        assert until(lambda: device._emulator.connected and not ready())
        received_us = device._emulator.device.received_us
        assert until(lambda: device._emulator.device.received_us > received_us + 1_000_000)
        assert device._emulator.state is State.OFF
        assert enable()
        motions.clear()
        assert until(lambda: sum(map(whole, motions)) > 2)
    finally:
        driver.destroy_node()  # it still speaks with the device
        executor.shutdown()
        ended.set()
        thread.join(10)  # before the objects that it waits for are destroyed
        own.shutdown()
        device.destroy_node()
        peer.destroy_node()
        rclpy.shutdown()
    assert not os.path.lexists(link)


def test_a_stall_of_the_computer_is_no_timeout_of_the_host(tmp_path, monkeypatch):
    """Its process gets no CPU time for three seconds, and its clock stops meanwhile."""
    clock = [10**9]
    monkeypatch.setattr(node, "time", SimpleNamespace(monotonic_ns=lambda: clock[0]))
    arguments = ["--ros-args", "-p", f"link:={tmp_path / 'port'}", "-r", "__ns:=/held_up"]
    rclpy.init(args=arguments)
    device = DeviceNode()
    start_nodes(device)
    try:

        def passed(seconds: float) -> float:
            before = device._emulator.now
            clock[0] += round(seconds * 1e9)
            device._on_serve_timer()
            return device._emulator.now - before

        assert passed(0.02) == pytest.approx(0.02, abs=2e-3)
        begin_ns = device._begin_ns
        assert passed(3.0) <= 0.1  # less than the watchdog's 0.25 s
        assert device._begin_ns - begin_ns == pytest.approx(2.9e9, rel=0.01)  # so stamps are right
        assert passed(0.02) == pytest.approx(0.02, abs=2e-3)
    finally:
        device.destroy_node()
        rclpy.shutdown()


def test_a_plate_on_flexures_moves_in_steps_of_a_millisecond(tmp_path):
    given = f"-p rig_file:={rig_path('desk')} -p link:={tmp_path / 'port'}"
    rclpy.init(args=["--ros-args", *given.split()])
    device = DeviceNode()
    try:
        start_nodes(device)
        expected = SuspendedPlate(load_rig("desk"), 1e-3)
        now = np.ones((3, 4))
        np.testing.assert_array_equal(device._emulator._suspended.moved(now), expected.moved(now))
    finally:
        device.destroy_node()
        rclpy.try_shutdown()
