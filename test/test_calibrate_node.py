"""The calibrate service, end to end: driver node, serial line, device, plate on flexures.

In simulated time: the node's timers are called here, its clock is the device's.
"""

import itertools

import numpy as np
import pytest

from harness.serial import open_port
from plate_core import PlateCycle, load_rig
from plate_core.motion import motor_state

rclpy = pytest.importorskip("rclpy")
from rclpy.serialization import serialize_message  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from plate_core.driver_status import DriverReason, DriverState  # noqa: E402
from plate_core.rig import default_rig_path  # noqa: E402
from plate_core.ros import cycle_to_msg, start_nodes  # noqa: E402
from plate_driver.clocks import Clocks  # noqa: E402
from plate_driver.node import DriverNode  # noqa: E402
from plate_driver.transports import SerialTransport, TransportThread  # noqa: E402
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule, LineFaults, SuspendedPlate  # noqa: E402

RIG = load_rig()
PERIOD = 0.2
TICK_S = 1e-3
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


def test_the_next_configure_uses_the_result_of_calibrate(monkeypatch, tmp_path):
    learned, rig_file = tmp_path / "plate.npz", tmp_path / "rig.yaml"
    rig_file.write_text(default_rig_path().read_text(encoding="utf-8") + HUNG, encoding="utf-8")
    sessions = itertools.count(1, 1000)
    hung, line = load_rig(rig_file), FaultSchedule(LineFaults(baud=921_600.0))
    emulator = Emulator(DeviceLimits.of_rig(hung), 3, line, plate=SuspendedPlate(hung, TICK_S))
    monkeypatch.setattr(Clocks, "playback_s", lambda self: emulator.now)
    monkeypatch.setattr(
        TransportThread, "start", lambda self: None
    )  # we look after it, in its time
    monkeypatch.setattr(
        "plate_driver.node.make_transport",
        lambda name, context: SerialTransport(
            lambda: open_port(emulator), lambda: emulator.now, next(sessions)
        ),
    )
    words = ["transport:=serial", "port:=simulated", "hold_cycles:=20"]
    words += [f"calibration_file:={learned}", f"rig_file:={rig_file}"]
    arguments = ["--ros-args", "-r", "__ns:=/calibrate_node"]
    rclpy.init(args=arguments + [w for p in words for w in ("-p", p)])
    driver, cycle = DriverNode(), shaking()
    start_nodes(driver)
    t = PERIOD * np.arange(1000) / 1000
    _, _, expected = motor_state(RIG, cycle.pose(t), cycle.twist(t), cycle.accel(t))

    def run(seconds: float) -> np.ndarray:
        """Accelerations (n, 4) that are measured meanwhile."""
        measured = []
        for tick in range(round(seconds / TICK_S)):
            emulator.tick()
            measured.append(emulator._measured[1])
            if tick % 5 == 0:
                driver.transports.current.poll()
            if tick % 20 == 0:
                driver._on_watch_timer()
        return np.array(measured)

    def enable() -> None:
        """As a person does; the service would wait in real time."""
        run(0.3)
        order = driver.transports.current.enable(driver.latch.number)
        for _ in range(20):
            run(0.0 if order.completed else 0.2)
        assert order.done, order.failure
        run(0.1)
        assert driver.status.state is DriverState.READY

    def shaken() -> np.ndarray:
        """Root mean square of the measured accelerations over that of the wanted ones (4,)."""
        data = serialize_message(cycle_to_msg(cycle, driver.get_clock().now().to_msg()))
        driver.take_cycle(data, len(data))
        run(1.5)
        return np.sqrt(np.mean(run(5 * PERIOD) ** 2, axis=0) / np.mean(expected**2, axis=0))

    def calibrated() -> None:
        assert driver._on_calibrate(Trigger.Request(), Trigger.Response()).success
        assert driver.status.state is DriverState.CALIBRATING

    try:
        enable()
        assert np.min(shaken()) > 2.8  # at the resonance of 3 %
        run(1.0)
        calibrated()
        run(1.0)
        emulator.reset()  # it fails, with the reason, and does not restart by itself
        run(2.0)
        assert not learned.exists()
        assert not driver._calibration.running
        assert driver.status.state is DriverState.STOPPED
        assert driver.status.reason is DriverReason.DEVICE_RESET
        enable()
        calibrated()
        for _ in range(40):
            if driver._calibration.running:
                run(1.0)
        assert driver.status.state is DriverState.READY
        assert learned.exists()
        assert [path.name for path in learned.parent.iterdir() if "plate.npz" in path.name] == [
            "plate.npz"
        ]
        for change in ("deactivate", "cleanup", "configure", "activate"):
            if change == "deactivate":
                driver.transports.current.stop()
                run(1.5)
            getattr(driver, f"trigger_{change}")()
        enable()
        np.testing.assert_allclose(shaken(), 1, atol=0.02)
    finally:
        driver.destroy_node()
        rclpy.shutdown()
