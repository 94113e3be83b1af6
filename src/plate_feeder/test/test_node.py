"""The node with a planner and a hopper that do as ordered."""

import math
import socket
import time
from types import SimpleNamespace

import pytest

rclpy = pytest.importorskip("rclpy")

from action_msgs.msg import GoalStatus  # noqa: E402
from builtin_interfaces.msg import Time  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.action import ActionClient, ActionServer, CancelResponse  # noqa: E402
from rclpy.task import Future  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from stepped_clock import MAX_S, SteppedExecutor  # noqa: E402

from plate_core import PlateError  # noqa: E402
from plate_core.ros import DATA, LATCHED, msg_to_order, start_nodes  # noqa: E402
from plate_core.tasks import FeedMode  # noqa: E402
from plate_feeder.node import BY_PERSON, NEED_A_PERSON, STOPPED, FeederNode  # noqa: E402
from plate_interfaces.action import FeedParts, GetPart, PurgePlate  # noqa: E402
from plate_interfaces.msg import (  # noqa: E402
    DriverStatus,
    FeedOrder,
    FeedPick,
    FeedStatus,
    Part,
    PartCount,
    TaskStatus,
)
from plate_interfaces.srv import OpenHopper, PartQuantity, PartTaken, PreparePart  # noqa: E402

COVARIANCE = [1e-8, 0.0, 0.0, 0.0, 4e-8, 0.0, 0.0, 0.0, 1e-4]


class Planner:
    """Reports for each image whether the plate rests as ordered, and the ready parts."""

    def __init__(self, clock):
        self.node = rclpy.create_node("planner")
        self.goal = None
        self.results = {}
        self.orders = []
        self.opened = []
        self.mode = FeedMode.FEED
        self.ready = {}
        self.seen = 15
        self.began = 0
        self.silent, self.jam = False, ""
        self.publish = self.node.create_publisher(FeedStatus, "feed_status", DATA).publish
        self.tell = self.node.create_publisher(TaskStatus, "task_status", LATCHED).publish
        self.drive = self.node.create_publisher(DriverStatus, "driver_status", LATCHED).publish
        self.node.create_subscription(FeedOrder, "feed_orders", self.on_order, DATA)
        self.node.create_service(OpenHopper, "hopper/open", self.on_open)
        self.node.create_timer(0.03, self.look, clock=clock.clock)
        self.server = ActionServer(
            self.node, FeedParts, "feed_parts", self.result, handle_accepted_callback=self.begin,
            cancel_callback=self.cancel,
        )  # fmt: skip

    def begin(self, goal):
        self.goal, self.mode, self.began = goal, FeedMode.FEED, self.began + 1

    def cancel(self, goal):
        self.end("canceled", TaskStatus.CANCELED)
        return CancelResponse.ACCEPT

    def end(self, text, reason=TaskStatus.NO_PARTS):
        """End the task, and report it only by the result."""
        goal, self.goal = self.goal, None
        self.results[bytes(goal.goal_id.uuid)] = TaskStatus(
            task="feed", state=TaskStatus.ABORTED, reason=reason, text=text
        )
        goal.execute()

    def result(self, goal):
        status = self.results.pop(bytes(goal.goal_id.uuid))
        (goal.canceled if goal.is_cancel_requested else goal.abort)()
        return FeedParts.Result(status=status)

    def on_order(self, msg):
        self.orders.append(msg)
        self.mode = msg_to_order(msg).mode

    def on_open(self, request, response):
        self.opened.append(request.duration_s)
        response.success, response.message = not self.jam, self.jam
        return response

    def look(self):
        if self.goal is None or self.silent:
            return
        msg = FeedStatus(mode=int(self.mode), at_rest=self.mode is FeedMode.REST)
        msg.header.stamp = self.node.get_clock().now().to_msg()
        msg.ready = [
            Part(id=name, type="black", x=x, y=y, angle=0.1, covariance=COVARIANCE)
            for name, (x, y) in self.ready.items()
        ]
        msg.seen = [PartCount(type="black", count=self.seen)]
        self.publish(msg)
        self.tell(TaskStatus(task="feed", state=TaskStatus.RUNNING))


