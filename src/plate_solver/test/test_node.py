"""The solver, spoken to over ROS."""

import re

import numpy as np
import pytest

from plate_core import CycleRequest, Parts, PlateCycle, PlateError
from plate_core.motion import usage
from plate_sim import simulate

rclpy = pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rcl_interfaces.msg import Parameter as ParameterMsg  # noqa: E402
from rcl_interfaces.msg import ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from stepped_clock import SteppedExecutor  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.ros import DATA, msg_to_cycle, nanoseconds, request_to_msg, start_nodes, to_time  # noqa: E402
from plate_interfaces.msg import PartForces  # noqa: E402
from plate_solver.node import LATER_S, LATEST_S, SOONER_S, Sent, SolverNode  # noqa: E402

MS = 1_000_000
MASS, MU = 0.02, 0.25  # of the default rig
PLACES = np.array([[0.12, 0.05], [-0.15, -0.04]])
WANTED = np.array([[0.006, 0.002], [-0.004, 0.005]])  # drift, m/s


class Peer:
    """A solver and a node that listens to it."""

    def __init__(self, clock) -> None:
        words = ["-r", "__ns:=/solver_test", "-p", "handover_s:=0.0"]
        rclpy.init(args=["--ros-args", *words])
        self.node, self.solver = rclpy.create_node("peer"), SolverNode()
        self.executor = SteppedExecutor(clock)
        self.executor.add_node(self.node)
        self.executor.add_node(self.solver)
        self.cycles: list[JointTrajectory] = []
        self.reports: list[DiagnosticArray] = []
        self.node.create_subscription(JointTrajectory, "plate_cycle", self.cycles.append, DATA)
        self.node.create_subscription(DiagnosticArray, "diagnostics", self.reports.append, DATA)
        self.forces = self.node.create_publisher(PartForces, "part_forces", DATA)
        self.parameters = self.node.create_client(SetParameters, "solver/set_parameters")
        start_nodes(self.solver)

    def until(self, condition, seconds: float = 5.0) -> bool:
        """Spin until the condition holds; False when it takes too long."""
        clock = self.executor.clock
        end = clock.monotonic() + seconds
        while not (done := condition()) and clock.monotonic() < end:
            self.executor.spin_once()
        return bool(done)

    def send(self, request: CycleRequest, stamp_ns: int) -> None:
        self.forces.publish(request_to_msg(request, to_time(stamp_ns)))

    def answers(self, stamp_ns: int) -> list[JointTrajectory]:
        return [m for m in self.cycles if nanoseconds(m.header.stamp) == stamp_ns]

    def answer(self, stamp_ns: int, count: int = 1) -> JointTrajectory:
        """Wait for the cycle with a stamp; `count` of them."""
        found = self.until(lambda: len(self.answers(stamp_ns)) >= count)
        assert found, f"no answer to stamp {stamp_ns}"
        return self.answers(stamp_ns)[-1]

    def ask(self, request: CycleRequest, stamp_ns: int) -> PlateCycle:
        self.send(request, stamp_ns)
        return msg_to_cycle(self.answer(stamp_ns))

    def set_method(self, value: str):
        text = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
        future = self.parameters.call_async(
            SetParameters.Request(parameters=[ParameterMsg(name="method", value=text)])
        )
        assert self.until(future.done)
        return future.result().results[0]

    def report(self, condition) -> dict[str, str]:
        """Wait for diagnostics of which the condition holds."""

        def latest() -> dict[str, str]:
            if not self.reports:
                return {}
            return {item.key: item.value for item in self.reports[-1].status[0].values}

        assert self.until(lambda: latest() and condition(latest())), latest()
        return latest()

    def wait_for_diagnostics(self, level: bytes, *texts: str) -> None:
        """Wait for diagnostics of a level whose message contains some texts."""

        def published() -> bool:
            status = self.reports[-1].status[0] if self.reports else None
            return (
                status is not None
                and status.level == level
                and all(text in status.message for text in texts)
            )

        assert self.until(published), self.reports[-1:]

    def second_publisher(self) -> str:
        return self.solver.second_publisher("part_forces")

    def close(self) -> None:
        self.executor.shutdown()
        self.solver.destroy_node()
        self.node.destroy_node()
        rclpy.shutdown()


@pytest.fixture(name="peer")
def _peer(clock):
    peer = Peer(clock)
    yield peer
    peer.close()


class Plate:
    """Parts on a simulated plate, seen at the start of each cycle; stamps are simulated time."""

    def __init__(self, peer: Peer, stamp_ns: int) -> None:
        self.peer, self.stamp_ns = peer, stamp_ns
        self.position, self.velocity = PLACES.copy(), np.zeros_like(PLACES)
        self.drift = np.zeros_like(PLACES)
        self.running: PlateCycle | None = None

    def cycle(self) -> PlateCycle:
        """One image, its answer, one cycle of the plate."""
        period = self.running.period if self.running else 0.1
        force = (WANTED - self.drift) * MASS / period
        request = CycleRequest.make(Parts.make(("a_1", "a_2"), self.position, self.drift), force)
        answer = self.peer.ask(request, self.stamp_ns)
        if self.running:
            run = simulate(self.running, self.position, self.velocity, MU)
            self.drift = (run.position[-1] - self.position) / self.running.period
            self.position, self.velocity = run.position[-1], run.velocity[-1]
        self.stamp_ns += round(period * 1e9)
        self.running = answer
        return answer


