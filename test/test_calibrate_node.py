"""The calibrate service, end to end: driver node, pseudo-terminal, device, plate on flexures."""

import itertools
import os
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_core.kinematics import motor_state

rclpy = pytest.importorskip("rclpy")
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.rig import default_rig_path  # noqa: E402
from plate_core.ros.convert import cycle_to_msg, to_time  # noqa: E402
from plate_core.ros.qos import DATA, LATCHED  # noqa: E402
from plate_driver.calibration import Calibration  # noqa: E402
from plate_driver.node import DriverNode  # noqa: E402

RIG = load_rig()
DOMAIN = 1 + (43 * os.getpid() + 29) % 99
DEVICE = [sys.executable, "-c", "from plate_sim.device.node import main; main()"]
PATIENCE_S = 90.0
PERIOD = 0.207
HUNG = """
suspension:
  frequency_hz: [35, 35, 35]
  damping_ratio: [0.03, 0.03, 0.03]
  centre_of_mass_m: [0.01, -0.005]
  feedforward: {mass: 0, damping: 0, stiffness: 1}
  motor_gain: [1.15, 0.85, 1.15, 0.85]
  motor_bandwidth_hz: 200
"""


def shaking() -> PlateCycle:
    """Cycle along x and y at 25 Hz, swelling and fading."""
    t = np.linspace(0, PERIOD, 65)
    u, w = 2 * np.pi * t / PERIOD, 2 * np.pi / PERIOD
    # (1 - cos u)^2 sin 5u, as the sum of its harmonics
    weights = {5: 1.5, 4: -1.0, 6: -1.0, 3: 0.25, 7: 0.25}
    wave = np.zeros((3, len(t)))
    for k, weight in weights.items():
        wave += weight * np.array(
            [np.sin(k * u), k * w * np.cos(k * u), -((k * w) ** 2) * np.sin(k * u)]
        )
    states = 2e-4 * np.einsum("sn,a->sna", wave, [1.0, -0.7, 0.0])
    states[:2, [0, -1]] = 0
    return PlateCycle.from_knots(t, *states)


def waited(condition, step=lambda: time.sleep(0.01)) -> bool:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if condition():
            return True
        step()
    return False


@pytest.fixture(name="quick")
def _quick(monkeypatch):
    """A third less patience than on a real rig: a single cycle settles, four are measured."""
    begun = Calibration.begun
    quick = lambda rig: replace(begun(rig), settle=1, measure=4)  # noqa: E731
    monkeypatch.setattr(Calibration, "begun", quick)


def test_what_calibrate_has_learned_is_used_from_the_next_configure_on(quick, tmp_path):
    link, learned, rig_file = (tmp_path / name for name in ("port", "plate.npz", "rig.yaml"))
    rig_file.write_text(default_rig_path().read_text(encoding="utf-8") + HUNG, encoding="utf-8")
    words = [f"link:={link}", f"port:={link}", "transport:=serial", "hold_cycles:=1000"]
    words += [
        "state_rate:=200.0",
        f"calibration_file:={learned}",
        f"rig_file:={rig_file}",
    ]
    arguments = ["--ros-args", "-r", "__ns:=/calibrate_node"]
    arguments += [w for p in words for w in ("-p", p)]
    env = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)}
    device = subprocess.Popen([*DEVICE, *arguments], env=env)
    assert waited(link.exists)
    rclpy.init(args=arguments, domain_id=DOMAIN)
    executor = SingleThreadedExecutor()
    driver, peer = DriverNode(), rclpy.create_node("peer")
    states: list[JointState] = []
    told: list[str] = []
    peer.create_subscription(JointState, "motor_states", states.append, DATA)
    peer.create_subscription(String, "driver_state", lambda m: told.append(m.data), LATCHED)
    cycles = peer.create_publisher(JointTrajectory, "plate_cycle", DATA)
    calibrate = peer.create_client(Trigger, "calibrate")
    for node in (driver, peer):
        executor.add_node(node)

    def until(condition) -> bool:
        return waited(condition, lambda: executor.spin_once(timeout_sec=0.01))

    cycle, stamps = shaking(), itertools.count(1_000)
    t = np.linspace(0, PERIOD, 1000)
    _, _, wanted = motor_state(RIG, cycle.pose(t), cycle.twist(t), cycle.accel(t))

    def shaken(low: float, high: float) -> bool:
        """Whether the plate comes to shake by so much: measured acceleration over wanted (4,)."""

        def judged() -> bool:
            if len(states) < 105:
                return False
            got = np.array([state.effort for state in states[-105:]])
            ratio = np.sqrt(np.mean(got**2, axis=0) / np.mean(wanted**2, axis=0))
            return bool(np.all((low < ratio) & (ratio < high)))

        states.clear()
        assert until(lambda: cycles.get_subscription_count() > 0)
        cycles.publish(cycle_to_msg(cycle, to_time(next(stamps))))
        return until(judged)

    try:
        assert shaken(3, 4)  # at the resonance of 3 %
        assert until(lambda: calibrate.service_is_ready())
        answer = calibrate.call_async(Trigger.Request())
        assert until(answer.done)
        assert answer.result().success, answer.result().message
        assert until(lambda: "calibrating" in told)
        assert until(lambda: told[-1] == "ready"), told
        assert learned.exists()
        for change in (driver.trigger_deactivate, driver.trigger_cleanup):
            change()
        for change in (driver.trigger_configure, driver.trigger_activate):
            change()
        assert shaken(0.95, 1.05)
    finally:
        driver.destroy_node()
        executor.shutdown()
        peer.destroy_node()
        rclpy.shutdown()
        device.terminate()
        code = device.wait(20)
    assert code == 0