class Graph:
    def __init__(self, clock, **parameters):
        self.clock = clock
        given = {"port": 0, **parameters}
        args = ["--ros-args", "-r", "__ns:=/feeder_test"]
        for name, value in given.items():
            args += ["-p", f"{name}:={value}"]
        rclpy.init(args=args)
        self.numbers = {}  # of robots, as the server counts them
        self.feeder = FeederNode()
        self.executor = SteppedExecutor(clock)
        self.executor.add_node(self.feeder)
        try:
            start_nodes(self.feeder)
        except BaseException:
            self.feeder.destroy_node()
            rclpy.try_shutdown()
            raise
        self.planner = Planner(clock)
        self.node = self.planner.node
        for node in (self.feeder, self.node):
            clock.lead(node.get_clock())
        self.executor.add_node(self.node)
        self.actions = {
            "get_part": ActionClient(self.node, GetPart, "get_part"),
            "purge_plate": ActionClient(self.node, PurgePlate, "purge_plate"),
        }
        self.reports = []
        self.node.create_subscription(DiagnosticArray, "diagnostics", self.reports.append, DATA)
        self.until, self.spin = self.executor.until, self.executor.spin_for

    def until_really(self, condition, robot=None):
        """Wait for the server's thread; time goes on only while the feeder has a robot wait."""
        end = time.monotonic() + MAX_S
        self.executor.settle()
        while not condition():
            assert time.monotonic() < end, "it did not come"
            if self.waits(robot):
                self.clock.step()
            else:
                time.sleep(0.001)
            self.executor.settle()

    def send(self, name, goal):
        future = self.actions[name].send_goal_async(goal)
        self.until(future.done)
        return future.result()

    def result(self, handle):
        future = handle.get_result_async()
        self.until(future.done)
        return future.result().status, future.result().result

    def call(self, kind, name, **values):
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**values))
        self.until(future.done)
        return future.result()

    def robot(self):
        server = self.feeder._server
        before = server._count
        robot = socket.create_connection(("127.0.0.1", server.port), timeout=MAX_S)
        self.until_really(lambda: server._count > before)
        self.numbers[robot] = server._count
        return robot

    def ask(self, robot, text):
        """Have a robot send a command that waits."""
        robot.sendall(text.encode() + b"\n")
        self.until_really(lambda: self.waits(robot))

    def waits(self, robot):
        return self.numbers.get(robot) in self.feeder._waiting

    def say(self, robot, text):
        robot.sendall(text.encode() + b"\n")
        return self.hear(robot)

    def hear(self, robot):
        robot.setblocking(False)
        data = bytearray()

        def has_arrived():
            try:
                got = robot.recv(4096)
            except BlockingIOError:
                return False
            data.extend(got)
            return not got or data.endswith(b"\n")

        self.until_really(has_arrived, robot)
        return data.decode()

    def close(self):
        for robot in self.numbers:
            robot.close()
        self.executor.remove_node(self.feeder)
        for each in (self.planner.server, *self.actions.values()):
            each.destroy()
        self.feeder.destroy_node()
        self.node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()


@pytest.fixture
def make(clock):
    made = []

    def make(**parameters):
        made.append(Graph(clock, **parameters))
        return made[-1]

    yield make
    for graph in made:
        graph.close()


@pytest.fixture
def graph(make):
    graph = make()
    graph.planner.ready = {"black_3": (0.1, 0.02)}
    return graph