START_NS = 1_000 * MS
BOTH = Parts.make(("a_1", "a_2"), PLACES)
PUSH = CycleRequest.make(BOTH, 1e-4 * np.ones((2, 2)))
NO_PARTS = CycleRequest.make(Parts.make((), np.zeros((0, 2))))


def test_cycles_keep_the_limits_and_move_the_parts_as_requested(peer, rig):
    plate = Plate(peer, START_NS)
    for _ in range(7):
        cycle = plate.cycle()
        assert cycle.starts_at_rest
        assert usage(rig, cycle).worst <= 1 + 1e-6
        assert np.max(np.abs(cycle.knot_pose)) > 1e-4
    np.testing.assert_allclose(plate.drift, WANTED, atol=0.003)
    assert peer.cycles[-1].joint_names == ["x", "y", "theta"]
    report = peer.report(lambda r: r["parts"] == "2")
    assert report["method"] == "sinusoids"
    assert 0 <= float(report["missed_fraction"]) <= 1
    assert float(report["condition"]) >= 1


def test_a_repeated_stamp_gets_the_same_cycle(peer):
    """The first message may have been lost. A request without parts, after the end of a task, is
    answered by rest, and later requests with this stamp are too."""
    Plate(peer, START_NS).cycle()
    first = msg_to_cycle(peer.answer(START_NS))
    other = CycleRequest.make(Parts.make(("a_1",), [[0.0, 0.1]]), [[1e-3, 0.0]])
    peer.send(other, START_NS)
    again = msg_to_cycle(peer.answer(START_NS, count=2))
    np.testing.assert_array_equal(again.knot_pose, first.knot_pose)
    for count, ended in enumerate((NO_PARTS, other), start=3):
        peer.send(ended, START_NS)
        assert not msg_to_cycle(peer.answer(START_NS, count)).moves


def test_the_method_can_change_while_the_plate_moves(peer):
    plate = Plate(peer, START_NS)
    for _ in range(7):
        plate.cycle()
    assert np.ptp(np.diff(plate.running.times)) < 1e-6, "Method B has even knots"
    result = peer.set_method("rotations")
    assert result.successful, result.reason
    plate.cycle()
    assert np.ptp(np.diff(plate.running.times)) > 1e-4
    for _ in range(6):
        plate.cycle()
    np.testing.assert_allclose(plate.drift, WANTED, atol=0.004)
    peer.report(lambda r: r["method"] == "rotations")
    refused = peer.set_method("chance")
    assert not refused.successful
    assert refused.reason == (
        "parameter method is 'chance', allowed: one of A, B, rotations, sinusoids"
    )
    assert peer.set_method("B").successful
    peer.report(lambda r: r["method"] == "sinusoids")


def test_without_parts_the_plate_rests(peer):
    rest = peer.ask(NO_PARTS, START_NS)
    assert np.all(rest.knot_pose == 0)
    assert rest.starts_at_rest


def test_invalid_requests_are_not_answered(peer, capfd):
    peer.ask(PUSH, START_NS)
    count = len(peer.cycles)
    refused = [
        CycleRequest.make(Parts.make(("a_1", "a_2"), PLACES * [np.nan, 1])),
        CycleRequest.make(BOTH, np.full((2, 2), np.nan)),
        CycleRequest.make(Parts.make(("a_1", "a_1"), PLACES)),
    ]
    peer.executor.spin_for(1.1)  # so that diagnostics report only these
    stamp_ns = START_NS
    for number, bad in enumerate(refused, 1):
        stamp_ns += 100 * MS
        peer.send(bad, stamp_ns)
        peer.report(lambda r, number=number: r["refused_messages"] == str(number))
    peer.wait_for_diagnostics(DiagnosticStatus.ERROR, "part_forces refused: ")
    peer.send(PUSH, START_NS - 50 * MS)  # older than the last
    peer.report(lambda r: r["refused_messages"] == "4")
    stamp_ns += 100 * MS
    assert np.any(peer.ask(PUSH, stamp_ns).knot_pose != 0)
    assert len(peer.cycles) == count + 1
    output = capfd.readouterr().err
    assert "Traceback" not in output
    assert "part_forces refused" in output


def test_of_requests_that_arrive_during_a_search_the_last_is_answered(peer):
    """Otherwise, the solver would fall behind."""
    burst = [START_NS + k * MS for k in range(1, 9)]
    for stamp_ns in burst:
        peer.send(PUSH, stamp_ns)
    peer.answer(burst[-1])
    assert len(peer.cycles) < len(burst)


