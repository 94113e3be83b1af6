"""The feeder's rules against a planner that does as ordered, and one that does not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from plate_core import load_rig
from plate_core.tasks import FeedMode, FeedTask, Hopper, Pick, Side, as_picked
from plate_feeder import Code, Feeder, FeedStatus, ReadyPart, State
from plate_feeder.feeder import (
    FALLEN_S,
    MAX_FAILURES,
    MAX_OPENINGS,
    SEEN_AGAIN_S,
    START_S,
    STATUS_TIMEOUT_S,
)

RIG = load_rig("")
WINDOW = {"low": (-0.05, -0.1), "high": (0.25, 0.1)}
BLACK = Pick("black", 2, **WINDOW)
GREY = Pick("grey", 1, **WINDOW)
HOPPER = Hopper(fill=10, least=8, rate=5.0, place=(-0.2, 0.0), spread_m=0.05, mix={"black": 1.0})
TASK = FeedTask(picks=(BLACK,), clearance_m=0.006, timeout_s=5.0, valid_s=3.0)
PURGED = replace(TASK, chute=Side(-1, 0), hopper=HOPPER)
PERIOD_S = 0.1


def part(name, x=0.1, y=0.0, angle=0.0):
    return ReadyPart(name, x, y, angle)


class Cell:
    """A feeder and a planner: each status is of the order that was in force two cycles before."""

    def __init__(self, task=TASK, ready=("black_1", "black_2"), seen=None):
        self.feeder, self.t, self.steps = Feeder(task, RIG), 100.0, 0
        self.ready = {name: part(name, 0.05 + 0.03 * i) for i, name in enumerate(ready)}
        self.seen = {"black": 10} if seen is None else seen
        self.modes, self.moving, self.mode = [FeedMode.FEED] * 3, 0, FeedMode.FEED
        self.output, self.replies, self.opened = self.feeder.step(self.t), [], []
        self.counts, self.silent, self.at_rest = {}, False, True
        self.busy = False  # whether the planner has more to do though enough are ready

    def do(self, method, *args, **kwargs):
        """Give a command, and return its reply, now or in this step."""
        reply = getattr(self.feeder, method)("robot", *args, **kwargs)
        self.step()
        return reply

    def get(self, *args, **kwargs):
        return self.do("get_part", *args, now=self.t, **kwargs)

    def step(self):
        self.output = self.feeder.step(self.t)
        self.replies += [reply for _, reply in self.output.replies]
        if self.output.open_s is not None:
            self.opened.append((self.t, self.output.open_s))

    def run(self, cycles=1):
        for _ in range(cycles):
            self.t += PERIOD_S
            if self.output.run and not self.silent:
                self.modes.append(self.output.order.mode)
                self.mode = self.modes[-2]
                rests = self.mode is FeedMode.REST or (len(self.ready) >= 2 and not self.busy)
                self.moving = 0 if rests else 2
                self.shown = set(self.ready)
                self.feeder.receive_status(
                    FeedStatus(
                        stamp=1000.0 + self.t - 0.05, mode=self.mode,
                        at_rest=rests and self.at_rest, ready=tuple(self.ready.values()),
                        seen=self.seen, **self.counts,
                    ),
                    self.t,
                )  # fmt: skip
            self.step()

    def answer(self, seconds=10.0):
        """Run until a command is answered."""
        for _ in range(round(seconds / PERIOD_S)):
            if self.replies:
                break
            self.run()
        return self.replies.pop(0)


def test_the_task_does_not_run_before_a_command():
    cell = Cell()
    cell.run(5)
    assert not cell.output.run
    assert cell.feeder.state(cell.t) is State.IDLE
    assert cell.get() is None
    assert cell.output.run
    assert cell.feeder.state(cell.t) is State.STARTING


def test_a_robot_does_not_wait_if_enough_are_ready():
    """Then the plate rests by order before it asks."""
    cell = Cell()
    cell.do("prepare_part", now=cell.t)
    cell.run(8)
    assert cell.feeder.state(cell.t) is State.READY
    cell.get()
    assert [reply.code for reply in cell.replies] == [Code.DONE]


def test_the_planner_rests_by_itself_before_it_is_ordered_to():
    """It may have something to do although enough are ready: parts for the chute."""
    cell = Cell()
    cell.get()
    cell.answer()
    cell.busy, cell.ready["black_3"] = True, part("black_3")
    cell.do("part_taken")
    cell.run(15)
    assert cell.output.order.mode is FeedMode.FEED
    cell.busy = False
    cell.run(2)
    assert cell.output.order.mode is FeedMode.REST


def test_ready_parts_are_evaluated_when_the_plate_rests():
    cell = Cell(ready=("black_1",))
    cell.get()
    cell.run()
    assert cell.output.order.mode is FeedMode.REST
    ready, cell.ready, cell.at_rest = cell.ready, {}, False
    cell.run(3)
    assert cell.output.order.mode is FeedMode.REST
    cell.ready, cell.at_rest = ready, True
    cell.run()
    assert cell.replies[0].part.id == "black_1"


def test_a_part_is_reported_only_at_rest_under_an_order_to_rest():
    cell = Cell(ready=("black_1",))  # one is too few: the planner moves
    cell.do("prepare_part", now=cell.t)
    cell.run(8)
    assert cell.output.order.mode is FeedMode.FEED
    cell.get()
    assert cell.output.order.mode is FeedMode.REST  # at once
    assert not cell.replies
    cell.run()
    assert cell.mode is FeedMode.FEED
    assert not cell.replies
    assert cell.answer().part.id == "black_1"
    assert cell.mode is FeedMode.REST


def test_a_part_removed_before_the_plate_rests_is_not_reported():
    cell = Cell(ready=("black_1",))
    cell.get()
    cell.run()
    assert cell.output.order.mode is FeedMode.REST
    cell.ready.clear()
    cell.run(5)
    assert not cell.replies
    assert cell.output.order.mode is FeedMode.FEED


def test_a_status_of_an_earlier_rest_does_not_count_for_the_present_rest():
    cell = Cell()
    cell.get()
    cell.answer()
    cell.ready = {"black_3": part("black_3")}
    cell.do("part_taken", taken=True)
    assert cell.output.order.mode is FeedMode.FEED
    cell.get()  # the newest status is of the order before
    assert not cell.replies
    assert cell.answer().part.id == "black_3"
    assert FeedMode.FEED in cell.modes[-6:]


def test_a_part_that_was_taken_is_not_reported_while_old_images_show_it():
    cell = Cell(ready=("black_1",))
    cell.get()
    cell.answer()
    since = cell.t
    assert cell.do("part_taken", taken=True).code is Code.DONE
    cell.get()
    cell.run(int(0.9 * SEEN_AGAIN_S / PERIOD_S))
    assert not cell.replies
    reply = cell.answer()  # it lies there in images that were taken later
    assert reply.part.id == "black_1"
    assert cell.t - since >= SEEN_AGAIN_S


def test_a_part_whose_pick_failed_is_offered_again_a_limited_number_of_times():
    cell = Cell(ready=("black_1",))
    for count in range(MAX_FAILURES):
        assert cell.get() is None
        assert cell.answer().part.id == "black_1"
        reply = cell.do("part_taken", "black_1", False)
        assert f"failed picks at this place: {count + 1}" in reply.text
    cell.get()
    assert cell.answer().code is Code.NO_PART
    requested = {pick.label: pick.ready for pick in cell.output.order.picks}
    assert requested == {"black": BLACK.ready + 1}  # one in its place
    cell.ready["black_1"] = part("black_1", 0.2)  # it lies elsewhere
    cell.get()
    assert cell.answer().part.id == "black_1"


def test_a_part_that_has_not_failed_comes_first():
    cell = Cell(ready=())
    cell.ready = {"black_1": part("black_1", 0.10), "black_2": part("black_2", 0.2)}
    cell.get()
    assert cell.answer().part.id == "black_1"  # in the middle of the window
    cell.do("part_taken", taken=False)
    cell.run(30)
    cell.get()
    assert cell.answer().part.id == "black_2"


def test_a_reservation_ends_in_time_and_may_be_reported_later():
    cell = Cell()
    cell.get()
    name = cell.answer().part.id
    cell.run(round(TASK.valid_s / PERIOD_S) + 1)
    assert cell.feeder.reserved is None
    late = cell.do("part_taken", name, True)
    assert late.code is Code.DONE
    assert late.text.startswith(f"{name} is taken, but its reservation had expired")
    assert cell.feeder.quantity().taken == 1
    assert cell.do("part_taken", name, True).code is Code.NOT_RESERVED


def test_other_clients_are_refused_and_the_same_one_gives_its_part_up():
    cell = Cell()
    cell.get()
    feeder = cell.feeder
    assert feeder.get_part("other", now=cell.t).code is Code.BUSY
    first = cell.answer().part.id
    refusals = [
        feeder.get_part("other", now=cell.t),
        feeder.prepare_part("other", now=cell.t),
        *(feeder.part_taken("other", name) for name in ("", first, "black_77")),
    ]
    assert [reply.code for reply in refusals] == [*2 * [Code.BUSY], *3 * [Code.NOT_RESERVED]]
    assert not any(first in reply.text for reply in refusals), "its client alone knows the id"
    assert len({reply.text for reply in refusals[2:]}) == 1, "nor can others find it out"
    assert feeder.reserved.part.id == first
    assert feeder.part_taken("robot", "black_77").code is Code.NOT_RESERVED
    assert cell.get() is None
    assert cell.answer().part.id != first


@pytest.mark.parametrize("late", [False, True])
def test_the_part_of_a_disconnected_client_is_reported_with_its_id(late):
    """The robot may still stand over it, and comes back as another client."""
    cell = Cell()
    cell.get()
    name, feeder = cell.answer().part.id, cell.feeder
    if late:  # its time is over
        cell.run(round(TASK.valid_s / PERIOD_S) + 1)
    assert feeder.part_taken("back", name).code is Code.NOT_RESERVED, "its client is there"
    feeder.remove_client("other")
    assert feeder.part_taken("back", name).code is Code.NOT_RESERVED
    feeder.remove_client("robot")
    cell.run(3)
    if not late:
        assert cell.output.order.mode is FeedMode.REST
        assert feeder.reserved.client is None
        assert feeder.get_part("back", now=cell.t).code is Code.BUSY
    for wrong in ("", "black_77"):
        reply = feeder.part_taken("back", wrong)
        assert (reply.code, name in reply.text) == (Code.NOT_RESERVED, False)
    assert feeder.part_taken("back", name).code is Code.DONE
    assert feeder.get_part("back", now=cell.t) is None


def test_the_part_of_a_disconnected_client_stays_reserved_until_its_time_is_over():
    cell = Cell()
    cell.get()
    until = cell.answer().valid_until
    cell.feeder.remove_client("robot")
    while cell.feeder.reserved is not None:
        assert cell.output.order.mode is FeedMode.REST
        cell.run()
    assert cell.t == pytest.approx(until, abs=1.5 * PERIOD_S)
    assert cell.feeder.get_part("other", now=cell.t) is None


def test_a_part_is_prepared_for_the_next_command_that_names_none():
    task = replace(TASK, picks=(BLACK, GREY))
    cell = Cell(task, ready=("black_1", "black_2", "grey_1"), seen={"black": 5, "grey": 5})
    cell.do("prepare_part", "grey", now=cell.t)
    cell.run(8)
    cell.get()
    assert cell.answer().part.id == "grey_1"
    cell.do("part_taken")
    cell.get()
    assert cell.answer().part.label == "black"


def test_a_window_and_an_angle_of_a_command():
    cell = Cell(ready=())
    cell.ready = {"black_1": part("black_1", 0.1), "black_2": part("black_2", 0.2)}
    pick = replace(BLACK, low=(0.15, -0.1), ready=1)
    assert cell.get(pick=pick) is None
    assert cell.output.order.picks == (pick,)
    assert cell.answer().part.id == "black_2"
    cell.do("part_taken")
    cell.run(3)
    one_more = replace(BLACK, ready=BLACK.ready + 1)  # while old images show the removed part
    assert cell.output.order.picks == (one_more,)
    cell.run(15)
    assert cell.output.order.picks == (BLACK,)


def test_the_angle_tolerance_respects_the_symmetry_of_parts():
    rig = load_rig("shapes")
    pick = Pick("bar", 1, **WINDOW, angle=0.0, tolerance_rad=math.radians(5))
    assert rig.part_type("bar").symmetry == 2
    offered = [
        angle
        for angle in (0.0, 4.0, 6.0, 90.0, 174.0, 176.0, -184.0, 720.0)
        if as_picked(part("bar_1", angle=math.radians(angle)).alone, pick, rig)[0]
    ]
    assert offered == [0.0, 4.0, 176.0, -184.0, 720.0]


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"label": "blue"}, "blue"),
        ({"label": "grey"}, "grey"),
        ({"timeout_s": -1.0}, "-1"),
        ({"timeout_s": math.nan}, "nan"),
        ({"timeout_s": 1e6}, "timeout_s"),
        ({"pick": replace(BLACK, label="")}, "class"),
        ({"label": "black", "pick": GREY}, "grey"),
        ({"pick": replace(BLACK, low=(1.0, 0.0), high=(2.0, 0.0))}, "window"),
        ({"pick": replace(BLACK, low=(math.nan, 0.0))}, "window"),
        ({"pick": replace(BLACK, angle=0.0, tolerance_rad=0.1)}, "round"),
        ({"pick": replace(BLACK, ready=0)}, "ready"),
    ],
)
def test_wrong_arguments_are_refused(given, named):
    reply = Feeder(TASK, RIG).get_part("robot", **given, now=0.0)
    assert reply.code is Code.BAD_ARGUMENT
    assert named in reply.text


def test_no_part_in_time():
    cell = Cell(ready=())
    cell.get(timeout_s=2.0)
    before = cell.t
    reply = cell.answer()
    assert reply.code is Code.NO_PART
    assert "2 s" in reply.text
    assert reply.text.endswith("; the recipe has no hopper")
    assert cell.t - before == pytest.approx(2.0, abs=0.15)


def test_a_planner_that_never_rests_or_sends_nothing():
    cell = Cell()
    cell.at_rest = False
    cell.get()
    assert cell.answer().code is Code.NO_PART
    cell.at_rest, cell.silent = True, True
    cell.get()
    before = cell.t
    reply = cell.answer()
    assert reply.code is Code.SILENT
    assert "feed_status" in reply.text
    assert cell.t - before < STATUS_TIMEOUT_S + 3 * PERIOD_S
    assert cell.feeder.state(cell.t) is State.SILENT


def test_a_task_that_does_not_begin():
    cell = Cell()
    cell.silent = True
    cell.get(timeout_s=60.0)
    before = cell.t
    assert cell.answer(2 * START_S).code is Code.SILENT
    assert cell.t - before == pytest.approx(START_S, abs=0.25)
    assert not cell.output.run  # no task begins later without a waiting client


@pytest.mark.parametrize("command", ["prepare_part", "get_part"])
def test_a_client_without_a_wait_withdraws_a_task_that_does_not_begin(command):
    cell = Cell()
    cell.silent = True
    cell.do(command, now=cell.t)
    cell.feeder.remove_client("robot")
    cell.run(round((START_S - 1) / PERIOD_S))
    assert cell.output.run
    cell.run(round(2 / PERIOD_S))
    assert not cell.output.run


def test_the_end_of_the_task_is_reported_at_once_and_a_command_begins_it_again():
    cell = Cell(ready=())
    cell.get()
    cell.run(3)
    cell.feeder.task_ended("stopped by the service stop")
    assert cell.feeder.state(cell.t) is State.STOPPED
    cell.step()
    assert cell.replies.pop().text == "stopped by the service stop"
    assert not cell.output.run
    cell.run(5)
    assert not cell.output.run
    cell.get()
    assert cell.output.run


def test_after_a_stop_nothing_starts_before_a_person_requests_it():
    cell = Cell(PURGED, ready=())
    cell.get()
    cell.run(3)
    feeder = cell.feeder
    feeder.stop("aborted: stopped")
    cell.step()
    reply = cell.replies.pop()
    assert reply.code is Code.STOPPED
    assert "call" in reply.text
    assert "resume_feeding" in reply.text
    assert "aborted: stopped" in reply.text
    for command in ("get_part", "prepare_part", "purge"):
        for client in ("robot", "other"):
            reply = getattr(feeder, command)(client, now=cell.t)
            expected = replace(reply, left=10 if command == "purge" else 0)
            assert repr(reply) == repr(expected)  # its NaN is unequal to itself
        cell.run(2)
        assert not cell.output.run
    feeder.task_ended("the planner is gone")  # later events do not end the stop
    assert feeder.get_part("robot", now=cell.t).code is Code.STOPPED
    assert feeder.state(cell.t) is State.STOPPED
    feeder.resume()
    assert feeder.stopped == ""
    assert feeder.state(cell.t) is State.IDLE
    cell.run(5)
    assert not cell.output.run, "it only lets the next command begin"
    cell.get()
    assert cell.output.run


@pytest.mark.parametrize("end", ["stop", "task_ended"])
def test_the_end_of_the_task_keeps_the_reservation_and_its_report(end):
    cell = Cell()
    cell.get()
    name = cell.answer().part.id
    getattr(cell.feeder, end)("driver: emergency stop")
    cell.run(2)
    other = Code.STOPPED if end == "stop" else Code.BUSY
    assert cell.feeder.get_part("other", now=cell.t).code is other
    assert cell.do("part_taken", name).code is Code.DONE
    cell.run(2)
    assert not cell.output.run


def test_resume_without_a_stop_has_no_effect():
    cell = Cell()
    cell.get()
    cell.run(3)
    cell.feeder.resume()
    cell.step()
    assert cell.output.run
    cell.feeder.task_ended("no parts for 1.5 s")
    cell.feeder.resume()
    assert cell.feeder.state(cell.t) is State.STOPPED
    assert cell.get() is None, "a technical failure needs no person"


def test_counts_continue_from_task_to_task():
    cell = Cell()
    cell.get()
    cell.answer()
    cell.counts = {"discharged": 3, "lost": 1}
    cell.run(2)
    cell.feeder.task_ended("stopped")
    cell.do("part_taken")
    quantity = cell.feeder.quantity()
    assert (quantity.taken, quantity.discharged, quantity.lost) == (1, 3, 1)
    cell.counts = {"discharged": 2}
    cell.get()
    cell.run(3)
    assert cell.feeder.quantity().discharged == 5


def test_a_canceled_request_gets_no_reply_but_a_reservation_stays():
    cell = Cell()
    cell.get()
    cell.feeder.cancel("other")
    cell.feeder.cancel("robot")
    cell.run(20)
    assert not cell.replies
    cell.get()
    cell.answer()
    cell.feeder.cancel("robot")
    cell.step()
    assert cell.feeder.reserved is not None


def test_purge_ends_when_the_plate_is_empty():
    cell = Cell(PURGED)
    assert cell.do("purge", now=cell.t) is None
    cell.run(4)
    assert cell.mode is FeedMode.PURGE
    assert cell.feeder.state(cell.t) is State.PURGING
    assert cell.feeder.get_part("other", now=cell.t).code is Code.BUSY
    cell.seen, cell.ready = {"black": 0}, {}
    reply = cell.answer()
    assert (reply.code, reply.left) == (Code.DONE, 0)
    assert not cell.output.run
    assert not [t for t, _ in cell.opened if t > 100.2]


@pytest.mark.parametrize("command", ["get_part", "prepare_part", "purge"])
def test_the_next_command_ends_a_reservation(command):
    cell = Cell(PURGED, ready=("black_1",))
    cell.get()
    name = cell.answer().part.id
    assert cell.feeder.state(cell.t) is State.RESERVED
    cell.do(command, now=cell.t)
    assert cell.feeder.state(cell.t) is not State.RESERVED
    cell.run(2)
    assert cell.output.order.mode is (FeedMode.PURGE if command == "purge" else FeedMode.FEED)
    reply = cell.do("part_taken")
    assert reply.text.startswith(f"{name} is taken, but its reservation had expired")


def test_purge_that_takes_too_long_or_is_withdrawn_or_has_no_chute():
    cell = Cell(PURGED)
    cell.do("purge", 2.0, now=cell.t)
    reply = cell.answer()
    assert (reply.code, reply.left) == (Code.NOT_PURGED, 10)
    assert not cell.output.run
    cell.do("purge", now=cell.t)
    cell.feeder.cancel("robot")
    cell.step()
    assert not cell.output.run
    assert Cell().do("purge", now=0.0).code is Code.NOT_PURGED
    assert cell.do("purge", math.inf, now=cell.t).code is Code.BAD_ARGUMENT


def filled(cell, count):
    cell.seen = {"black": count}


def test_the_hopper_opens_for_what_is_missing_and_not_before_that_can_be_seen():
    cell = Cell(replace(TASK, hopper=HOPPER), ready=(), seen={"black": 6})
    cell.get()
    cell.run(3)
    ((opened, duration),) = cell.opened
    assert duration == pytest.approx(4 / HOPPER.rate)
    filled(cell, 7)
    while len(cell.opened) == 1:
        cell.run()
    assert cell.t - opened >= duration + FALLEN_S
    assert cell.opened[1][1] == pytest.approx(3 / HOPPER.rate)
    filled(cell, 8)
    cell.run(30)
    assert len(cell.opened) == 2


def test_a_hopper_opens_for_a_class_that_is_waited_for_and_not_there():
    cell = Cell(replace(TASK, picks=(BLACK, GREY), hopper=HOPPER), ready=(), seen={"black": 9})
    cell.get("black", timeout_s=1.0)
    cell.answer()
    assert not cell.opened
    cell.get("grey", timeout_s=2.0)
    reply = cell.answer()
    assert [duration for _, duration in cell.opened] == [pytest.approx(1 / HOPPER.rate)] * 2
    assert reply.text.endswith(
        "parts on the plate: 9, of them grey: 0; ready parts of any class: 0"
    )


def test_a_hopper_that_brings_nothing_is_empty_and_tried_again_by_a_command():
    cell = Cell(replace(TASK, hopper=HOPPER, timeout_s=60.0), ready=(), seen={"black": 0})
    cell.get()
    reply = cell.answer(60.0)
    assert reply.code is Code.HOPPER_EMPTY
    assert len(cell.opened) == MAX_OPENINGS
    assert cell.feeder.hopper_empty
    cell.run(100)
    assert len(cell.opened) == MAX_OPENINGS
    cell.get()
    cell.run(3)
    assert len(cell.opened) == MAX_OPENINGS + 1
    filled(cell, 9)
    cell.run(30)
    assert not cell.feeder.hopper_empty
    assert not cell.replies


def test_a_robot_that_does_not_report_its_parts_does_not_empty_the_hopper():
    """Each get_part gives the part before it up."""
    cell = Cell(replace(TASK, hopper=replace(HOPPER, fill=8)), ready=(), seen={"black": 8})
    for name in range(40):
        cell.ready = {f"black_{name}": part(f"black_{name}")}
        cell.get()
        for _ in range(6):
            falls = round(sum(HOPPER.rate * open_s for t, open_s in cell.opened if t == cell.t))
            cell.run()
            filled(cell, cell.seen["black"] + falls)
            assert not cell.feeder.hopper_empty
        assert cell.replies.pop().code is Code.DONE
        filled(cell, cell.seen["black"] - 1)
    assert len(cell.opened) > 2 * MAX_OPENINGS


def test_no_hopper_opens_over_a_robot_and_no_part_is_reported_on_which_others_fall():
    cell = Cell(replace(TASK, hopper=HOPPER), ready=(), seen={"black": 7})
    cell.ready = {"black_1": part("black_1", -0.15)}  # in no window that we have
    cell.feeder = Feeder(replace(cell.feeder.task, picks=(replace(BLACK, low=(-0.2, -0.1)),)), RIG)
    cell.get()
    cell.run(8)
    assert len(cell.opened) == 1
    assert not cell.replies
    filled(cell, 9)
    reply = cell.answer()
    assert cell.t >= cell.opened[0][0] + cell.opened[0][1] + FALLEN_S
    assert reply.code is Code.DONE
    filled(cell, 3)
    cell.run(10)
    assert len(cell.opened) == 1
    cell.do("part_taken")
    assert len(cell.opened) == 2


def test_parts_that_fall_while_a_robot_hides_them_are_counted_before_the_hopper_opens():
    """Until the robot has left, the planner uses the last image before. Otherwise newly dropped
    parts would be dropped again, and parts below the robot would be offered."""
    place = replace(BLACK, low=(-0.2, -0.1))
    cell = Cell(replace(TASK, picks=(place,), hopper=HOPPER), ready=(), seen={"black": 2})
    cell.ready = {"black_1": part("black_1"), "black_2": part("black_2", -0.19)}
    cell.get()
    assert cell.answer().part.id == "black_1"
    assert len(cell.opened) == 1
    cell.run(28)
    assert cell.t > cell.opened[0][0] + cell.opened[0][1] + FALLEN_S
    assert cell.do("part_taken").code is Code.DONE
    cell.get()
    cell.run(2)
    assert len(cell.opened) == 1
    assert not cell.replies
    filled(cell, 9)
    assert cell.answer().part.id == "black_2"
    cell.run(20)
    assert len(cell.opened) == 1
    assert not cell.feeder.hopper_empty


def test_a_plate_on_which_parts_still_fall_is_not_purged():
    cell = Cell(PURGED, ready=(), seen={"black": 0})
    cell.get()
    cell.run(3)
    assert cell.opened[0][1] == pytest.approx(2.0)
    cell.feeder.cancel("robot")
    began = cell.t
    cell.do("purge", now=cell.t)
    assert cell.opened[1:] == [(began, 0.0)], "only the parts that fall already"
    reply = cell.answer()
    assert reply.code is Code.DONE
    assert FALLEN_S <= cell.t - began < FALLEN_S + 4 * PERIOD_S


def test_a_hopper_is_shut_when_the_task_ends_and_not_opened_again_before_that_can_be_seen():
    cell = Cell(replace(TASK, hopper=HOPPER), ready=(), seen={"black": 0})
    cell.get()
    cell.run(3)
    cell.feeder.stop("somebody has pressed the button")
    ended = cell.t
    cell.run(3)
    assert cell.opened[1:] == [(ended + PERIOD_S, 0.0)]
    cell.feeder.resume()
    cell.get()
    cell.run(5)
    assert len(cell.opened) == 2
    cell.run(10)
    again, duration = cell.opened[2]
    assert again >= ended + FALLEN_S
    assert duration == pytest.approx(2.0)
    filled(cell, 9)
    cell.run(40)
    cell.feeder.stop("again")
    cell.run(3)
    assert len(cell.opened) == 3, "it has closed long ago"


def test_no_hopper_is_open_for_longer_at_once_than_the_simulators_may_be():
    slow = replace(TASK, hopper=replace(HOPPER, fill=100, least=90, rate=0.1))
    cell = Cell(slow, ready=(), seen={"black": 1})
    cell.get()
    cell.run(3)
    assert [duration for _, duration in cell.opened] == [60.0]


def test_a_clock_that_was_set_back_delays_nothing_forever():
    cell = Cell(ready=("black_1",))
    cell.get()
    cell.answer()
    cell.do("part_taken", taken=False)
    stamp = 5.0
    cell.feeder.receive_status(FeedStatus(stamp, FeedMode.FEED, False, (part("black_1"),)), cell.t)
    assert cell.feeder.quantity().ready == 1


@pytest.mark.parametrize("seed", range(2))
def test_any_sequence_of_commands_and_statuses(seed):
    """Parts flicker, come and go; the robot and a second client ask as they like."""
    rng = np.random.default_rng(seed)
    task = replace(PURGED, picks=(BLACK, GREY), timeout_s=3.0, valid_s=1.5)
    cell = Cell(task, ready=(), seen={"black": 5, "grey": 5})
    feeder = cell.feeder
    reported = {}
    waiting = {}
    answered = 0
    names = [f"{label}_{k}" for label in ("black", "grey") for k in range(4)]
    for _ in range(3000):
        who, deed = rng.choice(["robot", "other"]), rng.choice(10, p=[0.4, *8 * [0.07], 0.04])
        label = rng.choice(["", "black", "grey"])
        if deed == 1 and (reply := feeder.get_part(who, label, now=cell.t)) is None:
            assert who not in waiting
            waiting[who] = cell.t + task.timeout_s
        elif deed == 2:
            kept = feeder.reserved
            feeder.part_taken(who, rng.choice(["", *names]), bool(rng.random() < 0.7))
            assert feeder.reserved == kept or kept.client in (who, None)
        elif deed == 3 and rng.random() < 0.3:
            feeder.prepare_part(who, label, now=cell.t)
        elif deed == 4 and rng.random() < 0.1 and feeder.purge(who, now=cell.t) is None:
            waiting[who] = cell.t + task.timeout_s
        elif deed == 5 and rng.random() < 0.2:
            feeder.cancel(who)
            waiting.pop(who, None)
        elif deed == 6 and rng.random() < 0.1:
            (feeder.stop if rng.random() < 0.5 else feeder.task_ended)("stopped")
        elif deed == 7:
            cell.silent = bool(rng.random() < 0.1)
        elif deed == 8:
            name = rng.choice(names)
            if cell.ready.pop(name, None) is None and len(cell.ready) < 4:
                cell.ready[name] = part(name, *rng.uniform((-0.05, -0.1), (0.25, 0.1)))
            cell.seen = {"black": int(rng.integers(0, 9)), "grey": int(rng.integers(0, 5))}
        elif deed == 9 and feeder.stopped:
            feeder.resume()
        elif deed == 9 and rng.random() < 0.3:
            feeder.remove_client(who)
            waiting.pop(who, None)
        opened, reserved = len(cell.opened), feeder.reserved
        cell.run()
        rests, was = feeder.reserved is not None, reserved is not None
        assert not (rests and was and any(open_s for _, open_s in cell.opened[opened:]))
        assert not (feeder.stopped and cell.output.run)
        if rests and cell.output.run and feeder.reserved == reserved:
            assert cell.output.order.mode is FeedMode.REST
        for client, reply in cell.output.replies:
            answered += 1
            assert cell.t <= waiting.pop(client) + 2 * PERIOD_S
            if reply.part is None:
                continue
            name = reply.part.id
            assert cell.mode is FeedMode.REST
            assert name in cell.shown
            assert cell.t - reported.get(name, -math.inf) >= SEEN_AGAIN_S - PERIOD_S
            reported[name] = cell.t
        assert all(cell.t <= until + 2 * PERIOD_S for until in waiting.values())
    assert answered > 50
    assert len(reported) == len(names)