def test_the_task_begins_with_a_request_whose_result_is_a_part(graph):
    graph.spin(0.3)
    assert graph.planner.began == 0
    status, result = graph.result(graph.send("get_part", GetPart.Goal()))
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert (result.part.id, result.part.x, result.part.y) == ("black_3", 0.1, 0.02)
    assert result.pose.header.frame_id == "plate_home"
    assert 2 * math.atan2(
        result.pose.pose.pose.orientation.z, result.pose.pose.pose.orientation.w
    ) == pytest.approx(0.1)
    assert (result.pose.pose.covariance[0], result.pose.pose.covariance[35]) == (1e-8, 1e-4)
    stamp, until = result.pose.header.stamp, result.valid_until
    assert until.sec - stamp.sec + 1e-9 * (until.nanosec - stamp.nanosec) == pytest.approx(
        10.0, abs=0.5
    )
    assert graph.planner.began == 1
    assert graph.planner.orders[-1].mode == FeedOrder.REST
    assert graph.call(PartTaken, "part_taken", taken=True).success
    graph.until(lambda: graph.planner.orders[-1].mode == FeedOrder.FEED)
    assert graph.call(PartQuantity, "part_quantity").taken == 1
    assert not graph.call(PartTaken, "part_taken", taken=True).success


def test_a_robot_gets_and_takes_a_part_over_tcp(graph):
    robot, other = graph.robot(), graph.robot()
    answer = graph.say(robot, "get_part black 20")
    assert answer.startswith("200 x=100.00 y=20.00 angle=5.73 id=black_3 class=black valid_s=")
    assert graph.say(other, "get_part").startswith("409 ")
    assert "state=reserved" in graph.say(other, "state")
    for deed in ("part_taken black_3", "part_taken", "part_taken black_4 failed"):
        assert graph.say(other, deed).startswith("410 ")
    assert not graph.call(PartTaken, "part_taken", id="black_3", taken=True).success
    assert "id=black_3 valid_s=" in graph.say(robot, "state")
    assert "id=" not in graph.say(other, "state")
    assert graph.say(robot, "part_taken black_3 failed").startswith("200 ")
    assert graph.say(robot, "part_quantity").startswith("200 seen=15 ")
    assert graph.say(robot, "get_part blue").startswith("422 ")
    assert graph.say(robot, "prepare_part").startswith("200 ")


@pytest.mark.parametrize("lost", ["goal", "answer"])
def test_a_goal_without_a_reply_is_sent_again_but_executed_once(graph, monkeypatch, lost):
    client = graph.feeder._task._client
    send, unanswered = client.send_goal_async, []

    def lose_the_first(goal, goal_uuid):
        if not unanswered:
            unanswered.append(Future())
            if lost == "answer":
                send(goal, goal_uuid=goal_uuid)
            return unanswered[0]
        return send(goal, goal_uuid=goal_uuid)

    monkeypatch.setattr(client, "send_goal_async", lose_the_first)
    assert graph.say(graph.robot(), "get_part black 20").startswith("200 ")
    assert graph.planner.began == 1
    unanswered[0].set_result(SimpleNamespace(accepted=True))  # it comes after all: no matter
    graph.spin(0.1)
    assert graph.feeder._task.runs
    graph.planner.end("so")
    graph.until(lambda: not graph.feeder._task.runs)


def test_no_part_in_time(graph):
    graph.planner.ready = {}
    pick = FeedPick(type="black", x_min=0.0, x_max=0.2, y_min=-0.1, y_max=0.1, angle=math.nan)
    handle = graph.send("get_part", GetPart.Goal(timeout_s=0.5, pick=[pick]))
    status, result = graph.result(handle)
    assert (status, result.success) == (GoalStatus.STATUS_ABORTED, False)
    assert "0.5 s" in result.message
    windows = [[each.x_max for each in order.picks] for order in graph.planner.orders]
    assert [0.2] in windows
    graph.until(lambda: [each.x_max for each in graph.planner.orders[-1].picks] == [0.26])


def test_the_hopper_opens_for_missing_parts_and_a_stop_shuts_it(graph):
    graph.planner.seen = 5
    graph.call(PreparePart, "prepare_part")
    graph.until(lambda: graph.planner.opened)
    graph.planner.end("stopped", TaskStatus.STOPPED)
    graph.until(lambda: len(graph.planner.opened) == 2)
    assert graph.planner.opened == [pytest.approx((15 - 5) / 10), 0]