def test_after_a_restart_of_the_simulator_the_memory_is_cleared(peer):
    """A stamp far in the past is that of a restarted simulator."""
    plate = Plate(peer, START_NS)
    for _ in range(3):
        plate.cycle()
    first = [msg_to_cycle(m).knot_pose for m in peer.cycles]
    fresh = Plate(peer, stamp_ns=0)
    again = [fresh.cycle().knot_pose for _ in range(3)]
    np.testing.assert_array_equal(again, first)


def test_a_torque_moves_the_plate(peer):
    """test_turning.py tests the motion."""
    part = Parts.make(("z_1",), PLACES[:1])
    assert np.any(peer.ask(CycleRequest.make(part, torque=[2e-6]), START_NS).knot_pose != 0)


def test_if_a_second_node_sends_requests_the_plate_rests(peer, capfd):
    peer.ask(PUSH, START_NS)
    rogue = rclpy.create_node("rogue")
    rogue.create_publisher(PartForces, "part_forces", DATA)
    assert peer.until(lambda: "rogue" in peer.second_publisher())
    assert not np.any(peer.ask(PUSH, START_NS + 100 * MS).knot_pose)
    rogue.destroy_node()
    assert peer.until(lambda: not peer.second_publisher())
    assert np.any(peer.ask(PUSH, START_NS + 200 * MS).knot_pose)
    output = capfd.readouterr().err
    assert "Traceback" not in output
    assert "no solution, plate rests: 2 nodes publish part_forces (peer, rogue)" in output


def test_a_second_node_with_the_name_of_the_first_is_detected(peer):
    peer.ask(PUSH, START_NS)
    twin = rclpy.create_node(peer.node.get_name())
    publisher = twin.create_publisher(PartForces, "part_forces", DATA)
    for k in range(100, 140, 10):
        publisher.publish(request_to_msg(PUSH, to_time(START_NS + k * MS)))
        peer.executor.spin_for(0.1)
        cycle = peer.ask(PUSH, START_NS + (k + 5) * MS)
    assert not np.any(cycle.knot_pose)
    twin.destroy_node()
    assert peer.until(lambda: not peer.second_publisher())
    assert np.any(peer.ask(PUSH, START_NS + 200 * MS).knot_pose)


def test_missing_requests_are_reported(peer):
    peer.ask(PUSH, START_NS)
    peer.wait_for_diagnostics(
        DiagnosticStatus.STALE, "no part_forces for ", "check that the planner runs"
    )


def test_the_cycle_that_runs_is_the_last_that_was_sent_in_time(peer):
    first, second = PlateCycle.rest(0.1), PlateCycle.rest(0.2)
    peer.solver._sent.extend([Sent(0, 10 * MS, first), Sent(100 * MS, 150 * MS, second)])
    for stamp_ms, expected, late in (
        (13, None, 0), (15, first, 1), (153, first, 2), (155, second, 2), (900, second, 2),
    ):  # fmt: skip
        assert peer.solver._running(stamp_ms * MS) is expected, stamp_ms
        assert peer.solver._count["late_answers"] == late, stamp_ms


def test_cycles_are_sent_earlier_while_they_are_not_played(peer):
    solver, cycle = peer.solver, PlateCycle.rest(0.1)
    played, missed = np.zeros((3, 3)), np.full((3, 3), 1e-3)
    solver._adapt(missed)
    assert solver._handover_s == 0.0  # the simulator waits
    solver._handover_s = 0.02
    solver._adapt(missed)  # nothing was sent yet
    solver._sent.append(Sent(0, 10 * MS, cycle))
    for plate, margin_s, count in (
        (None, 0.02, 0), (missed, 0.02 + LATER_S, 1), (played, 0.02 + LATER_S - SOONER_S, 1),
    ):  # fmt: skip
        solver._adapt(plate)
        assert solver._handover_s == pytest.approx(margin_s)
        assert solver._count["not_played"] == count
    for plate, limit_s in ((missed, LATEST_S), (played, solver.options.handover_s)):
        for _ in range(1000):
            solver._handover_s = max(solver._handover_s, 1e-9)
            solver._adapt(plate)
        assert solver._handover_s == pytest.approx(limit_s, abs=1e-8)


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("method:=magic", "parameter method is 'magic', allowed: one of A, B, "),
        ("seed:=-1", "parameter seed is -1, allowed: 0 to 2147483647"),
        ("restarts:=1001", "parameter restarts is 1001, allowed: 0 to 1000"),
        ("seed:=0.5", "parameter seed is 0.5, allowed: a value of type int"),
        ("rig_file:=nowhere.yaml", "nowhere.yaml: no such file"),
    ],
)
def test_wrong_parameters_are_refused_at_start(parameter, message):
    rclpy.init(args=["--ros-args", "-p", parameter])
    try:
        with pytest.raises(PlateError, match=re.escape(message)):
            start_nodes(SolverNode())
    finally:
        rclpy.shutdown()