@pytest.mark.parametrize(
    ("jam", "cause"), [("the lid is jammed", "jammed"), (None, "does not reply")]
)
def test_a_hopper_that_does_not_open_is_reported(graph, jam, cause):
    if jam is None:
        graph.feeder._hopper.call_async = lambda request: Future()
    graph.planner.jam, graph.planner.ready, graph.planner.seen = jam, {}, 0
    robot = graph.robot()
    graph.ask(robot, "get_part")
    graph.until(lambda: graph.reports and cause in graph.reports[-1].status[0].message)
    answer = graph.hear(robot)
    assert answer.startswith("507 no part is on the plate")
    assert cause in answer


def test_a_robot_that_leaves_does_not_leave_its_command(graph):
    graph.planner.ready = {}
    robot, other = graph.robot(), graph.robot()
    graph.ask(robot, "get_part")
    assert graph.say(other, "get_part").startswith("409 ")
    robot.close()
    graph.until_really(lambda: not graph.feeder._waiting)
    graph.planner.ready = {"black_4": (0.1, 0.0)}
    assert graph.say(other, "get_part").startswith("200 ")


def test_a_robot_that_comes_back_reports_its_part_with_its_id(graph):
    robot, other = graph.robot(), graph.robot()
    assert graph.say(robot, "get_part").startswith("200 ")
    robot.close()
    graph.until_really(lambda: graph.feeder._feeder.reserved.client is None)
    back = graph.robot()
    state = graph.say(back, "state")
    assert "state=reserved" in state
    assert "id=" not in state
    assert graph.say(back, "part_taken").startswith("410 ")
    assert graph.say(other, "get_part").startswith("409 ")
    assert graph.say(back, "part_taken black_3 ok") == "200 black_3 is taken\r\n"


def test_a_goal_is_canceled(graph):
    graph.planner.ready = {}
    handle = graph.send("get_part", GetPart.Goal())
    graph.until(graph.planner.orders.__len__)
    future = handle.cancel_goal_async()
    graph.until(future.done)
    assert graph.result(handle)[0] == GoalStatus.STATUS_CANCELED
    graph.planner.ready = {"black_4": (0.1, 0.0)}
    status, result = graph.result(graph.send("get_part", GetPart.Goal()))
    assert (status, result.part.id) == (GoalStatus.STATUS_SUCCEEDED, "black_4")


def test_a_task_that_ends_is_reported_and_restarted(graph):
    graph.planner.ready = {}
    robot = graph.robot()
    graph.ask(robot, "get_part")
    graph.until(lambda: graph.planner.orders)
    graph.planner.end("aborted: no parts for 1.5 s")
    assert graph.hear(robot) == "503 aborted: no parts for 1.5 s\r\n"
    graph.spin(0.3)
    assert graph.planner.began == 1
    graph.planner.ready = {"black_4": (0.1, 0.0)}
    assert "call=" not in graph.say(robot, "state")
    assert graph.say(robot, "get_part").startswith("200 ")
    assert graph.planner.began == 2


STOPPED_TASK = {"state": TaskStatus.ABORTED, "reason": TaskStatus.STOPPED, "text": "so"}
ENDS = {  # of the planner's task, that of the feeder or another
    "a result": lambda planner: planner.end("aborted: so", min(NEED_A_PERSON)),
    "a stop": lambda planner: planner.tell(TaskStatus(task="feed", **STOPPED_TASK)),
    "a stop of the idle planner": lambda planner: planner.tell(
        TaskStatus(reason=TaskStatus.STOPPED, text="so")
    ),
    "another task": lambda planner: planner.tell(
        TaskStatus(task="sort", state=TaskStatus.RUNNING, text="so")
    ),
    "the driver": lambda planner: planner.drive(
        DriverStatus(state=DriverStatus.STOPPED, reason=min(BY_PERSON), text="so")
    ),
}


@pytest.mark.parametrize("end", ENDS)
def test_a_task_that_a_person_has_ended_continues_only_by_a_person(graph, end):
    planner = graph.planner
    planner.ready = {}
    robot = graph.robot()
    graph.ask(robot, "get_part")
    graph.until(lambda: graph.feeder._task._seen)
    if end != "a result":
        planner.silent = True
    ENDS[end](planner)
    answer = graph.hear(robot)
    assert answer.startswith("503 stopped until a person calls resume_feeding: ")
    assert "so" in answer
    planner.silent, planner.ready = False, {"black_4": (0.1, 0.0)}
    for deed in ("get_part", "prepare_part", "get_part black 5"):
        assert graph.say(robot, deed) == answer
    assert not graph.result(graph.send("get_part", GetPart.Goal()))[1].success
    assert not graph.call(PreparePart, "prepare_part").success
    assert graph.say(robot, "resume_feeding").startswith("404 ")
    assert "state=stopped" in (state := graph.say(robot, "state"))
    assert state.endswith(" call=resume_feeding\r\n")
    graph.until(lambda: graph.reports and "resume" in graph.reports[-1].status[0].message)
    assert planner.began == 1
    if end == "the driver":
        refused = graph.call(Trigger, "resume_feeding")
        assert (refused.success, refused.message) == (
            False,
            "driver: so, allowed: ready",
        )
        planner.drive(DriverStatus(state=DriverStatus.READY, text="ready"))
        graph.until(lambda: graph.feeder._driver.state == DriverStatus.READY)
    assert graph.call(Trigger, "resume_feeding").success
    graph.spin(0.3)
    assert planner.began == 1, "it only lets the next command begin"
    assert graph.say(robot, "get_part").startswith("200 ")
    assert planner.began == 2


def test_a_stop_that_was_missed_is_known_by_the_enable_after_it(graph):
    drive, robot = graph.planner.drive, graph.robot()
    for second in (5, 5):
        drive(DriverStatus(state=DriverStatus.READY, text="ready", enabled_at=Time(sec=second)))
        graph.spin(0.2)
        assert not graph.feeder._feeder.stopped
    drive(DriverStatus(state=DriverStatus.READY, text="ready", enabled_at=Time(sec=9)))
    graph.until(lambda: graph.feeder._feeder.stopped)
    assert "enabled again after a stop" in graph.say(robot, "get_part")
    assert graph.call(Trigger, "resume_feeding").success
    assert graph.say(robot, "get_part").startswith("200 ")


def test_a_stop_without_a_task_counts_and_its_repetition_does_not(graph):
    tell = graph.planner.tell
    ended = TaskStatus(task="sort", **STOPPED_TASK)
    robot = graph.robot()
    off = TaskStatus(task="sort", state=TaskStatus.ABORTED, reason=TaskStatus.DRIVER_STOPPED)
    for status in (ended, TaskStatus(reason=TaskStatus.STOPPED, text="idle"), off) * 2:
        tell(status)
        graph.until(lambda: graph.feeder._feeder.stopped)
        assert graph.say(robot, "get_part").startswith("503 ")
        assert graph.call(Trigger, "resume_feeding").success
    tell(ended)
    graph.until(lambda: graph.feeder._feeder.stopped)
    assert graph.call(Trigger, "resume_feeding").success
    received = []
    graph.feeder._task.on_task_status = received.append
    tell(ended)  # as the planner does with each image
    graph.until(lambda: received)
    assert graph.say(robot, "get_part").startswith("200 ")


def test_a_stop_outlives_a_reactivated_feeder(graph):
    graph.planner.tell(TaskStatus(reason=TaskStatus.STOPPED, text="idle"))
    graph.until(lambda: graph.feeder._feeder.stopped)
    answer = graph.say(graph.robot(), "get_part")
    assert answer.startswith("503 ")
    graph.feeder.trigger_deactivate()
    graph.feeder.trigger_activate()
    assert "call=resume_feeding" in graph.say(graph.robot(), "state")
    assert graph.say(graph.robot(), "get_part") == answer


def test_a_restarted_planner_is_noticed(graph):
    graph.call(PreparePart, "prepare_part")
    graph.until(lambda: graph.planner.orders)
    graph.until(lambda: graph.feeder._task._seen)
    graph.planner.goal = None  # it knows nothing of the task any more
    graph.planner.tell(TaskStatus(state=TaskStatus.IDLE, text="idle"))
    robot = graph.robot()
    graph.until(lambda: "state=stopped" in graph.say(robot, "state"))
    assert graph.say(robot, "get_part").startswith("200 ")


def test_a_planner_without_messages_is_reported(graph):
    graph.call(PreparePart, "prepare_part")
    graph.until(lambda: graph.feeder._feeder.quantity().seen)
    graph.planner.silent, graph.planner.ready = True, {}
    assert graph.say(graph.robot(), "get_part").startswith("502 no feed_status")
    graph.until(lambda: "feed_status" in graph.reports[-1].status[0].message)


def test_purge_ends_the_task(graph):
    handle = graph.send("purge_plate", PurgePlate.Goal())
    graph.until(lambda: graph.planner.mode is FeedMode.PURGE)
    graph.planner.seen, graph.planner.ready = 0, {}
    status, result = graph.result(handle)
    assert (status, result.left) == (GoalStatus.STATUS_SUCCEEDED, 0)
    graph.until(lambda: graph.planner.goal is None)
    robot = graph.robot()
    graph.planner.seen, graph.planner.ready = 15, {"black_4": (0.1, 0.0)}
    assert graph.say(robot, "get_part").startswith("200 ")  # right after the end
    assert graph.say(robot, "purge 0.3").startswith("508 15 parts")


def test_waiting_requests_are_answered_when_the_node_is_deactivated(graph):
    graph.planner.ready = {}
    robot = graph.robot()
    graph.ask(robot, "get_part")
    graph.until(lambda: graph.planner.orders)
    graph.feeder.trigger_deactivate()
    assert graph.hear(robot) == f"503 {STOPPED}\r\n"
    graph.until(lambda: graph.planner.goal is None)
    for name, goal in (("get_part", GetPart.Goal()), ("purge_plate", PurgePlate.Goal())):
        result = graph.result(graph.send(name, goal))[1]
        assert (result.success, result.message) == (False, STOPPED)
    assert graph.call(PartQuantity, "part_quantity").taken == 0
    assert not graph.call(PartTaken, "part_taken").success
    graph.feeder.trigger_activate()
    graph.planner.ready = {"black_4": (0.1, 0.0)}
    assert graph.say(graph.robot(), "get_part").startswith("200 ")


def test_poses_in_the_frame_of_the_robot(make, tmp_path):
    path = tmp_path / "hand_eye.yaml"
    path.write_text(
        "frame: base\n"
        "points:\n"
        "  - {plate_m: [-0.2, 0], robot_m: [0.5, -0.2]}\n"
        "  - {plate_m: [0.2, 0], robot_m: [0.5, 0.2]}\n"
    )
    graph = make(hand_eye=path)
    graph.planner.ready = {"black_3": (0.1, 0.02)}
    _, result = graph.result(graph.send("get_part", GetPart.Goal()))
    pose = result.pose
    assert pose.header.frame_id == "base"
    at = pose.pose.pose.position
    assert (at.x, at.y) == pytest.approx((0.48, 0.1))
    assert (pose.pose.covariance[0], pose.pose.covariance[7]) == pytest.approx((4e-8, 1e-8))
    assert result.part.x == 0.1
    graph.call(PartTaken, "part_taken", taken=False)
    graph.spin(1.2)
    assert graph.say(graph.robot(), "get_part").startswith("200 x=480.00 y=100.00 angle=95.73 ")


def test_a_pose_in_the_frame_of_one_of_two_plates(make):
    graph = make(frame_prefix="left/")
    graph.planner.ready = {"black_3": (0.1, 0.02)}
    _, result = graph.result(graph.send("get_part", GetPart.Goal()))
    assert result.pose.header.frame_id == "left/plate_home"


def test_a_recipe_brings_its_rig(make):
    graph = make(recipe="feed_bars")
    assert graph.say(graph.robot(), "get_part disc").endswith("allowed: bar\r\n")


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [("recipe", "sort_10", "sort_10"), ("hand_eye", "none.yaml", "none.yaml")],
)
def test_wrong_parameters_are_refused(clock, name, value, named):
    with pytest.raises(PlateError, match=named):
        Graph(clock, **{name: value})
